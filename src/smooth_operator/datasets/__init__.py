"""Data sets of human hands into episodes of robot hands: readers, retargeting, filters, writers."""

from smooth_operator.lazy_names import public_names

__getattr__, __dir__, __all__ = public_names(__name__, __file__)
