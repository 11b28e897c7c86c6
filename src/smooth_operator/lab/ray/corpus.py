"""A corpus of clips into a data set of robot episodes: read, retarget, filter, write, on Ray Data.

The list of clips is cut into shards. A shard is one task: its worker reads, retargets, filters, and
writes its own part of the output. So no array passes through the driver or the object store,
whatever dies costs a few clips, and the driver knows numbers alone.
"""

from __future__ import annotations

import contextlib
import json
import time
from collections.abc import Callable, Generator, Iterable
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from smooth_operator.atomic_files import atomic_write, claimed, output_error, write_json
from smooth_operator.errors import ConfigError, DocumentError, OutputError, WorkerError
from smooth_operator.formats.jsonable import to_json
from smooth_operator.io.documents import read_json
from smooth_operator.lab.datasets.sources import Item
from smooth_operator.lab.ray.manifest import write_manifest
from smooth_operator.lab.ray.settings import CorpusRun, CorpusSettings, run_digest, state_folder
from smooth_operator.lab.ray.shards import ShardReport, ShardWorker, read_report
from smooth_operator.parallel import run_tasks
from smooth_operator.parallel.cluster import run_on_cluster


@dataclass
class Progress:
    """How far a run is.

    Attributes:
        clips: of the corpus.
        done: clips of shards that are whole.
        kept: those of them that an earlier run had finished.
        shards: of the corpus.
        shards_done: shards that are whole.
        elapsed_s: since the first worker could begin [s].
        last: report of the last shard.
    """

    clips: int
    shards: int
    done: int = 0
    kept: int = 0
    shards_done: int = 0
    elapsed_s: float = 0.0
    last: ShardReport | None = None

    @property
    def left_s(self) -> float | None:
        """Time until the end at the pace so far [s]; None while there is none."""
        since_start = self.done - self.kept
        return self.elapsed_s / since_start * (self.clips - self.done) if since_start else None


def retarget_corpus(
    items: Iterable[Item],
    output: Path,
    settings: CorpusSettings,
    *,
    workers: int | None = None,
    least_workers: int | None = None,
    cluster: str | None = "local",
    gpus: float = 0.0,
    progress: Callable[[Progress], None] | None = None,
) -> dict[str, Any]:
    """Makes a data set, or finishes one that was begun with the same settings and clips.

    A clip that can't be read or retargeted, and one that a worker dies of, is named in
    ``report.jsonl`` with the reason; the others are not touched by it. The files of the data set
    depend on clips and settings alone: not on the number of workers, and not on what died.

    Args:
        items: the clips, as ``find_items`` lists them; their order is that of the output.
        output: folder of the data set; the run keeps its own files in ``.corpus`` in it.
        settings: what is done.
        workers: how many at most; None for as many as there are cores, or on a cluster CPUs.
        least_workers: a pool that begins with so many and grows to ``workers`` as work waits and
            the cluster has room; None for a pool of one size.
        cluster: ``"local"`` for a Ray started for this run, ``"auto"`` or an address for a running
            one; None for a pool of processes on this machine, without Ray.
        gpus: accelerators for each worker, which may be a fraction.
        progress: called after each shard.

    Returns:
        The summary, which is in ``summary.json`` too.

    Raises:
        ConfigError: there are no clips, or a number is not a possible one.
        OutputError: the folder holds something else, or a result can't be written.
        WorkerError: the cluster can't be reached, or a worker can't do what is asked for.
        MissingExtraError: Ray is not installed, or a library of the output format.
    """
    output = output.absolute()
    state = state_folder(output)
    try:
        (state / "shards").mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise output_error(state, error) from error
    with claimed(state):
        run, clips = _begin(items, output, settings)
        so_far = Progress(clips, run.shards)
        totals: dict[str, float] = {}
        began: float | None = None
        engine = _reports(run, workers, least_workers, cluster, gpus)
        with contextlib.closing(engine) as reports:
            for report in reports:
                if report.error:
                    raise WorkerError(report.error)
                now = time.perf_counter()
                began = now - report.busy_s if began is None else began
                _add(totals, report)
                so_far.done += report.clips
                so_far.kept += report.clips if report.kept else 0
                so_far.shards_done += 1
                so_far.elapsed_s = now - began
                so_far.last = report
                if progress is not None:
                    progress(so_far)
        return _end(run, totals)


