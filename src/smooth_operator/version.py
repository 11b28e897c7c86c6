"""The version of the installed distribution."""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError, version
from typing import Final

from smooth_operator.extras import DISTRIBUTION


def package_version() -> str:
    """Version of the installed distribution; ``0+unknown`` in a source tree that is not
    installed."""
    try:
        return version(DISTRIBUTION)
    except PackageNotFoundError:
        return "0+unknown"


__version__: Final = package_version()
