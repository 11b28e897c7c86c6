"""A tracker and a robot of your own: a source posts hand frames, a sink takes commands.

In a module that Python finds, both work by name:
``smooth-operator teleop --source mylab.tracker:WaveSource --sink mylab.robot:CsvSink``.
"""

import csv
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import smooth_operator.teleop as teleop
from smooth_operator import Hand, HandFrame, Retargeter, SyntheticOperator


@dataclass(frozen=True)
class WaveSource(teleop.ThreadedSource):
    """The built-in operator's motion; stands for the library of your tracker."""

    rate_hz: float = 60.0
    label = "wave"

    def run(self, running: Any) -> None:  # on its own thread
        for frame in SyntheticOperator(seed=5, rate_hz=self.rate_hz).frames():
            if running.stopping.wait(1 / self.rate_hz):
                return
            running.mailbox.post(HandFrame(frame.landmarks, time.perf_counter(), frame.side))


@dataclass
class CsvSink(teleop.Sink):
    """Joint positions as rows of a CSV file; stands for the driver of your robot."""

    path: str = "commands.csv"
    rows: list[list[float]] = field(default_factory=list)
    label = "csv"

    def open(self, hands: Mapping[str, Hand], config: Mapping[str, Any]) -> None:
        self.names = hands["right"].joint_names

    def send(self, tick: teleop.Tick) -> None:  # in well under a millisecond: the disk can wait
        self.rows.append([tick.time, *tick.command.joint_positions])

    def stalled(self, seconds: float) -> None:  # from the watchdog's thread
        print(f"no command for {seconds:.2f} s: a robot should hold or stop here")

    def close(self) -> None:
        with open(self.path, "w", newline="", encoding="utf-8") as file:
            csv.writer(file).writerows([["time", *self.names], *self.rows])


sink, config = CsvSink(), teleop.LoopConfig(rate=60)
retargeter = Retargeter("mimic_p050")
retargeter.warm_up()
pipeline = teleop.HandPipeline(retargeter, config)
loop = teleop.TeleopLoop({"right": pipeline}, WaveSource(), teleop.SinkRunner([sink]), config)
loop.run(duration=1.5)
print(f"{len(sink.rows)} commands in {sink.path}")
assert sink.rows, "no command came"
