"""What a second hand costs the live loop: time until the commands of both hands are out.

    python research/benchmarks/both_hands.py RECORDING.npz --hand mimic_p050

A tracker posts a frame of one hand, or of both together, at a pace; the loop answers. Loops with
one hand and with both take turns. The left hand's frames are the right one's, mirrored, half a
recording later.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tyro
from timing import percentiles

from smooth_operator import HandFrame, SmoothOperatorError
from smooth_operator.compilation.start import build_retargeter
from smooth_operator.formats.readers import read_recording
from smooth_operator.hands.hand import Hand
from smooth_operator.hands.registry import load_hand
from smooth_operator.methods.presets import method_config
from smooth_operator.methods.retargeter import Retargeter
from smooth_operator.synthetic import SyntheticOperator
from smooth_operator.teleop.runtime.loop import TeleopLoop
from smooth_operator.teleop.runtime.pipeline import HandPipeline
from smooth_operator.teleop.runtime.priority import going_first, low_jitter
from smooth_operator.teleop.runtime.settings import LoopConfig
from smooth_operator.teleop.sinks.runner import SinkRunner
from smooth_operator.teleop.sinks.sink import Sink
from smooth_operator.teleop.sinks.tick import Tick
from smooth_operator.teleop.sources.live import Running, SourceHealth, ThreadedSource
from smooth_operator.types import Side
from smooth_operator_research.run_report import BenchmarkError, Report

RIGHT, BOTH = "one hand", "both hands"


@dataclass(frozen=True)
class Settings:
    """What to run.

    Attributes:
        recording: file to play; none for the built-in operator.
        hand: robot hand, on both sides.
        method: retargeting method.
        preset: of the method; its default if left out.
        rate: frames a second of each hand [Hz].
        frames: how many of each hand in one turn.
        turns: how often each loop has its turn.
        first: asks the system for real-time priority, as teleop does.
        output: JSON file; build/benchmarks/both_hands.json unless given.
        compare: an earlier JSON file to compare this run with.
    """

    recording: Annotated[Path | None, tyro.conf.Positional] = None
    hand: str = "mimic_p050"
    method: str = "smooth"
    preset: str | None = None
    rate: float = 100.0
    frames: int = 200
    turns: int = 3
    first: bool = True
    output: Path | None = None
    compare: Path | None = None


@dataclass
class Together(ThreadedSource):
    """Frames of all hands, posted together at a pace."""

    frames: list[tuple[HandFrame, ...]]
    rate: float
    posted: list[float] = field(default_factory=list)
    label: str = "together"

    def run(self, running: Running) -> None:
        """Post the frames when they are due."""
        running.health = SourceHealth("running")
        start = time.perf_counter()
        for i, together in enumerate(self.frames):
            if running.stopping.wait(max(start + i / self.rate - time.perf_counter(), 0)):
                return
            self.posted.append(time.perf_counter())
            for frame in together:
                running.mailbox.post(frame, received=self.posted[-1])


@dataclass
class Out(Sink):
    """When the answer to each frame was out."""

    sent: dict[tuple[Side, float], float] = field(default_factory=dict)
    label: str = "out"

    def open(self, hands: Mapping[Side, Hand], config: Mapping[str, Any]) -> None:
        """Nothing to open."""

    def send(self, tick: Tick) -> None:
        """Keep the time."""
        if tick.arrival is not None:
            self.sent[tick.side, tick.arrival.received] = time.perf_counter()

    def close(self) -> None:
        """Nothing to close."""


def main(settings: Settings) -> None:
    report = Report("both_hands", vars(settings))
    frames = load(settings)
    config = method_config(settings.method, settings.preset)
    sides: tuple[Side, ...] = ("right", "left")
    built = {side: build_retargeter(load_hand(settings.hand, side), config, 0)[0] for side in sides}
    loops: dict[str, tuple[Side, ...]] = {RIGHT: ("right",), BOTH: sides}
    times: dict[str, list[np.ndarray]] = {name: [] for name in loops}
    for turn in range(settings.turns):
        for name in list(loops) if turn % 2 == 0 else reversed(list(loops)):
            of = {side: built[side] for side in loops[name]}
            times[name].append(run(of, frames, settings))
    figures = {name: percentiles(np.concatenate(took)) for name, took in times.items()}
    rows = []
    for name, row in figures.items():
        ratio = row["p50_ms"] / figures[RIGHT]["p50_ms"]
        worst = row["p99_ms"] / figures[RIGHT]["p99_ms"]
        report.add(name, row | {"p50_ratio": ratio, "p99_ratio": worst})
        rows.append([name, *row.values(), ratio, worst, sum(map(len, times[name]))])
    header = ("loop", "p50 [ms]", "p95 [ms]", "p99 [ms]", "max [ms]", "p50 ratio", "p99 ratio")
    report.table("Frame received until the last command is out", (*header, "frames"), rows)
    report.finish(settings.output, settings.compare)


def load(settings: Settings) -> list[tuple[HandFrame, ...]]:
    """(right, left) frames with stamps of their own clock."""
    if settings.recording is None:
        whole = SyntheticOperator(rate_hz=settings.rate).record(2 * settings.frames / settings.rate)
    else:
        whole = read_recording(settings.recording)
    right = list(whole[: settings.frames])
    later = [whole[(i + len(right) // 2) % len(whole)] for i in range(len(right))]
    pairs: list[tuple[HandFrame, ...]] = []
    for i, (a, b) in enumerate(zip(right, later, strict=True)):
        mirrored = b.landmarks * np.array([-1, 1, 1]) if b.side == "right" else b.landmarks
        stamp = i / settings.rate
        left = HandFrame(mirrored, stamp, "left", b.valid)
        pairs.append((replace(a, stamp=stamp), left))
    return pairs


def run(
    retargeters: Mapping[Side, Retargeter],
    frames: list[tuple[HandFrame, ...]],
    settings: Settings,
) -> np.ndarray:
    """Milliseconds until the commands of all hands were out, of each frame but the first ten."""
    config = LoopConfig(settings.rate)
    source = Together([pair[: len(retargeters)] for pair in frames], settings.rate)
    sink = Out()
    pipelines = {side: HandPipeline(retargeter, config) for side, retargeter in retargeters.items()}
    loop = TeleopLoop(pipelines, source, SinkRunner([sink]), config)
    with low_jitter(), contextlib.ExitStack() as first:
        loop.run(started=lambda: _first(first, settings.first))
    took = [
        max(sink.sent[side, at] for side in retargeters) - at
        for at in source.posted
        if all((side, at) in sink.sent for side in retargeters)
    ]
    return np.array(took[10:]) * 1e3


def _first(stack: contextlib.ExitStack, enabled: bool) -> None:
    if enabled:
        stack.enter_context(going_first())


if __name__ == "__main__":
    try:
        main(tyro.cli(Settings, description=__doc__))
    except SmoothOperatorError as error:
        raise BenchmarkError(str(error)) from error
