"""Benchmarks: measure every method on every recording and hand, and produce tables, plots and a
report.

``plan_cells`` checks the request, ``run_suite`` measures, ``make_rows`` creates the rows of
``results.json``, ``compare`` compares them with an earlier benchmark, and
``smooth_operator.benchmark.page`` writes the report. Nothing here prints.
"""

from smooth_operator.benchmark.cells import Settings as Settings
from smooth_operator.benchmark.ranking import Comparison as Comparison
from smooth_operator.benchmark.ranking import compare as compare
from smooth_operator.benchmark.suite import Finished as Finished
from smooth_operator.benchmark.suite import Row as Row
from smooth_operator.benchmark.suite import make_rows as make_rows
from smooth_operator.benchmark.suite import plan_cells as plan_cells
from smooth_operator.benchmark.suite import read_results as read_results
from smooth_operator.benchmark.suite import run_suite as run_suite
