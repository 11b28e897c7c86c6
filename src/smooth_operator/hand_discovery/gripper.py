"""Finds, in grippers with one moving jaw, the jaw, the part that it closes against, and the pads of
both."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Float
from scipy.spatial import cKDTree

from smooth_operator.errors import HandModelError, UnknownNameError
from smooth_operator.hand_discovery.branches import Branches, Chain
from smooth_operator.hand_discovery.landmarks import Overrules
from smooth_operator.hand_discovery.skeleton import Placement, Skeleton
from smooth_operator.hands.spec import FingerSpec, Point

_STEPS: Final = 61  # positions of the jaw that are compared
_OUTER: Final = 0.6  # part of the jaw that may hold its pad, over the reach from its joint
_CLOSED: Final = 1e-3  # margin above the least gap within which the jaws are closed [m]
_PATCH: Final = 0.05  # thickness of the layer of points that counts as the pad, over the reach
_BASES: Final = 0.6  # least distance of the bases of the two jaws, over the jaw's length
_WRIST: Final = (
    0.95  # from the jaws' bases to the wrist, over the jaw's length; as for a human hand
)
_CLOSES: Final = 0.2  # least decrease of the gap from open to closed, over the jaw's length
_MEETS: Final = 0.1  # largest gap of closed jaws that meet, over the reach
_NEUTRAL: Final = 0.4  # position between closed and open


@dataclass(frozen=True)
class Jaws:
    """The moving jaw and the fixed jaw of a gripper.

    Attributes:
        fingers: ``thumb``, the fixed jaw, and ``index``, the moving one.
        wrist: a point behind both.
        neutral: joint -> position in which the gripper is partly open [rad or m].
        confidence: confidence of the pads, 0 to 1.
        evidence: reasons for the pads.
    """

    fingers: tuple[FingerSpec, FingerSpec]
    wrist: Point
    neutral: dict[str, float]
    confidence: float
    evidence: tuple[str, ...]


def gripper_palm(skeleton: Skeleton, branches: Branches, joint: str) -> tuple[str, Chain | None]:
    """Body that carries the jaws of a gripper, found from the joint of a jaw.

    Args:
        joint: a hinge or slide with limits, of which one link follows another without a branch.

    Returns:
        Name of the body; and the chain of the jaw if no other chain branches from that body.

    Raises:
        UnknownNameError: there is no such joint.
        HandModelError: the joint has no limits, or moves more than one chain, like an arm's joint.
    """
    if joint not in skeleton.joint_names:
        raise UnknownNameError("joint", joint, skeleton.joint_names)
    j = skeleton.joint_names.index(joint)
    body = int(skeleton.model.jnt_bodyid[j])
    palm = int(skeleton.model.body_parentid[body])
    name = skeleton.body_name(palm)
    moved = [leaf for leaf in branches.leaves if body in skeleton.path(leaf)]
    beside = [leaf for leaf in branches.leaves if palm in (0, *skeleton.path(leaf)[:-1])]
    if len(moved) != 1:
        raise HandModelError(
            f"--gripper names {joint!r}, which moves {len(moved)} chains of links; expected the "
            "joint of one jaw"
        )
    if not skeleton.bounded[skeleton.free((j,))[0]]:
        raise HandModelError(
            f"--gripper names {joint!r}, which has no limits; add the limits of the jaw to the "
            'file (URDF: <limit lower="…" upper="…"/>, MJCF: range="… …")'
        )
    return name, branches.chain(palm, moved[0]) if beside == moved else None


def find_jaws(skeleton: Skeleton, chain: Chain, overrules: Overrules) -> Jaws:
    """Finds the pads of a gripper with one moving jaw.

    The jaw moves through its range. It is closed at the end where its outer part is nearest to the
    fixed part, and the pads are where the two touch first, or are nearest.

    Raises:
        HandModelError: a jaw has no shape, or the gap between them does not close.
    """
    at = skeleton.place(skeleton.reference)
    joint = skeleton.free(chain.joints)[0]
    fixed = _points(skeleton, chain.palm, at, None)
    jaw = _points(skeleton, chain.last, at, chain.last)
    tips = dict(overrules.tips)
    if not len(fixed) or not len(jaw):
        lacking = skeleton.body_name(chain.palm if not len(fixed) else chain.last)
        raise HandModelError(
            f"the gripper's pads can't be found, because {lacking!r} has no shape that can be "
            "read; put the mesh files at the paths in the model file"
        )
    outer, reach = _outer(skeleton, at, chain, jaw, fixed)
    low, high = skeleton.limits[joint]
    sweep = np.linspace(low, high, _STEPS)
    name = skeleton.joint_names[joint]
    places = [skeleton.place(skeleton.posed({name: value})) for value in sweep]
    surface = cKDTree(fixed)
    gaps = np.array([surface.query(p.world(chain.last, outer))[0].min() for p in places])
    if gaps[0] > gaps[-1]:  # from closed to open
        sweep, places, gaps = sweep[::-1], places[::-1], gaps[::-1]
    if gaps[-1] - gaps.min() < _CLOSES * reach:
        raise HandModelError(
            f"joint {name!r} changes the gap between "
            f"{skeleton.body_name(chain.last)!r} and {skeleton.body_name(chain.palm)!r} by only "
            f"{(gaps[-1] - gaps.min()) * 1e3:.0f} mm; expected the joint of a jaw that closes "
            "against the body that carries it"
        )
    k = int(np.flatnonzero(gaps < gaps.min() + _CLOSED)[-1])  # before the jaws overlap
    closed = places[k]
    distances, nearest = surface.query(closed.world(chain.last, outer))
    patch = distances < distances.min() + _PATCH * reach
    facing = fixed[nearest[patch]].mean(axis=0)
    pads = {
        "thumb": skeleton.point(chain.palm, closed.local(chain.palm, facing)),
        "index": skeleton.point(chain.last, outer[patch].mean(axis=0)),
    }
    for finger, point in tips.items():
        pads[finger] = _given_pad(skeleton, chain, finger, point)

    def pad(finger: str, place: Placement) -> Float[np.ndarray, "3"]:
        point = pads[finger]
        return place.world(skeleton.body(point.body), np.array(point.offset))

    def opening(place: Placement) -> float:
        return float(np.linalg.norm(pad("thumb", place) - pad("index", place)))

    thumb, index = pad("thumb", closed), pad("index", closed)
    opens = pad("index", places[min(k + 1, _STEPS - 1)]) - pad("index", places[max(k - 1, 0)])
    opens /= max(float(np.linalg.norm(opens)), 1e-9)
    base = _base(skeleton, chain, closed, index, reach, opens)
    length = float(np.linalg.norm(index - base))
    # The fixed jaw is the mirror image of the moving one in the plane where they meet.
    side = max(float((base - thumb) @ opens), _BASES * length / 2)
    base = base + (side - (base - thumb) @ opens) * opens
    root = base - 2 * side * opens
    forward = index - base - ((index - base) @ opens) * opens
    forward /= max(float(np.linalg.norm(forward)), 1e-9)

    def on_palm(place: np.ndarray) -> Point:
        return skeleton.point(chain.palm, closed.local(chain.palm, place))

    wrist = overrules.wrist or on_palm((base + root) / 2 - _WRIST * length * forward)
    skeleton.body(wrist.body)  # fails for an unknown body
    fingers = (
        FingerSpec("thumb", (on_palm(root), None, None, pads["thumb"])),
        FingerSpec("index", (on_palm(base), None, None, pads["index"])),
    )
    widths = (opening(closed), opening(places[-1]))
    given = set(tips) >= {"thumb", "index"}
    why = (
        "given"
        if given
        else f"where the jaws meet, at {sweep[k]:.3g}; the pads are {widths[0] * 1e3:.0f} mm apart "
        f"there and {widths[1] * 1e3:.0f} mm at {sweep[-1]:.3g}"
    )
    neutral = sweep[k] + _NEUTRAL * (sweep[-1] - sweep[k])
    return Jaws(
        fingers,
        wrist,
        {name: round(float(neutral), 4)},
        1.0 if given else 0.85 if gaps[k] < _MEETS * reach else 0.6,
        (why,),
    )


def _points(
    skeleton: Skeleton, body: int, at: Placement, local: int | None
) -> Float[np.ndarray, "p 3"]:
    """Points on all shapes that are fixed to a body, in the world or in a body's frame [m]."""
    clouds = [at.world(b, c) for b in skeleton.rigid(body) for c in skeleton.clouds.get(b, ())]
    points = np.concatenate(clouds) if clouds else np.empty((0, 3))
    return points if local is None else at.local(local, points)