def _begin(items: Iterable[Item], output: Path, settings: CorpusSettings) -> tuple[CorpusRun, int]:
    """Writes the list of clips, and refuses a folder that another run has begun."""
    state = state_folder(output)
    clips, listed = write_manifest(state / "clips", items, settings.clips_per_shard)
    if not clips:
        raise ConfigError("there are no clips to retarget; look at what the sources hold")
    document = settings.document()
    run = CorpusRun(
        output,
        settings,
        run_digest(document, listed),
        -(-clips // settings.clips_per_shard),
    )
    mark = state / "run.json"
    expected = json.loads(to_json({**document, "clips": clips, "list": listed}))
    try:
        stood = read_json(mark)
    except FileNotFoundError:
        write_json(mark, expected)
        return run, clips
    except (OSError, DocumentError) as error:
        raise OutputError(f"{mark}: can't be read ({error}); write to a new folder") from error
    for name in expected:
        if not isinstance(stood, dict) or stood.get(name) != expected[name]:
            what = "another list of clips" if name == "list" else f"another {name}"
            raise OutputError(
                f"can't write into {str(output)!r}: it was begun with {what}; go on with the same, "
                "or write to a new folder"
            )
    return run, clips


def _reports(
    run: CorpusRun, workers: int | None, least: int | None, cluster: str | None, gpus: float
) -> Generator[ShardReport, None, None]:
    tasks = [(run, shard) for shard in range(run.shards)]
    # A worker's death is counted clip by clip, in the shard's journal.
    retries = run.settings.attempts * run.settings.clips_per_shard
    if cluster is None:
        results = run_tasks(make_shard, tasks, workers=workers, retries=retries)
    else:
        results = run_on_cluster(
            make_shard, tasks, cluster,
            workers=workers, least_workers=least, gpus=gpus, retries=retries,
        )  # fmt: skip
    for result in results:
        if result.value is None:
            yield ShardReport(result.index, error=result.error or "no result")
        else:
            yield result.value


_workers: dict[tuple[str, str], ShardWorker] = {}


def make_shard(task: tuple[CorpusRun, int]) -> ShardReport:
    """One shard, in a process that keeps its worker."""
    run, shard = task
    name = (str(run.output), run.digest)
    worker = _workers.get(name)
    if worker is None:
        _workers.clear()
        worker = _workers[name] = ShardWorker(run)
    return worker.make(shard)


def _add(totals: dict[str, float], report: ShardReport) -> None:
    for each in fields(report):
        value = getattr(report, each.name)
        if each.name == "memory_mb":
            totals[each.name] = max(value, totals.get(each.name, 0.0))
        elif each.name == "kept":
            totals["kept_clips"] = totals.get("kept_clips", 0) + (report.clips if value else 0)
        elif isinstance(value, int | float) and each.name != "shard":
            totals[each.name] = totals.get(each.name, 0) + value


def _end(run: CorpusRun, totals: dict[str, float]) -> dict[str, Any]:
    """Writes the summary, and line by line what is not in the output, in the order of the list."""
    lost = 0
    with atomic_write(run.output / "report.jsonl") as file:
        for shard in range(run.shards):
            content = read_report(run, shard)
            if content is None:
                raise OutputError(f"{run.report(shard)}: it is gone; start the run again")
            for each in content["lost"]:
                file.write(json.dumps(each).encode() + b"\n")
                lost += 1
    counts = ("clips", "made", "dropped", "failed", "episodes", "frames", "hand_frames")
    summary: dict[str, Any] = {
        "program": "smooth-operator",
        "command": "corpus",
        "settings": run.settings.document(),
        **{name: int(totals.get(name, 0)) for name in counts},
        "lost": lost,
        "this_run": {
            name: value
            for name, value in totals.items()
            if name not in counts and name not in ("worker", "error")
        },
    }
    write_json(run.output / "summary.json", summary, indent=2)
    return summary
