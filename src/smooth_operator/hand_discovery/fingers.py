"""Checks of fingers: their closing directions, the declared side, and the fingertips.

If the fingers point along f and close towards p, a right hand has its thumb and index finger on the
side of f x p: on your right, if you see the palm with the fingers up. A left hand is its mirror
image."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any, Final

import mujoco
import numpy as np
from jaxtyping import Float

from smooth_operator.errors import require
from smooth_operator.hand_discovery.checks import Check, Samples, movers
from smooth_operator.hands.hand import Hand
from smooth_operator.hands.penetration import parts_above
from smooth_operator.landmarks import BASES, FINGERS, LANDMARKS

_PARALLEL: Final = 0.8  # least cosine of two axes that bend a finger in one plane
_BENDS: Final = 0.05  # least difference of the two ways to fold, over the finger's length
_AGREE: Final = 0.0  # least cosine of a finger's closing direction to that of the others
_SKEW: Final = 0.4  # cosine below which a finger closes sideways
_CLEAR: Final = 0.12  # distance over a finger's length at which a thumb is clearly on one side


@dataclass(frozen=True, eq=False)
class FlexionAxes:
    """Pointing and closing directions of the fingers other than the thumb, in the palm frame.

    Attributes:
        names: fingers that clearly fold in one direction.
        forward: (f, 3) unit vectors from base to tip of the straight fingers.
        closing: (f, 3) unit vectors at right angles to ``forward``: motion of the tips when the
            fingers fold.
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
        """Direction out of the palm: the mean of the directions in which most fingers close."""
        near = self.closing @ self.closing.T
        most = int(np.argmax((near > _AGREE).sum(axis=1) + near.mean(axis=1)))
        return _unit(self.closing[near[most] > _AGREE].mean(axis=0))

    @property
    def lateral(self) -> Float[np.ndarray, "3"]:
        """Direction across the palm, towards the thumb's side of a right hand."""
        return _unit(np.cross(self.forward.mean(axis=0), self.palmar))


def find_flexion_axes(samples: Samples, sound: tuple[str, ...]) -> FlexionAxes | None:
    """Finds the direction in which each finger closes when its flexion joints fold it.

    Args:
        sound: fingers with a sound tip.

    Returns:
        The axes; None if no finger clearly folds in one direction.
    """
    hand = samples.hand
    names, forward, closing, bases, lengths = [], [], [], [], []
    for i, name in enumerate(hand.fingers):
        if name == "thumb" or name not in sound:
            continue
        bend = _Bend(hand, i)
        straight = hand.straight_pose.q
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
    """One finger that turns about the axis of its last hinge; all other joints stay at neutral."""

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
                weights = hand.transmission.slopes(hand.neutral)[j]
                for k in np.flatnonzero(weights):
                    self._drives[int(k)] = self._drives.get(int(k), 0.0) + along * weights[k]

    def ends(self, q: np.ndarray) -> Float[np.ndarray, "2 3"]:
        """Base and tip in a pose, palm frame [m]."""
        return self.hand.landmark_positions(q)[self._ends]

    def folded(self, straight: np.ndarray, sense: int) -> float:
        """Distance of base and tip with all flexion joints at their limits in a direction [m]."""
        q = straight.copy()
        for k, turn in self._drives.items():
            q[k] = self.hand.limits[k, int(turn * sense > 0)]
        base, tip = self.ends(q)
        return float(np.linalg.norm(tip - base))


def check_flexion(axes: FlexionAxes | None) -> Check:
    """Checks that all fingers close in the same direction."""
    if axes is None:
        return Check("flexion", "skipped", "no finger bends enough to determine a direction")
    cosines = axes.closing @ axes.palmar
    figures = {n: round(float(c), 3) for n, c in zip(axes.names, cosines, strict=True)}
    text = f"all fingers close in the same direction (cosine {cosines.min():.2f} or more)"
    check = partial(Check, "flexion", figures=figures)
    if against := [n for n, c in figures.items() if c < _AGREE]:
        return check(
            "failed",
            f"{', '.join(against)}: closes in the direction opposite to the others",
            "in the model, change the sign of this finger's flexion axes or limits",
        )
    if skew := [n for n, c in figures.items() if c < _SKEW]:
        return check(
            "warning",
            f"{', '.join(skew)}: closes sideways relative to the others (cosine "
            f"{cosines.min():.2f})",
            "check the axes and the tip of that finger",
        )
    return check("ok", text)


