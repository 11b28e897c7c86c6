"""File formats of recordings, commands, episodes and arrays: readers, writers, their checks.

Reading dispatches on what a file holds, never on its name alone, and nothing here unpickles.
"""

from smooth_operator.lazy_names import public_names

__getattr__, __dir__, __all__ = public_names(__name__, __file__)
