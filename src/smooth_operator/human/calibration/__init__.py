"""An operator's calibration: the poses that are asked for or found, and what they tell."""
