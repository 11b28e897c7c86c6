"""Recordings of one hand, in any format that ``retarget`` reads, as clips."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Final

from smooth_operator.formats.readers import rated_if_unstamped, read_recording
from smooth_operator.formats.registry import recording_suffixes
from smooth_operator.lab.datasets.clip import Clip
from smooth_operator.lab.datasets.registry import ClipRef, ReadingOptions


class Files:
    """One file, one hand, one clip."""

    what = "a recording of one hand"
    expects = "a file that 'smooth-operator retarget' reads"

    def matches(self, path: Path) -> bool:
        """True if it is a file whose name ends as those of recordings do."""
        return path.suffix.lower() in recording_suffixes() and path.is_file()

    def clips(self, path: Path) -> Iterator[ClipRef]:
        """The file."""
        yield ClipRef(path.stem, path, layout="files", size=path.stat().st_size)

    def read(self, ref: ClipRef, options: ReadingOptions) -> Clip:
        """Its hand.

        Raises:
            RecordingError: as ``read_recording``.
        """
        recording, _ = rated_if_unstamped(
            lambda rate: read_recording(ref.path, rate=rate, side=options.side), options.rate
        )
        return Clip(ref.name, {recording.side: recording}, "files", (ref.path,))


FILES: Final = Files()
