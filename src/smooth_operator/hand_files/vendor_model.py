"""Applies a hand's description to another model of the hand, such as the vendor's model with
meshes.

The built-in compact models keep the vendor's joints and the frames of the links that these move. A
point on a link is therefore the same point on the vendor's link with the same joint, whatever the
names of the bodies; the palm is the vendor's body in whose frame the first links have the same
poses as in our palm frame.

Models with meshes are also available from MuJoCo Menagerie through its package (extra
``menagerie``). The package downloads a hand's archive (0.3 to 1.5 MB) on the first request and
keeps it in its own cache; its environment variable ``MENAGERIE_ROOT`` names a checkout of Menagerie
to use instead.
"""

from __future__ import annotations

from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Final

import mujoco
import numpy as np
from jaxtyping import Float

from smooth_operator.errors import HandModelError, MissingExtraError
from smooth_operator.hands.hand import Hand, load_hand_spec
from smooth_operator.hands.loading import load_model
from smooth_operator.hands.spec import FingerSpec, HandSpec, Point
from smooth_operator.hands.stand_ins import stand_in_links
from smooth_operator.types import Side

_SAME: Final = 1e-3  # largest distance of landmarks of the same hand [m]
_POSES: Final = 32

_Frame = tuple[Float[np.ndarray, "3 3"], Float[np.ndarray, "3"]]


def on_model(hand: Hand, path: str | Path) -> Hand:
    """Loads a hand with another model of it, such as the vendor's.

    Args:
        hand: a hand, not a mirrored one.
        path: MJCF or URDF file with the hand's joints, by their names; it may have more, such as a
            wrist's or an arm's.

    Raises:
        HandModelError: the model can't be used, lacks joints, or is of another hand (its landmarks
            have other positions).
    """
    path = Path(path)
    if hand.spec.mirror:
        raise HandModelError(
            f"the {hand.spec.side} hand {hand.name!r} is a mirror image, so it has no model "
            "of its own; use the other side"
        )
    model = load_model(path).model
    names = {model.joint(j).name for j in range(model.njnt)}
    if missing := [name for name in hand.joint_names if name not in names]:
        raise HandModelError(
            f"{path} lacks the joints {', '.join(missing)} of the {hand.spec.side} hand "
            f"{hand.name!r}; name a model of that hand and side"
        )
    other = load_hand_spec(_carried(hand, model, path))
    distance = _difference(hand, other)
    if not distance < _SAME:
        raise HandModelError(
            f"{path} is not the {hand.spec.side} {hand.name!r}: at equal joint "
            f"positions their landmarks are up to {distance * 1e3:.1f} mm apart"
        )
    return other


def _carried(hand: Hand, model: mujoco.MjModel, path: Path) -> HandSpec:
    spec, palm = hand.spec, _palm(hand, model)

    def carry(point: Point) -> Point:
        body = hand.model.body(point.body).id
        link = int(hand.model.body_weldid[body])  # a tip, say, is fixed to the last link
        joint = int(hand.model.body_jntadr[link])
        if joint >= 0 and hand.model.joint(joint).name in hand.joint_names:
            there = int(model.jnt_bodyid[model.joint(hand.model.joint(joint).name).id])
            name = _name(model, there, path)
        else:
            link, name = hand.model.body(spec.palm).id, palm
        rotation, position = _relative(hand.model, link, body)
        x, y, z = rotation @ np.asarray(point.offset) + position
        return Point(name, (float(x), float(y), float(z)))

    fingers = []
    for finger in spec.fingers:
        a, b, c, d = (None if point is None else carry(point) for point in finger.points)
        fingers.append(FingerSpec(finger.name, (a, b, c, d)))
    return replace(
        spec,
        model=path,
        palm=palm,
        wrist=carry(spec.wrist),
        fingers=tuple(fingers),
        neutral={name: q for name, q in spec.neutral.items() if name in hand.joint_names},
        torque=None,
        wrist_joints=(),
    )


def _palm(hand: Hand, model: mujoco.MjModel) -> str:
    """Name of the body in whose frame the first links have the same poses as in our palm frame."""
    ours = hand.model.body(hand.spec.palm).id
    held = hand.model.body_weldid[ours]
    links = []
    for name in hand.joint_names:
        body = int(hand.model.joint(name).bodyid[0])
        if hand.model.body_weldid[hand.model.body_parentid[body]] == held:
            there = int(model.joint(name).bodyid[0])
            links.append((there, _relative(hand.model, ours, body)))

    def apart(body: int) -> float:
        frames = [(_relative(model, body, link), there) for link, there in links]
        return max(float(np.abs(R - S).max() + np.abs(p - q).max()) for (R, p), (S, q) in frames)

    # of bodies with one frame, such as a mount and the palm on it, the innermost
    best = min(range(1, model.nbody), key=lambda body: (round(apart(body) / _SAME, 2), -body))
    if not apart(best) < _SAME or not model.body(best).name:
        raise HandModelError(
            f"no body of that model matches the palm of {hand.name!r}: its fingers begin at other "
            "positions or angles"
        )
    return str(model.body(best).name)


