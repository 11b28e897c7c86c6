"""Runs tasks on a Ray cluster with Ray Data's ``map_batches``, following the same rules as the
local pool.

Ray replaces workers and nodes that die, and gives their tasks to other workers.
"""

from __future__ import annotations

import builtins
import contextlib
import logging
import os
import signal
import socket
import sys
import threading
import warnings
from collections import Counter
from collections.abc import Callable, Generator, Iterator, Sequence
from multiprocessing.reduction import ForkingPickler
from typing import Any, Final, TypeVar

from smooth_operator.errors import MissingExtraError, WorkerError
from smooth_operator.parallel.tasks import (
    TaskResult,
    death,
    describe,
    one_thread,
    pack,
    packed_answer,
)

T = TypeVar("T")
R = TypeVar("R")

LOCAL: Final = "local"
"""Name of a cluster on this machine that is started for one run."""

_CONNECTION_S: Final = 10.0
_AUTH_MODE: Final = "RAY_AUTH_MODE"
_QUEUED: Final = 2
"""Number of tasks at a worker, including the running one."""


def run_on_cluster(
    function: Callable[[T], R],
    tasks: Sequence[T],
    cluster: str,
    *,
    workers: int | None = None,
    retries: int = 2,
) -> Generator[TaskResult[R]]:
    """Yields the results of tasks that run on a cluster; see ``run_tasks``.

    Raises:
        MissingExtraError: Ray or Ray Data is not installed.
        WorkerError: the cluster can't be reached, or gave up.
    """
    try:
        import ray
        import ray.data
    except ImportError as error:
        raise MissingExtraError("working on a cluster", "cluster") from error
    return _results(ray, function, tasks, cluster, workers, retries)


def _results(
    ray: Any,
    function: Callable[[T], R],
    tasks: Sequence[T],
    cluster: str,
    workers: int | None,
    retries: int,
) -> Generator[TaskResult[R]]:
    rows = []
    for index, task in enumerate(tasks):
        try:
            rows.append({"index": index, "task": bytes(ForkingPickler.dumps(task))})
        except Exception as failure:
            yield TaskResult(index, None, f"the task can't be sent: {describe(failure)}", 0.0, 1)
    if not rows:
        return
    with connected(ray, cluster, workers), _data_context(ray):
        size = workers or max(1, int(ray.cluster_resources().get("CPU", 1)))
        starts = ray.remote(num_cpus=0)(Starts).remote()
        results = ray.data.from_items(rows, override_num_blocks=len(rows)).map_batches(
            Worker,
            fn_constructor_args=(function, starts, retries),
            batch_size=1,
            batch_format="pyarrow",
            compute=ray.data.ActorPoolStrategy(
                size=min(size, len(rows)),
                max_tasks_in_flight_per_actor=_QUEUED,
            ),
            num_cpus=1,
        )
        try:
            for batch in results.iter_batches(
                batch_size=None, batch_format="pyarrow", prefetch_batches=0
            ):
                for row in batch.to_pylist():
                    value, error, seconds = ForkingPickler.loads(row["answer"])
                    yield TaskResult(row["index"], value, error, seconds, row["attempts"])
        except ray.exceptions.RayError as failure:
            raise WorkerError(f"the cluster failed: {describe(failure)[:2000]}") from failure


class Starts:
    """Counts how often each task was started, because Ray itself retries without a limit."""

    def __init__(self) -> None:
        self._counts: Counter[int] = Counter()

    def count(self, index: int) -> int:
        """Counts one more start of a task, and returns the number of its starts."""
        self._counts[index] += 1
        return self._counts[index]


class Worker:
    """A worker of the cluster for ``map_batches``: takes pickled tasks and returns pickled answers.

    Args:
        function: function of a task.
        starts: actor of ``Starts``.
        retries: number of retries of a task whose worker died.
    """

    def __init__(self, function: Callable[[Any], Any], starts: Any, retries: int) -> None:
        with one_thread(os.getpid()) as start_threads:
            self._function, self._starts, self._retries = function, starts, retries
            start_threads()

    def __call__(self, batch: Any) -> Any:
        """Computes the answers of a batch (an Arrow table): value, error and seconds, pickled."""
        import pyarrow as pa
        import ray

        answers, attempts = [], []
        for index, raw in zip(batch["index"].to_pylist(), batch["task"].to_pylist(), strict=True):
            started = ray.get(self._starts.count.remote(index))
            if started > self._retries + 1:
                started = self._retries + 1
                answers.append(pack(None, death(started, "on the cluster")))
            else:
                answers.append(packed_answer(self._function, raw))
            attempts.append(started)
        return pa.table(
            {
                "index": batch["index"],
                "attempts": pa.array(attempts, pa.int64()),
                "answer": pa.array(answers, pa.binary()),
            }
        )


