"""Facts of ``smooth-operator doctor``: the machine, versions, extras, kept programs."""

from __future__ import annotations

import contextlib
import os
import platform
import re
from importlib.metadata import PackageNotFoundError, requires, version
from pathlib import Path
from typing import Any, Final

from smooth_operator.extras import DISTRIBUTION
from smooth_operator.own_files import SWITCH, folder_problem, user_cache
from smooth_operator.retargeting.program_cache import is_off, program_cache

_LIBRARIES: Final = ("jax", "jaxlib", "mujoco", "numpy", "scipy")
_OPENCV: Final = tuple(
    f"opencv-{part}"
    for part in ("python", "python-headless", "contrib-python", "contrib-python-headless")
)
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
