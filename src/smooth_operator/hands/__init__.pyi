from smooth_operator.hands.hand import Hand as Hand
from smooth_operator.hands.registry import hand_names as hand_names
from smooth_operator.hands.registry import load_hand as load_hand
from smooth_operator.hands.spec import FingerSpec as FingerSpec
from smooth_operator.hands.spec import HandSpec as HandSpec
from smooth_operator.hands.spec import Point as Point
