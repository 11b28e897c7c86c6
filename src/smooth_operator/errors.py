"""Exceptions of this package; each message says what was expected, what was found, what to do.

All errors derive from ``SmoothOperatorError``, and from the matching built-in class, such as
``ValueError``, so that code that does not know this package can still catch them.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterable
from difflib import get_close_matches
from importlib.util import find_spec
from typing import Final

from smooth_operator.terminal import printable

__all__ = (
    "ConfigError",
    "HandModelError",
    "MissingExtraError",
    "OutputError",
    "RecordingError",
    "RemoteError",
    "RemoteRefusedError",
    "SinkError",
    "SmoothOperatorError",
    "SourceError",
    "StudyError",
    "UnknownNameError",
)
"""Public names; all other names are for use inside this package."""


class SmoothOperatorError(Exception):
    """Base of every error that this package raises on purpose; control characters from a file's
    text are escaped in its message."""

    def __str__(self) -> str:
        return printable(super().__str__())


class RecordingError(SmoothOperatorError, ValueError):
    """A recording can't be read as hand motion: wrong format, shape, units, side or stamps."""


class HandModelError(SmoothOperatorError, ValueError):
    """A robot hand model or its description can't be used."""


class ConfigError(SmoothOperatorError, ValueError):
    """A setting is outside its allowed range or contradicts another."""


class StudyError(SmoothOperatorError, ValueError):
    """The plan or the data of a user study can't be used, or are not sufficient for an analysis."""


class DocumentError(SmoothOperatorError, ValueError):
    """A JSON or TOML text is malformed, or exceeds the limits of the parser."""


class OutputError(SmoothOperatorError, OSError):
    """A result can't be written: no space, no permission, a folder where a file should be."""


class MissingExtraError(SmoothOperatorError, ImportError):
    """An optional library that a feature needs is not installed."""

    def __init__(self, feature: str, *extras: str) -> None:
        from smooth_operator.extras import install_command

        names = " and the extra ".join(map(repr, extras))
        super().__init__(f"{feature} needs the extra {names}: {install_command(','.join(extras))}")


def require(feature: str, extra: str, *libraries: str) -> None:
    """Checks that the libraries (top-level modules) of an extra are installed, without importing
    them; MissingExtraError if a library that ``feature`` needs is missing."""
    for name in libraries:
        if sys.modules.get(name) is None and find_spec(name) is None:
            raise MissingExtraError(feature, extra)


class SourceError(SmoothOperatorError, RuntimeError):
    """A live source of hand frames can't be opened, or has failed."""


class SinkError(SmoothOperatorError, RuntimeError):
    """A sink can't be opened, or can't take commands now."""


class RemoteError(SmoothOperatorError, RuntimeError):
    """A teleoperation in another process does not answer, or its answer can't be read."""


class RemoteRefusedError(RemoteError):
    """The other program reports that it can't do what was requested."""


class WorkerError(SmoothOperatorError, RuntimeError):
    """Worker processes can't be started, or a cluster can't be reached."""


class UnknownNameError(SmoothOperatorError, KeyError):
    """A name that is not in a catalogue (hand, method, preset, landmark, joint).

    Args:
        kind: kind of the name, such as ``"hand"``.
        name: unknown name.
        available: known names; a similar one is suggested.
        more: further advice, one sentence.
    """

    def __init__(self, kind: str, name: str, available: Iterable[str], more: str = "") -> None:
        name = name if len(name) <= 80 else f"{name[:77]}..."  # of a file, perhaps a damaged one
        names = sorted(available)
        hint = did_you_mean(name, names)
        self.message = f"unknown {kind} {name!r}.{hint} Available: {', '.join(names) or 'none'}."
        self.message += f" {more}" if more else ""
        super().__init__(self.message)

    def __str__(self) -> str:  # KeyError would print the repr of the message
        return printable(self.message)


def did_you_mean(name: str, names: Iterable[str]) -> str:
    """Suggests a similar name, as in `` Did you mean 'sbr'?``; empty if no name is similar.

    A name is similar if it contains the same words, such as ``brainco_revo2`` and ``revo2``, or has
    nearly the same letters.
    """
    bare = {one.lstrip("-"): one for one in names}  # the dashes of options are like any others
    words = _words(name)
    same = {one: _words(one) for one in bare}
    close = [one for one, own in same.items() if words and own and (words <= own or own <= words)]
    close = close or get_close_matches(name.lstrip("-"), bare, n=1)
    return f" Did you mean {' or '.join(repr(bare[one]) for one in close[:3])}?" if close else ""


def _words(name: str) -> set[str]:
    return {word for word in re.split(r"[^a-z0-9]+", name.lower()) if len(word) > 2}


_SHOWN: Final = 80


def brief(value: object, most: int = _SHOWN) -> str:
    """The ``repr`` of a value, shortened if it is too long for a message."""
    text = repr(value)
    return text if len(text) <= most else f"{text[: most - 3]}..."


def reason(error: object, most: int = 2 * _SHOWN) -> str:
    """Text of another library's error on one line, shortened to at most ``most`` characters."""
    text = " ".join(str(error).split())
    return text if len(text) <= most else f"{text[: most - 3]}..."


def listed(names: Iterable[object], most: int = 12) -> str:
    """Lists names for a message; only the first ones if there are many."""
    words = [str(name) for name in names]
    shown = [word if len(word) <= 40 else f"{word[:37]}..." for word in words[:most]]
    return ", ".join(shown) + (f" and {len(words) - most} more" if len(words) > most else "")


def counted(number: int, noun: str) -> str:
    """A number with its noun: ``1 frame``, ``2 frames``; for nouns with a regular plural."""
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"
