"""A shard of a corpus, from its list of clips to its part of the output, by one worker.

Reading runs ahead in a thread, by a bounded number of clips. Each clip that is done is on disk
before the next group begins, so a worker that dies loses the clips that it had in hand.
"""

from __future__ import annotations

import contextlib
import os
import socket
import time
from collections import deque
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

from smooth_operator.atomic_files import write_json
from smooth_operator.errors import DocumentError, OutputError, SmoothOperatorError
from smooth_operator.io.documents import read_json
from smooth_operator.lab.datasets.robot_clip import RobotClip
from smooth_operator.lab.datasets.sources import Item
from smooth_operator.lab.datasets.work import ReadClip
from smooth_operator.lab.ray.episode_bytes import decode, encode
from smooth_operator.lab.ray.manifest import Manifest
from smooth_operator.lab.ray.settings import CorpusRun
from smooth_operator.lab.ray.spool import Done, Spool
from smooth_operator.lab.ray.work import ClipWork
from smooth_operator.parallel.results import describe

_MOST_BYTES: Final = 256_000_000


@dataclass(frozen=True)
class ShardReport:
    """The result of a shard, small enough to go through a driver by the thousand.

    Attributes:
        shard: its number.
        clips: in it.
        made: clips with one episode at least.
        dropped: clips without one, by quality.
        failed: clips that could not be read or retargeted.
        episodes: in the output.
        frames: of the clips that were made or dropped.
        hand_frames: the same, of all their hands.
        kept: whether it was whole already.
        computed: clips that were retargeted for it now.
        recovered: clips whose result an attempt before had left.
        repeated: clips that an attempt before had begun to retarget, in vain.
        retarget_s: time in retargeting, quality figures included [s].
        read_s: time in which nothing could be done before a clip was read [s].
        write_s: time for spooling, filtering and writing the output [s].
        busy_s: time from begin to end [s].
        cpu_s: time of processors that the worker's process took meanwhile [s].
        idle_s: time that the worker had waited before for a shard [s].
        start_s: time that the worker took to start, in its first report [s].
        memory_mb: largest memory of the worker so far [MB].
        worker: its host and process.
        error: why the run can't go on; empty if it can.
    """

    shard: int
    clips: int = 0
    made: int = 0
    dropped: int = 0
    failed: int = 0
    episodes: int = 0
    frames: int = 0
    hand_frames: int = 0
    kept: bool = False
    computed: int = 0
    recovered: int = 0
    repeated: int = 0
    retarget_s: float = 0.0
    read_s: float = 0.0
    write_s: float = 0.0
    busy_s: float = 0.0
    cpu_s: float = 0.0
    idle_s: float = 0.0
    start_s: float = 0.0
    memory_mb: float = 0.0
    worker: str = ""
    error: str = ""


@dataclass
class _Times:
    retarget: float = 0.0
    read: float = 0.0
    write: float = 0.0

    @contextlib.contextmanager
    def spent(self, name: str) -> Iterator[None]:
        started = time.perf_counter()
        try:
            yield
        finally:
            setattr(self, name, getattr(self, name) + time.perf_counter() - started)


