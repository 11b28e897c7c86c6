"""Jobs for worker processes, which read clips, retarget them and write them to a pack (a file of
retargeted clips; see ``store``)."""

from __future__ import annotations

import faulthandler
import functools
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from multiprocessing import parent_process
from pathlib import Path

from smooth_hand_datasets.pipeline.clip import RobotClip
from smooth_hand_datasets.pipeline.retargeting import Recipe, SourceFile, clip_key, retarget_clips
from smooth_hand_datasets.pipeline.sources import Item, fetched
from smooth_hand_datasets.pipeline.store import ReadClip, Results, write_pack
from smooth_operator.errors import RecordingError, SmoothOperatorError
from smooth_operator.formats.checks import frame_slice
from smooth_operator.formats.clip import RATE, Clip, ClipRef, clip_part, with_side
from smooth_operator.formats.registry import find_reader, recognise
from smooth_operator.parallel.tasks import describe
from smooth_operator.result_cache import content_digest

_MOST_CLIPS = 1_000_000  # of one fetched file

READING_S = 300.0
"""Time limit for reading a clip in a worker [s], since a damaged file can make a library such as
libhdf5 hang."""


@dataclass(frozen=True)
class Job:
    """Items that one worker writes to one pack.

    Attributes:
        items: clips, or files to fetch.
        recipe: settings of the retargeting.
        folder: folder of the pack.
    """

    items: tuple[Item, ...]
    recipe: Recipe
    folder: Path


def do_job(job: Job) -> Results:
    """Reads, retargets and writes the clips of a job, in a worker.

    An item that can't be read or retargeted gets the reason as its result and does not stop others.

    Raises:
        OutputError: the pack can't be written.
    """
    return finish_job(job, *read_job(job))


def read_job(job: Job) -> tuple[list[ReadClip], dict[str, str]]:
    """Reads the clips of a job. An item that can't be read does not stop the others.

    Returns:
        the clips, in the order of the items; and name of item -> reason of its failure.
    """
    clips: list[ReadClip] = []
    reasons: dict[str, str] = {}
    for item in job.items:
        try:
            clips += read_item(item, job.recipe)
        except SmoothOperatorError as error:
            reasons[item.name] = str(error)
        except Exception as error:  # of a damaged file, or a plugin: anything; the others go on
            reasons[item.name] = describe(error)
    return clips, reasons


def finish_job(job: Job, clips: list[ReadClip], reasons: dict[str, str]) -> Results:
    """Retargets the clips of a job and writes them to a pack, without the items of clips that
    failed. Raises OutputError if the pack can't be written."""
    clips = [each for each in clips if each.item.name not in reasons]
    answers = retarget_clips(
        [each.clip for each in clips],
        job.recipe,
        [each.files for each in clips],
        [each.key for each in clips],
    )
    reasons = dict(reasons)
    items: dict[str, tuple[ReadClip, list[RobotClip]]] = {}
    for each, answer in zip(clips, answers, strict=True):
        if isinstance(answer, SmoothOperatorError):
            reasons[each.item.name] = str(answer)
        else:
            items.setdefault(each.item.name, (each, []))[1].append(answer)
    finished = [item for name, item in items.items() if name not in reasons]
    missing = {item.name: reasons.get(item.name, "it contains no clips") for item in job.items}
    return {**missing, **(write_pack(job.folder, finished) if finished else {})}


def unchanged(item: Item, files: Sequence[SourceFile]) -> bool:
    """True if the files of an item are unchanged: their dates are equal or, if not, their digests.

    Args:
        files: files that were read before.
    """
    if item.ref is None:
        return [(file.bytes, file.changed) for file in files] == [item.mark]
    for file in files:
        path = (item.root or Path()) / file.path
        try:
            stat = path.stat()
            same = str(stat.st_mtime_ns) == file.changed
            if stat.st_size != file.bytes or not (same or content_digest(path) == file.sha256):
                return False
        except OSError:
            return False
    return bool(files)


def read_item(item: Item, recipe: Recipe) -> Iterator[ReadClip]:
    """Yields the clips of an item; SmoothOperatorError if the item can't be read."""
    reading = recipe.reading(item.side, item.rate)
    if item.ref is not None:
        reader = find_reader(item.ref.layout)
        with _limited():
            clip = reader.read(item.ref, reading)
        if item.frames:
            clip = clip_part(clip, frame_slice(item.frames, len(clip)))
        yield _read_clip(item, item.ref, clip, item.name, recipe)
        return
    with ExitStack() as stack:
        path = stack.enter_context(fetched(item.address))
        recognised = recognise(path, item.layout)
        if recognised is None:
            raise RecordingError(
                f"{item.address}: no reader recognises this file; data with several files per clip "
                "must be copied to a local folder first"
            )
        layout, reader = recognised
        refs = sorted(replace(ref, layout=ref.layout or layout) for ref in reader.clips(path))
        for ref in refs[:_MOST_CLIPS]:
            stem = item.name.rsplit(".", 1)[0]
            name = stem if len(refs) == 1 else f"{stem}/{ref.name}"
            with _limited():
                clip = reader.read(ref, reading)
            yield _read_clip(item, ref, clip, name, recipe)


@contextmanager
def _limited() -> Iterator[None]:
    """Ends a worker of the pool after ``READING_S``, even in a library that never returns."""
    if parent_process() is None:  # the user's own process, or one of Ray's
        yield
        return
    faulthandler.dump_traceback_later(READING_S, exit=True)
    try:
        yield
    finally:
        faulthandler.cancel_dump_traceback_later()


def _read_clip(item: Item, ref: ClipRef, clip: Clip, name: str, recipe: Recipe) -> ReadClip:
    """Combines a clip with its name, its files and its key."""
    meshes = [track.mesh for track in clip.objects if recipe.with_objects and track.mesh]
    paths = [path for path in (*(clip.source or (ref.path,)), *meshes) if path.is_file()]
    if item.ref is None:
        size, changed = item.mark
        files = tuple(SourceFile(item.address, size, _file(p).sha256, changed) for p in paths[:1])
    else:
        files = tuple(replace(_file(path), path=_shown(path, item.root)) for path in paths)
    # The reader of plain recordings says whether it needed the rate.
    rate = clip.meta.get(RATE) if clip.layout == "files" else item.rate or recipe.request.rate
    key = clip_key(recipe, ref.layout, ref.key or name, item.settings_key, files, rate)
    task = clip.task if item.task is None else item.task
    clip = with_side(clip, item.side)
    clip = replace(clip, name=name, task=task, source=tuple(Path(file.path) for file in files))
    if item.ref is None:  # what it was read from is gone when the block ends
        clip = replace(clip, source=(), video=None)
    return ReadClip(item, clip, files, key, rate)


def _shown(path: Path, root: Path | None) -> str:
    """Path to store in a data set: relative to its source, with slashes; absolute if outside."""
    inside = root is not None and path.is_relative_to(root)
    return (path.relative_to(root) if inside and root is not None else path.resolve()).as_posix()


def _file(path: Path) -> SourceFile:
    stat = path.stat()
    return _digested(path, stat.st_size, stat.st_mtime_ns)


@functools.lru_cache(maxsize=16)
def _digested(path: Path, size: int, modified: int) -> SourceFile:
    """Identity of a file with its digest; cached, since a file may contain many clips."""
    return SourceFile(str(path), size, content_digest(path), str(modified))
