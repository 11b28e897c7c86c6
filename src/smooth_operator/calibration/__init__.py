"""Calibration of an operator: the poses that are asked for or found, and what they measure."""
