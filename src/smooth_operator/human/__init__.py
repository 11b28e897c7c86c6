"""The human side: alignment to the palm, scale, calibration, filtering, directions of the palm."""

from smooth_operator.moved_names import former_names

__getattr__ = former_names(__name__)
