"""The human side: alignment to the palm, scale, calibration, filtering, directions of the palm."""
