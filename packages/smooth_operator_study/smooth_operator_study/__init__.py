"""Plans, runs and analyses user studies of retargeters.

A separate distribution that uses ``smooth_operator`` and adds the command ``study`` to it.
"""

from smooth_operator.lazy_names import public_names

__getattr__, __dir__, __all__ = public_names(__name__, __file__)
