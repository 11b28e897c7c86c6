"""File formats of the live loop and its episodes: MCAP logs, HDF5 and LeRobot datasets."""

from smooth_operator.lazy_names import public_names

__getattr__, __dir__, __all__ = public_names(__name__, __file__)
