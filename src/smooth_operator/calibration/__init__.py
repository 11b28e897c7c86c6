"""Calibration of an operator: poses by prompt or by search, and the profile that follows."""

from smooth_operator.lazy_names import public_names

__getattr__, __dir__, __all__ = public_names(__name__, __file__)
