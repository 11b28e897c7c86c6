"""Metrics of a run: pure functions of what the human did and what the robot was told to do.

``evaluate(trace)`` gives all of them; the modules beside it hold one family each and can be used
alone: :mod:`~smooth_operator.metrics.accuracy`, :mod:`~smooth_operator.metrics.consistency`,
:mod:`~smooth_operator.metrics.joints`, :mod:`~smooth_operator.metrics.safety`,
:mod:`~smooth_operator.metrics.service` and :mod:`~smooth_operator.metrics.published`.
"""

from smooth_operator.metrics.evaluation import Definition as Definition
from smooth_operator.metrics.evaluation import evaluate as evaluate
from smooth_operator.metrics.plots import save_plots as save_plots
from smooth_operator.metrics.table import GROUPS as GROUPS
from smooth_operator.metrics.table import METRICS as METRICS
from smooth_operator.metrics.table import Metric as Metric
from smooth_operator.metrics.trace import Trace as Trace
from smooth_operator.metrics.trace import keyvectors as keyvectors
