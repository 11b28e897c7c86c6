"""Reading of files: documents within bounds, checks of landmarks.

Nothing here unpickles. The formats of recordings and commands are in ``smooth_operator.formats``.
"""

from smooth_operator.moved_names import former_names

__getattr__ = former_names(__name__)
