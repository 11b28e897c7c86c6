"""Data sets of human hands into data sets of robot hands: read, retarget, filter, write.

    from smooth_operator.lab.datasets.pipeline import DatasetRequest, make_dataset
    from smooth_operator.lab.datasets.retargeting import Recipe
    from smooth_operator.planning import make_request

    request = DatasetRequest(("egodex/",), Path("out"), Recipe(make_request(hand="leap_hand")))
    summary = make_dataset(request)

In the folder of results, ``dataset`` is the data set, ``report.json``, ``report.html`` and
``episodes.jsonl`` say what was kept and dropped and why, and ``work`` holds the retargeted clips,
from which a later run goes on. Other limits or another format retarget nothing a second time.
"""

from __future__ import annotations

import contextlib
from collections.abc import Generator, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final

from smooth_operator.errors import ConfigError, OutputError, RecordingError
from smooth_operator.lab.datasets.gpu import GpuUse, entries_of_gpu, only_cpus_in_children
from smooth_operator.lab.datasets.quality import Limits
from smooth_operator.lab.datasets.retargeting import Recipe, SourceFile
from smooth_operator.lab.datasets.sources import Found, Item, find_items, in_shard
from smooth_operator.lab.datasets.store import Kept, Store, clear_unfinished
from smooth_operator.lab.datasets.work import Entry, Job, do_job, unchanged
from smooth_operator.lab.datasets.writers.registry import WritingOptions
from smooth_operator.lab.datasets.writing import Order, Summary, hand_in, write_episodes
from smooth_operator.lab.offline.finished import claimed
from smooth_operator.lab.offline.folder import checked
from smooth_operator.parallel import run_groups, usable_cores

WORK: Final = "work"
"""Folder with the retargeted clips, in the folder of results."""

_MOST_ITEMS: Final = 64  # in a pack
_FEW_ITEMS: Final = 8
_MOST_BYTES: Final = 256_000_000  # read for a pack, unless one file has more
_SHARE: Final = 50  # packs a worker makes at least, so that a killed run loses 2 % at most


@dataclass(frozen=True)
class DatasetRequest:
    """Sources, recipe and output of a data set.

    Attributes:
        sources: folders, files, patterns, lists of paths (``.txt``, ``.csv``, ``.jsonl``) and
            addresses of object storage.
        output: folder of the results.
        recipe: hand, method and frame of each clip.
        layout: name of the reader; None for the one that recognises each file.
        limits: least quality of an episode.
        format: name of the output format, of ``WRITERS``.
        writing: settings of that format; the joints of the hand are filled in.
        shard: (i, n) for the i-th of n runs that share the work, from 1; it retargets its items and
            writes no data set.
        merge: retarget nothing; write the data set from what other runs have finished.
        pack: retarget nothing; write the human clips as they are, a source for later runs.
        workers: as in ``run_tasks``.
        cluster: as there.
    """

    sources: tuple[str, ...]
    output: Path
    recipe: Recipe
    layout: str | None = None
    limits: Limits = field(default_factory=Limits)
    format: str = "lerobot"
    writing: WritingOptions = field(default_factory=WritingOptions)
    shard: tuple[int, int] | None = None
    merge: bool = False
    pack: bool = False
    workers: int | None = None
    cluster: str | None = None


class Progress:
    """Receives the state of the work and does nothing; derive from it to show progress."""

    def looked(self, found: Found, items: int, kept: int) -> None:
        """Called after the search, with the number of items, and of those that are done already."""

    def retargeted(self, entries: Sequence[Entry]) -> None:
        """Called after each pack."""

    def written(self, done: int, count: int) -> None:
        """Called while the data set is written, with the number of items done, and of all."""


