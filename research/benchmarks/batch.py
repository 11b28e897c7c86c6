"""Frames a second of recordings side by side in one program, and of a folder; dex-retargeting too.

    python research/benchmarks/batch.py                                   # lanes, on this CPU
    python research/benchmarks/batch.py --methods smooth:teleop --lanes 256 1024 4096 --device gpu
    python research/benchmarks/batch.py --folder --workers 2 --peer-python PYTHON --peer-urdf FOLDER

The first table is about one process: frames one by one, as live, and recordings side by side in
1, 2, 4 ... lanes. The second (``--folder``) is ``smooth-operator retarget FOLDER`` by a pool, the
start of the workers included and not; with ``--peer-python``, an interpreter that has
dex-retargeting, the same recordings go through its vector optimiser for the LEAP hand in as many
processes. What is compared takes turns in one run. JAX's compilation cache is filled beforehand.
"""

from __future__ import annotations

import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import jax
import numpy as np

from smooth_operator import HandRecording
from smooth_operator.lab.offline.folder import retarget_all, survey
from smooth_operator.landmarks import BASES, WRIST
from smooth_operator.parallel import usable_cores
from smooth_operator.planning import make_request
from smooth_operator_research.run_report import (
    BenchmarkError,
    Report,
    ReportSettings,
    child_json,
    operator_frames,
    peak_memory_mib,
    retargeter_of,
    run_program,
)

PEER = Path(__file__).with_name("peer_worker.py")
_PEER = "dex-retargeting, LEAP hand"


@dataclass(frozen=True)
class Settings(ReportSettings):
    """What to run.

    Attributes:
        methods: METHOD or METHOD:PRESET of each row.
        lanes: recordings side by side in one process; none leaves that table out.
        frames: of each recording in that table.
        folder: measure a folder too.
        recordings: in the folder.
        folder_frames: of each of them.
        workers: of the folder's pool; as many as there are cores unless given.
        repeats: how often; medians are reported.
        hand: robot hand.
        device: cpu or gpu; stops where JAX has none of that kind.
        peer_python: interpreter of an environment with dex-retargeting.
        peer_urdf: folder with leap_hand/leap_hand_right.urdf for it.
    """

    methods: tuple[str, ...] = ("smooth:teleop", "sbr:realtime", "geort", "joint_angle")
    lanes: tuple[int, ...] = (1, 2, 4, 8, 16)
    frames: int = 1000
    folder: bool = False
    recordings: int = 16
    folder_frames: int = 3000
    workers: int | None = None
    repeats: int = 3
    hand: str = "mimic_p050"
    device: Literal["cpu", "gpu"] = "cpu"
    peer_python: Path | None = None
    peer_urdf: Path | None = None


def main(settings: Settings) -> None:
    if jax.default_backend() != settings.device:
        raise BenchmarkError(f"JAX's default device is a {jax.default_backend()}; see --device")
    report = Report("batch", vars(settings))
    if settings.lanes:
        side_by_side(report, settings)
    if settings.folder:
        with tempfile.TemporaryDirectory() as at:
            folder(report, settings, Path(at))
    memory = peak_memory_mib()
    if memory is not None:
        report.figures["peak_memory_mib"] = memory
        report.notes.append(f"peak memory of this process: {memory:.0f} MiB")
    report.finish(settings.output, settings.compare)


def side_by_side(report: Report, settings: Settings) -> None:
    rows: list[list[object]] = []
    for name in settings.methods:
        retargeter = retargeter_of(settings.hand, name)
        if retargeter.method.host is not None:
            report.notes.append(f"{name}: its solver runs on the host, so a batch is a loop")
            continue
        size = max(settings.lanes)
        # as many motions as a batch needs at most, each of its own; few where there are thousands
        motions = [operator_frames(settings.frames, seed) for seed in range(min(size, 32))]
        recordings = [motions[i % len(motions)] for i in range(size)]
        single, _ = retargeter.run(motions[0])
        apart, memory = {}, {}
        for lanes in settings.lanes:
            commands, _ = retargeter.batch(recordings[:lanes], lanes=lanes)[0]
            own_tips = retargeter.hand.tips(commands.joint_positions)
            tips = retargeter.hand.tips(single.joint_positions)
            apart[lanes] = np.linalg.norm(own_tips - tips, axis=-1).max(axis=1) * 1e3
            memory[lanes] = device_memory_mib()
        times: dict[int, list[float]] = {lanes: [] for lanes in settings.lanes}
        live = []
        for _ in range(settings.repeats):  # in turn, so that noise hits all alike
            live.append(float(np.median(retargeter.run(motions[0])[0].latency_ms)))
            for lanes in settings.lanes:
                started = time.perf_counter()
                retargeter.batch(recordings[:lanes], lanes=lanes)
                times[lanes].append(time.perf_counter() - started)
        one = float(np.median(live)) * 1e-3
        report.add(f"{name}/live", {"p50_ms": one * 1e3})
        rows.append([name, "live", 1 / one, one * 1e6, 1.0, None, None, None])
        for lanes, seconds in times.items():
            each = float(np.median(seconds)) / (lanes * settings.frames)
            middle, worst = np.percentile(apart[lanes], (50, 100))
            figures = {
                "frames_per_s": 1 / each,
                "us_per_frame": each * 1e6,
                "ratio_to_live": one / each,
                "tips_apart_p50_mm": float(middle),
                "tips_apart_max_mm": float(worst),
                "device_memory_mib": memory[lanes],
            }
            report.add(f"{name}/{lanes} lanes", figures)
            rows.append([name, str(lanes), *figures.values()])
    header = ("method", "lanes", "frames/s", "µs a frame", "ratio", "apart p50 [mm]")
    report.table(
        f"One process, recordings of {settings.frames} frames side by side",
        (*header, "apart max [mm]", "device memory [MiB]"),
        rows,
        2,
    )
    report.notes.append(
        "live: the median latency of a frame alone. apart: fingertips of the batch's first "
        "recording against the same frame by frame"
    )


