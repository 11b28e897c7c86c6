from smooth_operator.metrics.assemble import assemble_trace as assemble_trace
from smooth_operator.metrics.table import METRICS as METRICS
from smooth_operator.metrics.table import Metric as Metric
from smooth_operator.metrics.table import evaluate as evaluate
from smooth_operator.metrics.trace import Trace as Trace
