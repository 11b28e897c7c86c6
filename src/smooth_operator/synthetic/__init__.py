"""The built-in operator: a parametric human hand that moves, and the tracker that sees it."""

from smooth_operator.synthetic.gestures import GESTURES as GESTURES
from smooth_operator.synthetic.operator import SyntheticOperator as SyntheticOperator
from smooth_operator.synthetic.tracker import TrackerModel as TrackerModel
from smooth_operator.synthetic.wrist import WristMotion as WristMotion
