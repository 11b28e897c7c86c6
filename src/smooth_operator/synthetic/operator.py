"""The synthetic operator: a moving human hand, determined by a seed, in place of a person and a
tracker."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from smooth_operator.errors import ConfigError, UnknownNameError
from smooth_operator.poses import WRIST_AXES, axes, to_ours
from smooth_operator.settings import check_range
from smooth_operator.synthetic.gestures import GESTURES, Programme
from smooth_operator.synthetic.hand_anatomy import (
    JOINTS,
    HandAnatomy,
    couple,
    draw_anatomy,
    mirror,
    move,
    pose_hand,
)
from smooth_operator.synthetic.tracker import (
    TrackerModel,
    TrackerStream,
    WristMotion,
    check_seed,
)
from smooth_operator.types import HandFrame, HandRecording, Side, as_side

_WORLD_AXES = axes("z", "y", "-x")  # the flat hand lies palm down, and points forward
_BLOCK = 256  # ticks per block in record() and frames(), so that both give the same bits


@dataclass(frozen=True)
class SyntheticOperator:
    """A simulated person in front of a tracker, generated from published anatomy and a seed.

    The frames have the same content as those of a MANUS glove: 21 landmarks with the wrist at the
    origin, the four metacarpal bases and an orientation per landmark. The right hand's axes are x
    palmar, y towards the thumb, z distal; the left hand is its mirror image in y. A recording also
    has the true joint angles and gesture of every frame, see ``record``.

    Attributes:
        seed: seed of the person (bone lengths vary by a few percent) and of the motion (timing,
            amplitude, random motion).
        side: side of the hand; the left mirrors the right exactly.
        hand_length: distance from wrist to tip of the straight middle finger [m], 0.12 to 0.25.
            Adults have about 0.16 to 0.21.
        rate_hz: frame rate [Hz]; None for the tracker's rate.
        gestures: gestures in order, from ``GESTURES``; repeated with new draws.
        speed: 1 is a natural tempo, with fingertips up to about 0.5 m/s; 2 doubles it as far as
            ``max_jerk`` allows.
        max_jerk: bound on the jerk of every joint angle except the DIPs, which stay below 2/3 of
            it [rad/s^3].
        tracker: tracker that sees the hand. Default: a perfect tracker at 100 Hz.
        wrist: motion of the whole hand. Default: none.

    Raises:
        ConfigError: a setting is outside its range.
        UnknownNameError: there is no gesture with one of the names.
    """

    seed: int = 0
    side: Side = "right"
    hand_length: float = 0.19
    rate_hz: float | None = None
    gestures: tuple[str, ...] = GESTURES
    speed: float = 1.0
    max_jerk: float = 500.0
    tracker: TrackerModel = field(default_factory=TrackerModel)
    wrist: WristMotion = field(default_factory=WristMotion)

    def __post_init__(self) -> None:
        object.__setattr__(self, "side", as_side(self.side))
        gestures: Sequence[str] = self.gestures
        # a text is one gesture, not a gesture per letter
        names = (gestures,) if isinstance(gestures, str) else tuple(gestures)
        object.__setattr__(self, "gestures", names)
        check_seed("seed", self.seed)
        check_range("hand_length", self.hand_length, 0.12, 0.25, "m")
        check_range("rate_hz", self.rate_hz, 1.0, 10_000.0, "Hz")
        check_range("speed", self.speed, 0.05, 5.0)
        check_range("max_jerk", self.max_jerk, 10.0, 1e5, "rad/s^3")
        if not self.gestures:
            raise ConfigError(f"gestures must name one or more of {', '.join(GESTURES)}")
        for gesture in self.gestures:
            if gesture not in GESTURES:
                raise UnknownNameError("gesture", gesture, GESTURES)

    @property
    def anatomy(self) -> HandAnatomy:
        """Bone lengths and layout of this person's right hand."""
        return draw_anatomy(self.hand_length, int(self.seed))

    @property
    def _rate(self) -> float:
        return self.tracker.rate_hz if self.rate_hz is None else self.rate_hz

    def record(self, duration: float = 20.0) -> HandRecording:
        """Makes a recording that starts at time 0 with a flat hand.

        A longer recording starts with the frames of a shorter one.

        Args:
            duration: length of the recording [s]: ``round(duration * rate_hz)`` ticks of the
                tracker; lost frames are left out.

        Returns:
            The recording. Its ``meta`` holds, per frame, ``gesture`` (T names) and
            ``joint_angles`` ((T, 20) [rad]); and ``joint_names`` (20) with the settings
            ``seed``, ``hand_length`` [m] and ``rate_hz``.

        Raises:
            ConfigError: the duration is shorter than one frame, or not finite.
        """
        blocks = list(self._blocks(self._ticks(duration)))

        def joined(name: str) -> np.ndarray:
            return np.concatenate([getattr(block, name) for block in blocks])

        return HandRecording(
            joined("landmarks"),
            joined("stamps"),
            self.side,
            joined("valid"),
            joined("metacarpals"),
            joined("orientations"),
            T_world_wrist=joined("T_world_wrist") if self.wrist else None,
            world=blocks[0].world,
            name=f"synthetic-{self.side}-{self.seed}",
            meta={
                "gesture": [label for block in blocks for label in block.meta["gesture"]],
                "joint_angles": np.concatenate([block.meta["joint_angles"] for block in blocks]),
                "joint_names": tuple(joint.name for joint in JOINTS),
                "seed": self.seed,
                "hand_length": self.hand_length,
                "rate_hz": self._rate,
            },
        )

    def frames(self, duration: float | None = None) -> Iterator[HandFrame]:
        """Yields the frames of ``record`` one by one, without waiting between them.

        Args:
            duration: length of the sequence [s]; None for an endless one.

        Raises:
            ConfigError: the duration is shorter than one frame, or not finite.
        """
        ticks = None if duration is None else self._ticks(duration)
        return (frame for block in self._blocks(ticks) for frame in block)

    def _ticks(self, duration: float) -> int:
        ticks = round(duration * self._rate) if math.isfinite(duration) else 0
        if ticks < 1:
            raise ConfigError(
                "duration must be finite and contain at least one frame, "
                f"{1.0 / self._rate:g} s at {self._rate:g} Hz, not {duration!r} s"
            )
        return ticks

    def _blocks(self, ticks: int | None) -> Iterator[HandRecording]:
        """Yields parts of the recording, up to ``ticks`` ticks or endlessly."""
        anatomy = self.anatomy
        programme = Programme(int(self.seed), self.gestures, self.speed, self.max_jerk)
        stream = TrackerStream(self.tracker, self._rate)
        done = 0
        while ticks is None or done < ticks:
            tick = stream.next(_BLOCK)
            shown = np.maximum(tick.stamps - self.tracker.delay, 0.0)
            free, labels = programme.at(shown)
            angles = couple(free)
            poses = pose_hand(anatomy, angles)
            if self.side == "left":
                poses = mirror(poses)
            wrist = None
            if self.wrist:
                poses = move(poses, *self.wrist.at(shown))
                held = np.concatenate([poses.landmarks[:, 0], poses.orientations[:, 0]], axis=-1)
                wrist = to_ours(held, _WORLD_AXES, WRIST_AXES["ours"])
            landmarks = tick.shown(poses.landmarks)
            landmarks[tick.lost] = np.nan
            poses.orientations[tick.lost] = np.nan

            rows = np.flatnonzero(tick.arrives[: None if ticks is None else ticks - done])
            done += _BLOCK
            yield HandRecording(
                landmarks[rows],
                tick.stamps[rows],
                self.side,
                ~tick.lost[rows],
                poses.metacarpals[rows],
                poses.orientations[rows],
                T_world_wrist=None if wrist is None else wrist[rows],
                world=None if wrist is None else "synthetic",
                meta={
                    "gesture": [labels[k] for k in rows],
                    "joint_angles": angles[rows],
                },
            )
