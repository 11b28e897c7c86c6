"""Class for ``map_batches`` of Ray Data that turns batches of human clips into episodes."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from smooth_operator.datasets.clip import RobotClip
from smooth_operator.datasets.quality import Dropped, select
from smooth_operator.datasets.request import NO_LIMITS, Limits
from smooth_operator.datasets.retargeting import Recipe, retarget_clips
from smooth_operator.datasets.sources import Item
from smooth_operator.datasets.store import ReadClip, as_stored
from smooth_operator.datasets.work import read_item
from smooth_operator.datasets.writers.parquet import clips_table
from smooth_operator.episode_files.packed import clip_of_row
from smooth_operator.errors import RecordingError
from smooth_operator.execution import checked
from smooth_operator.formats.clip import Clip, ClipRef, Frame, ReadingOptions
from smooth_operator.parallel.tasks import describe, one_thread
from smooth_operator.planning import make_request
from smooth_operator.result_cache import key_digest
from smooth_operator.types import Side


class RetargetClips:
    """Retargets batches of clips; builds and compiles the retargeters once in each actor.

    A row is a clip. It contains either the clip's arrays, in the columns of the format ``parquet``
    (``name``, ``stamps``, ``right_landmarks`` and ``left_landmarks``, and others if known), or a
    reference: ``path`` and ``layout`` (name of a reader), and ``key`` if the file contains several
    clips. The result has the columns of the format ``parquet``, so that the reader of this format
    can read the files of ``write_parquet``, and three more:

    - ``clip``: name of the clip from which the episode was made; a clip may be cut into several.
    - ``kept``: whether the episode is within the limits of quality.
    - ``reason``: why it was not kept, or why the clip failed.

    An episode that is not kept has null arrays. If a clip raises an exception, it becomes the
    clip's ``reason`` and does not affect other clips.

        Example::

            import ray
            from smooth_operator.datasets.map_batches import RetargetClips

            episodes = (
                ray.data.read_parquet("clips/")
                .map_batches(
                    RetargetClips,
                    fn_constructor_kwargs={"hand": "leap_hand", "method": "smooth"},
                    batch_format="pyarrow",
                    batch_size=16,
                    compute=ray.data.ActorPoolStrategy(min_size=2, max_size=64),
                    num_cpus=1,
                )
                .filter(expr="kept")
            )
            episodes.write_parquet("episodes/")

        Args:
            limits: limits of quality, as arguments of ``Limits``; None keeps every clip whole.
            reading: options of the readers of references.
            frame: frame of the wrists, ``world`` or ``camera``; None for each clip's own frame.
            side: retarget this hand only.
            request: hand, method, preset and so on, as arguments of ``planning.make_request``.

        Raises:
            SmoothOperatorError: there is no such hand, method or preset, or a limit is not valid.
    """

    def __init__(
        self,
        *,
        limits: Mapping[str, Any] | None = None,
        reading: ReadingOptions | None = None,
        frame: Frame | None = None,
        side: Side | None = None,
        **request: Any,
    ) -> None:
        with one_thread(os.getpid()) as start_threads:
            reading = reading or ReadingOptions()
            resolved = make_request(**request, side=side or reading.side, rate=reading.rate)
            self._recipe = Recipe(
                checked(resolved), frame, mano=reading.mano, objects=reading.objects
            )
            self._limits = NO_LIMITS if limits is None else Limits(**limits)
            start_threads()

    def __call__(self, batch: Any) -> Any:
        """Retargets some clips and returns their episodes.

        Args:
            batch: an Arrow table (``batch_format="pyarrow"``).

        Returns:
            an Arrow table.
        """
        results: list[tuple[int, str, RobotClip | str]] = []
        read: list[tuple[int, str, ReadClip]] = []
        for row in range(batch.num_rows):
            name = str(row)
            try:
                name, clips = self._read(batch, row)
                read += [(row, name, each) for each in clips]
            except Exception as error:  # of one row: a damaged file, a foreign reader
                results.append((row, name, describe(error)))
        answers = retarget_clips(
            [each.clip for _, _, each in read],
            self._recipe,
            [each.files for _, _, each in read],
            [each.key for _, _, each in read],
        )
        for (row, name, _), answer in zip(read, answers, strict=True):
            if isinstance(answer, RobotClip):
                whole = as_stored(answer)  # so that figures are those of the pipeline
                results += [(row, name, _judged(each)) for each in select(whole, self._limits)]
            else:
                results.append((row, name, describe(answer)))
        results.sort(key=lambda each: each[0])
        return _table([name for _, name, _ in results], [each for _, _, each in results])

    def _read(self, batch: Any, row: int) -> tuple[str, list[ReadClip]]:
        columns = batch.column_names
        if "stamps" in columns:
            clip: Clip = clip_of_row(batch, row)
            return clip.name, [
                ReadClip(
                    Item(clip.name),
                    clip,
                    (),
                    key_digest([self._recipe.digest, clip.name, _content(clip)]),
                )
            ]
        if not {"path", "layout"} <= set(columns):
            raise RecordingError(
                "a row needs 'stamps' and landmarks, or 'path' and 'layout'; it has "
                f"{', '.join(columns)}"
            )
        values = {
            name: batch.column(name)[row].as_py()
            for name in ("path", "layout", "key", "name")
            if name in columns
        }
        path = Path(values["path"])
        name = values.get("name") or path.stem
        ref = ClipRef(name, path, values.get("key") or "", values["layout"])
        return name, list(read_item(Item(name, ref, layout=ref.layout), self._recipe))


def _judged(episode: RobotClip | Dropped) -> RobotClip | str:
    """Returns an episode, or the reason why it is not kept."""
    if isinstance(episode, RobotClip):
        return episode
    return "; ".join(f"{limit}: {value}" for limit, value in episode.reasons.items())


def _content(clip: Clip) -> str:
    """Digest of a clip's hands, for a clip that has no file."""
    content = hashlib.sha256(clip.stamps.tobytes())
    for side, hand in sorted(clip.hands.items()):
        content.update(side.encode() + hand.landmarks.tobytes())
        if hand.T_world_wrist is not None:
            content.update(hand.T_world_wrist.tobytes())
    return content.hexdigest()


def _table(names: list[str], rows: list[RobotClip | str]) -> Any:
    import pyarrow as pa

    episodes = [row for row in rows if isinstance(row, RobotClip)]
    # Rows without an episode take null from every column: an index that is null.
    order = iter(range(len(episodes)))
    index = [next(order) if isinstance(row, RobotClip) else None for row in rows]
    table = clips_table(episodes).take(pa.array(index, pa.int64()))
    more = {
        "clip": pa.array(names, pa.string()),
        "kept": pa.array([isinstance(row, RobotClip) for row in rows], pa.bool_()),
        "reason": pa.array(["" if isinstance(r, RobotClip) else r for r in rows], pa.string()),
    }
    for name, column in more.items():
        table = table.append_column(name, column)
    return table
