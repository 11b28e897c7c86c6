"""The report of a benchmark, which is one self-contained HTML file."""

from smooth_operator_benchmark.page.report import write_report as write_report
