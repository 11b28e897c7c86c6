"""Reading of files: documents within bounds, checks of landmarks.

Nothing here unpickles. The formats of recordings and commands are in ``smooth_operator.formats``.
"""
