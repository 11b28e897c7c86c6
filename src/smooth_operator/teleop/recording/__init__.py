"""Reads and writes recordings of the live loop (MCAP logs), and converts them to other formats."""

from smooth_operator.lazy_names import public_names

__getattr__, __dir__, __all__ = public_names(__name__, __file__)