def device_memory_mib() -> float | None:
    """Most that JAX has taken of the device's memory so far; None where it does not say."""
    stats = jax.devices()[0].memory_stats()
    return None if not stats else stats.get("peak_bytes_in_use", 0) / 2**20


def folder(report: Report, settings: Settings, at: Path) -> None:
    """Folders by a pool, in turn with dex-retargeting."""
    workers = settings.workers or usable_cores()
    sources = {count: at / f"{count}" for count in (settings.folder_frames, 2)}
    for frames, source in sources.items():
        source.mkdir()
        for seed in range(settings.recordings):
            recording = operator_frames(frames, seed)
            landmarks, path = in_wrist_axes(recording), source / f"{seed:03d}.npz"
            np.savez(path, landmarks=landmarks, stamps=recording.stamps, side="right")
    total = settings.recordings * settings.folder_frames

    def ours(name: str, source: Path) -> None:
        method, _, preset = name.partition(":")
        request = make_request(hand=settings.hand, method=method, preset=preset or None)
        with tempfile.TemporaryDirectory(dir=at) as output:
            jobs = survey(source, Path(output), request).jobs
            entries = list(retarget_all(jobs, workers=workers))
        reasons = [entry.reason for entry in entries if entry.reason]
        if reasons:
            raise BenchmarkError(f"{name}: {reasons[0]}")

    ways = [*settings.methods, *([_PEER] if settings.peer_python is not None else [])]

    def run(way: str) -> dict[str, float]:
        seconds = []
        for source in sources.values():
            started = time.perf_counter()
            if way == _PEER:
                more = ("--method", "vector", "--urdf", settings.peer_urdf, "--workers", workers)
                output = at / "peer"
                command = (settings.peer_python, PEER, "dex-retargeting", source, output, *more)
                child_json(command, {"OMP_NUM_THREADS": "1", "PYTHONPATH": ""})
            else:
                ours(way, source)
            seconds.append(time.perf_counter() - started)
        whole, startup = seconds
        return {"total_s": whole, "startup_s": startup, "work_s": whole - startup}

    times: dict[str, list[dict[str, float]]] = {way: [] for way in ways}
    for way in ways:  # fills the cache
        run(way)
    for _ in range(settings.repeats):  # in turn, so that noise hits all alike
        for way in ways:
            times[way].append(run(way))
    rows = []
    for way, runs in times.items():
        middle = {key: float(np.median([run[key] for run in runs])) for key in runs[0]}
        middle["frames_per_s"] = total / middle["work_s"]
        middle["frames_per_s_with_startup"] = total / middle["total_s"]
        report.add(f"folder/{way}", middle)
        rows.append([way, *middle.values()])
    report.table(
        f"A folder of {settings.recordings} recordings of {settings.folder_frames} frames, "
        f"{workers} processes, medians of {settings.repeats}",
        ("method", "total [s]", "start-up [s]", "work [s]", "frames/s", "with start-up"),
        rows,
    )
    report.notes.append("start-up: the same folder with two frames in each recording")


def in_wrist_axes(recording: HandRecording) -> np.ndarray:
    """Landmarks from the wrist, x to the base of the middle finger, z out of the back [m]."""
    landmarks = recording.landmarks - recording.landmarks[:, WRIST, None]
    x = landmarks[:, BASES[2]]
    x = x / np.linalg.norm(x, axis=-1, keepdims=True)
    y = landmarks[:, BASES[1]] - landmarks[:, BASES[3]]
    z = np.cross(x, y)
    z = z / np.linalg.norm(z, axis=-1, keepdims=True)
    turned: np.ndarray = np.einsum("tij,tnj->tni", np.stack([x, np.cross(z, x), z], 1), landmarks)
    return turned


if __name__ == "__main__":
    run_program(main, Settings, __doc__)
