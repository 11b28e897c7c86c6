"""How long a command waits while a running loop gets another method.

    python research/benchmarks/switch.py

The built-in operator's frames come at 100 Hz; the loop runs as ``teleop`` runs it, without a page.
Each switch is measured twice: first with nothing kept of the method that is asked for, and then, in
the next process, with its program kept. What is said of a command is how long after its frame came
it had left; where none came, after it was due. From the request to half a second after the switch.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import threading
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import tyro

from smooth_operator_research.run_report import BenchmarkError, Report

QUIET_S = 0.5
"""Before a switch is asked for, and after it was done [s]."""


@dataclass(frozen=True)
class Settings:
    """What to run.

    Attributes:
        methods: ``method`` or ``method:preset``; the loop begins with the first.
        repeats: fresh processes with each state of the cache.
        hand: robot hand.
        priority: of the loop, as ``teleop`` has it; ``high`` is real-time where it may.
        output: JSON file; build/benchmarks/switch.json unless given.
        compare: an earlier JSON file to compare this run with.
    """

    methods: tuple[str, ...] = ("smooth", "sbr", "smooth:grasp", "dexpilot")
    repeats: int = 3
    hand: str = "mimic_p050"
    priority: Literal["normal", "high"] = "normal"
    output: Path | None = None
    compare: Path | None = None


def main(settings: Settings) -> None:
    report = Report("switch", vars(settings))
    rows = []
    runs: dict[tuple[str, str], list[dict[str, float]]] = {}
    for _ in range(settings.repeats):
        with tempfile.TemporaryDirectory() as folder:
            for state in ("nothing kept", "kept"):
                for name, figures in measured(settings, folder).items():
                    runs.setdefault((name, state), []).append(figures)
    for (name, state), latencies in runs.items():
        middle = {key: float(np.median([each[key] for each in latencies])) for key in latencies[0]}
        worst = max(each["worst_ms"] for each in latencies)
        report.add(f"{name}/{state}", middle | {"worst_of_all_ms": worst})
        rows.append([name, state, middle["seconds"], middle["p50_ms"], middle["worst_ms"], worst])
    report.table(
        f"Switches in a running loop, medians of {settings.repeats}",
        ("to", "programs", "took [s]", "p50 [ms]", "worst [ms]", "worst of all [ms]"),
        rows,
    )
    report.finish(settings.output, settings.compare)


def measured(settings: Settings, folder: str) -> dict[str, dict[str, float]]:
    """One run of the loop in a process of its own: name of a switch -> figures."""
    environment = {k: v for k, v in os.environ.items() if "CACHE" not in k}
    environment["SMOOTH_OPERATOR_CACHE"] = folder
    job = json.dumps([settings.hand, settings.methods, settings.priority])
    child = subprocess.run(
        [sys.executable, __file__, "--child", job],
        capture_output=True, text=True, env=environment, check=False,
    )  # fmt: skip
    if child.returncode:
        raise BenchmarkError(f"the measured process failed:\n{child.stderr}")
    figures: dict[str, dict[str, float]] = json.loads(child.stdout.splitlines()[-1])
    return figures


def child(hand: str, methods: list[str], priority: Any) -> dict[str, dict[str, float]]:
    """Runs the loop, asks for the methods in turn, and looks at the commands meanwhile."""
    from smooth_operator.teleop import run
    from smooth_operator.teleop.control import method_switcher

    retargeters: list[Any] = []
    plain = run.MethodSwitcher

    class Kept(method_switcher.MethodSwitcher):
        def __init__(self, *arguments: Any) -> None:
            super().__init__(*arguments)
            retargeters.append(self)

    run.MethodSwitcher = Kept  # type: ignore[misc]
    late: list[tuple[float, float]] = []
    figures: dict[str, dict[str, float]] = {}
    last: list[float] = []

    def started(loop: Any) -> None:
        def watch(tick: Any) -> None:
            now = loop.mailbox.clock()
            due = tick.arrival.received if tick.arrival else (last[0] + 0.01 if last else now)
            late.append((now, (now - due) * 1e3))
            last[:] = [now]

        loop.watch = watch
        threading.Thread(target=ask, args=(loop,), daemon=True).start()

    def ask(loop: Any) -> None:
        try:
            time.sleep(3 * QUIET_S)
            for name in methods[1:]:
                method, _, preset = name.partition(":")
                begin = loop.mailbox.clock()
                retargeters[0].choose(method, preset or None).result(120)
                end = loop.mailbox.clock()
                time.sleep(QUIET_S)
                times = [ms for at, ms in list(late) if at >= begin]
                figures[name] = {
                    "seconds": end - begin,
                    "p50_ms": float(np.median(times)),
                    "worst_ms": max(times),
                }
        finally:
            loop.controls.quit()

    method, _, preset = methods[0].partition(":")
    run.teleoperate(
        "synthetic",
        hand=hand,
        method=method,
        preset=preset or None,
        priority=priority,
        methods=(methods[0],),
        started=started,
    )
    run.MethodSwitcher = plain  # type: ignore[misc]
    return figures


if __name__ == "__main__":
    if sys.argv[1:2] == ["--child"]:
        print(json.dumps(child(*json.loads(sys.argv[2]))))
    else:
        main(tyro.cli(Settings, description=__doc__))
