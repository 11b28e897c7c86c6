from smooth_operator.solvers.newton import NewtonConfig as NewtonConfig
from smooth_operator.solvers.newton import newton_minimise as newton_minimise
from smooth_operator.solvers.sampling import SamplingConfig as SamplingConfig
from smooth_operator.solvers.sampling import sample_minimise as sample_minimise
