"""Makes data sets of robot hands from data sets of human hands: reads, retargets, filters, writes.

    from smooth_hand_datasets.pipeline import DatasetRequest, make_dataset

    request = DatasetRequest(sources=("egodex/",), output=Path("out"), hand="leap_hand")
    summary = make_dataset(request)

In the folder of results, ``dataset`` is the data set. ``report.json``, ``report.html`` and
``episodes.jsonl`` report kept and dropped episodes with reasons. ``work`` contains the retargeted
clips, from which a later run continues, so that other limits or formats need no new retargeting.
"""

from __future__ import annotations

import contextlib
import os
import shutil
from collections.abc import Generator, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

from smooth_hand_datasets.pipeline.groups import run_groups
from smooth_hand_datasets.pipeline.request import DatasetRequest as DatasetRequest
from smooth_hand_datasets.pipeline.retargeting import Recipe, SourceFile
from smooth_hand_datasets.pipeline.sources import Item, find_items, in_shard, parse_shard
from smooth_hand_datasets.pipeline.store import ReadClip, Result, Results, Store
from smooth_hand_datasets.pipeline.work import Job, do_job, finish_job, read_job, unchanged
from smooth_hand_datasets.pipeline.writers.npz import refused
from smooth_hand_datasets.pipeline.writers.registry import WRITERS, WritingOptions
from smooth_hand_datasets.pipeline.writing import REPORT, Order, Summary, hand_in, write_episodes
from smooth_operator.atomic_files import claimed, remove_leftovers
from smooth_operator.errors import ConfigError, OutputError, RecordingError, counted
from smooth_operator.execution import request_notes
from smooth_operator.formats.foreign import foreign_suffix
from smooth_operator.parallel import usable_cores
from smooth_operator.planning import RetargetRequest, read_configuration
from smooth_operator.reporter import Reporter

BATCH: Final = 2048
"""Number of hands that are retargeted together: two for each lane, so that short and long clips
balance."""

_BATCHES: Final = 2  # read and waiting, or retargeted and being written


def gpu_name() -> str:
    """Name of the first GPU that JAX sees; ConfigError if JAX sees no GPU."""
    import jax

    try:
        (device, *_) = jax.devices("gpu")
    except RuntimeError as error:
        raise ConfigError(
            f"--device gpu needs a GPU that JAX can use; JAX sees only {jax.devices()[0]} "
            "(`smooth-operator doctor` says why). To use the CPU, set --device cpu"
        ) from error
    return str(device.device_kind)


@contextlib.contextmanager
def only_cpus_in_children() -> Iterator[None]:
    """Makes processes that start inside the block use the CPU, even if JAX finds a GPU.

    JAX reads the environment variable when it is imported, so a process that uses a GPU itself must
    import JAX before.
    """
    before = os.environ.get("JAX_PLATFORMS")
    os.environ["JAX_PLATFORMS"] = "cpu"
    try:
        yield
    finally:
        if before is None:
            del os.environ["JAX_PLATFORMS"]
        else:
            os.environ["JAX_PLATFORMS"] = before


def results_of_gpu(jobs: Sequence[Job], **options: Any) -> Generator[Results]:
    """Yields the results of jobs. Workers read the clips; this process retargets ``BATCH`` hands at
    once on the GPU.

    While a thread retargets and packs a batch, the next batch is read. One process uses one GPU; to
    use several GPUs, start several runs, each with its ``CUDA_VISIBLE_DEVICES`` and its
    ``--shard``.

    Args:
        options: options of ``run_tasks``.

    Raises:
        OutputError: a pack can't be written.
    """

    def finish(waiting: list[tuple[Job, list[ReadClip], dict[str, str]]]) -> Results:
        job = replace(waiting[0][0], items=tuple(i for part, *_ in waiting for i in part.items))
        clips = [clip for _, read, _ in waiting for clip in read]
        reasons = {name: why for *_, own in waiting for name, why in own.items()}
        return finish_job(job, clips, reasons)

    with (
        ThreadPoolExecutor(1) as thread,
        contextlib.closing(run_groups(read_job, jobs, _alone, **options)) as results,
    ):
        batches: list[Future[Results]] = []
        waiting: list[tuple[Job, list[ReadClip], dict[str, str]]] = []
        hands = 0
        for job, result in results:
            if result.value is None:
                yield _lost(job, result.error)
                continue
            waiting.append((job, *result.value))
            hands += sum(len(each.clip.hands) for each in result.value[0])
            if hands >= BATCH:
                batches.append(thread.submit(finish, waiting))
                waiting, hands = [], 0
            if len(batches) >= _BATCHES:
                yield batches.pop(0).result()
        if waiting:
            batches.append(thread.submit(finish, waiting))
        for batch in batches:
            yield batch.result()


_MOST_ITEMS: Final = 64  # in a pack
_FEW_ITEMS: Final = 8
_MOST_BYTES: Final = 256_000_000  # read for a pack, unless one file has more
_SHARE: Final = 50  # packs a worker makes at least, so that a killed run loses 2 % at most


