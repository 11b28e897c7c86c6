from smooth_operator.objective.keyvectors import KeyvectorLayout as KeyvectorLayout
from smooth_operator.objective.loss import ObjectiveConfig as ObjectiveConfig
from smooth_operator.objective.targets import DexPilotTargets as DexPilotTargets
from smooth_operator.objective.targets import PlainTargets as PlainTargets
from smooth_operator.objective.targets import StatelessTargets as StatelessTargets
from smooth_operator.objective.targets import TargetPolicy as TargetPolicy
from smooth_operator.objective.targets import Targets as Targets
from smooth_operator.objective.terms.term import LeastSquaresTerm as LeastSquaresTerm
