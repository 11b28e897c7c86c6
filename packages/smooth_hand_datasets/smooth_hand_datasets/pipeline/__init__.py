"""Converts data sets of human hands to episodes of robot hands: retargets, filters and writes."""

from smooth_operator.lazy_names import public_names

__getattr__, __dir__, __all__ = public_names(__name__, __file__)
