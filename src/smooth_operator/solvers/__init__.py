"""Solvers: pure functions of an objective, a start and, where they sample, random words."""

from smooth_operator.lazy_names import public_names

__getattr__, __dir__, __all__ = public_names(__name__, __file__)
