"""Profile of one operator on one robot hand, and the correction of landmarks by it.

The correction comes after the alignment to the palm, in the palm frame, and is the same for every
method. It has parts that are switched one by one (``COMPONENTS``); which are on is a field of
the profile, and docs/how-to/calibrate.md says what each did where it was measured.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from types import ModuleType
from typing import Any, Final, Literal, TypeAlias, get_args

import numpy as np
from jaxtyping import Float

from smooth_operator.errors import ConfigError, UnknownNameError
from smooth_operator.geometry import AnyArray, AnyKind, array_namespace
from smooth_operator.hands.hand import Hand
from smooth_operator.human.palm import PalmAxes, unit_vectors
from smooth_operator.landmarks import BASES, FINGERS, TIPS
from smooth_operator.types import Side

_TINY: Final = 1e-9


Component: TypeAlias = Literal["scale", "tips", "pinch", "fingers", "palm"]
COMPONENTS: Final[tuple[Component, ...]] = get_args(Component)
"""``scale``: one scale instead of one a frame. ``tips``: landmark to pad. ``pinch``: what distance
is left in pinches is closed, and latches close and open at the operator's distances. ``fingers``:
each finger's reach to the robot's. ``palm``: the flat hand's direction to the robot's."""
DEFAULT_COMPONENTS: Final[tuple[Component, ...]] = ("scale", "pinch")
"""Those that did good on recordings that they were not fitted on: docs/how-to/calibrate.md."""

THUMB_FLEXES_TOWARDS: Final = (0.5, -1.0)
"""(distal, radial): where a thumb flexes to, as in ``smooth_operator.baselines.joint_angle``."""

_NEAR, _FAR = 0.010, 0.045  # thumb to tip [m]: a pinch is kept whole under, and is none over


@dataclass(frozen=True)
class FingerProfile:
    """One finger of an operator.

    Attributes:
        name: the human finger.
        robot: body of the robot's fingertip that it drives.
        bones: lengths from base to tip [m].
        reach: base to tip with the finger straight [m], of the operator.
        robot_reach: the same of the robot [m].
        scale: robot reach over human reach.
        tip_along: from the tip landmark to the pad, along the last bone and outwards [m], at human
            size.
        tip_pad: the same at right angles to that, to the side that the finger flexes to [m].
        pinch_gap: from thumb landmark to tip landmark in a pinch [m], at human size; None where no
            pinch was found.
        pinch_gap_after: the same with the tips corrected [m].
    """

    name: str
    robot: str
    bones: tuple[float, float, float]
    reach: float
    robot_reach: float
    scale: float
    tip_along: float = 0.0
    tip_pad: float = 0.0
    pinch_gap: float | None = None
    pinch_gap_after: float | None = None


@dataclass(frozen=True)
class OperatorProfile:
    """An operator, as calibrated for a robot hand.

    Attributes:
        hand: name of the robot hand.
        side: side of both hands.
        scale: robot size over human size, of the palm.
        palm_width: index MCP to pinky MCP [m].
        palm_length: wrist to middle MCP [m].
        fingers: those that drive the robot, thumb first.
        palm_rotation: (w, x, y, z) that turns the operator's flat hand, once aligned, into the
            direction of the robot's straight fingers.
        project: aligned thumb-to-tip distance under which a pinch is meant [m]; None if no pinch
            was found.
        escape: and over which it is over [m].
        apply: components that are used.
        source: the recording it was found in.

    Raises:
        ConfigError: a figure is outside what a hand can be.
        UnknownNameError: a finger or a component has no such name.
    """

    hand: str
    side: Side
    scale: float
    palm_width: float
    palm_length: float
    fingers: tuple[FingerProfile, ...]
    palm_rotation: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)
    project: float | None = None
    escape: float | None = None
    apply: tuple[Component, ...] = DEFAULT_COMPONENTS
    source: str = ""

    def __post_init__(self) -> None:
        for component in self.apply:
            if component not in COMPONENTS:
                raise UnknownNameError("component of a calibration", component, COMPONENTS)
        names = [finger.name for finger in self.fingers]
        for name in names:
            if name not in FINGERS:
                raise UnknownNameError("finger", name, FINGERS)
        if len(names) < 2 or names[0] != "thumb" or len(set(names)) < len(names):
            raise ConfigError(
                f"an operator's fingers must be 2 to 5 different ones, thumb first, not {names}"
            )
        self._check_range("scale", self.scale, 0.1, 10)
        for name in ("palm_width", "palm_length"):
            self._check_range(name, getattr(self, name), 0.01, 0.3)
        for finger in self.fingers:
            self._check_range(f"{finger.name}: reach", finger.reach, 0.01, 0.3)
            self._check_range(f"{finger.name}: robot_reach", finger.robot_reach, 0.001, 3)
            self._check_range(f"{finger.name}: scale", finger.scale, 0.05, 20)
            for name in ("tip_along", "tip_pad"):
                self._check_range(f"{finger.name}: {name}", getattr(finger, name), -0.03, 0.03)
        if abs(float(np.linalg.norm(self.palm_rotation)) - 1) > 1e-3:
            raise ConfigError(
                f"palm_rotation must be a unit quaternion w x y z, not {self.palm_rotation}"
            )
        if (self.project is None) != (self.escape is None):
            raise ConfigError("project and escape belong together: give both or none")
        if self.project is not None and self.escape is not None:
            self._check_range("project", self.project, 0.001, 0.1)
            self._check_range("escape", self.escape, self.project, 0.2)

    def _check_range(self, name: str, value: float, low: float, high: float) -> None:
        if not low <= value <= high:  # False for NaN
            raise ConfigError(
                f"an operator's {name} must be from {low:g} to {high:g}, not {value:g}: calibrate "
                "again, or mend the file"
            )

    def check(self, hand: Hand) -> None:
        """Looks whether the profile was made for a hand.

        Raises:
            ConfigError: it is another hand, side or finger.
        """
        again = f"smooth-operator calibrate RECORDING --hand {hand.name} --output operator.json"
        if (self.hand, self.side) != (hand.name, hand.spec.side):
            raise ConfigError(
                f"this operator was calibrated for the {self.side} hand {self.hand!r}, not for the "
                f"{hand.spec.side} hand {hand.name!r}; calibrate for it: {again}"
            )
        robots = {finger.name: finger.robot for finger in self.fingers}
        for finger in hand.spec.fingers:
            if robots.get(finger.name) != finger.tip.body:
                robot = robots.get(finger.name)
                raise ConfigError(
                    f"this operator was calibrated with {finger.name} driving "
                    f"{robot or 'nothing'}, not {finger.tip.body}; calibrate with the same "
                    f"--fingers: {again}"
                )

    def has(self, component: Component) -> bool:
        """True if a component is used."""
        return component in self.apply

    def without(self, *components: Component) -> OperatorProfile:
        """The same with some components left out."""
        return replace(self, apply=tuple(c for c in self.apply if c not in components))

    def using(self, components: Iterable[Component]) -> OperatorProfile:
        """The same with other components used."""
        return replace(self, apply=tuple(components))

    @cached_property
    def _of(self) -> dict[str, FingerProfile]:
        return {finger.name: finger for finger in self.fingers}

    def needs(self, hand: Hand) -> tuple[int, ...]:
        """Human landmarks that the correction uses."""
        rows: set[int] = set()
        for i in (FINGERS.index(name) for name in hand.fingers):
            if self.has("tips"):
                rows |= {TIPS[i] - 1, TIPS[i]}
            if self.has("fingers"):
                rows |= {BASES[i], TIPS[i]}
            if self.has("pinch"):
                rows.add(TIPS[i])
        if self.has("tips"):
            rows |= {BASES[0], BASES[0] + 1}
        return tuple(sorted(rows))

    def correct(
        self, aligned: AnyKind, scale: AnyArray, hand: Hand, axes: PalmAxes[np.ndarray]
    ) -> AnyKind:
        """(..., 21, 3) landmarks as the robot should see them [m], from those in the palm frame
        [m], for (...) scales of the alignment and the axes of ``human_palm_axes``; NumPy or JAX,
        traceable. The palm's own landmarks move by ``palm`` only."""
        xp = array_namespace(aligned)
        out: Any = aligned
        if self.has("palm"):
            pivot = hand.align_points.mean(axis=0).astype(aligned.dtype)
            turn = xp.asarray(_matrix(self.palm_rotation), aligned.dtype)
            out = xp.einsum("ij,...kj->...ki", turn, out - pivot) + pivot
        fingers = [FINGERS.index(name) for name in hand.fingers]
        tips = [TIPS[i] for i in fingers]
        if self.has("tips"):
            mine = [self._of[name] for name in hand.fingers]
            offsets = np.array([[f.tip_along, f.tip_pad] for f in mine]).astype(aligned.dtype)
            along, pad = tip_frames(out, fingers, axes)
            shift = along * offsets[:, :1] + pad * offsets[:, 1:]
            out = _put(out, tips, out[..., tips, :] + scale[..., None, None] * shift, xp)
        if self.has("pinch"):
            out = self._closed(out, scale, hand, xp)
        if self.has("fingers"):
            out = self._reached(out, hand, xp)
        corrected: AnyKind = out
        return corrected

    @cached_property
    def residual_gap(self) -> float | None:
        """Gap between tips in a pinch without other knowledge [m], at human size: the
        middle one of the fingers that were seen pinching; None if none was."""
        gaps = [
            f.pinch_gap_after if self.has("tips") else f.pinch_gap
            for f in self.fingers
            if f.pinch_gap is not None
        ]
        finite = [gap for gap in gaps if gap is not None]
        return float(np.median(finite)) if finite else None

    @cached_property
    def pinch_gaps(self) -> dict[str, float]:
        """Finger, but for the thumb -> what is left between it and the thumb in a pinch [m], at
        human size; empty if no pinch was seen."""
        if self.residual_gap is None:
            return {}
        tips = self.has("tips")
        gaps = {f.name: f.pinch_gap_after if tips else f.pinch_gap for f in self.fingers[1:]}
        middle = self.residual_gap
        return {name: middle if gap is None else gap for name, gap in gaps.items()}

    def _closed(self, points: Any, scale: Any, hand: Hand, xp: ModuleType) -> Any:
        """Thumb and finger moved to each other by what is left between them in a pinch.

        In full where they nearly touch, and the less the further they are apart, so that an open
        hand is left as it is and no distance ever shrinks by a jump.
        """
        if not self.pinch_gaps:
            return points
        fingers = [FINGERS.index(name) for name in hand.fingers]
        left = np.array([self.pinch_gaps[name] for name in hand.fingers[1:]])
        tips = points[..., [TIPS[i] for i in fingers], :]
        apart = tips[..., 1:, :] - tips[..., :1, :]
        distance = xp.sqrt((apart**2).sum(axis=-1))
        share = pinch_nearness(distance, xp)
        amount = share * xp.minimum(left.astype(points.dtype) * scale[..., None], distance)
        step = apart * (0.5 * amount / xp.maximum(distance, _TINY))[..., None]
        total = xp.maximum(share.sum(axis=-1), 1.0)
        thumb = step.sum(axis=-2) / total[..., None]  # its steps hold their share already
        moved = xp.concatenate([thumb[..., None, :], -step], axis=-2)
        return _put(points, [TIPS[i] for i in fingers], tips + moved, xp)

    def _reached(self, points: Any, hand: Hand, xp: ModuleType) -> Any:
        """Each finger about its base to the robot's reach; what pinches goes on pinching.

        Fingers that grow by different factors would part where they touch. So a finger near the
        thumb shares the thumb's displacement, the nearer the more.
        """
        fingers = [FINGERS.index(name) for name in hand.fingers]
        growth = np.array([self._of[name].scale / self.scale for name in hand.fingers]) - 1
        tips = points[..., [TIPS[i] for i in fingers], :]
        bases = points[..., [BASES[i] for i in fingers], :]
        moved = growth.astype(points.dtype)[:, None] * (tips - bases)
        apart = tips[..., 1:, :] - tips[..., :1, :]
        share = pinch_nearness(xp.sqrt((apart**2).sum(axis=-1)), xp)[..., None]
        thumb = (moved[..., :1, :] + (share * moved[..., 1:, :]).sum(axis=-2, keepdims=True)) / (
            1 + share.sum(axis=-2, keepdims=True)
        )
        others = moved[..., 1:, :] + share * (thumb - moved[..., 1:, :])
        tip = xp.concatenate([thumb, others], axis=-2)
        out = points
        for step in (1, 2, 3):  # the chain in proportion, the tip in full
            rows = [BASES[i] + step for i in fingers]
            out = _put(out, rows, points[..., rows, :] + tip * (step / 3), xp)
        return out


