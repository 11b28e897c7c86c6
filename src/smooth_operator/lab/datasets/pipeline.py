"""Data sets of human hands into data sets of robot hands: read, retarget, filter, write.

    from smooth_operator.lab.datasets.pipeline import DatasetRequest, make_dataset
    from smooth_operator.lab.datasets.retargeting import Recipe
    from smooth_operator.planning import make_request

    asked = DatasetRequest(("egodex/",), Path("out"), Recipe(make_request(hand="leap_hand")))
    summary = make_dataset(asked)

In the folder of results, ``dataset`` is the data set, ``report.json``, ``report.html`` and
``episodes.jsonl`` say what was kept and dropped and why, and ``work`` holds the retargeted clips,
from which a later run goes on. Other limits or another format retarget nothing a second time.
"""

from __future__ import annotations

import contextlib
from collections.abc import Generator, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from smooth_operator.errors import OutputError, RecordingError
from smooth_operator.lab.datasets.filters import Limits
from smooth_operator.lab.datasets.retargeting import Recipe, SourceFile
from smooth_operator.lab.datasets.sources import Found, Item, find_items, in_shard
from smooth_operator.lab.datasets.store import Kept, Store, clear_unfinished
from smooth_operator.lab.datasets.work import Entry, Job, do_job, unchanged
from smooth_operator.lab.datasets.writers.registry import WritingOptions
from smooth_operator.lab.datasets.writing import Order, Summary, write_episodes
from smooth_operator.lab.offline.finished import claimed
from smooth_operator.lab.offline.jobs import checked
from smooth_operator.parallel import run_tasks, usable_cores

WORK: Final = "work"
"""Folder with the retargeted clips, in the folder of results."""

_MOST_ITEMS: Final = 64  # in a pack
_FEW_ITEMS: Final = 8
_MOST_BYTES: Final = 256_000_000  # that a worker reads for a pack, unless one file has more
_SHARE: Final = 50  # packs a worker makes at least, so that a killed run loses 2 % at most


