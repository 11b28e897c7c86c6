"""The synthetic operator: a parametric human hand that makes gestures, and a model of its
tracker."""

from smooth_operator.synthetic.gestures import GESTURES as GESTURES
from smooth_operator.synthetic.operator import SyntheticOperator as SyntheticOperator
from smooth_operator.synthetic.tracker import TRACKERS as TRACKERS
from smooth_operator.synthetic.tracker import TrackerModel as TrackerModel
from smooth_operator.synthetic.tracker import WristMotion as WristMotion
