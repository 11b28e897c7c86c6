"""Check that fingertips are at the ends of fingers: distances to the shapes of bodies."""

from __future__ import annotations

from functools import partial
from typing import Any, Final

import mujoco
import numpy as np
from jaxtyping import Float

from smooth_operator.errors import require
from smooth_operator.hands.hand import Hand
from smooth_operator.lab.validation.checks import Check
from smooth_operator.lab.validation.samples import movers
from smooth_operator.landmarks import BASES, FINGERS, LANDMARKS

_OFF: Final = 0.04  # a tip this far from its link's shapes is none of that link [m]
_BESIDE: Final = 0.01  # further than a fingertip is thick: some models leave out its pad [m]
_INSIDE: Final = 2e-3  # a tip this deep in another part is not free [m]
_LONG: Final = 1.7  # last phalanx over the longest other; built-in hands: 1.3


def check_tips(hand: Hand) -> tuple[Check, tuple[str, ...]]:
    """Checks that each tip moves, belongs to one finger, and is near its link and in no other part.

    Returns:
        the check, and the fingers whose tips can be relied upon.
    """
    faults: dict[str, str] = {}
    distant: dict[str, float] = {}
    figures: dict[str, dict[str, float]] = {}
    ends: dict[int, str] = {}
    for finger, landmark in zip(hand.spec.fingers, hand.tip_names, strict=True):
        chain = movers(hand, landmark)
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
            faults[finger.name] = f"makes a last phalanx {stretch:.1f} times as long as the others"
        elif away > _BESIDE:
            distant[finger.name] = 1e3 * away
    sound = tuple(name for name in hand.fingers if name not in faults)
    advice = "give the tip as a body of the finger's last link, with an offset in metres to its pad"
    check = partial(Check, "fingertips", figures=figures)
    if faults:
        summary = "; ".join(f"{name} tip {text}" for name, text in faults.items())
        return check("failed", summary, advice), sound
    if distant:
        summary = (
            f"{', '.join(distant)}: up to {max(distant.values()):.0f} mm away from the shapes of "
            "the link"
        )
        advice = f"if the model doesn't just lack the fingertips' shapes, {advice}"
        return check("warning", summary, advice), sound
    own = [place["own"] for place in figures.values() if "own" in place]
    summary = "each moves with its finger"
    if own:
        summary += (
            f", {min(own):.1f} to {max(own):.1f} mm from its link's shapes (negative: inside)"
        )
    else:
        summary += "; the model has no shapes of the last links to compare with"
    return check("ok", summary), sound


def _place(hand: Hand, finger: str) -> dict[str, float]:
    """``own``: distance to the tip's own link; ``other``: to the nearest other part [m].

    Links beyond the tip are not looked at: another check reports joints that move them in vain.
    """
    spec = hand.spec.fingers[hand.fingers.index(finger)]
    body = hand.model.body(spec.tip.body).id
    point = spec.tip.mirrored if hand.spec.mirror else spec.tip
    distances = part_distances(hand, body, np.asarray(point.offset))
    part = int(hand.model.body_weldid[body])
    own = distances.pop(part, None)
    distances = {k: d for k, d in distances.items() if part not in _above(hand, k)}
    out = {} if own is None else {"own": own}
    return out | ({"other": min(distances.values())} if distances else {})


def _above(hand: Hand, part: int) -> set[int]:
    """The parts that a part hangs from."""
    above: set[int] = set()
    while part:
        part = int(hand.model.body_weldid[hand.model.body_parentid[part]])
        above.add(part)
    return above


def _stretch(hand: Hand, finger: str) -> float:
    """Last phalanx over the longest of the others, between the finger's own joints."""
    names = [LANDMARKS[BASES[FINGERS.index(finger)] + i] for i in range(4)]
    at = dict(zip(hand.tree.names, hand.landmark_positions(hand.neutral), strict=True))
    points = np.array([at[name] for name in names if name in at])
    lengths = np.linalg.norm(np.diff(points, axis=0), axis=1)
    return float(lengths[-1] / max(lengths[:-1].max(), 1e-9)) if len(lengths) > 1 else 0.0


_G: Final = mujoco.mjtGeom


def part_distances(hand: Hand, body: int, point: Float[np.ndarray, "3"]) -> dict[int, float]:
    """Signed distances of a point that is fixed to a body, in the hand's neutral pose.

    Args:
        point: (3,) in the body's frame [m].

    Returns:
        part (a body; those fixed to each other are one, named after the first) -> distance to the
        nearest of its shapes [m], negative inside; parts without shapes are left out.
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
    if kind == _G.mjGEOM_SPHERE:
        return float(np.linalg.norm(p) - size[0])
    if kind == _G.mjGEOM_CAPSULE:
        axis = np.array([0.0, 0.0, np.clip(p[2], -size[1], size[1])])
        return float(np.linalg.norm(p - axis) - size[0])
    if kind == _G.mjGEOM_CYLINDER:
        return _corner(np.array([np.hypot(p[0], p[1]) - size[0], abs(p[2]) - size[1]]))
    if kind == _G.mjGEOM_BOX:
        return _corner(abs(p) - size)
    if kind == _G.mjGEOM_ELLIPSOID:
        # exact on the surface, and good enough near it
        scaled = np.linalg.norm(p / size)
        slope = np.linalg.norm(p / size**2)
        return float(scaled * (scaled - 1) / slope) if slope > 0 else -float(size.min())
    if kind == _G.mjGEOM_MESH:
        return _mesh_distance(model, int(model.geom_dataid[geom]), p)
    return None


def _corner(past: np.ndarray) -> float:
    """Distance to a box, by how far the point is past each pair of faces."""
    return float(np.linalg.norm(np.maximum(past, 0)) + min(past.max(), 0.0))


def _mesh_distance(model: mujoco.MjModel, mesh: int, p: np.ndarray) -> float:
    require("the shape of a mesh", "lab", "trimesh")
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

    Small holes, as vendors' meshes have, change it little (van Oosterom and Strackee 1983).
    """
    a, b, c = np.moveaxis(corners, 1, 0)
    la, lb, lc = (np.linalg.norm(v, axis=1) for v in (a, b, c))
    volume = np.einsum("ij,ij->i", a, np.cross(b, c))
    rest = la * lb * lc
    for u, v, length in ((a, b, lc), (b, c, la), (c, a, lb)):
        rest = rest + np.einsum("ij,ij->i", u, v) * length
    return abs(float(np.arctan2(volume, rest).sum())) / (2 * np.pi)
