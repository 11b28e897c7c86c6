"""Objective of a retargeter: keyvectors, their targets, and Eq. (1)."""

from smooth_operator.lazy_names import public_names

__getattr__, __dir__, __all__ = public_names(__name__, __file__)
