"""An output of feedback: the strength at each fingertip, as lines of a text file."""

from dataclasses import dataclass
from pathlib import Path

from smooth_operator.errors import SinkError
from smooth_operator.teleop import Feedback


@dataclass(frozen=True)
class LinesFeedback(Feedback):
    path: Path
    label = "lines"

    def output(self):
        try:
            file = self.path.open("w")
        except OSError as error:
            raise SinkError(f"can't write {self.path}: {error.strerror}") from error

        def send(message):
            levels = " ".join(f"{level:.2f}" for level in message["levels"])
            file.write(f"{message['side']} {levels}\n")

        return send, file.close