def make_dataset(
    request: DatasetRequest,
    reporter: Reporter | None = None,
    *,
    resolved: RetargetRequest | None = None,
    again: bool = False,
) -> Summary:
    """Makes a data set, or one shard of it. Continues where an earlier run was stopped.

    The result depends only on the sources and the request, not on the number of workers or on
    interruptions. A clip that can't be read or retargeted is reported and does not stop the others.

    Args:
        request: sources, robot hand, limits, format and output.
        reporter: shows the progress.
        resolved: request that replaces hand, method, settings and frames of ``request``, for
            example to use a hand description.
        again: True to also retarget clips that are already finished.

    Returns:
        numbers of kept, dropped and failed clips, with reasons, as in ``report.json``.

    Raises:
        SmoothOperatorError: the hand, the method, a source or the folder can't be used.
    """
    reporter = Reporter() if reporter is None else reporter
    shard = _checked_share(request)
    recipe = Recipe.of(request, resolved)
    writing = WritingOptions(
        rate=request.fps, videos=request.videos, shard_mb=request.shard_mb, loose=request.loose
    )
    check_output(request, recipe.request.hand_name)
    for note in request_notes(recipe.request):
        reporter.note(note, matters=True)
    survey = find_items(request.sources, layout=request.layout, leave_out=request.output)
    kinds = ", ".join(f"{count} {suffix}" for suffix, count in survey.passed_over.items())
    if not survey.items and not survey.refused:
        ways = [
            f"; a {suffix} file is {kind}"
            for suffix in survey.passed_over
            if (kind := foreign_suffix(suffix)) is not None
        ]
        raise RecordingError(
            f"nothing to retarget in {', '.join(request.sources)}"
            + (f": no reader recognises the files ({kinds})" if kinds else ": it is empty")
            + "".join(ways[:3])
        )
    if not survey.items:
        failures = "; ".join(f"{each.name}: {each.reason}" for each in survey.refused[:3])
        raise RecordingError(f"nothing to retarget; {failures}")
    name = recipe.digest[:16]
    on_gpu = recipe.device == "gpu" and not request.merge
    if on_gpu and request.cluster is not None:
        raise ConfigError(
            "a GPU can be used on this machine, but not on a cluster; for several GPUs start one "
            "run per GPU with --shard I/N, and run --merge at the end"
        )
    gpu = gpu_name() if on_gpu else None
    work = request.packs / name
    own = work if shard is None else work / "shard-{:05d}-of-{:05d}".format(*shard)
    own.mkdir(parents=True, exist_ok=True)
    with claimed(request.output if request.mirror else own):
        remove_leftovers([own, *(path for path in own.rglob("*") if path.is_dir())])
        part = recipe.request.frames or ""
        items = [
            replace(item, frames=item.frames or part)
            for item in survey.items
            if in_shard(item, shard)
        ]
        reasons: dict[str, str] = {each.name: each.reason for each in survey.refused}
        if request.mirror:
            remove_leftovers({(request.output / item.name).parent for item in items})
            reasons |= refused(items, request.output, REPORT)
            items = [item for item in items if item.name not in reasons]
        finished = {} if again else _finished(Store(work), items, recipe)
        before = len(finished)
        left = [item for item in items if item.name not in finished]
        line = f"{len(left)} to retarget, {before} already done"
        reporter.note(line + (f"; skipped (unknown format): {kinds}" if kinds else ""))
        there = [item for item in left if (request.output / f"{item.name}.npz").exists()]
        if request.mirror and there:
            reporter.note(
                f"making {counted(len(there), 'result')} again: the settings, the recording, the "
                "robot hand or the code changed",
                matters=True,
            )
        if request.merge:
            missing = "no run has finished this clip yet; run without --merge to retarget it now"
            reasons |= {item.name: missing for item in left}
        else:
            with (
                only_cpus_in_children(),
                contextlib.closing(
                    _retargeted(left, own, request, recipe, reporter, gpu)
                ) as entries,
            ):
                for each in entries:  # whatever happens here, the workers end
                    for item, result in each.items():
                        if isinstance(result, str):
                            reasons[item] = result
                        else:
                            finished[item] = result
        if shard is not None:
            frames = sum(each.frames for each in finished.values())
            failed = dict(sorted(reasons.items()))
            return Summary(request.output, shard, len(finished), frames, failed=failed)
        notes = [f"retargeted on {gpu}"] if gpu is not None and len(finished) > before else []
        if not request.merge:
            Store(work).remove_superseded(finished)
        shortest = getattr(WRITERS.load(request.format), "shortest", 2)
        for item, result in [*finished.items()]:
            if result.frames < shortest:
                reasons[item] = (
                    f"{item}: it has {result.frames} frames; at least {shortest} are needed"
                )
                del finished[item]
        names = [item.name for item in items if item.name in finished]
        summary = write_episodes(
            Order(
                request, recipe.request, writing, [(name, finished[name]) for name in names], work
            ),
            reasons,
            survey.passed_over,
            reporter,
            notes,
        )
        if request.mirror:  # the results of other settings and other code are replaced
            for other in request.packs.iterdir():
                if other.is_dir() and other != work:
                    shutil.rmtree(other, ignore_errors=True)
        return summary


