"""Made clips of which one hangs its reader, with a short time for reading."""

import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from made_clips import MadeClips

from smooth_operator.datasets import work
from smooth_operator.formats.clip import Clip, ClipRef, ReadingOptions

LAYOUT = "hanging_clips:CLIPS"
work.READING_S = 10.0  # a busy machine takes over a second for the other clips


class HangingClips(MadeClips):
    """The third clip never comes."""

    def clips(self, path: Path) -> Iterator[ClipRef]:
        return (replace(ref, layout=LAYOUT) for ref in super().clips(path))

    def read(self, ref: ClipRef, options: ReadingOptions) -> Clip:
        if ref.key == "2":
            time.sleep(600.0)
        return super().read(ref, options)


CLIPS = HangingClips()
