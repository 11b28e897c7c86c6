"""Reading of JSON and TOML files within size limits, and checks of landmarks.

Nothing here unpickles. The formats of recordings and commands are in ``smooth_operator.formats``.
"""
