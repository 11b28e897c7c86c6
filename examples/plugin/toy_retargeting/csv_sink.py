"""A sink: a line of joint positions [rad] for each command, in a CSV file."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import TextIO

from smooth_operator.errors import OutputError
from smooth_operator.teleop import Sink


@dataclass
class CsvSink(Sink):
    path: Path
    file: TextIO | None = field(default=None, init=False)
    label = "csv"

    def open(self, hands, config):
        try:
            self.file = self.path.open("w")
        except OSError as error:
            raise OutputError(f"can't write {self.path}: {error.strerror}") from error
        self.file.write("side,number,positions\n")

    def send(self, tick):
        positions = " ".join(f"{q:.6f}" for q in tick.command.joint_positions)
        self.file.write(f"{tick.side},{tick.number},{positions}\n")

    def close(self):
        if self.file is not None:
            self.file.close()
