"""Measures the quality of a recording (take): holds, lost frames, robot jumps and
self-collision."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from smooth_operator.errors import RecordingError
from smooth_operator.hands.hand import Hand
from smooth_operator.hands.penetration import penetration_depths
from smooth_operator.hands.wrist_joints import has_joints
from smooth_operator.landmarks import BASES, FINGERS
from smooth_operator.metrics import posture, safety
from smooth_operator.retargeting.aligned_recording import align_recording
from smooth_operator.retargeting.alignment import AlignmentConfig
from smooth_operator.teleop.recording.log_reader import read_log
from smooth_operator.teleop.sinks.tick import Mode
from smooth_operator.types import Status

_POSES: Final = 500
"""Number of a take's poses that are checked for self-collision; more would take seconds."""


@dataclass(frozen=True)
class TakeQuality:
    """Metrics that help to decide whether to keep a recording (take).

    Attributes:
        seconds: length of the take [s].
        frames: number of frames from which a command was computed.
        lost_s: time without usable frames [s].
        paused_s: time in which the operator paused the robot [s].
        stopped_s: time in an emergency stop [s].
        unused: number of frames that the method could not use.
        jumps: number of frames in which a fingertip of the robot jumped
            (``posture.jumps_per_1000``).
        collision: share of poses in which links overlap by over 2 mm; None if the hand has no
            collision shapes.
        depth_mm: deepest overlap [mm]; None if ``collision`` is None.
    """

    seconds: float
    frames: int
    lost_s: float
    paused_s: float
    stopped_s: float
    unused: int
    jumps: int
    collision: float | None
    depth_mm: float | None


def take_quality(path: Path, hand: Hand) -> TakeQuality:
    """Measures the quality of a recording of one hand.

    Args:
        hand: the recorded robot hand.

    Raises:
        RecordingError: the file can't be read, or has no commands of this hand.
    """
    log = read_log(path)
    if log.commands is None or log.loop is None or not len(log.commands):
        raise RecordingError(f"{path.name} contains no commands from a live run")
    if not has_joints(hand, log.commands.joint_names):
        raise RecordingError(f"{path.name} was recorded with a different hand than {hand.name!r}")
    q = np.asarray(log.commands.joint_positions, float)[:, : len(hand.joint_names)]
    times = log.loop.times
    answers = log.loop.answers
    modes, lasted = log.loop.modes, np.diff(times, append=times[-1:])  # until the next command [s]

    def seconds_in(*those: Mode) -> float:
        return float(lasted[np.isin(modes, [mode.value for mode in those])].sum())

    chosen = np.unique(np.linspace(0, len(q) - 1, min(len(q), _POSES)).astype(int))
    depths = penetration_depths(hand, q[chosen])
    collisions = None if depths is None else safety.self_collision(depths)
    jumps = 0
    if log.recording is not None:
        stamps, rows, columns = np.intersect1d(
            log.recording.stamps, log.commands.stamps[answers], return_indices=True
        )
        if len(stamps) > 1:
            aligned = align_recording(log.recording, hand, AlignmentConfig())
            bases = np.array([BASES[FINGERS.index(finger)] for finger in hand.fingers])
            fingers = aligned[rows][:, bases[:, None] + range(4)]
            gains = posture.finger_gains(fingers, hand.straight_pose.reach)
            human = posture.steps(fingers[:, :, 3])
            robot = posture.steps(hand.tips(q[answers][columns]))
            jumps = round((posture.jumps_per_1000(human, robot, gains) or 0.0) * len(human) / 1e3)
    return TakeQuality(
        seconds=float(times[-1] - times[0]),
        frames=int(answers.sum()),
        lost_s=seconds_in(Mode.WAITING, Mode.HOLDING, Mode.EASING),
        paused_s=seconds_in(Mode.PAUSED),
        stopped_s=seconds_in(Mode.STOPPED),
        unused=int((log.commands.status[answers] != Status.OK).sum()),
        jumps=jumps,
        collision=None if collisions is None else collisions["share"],
        depth_mm=None if collisions is None else collisions["max_depth_mm"],
    )
