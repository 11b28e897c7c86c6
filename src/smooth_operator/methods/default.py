"""The method that is used where none is named.

It stands by itself, since options of the command line name it, and ``--help`` needs no JAX.
"""

from __future__ import annotations

from typing import Final

DEFAULT_METHOD: Final = "smooth"
"""With its default preset, the first of ``PRESETS``."""
