"""``smooth-operator doctor``: reports on the machine, versions and extras, and suggests changes."""

from __future__ import annotations

import os
import platform
import re
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, requires, version
from pathlib import Path
from typing import Any, ClassVar, Final

from smooth_operator.cli.common_options import Common
from smooth_operator.extras import DISTRIBUTION
from smooth_operator.formats.environment import processor
from smooth_operator.own_files import folder_problem
from smooth_operator.parallel import usable_cores
from smooth_operator.user_folders import SWITCH, is_off, user_cache


@dataclass(frozen=True, kw_only=True)
class Doctor(Common):
    """Check this machine, its extras and settings, and suggest fixes."""

    work: ClassVar[str] = "smooth_operator.cli.doctor:doctor"
    details: ClassVar[str] = """Prints the machine, versions, extras, priority and the folder of
compiled programs. The exit status is always 0. To measure the time of a frame, use `bench`.

Examples:
  smooth-operator doctor
  smooth-operator doctor --json"""

    json: bool = False
    """Print one JSON object on standard output instead of the table."""


def doctor(options: Doctor) -> None:
    """Prints facts about the machine as a table or JSON, and suggested changes."""
    from smooth_operator.cli.console import output_console, plain_table
    from smooth_operator.io.jsonable import to_json
    from smooth_operator.teleop.runtime.priority import going_first

    with going_first() as priority:
        pass
    report = environment() | {"priority": priority}
    advice = _advice(report)
    if options.json:
        print(to_json({"environment": report, "advice": advice}, indent=2))
        return
    console = output_console()
    rows = ((n.replace("_", " "), "-" if v is None else str(v)) for n, v in report.items())
    console.print(plain_table("Machine", ("", "found"), rows))
    for line in advice or ["Nothing to change."]:
        console.print(f"{'! ' if advice else ''}{line}", markup=False, soft_wrap=True)


def _advice(report: Mapping[str, object]) -> list[str]:
    """Suggested changes; empty if there are none."""
    advice = []
    if str(report["programs"]).startswith("not kept"):
        advice.append(
            f"compiled programs are {report['programs']}, so every start compiles them again; set "
            "SMOOTH_OPERATOR_CACHE to a folder that only you can write to, or unset it"
        )
    load, cores = report["load"], report["cores"]
    if isinstance(load, float) and isinstance(cores, int) and load > cores:
        advice.append(
            f"the load is {load:.1f} on {cores} cores: other programs take time from the loop"
        )
    if cores == 1:
        advice.append(
            "the loop, the page and the tracker share one core: give the process at least two cores"
        )
    if report["priority"] != "real-time" and report["system"] == "Linux":
        advice.append(
            "real-time priority is not granted, so `teleop --priority high` has no effect: add "
            "'USER - rtprio 20' to /etc/security/limits.conf and log in again"
        )
    if report["governor"] == "powersave":
        advice.append(
            "the processor is in a power-saving mode; to change it: sudo cpupower frequency-set "
            "-g performance"
        )
    if "," in str(report["opencv"]):
        advice.append(
            f"{report['opencv']} are installed in one folder, where the last one overwrites "
            "the others: keep only one (see Problems in docs/how-to/webcam.md)"
        )
    if report["device"] not in ("cpu", None):
        advice.append(
            f"frames run on {report['device']}, which is efficient for many hands at once; for a "
            "single hand, try JAX_PLATFORMS=cpu"
        )
    return advice


_LIBRARIES: Final = ("jax", "jaxlib", "mujoco", "numpy", "scipy")
_OPENCV: Final = tuple(
    f"opencv-{part}"
    for part in ("python", "python-headless", "contrib-python", "contrib-python-headless")
)
"""Distributions that install into one folder, ``cv2``, and overwrite each other there."""
_EXTRAS: Final = ("teleop", "training")


def environment() -> dict[str, Any]:
    """Describes the machine, versions and extras, and where compiled programs are kept."""
    import jax

    from smooth_operator.retargeting.program_store import ProgramStore

    store = ProgramStore.of_user()
    reason = f"{SWITCH} is off" if is_off() else _why_not_kept()
    sizes = [] if store is None else [file.stat().st_size for file in store.folder.iterdir()]
    return {
        "system": platform.system(),
        "machine": platform.machine(),
        "processor": processor(),
        "cores": usable_cores(),
        "load": round(os.getloadavg()[0], 1) if hasattr(os, "getloadavg") else None,
        "governor": _line(Path("/sys/devices/system/cpu/cpu0/cpufreq/scaling_governor")),
        "python": platform.python_version(),
        **{name: _version(name) for name in (DISTRIBUTION, *_LIBRARIES)},
        "opencv": ", ".join(f"{n} {_version(n)}" for n in _OPENCV if _version(n)) or None,
        "extras": ", ".join(extra for extra in _EXTRAS if not _missing(extra)) or None,
        "device": jax.default_backend(),
        "programs": f"not kept: {reason}" if store is None else str(store.folder),
        "programs_kept": len(sizes),
        "programs_mb": round(sum(sizes) / 1e6),
    }


def _why_not_kept() -> str:
    try:
        problem = folder_problem(user_cache() / "programs")
    except OSError:
        problem = ""
    return problem or f"{str(user_cache())!r} is not writable"


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


def _line(path: Path) -> str | None:
    try:
        return path.read_text(encoding="utf-8").strip()
    except OSError:
        return None