def tip_frames(
    points: AnyKind, fingers: list[int], axes: PalmAxes[np.ndarray]
) -> tuple[AnyKind, AnyKind]:
    """The frame of each fingertip: outwards along the last bone, and to the pad.

    The pad is on the side that a finger flexes to. That side is taken from the palm, and not from
    the bend of the finger, which a straight one doesn't show.

    Args:
        points: (..., 21, 3) landmarks in any frame [m].
        fingers: F indices of fingers, 0 for the thumb, which must be the first if it is there.
        axes: axes of the palm in that frame.

    Returns:
        two (..., F, 3) of unit vectors.
    """
    xp = array_namespace(points)
    distal, radial, palmar = (np.asarray(axis, points.dtype) for axis in axes)
    tips = [TIPS[i] for i in fingers]
    along = unit_vectors(points[..., tips, :] - points[..., [t - 1 for t in tips], :], xp)
    # Two cross products: a hand and its mirror image have mirrored pads.
    hinge = xp.broadcast_to(xp.asarray(np.cross(distal, palmar)), along.shape)
    if fingers[0] == 0:
        towards = THUMB_FLEXES_TOWARDS[0] * distal + THUMB_FLEXES_TOWARDS[1] * radial
        metacarpal = points[..., BASES[0] + 1, :] - points[..., BASES[0], :]
        thumb = xp.cross(metacarpal, xp.broadcast_to(xp.asarray(towards), metacarpal.shape))
        hinge = xp.concatenate([thumb[..., None, :], hinge[..., 1:, :]], axis=-2)
    return along, unit_vectors(xp.cross(hinge, along), xp)


def pinch_nearness(distance: Any, xp: ModuleType) -> Any:
    """Weight of a thumb-to-tip distance [m] as a pinch: 1 under 10 mm, 0 over 45 mm, smooth in
    between; ``xp`` is NumPy or JAX."""
    share = xp.clip((_FAR - distance) / (_FAR - _NEAR), 0, 1)
    return share * share * (3 - 2 * share)


def _put(points: Any, rows: list[int], values: Any, xp: ModuleType) -> Any:
    if xp is np:
        out = points.copy()
        out[..., rows, :] = values
        return out
    return points.at[..., np.array(rows), :].set(values.astype(points.dtype))


def _matrix(q: tuple[float, float, float, float]) -> Float[np.ndarray, "3 3"]:
    """Rotation matrix of a unit quaternion, w x y z."""
    w, v = q[0], np.array(q[1:])
    cross = np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])
    return np.asarray(np.eye(3) + 2 * w * cross + 2 * cross @ cross)