def _outer(
    skeleton: Skeleton, at: Placement, chain: Chain, jaw: np.ndarray, fixed: np.ndarray
) -> tuple[Float[np.ndarray, "p 3"], float]:
    """Points of the outer part of a jaw, in its frame, and its reach from its hinge, or from the
    middle of the fixed part for a slide, at right angles to the joint's axis [m]."""
    joint = chain.joints[-1]
    axis = at.axes[joint]
    hinge = at.anchors[joint]
    centre = hinge if skeleton.turns[joint] else (fixed.min(axis=0) + fixed.max(axis=0)) / 2
    away = at.world(chain.last, jaw) - centre
    away = away - (away @ axis)[:, None] * axis
    distance = np.linalg.norm(away, axis=1)
    reach = float(np.quantile(distance, 0.99))
    return jaw[distance > _OUTER * reach], reach


def _base(
    skeleton: Skeleton,
    chain: Chain,
    at: Placement,
    pad: np.ndarray,
    reach: float,
    opens: np.ndarray,
) -> Float[np.ndarray, "3"]:
    """Start of the moving jaw, level with its pad: its hinge, or for a slide the reach behind."""
    joint = chain.joints[-1]
    axis, anchor = at.axes[joint], at.anchors[joint]
    if skeleton.turns[joint]:
        level: np.ndarray = anchor + ((pad - anchor) @ axis) * axis
        return level
    back = at.bodies[chain.palm] - pad
    back = back - (back @ opens) * opens
    start: np.ndarray = pad + reach * back / max(float(np.linalg.norm(back)), 1e-9)
    return start


def _given_pad(skeleton: Skeleton, chain: Chain, finger: str, point: Point) -> Point:
    """The pad that the user names; it must be fixed to its jaw."""
    jaws = {"thumb": chain.palm, "index": chain.last}
    if finger not in jaws:
        raise HandModelError(
            f"--tip names the finger {finger!r}; a gripper has thumb, the fixed jaw, and index"
        )
    bodies = skeleton.rigid(jaws[finger])
    if skeleton.body(point.body) not in bodies:
        options = ", ".join(repr(skeleton.body_name(b)) for b in bodies if b)
        raise HandModelError(
            f"--tip puts the pad of {finger} on {point.body!r}; choose a body that is fixed to "
            f"that jaw: {options}"
        )
    return point