def check_side(samples: Samples, axes: FlexionAxes | None, sound: tuple[str, ...]) -> Check:
    """Checks that the thumb, the order of the fingers and the closing direction agree with the
    declared side."""
    hand = samples.hand
    if hand.spec.gripper:
        return Check("side", "ok", "a gripper has no side: either human hand can drive it")
    if axes is None or "thumb" not in sound:
        return Check("side", "skipped", "not checked: correct the fingertips or axes first")
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
    text = f"thumb {figures['thumb_mm']:+.0f} mm from the other fingers" + (
        f", {first} {figures['first_finger_mm']:+.0f} mm from {last}" if order else ""
    )
    text += f", towards the thumb's side of a {hand.spec.side} hand"
    other = "left" if hand.spec.side == "right" else "right"
    check = partial(Check, "side", figures=figures)
    if (order < -_CLEAR and thumb_offset < _CLEAR) or (thumb_offset < -_CLEAR and order <= _CLEAR):
        return check(
            "failed",
            text,
            f'this is a {other} hand: set side = "{other}" (or mirror = true, if the model is of '
            "the other hand)",
        )
    if order < -_CLEAR:
        return check(
            "failed",
            text,
            f"the names of the fingers are in the wrong order: {first} should be next to the thumb",
        )
    if thumb_offset < -_CLEAR:
        return check(
            "warning",
            text,
            "the finger detected as the thumb is next to the little finger; if it is not the "
            "thumb, name the correct one with --thumb",
        )
    if max(thumb_offset, order) < _CLEAR:
        return check("ok", f"{text}, so the hand can serve as a right or a left hand")
    return check("ok", text)


def _unit(vector: np.ndarray) -> np.ndarray:
    out: np.ndarray = vector / max(float(np.linalg.norm(vector)), 1e-12)
    return out


_OFF: Final = 0.04  # distance from its link's shapes at which a tip is wrong [m]
_BESIDE: Final = 0.01  # largest usual distance, a fingertip's thickness; some models lack a pad [m]
_INSIDE: Final = 2e-3  # depth in another part at which a tip is wrong [m]
_LONG: Final = 1.7  # largest last phalanx over the longest other one; built-in hands: 1.3


def check_tips(hand: Hand) -> tuple[Check, tuple[str, ...]]:
    """Checks that each fingertip moves, belongs to one finger, is near its link, and is not inside
    other parts.

    Returns:
        The check, and the fingers with a sound tip.
    """
    faults: dict[str, str] = {}
    distant: dict[str, float] = {}
    figures: dict[str, dict[str, float]] = {}
    ends: dict[int, str] = {}
    for finger, landmark in zip(hand.spec.fingers, hand.tip_names, strict=True):
        chain = movers(hand, landmark)
        if not chain and hand.spec.gripper:
            continue  # a fixed jaw
        if not chain:
            faults[finger.name] = f"is fixed to the palm, on body {finger.tip.body}"
            continue
        if chain[-1] in ends:
            faults[finger.name] = f"is on the last link of the {ends[chain[-1]]}"
            continue
        ends[chain[-1]] = finger.name
        place = _place(hand, finger.name)
        figures[finger.name] = {name: round(1e3 * value, 1) for name, value in place.items()}
        away, stretch = place.get("own", 0.0), _stretch(hand, finger.name)
        if place.get("other", 0.0) < -_INSIDE:
            faults[finger.name] = f"is {-1e3 * place['other']:.0f} mm inside another part"
        elif away > _OFF:
            faults[finger.name] = f"is {1e3 * away:.0f} mm away from the shapes of its link"
        elif stretch > _LONG:
            faults[finger.name] = (
                f"makes the last phalanx {stretch:.1f} times as long as those of the other fingers"
            )
        elif away > _BESIDE:
            distant[finger.name] = 1e3 * away
    sound = tuple(name for name in hand.fingers if name not in faults)
    advice = "set the tip to a body of the finger's last link, with an offset in metres to its pad"
    check = partial(Check, "fingertips", figures=figures)
    if faults:
        summary = "; ".join(f"{name} tip {text}" for name, text in faults.items())
        return check("failed", summary, advice), sound
    if distant:
        summary = (
            f"{', '.join(distant)}: up to {max(distant.values()):.0f} mm away from the shapes of "
            "the link"
        )
        advice = f"unless the model has no fingertip shapes, {advice}"
        return check("warning", summary, advice), sound
    own = [place["own"] for place in figures.values() if "own" in place]
    summary = "each fingertip moves with its finger"
    if own:
        summary += (
            f", {min(own):.1f} to {max(own):.1f} mm from its link's shapes (negative: inside)"
        )
    else:
        summary += "; the model has no shapes of the last links for comparison"
    return check("ok", summary), sound


def _place(hand: Hand, finger: str) -> dict[str, float]:
    """Distances of a tip [m]: ``own`` to its own link, ``other`` to the nearest other part.

    Links beyond the tip do not count; ``check_motion`` reports the joints that move them.
    """
    spec = hand.spec.fingers[hand.fingers.index(finger)]
    body = hand.model.body(spec.tip.body).id
    point = spec.tip.mirrored if hand.spec.mirror else spec.tip
    distances = part_distances(hand, body, np.asarray(point.offset))
    part = int(hand.model.body_weldid[body])
    own = distances.pop(part, None)
    distances = {k: d for k, d in distances.items() if part not in parts_above(hand.model, k)}
    out = {} if own is None else {"own": own}
    return out | ({"other": min(distances.values())} if distances else {})


