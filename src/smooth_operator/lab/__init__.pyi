from smooth_operator.lab.physics.reachable_motion import motion_figures as motion_figures
from smooth_operator.lab.physics.reachable_motion import reachable_motion as reachable_motion
from smooth_operator.lab.validation.hand_validation import check_hand as check_hand