class ShardWorker:
    """Makes shards of one run, one after the other, with retargeters that are compiled once.

    A failure that is the run's own (no such hand, a full disk) is in the report, so that an engine
    does not try it again for ever.

    Args:
        run: the run.
    """

    def __init__(self, run: CorpusRun) -> None:
        started = time.perf_counter()
        self._run = run
        self._trouble = ""
        try:
            self._work = ClipWork(run.settings)
            self._manifest = Manifest(run.state / "manifest.arrow")
        except SmoothOperatorError as error:
            self._trouble = describe(error)
        self._ahead = ThreadPoolExecutor(1, "reader")
        self._free_since = time.perf_counter()
        self._start_s = self._free_since - started

    def make(self, shard: int) -> ShardReport:
        """One shard; what is done of it already is not done again."""
        began, cpu = time.perf_counter(), time.process_time()
        own: dict[str, Any] = {
            "idle_s": began - self._free_since,
            "start_s": self._start_s,
            "worker": f"{socket.gethostname()}:{os.getpid()}",
        }
        if self._trouble:
            return ShardReport(shard, error=self._trouble, **own)
        try:
            found = self._kept(shard) or self._made(shard)
        except SmoothOperatorError as error:
            found = {"error": describe(error)}
        self._start_s = 0.0
        self._free_since = time.perf_counter()
        own |= {"busy_s": self._free_since - began, "cpu_s": time.process_time() - cpu}
        own["memory_mb"] = _peak_memory_mb()
        return ShardReport(shard, **found, **own)

    def _kept(self, shard: int) -> dict[str, Any] | None:
        content = read_report(self._run, shard)
        return None if content is None else {**content["counts"], "kept": True}

    def _made(self, shard: int) -> dict[str, Any]:
        items = self._manifest.items(shard)
        folder = self._run.state / "spool"
        folder.mkdir(parents=True, exist_ok=True)
        spool, times = Spool(folder, shard, self._run.digest), _Times()
        whole = False
        try:
            left = [item for item in items if item.name not in spool.done]
            again = len(spool.retargeted)
            # One death has many causes. Where workers died twice, each clip that was in hand both
            # times is alone, with nothing else at work meanwhile.
            suspects = [item for item in left if spool.begun[item.name] > 1]
            computed = sum(self._alone(item, spool, times) for item in suspects)
            left = [item for item in left if spool.begun[item.name] < 2]
            computed += sum(
                self._group(group, spool, times) for group in self._groups(left, spool, times)
            )
            with times.spent("write"):
                content = self._written(shard, items, spool)
                path = self._run.report(shard)
                path.parent.mkdir(parents=True, exist_ok=True)
                write_json(path, content)
            whole = True
        finally:
            spool.close(remove=whole)
        return {
            **content["counts"],
            "computed": computed,
            "recovered": spool.recovered,
            "repeated": again,
            **{f"{name}_s": seconds for name, seconds in asdict(times).items()},
        }

    def _alone(self, item: Item, spool: Spool, times: _Times) -> int:
        died = spool.begun[item.name]
        if died >= self._run.settings.attempts:
            spool.finish(item.name, "failed", [f"WorkerDied: {died} times at it"])
            return 0
        return sum(self._group(group, spool, times) for group in self._groups([item], spool, times))

    def _groups(
        self, left: list[Item], spool: Spool, times: _Times
    ) -> Iterator[list[tuple[Item, list[ReadClip]]]]:
        """Clips that have been read, in groups; reading is ahead by a group."""
        size = self._run.settings.group
        waiting: deque[tuple[Item, Future[list[ReadClip]]]] = deque()
        coming = iter(left)
        group: list[tuple[Item, list[ReadClip]]] = []
        while True:
            while len(waiting) < 2 * size and (item := next(coming, None)) is not None:
                spool.begin(item.name)
                waiting.append((item, self._ahead.submit(self._work.read, item)))
            if not waiting:
                break
            item, future = waiting.popleft()
            with times.spent("read"):
                try:
                    group.append((item, future.result()))
                except Exception as error:  # of a reader, which may be a plugin's
                    spool.finish(item.name, "failed", [describe(error)])
            if len(group) == size:
                yield group
                group = []
        if group:
            yield group

    def _group(self, group: list[tuple[Item, list[ReadClip]]], spool: Spool, times: _Times) -> int:
        with times.spent("write"):
            for item, _ in group:
                spool.retarget(item.name)
        with times.spent("retarget"):
            results = iter(self._retargeted([each for _, read in group for each in read]))
        with times.spent("write"):
            for item, read in group:
                self._finish(item.name, [next(results) for _ in read], spool)
        return len(group)

    @staticmethod
    def _finish(name: str, results: list[RobotClip | Exception], spool: Spool) -> None:
        episodes: list[bytes] = []
        frames = hand_frames = 0
        for found in results:
            if isinstance(found, Exception):
                spool.finish(name, "failed", [describe(found)])
                return
            episodes.append(encode(found))
            frames += len(found.clip)
            hand_frames += len(found.clip) * max(len(found.commands), 1)
        if episodes:
            spool.finish(name, "made", (), frames, hand_frames, episodes)
        else:
            spool.finish(name, "failed", ["RecordingError: no clip is in it"])

    def _retargeted(self, read: list[ReadClip]) -> list[RobotClip | Exception]:
        if not read:
            return []
        try:
            return list(self._work.retarget(read))
        except Exception as error:  # of one of them, which must not take the others with it
            if len(read) == 1:
                return [error]
        return [found for each in read for found in self._retargeted([each])]

    def _written(self, shard: int, items: list[Item], spool: Spool) -> dict[str, Any]:
        """Filters the results in the order of the list and writes the output; the report."""
        counts = dict.fromkeys(
            ("clips", "made", "dropped", "failed", "episodes", "frames", "hand_frames"), 0
        )
        lost: list[dict[str, Any]] = []
        with self._work.writer(self._run, shard) as writer:
            for item in items:
                counts["clips"] += 1
                done = spool.done[item.name]
                if done.state == "failed":
                    counts["failed"] += 1
                    lost.append({"clip": item.name, "failed": done.reasons[0]})
                    continue
                kept = self._episodes(done, writer, lost)
                counts["made" if kept else "dropped"] += 1
                counts["episodes"] += kept
                counts["frames"] += done.frames
                counts["hand_frames"] += done.hand_frames
        return {"run": self._run.digest, "counts": counts, "lost": lost}

    def _episodes(self, done: Done, writer: Any, lost: list[dict[str, Any]]) -> int:
        kept = 0
        for content in done.episodes():
            for episode in self._work.select(decode(content)):
                if not isinstance(episode, RobotClip):
                    lost.append({"clip": done.name, **asdict(episode)})
                    continue
                try:
                    writer.write(episode)
                    kept += 1
                except OutputError:
                    raise
                except SmoothOperatorError as error:  # the format can't hold it
                    reason = {"name": episode.clip.name, "reasons": {"format": str(error)}}
                    lost.append({"clip": done.name, **reason})
        return kept


def read_report(run: CorpusRun, shard: int) -> dict[str, Any] | None:
    """Counts and losses of a shard that is whole; None if it is not.

    Raises:
        OutputError: it is another run's.
    """
    path = run.report(shard)
    try:
        content = read_json(path, most_bytes=_MOST_BYTES)
        if content["run"] == run.digest:
            return dict(content)
    except FileNotFoundError:
        return None
    except (OSError, DocumentError, KeyError, TypeError) as error:
        raise OutputError(f"{path}: no report of a shard ({error}); write to a new folder") from (
            error
        )
    raise OutputError(f"{path}: it is of another run; write to a new folder")


def _peak_memory_mb() -> float:
    with contextlib.suppress(OSError, StopIteration, ValueError):
        lines = Path("/proc/self/status").read_text(encoding="ascii").splitlines()
        return next(int(line.split()[1]) / 1024 for line in lines if line.startswith("VmHWM"))
    return float("nan")
