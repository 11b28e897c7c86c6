"""Playback of one retargeted recording, human and robot, frame by frame."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
import trimesh
from jaxtyping import Bool, Float, Int
from numpy.typing import ArrayLike, DTypeLike

from smooth_operator.errors import HandModelError, RecordingError
from smooth_operator.landmarks import FINGERS, NUM_LANDMARKS, TIPS
from smooth_operator.metrics.accuracy import PINCH_DISTANCE


@dataclass(frozen=True, eq=False)
class SimpleShapes:
    """A robot hand of a playback in simple shapes, on a model of its own.

    Attributes:
        model: the robot hand.
        qpos: (T, nq) joint positions of that model [rad].
        meshes: body -> its surface, in the body's frame [m].
        wxyz: (4,) rotation of that model's world in the playback's, a unit quaternion.
        position: (3,) its origin there [m].
    """

    model: mujoco.MjModel
    qpos: Float[np.ndarray, "T nq"]
    meshes: Mapping[int, trimesh.Trimesh]
    wxyz: Float[np.ndarray, "4"]
    position: Float[np.ndarray, "3"]


@dataclass(frozen=True, eq=False)
class Playback:
    """A recording and its retargeted motion, ready to be drawn.

    Attributes:
        title: shown at the top of the page.
        model: the robot hand; its geoms are what is drawn.
        qpos: (T, nq) joint positions of the model [rad], finite.
        stamps: (T,) strictly increasing times [s].
        human: (T, 21, 3) landmarks aligned to the robot, in the model's world frame [m]; NaN where
            a landmark is invalid.
        status: (T,) ``Status`` values.
        robot_tips: (T, F, 3) robot fingertips in the model's world frame [m], thumb first.
        robot_wrist: (3,) robot wrist in the model's world frame [m].
        latency_ms: (T,) time from landmarks to command [ms]; NaN where unknown.
        human_tips: (F,) landmark index of the human fingertip that each robot fingertip follows.
        fingers: (F,) names of the fingers, thumb first.
        bodies: (nbody,) which bodies of the model to draw, where it holds more than the hand; all
            if None.
        label: label above the robot; with several robots, the origin of its motion.
        simple: the hand in simple shapes, for a switch; None where ``model`` is all there is.
        show_meshes: draw the model at first, not the simple shapes.

    Raises:
        RecordingError: if an array about the human has the wrong shape, or the stamps don't
            increase, or there is no frame.
        HandModelError: if an array about the robot has the wrong shape or is not finite.
    """

    title: str
    model: mujoco.MjModel
    qpos: Float[np.ndarray, "T nq"]
    stamps: Float[np.ndarray, " T"]
    human: Float[np.ndarray, "T 21 3"]
    status: Int[np.ndarray, " T"]
    robot_tips: Float[np.ndarray, "T F 3"]
    robot_wrist: Float[np.ndarray, "3"]
    latency_ms: Float[np.ndarray, " T"]
    human_tips: tuple[int, ...] = TIPS
    fingers: tuple[str, ...] = FINGERS
    bodies: Bool[np.ndarray, " nbody"] | None = None
    label: str = "robot"
    simple: SimpleShapes | None = None
    show_meshes: bool = True

    def __post_init__(self) -> None:
        stamps = np.asarray(self.stamps, np.float64)
        if stamps.ndim != 1 or not len(stamps):
            raise RecordingError(
                f"stamps must have shape (T,) with at least one frame, not {stamps.shape}"
            )
        if not (np.isfinite(stamps).all() and (np.diff(stamps) > 0).all()):
            raise RecordingError("stamps must be finite and strictly increasing; sort the frames")
        frames, fingers = len(stamps), len(self.fingers)
        if fingers < 2 or len(self.human_tips) != fingers:
            raise HandModelError(
                f"fingers and human_tips must name the same two or more fingers, thumb first; "
                f"got {self.fingers} and {self.human_tips}"
            )
        if not all(0 <= tip < NUM_LANDMARKS for tip in self.human_tips):
            raise RecordingError(
                f"human_tips must be landmark indices 0..{NUM_LANDMARKS - 1}, not {self.human_tips}"
            )
        human, robot = RecordingError, HandModelError
        self._put("stamps", (frames,), human)
        self._put("human", (frames, NUM_LANDMARKS, 3), human)
        self._put("status", (frames,), human, np.int64)
        self._put("latency_ms", (frames,), human)
        self._put("qpos", (frames, self.model.nq), robot)
        self._put("robot_tips", (frames, fingers, 3), robot)
        self._put("robot_wrist", (3,), robot)
        for name in ("qpos", "robot_tips", "robot_wrist"):
            if not np.isfinite(getattr(self, name)).all():
                raise HandModelError(f"{name} holds NaN or infinity; hold the last good value")

    def _put(
        self,
        name: str,
        shape: tuple[int, ...],
        error: type[RecordingError | HandModelError],
        dtype: DTypeLike = np.float64,
    ) -> None:
        array: ArrayLike = getattr(self, name)
        array = np.asarray(array, dtype)
        if array.shape != shape:
            raise error(f"{name} must have shape {shape}, not {array.shape}")
        object.__setattr__(self, name, array)  # normalising a frozen dataclass

    def __len__(self) -> int:
        return len(self.stamps)

    @property
    def times(self) -> Float[np.ndarray, " T"]:
        """(T,) seconds since the first frame."""
        return np.asarray(self.stamps - self.stamps[0])

    def pinches(self) -> Bool[np.ndarray, "T G"]:
        """(T, F-1) True where the human pinches: gap under ``PINCH_DISTANCE``."""
        tips = self.human[:, list(self.human_tips)]
        # NaN compares False: a lost hand never pinches
        gaps = np.linalg.norm(tips[:, 1:] - tips[:, :1], axis=-1)
        return np.asarray(gaps < PINCH_DISTANCE)


def check_runs(runs: Sequence[Playback]) -> None:
    """Looks whether runs can be shown side by side.

    Raises:
        RecordingError: there is none, or they are not of the same frames and fingers.
    """
    if not runs:
        raise RecordingError("there is nothing to play: give one run or more")
    first = runs[0]
    for run in runs[1:]:
        if not np.array_equal(run.stamps, first.stamps):
            raise RecordingError(
                f"{run.label!r} has {len(run)} frames and {first.label!r} {len(first)}, or their "
                "time stamps differ: retarget the same frames of one recording with both"
            )
        if run.fingers != first.fingers:
            raise RecordingError(
                f"{run.label!r} drives {', '.join(run.fingers)}, but {first.label!r} "
                f"{', '.join(first.fingers)}: give runs of the same fingers"
            )


class PlaybackClock:
    """Maps wall time to frames of a recording; frames are dropped, time is never stretched.

    Args:
        times: (T,) strictly increasing times of the frames [s].
        speed: playback seconds per wall second, > 0.
        loop: start over after the last frame.
    """

    def __init__(
        self, times: Float[np.ndarray, " T"], speed: float = 1.0, loop: bool = True
    ) -> None:
        self._times = np.asarray(times, np.float64) - times[0]
        # the last frame is shown for as long as a usual one, so a loop has no hiccup
        period = float(np.median(np.diff(self._times))) if len(self._times) > 1 else 0.0
        self._duration = float(self._times[-1]) + period
        self._speed = speed
        self.loop = loop
        self._wall = 0.0
        self._time = 0.0

    @property
    def speed(self) -> float:
        """Playback seconds per wall second."""
        return self._speed

    def start(self, frame: int, now: float) -> None:
        """Let ``frame`` be the one that is due at wall time ``now`` [s]."""
        self._time, self._wall = float(self._times[frame]), now

    def set_speed(self, speed: float, now: float) -> None:
        """Change the speed from ``now`` [s] on, without a jump."""
        self._time += (now - self._wall) * self._speed
        self._wall, self._speed = now, speed

    def frame(self, now: float) -> tuple[int, bool]:
        """The frame that is due at wall time ``now`` [s], and whether playback has ended."""
        time = self._time + (now - self._wall) * self._speed
        if time >= self._duration:
            if not self.loop or self._duration <= 0.0:
                return len(self._times) - 1, True
            time %= self._duration
        return max(int(np.searchsorted(self._times, time, side="right")) - 1, 0), False
