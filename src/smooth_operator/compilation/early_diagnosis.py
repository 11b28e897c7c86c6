"""A start with nothing kept that answers early, measured: ``smooth-operator doctor`` and
``benchmarks/startup.py``."""

from __future__ import annotations

import json
import os
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from smooth_operator.compilation.diagnosis import measured_by
from smooth_operator.synthetic import SyntheticOperator

RATE_HZ: Final = 50.0
"""Frames a second of the built-in operator."""
_LONGEST_S: Final = 120.0

_CHILD: Final = """
import sys, time
job, started = sys.argv[1:]
import json
import numpy as np
from smooth_operator import HandFrame, Retargeter, Status
hand, side, method, preset, frames, rate, most = json.loads(job)
early = Retargeter(hand, side=side, method=method, preset=preset, early=True)
from smooth_operator.compilation.early_answers import EarlyAnswers
from smooth_operator.compilation.first_stage import FirstStage
side, points, actuated = early.hand.spec.side, np.load(frames), list(early.hand.actuated)
live, begin, k, states, sent = early.live, time.time(), 0, [], []
first = full = own = worst = further = 0.0
state = live.init()
assert isinstance(live, EarlyAnswers)
while time.time() - begin < most:
    wait = begin + k / rate - time.time()
    if wait > 0:
        time.sleep(wait)
    frame = HandFrame(points[k % len(points)], k / rate, side)
    before, at = state, time.perf_counter()
    state, result = live.step(state, frame)
    now, took = time.time() - float(started), 1e3 * (time.perf_counter() - at)
    q = result.command.positions[actuated]
    if result.status != Status.OK:
        sys.exit(f"a frame was not answered: {result.status.reason}")
    first = first or now
    if state.begun and not full:
        full = now
        if before.q is not None:
            stage = FirstStage(early.hand, early.config.alignment, tuple(early.method.needs))
            staged = stage(frame.landmarks, frame.valid, before.q, 1 / rate).q
            further = float(np.abs(q - staged).max())
    elif not full:
        worst = max(worst, took)
    elif before.offset is not None:
        left = 0.0 if state.offset is None else state.offset
        alone = np.abs((q - left) - (before.q - before.offset))
        further = max(further, float((np.abs(q - before.q) - alone).max()))
    k += 1
    if full and not result.provisional:
        own = now
        break
else:
    sys.exit(f"the program was not there after {most:g} s")
print(json.dumps([first, full, own, k, worst, further]))
"""


@dataclass(frozen=True)
class EarlyStart:
    """What a fresh process did that had nothing kept, and answered frames from the first on.

    Attributes:
        first_command: from its start to its first command [s].
        full_program: to the first frame that the method answered [s].
        own_commands: to the first command that is the method's alone [s].
        frames: answered until then.
        worst_ms: longest time of a frame that only the first stage answered [ms].
        step_rad: most that a joint moved in a frame because of the hand-over [rad].
    """

    first_command: float
    full_program: float
    own_commands: float
    frames: int
    worst_ms: float
    step_rad: float


def early_start(hand: str, side: str | None, method: str, preset: str | None) -> EarlyStart:
    """Starts a process with an empty cache that answers the built-in operator's frames.

    Raises:
        SmoothOperatorError: it failed, with what it said.
    """
    operator = SyntheticOperator(side="left" if side == "left" else "right", rate_hz=RATE_HZ)
    with tempfile.TemporaryDirectory() as folder:
        frames = Path(folder) / "frames.npy"
        np.save(frames, operator.record(20.0).landmarks)
        environment = {
            **os.environ,
            "SMOOTH_OPERATOR_CACHE": str(Path(folder) / "cache"),
            "JAX_ENABLE_COMPILATION_CACHE": "false",
        }
        job = json.dumps([hand, side, method, preset, str(frames), RATE_HZ, _LONGEST_S])
        measured = measured_by(
            _CHILD,
            job,
            str(time.time()),
            failed="a fresh process could not answer early",
            environment=environment,
        )
    first, full, own, count, worst, step = measured
    return EarlyStart(first, full, own, int(count), worst, step)
