"""Limits on the unpacked size of a file: a small file must not fill the memory.

Deflate, gzip and Zstandard make thousands of bytes of one, an HDF5 array that was never written
needs none, and NumPy's text of no characters has no size at all. What a file says that it holds is
therefore compared with its own size, before anything is unpacked. Recordings stay far below: noisy
figures shrink to a half or a third, and an uncompressed file of any length passes.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from smooth_operator.errors import RecordingError

FREE_BYTES: Final = 32 << 20
"""Unpacked size that any file may have [bytes]: 10 minutes of landmarks at 100 Hz."""

ARRAYS_RATIO: Final = 16
"""Largest size of arrays in memory, as a multiple of the size of the file."""

LOG_RATIO: Final = 64
"""The same for the text of a log, which repeats itself more."""

NUMBER_BYTES: Final = 8
"""Least bytes that an element counts: every number is read as float64."""

TEXT_BYTES: Final = 64
"""Least bytes that a text counts, in addition to its characters."""


class TooLargeError(RecordingError):
    """A file would unpack to more than is allowed for its size."""


@dataclass
class Allowance:
    """Bytes that may still be unpacked of one file.

    Attributes:
        path: the file, for messages.
        most: bytes in all.
        used: bytes of each part so far, and
        total: sum over all files.
    """

    path: Path
    most: int
    used: dict[str, int] = field(default_factory=dict)
    total: int = 0

    @classmethod
    def of(cls, path: Path, size: int, ratio: int = ARRAYS_RATIO) -> Allowance:
        """Allowance of a file of some size [bytes]."""
        return cls(path, max(FREE_BYTES, ratio * size))

    def take(self, part: str, count: int) -> None:
        """Counts a part of some bytes before it is unpacked; one that is unpacked again counts
        once.

        Raises:
            TooLargeError: that would be more than is allowed.
        """
        total = self.total - self.used.get(part, 0) + count
        if total > self.most:
            raise TooLargeError(
                f"{self.path}: it would take {_size(total)} of memory to read {part[:80]!r}, more "
                f"than the {_size(self.most)} allowed for a file of this size; if the file is "
                "right, save it without compression, or in parts"
            )
        self.used[part], self.total = count, total


def _size(count: int) -> str:
    return f"{count / 1e6:,.0f} MB" if count < 10**15 else "more than 10^9 MB"
