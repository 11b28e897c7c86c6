from smooth_operator.human.alignment import AlignmentConfig as AlignmentConfig
from smooth_operator.human.alignment import align_recording as align_recording
from smooth_operator.human.alignment import calibrate_scale as calibrate_scale
from smooth_operator.human.calibration.estimate import Calibration as Calibration
from smooth_operator.human.calibration.estimate import calibrate as calibrate
from smooth_operator.human.operator import OperatorProfile as OperatorProfile
