"""Real robot hands, live trackers and ROS 2 for ``smooth_operator``: drivers, sinks and sources.

A separate distribution that adds sinks, sources and the command ``hardware`` to it.
"""

from smooth_operator.lazy_names import public_names

__getattr__, __dir__, __all__ = public_names(__name__, __file__)
