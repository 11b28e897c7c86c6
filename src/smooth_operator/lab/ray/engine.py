"""Shards of a corpus on Ray Data: an actor pool that grows, and tries again what dies."""

from __future__ import annotations

import contextlib
import logging
import os
from collections.abc import Generator, Iterator
from dataclasses import asdict
from typing import Any, Final

import numpy as np

from smooth_operator.errors import ConfigError, MissingExtraError, WorkerError
from smooth_operator.lab.ray.settings import CorpusRun
from smooth_operator.lab.ray.shards import ShardReport, ShardWorker
from smooth_operator.parallel.cluster import connected
from smooth_operator.parallel.results import describe
from smooth_operator.parallel.threads import one_thread

_QUEUED: Final = 2
"""Shards that wait at a worker, the one that it works on included."""


def ray_data() -> Any:
    """Ray, with Ray Data.

    Raises:
        MissingExtraError: one is not installed.
    """
    try:
        import ray
        import ray.data
    except ImportError as error:
        raise MissingExtraError("a corpus on Ray", "cluster") from error
    return ray


class ShardActor:
    """A worker of the pool, as ``map_batches`` calls it: numbers of shards in, reports out.

    Args:
        run: the run.
    """

    def __init__(self, run: CorpusRun) -> None:
        with one_thread(os.getpid()) as start_threads:
            self._worker = ShardWorker(run)
            start_threads()

    def __call__(self, batch: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Reports on some shards, a row each."""
        rows = [asdict(self._worker.make(int(shard))) for shard in batch["item"]]
        return {name: np.array([row[name] for row in rows]) for name in rows[0]}


def shard_reports(
    run: CorpusRun, cluster: str, workers: int | None, least: int | None, gpus: float
) -> Generator[ShardReport, None, None]:
    """A report of each shard, as they finish; see ``retarget_corpus``."""
    for name, value in (("workers", workers), ("least_workers", least)):
        if value is not None and value < 1:
            raise ConfigError(f"{name} must be 1 or more, not {value}")
    if workers is not None and least is not None and least > workers:
        raise ConfigError(f"least_workers, {least}, must not be more than workers, {workers}")
    ray = ray_data()
    with connected(ray, cluster, workers), _quiet(ray):
        size = workers or max(1, int(ray.cluster_resources().get("CPU", 1)))
        pool = ray.data.ActorPoolStrategy(
            min_size=size if least is None else least,
            max_size=size if least is None else workers,
            max_tasks_in_flight_per_actor=_QUEUED,
        )
        shards = ray.data.from_items(list(range(run.shards)), override_num_blocks=run.shards)
        reports = shards.map_batches(
            ShardActor,
            fn_constructor_args=(run,),
            batch_size=1,
            batch_format="numpy",
            compute=pool,
            num_cpus=1,
            **({"num_gpus": gpus} if gpus else {}),
        )
        try:
            for batch in reports.iter_batches(
                batch_size=None, batch_format="pyarrow", prefetch_batches=0
            ):
                yield from (ShardReport(**row) for row in batch.to_pylist())
        except ray.exceptions.RayError as error:
            raise WorkerError(f"the cluster gave up: {describe(error)[:2000]}") from error


@contextlib.contextmanager
def _quiet(ray: Any) -> Iterator[None]:
    """Ray Data without bars and notes of its own, which ``progress`` replaces."""
    context = ray.data.DataContext.get_current()
    settings = {"enable_progress_bars": False, "print_on_execution_start": False}
    before = {name: getattr(context, name) for name in settings if hasattr(context, name)}
    logger = logging.getLogger("ray.data")
    level = logger.level
    for name in before:
        setattr(context, name, settings[name])
    logger.setLevel(logging.ERROR)
    try:
        yield
    finally:
        logger.setLevel(level)
        for name, value in before.items():
            setattr(context, name, value)
