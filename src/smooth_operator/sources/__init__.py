"""Where hand frames come from: one module per kind of source."""

from smooth_operator.sources.gestures import GESTURES as GESTURES
from smooth_operator.sources.synthetic import SyntheticOperator as SyntheticOperator
from smooth_operator.sources.tracker import TrackerModel as TrackerModel
from smooth_operator.sources.wrist import WristMotion as WristMotion