def _relative(model: mujoco.MjModel, base: int, body: int) -> _Frame:
    """Pose of a body in the frame of another body, in the model's reference pose."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    rotation = data.xmat.reshape(-1, 3, 3)
    return (
        rotation[base].T @ rotation[body],
        rotation[base].T @ (data.xpos[body] - data.xpos[base]),
    )


def _name(model: mujoco.MjModel, body: int, path: Path) -> str:
    if not (name := model.body(body).name):
        raise HandModelError(
            f"{path}: body {body} has a joint of the hand but no name; give it a name"
        )
    return str(name)


def _difference(hand: Hand, other: Hand) -> float:
    """Largest distance between landmarks of two models, over poses in the joints' ranges [m]."""
    low, high = np.clip(hand.joint_limits.T, -np.pi, np.pi)
    poses = np.random.default_rng(0).uniform(low, high, (_POSES, len(low)))
    theirs = np.zeros((_POSES, len(other.joint_names)))
    theirs[:, [other.joint_names.index(name) for name in hand.joint_names]] = poses
    apart = np.asarray(hand.tree.positions(poses)) - np.asarray(other.tree.positions(theirs))
    return float(np.linalg.norm(apart, axis=-1).max())


MENAGERIE: Final = "menagerie"
"""Word that selects the model of Menagerie's package instead of a model file."""

_ENTRIES: Final[dict[tuple[str, Side], tuple[str, str]]] = {
    ("allegro_hand", "right"): ("wonik_allegro", "right_hand"),
    ("allegro_hand", "left"): ("wonik_allegro", "left_hand"),
    ("leap_hand", "right"): ("leap_hand", "right_hand"),
    ("leap_hand", "left"): ("leap_hand", "left_hand"),
    ("shadow_dexee", "right"): ("shadow_dexee", "shadow_dexee"),
    ("shadow_hand", "right"): ("shadow_hand", "right_hand"),
    ("shadow_hand", "left"): ("shadow_hand", "left_hand"),
    ("sharpa_wave", "right"): ("sharpa_wave", "right_hand"),
    ("sharpa_wave", "left"): ("sharpa_wave", "left_hand"),
}
"""Hand and side in the catalogue -> robot and entry point in the package."""


def hand_with_meshes(hand: Hand, model: str | Path | None = None) -> Hand | None:
    """Loads a hand with its real meshes; without ``model``, nothing is downloaded.

    Args:
        model: MJCF or URDF file of that hand, or ``MENAGERIE``, which may be downloaded; by
            default the hand's own model if it has meshes, else the package's local copy.

    Returns:
        the hand; None without a local model with meshes.

    Raises:
        HandModelError: there is no such model, it can't be read, or it is of another hand.
        MissingExtraError: the package is requested and not installed.
    """
    if model is not None:
        return on_model(hand, menagerie_file(hand) if str(model) == MENAGERIE else model)
    if has_meshes(hand):
        return hand
    path = None if hand.spec.mirror else menagerie_copy(hand)
    if path is None:
        return None
    there = on_model(hand, path)
    if lost := stand_in_links(there):
        raise HandModelError(f"{path}: the meshes of {', '.join(lost)} can't be read")
    return there


def has_meshes(hand: Hand) -> bool:
    """True if the hand's own model has meshes."""
    own = hand.bodies[hand.model.geom_bodyid]
    return bool((hand.model.geom_type[own] == mujoco.mjtGeom.mjGEOM_MESH).any())


def menagerie_copy(hand: Hand) -> Path | None:
    """Local copy of MuJoCo Menagerie's model of a hand; None if there is no copy."""
    entry = _ENTRIES.get((hand.name, hand.spec.side))
    if entry is None or find_spec("mujoco_menagerie") is None:
        return None
    package = _package()
    try:
        robot, cache = package.get(entry[0]), package.Cache()
        here = (cache.root / robot.name).is_dir() if cache.root else cache.is_cached(robot)
        return Path(robot.xml(entry[1])) if here else None
    except (package.MenagerieError, OSError):
        return None


def menagerie_file(hand: Hand) -> Path:
    """MuJoCo Menagerie's model of a hand, downloaded if necessary.

    Raises:
        HandModelError: the package has no model of this hand and side, or can't download it.
        MissingExtraError: the package is not installed.
    """
    entry = _ENTRIES.get((hand.name, hand.spec.side))
    if entry is None:
        names = ", ".join(f"{name} ({side})" for name, side in _ENTRIES)
        raise HandModelError(
            f"Menagerie has no model of the {hand.spec.side} hand {hand.name!r}, only of "
            f"{names}; name a model file instead of the word menagerie"
        )
    package = _package()
    robot, xml = entry
    try:
        return Path(package.get(robot).xml(xml))
    except (package.MenagerieError, OSError) as error:
        raise HandModelError(
            f"the model {robot!r} of Menagerie can't be downloaded: {error}. Try again with a "
            "network connection, or set MENAGERIE_ROOT to a checkout of "
            "github.com/google-deepmind/mujoco_menagerie"
        ) from error


def _package() -> Any:
    try:
        import mujoco_menagerie
    except ImportError as error:
        raise MissingExtraError("a model of Menagerie", "menagerie") from error
    return mujoco_menagerie
