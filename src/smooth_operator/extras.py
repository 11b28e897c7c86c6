"""Commands that install this program and its extras."""

from __future__ import annotations

import functools
from contextlib import suppress
from pathlib import Path
from typing import Final

DISTRIBUTION: Final = "smooth-retargeting"
"""Name of the distribution; ``smooth-operator`` on the package index is a different program."""

DEVICES: Final = "smooth-operator-devices"
"""Name of the distribution of real hands, trackers and ROS 2, which has extras of its own."""

DATA_SETS: Final = "smooth-hand-datasets"
"""Name of the distribution that makes data sets and reads research data sets."""

PART_OF_DATA_SETS: Final = (
    f"part of the distribution {DATA_SETS}, which is not installed; in a clone of the repository, "
    "run: python -m pip install . ./packages/smooth_hand_datasets"
)
"""Advice about a part of ``DATA_SETS``, for messages."""

UPGRADE: Final = "git pull && python -m pip install ."
"""Commands that update this program, in a clone."""


def install_command(extra: str) -> str:
    """Command that installs an extra of this distribution, of ``DEVICES`` or of ``DATA_SETS``: from
    the source folder if it was installed from one, otherwise by package name."""
    owner = _owner(extra)
    folder, options = _installed_from(owner)
    if folder is None:
        return f'python -m pip install "{owner}[{extra}]"'
    here = Path.cwd()
    if folder.is_relative_to(here):
        inside = folder.relative_to(here).as_posix()
        return (
            f'python -m pip install {options}"{"." if inside == "." else f"./{inside}"}[{extra}]"'
        )
    return f'python -m pip install {options}"{folder}[{extra}]"'


@functools.cache
def _owner(extra: str) -> str:
    """Distribution that has an extra."""
    from importlib.metadata import PackageNotFoundError, metadata

    for name in (DEVICES, DATA_SETS):
        with suppress(PackageNotFoundError):
            if extra in (metadata(name).get_all("Provides-Extra") or ()):
                return name
    return DISTRIBUTION


@functools.cache
def _installed_from(distribution_name: str) -> tuple[Path | None, str]:
    """Folder from which a distribution was installed (None for a wheel), and options of the install
    command."""
    import json  # here, for who misses something: these take 20 ms
    from importlib.metadata import PackageNotFoundError, distribution
    from urllib.parse import urlsplit
    from urllib.request import url2pathname

    try:
        origin = json.loads(distribution(distribution_name).read_text("direct_url.json") or "{}")
        folder = Path(url2pathname(urlsplit(origin["url"]).path))
        options = "-e " if origin["dir_info"].get("editable") else ""
    except PackageNotFoundError:  # run from a source tree that was never installed
        folder, options = Path(__file__).resolve().parents[2], ""
    except (ValueError, LookupError, TypeError, AttributeError):  # of a wheel, or unreadable
        return None, ""
    return (folder, options) if (folder / "pyproject.toml").is_file() else (None, "")