@dataclass(frozen=True)
class DatasetRequest:
    """What is to be made of what.

    Attributes:
        sources: folders, files, patterns, lists of paths (``.txt``, ``.csv``, ``.jsonl``) and
            addresses of object storage.
        output: folder of the results.
        recipe: what is done to each clip.
        layout: name of the reader; None for the one that recognises each file.
        limits: which episodes are good enough.
        format: name of the output format, of ``WRITERS``.
        writing: settings of that format; the joints of the hand are filled in.
        shard: (i, n) for the i-th of n runs that share the work, from 1; it retargets its items and
            writes no data set.
        merge: retarget nothing; write the data set from what other runs have finished.
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
    workers: int | None = None
    cluster: str | None = None


class Progress:
    """Is called as the work goes on; does nothing. Derive from it to show progress."""

    def looked(self, found: Found, items: int, kept: int) -> None:
        """After the search: how many items are to be done in all, and how many are done already."""

    def retargeted(self, entries: Sequence[Entry]) -> None:
        """After each pack."""

    def written(self, done: int, count: int) -> None:
        """While the data set is written: items, of so many."""


def make_dataset(asked: DatasetRequest, progress: Progress | None = None) -> Summary:
    """Makes a data set, or the share of one that a shard is; goes on where a run was stopped.

    The result depends on the sources and the request alone, not on the number of workers, nor on
    what was stopped or killed before. A clip that can't be read or retargeted is reported, and the
    others go on.

    Args:
        asked: what to do.
        progress: is called as the work goes on.

    Returns:
        what was kept, dropped and failed; ``report.json`` in the folder has it too.

    Raises:
        SmoothOperatorError: nothing can be made at all: the hand, the method, a source, the folder.
    """
    progress = Progress() if progress is None else progress
    checked(asked.recipe.request)
    check_output(asked)
    found = find_items(asked.sources, layout=asked.layout, leave_out=asked.output)
    if not found.items and not found.refused:
        kinds = ", ".join(f"{count} {suffix}" for suffix, count in found.passed_over.items())
        raise RecordingError(
            f"nothing to retarget in {', '.join(asked.sources)}"
            + (f": no layout knows its files ({kinds})" if kinds else ": it is empty")
        )
    work = asked.output / WORK / asked.recipe.digest[:16]
    own = work if asked.shard is None else work / "shard-{:05d}-of-{:05d}".format(*asked.shard)
    own.mkdir(parents=True, exist_ok=True)
    with claimed(own):
        clear_unfinished(own)
        items = [item for item in found.items if in_shard(item, asked.shard)]
        kept = _finished(Store(work), items)
        progress.looked(found, len(items), len(kept))
        left = [item for item in items if item.name not in kept]
        reasons: dict[str, str] = {refused.name: refused.reason for refused in found.refused}
        if asked.merge:
            missing = "no run has finished it yet; leave out --merge to retarget it now"
            reasons |= {item.name: missing for item in left}
        else:
            with contextlib.closing(_retargeted(left, own, asked, progress)) as entries:
                for entry in entries:  # whatever happens here, the workers end
                    if entry.kept is None:
                        reasons[entry.item] = entry.reason or "no clip is in it"
                    else:
                        kept[entry.item] = entry.kept
        if asked.shard is not None:
            return Summary.of_shard(asked.output, asked.shard, kept, reasons)
        names = [item.name for item in items if item.name in kept]
        order = Order(
            asked.output,
            [(name, kept[name]) for name in names],
            asked.recipe,
            asked.limits,
            asked.format,
            asked.writing,
        )
        return write_episodes(order, Store(work), reasons, found.passed_over, progress.written)


def check_output(asked: DatasetRequest) -> None:
    """Looks whether the results would stand among the sources.

    Raises:
        OutputError: they would, or a file stands in their place.
    """
    if asked.output.exists() and not asked.output.is_dir():
        raise OutputError(
            f"can't write into {str(asked.output)!r}: a file stands there; name a folder"
        )
    real = asked.output.resolve()
    for source in asked.sources:
        path = Path(source).expanduser()
        if path.is_dir() and path.resolve() == real:
            raise OutputError(
                f"can't write into {str(asked.output)!r}: it is a source; give a separate folder"
            )


def _finished(store: Store, items: Sequence[Item]) -> dict[str, Kept]:
    """What earlier runs have done of the items, and need not be done again."""
    by_name = {item.name: item for item in items}

    def accept(name: str, asked: str, files: tuple[SourceFile, ...]) -> bool:
        item = by_name.get(name)
        return item is not None and item.asked == asked and unchanged(item, files)

    return store.find(accept)


def _retargeted(
    items: Sequence[Item], folder: Path, asked: DatasetRequest, progress: Progress
) -> Generator[Entry]:
    """Entries of all items; those of a worker that died are tried once more, each alone."""
    jobs = list(_jobs(items, folder, asked))
    alone: list[Item] = []
    for job, entries, error in _run(jobs, asked, retries=1):
        if entries is None and len(job.items) > 1:
            alone += job.items
            continue
        done = entries or [Entry(item.name, None, error) for item in job.items]
        progress.retargeted(done)
        yield from done
    single = [Job((item,), asked.recipe, folder) for item in alone]
    for job, entries, error in _run(single, asked, retries=0):
        done = entries or [Entry(item.name, None, error) for item in job.items]
        progress.retargeted(done)
        yield from done


def _jobs(items: Sequence[Item], folder: Path, asked: DatasetRequest) -> Iterator[Job]:
    """Items of neighbouring names in packs, small enough for all workers to have some."""
    workers = asked.workers or usable_cores()
    share = -(-len(items) // max(workers, 1))
    count = max(min(_FEW_ITEMS, share), min(_MOST_ITEMS, len(items) // (workers * _SHARE)), 1)
    now: list[Item] = []
    size = 0
    for item in items:
        if now and (len(now) == count or size + item.size > _MOST_BYTES):
            yield Job(tuple(now), asked.recipe, folder)
            now, size = [], 0
        now.append(item)
        size += item.size
    if now:
        yield Job(tuple(now), asked.recipe, folder)


def _run(
    jobs: Sequence[Job], asked: DatasetRequest, retries: int
) -> Iterator[tuple[Job, list[Entry] | None, str | None]]:
    """Each job with its entries, or with why there are none."""
    if not jobs:
        return
    running = run_tasks(do_job, jobs, workers=asked.workers, cluster=asked.cluster, retries=retries)
    with contextlib.closing(running) as results:  # type: ignore[type-var]
        for result in results:
            if result.error is not None and result.error.startswith(OutputError.__name__):
                raise OutputError(result.error.partition(": ")[2])  # no space: nothing would go on
            yield jobs[result.index], result.value, result.error
