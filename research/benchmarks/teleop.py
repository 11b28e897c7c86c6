"""Long runs of the live loop in separate processes: soak run, or fault run.

A glove simulator sends to ``smooth-operator teleop``, which commands a ZeroMQ socket that a robot's
stand-in listens to, and records. With ``--faults`` everything goes wrong: the glove loses, doubles,
shuffles and garbles frames, falls silent and starts anew, and it and the robot are killed over and
over. Then the recording is held against the limits.

Exit status 1 if a check failed.
"""

from __future__ import annotations

import argparse
import json
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import zmq

from smooth_operator_research.run_report import Report, memory_mib

RATE = 100.0
FAULTS = {
    "drop": 0.1,
    "silence-every": 15,
    "silence": 2.5,
    "missing": 0.03,
    "duplicate": 0.02,
    "reorder": 0.02,
    "swap": 0.02,
    "garbage": 0.02,
    "restart-every": 40,
}
"""Options of ``tests/glove_simulator.py``."""

ROBOT = """
import sys, zmq
socket = zmq.Context().socket(zmq.SUB)
socket.connect(sys.argv[1])
socket.subscribe(b"")
while True:
    socket.recv()
"""


GLOVE = Path(__file__).resolve().parents[2] / "tests" / "glove_simulator.py"


def free_address() -> str:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"tcp://127.0.0.1:{probe.getsockname()[1]}"


@dataclass
class Process:
    """A process that is killed and started again; counts how often."""

    command: list[str]
    running: subprocess.Popen[bytes] | None = None
    starts: int = 0

    def start(self) -> None:
        quiet = subprocess.DEVNULL
        self.running = subprocess.Popen(self.command, stdout=quiet, stderr=quiet)
        self.starts += 1

    def kill(self) -> None:
        if self.running is not None:
            self.running.kill()
            self.running.wait()


class Listener:
    """Detects whether a simulated glove sends; on a busy machine its start takes long."""

    def __init__(self, address: str) -> None:
        self._socket = zmq.Context.instance().socket(zmq.SUB)
        self._socket.connect(address)
        self._socket.subscribe(b"")

    def wait(self, seconds: float) -> None:
        """Waits for a frame."""
        if not self._socket.poll(1e3 * seconds):
            raise SystemExit(f"the glove sent nothing for {seconds:g} s after its start")

    def heard(self) -> bool:
        """True if one came since the last call."""
        received = False
        while self._socket.poll(0):
            self._socket.recv()
            received = True
        return received


@dataclass
class Memory:
    """Resident memory of a process over time [MiB]; empty where the system can't tell."""

    pid: int
    samples: list[tuple[float, float]] = field(default_factory=list)

    def look(self, now: float) -> None:
        if (mib := memory_mib("VmRSS", self.pid)) is not None:
            self.samples.append((now, mib))

    def drift(self) -> float | None:
        """Median of the last fifth minus that of the second fifth [MiB]."""
        values = [mib for _, mib in self.samples]
        fifth = len(values) // 5
        if fifth < 3:
            return None
        return float(np.median(values[-fifth:]) - np.median(values[fifth : 2 * fifth]))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--faults", action="store_true")
    parser.add_argument("--method", default="sbr")
    parser.add_argument("--hand", default="mimic_p050")
    parser.add_argument("--priority", choices=("high", "normal"), default="high")
    parser.add_argument("--keep", type=Path, help="keep the recording here")
    parser.add_argument("--output", type=Path)
    parser.add_argument("--compare", type=Path)
    options = parser.parse_args()
    report = Report("teleop-faults" if options.faults else "teleop", vars(options))
    with tempfile.TemporaryDirectory() as scratch:
        record = options.keep or Path(scratch) / "take.mcap"
        summary, memory, counts = run(options, record)
        checks = judge(record, summary, options)
    drift = memory.drift()
    added, stages = summary["added_latency_ms"], summary["stages_ms"]
    rows = {name: stages.get(name, {}) for name in stages} | {"added: received to sent": added}
    report.table(
        f"{summary['duration_s']:.0f} s at {RATE:g} Hz, {options.method} on {options.hand}",
        ("[ms]", "p50", "p95", "p99", "max"),
        [[name, *(row.get(k) for k in ("p50", "p95", "p99", "max"))] for name, row in rows.items()],
    )
    report.add("added_ms", added)
    figures = {
        "rate_hz": summary["rate_hz"],
        "frames_answered": summary["frames_answered"],
        "frames_received": summary["frames_received"],
        "deadlines_missed_share": summary["deadlines_missed_share"],
        "memory_mib": memory.samples[-1][1] if memory.samples else None,
        "memory_drift_mib": drift,
        **counts,
    }
    report.table("The run", ("", "value"), [[k, v] for k, v in figures.items()])
    report.add("run", figures)
    report.table("Checks on the recording", ("", "held"), [[k, str(v)] for k, v in checks.items()])
    shares = {mode: f"{100 * share:.1f} %" for mode, share in summary["mode_share"].items()}
    report.notes.append(
        f"priority: {summary['priority']}; modes: {shares}; refused: {summary['frames_refused']}"
    )
    report.finish(options.output, options.compare)
    if not all(checks.values()):
        raise SystemExit(1)


