"""Digests of the code that a stored result depends on, in this distribution and in the library."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Final

from smooth_operator.result_cache import code_digest

HOME: Final = Path(__file__).resolve().parent
"""Folder of this package."""


@cache
def research_digest(*names: str) -> str:
    """Digest of files and folders of this package and of ``smooth_operator``.

    Args:
        names: paths relative to this package, or, if it has no such file, to ``smooth_operator``.

    Returns:
        The digest, hexadecimal.
    """
    own = [name for name in names if (HOME / name).exists()]
    return code_digest(*own, home=HOME) + code_digest(*(n for n in names if n not in own))
