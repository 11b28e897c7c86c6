"""Computes digests of the code on which a result depends."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Final

HOME: Final = Path(__file__).resolve().parent
"""Folder of this package."""


@cache
def code_digest(
    *names: str, home: Path = HOME, content: Callable[[Path], bytes] = Path.read_bytes
) -> str:
    """SHA-256 digest of the names and contents of some files and folders of this package.

    Args:
        names: paths relative to ``home``; a folder stands for all files below it, data included.
        content: reads what counts of a file.

    Returns:
        the digest, hexadecimal.

    Raises:
        FileNotFoundError: a path does not exist; perhaps the code has moved.
    """
    total = hashlib.sha256()
    for name in names:
        path = home / name
        if not path.exists():
            raise FileNotFoundError(
                f"{name!r} is not in the package {home.name!r}; if it has moved, name its new place"
            )
        for file in sorted(path.rglob("*")) if path.is_dir() else [path]:
            if file.is_file() and file.suffix != ".pyc":
                total.update(file.relative_to(home).as_posix().encode() + b"\0" + content(file))
    return total.hexdigest()