@contextlib.contextmanager
def _data_context(ray: Any) -> Iterator[None]:
    """Disables the progress bars and notes of Ray Data inside the block."""
    context, logger = ray.data.DataContext.get_current(), logging.getLogger("ray.data")
    before = context.enable_progress_bars, context.print_on_execution_start
    level = logger.level
    context.enable_progress_bars = context.print_on_execution_start = False
    logger.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        context.enable_progress_bars, context.print_on_execution_start = before
        logger.setLevel(level)


@contextlib.contextmanager
def connected(ray: Any, cluster: str, workers: int | None) -> Iterator[None]:
    """Connects to a cluster for the duration of the block. An existing connection is used and stays
    open.

    Args:
        ray: the module ``ray``.
        cluster: as in ``run_tasks``.
        workers: number of CPUs of a local cluster; None for all cores.

    Raises:
        WorkerError: the cluster can't be reached.
    """
    if ray.is_initialized():  # by the embedding program, which also closes it
        yield
        return
    options: dict[str, Any] = {"log_to_driver": False, "logging_level": logging.ERROR}
    if cluster == LOCAL:
        options |= {"num_cpus": workers, "include_dashboard": False}
        # workers on this machine can import the same modules
        options["runtime_env"] = {
            "env_vars": {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
        }
    with _state_restored():
        try:
            try:
                _check_address(cluster)
                with warnings.catch_warnings():
                    # JAX warns of its threads, but Ray's forks become other programs immediately.
                    warnings.filterwarnings("ignore", r"os\.fork\(\) was called", RuntimeWarning)
                    _connect(ray, cluster, options)
            except Exception as error:  # Ray raises ConnectionError, RuntimeError and others
                raise WorkerError(
                    f"can't reach the Ray cluster {cluster!r} ({describe(error)}); expected "
                    "'auto', the address of a running one ('ray start --head' prints it), "
                    "or 'local'. Ray sends the cluster's token, which clusters require by "
                    "default, only if RAY_AUTH_MODE=token is set in the environment"
                ) from error
            yield
        finally:
            ray.shutdown()


def _connect(ray: Any, cluster: str, options: dict[str, Any]) -> None:
    """Calls ``ray.init``, a second time if a local cluster started too slowly.

    Ray gives its processes 30 seconds, which a busy machine may exceed while it reads their files
    for the first time.
    """
    try:
        ray.init(address=cluster, **options)
    except Exception as error:
        if cluster != LOCAL or "timed out" not in str(error):
            raise
        ray.shutdown()
        ray.init(address=cluster, **options)


@contextlib.contextmanager
def _state_restored() -> Iterator[None]:
    """Restores what Ray replaces in this process: SIGTERM's handler, ``print``,
    ``sys.excepthook``, and the mode of authentication.
    """
    shown, hook, handler = builtins.print, sys.excepthook, signal.getsignal(signal.SIGTERM)
    mode = os.environ.get(_AUTH_MODE)
    try:
        yield
    finally:
        builtins.print, sys.excepthook = shown, hook
        os.environ.pop(_AUTH_MODE, None)
        if mode is not None:
            os.environ[_AUTH_MODE] = mode
        if handler is not None and threading.current_thread() is threading.main_thread():
            signal.signal(signal.SIGTERM, handler)


def _check_address(cluster: str) -> None:
    """Tries to connect to an address, because Ray itself would take minutes to notice a wrong one.

    Raises:
        OSError: nothing listens at the address.
        ValueError: the address has no port.
    """
    if cluster in (LOCAL, "auto"):
        return
    host, _, port = cluster.removeprefix("ray://").rpartition(":")
    if not host or not port.isdigit():
        raise ValueError("an address is HOST:PORT")
    socket.create_connection((host.strip("[]"), int(port)), timeout=_CONNECTION_S).close()
