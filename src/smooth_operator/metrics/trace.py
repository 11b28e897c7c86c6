"""Input of the metrics: one run of a human hand and of the robot hand that followed it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from numpy.typing import ArrayLike

from smooth_operator.errors import RecordingError, UnknownNameError
from smooth_operator.landmarks import BASES, FINGERS, NUM_LANDMARKS, TIPS, WRIST
from smooth_operator.retargeting.targets import KeyvectorLayout


@dataclass(frozen=True, eq=False)
class Trace:
    """Data of one run for the metrics; positions are in the robot's palm frame [m].

    Attributes:
        human: (T, 21, 3) human landmarks after alignment [m]; NaN where a frame was invalid.
        robot_tips: (T, F, 3) robot fingertips [m], in the order of ``fingers``.
        robot_wrist: (3,) the robot point that corresponds to the human wrist [m].
        fingers: F human finger names, thumb first, 2 to 5 of them.
        joint_positions: (T, n) [rad], coupled joints included.
        joint_limits: (n, 2) lower and upper limits [rad]; NaN or infinite where there is none.
        stamps: (T,) strictly increasing times [s].
        status: (T,) ``Status`` values.
        latency_ms: (T,) time from landmarks to command [ms]; NaN where it was not measured.
        reach: (S, F, 3) fingertips of random poses [m], for workspace utilisation; or None.
        penetration: (T,) deepest overlap of two robot links per frame [m], positive inside; or
            None.
        robot_landmarks: (T, 21, 3) robot points that correspond to the human landmarks [m], NaN if
            the robot has none; only for the published definition; or None.
        palm_landmarks: indices of the landmarks that align the two palms; used by the published
            definition only.
        straight_lengths: (F,) base to tip of the robot's straight fingers [m], for the metrics of
            posture; or None.
        pinch_distances: (T, F - 1) distance between the surfaces of the robot's thumb and of each
            other finger [m], negative inside, NaN where the human does not pinch with that finger;
            or None.

    Raises:
        RecordingError: if an array has the wrong shape or the stamps don't increase.
        UnknownNameError: if a finger is not a human finger.
    """

    human: Float[np.ndarray, "T 21 3"]
    robot_tips: Float[np.ndarray, "T F 3"]
    robot_wrist: Float[np.ndarray, "3"]
    fingers: tuple[str, ...]
    joint_positions: Float[np.ndarray, "T n"]
    joint_limits: Float[np.ndarray, "n 2"]
    stamps: Float[np.ndarray, " T"]
    status: Int[np.ndarray, " T"]
    latency_ms: Float[np.ndarray, " T"]
    reach: Float[np.ndarray, "S F 3"] | None = None
    penetration: Float[np.ndarray, " T"] | None = None
    robot_landmarks: Float[np.ndarray, "T 21 3"] | None = None
    palm_landmarks: tuple[int, ...] = (BASES[0], BASES[1], BASES[4])
    straight_lengths: Float[np.ndarray, " F"] | None = None
    pinch_distances: Float[np.ndarray, "T f"] | None = None

    def __post_init__(self) -> None:
        fingers = tuple(self.fingers)
        for name in fingers:
            if name not in FINGERS:
                raise UnknownNameError("finger", name, FINGERS)
        if not 2 <= len(fingers) <= 5 or fingers[0] != "thumb" or len(set(fingers)) < len(fingers):
            raise RecordingError(
                f"fingers must be 2 to 5 different fingers, thumb first, not {fingers}"
            )
        object.__setattr__(self, "fingers", fingers)
        count, tips = np.shape(self.human)[0] if np.ndim(self.human) else 0, len(fingers)
        joints = np.shape(self.joint_positions)[-1] if np.ndim(self.joint_positions) == 2 else 0
        self._take("human", (count, NUM_LANDMARKS, 3))
        self._take("robot_tips", (count, tips, 3))
        self._take("robot_wrist", (3,))
        self._take("joint_positions", (count, joints))
        self._take("joint_limits", (joints, 2))
        self._take("stamps", (count,))
        self._take("status", (count,), np.int64)
        self._take("latency_ms", (count,))
        if self.reach is not None:
            samples = np.shape(self.reach)[0] if np.ndim(self.reach) else 0
            self._take("reach", (samples, tips, 3))
        if self.penetration is not None:
            self._take("penetration", (count,))
        if self.robot_landmarks is not None:
            self._take("robot_landmarks", (count, NUM_LANDMARKS, 3))
        if self.straight_lengths is not None:
            self._take("straight_lengths", (tips,))
        if self.pinch_distances is not None:
            self._take("pinch_distances", (count, tips - 1))
        steps = np.diff(self.stamps)
        if not (np.isfinite(self.stamps).all() and (steps > 0).all()):
            at = int(np.argmin(np.isfinite(self.stamps[1:]) & (steps > 0))) + 1
            raise RecordingError(
                f"timestamps must be finite and strictly increasing, but that of frame {at} "
                "is not: sort the frames and drop repeated ones before measuring"
            )

    def _take(
        self,
        name: str,
        shape: tuple[int, ...],
        dtype: type[np.float64] | type[np.int64] = np.float64,
    ) -> None:
        value: ArrayLike = getattr(self, name)
        array = np.asarray(value, dtype)
        if array.shape != shape:
            raise RecordingError(f"{name} must have shape {shape}, not {array.shape}")
        object.__setattr__(self, name, array)  # normalising a frozen dataclass

    def __len__(self) -> int:
        return len(self.stamps)

    @property
    def rate_hz(self) -> float | None:
        """Median frame rate [Hz]; None for fewer than two frames."""
        return float(1.0 / np.median(np.diff(self.stamps))) if len(self) > 1 else None

    @property
    def human_tips(self) -> Float[np.ndarray, "T F 3"]:
        """Positions of the human fingertips that correspond to the robot's fingers [m]."""
        return np.asarray(self.human[:, [TIPS[FINGERS.index(name)] for name in self.fingers]])

    @property
    def human_reaches(self) -> Float[np.ndarray, "T F 3"]:
        """Vectors from the human's wrist to the fingertips [m], which show fingertip motion without
        wrist motion."""
        return np.asarray(self.human_tips - self.human[:, WRIST, None])

    @property
    def robot_reaches(self) -> Float[np.ndarray, "T F 3"]:
        """Vectors from the robot's wrist to its fingertips [m]."""
        return np.asarray(self.robot_tips - self.robot_wrist)

    @property
    def human_fingers(self) -> Float[np.ndarray, "T F 4 3"]:
        """Human landmarks, from base to tip, of the fingers that the robot hand has [m]."""
        return np.asarray(self.human[:, self._chains])

    @property
    def robot_fingers(self) -> Float[np.ndarray, "T F 4 3"]:
        """The robot's points, from base to tip, of its fingers [m]; NaN for points that it
        lacks."""
        if self.robot_landmarks is None:
            return np.full((len(self), len(self.fingers), 4, 3), np.nan)
        return np.asarray(self.robot_landmarks[:, self._chains])

    @property
    def _chains(self) -> np.ndarray:
        """(F, 4) landmarks of each finger, base to tip."""
        return np.array([BASES[FINGERS.index(name)] for name in self.fingers])[:, None] + range(4)

    @property
    def human_keyvectors(self) -> Float[np.ndarray, "T K 3"]:
        """All human keyvectors [m], in the order of ``keyvectors``."""
        return keyvectors(self.human_tips, self.human[:, WRIST])

    @property
    def robot_keyvectors(self) -> Float[np.ndarray, "T K 3"]:
        """All robot keyvectors [m], in the order of ``keyvectors``."""
        return keyvectors(self.robot_tips, np.broadcast_to(self.robot_wrist, (len(self), 3)))

    @property
    def thumb_vectors(self) -> slice:
        """Mask of the keyvectors from the thumb's tip to other tips."""
        return slice(len(self.fingers), 2 * len(self.fingers) - 1)


def keyvectors(
    tips: Float[np.ndarray, "T F 3"], wrist: Float[np.ndarray, "T 3"]
) -> Float[np.ndarray, "T K 3"]:
    """Keyvectors of a hand: from the wrist to each tip (F), from the thumb's tip to the other tips
    (F - 1), then between the other tips. There are K = F (F + 1) / 2, which is 15 for five fingers.

    Args:
        tips: (T, F, 3) fingertips [m], thumb first.
        wrist: (T, 3) [m].

    Returns:
        (T, K, 3) [m].
    """
    layout = KeyvectorLayout(FINGERS[: tips.shape[1]])  # only the number of fingers counts here
    return layout.among(np.concatenate([wrist[:, None], tips], axis=1))
