"""Retargeting on a GPU: processes read the clips, this one retargets a thousand side by side.

One process uses one GPU. Several GPUs are several runs, each with its ``CUDA_VISIBLE_DEVICES`` and
its ``--shard``.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import subprocess
import time
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from smooth_operator.errors import ConfigError
from smooth_operator.lab.datasets.work import Entry, Job, JobClips, finish_job, read_job
from smooth_operator.parallel import run_groups

BATCH: Final = 2048
"""Hands that are retargeted together: two for each lane, so that short and long ones balance."""

_BATCHES: Final = 2  # read and waiting, or retargeted and being written
_QUERY: Final = ("--query-gpu=utilization.gpu", "--format=csv,noheader,nounits", "-lms", "250")


@dataclass
class GpuUse:
    """The GPU of a run and the time that it works.

    Attributes:
        name: name of the device.
        frames: frames that were retargeted.
        seconds: time of the run [s].
        retargeting: time in which a batch was retargeted and packed [s].
        busy: share of ``seconds`` in which the GPU ran a kernel; None if it can't be measured.
    """

    name: str
    frames: int = 0
    seconds: float = 0.0
    retargeting: float = 0.0
    busy: float | None = None

    @classmethod
    def of_this_machine(cls) -> GpuUse:
        """The first GPU that JAX sees.

        Raises:
            ConfigError: JAX sees none.
        """
        import jax

        try:
            (device, *_) = jax.devices("gpu")
        except RuntimeError as error:
            raise ConfigError(
                f"--device gpu needs a GPU that JAX can use; it sees only {jax.devices()[0]} "
                "(`smooth-operator doctor` says why). Without it: --device cpu"
            ) from error
        return cls(device.device_kind)

    def sentence(self) -> str:
        """Frames a second and the share of time in which the GPU was busy."""
        busy = "" if self.busy is None else f"; the GPU was busy {self.busy:.0%} of the time"
        return (
            f"{self.name}: {self.frames} frames in {self.seconds:.1f} s "
            f"({self.frames / max(self.seconds, 1e-9):,.0f} a second), "
            f"{self.retargeting / max(self.seconds, 1e-9):.0%} of it retargeting and packing{busy}"
        )

    @contextlib.contextmanager
    def measured(self) -> Iterator[None]:
        """Measures the time of a block, and how busy the GPU is."""
        started = time.perf_counter()
        with gpu_samples() as samples:
            try:
                yield
            finally:
                self.seconds += time.perf_counter() - started
        self.busy = float(np.mean(samples)) if samples else None


@contextlib.contextmanager
def gpu_samples() -> Iterator[list[float]]:
    """Shares of time in which the GPU ran a kernel, four a second while a block runs.

    ``nvidia-smi`` measures them; the list is filled at the end, and stays empty without it.
    """
    samples: list[float] = []
    program = shutil.which("nvidia-smi")
    if program is None:
        yield samples
        return
    with subprocess.Popen([program, *_QUERY], stdout=subprocess.PIPE, text=True) as sampler:
        try:
            yield samples
        finally:
            sampler.terminate()
            lines = (sampler.communicate()[0] or "").split()
            samples += [float(line) / 100 for line in lines if line.isdigit()]


@contextlib.contextmanager
def only_cpus_in_children() -> Iterator[None]:
    """Processes that start in the block compute on the CPU, whatever JAX would choose.

    JAX reads the variable when it is imported: a process that uses a GPU imports it before.
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


def entries_of_gpu(
    jobs: Sequence[Job], split: Callable[[Job], Sequence[Job]], use: GpuUse, **options: Any
) -> Generator[list[Entry]]:
    """Results of jobs: workers read the clips, this process retargets ``BATCH`` hands together.

    While a batch is retargeted and packed by a thread, the next is read.

    Args:
        split: parts of a job whose worker died.
        options: options of ``run_tasks``.

    Raises:
        OutputError: a pack can't be written.
    """

    def finish(waiting: list[tuple[Job, JobClips]]) -> list[Entry]:
        started = time.perf_counter()
        job = replace(waiting[0][0], items=tuple(i for part, _ in waiting for i in part.items))
        read = JobClips()
        for _, each in waiting:
            read.clips += each.clips
            read.reasons |= each.reasons
        entries = finish_job(job, read)
        use.retargeting += time.perf_counter() - started
        use.frames += sum(0 if each.kept is None else each.kept.frames for each in entries)
        return entries

    with (
        use.measured(),
        ThreadPoolExecutor(1) as thread,
        contextlib.closing(run_groups(read_job, jobs, split, **options)) as results,
    ):
        batches: list[Future[list[Entry]]] = []
        waiting: list[tuple[Job, JobClips]] = []
        hands = 0
        for job, result in results:
            if result.value is None:
                yield [Entry(item.name, None, result.error) for item in job.items]
                continue
            waiting.append((job, result.value))
            hands += sum(len(each.clip.hands) for each in result.value.clips)
            if hands >= BATCH:
                batches.append(thread.submit(finish, waiting))
                waiting, hands = [], 0
            if len(batches) >= _BATCHES:
                yield batches.pop(0).result()
        if waiting:
            batches.append(thread.submit(finish, waiting))
        for batch in batches:
            yield batch.result()
