"""Check of the direction in which fingers bend, and of the declared side.

With fingers pointing along f and closing towards p, a right hand has its thumb, and its index
finger, on the side of f x p: palm towards you and fingers up, on your right. A left hand is its
mirror image.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Final

import mujoco
import numpy as np
from jaxtyping import Float

from smooth_operator.hands.hand import Hand
from smooth_operator.lab.validation.checks import Check
from smooth_operator.lab.validation.samples import Samples, movers
from smooth_operator.landmarks import BASES, FINGERS, LANDMARKS

_PARALLEL: Final = 0.8  # cosine of two axes that bend a finger in one plane
_STEPS: Final = 9
_BENDS: Final = 0.05  # of a finger's length: how much more it folds one way than the other
_AGREE: Final = 0.0  # cosine of a finger's closing direction to that of the others
_SKEW: Final = 0.4  # cosine below which they close across each other
_CLEAR: Final = 0.12  # of a finger's length: thumb or index clearly to one side


@dataclass(frozen=True, eq=False)
class FlexionAxes:
    """Pointing and closing directions of the fingers other than the thumb, palm frame.

    Attributes:
        names: the fingers that fold clearly one way.
        forward: (f, 3) unit vectors, base to tip, straight.
        closing: (f, 3) unit vectors at right angles to them, in which the tips go when they fold.
        bases: (f, 3) finger bases [m].
        length: median length of a finger [m].
    """

    names: tuple[str, ...]
    forward: Float[np.ndarray, "f 3"]
    closing: Float[np.ndarray, "f 3"]
    bases: Float[np.ndarray, "f 3"]
    length: float

    @property
    def palmar(self) -> Float[np.ndarray, "3"]:
        """Direction out of the palm: towards which most fingers close."""
        near = self.closing @ self.closing.T
        most = int(np.argmax((near > _AGREE).sum(axis=1) + near.mean(axis=1)))
        return _unit(self.closing[near[most] > _AGREE].mean(axis=0))

    @property
    def lateral(self) -> Float[np.ndarray, "3"]:
        """Across the palm, to the thumb's side of a right hand."""
        return _unit(np.cross(self.forward.mean(axis=0), self.palmar))


def find_flexion_axes(samples: Samples, sound: tuple[str, ...]) -> FlexionAxes | None:
    """Finds each finger's closing direction: the turn of its flexion joints that folds it.

    Args:
        sound: fingers whose tips can be relied upon.

    Returns:
        the axes of the fingers that fold clearly one way; None if none does.
    """
    hand = samples.hand
    names, forward, closing, bases, lengths = [], [], [], [], []
    for i, name in enumerate(hand.fingers):
        if name == "thumb" or name not in sound:
            continue
        bend = _Bend(hand, i)
        straight = bend.straightened()
        base, tip = bend.ends(straight)
        length = float(np.linalg.norm(tip - base))
        plus, minus = bend.folded(straight, 1), bend.folded(straight, -1)
        if abs(plus - minus) < _BENDS * length:
            continue
        axis = bend.axis if plus < minus else -bend.axis
        along = _unit(tip - base - ((tip - base) @ axis) * axis)
        names.append(name)
        forward.append(along)
        closing.append(np.cross(axis, along))
        bases.append(base)
        lengths.append(length)
    if not names:
        return None
    return FlexionAxes(
        tuple(names),
        np.array(forward),
        np.array(closing),
        np.array(bases),
        float(np.median(lengths)),
    )


class _Bend:
    """One finger about its flexion axis, the one of its last hinge; all else at neutral.

    Args:
        hand: the hand.
        finger: its index.
    """

    def __init__(self, hand: Hand, finger: int) -> None:
        self.hand = hand
        base = LANDMARKS[BASES[FINGERS.index(hand.fingers[finger])]]
        self._ends = [hand.tree.names.index(n) for n in (base, hand.tip_names[finger])]
        model, data = hand.model, mujoco.MjData(hand.model)
        data.qpos[:] = hand.qpos(hand.full_configuration(hand.neutral))
        mujoco.mj_kinematics(model, data)
        palm = data.xmat[model.body(hand.spec.palm).id].reshape(3, 3)
        self.axis: np.ndarray = np.zeros(3)
        self._drives: dict[int, float] = {}  # actuated joint -> sense in which it turns the finger
        for j in reversed(movers(hand, hand.tip_names[finger])):
            joint = int(model.joint(hand.joint_names[j]).id)
            if model.jnt_type[joint] != int(mujoco.mjtJoint.mjJNT_HINGE):
                continue
            axis = palm.T @ data.xaxis[joint]
            self.axis = self.axis if self.axis.any() else axis
            if abs(along := float(axis @ self.axis)) > _PARALLEL:
                weights = hand.coupling_matrix[j]
                for k in np.flatnonzero(weights):
                    self._drives[int(k)] = self._drives.get(int(k), 0.0) + along * weights[k]

    def ends(self, q: np.ndarray) -> Float[np.ndarray, "2 *batch 3"]:
        """Base and tip in a pose, or in many, palm frame [m]."""
        points = self.hand.landmark_positions(q)
        return np.stack([points[..., end, :] for end in self._ends])

    def straightened(self) -> Float[np.ndarray, " m"]:
        """The pose of the flexion joints in which the tip is farthest from the base."""
        best = self.hand.neutral.copy()
        for _ in range(2):
            for k in self._drives:
                low, high = self.hand.limits[k].tolist()
                trials = np.repeat(best[None], _STEPS + 1, axis=0)
                trials[1:, k] = np.linspace(low, high, _STEPS)
                # as it is, unless another is better by more than rounding
                reach = self._reach(trials)
                reach[0] += 1e-6
                best = trials[int(np.argmax(reach))]
        return best

    def folded(self, straight: np.ndarray, sense: int) -> float:
        """Distance of base and tip with all flexion joints turned that way to their limits [m]."""
        q = straight.copy()
        for k, turn in self._drives.items():
            q[k] = self.hand.limits[k, int(turn * sense > 0)]
        return float(self._reach(q))

    def _reach(self, q: np.ndarray) -> Float[np.ndarray, "*batch"]:
        base, tip = self.ends(q)
        return np.asarray(np.linalg.norm(tip - base, axis=-1))