def make_dataset(request: DatasetRequest, progress: Progress | None = None) -> Summary:
    """Makes a data set, or the share of one that a shard is; goes on where a run was stopped.

    The result depends on the sources and the request alone, not on the number of workers, nor on
    what was stopped or killed before. A clip that can't be read or retargeted is reported, and the
    others go on.

    Args:
        request: sources, recipe and output.
        progress: receives the state of the work.

    Returns:
        counts and reasons of what was kept, dropped and failed, as in ``report.json``.

    Raises:
        SmoothOperatorError: nothing can be made at all: the hand, the method, a source, the folder.
    """
    progress = Progress() if progress is None else progress
    checked(request.recipe.request)
    check_output(request)
    survey = find_items(request.sources, layout=request.layout, leave_out=request.output)
    if not survey.items and not survey.refused:
        kinds = ", ".join(f"{count} {suffix}" for suffix, count in survey.passed_over.items())
        raise RecordingError(
            f"nothing to retarget in {', '.join(request.sources)}"
            + (f": no layout knows its files ({kinds})" if kinds else ": it is empty")
        )
    name = request.recipe.digest[:16]
    on_gpu = request.recipe.device == "gpu" and not (request.merge or request.pack)
    if on_gpu and request.cluster is not None:
        raise ConfigError(
            "a GPU retargets on this machine and not on a cluster; for several GPUs start one run "
            "a GPU with --shard I/N, and --merge at the end"
        )
    gpu = GpuUse.of_this_machine() if on_gpu else None
    work = request.output / WORK / (f"packed-{name}" if request.pack else name)
    own = work if request.shard is None else work / "shard-{:05d}-of-{:05d}".format(*request.shard)
    own.mkdir(parents=True, exist_ok=True)
    with claimed(own):
        clear_unfinished(own)
        items = [item for item in survey.items if in_shard(item, request.shard)]
        finished = _finished(Store(work), items)
        progress.looked(survey, len(items), len(finished))
        left = [item for item in items if item.name not in finished]
        reasons: dict[str, str] = {refused.name: refused.reason for refused in survey.refused}
        if request.merge:
            missing = "no run has finished it yet; leave out --merge to retarget it now"
            reasons |= {item.name: missing for item in left}
        else:
            with (
                only_cpus_in_children(),
                contextlib.closing(_retargeted(left, own, request, progress, gpu)) as entries,
            ):
                for entry in entries:  # whatever happens here, the workers end
                    if entry.kept is None:
                        reasons[entry.item] = entry.reason or "no clip is in it"
                    else:
                        finished[entry.item] = entry.kept
        if request.shard is not None:
            return Summary.of_shard(request.output, request.shard, finished, reasons)
        names = [item.name for item in items if item.name in finished]
        order = Order(
            request.output,
            [(name, finished[name]) for name in names],
            request.recipe,
            request.limits,
            request.format,
            request.writing,
            work,
        )
        return write_episodes(
            order,
            reasons,
            survey.passed_over,
            progress.written,
            [] if gpu is None or gpu.frames == 0 else [gpu.sentence()],
            workers=request.workers,
            cluster=request.cluster,
        )


def check_output(request: DatasetRequest) -> None:
    """Refuses a folder of results that is a source, a file, or has a data set of another hand.

    Raises:
        OutputError: with the folder.
    """
    if request.output.exists() and not request.output.is_dir():
        raise OutputError(
            f"can't write into {str(request.output)!r}: a file stands there; name a folder"
        )
    real = request.output.resolve()
    for source in request.sources:
        path = Path(source).expanduser()
        if path.is_dir() and path.resolve() == real:
            raise OutputError(
                f"can't write into {str(request.output)!r}: it is a source; give a separate folder"
            )
    hand, earlier = request.recipe.request.hand_name, hand_in(request.output)
    if earlier not in (None, hand):
        raise OutputError(
            f"can't write into {str(request.output)!r}: it has the data set of {earlier}; give "
            f"another folder for {hand}, or remove it first"
        )


def _finished(store: Store, items: Sequence[Item]) -> dict[str, Kept]:
    """Items that earlier runs have done, with the places of their clips."""
    by_name = {item.name: item for item in items}

    def accept(name: str, digest: str, files: tuple[SourceFile, ...]) -> bool:
        item = by_name.get(name)
        return item is not None and item.asked == digest and unchanged(item, files)

    return store.find(accept)


def _retargeted(
    items: Sequence[Item],
    folder: Path,
    request: DatasetRequest,
    progress: Progress,
    gpu: GpuUse | None,
) -> Generator[Entry]:
    """Entries of all items; those of a worker that died are tried once more, each alone."""

    def split(job: Job) -> list[Job]:
        return [replace(job, items=(item,)) for item in job.items]

    options: dict[str, Any] = {"workers": request.workers, "cluster": request.cluster, "retries": 1}
    jobs = list(_jobs(items, folder, request))
    if gpu is not None:
        for entries in entries_of_gpu(jobs, split, gpu, **options):
            progress.retargeted(entries)
            yield from entries
        return
    for job, result in run_groups(do_job, jobs, split, **options):
        if result.error is not None and result.error.startswith(OutputError.__name__):
            raise OutputError(result.error.partition(": ")[2])  # no space: nothing would go on
        entries = result.value or [Entry(item.name, None, result.error) for item in job.items]
        progress.retargeted(entries)
        yield from entries


def _jobs(items: Sequence[Item], folder: Path, request: DatasetRequest) -> Iterator[Job]:
    """Items of neighbouring names in packs, small enough for all workers to have some."""
    workers = request.workers or usable_cores()
    share = -(-len(items) // max(workers, 1))
    count = max(min(_FEW_ITEMS, share), min(_MOST_ITEMS, len(items) // (workers * _SHARE)), 1)
    now: list[Item] = []
    size = 0
    for item in items:
        if now and (len(now) == count or size + item.size > _MOST_BYTES):
            yield Job(tuple(now), request.recipe, folder, not request.pack)
            now, size = [], 0
        now.append(item)
        size += item.size
    if now:
        yield Job(tuple(now), request.recipe, folder, not request.pack)
