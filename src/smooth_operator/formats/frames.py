"""Choosing frames of a recording by text, as the command line does."""

from __future__ import annotations

import re

from smooth_operator.errors import ConfigError

_RANGE = re.compile(r"\s*([+-]?\d+)?\s*:\s*([+-]?\d+)?\s*", re.ASCII)
_LONG = 10**12  # frames; longer than any recording


def frame_slice(text: str, length: int | None) -> slice:
    """Parse ``A:B`` with the meaning of a Python slice.

    ``:500`` is the first 500 frames, ``2600:3100`` the frames 2600 .. 3099, ``-500:`` the last 500;
    an end beyond the recording means its end.

    Args:
        text: the range.
        length: number of frames in the recording; None before it is read, for a check of the text.

    Returns:
        ``slice(start, stop)`` with 0 <= start < stop <= length.

    Raises:
        ConfigError: if the text is no range, or the range holds no frame.
    """
    match = _RANGE.fullmatch(text)
    if match is None:
        raise ConfigError(
            f"frames must be a range A:B of whole numbers, such as ':500', '2600:3100' or '-500:', "
            f"not {text!r}{_hint(text)}"
        )
    start, stop = (None if part is None else int(part) for part in match.groups())
    first, last, _ = slice(start, stop).indices(_LONG if length is None else length)
    if first >= last:
        reason = (
            "A:B ends before frame B, which must be after A"
            if length is None
            else f"the recording has {length} frames, 0 to {length - 1}"
            if length
            else "the recording is empty"
        )
        raise ConfigError(f"frames {text!r} selects nothing: {reason}")
    return slice(first, last)


def _hint(text: str) -> str:
    if re.fullmatch(r"\s*\d+\s*", text, re.ASCII):
        number = int(text)
        return f"; the one frame {number} is '{number}:{number + 1}'"
    if text.count(":") > 1:
        return "; a step is not supported"
    return ""
