"""The report of a study: one HTML file with everything in it."""

from smooth_operator.study.analysis.report.page import write_report as write_report
