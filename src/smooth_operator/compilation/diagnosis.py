"""Measurements of ``smooth-operator doctor``: the machine, the start of a process, a frame."""

from __future__ import annotations

import contextlib
import json
import os
import platform
import re
import subprocess
import sys
import time
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, requires, version
from pathlib import Path
from typing import Any, Final

import numpy as np

from smooth_operator.compilation.cache import is_off, program_cache
from smooth_operator.errors import SmoothOperatorError
from smooth_operator.extras import DISTRIBUTION
from smooth_operator.methods.retargeter import Retargeter
from smooth_operator.own_files import SWITCH, folder_problem, user_cache
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
    """Times of a fresh process until its first command [s].

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
    """Times of frames in an idle process [ms].

    Attributes:
        count: number of frames.
        p50_ms, p99_ms, worst_ms: of their times.
    """

    count: int
    p50_ms: float
    p99_ms: float
    worst_ms: float


def start_times(hand: str, side: str | None, method: str, preset: str | None) -> StartTimes:
    """Starts a process as a script of the user's would be, and times its parts.

    Raises:
        SmoothOperatorError: it failed, with what it said.
    """
    landmarks = SyntheticOperator(side="left" if side == "left" else "right").record(0.1).landmarks
    job = [hand, side, method, preset, landmarks[-1].tolist(), time.time()]
    done = subprocess.run(
        [sys.executable, "-c", _CHILD, json.dumps(job)], capture_output=True, text=True, check=False
    )
    if done.returncode:
        reason = (done.stderr.strip().splitlines() or ["-"])[-1]
        raise SmoothOperatorError(f"a fresh process could not retarget: {reason}")
    interpreter, jax, package, build, frame = parts = json.loads(done.stdout.splitlines()[-1])
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


_LIBRARIES: Final = ("jax", "jaxlib", "mujoco", "numpy", "scipy")
_OPENCV: Final = tuple(
    f"opencv-{part}" for part in ("python", "python-headless", "contrib-python",
                                  "contrib-python-headless")
)  # fmt: skip
"""Distributions that install into one folder, ``cv2``, and overwrite each other there."""
_WINGS: Final = ("teleop", "lab")


def environment() -> dict[str, Any]:
    """Machine, versions, extras, and where compiled programs are kept."""
    import jax

    cache = program_cache()
    reason = f"{SWITCH} is off" if is_off() else _why_not_kept()
    count, size = (0, 0) if cache is None else cache.size()
    return {
        "system": platform.system(),
        "machine": platform.machine(),
        "processor": _processor(),
        "cores": len(os.sched_getaffinity(0))
        if hasattr(os, "sched_getaffinity")
        else os.cpu_count(),
        "load": round(os.getloadavg()[0], 1) if hasattr(os, "getloadavg") else None,
        "governor": _line(Path("/sys/devices/system/cpu/cpu0/cpufreq/scaling_governor")),
        "python": platform.python_version(),
        **{name: _version(name) for name in (DISTRIBUTION, *_LIBRARIES)},
        "opencv": ", ".join(f"{n} {_version(n)}" for n in _OPENCV if _version(n)) or None,
        "extras": ", ".join(wing for wing in _WINGS if not _missing(wing)) or None,
        "device": jax.default_backend(),
        "programs": f"not kept: {reason}" if cache is None else str(cache.folder),
        "programs_kept": count,
        "programs_mb": round(size / 1e6),
    }


def _why_not_kept() -> str:
    try:
        problem = folder_problem(user_cache() / "programs")
    except OSError:
        problem = ""
    return problem or f"{str(user_cache())!r} can't be written"


def _version(name: str) -> str | None:
    try:
        return version(name)
    except PackageNotFoundError:
        return None


def _missing(extra: str) -> list[str]:
    """Libraries of an extra that are not installed."""
    try:
        requirements = requires(DISTRIBUTION) or []
    except PackageNotFoundError:
        return [DISTRIBUTION]
    names = [
        re.split(r"[^\w.-]", each)[0]
        for each in requirements
        if re.search(rf"extra == ['\"]{extra}['\"]", each)
    ]
    return [name for name in names if name != DISTRIBUTION and _version(name) is None]


def _processor() -> str | None:
    with contextlib.suppress(OSError), Path("/proc/cpuinfo").open(encoding="utf-8") as lines:
        for line in lines:
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or None


def _line(path: Path) -> str | None:
    try:
        return path.read_text(encoding="utf-8").strip()
    except OSError:
        return None
