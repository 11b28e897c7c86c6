"""Readers of two hands that hang at one clip, or kill the process that first reads it."""

import os
import signal
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from two_hands import Pairs

from smooth_hand_datasets.pipeline import work
from smooth_operator.formats.clip import Clip, ClipRef, ReadingOptions

ODD_ONE = "00"
work.READING_S = 1.0  # the test waits twice as long


class Hanging(Pairs):
    """The clip ``ODD_ONE`` never comes."""

    def clips(self, path: Path) -> Iterator[ClipRef]:
        return (replace(ref, layout="hanging_clips:HANGING") for ref in super().clips(path))

    def read(self, ref: ClipRef, options: ReadingOptions) -> Clip:
        if ref.name == ODD_ONE:
            time.sleep(600.0)
        return super().read(ref, options)


class Fatal(Pairs):
    """The process that first reads the clip ``ODD_ONE`` is killed."""

    def clips(self, path: Path) -> Iterator[ClipRef]:
        return (replace(ref, layout="hanging_clips:FATAL") for ref in super().clips(path))

    def read(self, ref: ClipRef, options: ReadingOptions) -> Clip:
        mark = ref.path.with_name("killed")
        if ref.name == ODD_ONE and not mark.exists():
            mark.touch()
            os.kill(os.getpid(), signal.SIGKILL)
        return super().read(ref, options)


HANGING, FATAL = Hanging(), Fatal()