def check_flexion(axes: FlexionAxes | None) -> Check:
    """Checks that all fingers close towards one side."""
    if axes is None:
        return Check("flexion", "skipped", "no finger bends clearly enough to tell a direction")
    cosines = axes.closing @ axes.palmar
    figures = {n: round(float(c), 3) for n, c in zip(axes.names, cosines, strict=True)}
    text = f"all fingers close towards one side (cosine {cosines.min():.2f} or more)"
    check = partial(Check, "flexion", figures=figures)
    if against := [n for n, c in figures.items() if c < _AGREE]:
        return check(
            "failed",
            f"{', '.join(against)}: closes away from the side to which the others close",
            "turn the sign of its flexion axes in the model, or of its limits",
        )
    if skew := [n for n, c in figures.items() if c < _SKEW]:
        return check(
            "warning",
            f"{', '.join(skew)}: closes across the others (cosine {cosines.min():.2f})",
            "look at the axes of that finger, and at its tip",
        )
    return check("ok", text)


def check_side(samples: Samples, axes: FlexionAxes | None, sound: tuple[str, ...]) -> Check:
    """Checks that thumb, order of fingers and closing direction agree with the declared side."""
    hand = samples.hand
    if axes is None or "thumb" not in sound:
        return Check("side", "skipped", "not checked: fingertips or axes have to be mended first")
    sign = 1.0 if hand.spec.side == "right" else -1.0
    across = sign * axes.lateral / axes.length
    thumb = hand.fingers.index("thumb")
    middle = [samples.tips[:, hand.fingers.index(name)].mean(axis=0) for name in axes.names]
    by_base = (samples.bases[:, thumb].mean(axis=0) - axes.bases.mean(axis=0)) @ across
    by_reach = (samples.tips[:, thumb].mean(axis=0) - np.mean(middle, axis=0)) @ across
    thumb_offset = float(by_base + by_reach) / 2
    order = float((axes.bases[0] - axes.bases[-1]) @ across) if len(axes.names) > 1 else 0.0
    figures = {
        "thumb_mm": round(1e3 * thumb_offset * axes.length, 1),
        "first_finger_mm": round(1e3 * order * axes.length, 1),
    }
    first, last = axes.names[0], axes.names[-1]
    text = f"thumb {figures['thumb_mm']:+.0f} mm" + (
        f", {first} {figures['first_finger_mm']:+.0f} mm from {last}" if order else ""
    )
    text += f" to where they are on a {hand.spec.side} hand"
    other = "left" if hand.spec.side == "right" else "right"
    check = partial(Check, "side", figures=figures)
    if (order < -_CLEAR and thumb_offset < _CLEAR) or (thumb_offset < -_CLEAR and order <= _CLEAR):
        return check(
            "failed",
            text,
            f'this is a {other} hand: side = "{other}" (or, of a model of the other hand, '
            "mirror = true)",
        )
    if order < -_CLEAR:
        return check(
            "failed",
            text,
            f"the fingers are named in the wrong order: {first} should be next to the thumb",
        )
    if thumb_offset < -_CLEAR:
        return check("warning", text, "the thumb is on the little finger's side: is it the thumb?")
    if max(thumb_offset, order) < _CLEAR:
        return check("ok", f"{text}: it may serve as either")
    return check("ok", text)


def _unit(vector: np.ndarray) -> np.ndarray:
    out: np.ndarray = vector / max(float(np.linalg.norm(vector)), 1e-12)
    return out
