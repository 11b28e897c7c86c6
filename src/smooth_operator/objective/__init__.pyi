from smooth_operator.objective.least_squares import LeastSquaresTerm as LeastSquaresTerm
from smooth_operator.objective.loss import Objective as Objective
from smooth_operator.objective.published import ObjectiveConfig as ObjectiveConfig
from smooth_operator.objective.sampled import SampledObjective as SampledObjective
from smooth_operator.objective.terms import FrameGoal as FrameGoal
