"""Calibration of an operator: finds pinches, by prompts or by search, and measures pinch gaps."""

from smooth_operator.lazy_names import public_names

__getattr__, __dir__, __all__ = public_names(__name__, __file__)