def _checked_share(request: DatasetRequest) -> tuple[int, int] | None:
    """Checks the settings of a request, and returns its shard.

    Raises:
        ConfigError: settings are not valid, or contradict each other.
        MissingExtraError: the format needs an extra.
    """
    if not request.sources:
        raise ConfigError("name at least one SOURCE: a folder, a file, a pattern or a list")
    if request.shard is not None and request.merge:
        raise ConfigError(
            "--shard retargets a part of the data, but --merge only writes; give only one of them"
        )
    if request.workers is not None and request.workers < 0:
        raise ConfigError(f"workers must be 0 or more, not {request.workers}")
    WRITERS.load(request.format)  # before anything compiles
    return None if request.shard is None else parse_shard(request.shard)


def check_output(request: DatasetRequest, hand: str) -> None:
    """Checks that results can be written to a folder; OutputError if the folder is a source or a
    file, or contains the data set of another hand."""
    if request.output.exists() and not request.output.is_dir():
        raise OutputError(
            f"can't write into {str(request.output)!r}: it is a file; give the name of a folder"
        )
    real = request.output.resolve()
    for source in request.sources:
        path = Path(source).expanduser().resolve()
        if path.is_dir() and (path == real or (request.mirror and path.is_relative_to(real))):
            raise OutputError(
                f"can't write into {str(request.output)!r}: it contains the recordings; choose a "
                "separate folder for the results"
            )
    report = request.output / REPORT
    if report.exists() and read_configuration(report) is None:
        raise OutputError(
            f"can't write {str(report)!r}, the report of the run: another file has this name; "
            "choose another folder or remove it first"
        )
    earlier = hand_in(request.output)
    if earlier not in (None, hand):
        raise OutputError(
            f"can't write into {str(request.output)!r}: it contains the data set of {earlier}; "
            f"choose another folder for {hand} or remove it first"
        )


def _finished(store: Store, items: Sequence[Item], recipe: Recipe) -> dict[str, Result]:
    """Name of item -> result, for the items that earlier runs finished."""
    by_name = {item.name: item for item in items}
    usual = recipe.request.rate

    def accept(name: str, settings: str, files: tuple[SourceFile, ...], rate: float | None) -> bool:
        item = by_name.get(name)
        if item is None or item.settings_key != settings or rate not in (None, item.rate or usual):
            return False
        return unchanged(item, files)

    return store.find(accept)


def _retargeted(
    items: Sequence[Item],
    folder: Path,
    request: DatasetRequest,
    recipe: Recipe,
    reporter: Reporter,
    gpu: str | None,
) -> Generator[Results]:
    """Yields the results of all items. Items whose worker died are tried once more, each alone."""

    options: dict[str, Any] = {"workers": request.workers, "cluster": request.cluster, "retries": 1}
    jobs = list(_jobs(items, folder, recipe, request.workers))
    jobs.sort(key=lambda job: -sum(item.size for item in job.items))  # the longest first
    results_of = results_of_workers if gpu is None else results_of_gpu
    with (
        contextlib.closing(results_of(jobs, **options)) as packs,
        reporter.counting("", len(items), "clips", in_files=True) as advance,
    ):
        frames = failed = 0
        for done in packs:
            results = [each for each in done.values() if isinstance(each, Result)]
            frames += sum(each.frames for each in results)
            failed += len(done) - len(results)
            advance(len(done), extra=f"{frames} frames, {failed} failed")
            yield done


def results_of_workers(jobs: Sequence[Job], **options: Any) -> Generator[Results]:
    """Yields the results of jobs, whose clips workers read and retarget.

    Args:
        options: options of ``run_tasks``.

    Raises:
        OutputError: a pack can't be written.
    """
    with contextlib.closing(run_groups(do_job, jobs, _alone, **options)) as results:
        for job, result in results:
            if result.error is not None and result.error.startswith(OutputError.__name__):
                raise OutputError(result.error.partition(": ")[2])  # no space: nothing would go on
            yield result.value or _lost(job, result.error)


def _alone(job: Job) -> list[Job]:
    """The parts in which a job whose worker died is tried again."""
    return [replace(job, items=(item,)) for item in job.items]


def _lost(job: Job, error: str | None) -> Results:
    return {item.name: error or "it returned nothing" for item in job.items}


def _jobs(
    items: Sequence[Item], folder: Path, recipe: Recipe, workers: int | None
) -> Iterator[Job]:
    """Groups items with neighbouring names into jobs, small enough to keep all workers busy."""
    workers = workers or usable_cores()
    share = -(-len(items) // max(workers, 1))
    count = max(min(_FEW_ITEMS, share), min(_MOST_ITEMS, len(items) // (workers * _SHARE)), 1)
    now: list[Item] = []
    size = 0
    for item in items:
        if now and (len(now) == count or size + item.size > _MOST_BYTES):
            yield Job(tuple(now), recipe, folder)
            now, size = [], 0
        now.append(item)
        size += item.size
    if now:
        yield Job(tuple(now), recipe, folder)
