"""Benchmarks: recordings x hands x methods into one table of results, plots and a report.

:func:`plan_cells` looks everything up, :func:`run_suite` measures, :func:`make_rows` makes the rows
of ``results.json``, :func:`compare` lays an earlier one beside them, and
:mod:`smooth_operator.benchmark.page` writes the report. Nothing here prints.
"""

from smooth_operator.benchmark.comparison import Comparison as Comparison
from smooth_operator.benchmark.comparison import compare as compare
from smooth_operator.benchmark.results import Row as Row
from smooth_operator.benchmark.results import make_rows as make_rows
from smooth_operator.benchmark.results import read_results as read_results
from smooth_operator.benchmark.settings import Settings as Settings
from smooth_operator.benchmark.suite import Finished as Finished
from smooth_operator.benchmark.suite import plan_cells as plan_cells
from smooth_operator.benchmark.suite import run_suite as run_suite
