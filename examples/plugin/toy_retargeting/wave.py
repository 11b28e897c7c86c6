"""A source: a hand that opens and closes, without a tracker."""

from dataclasses import dataclass

import numpy as np

from smooth_operator import HandFrame, SyntheticOperator
from smooth_operator.teleop import ThreadedSource


@dataclass(frozen=True)
class WaveSource(ThreadedSource):
    """Fingers that swing between two poses, so often a second [Hz], for so long [s]."""

    frequency: float = 0.5
    duration: float = 10.0
    rate: float = 60.0
    label = "a wave"

    def run(self, running):
        opened, closed = SyntheticOperator(seed=3).record(3.0).landmarks[[0, 150]]
        for k in range(int(self.duration * self.rate)):
            share = 0.5 - 0.5 * np.cos(2 * np.pi * self.frequency * k / self.rate)
            pose = (1 - share) * opened + share * closed
            running.mailbox.post(HandFrame(pose, k / self.rate, "right"))
            if running.stopping.wait(1 / self.rate):
                return
