"""The human hand on its way to the robot: alignment to the palm frame, calibration."""
