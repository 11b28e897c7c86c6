from smooth_operator.calibration.estimate import Calibration as Calibration
from smooth_operator.calibration.estimate import calibrate as calibrate
