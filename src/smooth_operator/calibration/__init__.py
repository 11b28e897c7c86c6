"""Calibration of an operator: the poses that are asked for or found, and what they measure."""

from smooth_operator.lazy_names import public_names

__getattr__, __dir__, __all__ = public_names(__name__, __file__)