def _stretch(hand: Hand, finger: str) -> float:
    """Length of the last phalanx over the longest of the others."""
    names = [LANDMARKS[BASES[FINGERS.index(finger)] + i] for i in range(4)]
    at = dict(zip(hand.tree.names, hand.landmark_positions(hand.neutral), strict=True))
    points = np.array([at[name] for name in names if name in at])
    lengths = np.linalg.norm(np.diff(points, axis=0), axis=1)
    return float(lengths[-1] / max(lengths[:-1].max(), 1e-9)) if len(lengths) > 1 else 0.0


_G: Final = mujoco.mjtGeom


def part_distances(hand: Hand, body: int, point: Float[np.ndarray, "3"]) -> dict[int, float]:
    """Signed distances from a point on a body to the parts of the hand, in the neutral pose.

    Args:
        point: (3,) position in the body's frame [m].

    Returns:
        Part -> distance to the nearest of its shapes [m], negative inside, without parts that have
        no shapes. A part is the first of bodies without a joint between them (``body_weldid``).
    """
    model, data = hand.model, mujoco.MjData(hand.model)
    data.qpos[:] = hand.qpos(hand.full_configuration(hand.neutral))
    mujoco.mj_kinematics(model, data)
    at = data.xpos[body] + data.xmat[body].reshape(3, 3) @ point
    out: dict[int, float] = {}
    for geom in range(model.ngeom):
        if not hand.bodies[model.geom_bodyid[geom]]:
            continue
        local = data.geom_xmat[geom].reshape(3, 3).T @ (at - data.geom_xpos[geom])
        distance = _distance(model, geom, local)
        if distance is not None:
            part = int(model.body_weldid[model.geom_bodyid[geom]])
            out[part] = min(distance, out.get(part, np.inf))
    return out


def _distance(model: mujoco.MjModel, geom: int, p: np.ndarray) -> float | None:
    """Signed distance of a point in the shape's own frame; None for shapes without a volume."""
    kind, size = int(model.geom_type[geom]), np.asarray(model.geom_size[geom], float)
    if kind == _G.mjGEOM_SPHERE:  # MuJoCo keeps sizes of a sphere that it does not use
        return float(np.linalg.norm(p) - size[0])
    if kind == _G.mjGEOM_CAPSULE:
        axis = np.array([0.0, 0.0, np.clip(p[2], -size[1], size[1])])
        return float(np.linalg.norm(p - axis) - size[0])
    if kind == _G.mjGEOM_CYLINDER:
        return _corner(np.array([np.hypot(p[0], p[1]) - size[0], abs(p[2]) - size[1]]))
    if kind == _G.mjGEOM_BOX:
        return _corner(abs(p) - size)
    if kind == _G.mjGEOM_ELLIPSOID:
        # exact on the surface, approximate near it
        scaled = np.linalg.norm(p / size)
        slope = np.linalg.norm(p / size**2)
        return float(scaled * (scaled - 1) / slope) if slope > 0 else -float(size.min())
    if kind == _G.mjGEOM_MESH:
        return _mesh_distance(model, int(model.geom_dataid[geom]), p)
    return None


def _corner(past: np.ndarray) -> float:
    """Signed distance to a box from the distances beyond its pairs of faces."""
    return float(np.linalg.norm(np.maximum(past, 0)) + min(past.max(), 0.0))


def _mesh_distance(model: mujoco.MjModel, mesh: int, p: np.ndarray) -> float:
    require("the shape of a mesh", "teleop", "trimesh")
    import trimesh

    first, count = int(model.mesh_vertadr[mesh]), int(model.mesh_vertnum[mesh])
    vertices = np.asarray(model.mesh_vert[first : first + count], float)
    face, faces = int(model.mesh_faceadr[mesh]), int(model.mesh_facenum[mesh])
    corners: np.ndarray = vertices[np.asarray(model.mesh_face[face : face + faces])]
    closest_point: Any = trimesh.triangles.closest_point
    nearest = closest_point(corners, np.tile(p, (faces, 1)))
    distance = float(np.linalg.norm(nearest - p, axis=1).min())
    return -distance if _winding(corners - p) > 0.5 else distance


def _winding(corners: Float[np.ndarray, "n 3 3"]) -> float:
    """Winding number of a mesh around the origin, by its solid angles: 1 inside, 0 outside.

    Small holes, which vendors' meshes have, change it little (van Oosterom and Strackee 1983).
    """
    a, b, c = np.moveaxis(corners, 1, 0)
    la, lb, lc = (np.linalg.norm(v, axis=1) for v in (a, b, c))
    volume = np.einsum("ij,ij->i", a, np.cross(b, c))
    rest = la * lb * lc
    for u, v, length in ((a, b, lc), (b, c, la), (c, a, lb)):
        rest = rest + np.einsum("ij,ij->i", u, v) * length
    return abs(float(np.arctan2(volume, rest).sum())) / (2 * np.pi)
