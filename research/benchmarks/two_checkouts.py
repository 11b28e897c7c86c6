"""Latency of two checkouts of this package, whose processes take turns.

    python research/benchmarks/two_checkouts.py OLD/.venv/bin/python NEW/.venv/bin/python \
        --recording GLOVE.npz

Each interpreter has one checkout installed. A turn is a block of frames of one of them; the ratio
of a pair of turns is of medians, and the interval is a bootstrap over the pairs. Noise that lasts
longer than a turn hits both alike. Only names are used that have not changed since 0.1.0.
"""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro

from smooth_operator_research.run_report import Report, percentiles

WORKER = """
import json, sys, time, warnings
warnings.simplefilter("ignore")
import smooth_operator as so
path, hand = sys.argv[1], sys.argv[2]
recording = so.read_recording(path) if path else so.SyntheticOperator(seed=1).record(8.0)
frames = list(recording)
for line in sys.stdin:
    word, *rest = line.split()
    if word == "use":
        method, _, preset = rest[0].partition(":")
        retargeter = so.Retargeter(hand, config=so.method_config(method, preset or None))
        retargeter.warm_up()
        state, at = retargeter.init(), 0
        print("[]", flush=True)
        continue
    times = []
    for _ in range(int(rest[0])):
        if at == len(frames):
            state, at = retargeter.init(), 0
        before = time.perf_counter()
        state, _ = retargeter.step(state, frames[at])
        times.append(1e3 * (time.perf_counter() - before))
        at += 1
    print(json.dumps(times), flush=True)
"""


METHODS = (
    "smooth",
    "sbr",
    "sbr:paper",
    "dexpilot",
    "ako",
    "keyvector",
    "hybrid",
    "joint_angle",
    "geort",
)


@dataclass(frozen=True)
class Settings:
    """Settings of a run.

    Attributes:
        old: interpreter that has the older checkout.
        new: interpreter that has the newer one.
        recording: to retarget; the built-in operator if none is given.
        methods: METHOD or METHOD:PRESET.
        hand: robot hand.
        turns: pairs of turns.
        block: frames in a turn.
        output: JSON file; build/benchmarks/two_checkouts.json unless given.
    """

    old: Annotated[Path, tyro.conf.Positional]
    new: Annotated[Path, tyro.conf.Positional]
    recording: Path | None = None
    methods: tuple[str, ...] = METHODS
    hand: str = "mimic_p050"
    turns: int = 40
    block: int = 40
    output: Path | None = None


class Checkout:
    """A process of one interpreter that retargets frames on request."""

    def __init__(self, python: Path, settings: Settings) -> None:
        recording = "" if settings.recording is None else str(settings.recording.resolve())
        self.process = subprocess.Popen(
            [str(python), "-c", WORKER, recording, settings.hand],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )

    def ask(self, text: str) -> list[float]:
        """Sends a line; returns the answer, times [ms]."""
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        self.process.stdin.write(text + "\n")
        self.process.stdin.flush()
        answer = self.process.stdout.readline()
        if not answer:
            sys.exit(f"{self.process.args!r} ended; its message is above")
        return list(json.loads(answer))


def main(settings: Settings) -> None:
    """Measures and prints."""
    report = Report("two_checkouts", vars(settings))
    both = [Checkout(settings.old, settings), Checkout(settings.new, settings)]
    rows: list[list[object]] = []
    rng = np.random.default_rng(0)
    for method in settings.methods:
        for checkout in both:
            checkout.ask(f"use {method}")
        times: tuple[list[list[float]], list[list[float]]] = ([], [])
        for turn in range(settings.turns + 1):
            for i in (0, 1) if turn % 2 else (1, 0):
                times[i].append(both[i].ask(f"run {settings.block}"))
        old, new = (np.array(blocks[1:]) for blocks in times)  # the first turn warms caches
        ratios = np.median(new, axis=1) / np.median(old, axis=1)
        draws = rng.choice(ratios, (4000, len(ratios)))
        low, high = np.percentile(np.median(draws, axis=1), (2.5, 97.5))
        ratio = float(np.median(ratios))
        figures = [percentiles(blocks.ravel()) for blocks in (old, new)]
        keys = ("p50_ms", "p95_ms", "p99_ms")
        rows.append(
            [method, ratio, low, high, *(figure[key] for figure in figures for key in keys)]
        )
        report.add(method, {"ratio": ratio, "low": float(low), "high": float(high)})
    columns = ("ratio of p50", "95 % from", "to", "old p50 [ms]", "p95", "p99")
    report.table(
        "Latency per frame of two checkouts, in turns",
        ("method", *columns, "new p50 [ms]", "p95", "p99"),
        rows,
    )
    report.finish(settings.output, None)


if __name__ == "__main__":
    main(tyro.cli(Settings, description=__doc__))
