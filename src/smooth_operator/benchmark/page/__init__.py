"""The report: one HTML file with everything in it."""

from smooth_operator.benchmark.page.report import write_report as write_report
