"""A shard of a corpus, from its list of clips to its part of the output, by one worker.

The clips go through ``do_job`` in groups, as those of ``smooth-operator dataset`` do. Each group is
a pack on disk before the next one begins, so a worker that dies loses one group.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import socket
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from itertools import islice
from pathlib import Path
from typing import Any, Final

from smooth_operator.atomic_files import output_error, write_json
from smooth_operator.errors import DocumentError, OutputError, SmoothOperatorError
from smooth_operator.io.documents import read_json
from smooth_operator.lab.datasets.robot_clip import RobotClip
from smooth_operator.lab.datasets.sources import Item
from smooth_operator.lab.datasets.store import Kept, Store
from smooth_operator.lab.datasets.work import Job, do_job
from smooth_operator.lab.ray.manifest import shard_items
from smooth_operator.lab.ray.settings import CorpusRun
from smooth_operator.lab.ray.work import ClipWork
from smooth_operator.parallel.tasks import describe

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
        retarget_s: time for reading, retargeting and the packs, quality figures included [s].
        write_s: time for filtering and writing the output [s].
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
    write_s: float = 0.0
    busy_s: float = 0.0
    cpu_s: float = 0.0
    idle_s: float = 0.0
    start_s: float = 0.0
    memory_mb: float = 0.0
    worker: str = ""
    error: str = ""


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
        except SmoothOperatorError as error:
            self._trouble = describe(error)
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
            counts = self._finished(shard) or self._made(shard)
        except SmoothOperatorError as error:
            # A second attempt, by a worker that was taken for dead, may have finished it meanwhile.
            counts = self._finished(shard) or {"error": describe(error)}
        self._start_s = 0.0
        self._free_since = time.perf_counter()
        own |= {"busy_s": self._free_since - began, "cpu_s": time.process_time() - cpu}
        own["memory_mb"] = _peak_memory_mb()
        return ShardReport(shard, **counts, **own)

    def _finished(self, shard: int) -> dict[str, Any] | None:
        content = read_report(self._run, shard)
        return None if content is None else {**content["counts"], "kept": True}

    def _made(self, shard: int) -> dict[str, Any]:
        began = time.perf_counter()
        items = {item.name: item for item in shard_items(self._run.clips, shard)}
        folder = self._run.packs(shard)
        journal, store = Journal(folder, self._run.digest), Store(folder)
        packs = store.find(lambda name, requested, files: name in items)
        recovered = len(packs) + len(journal.failed)
        repeated = journal.repeated(packs)
        for group in self._groups(items, packs, journal):
            journal.begin([item.name for item in group])
            job = Job(tuple(group), self._work.recipe, folder, self._run.settings.retarget)
            for entry in do_job(job):
                if entry.kept is None:
                    journal.failed[entry.item] = entry.reason or "RecordingError: no clip is in it"
                else:
                    packs[entry.item] = entry.kept
        retargeted = time.perf_counter()
        with contextlib.closing(store):
            content = self._written(shard, items, packs, store, journal.failed)
        path = self._run.report(shard)
        path.parent.mkdir(parents=True, exist_ok=True)
        write_json(path, content)
        shutil.rmtree(folder, ignore_errors=True)
        return {
            **content["counts"],
            "computed": len(packs) + len(journal.failed) - recovered,
            "recovered": recovered,
            "repeated": repeated,
            "retarget_s": retargeted - began,
            "write_s": time.perf_counter() - retargeted,
        }

    def _groups(
        self, items: dict[str, Item], packs: dict[str, Kept], journal: Journal
    ) -> Iterator[Sequence[Item]]:
        """Clips that are left, in groups; a clip at which workers died is alone, or given up.

        One death has many causes. Where workers died twice, each clip that was in hand both times
        is alone, with nothing else at work meanwhile.
        """
        done = {*packs, *journal.failed}
        left = [item for name, item in items.items() if name not in done]
        together = iter([item for item in left if journal.deaths.get(item.name, 0) < 2])
        for item in left:
            deaths = journal.deaths.get(item.name, 0)
            if deaths >= self._run.settings.attempts:
                journal.failed[item.name] = f"WorkerDied: {deaths} times at it"
            elif deaths > 1:
                yield [item]
        while group := list(islice(together, self._run.settings.group)):
            yield group

    def _written(
        self,
        shard: int,
        items: dict[str, Item],
        packs: dict[str, Kept],
        store: Store,
        failed: dict[str, str],
    ) -> dict[str, Any]:
        """Filters the results in the order of the list and writes the output; the report."""
        counts = dict.fromkeys(
            ("clips", "made", "dropped", "failed", "episodes", "frames", "hand_frames"), 0
        )
        lost: list[dict[str, Any]] = []
        with self._work.writer(self._run, shard) as writer:
            for name in items:
                counts["clips"] += 1
                if name in failed:
                    counts["failed"] += 1
                    lost.append({"clip": name, "failed": failed[name]})
                    continue
                clips = store.read(packs[name])
                episodes = self._episodes(name, clips, writer, lost)
                counts["made" if episodes else "dropped"] += 1
                counts["episodes"] += episodes
                counts["frames"] += packs[name].frames
                counts["hand_frames"] += sum(
                    len(whole.clip) * max(len(whole.commands), 1) for whole in clips
                )
        return {"run": self._run.digest, "counts": counts, "lost": lost}

    def _episodes(
        self, name: str, clips: Sequence[RobotClip], writer: Any, lost: list[dict[str, Any]]
    ) -> int:
        count = 0
        for whole in clips:
            for episode in self._work.select(whole):
                if not isinstance(episode, RobotClip):
                    lost.append({"clip": name, **asdict(episode)})
                    continue
                try:
                    writer.write(episode)
                    count += 1
                except OutputError:
                    raise
                except SmoothOperatorError as error:  # the format can't hold it
                    reason = {"name": episode.clip.name, "reasons": {"format": str(error)}}
                    lost.append({"clip": name, **reason})
        return count


class Journal:
    """Clips of a shard that failed, that are in hand, and at which workers died.

    Args:
        folder: of the shard's packs; emptied if it is another run's.
        digest: of the run.

    Raises:
        OutputError: the folder can't be written.
    """

    def __init__(self, folder: Path, digest: str) -> None:
        self._path, self._digest = folder / "journal.json", digest
        self.failed: dict[str, str] = {}
        self.deaths: dict[str, int] = {}
        self._in_hand: list[str] = []
        with contextlib.suppress(OSError, DocumentError, KeyError, TypeError):
            content = read_json(self._path, most_bytes=_MOST_BYTES)
            if content["run"] == digest:
                self.failed, self.deaths = dict(content["failed"]), dict(content["deaths"])
                self._in_hand = list(content["in_hand"])
                return
        shutil.rmtree(folder, ignore_errors=True)
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise output_error(folder, error) from error

    def repeated(self, packs: dict[str, Kept]) -> int:
        """Counts a death at each clip that was in hand and has no result; how many there are."""
        names = [name for name in self._in_hand if name not in packs and name not in self.failed]
        for name in names:
            self.deaths[name] = self.deaths.get(name, 0) + 1
        return len(names)

    def begin(self, names: Sequence[str]) -> None:
        """Notes the clips that are worked on, before anything can go wrong with them."""
        content = {"run": self._digest, "failed": self.failed, "deaths": self.deaths}
        write_json(self._path, {**content, "in_hand": names})


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
