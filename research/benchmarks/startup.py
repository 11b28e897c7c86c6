"""Time from process start to the first command, in fresh processes.

    python research/benchmarks/startup.py --repeats 5

``no cache`` compiles everything; ``cache`` finds JAX's persistent compilation cache filled by an
earlier process; ``kept`` finds the traced program, too, as the command does. Files of the packages
are in the system's page cache in all of them, and byte-compiled.
"""

from __future__ import annotations

import json
import os
import sys
import tempfile
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from smooth_operator.synthetic import SyntheticOperator
from smooth_operator_research.run_report import Report, ReportSettings, child_json, run_program

CHILD = Path(__file__).with_name("first_command.py")
STATES = ("no cache", "cache", "kept")
STAGES = {
    "interpreter_s": "interpreter",
    "import_jax_s": "import jax",
    "import_package_s": "import package",
    "load_hand_s": "load hand",
    "build_s": "build method",
    "trace_s": "trace, lower",
    "compile_s": "compile",
    "cache_read_s": "read cache",
    "first_call_rest_s": "rest of first call",
    "total_s": "total",
    "cpu_s": "of the processor",
}


@dataclass(frozen=True)
class Settings(ReportSettings):
    """Settings of a run.

    Attributes:
        presets: which presets.
        repeats: fresh processes for each; medians are reported.
        hand: robot hand.
        method: retargeting method.
    """

    presets: tuple[str, ...] = ("paper", "realtime")
    repeats: int = 5
    hand: str = "mimic_p050"
    method: str = "sbr"


def main(settings: Settings) -> None:
    report = Report("startup", vars(settings))
    landmarks = SyntheticOperator().record(0.1).landmarks[-1]
    stages, memory = [], []
    with tempfile.TemporaryDirectory() as folder:
        job = {"hand": settings.hand, "method": settings.method, "landmarks": landmarks.tolist()}
        # byte-compile, fill the page cache
        first_command(job | {"preset": settings.presets[0]}, "no cache", Path(folder))
        for preset in settings.presets:
            cache = Path(folder) / preset
            runs: dict[str, list[Mapping[str, float]]] = {state: [] for state in STATES}
            for state in STATES:  # fill the caches
                first_command(job | {"preset": preset}, state, cache)
            for _ in range(settings.repeats):  # in turn, so that noise hits all alike
                for state, results in runs.items():
                    results.append(first_command(job | {"preset": preset}, state, cache))
            for name, results in runs.items():
                middle = {k: float(np.median([r[k] for r in results])) for k in results[0]}
                worst = max(r["total_s"] for r in results)
                report.add(f"{preset}/{name}", middle | {"worst_total_s": worst})
                stages.append([f"{preset}, {name}", *(middle[k] for k in STAGES), worst])
                memory.append([f"{preset}, {name}", middle.get("peak_mib"), middle["cache_hits"]])
    report.table(
        f"Process start to first command [s], medians of {settings.repeats}",
        ("preset", *STAGES.values(), "worst total"),
        stages,
    )
    report.table("Memory", ("preset", "peak resident [MiB]", "programs from the cache"), memory)
    report.notes.append(
        "trace, lower and compile add up over all programs that JAX builds on the way; 'rest of "
        "first call' is what remains of warm-up and first frame."
    )
    report.finish(settings.output, settings.compare)


def first_command(job: Mapping[str, object], state: str, cache: Path) -> dict[str, float]:
    """Runs the child process once; returns the times of its stages [s]."""
    environment: dict[str, str | None] = {name: None for name in os.environ if "CACHE" in name}
    environment |= {"SMOOTH_OPERATOR_CACHE": "off", "JAX_ENABLE_COMPILATION_CACHE": "false"}
    if state != "no cache":
        environment |= {
            "JAX_ENABLE_COMPILATION_CACHE": "true",
            "JAX_COMPILATION_CACHE_DIR": str(cache),
            "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
            "JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES": "-1",
        }
    if state == "kept":
        environment["SMOOTH_OPERATOR_CACHE"] = str(cache / "kept")
    start = time.time()  # wall clock: the child's own counters start with the child
    text = json.dumps({**job, "start": start})
    stages: dict[str, float] = child_json([sys.executable, CHILD], environment, text)
    return stages


if __name__ == "__main__":
    run_program(main, Settings, __doc__)
