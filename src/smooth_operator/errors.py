"""One error family: every message says what was expected, what came, and what to do.

All errors derive from ``SmoothOperatorError``, so a caller can catch the family; the ones
that are about a value also derive from ``ValueError``, those about a missing thing from the
matching built-in, so that code which knows nothing of this package still catches them.
"""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches
from typing import Final

DISTRIBUTION: Final = "smooth-retargeting"
"""Name of the distribution; ``smooth-operator`` on the package index is another program."""

UPGRADE: Final = f"python -m pip install --upgrade {DISTRIBUTION}"
"""The command that brings a newer version of this program."""


class SmoothOperatorError(Exception):
    """Base of every error that this package raises on purpose."""


class RecordingError(SmoothOperatorError, ValueError):
    """A recording can't be read as hand motion: wrong format, shape, units, side or stamps."""


class HandModelError(SmoothOperatorError, ValueError):
    """A robot hand model or its description can't be used."""


class ConfigError(SmoothOperatorError, ValueError):
    """A setting is outside its allowed range or contradicts another."""


class StudyError(SmoothOperatorError, ValueError):
    """The plan or the data of a user study can't be used, or do not carry an analysis."""


class DocumentError(SmoothOperatorError, ValueError):
    """A JSON or TOML text is not one, or is beyond the bounds of what is parsed."""


class OutputError(SmoothOperatorError, OSError):
    """A result can't be written: no space, no permission, a folder where a file should be."""


class MissingExtraError(SmoothOperatorError, ImportError):
    """An optional dependency is not installed."""

    def __init__(self, feature: str, extra: str) -> None:
        super().__init__(
            f"{feature} needs the extra '{extra}': python -m pip install '{DISTRIBUTION}[{extra}]'"
        )


class SourceError(SmoothOperatorError, RuntimeError):
    """A live source of hand frames can't be opened, or gave up."""


class SinkError(SmoothOperatorError, RuntimeError):
    """A sink can't be opened, or can't take commands now."""


class RemoteError(SmoothOperatorError, RuntimeError):
    """A teleoperation that runs elsewhere does not answer, or its answer can't be read."""


class RemoteRefusedError(RemoteError):
    """It answers that it can't do what it was told."""


class WorkerError(SmoothOperatorError, RuntimeError):
    """Worker processes can't be started, or a cluster can't be reached."""


class UnknownNameError(SmoothOperatorError, KeyError):
    """A name that is not in a catalogue (hand, method, preset, landmark, joint).

    Args:
        kind: what was looked up, e.g. ``"hand"``.
        name: the name that came.
        available: the names that exist; a close one is suggested.
        more: what else may help, a sentence.
    """

    def __init__(self, kind: str, name: str, available: Iterable[str], more: str = "") -> None:
        name = name if len(name) <= 80 else f"{name[:77]}..."  # of a file, perhaps a damaged one
        known = sorted(available)
        bare = {one.lstrip("-"): one for one in known}  # the dashes of options are like any others
        close = get_close_matches(name.lstrip("-"), bare, n=1)
        hint = f" Did you mean {bare[close[0]]!r}?" if close else ""
        self.message = f"unknown {kind} {name!r}.{hint} Available: {', '.join(known) or 'none'}."
        self.message += f" {more}" if more else ""
        super().__init__(self.message)

    def __str__(self) -> str:  # KeyError would print the repr of the message
        return self.message


_SHOWN: Final = 80


def brief(value: object, most: int = _SHOWN) -> str:
    """The ``repr`` of a value, cut where it is too long for a message."""
    text = repr(value)
    return text if len(text) <= most else f"{text[: most - 3]}..."


def listed(names: Iterable[object], most: int = 12) -> str:
    """Names in a row for a message, the first ones where there are many."""
    words = [str(name) for name in names]
    shown = [word if len(word) <= 40 else f"{word[:37]}..." for word in words[:most]]
    return ", ".join(shown) + (f" and {len(words) - most} more" if len(words) > most else "")
