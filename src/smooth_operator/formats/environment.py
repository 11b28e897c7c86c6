"""Records the versions and hardware on which a result depends; they are stored with every
result."""

from __future__ import annotations

import contextlib
import functools
import platform
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from smooth_operator.parallel import usable_cores
from smooth_operator.version import package_version

PACKAGES = ("jax", "jaxlib", "mujoco", "numpy", "scipy")


def environment() -> dict[str, Any]:
    """Returns versions, machine and date."""
    return {
        "versions": versions(),
        "platform": platform.platform(),
        "cpu": processor(),
        "cpu_cores": usable_cores(),
        "device": _device(),
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
    }


def versions() -> dict[str, str]:
    """Returns the versions of Python, of this program and of the libraries used for computing."""
    return {
        "python": platform.python_version(),
        "smooth-operator": package_version(),
        **{package: _version(package) for package in PACKAGES},
    }


@functools.cache
def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "unknown"


def processor() -> str:
    """Returns the name of the processor."""
    with contextlib.suppress(OSError):
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()


def _device() -> str:
    import jax

    device = jax.devices()[0]
    return f"{device.platform}: {device.device_kind}"
