"""How long a start and a frame take here: what ``smooth-operator doctor`` measures."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from smooth_operator.errors import SmoothOperatorError
from smooth_operator.methods.retargeter import Retargeter
from smooth_operator.synthetic import SyntheticOperator

_CHILD: Final = """
import time
clock = time.time
marks = [clock()]
import jax
marks.append(clock())
from smooth_operator import HandFrame, Retargeter
marks.append(clock())
import json, sys
hand, side, method, preset, landmarks, started = json.loads(sys.argv[1])
marks[0:0] = [started]
begin = clock()
retargeter = Retargeter(hand, side=side, method=method, preset=preset)
marks.append(marks[-1] + clock() - begin)
begin = clock()
retargeter(HandFrame(landmarks, 0.0, retargeter.hand.spec.side))
marks.append(marks[-1] + clock() - begin)
print(json.dumps([b - a for a, b in zip(marks, marks[1:])]))
"""
"""From the start of a process to its first command, timed."""


@dataclass(frozen=True)
class StartTimes:
    """What a fresh process did until its first command [s].

    Attributes:
        interpreter: until Python ran the first line.
        import_jax: JAX and NumPy.
        import_package: this package and MuJoCo.
        build: the hand read, the method made.
        first_frame: the program read, or traced and compiled, and run.
        total: all of them.
    """

    interpreter: float
    import_jax: float
    import_package: float
    build: float
    first_frame: float
    total: float


@dataclass(frozen=True)
class FrameTimes:
    """How long frames took in a process that has nothing else to do [ms].

    Attributes:
        count: how many.
        p50_ms, p99_ms, worst_ms: of their times.
    """

    count: int
    p50_ms: float
    p99_ms: float
    worst_ms: float


def measured_by(
    code: str, *arguments: str, failed: str, environment: Mapping[str, str] | None = None
) -> list[float]:
    """What a fresh process measured: the list of numbers in JSON that it printed last.

    Args:
        code: what it runs.
        arguments: of the code.
        failed: what is said if it fails, before its own last line.
        environment: of the process; None for this one's.

    Raises:
        SmoothOperatorError: it failed.
    """
    done = subprocess.run(
        [sys.executable, "-c", code, *arguments],
        capture_output=True, text=True, check=False, env=environment,
    )  # fmt: skip
    if done.returncode:
        said = (done.stderr.strip().splitlines() or ["-"])[-1]
        raise SmoothOperatorError(f"{failed}: {said}")
    found: list[float] = json.loads(done.stdout.splitlines()[-1])
    return found


def start_times(hand: str, side: str | None, method: str, preset: str | None) -> StartTimes:
    """Starts a process as a script of the user's would be, and times its parts.

    Raises:
        SmoothOperatorError: it failed, with what it said.
    """
    landmarks = SyntheticOperator(side="left" if side == "left" else "right").record(0.1).landmarks
    job = [hand, side, method, preset, landmarks[-1].tolist(), time.time()]
    times = measured_by(_CHILD, json.dumps(job), failed="a fresh process could not retarget")
    interpreter, jax, package, build, frame = parts = times
    return StartTimes(interpreter, jax, package, build, frame, sum(parts))


def frame_times(
    hand: str, side: str | None, method: str, preset: str | None, count: int
) -> FrameTimes:
    """Times frames of the built-in operator at 100 Hz, after the first."""
    retargeter = Retargeter(hand, side=side, method=method, preset=preset)
    operator = SyntheticOperator(side=retargeter.hand.spec.side, rate_hz=100)
    commands, _ = retargeter.run(operator.record((count + 1) / 100)[: count + 1])
    times = np.asarray(commands.latency_ms)[1:]
    p50, p99 = np.percentile(times, (50, 99))
    return FrameTimes(len(times), float(p50), float(p99), float(times.max()))
