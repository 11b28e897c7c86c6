"""File formats of recordings, commands, episodes and arrays: their readers, writers and checks.

A file's format is recognised by its content, never by its name alone. Nothing in this package
unpickles.
"""

from smooth_operator.lazy_names import public_names

__getattr__, __dir__, __all__ = public_names(__name__, __file__)
