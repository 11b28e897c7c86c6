"""Compares our retargeter with others in one run: latency, start and quality, in one table.

    python research/benchmarks/peers.py GLOVE.npz --frames 0:500 --wuji-python PYTHON \\
        --dex-python PYTHON --dex-urdf FOLDER --authors FOLDER

    # PYTHON is dex/bin/python, FOLDER is dex-urdf/robots/hands
    python -m venv dex && dex/bin/python -m pip install "dex-retargeting==0.5.0" torch six
    git clone https://github.com/dexsuite/dex-urdf

Every program runs in a process of its own, in the environment that an option names; processes take
turns. Those without an environment are left out, with a line that says so. Quality is judged by our
metrics, on our model of the hand that the peer was made for, where our methods run as well.
wuji_sdk: the maker's retargeter of the Wuji Hand (its telemetry is switched off). dex-retargeting:
its settings for LEAP, Shadow and Allegro. Its Shadow moves the wrist too, which is left out, and
the two last joints of a finger apart. The authors of "sampling-based retargeting" publish no
package: files with their code's commands for this recording (``*_frames-A-B.npz``:
``joint_positions``, ``joint_names``) are judged, without latency.
"""

from __future__ import annotations

import sys
import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro

from smooth_operator import HandRecording, assemble_trace, evaluate, load_hand
from smooth_operator.formats.checks import frame_slice
from smooth_operator.formats.readers import read_recording
from smooth_operator.formats.registry import rated_if_unstamped
from smooth_operator.hands.hand import Hand
from smooth_operator.landmarks import BASES, WRIST
from smooth_operator.retargeting.preset_files import method_config
from smooth_operator.types import CommandTrajectory
from smooth_operator_research.run_report import (
    BenchmarkError,
    Report,
    ReportSettings,
    child_json,
    percentiles,
    run_program,
)

WORKER = Path(__file__).with_name("peer_worker.py")
QUALITY = {
    "cosine_similarity": "cos thumb",
    "cosine_similarity_all": "cos all",
    "motion_preservation": "motion",
    "flatness": "flatness [m²]",
    "lag_ms": "lag [ms]",
    "pinch_touch_share": "pinches touch",
}
QUIET = {
    "WUJI_TELEMETRY_DISABLE": "1",
    "WUJI_TELEMETRY_NO_UPLOAD": "1",
    "WUJI_DEVICE_TELEMETRY_DISABLE": "1",
    "OMP_NUM_THREADS": "1",
}
BEYOND_RAD = 1e-3
DEX_HANDS = ("leap_hand", "shadow_hand", "allegro_hand")
ALLEGRO_ZERO_RAD = 0.263
"""Angle of the thumb's first joint in our model, which follows the MJCF, at the URDF's zero."""


@dataclass(frozen=True)
class Settings(ReportSettings):
    """Settings of a run.

    Attributes:
        recording: file with a right hand.
        frames: range A:B of its frames.
        rate: frame rate of a file without stamps [Hz].
        methods: METHOD or METHOD:PRESET of ours, on each hand.
        wuji_python: interpreter of an environment with wuji-sdk and NumPy.
        dex_python: interpreter of an environment with dex-retargeting.
        dex_urdf: folder with HAND/HAND_right.urdf for it, as in dex-urdf.
        authors: folder with commands of the authors' code.
        repeats: processes of each program; latencies are pooled, starts are medians.
    """

    recording: Annotated[Path, tyro.conf.Positional]
    frames: str = "0:500"
    rate: float | None = None
    methods: tuple[str, ...] = ("smooth", "smooth:precise", "sbr")
    wuji_python: Path | None = None
    dex_python: Path | None = None
    dex_urdf: Path | None = None
    authors: Path | None = None
    repeats: int = 5


@dataclass
class Program:
    """One row of the table.

    Attributes:
        hand: which hand it moves.
        name: what is run.
        python: interpreter.
        arguments: arguments of the worker.
        q: (T, n) commands in the order of our model of the hand [rad].
        ms: times of frames, of all processes.
        starts: from the start of a process to its first command [s].
    """

    hand: str
    name: str
    python: Path
    arguments: tuple[str, ...]
    q: np.ndarray = field(default_factory=lambda: np.empty(0))
    ms: list[np.ndarray] = field(default_factory=list)
    starts: list[float] = field(default_factory=list)


def main(settings: Settings) -> None:
    report = Report("peers", vars(settings))
    whole, _ = rated_if_unstamped(
        lambda rate: read_recording(settings.recording, rate=rate), settings.rate
    )
    recording = whole[frame_slice(settings.frames, len(whole))]
    if recording.side != "right":
        raise BenchmarkError("the recording has a left hand; the peers are set up for right ones")
    programs = make_programs(settings, report)
    with tempfile.TemporaryDirectory() as at:
        path = Path(at) / "recording.npz"
        stamps = recording.stamps - recording.stamps[0]
        np.savez(path, landmarks=in_wrist_axes(recording), stamps=stamps)
        for turn in range(settings.repeats + 1):  # the first one fills caches, and is not counted
            for program in list(programs) if turn % 2 else list(reversed(programs)):
                problem = run(program, path, Path(at), counted=turn > 0)
                if problem:
                    report.notes.append(f"left out: {program.name} on {program.hand}: {problem}")
                    programs.remove(program)
    rows: list[list[object]] = []
    for program in programs:
        times = percentiles(np.concatenate(program.ms))
        start = {"start_s": float(np.median(program.starts)), "worst_s": max(program.starts)}
        figures = judged(load_hand(program.hand, "right"), recording, program.q)
        report.add(f"{program.hand}/{program.name}", times | start | figures)
        speed = (times["p50_ms"], times["p95_ms"], times["p99_ms"], start["start_s"])
        rows.append([program.hand, program.name, *speed, *figures.values()])
    for hand, name, q in authors(settings, report):
        figures = judged(hand, recording, q)
        report.add(f"{hand.name}/{name}", figures)
        rows.append([hand.name, name, None, None, None, None, *figures.values()])
    rows.sort(key=lambda row: str(row[0]))
    header = ("hand", "program", "p50 [ms]", "p95 [ms]", "p99 [ms]", "start [s]")
    title = f"{len(recording)} frames; {settings.repeats} processes of each"
    report.table(title, (*header, *QUALITY.values(), "beyond limits"), rows)
    report.notes.append(
        "start: from the start of the process to its first command, median, everything cached that "
        "a program caches. beyond limits: share of frames with a joint outside our model's range"
    )
    report.finish(settings.output, settings.compare)


