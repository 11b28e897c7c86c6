"""What a worker does to clips: read, retarget, filter, write. It keeps compiled retargeters."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from smooth_operator.compilation.start import dispatch_here
from smooth_operator.errors import SmoothOperatorError
from smooth_operator.lab.datasets.clip import SIDES
from smooth_operator.lab.datasets.filters import NO_LIMITS, Dropped, Limits, select
from smooth_operator.lab.datasets.retargeting import Recipe, retarget_clips
from smooth_operator.lab.datasets.robot_clip import RobotClip
from smooth_operator.lab.datasets.sources import Item
from smooth_operator.lab.datasets.work import ReadClip, read_item
from smooth_operator.lab.datasets.writers.registry import WRITERS, DatasetWriter, WritingOptions
from smooth_operator.lab.offline.jobs import checked
from smooth_operator.lab.ray.settings import CorpusRun, CorpusSettings
from smooth_operator.planning import make_request
from smooth_operator.types import as_side


class ClipWork:
    """The four steps, for the settings of a run.

    Args:
        settings: of the run.

    Attributes:
        recipe: what the commands depend on.

    Raises:
        SmoothOperatorError: there is no such hand, method, layout or format; a limit is none.
    """

    def __init__(self, settings: CorpusSettings) -> None:
        dispatch_here()
        self._settings = settings
        side = None if settings.side is None else as_side(settings.side)
        frame: Any = settings.frame
        request = checked(make_request(**settings.request))
        self.recipe = Recipe(request, settings.reading, frame, side)
        self._joints = {
            each: request.load_hand(each).joint_names
            for each in (SIDES if side is None else (side,))
        }
        self._limits = NO_LIMITS if settings.limits is None else Limits(**settings.limits)
        self._format = WRITERS.load(settings.format)

    def read(self, item: Item) -> list[ReadClip]:
        """The clips of an item: one, but for files of object storage.

        Raises:
            SmoothOperatorError: as its reader.
        """
        return list(read_item(item, self.recipe))

    def retarget(self, read: Sequence[ReadClip]) -> list[RobotClip | SmoothOperatorError]:
        """The clips with the commands of their robot hands, whole and unfiltered."""
        clips, files, keys = zip(*((r.clip, r.files, r.key) for r in read), strict=True)
        return retarget_clips(clips, self.recipe, files, keys)

    def select(self, whole: RobotClip) -> Iterator[RobotClip | Dropped]:
        """The episodes of a clip, kept or dropped."""
        if not whole.commands:
            return iter((whole,))
        return select(whole, self._limits)

    def writer(self, run: CorpusRun, shard: int) -> DatasetWriter:
        """The writer of a shard's part of the output.

        Raises:
            SmoothOperatorError: as ``DatasetFormat.open``.
        """
        options = WritingOptions(
            **{"joints": self._joints, **self._settings.writing},
            part=shard,
            parts=run.shards,
            apart=True,
        )
        writer: DatasetWriter = self._format.open(run.output, options)
        return writer