def run(
    options: argparse.Namespace, record: Path
) -> tuple[dict[str, Any], Memory, dict[str, float]]:
    """Runs the loop and its sources.

    Returns:
        the loop's own summary, its memory, and how often what was killed.
    """
    gloves, commands = free_address(), free_address()
    faults = [f"--{name}={value}" for name, value in FAULTS.items()] if options.faults else []
    glove = Process([sys.executable, str(GLOVE), "--address", gloves, *faults])
    robot = Process([sys.executable, "-c", ROBOT, commands])
    glove.start()
    robot.start()
    listener = Listener(gloves)
    try:
        listener.wait(60.0)
    except BaseException:
        glove.kill()
        robot.kill()
        raise
    loop = subprocess.Popen(
        [
            sys.executable,
            "-m",
            "smooth_operator",
            "teleop",
            "--source",
            f"manus:{gloves}",
            "--sink",
            f"zmq:{commands}",
            f"record:{record}",
            "--rate",
            str(RATE),
            "--duration",
            str(options.seconds),
            "--method",
            options.method,
            "--hand",
            options.hand,
            "--json",
            "--priority",
            options.priority,
            "--no-view",
        ],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    memory, printed = Memory(loop.pid), []

    def listen() -> None:
        assert loop.stderr is not None
        printed.extend(iter(loop.stderr.readline, ""))

    threading.Thread(target=listen, daemon=True).start()
    try:
        start = time.monotonic()
        turns = sent = 0  # since the glove was started; those in which it sent
        while loop.poll() is None:
            time.sleep(1.0)
            turns, sent = turns + 1, sent + listener.heard()
            memory.look(time.monotonic() - start)
            if options.faults and turns >= 7 and sent >= 3:
                turns = sent = 0
                for process in (glove, robot):
                    process.kill()
                    process.start()
        assert loop.stdout is not None
        out = loop.stdout.read()
    finally:
        for process in (glove, robot):
            process.kill()
        if loop.poll() is None:
            loop.send_signal(signal.SIGINT)
            loop.wait(30)
    if loop.returncode not in (0, 1):
        raise SystemExit(f"teleop ended with {loop.returncode}: {''.join(printed)[-2000:]}")
    counts = {"glove_starts": glove.starts, "robot_starts": robot.starts}
    return json.loads(out), memory, counts


def judge(record: Path, summary: Mapping[str, Any], options: argparse.Namespace) -> dict[str, bool]:
    """Checks the recording."""
    from smooth_operator import load_hand
    from smooth_operator.teleop.recording import read_log
    from smooth_operator.teleop.runtime.settings import LimitsConfig

    log, hand, limits = read_log(record), load_hand(options.hand), LimitsConfig()
    assert log.commands is not None
    assert log.loop is not None
    q, times = log.commands.joint_positions, log.loop.times
    steps, dt = np.abs(np.diff(q, axis=0)).max(axis=1), np.diff(times)
    low, high = hand.joint_limits.T
    stamps = log.commands.stamps
    velocity = np.diff(q, axis=0) / dt[:, None]
    change = np.abs(np.diff(velocity, axis=0)).max(axis=1)
    apart = np.minimum(dt[1:], (dt[1:] + dt[:-1]) / 2)  # of two velocities [s]
    return {
        "the recording is whole": not log.truncated,
        "every tick is in it": bool((np.diff(log.loop.numbers) == 1).all()),
        "no command is outside the limits": bool(((q >= low - 1e-9) & (q <= high + 1e-9)).all()),
        "no step is above the velocity limit": bool(
            (steps <= limits.velocity * dt * (1 + 1e-6) + 1e-9).all()
        ),
        "no step is above the acceleration limit": bool(
            (change <= limits.acceleration * apart * (1 + 1e-6) + 1e-6).all()
        ),
        "stamps never go back": bool((np.diff(stamps) > 0).all()),
        # by what arrived: how much a glove sends that is ended and started again is the machine's
        "the operator was followed": summary["frames_answered"]
        > 0.5 * summary["frames_received"]
        > 0,
        "no sink failed": all(not sink["failed"] for sink in summary["sinks"]),
    }


if __name__ == "__main__":
    main()