def make_programs(settings: Settings, report: Report) -> list[Program]:
    """Makes the programs that have an environment, and notes the others in the report."""
    here = Path(sys.executable)
    programs = [
        Program(hand, f"`{method}`", here, ("smooth-operator", "--hand", hand, "--method", method))
        for hand in ("wuji_hand", *DEX_HANDS, "mimic_p050")
        for method in settings.methods
    ]
    if settings.wuji_python is None:
        report.notes.append("left out: wuji_sdk, for which --wuji-python names no environment")
    else:
        programs.append(Program("wuji_hand", "wuji_sdk", settings.wuji_python, ("wuji-sdk",)))
    if settings.dex_python is None or settings.dex_urdf is None:
        report.notes.append("left out: dex-retargeting, which needs --dex-python and --dex-urdf")
    else:
        python, more = settings.dex_python, ("--urdf", str(settings.dex_urdf))
        programs += [
            Program(
                hand,
                f"dex-retargeting {kind}",
                python,
                ("dex-retargeting", "--hand", hand, "--method", kind, *more),
            )
            for hand in DEX_HANDS
            for kind in ("vector", "dexpilot")
        ]
    if settings.authors is None:
        report.notes.append("left out: the authors' commands, for which --authors names no folder")
    return programs


def run(program: Program, recording: Path, at: Path, *, counted: bool) -> str:
    """Runs one process and adds its figures to the program's; returns the reason of a failure."""
    output = at / "commands.npz"
    kind, *more = program.arguments
    environ = QUIET
    if kind != "smooth-operator":
        environ = environ | {"PYTHONPATH": "", "HOME": str(at)}  # it leaves no files behind
    started = time.time()
    try:
        answer = child_json([program.python, WORKER, kind, recording, output, *more], environ)
    except BenchmarkError as error:
        return str(error).splitlines()[-1]
    with np.load(output) as file:
        q, names, ms = file["q"], file["names"].tolist(), file["ms"]
    hand = load_hand(program.hand, "right")
    if kind == "dex-retargeting":
        names, q = in_our_joints(hand, names, q)
    if missing := set(hand.joint_names) - set(names):
        return f"it has no {sorted(missing)}; its joints are {names}"
    program.q = q[:, [names.index(name) for name in hand.joint_names]]
    if counted:
        program.ms.append(ms)
        program.starts.append(answer["first"] - started)
    return ""


def in_our_joints(hand: Hand, names: list[str], q: np.ndarray) -> tuple[list[str], np.ndarray]:
    """Converts commands for the URDFs of dex-urdf to the joint names and zeros of our models."""
    if hand.name == "shadow_hand":
        return [f"rh_{name}" for name in names], q
    if hand.name == "allegro_hand":
        ours = {f"joint_{i}.0": name for i, name in enumerate(hand.joint_names)}
        return [ours[name] for name in names], np.where(
            np.array(names) == "joint_12.0", q + ALLEGRO_ZERO_RAD, q
        )
    return names, q


def authors(settings: Settings, report: Report) -> list[tuple[Hand, str, np.ndarray]]:
    """Commands of the authors' code for these frames, by method."""
    if settings.authors is None:
        return []
    hand = load_hand("mimic_p050", "right")
    first, _, last = settings.frames.partition(":")
    rows = []
    for path in sorted(settings.authors.glob(f"*_frames-{first}-{last}.npz")):
        with np.load(path) as file:
            q, names = file["joint_positions"].astype(float), file["joint_names"].tolist()
        order = [names.index(name) for name in hand.joint_names]
        rows.append((hand, f"authors' {path.name.split('_subject')[0]}", q[:, order]))
    if not rows:
        report.notes.append(f"left out: {settings.authors} has no commands for these frames")
    return rows


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


def judged(hand: Hand, recording: HandRecording, q: np.ndarray) -> dict[str, float | None]:
    """Our metrics of commands, on our model of the hand."""
    commands = CommandTrajectory(
        q, hand.joint_names, recording.stamps, np.zeros(len(q)), np.zeros(len(q), int)
    )
    alignment = method_config("smooth", None).alignment
    figures = evaluate(assemble_trace(recording, commands, hand, alignment, reach_samples=0))
    low, high = hand.joint_limits.T
    outside = ((q < low - BEYOND_RAD) | (q > high + BEYOND_RAD)).any(axis=1)
    values: dict[str, float | None] = {
        name: float(value) if isinstance(value := figures[name], float | int) else None
        for name in QUALITY
    }
    return values | {"beyond_limits": float(outside.mean())}


if __name__ == "__main__":
    run_program(main, Settings, __doc__)
