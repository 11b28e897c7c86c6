"""Hands, commands and measurements in Rerun: into its viewer, or into a file that it opens."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Final

import numpy as np
from jaxtyping import Float

from smooth_operator.atomic_files import output_error
from smooth_operator.errors import ConfigError, MissingExtraError, SinkError
from smooth_operator.hands.hand import Hand
from smooth_operator.landmarks import BONES
from smooth_operator.teleop.recording.messages import landmark_keypoints
from smooth_operator.teleop.sinks.sink import Link, ThreadedSink
from smooth_operator.teleop.sinks.tick import Tick
from smooth_operator.types import Side

_CLOSING_S: Final = 2.0
"""Time that closing waits for a viewer to take pending messages [s]."""


@dataclass(frozen=True)
class RerunSink(ThreadedSink):
    """Shows a run in Rerun's viewer.

    Entities, for each side: ``SIDE/human`` and ``SIDE/robot``, skeletons of the human's landmarks
    from its wrist and of the commanded hand's in its palm frame [m]; ``SIDE/command`` and
    ``SIDE/measured``, joint positions [rad]; ``SIDE/events``. The timeline ``loop`` is the loop's
    clock. If Rerun is slow, only the newest tick of each hand is shown.

    Attributes:
        to: address of a viewer, or a file NAME.rrd.

    Raises:
        ConfigError: ``to`` is neither.
    """

    observes: ClassVar[bool] = True

    to: str = "rerun+http://127.0.0.1:9876/proxy"

    def __post_init__(self) -> None:
        if "://" not in self.to and Path(self.to).suffix != ".rrd":
            raise ConfigError(
                f"rerun: expected the address of a viewer, such as "
                f"rerun+http://127.0.0.1:9876/proxy, or NAME.rrd, not {self.to!r}"
            )

    @property
    def label(self) -> str:
        """The word ``rerun`` and the viewer or file."""
        return f"rerun {self.to}"

    def check(self, hands: Mapping[Side, Hand]) -> None:
        """Check that Rerun is installed; a viewer may be started later."""
        del hands
        _rerun()

    def connect(self, hands: Mapping[Side, Hand], config: Mapping[str, Any]) -> Link:
        """Open the stream; see ``Sink.open``."""
        del config
        rerun = _rerun()
        stream = rerun.RecordingStream("smooth-operator")
        try:
            if "://" in self.to:
                stream.connect_grpc(self.to)
            else:
                Path(self.to).parent.mkdir(parents=True, exist_ok=True)
                stream.save(self.to)
        except OSError as error:
            raise output_error(self.to, error) from error
        except (RuntimeError, ValueError) as error:
            raise SinkError(f"rerun: can't open {self.to}: {error}") from error
        for side, hand in hands.items():
            for kind in ("command", "measured"):
                names = rerun.SeriesLines(names=list(hand.joint_names))
                stream.log(f"{side}/{kind}", names, static=True)
        return _Stream(rerun, stream, hands)


class _Stream:
    """The open stream; everything here is called on the sink's own thread."""

    def __init__(self, rerun: Any, stream: Any, hands: Mapping[Side, Hand]) -> None:
        self._rerun, self._stream = rerun, stream
        self._keypoints = {side: landmark_keypoints(hand) for side, hand in hands.items()}

    def deliver(self, tick: Tick) -> None:
        side, positions = tick.side, np.asarray(tick.command.joint_positions)
        self._stream.set_time("loop", duration=tick.time)
        self._skeleton(f"{side}/robot", self._keypoints[side](positions[None])[0])
        self._stream.log(f"{side}/command", self._rerun.Scalars(positions))
        if tick.state is not None:
            self._stream.log(f"{side}/measured", self._rerun.Scalars(tick.state.positions))
        if tick.arrival is not None:
            points = np.asarray(tick.arrival.frame.landmarks)
            self._skeleton(f"{side}/human", points - points[0])
        for event in tick.events:
            self._stream.log(f"{side}/events", self._rerun.TextLog(event))

    def stalled(self, seconds: float) -> None:
        del seconds

    def close(self) -> None:
        self._stream.flush(timeout_sec=_CLOSING_S)
        self._stream.disconnect()

    def _skeleton(self, path: str, points: Float[np.ndarray, "21 3"]) -> None:
        """Log finite landmarks and the bones between them."""
        finite = np.isfinite(points).all(axis=1)
        bones = [points[[a, b]] for a, b in BONES if finite[a] and finite[b]]
        self._stream.log(f"{path}/landmarks", self._rerun.Points3D(points[finite], radii=0.004))
        self._stream.log(f"{path}/bones", self._rerun.LineStrips3D(bones, radii=0.002))


def _rerun() -> Any:
    try:
        import rerun
    except ImportError as error:
        raise MissingExtraError("showing a run in Rerun", "rerun") from error
    return rerun
