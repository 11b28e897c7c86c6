from smooth_operator.calibration.estimate import calibrate as calibrate
