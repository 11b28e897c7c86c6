"""Metrics of a run: pure functions of what the human did and what the robot was told to do.

``evaluate(trace)`` gives all of them; the modules beside it hold one family each and can be used
alone: ``smooth_operator.metrics.accuracy``, ``smooth_operator.metrics.consistency``,
``smooth_operator.metrics.joints``, ``smooth_operator.metrics.safety``,
``smooth_operator.metrics.service`` and ``smooth_operator.metrics.published``.
"""

from smooth_operator.metrics.evaluation import Definition as Definition
from smooth_operator.metrics.evaluation import evaluate as evaluate
from smooth_operator.metrics.table import GROUPS as GROUPS
from smooth_operator.metrics.table import METRICS as METRICS
from smooth_operator.metrics.table import Metric as Metric
from smooth_operator.metrics.trace import Trace as Trace
from smooth_operator.metrics.trace import keyvectors as keyvectors
