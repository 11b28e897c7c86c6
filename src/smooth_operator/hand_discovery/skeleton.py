"""A model as a skeleton that can be posed: joints, limits, couplings, shape points and names.

Words in names are weak evidence. Only generic words count, not those of a product."""

from __future__ import annotations

import os
import re
import xml.etree.ElementTree as ElementTree
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, Final

import mujoco
import numpy as np
from jaxtyping import Float
from numpy.polynomial import Polynomial

from smooth_operator.errors import HandModelError, UnknownNameError, require
from smooth_operator.hand_discovery.model_limits import check_model_limits
from smooth_operator.hands.loading import load_model, merged_couplings
from smooth_operator.hands.model_assets import read_model_files, read_model_xml
from smooth_operator.hands.spec import Coupling, Point
from smooth_operator.types import Side

_FINGER_WORDS: Final[dict[str, tuple[str, ...]]] = {
    "thumb": ("thumb", "th", "thb", "pollex"),
    "index": ("index", "ff", "fore", "forefinger", "pointer", "if"),
    "middle": ("middle", "mf", "mid"),
    "ring": ("ring", "rf"),
    "pinky": ("pinky", "little", "lf", "pinkie", "small", "pf"),
}
_FULL_TURN: Final = 2 * np.pi - 0.01  # least range of a joint that nothing drives [rad]
_PARTS: Final = "(j|a|tip|base|hub|knuckle|proximal|middle|medial|distal|metacarpal)"
_SIDE_WORDS: Final[dict[Side, tuple[str, ...]]] = {"right": ("right", "rh"), "left": ("left", "lh")}


def words(name: str) -> tuple[str, ...]:
    """Splits an identifier into lower-case words: ``rightIndexTip_2`` gives right, index, tip."""
    spaced = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", " ", name)
    return tuple(re.findall(r"[a-z]+", spaced.lower()))


def says_tip(name: str) -> bool:
    """True if a name denotes a fingertip."""
    return any(word.endswith("tip") for word in words(name))


def says_wrist(name: str) -> bool:
    """True if a name denotes the wrist."""
    return "wrist" in words(name)


def fingers_said(chains: Sequence[Iterable[str]]) -> list[str | None]:
    """Human finger that the names in each chain mention most.

    Args:
        chains: names of bodies and joints of each chain. A word that all chains contain does not
            count: a middle link is not a middle finger.

    Returns:
        A human finger for each chain; None if its names mention none, or two equally often.
    """
    spoken = [{word for name in names for word in words(name)} for names in chains]
    common = set.intersection(*spoken) if len(spoken) > 1 else set()
    out: list[str | None] = []
    for own in spoken:
        votes = {
            finger: sum(_means(word, finger, len(chains) > 3) for word in own - common)
            for finger in _FINGER_WORDS
        }
        ranked = sorted(votes, key=lambda finger: votes[finger], reverse=True)
        out.append(ranked[0] if votes[ranked[0]] > votes[ranked[1]] else None)
    return out


def _means(word: str, finger: str, initials: bool) -> bool:
    """True if a word denotes a finger; initials may be a gripper's left and right finger."""
    return any(
        word == synonym
        or (len(synonym) > 3 and word.startswith(synonym))
        or (len(synonym) == 2 and re.fullmatch(synonym + _PARTS, word) is not None)
        for synonym in _FINGER_WORDS[finger]
        if initials or len(synonym) > 2
    )


def side_said(names: Iterable[str]) -> Side | None:
    """Side that the names indicate; None if they indicate no side, or both equally often."""
    votes: dict[Side, int] = {"right": 0, "left": 0}
    for name in names:
        parts = words(name)
        for side, synonyms in _SIDE_WORDS.items():
            # A letter counts only between underscores: r_thumb, but not the L of thumb_L1.
            letter = re.search(rf"(^|_){side[0]}(_|$)", name.lower())
            votes[side] += bool(letter) or any(word in synonyms for word in parts)
    if votes["right"] == votes["left"]:
        return None
    return "right" if votes["right"] > votes["left"] else "left"


@dataclass(frozen=True, eq=False)
class Placement:
    """Positions and frames of all parts in one pose, in the world frame [m].

    Attributes:
        bodies: (nbody, 3) origins.
        frames: (nbody, 3, 3) rotations, body to world.
        anchors: (njnt, 3) a point on each joint's axis.
        axes: (njnt, 3) unit axes.
        sites: (nsite, 3) positions.
    """

    bodies: Float[np.ndarray, "b 3"]
    frames: Float[np.ndarray, "b 3 3"]
    anchors: Float[np.ndarray, "j 3"]
    axes: Float[np.ndarray, "j 3"]
    sites: Float[np.ndarray, "s 3"]

    def world(self, body: int, points: np.ndarray) -> np.ndarray:
        """Transforms (..., 3) points from a body's frame to the world frame."""
        moved: np.ndarray = points @ self.frames[body].T + self.bodies[body]
        return moved

    def local(self, body: int, points: np.ndarray) -> np.ndarray:
        """Transforms (..., 3) points from the world frame to a body's frame."""
        moved: np.ndarray = (points - self.bodies[body]) @ self.frames[body]
        return moved


@dataclass(frozen=True, eq=False)
class Skeleton:
    """A compiled model with its couplings and the points of its shapes.

    Attributes:
        model: the compiled model.
        couplings: joints that follow another.
        clouds: body -> (p, 3) points on each of its shapes, in the body's frame [m].
        pinned: joint -> position, for joints whose upper and lower limit are equal in the file;
            MuJoCo treats them as joints without limits.
    """

    model: mujoco.MjModel
    couplings: tuple[Coupling, ...]
    clouds: Mapping[int, tuple[np.ndarray, ...]]
    pinned: Mapping[str, float] = field(default_factory=dict)

    @cached_property
    def joint_names(self) -> tuple[str, ...]:
        """Names of all joints, in the model's order."""
        return tuple(self.model.joint(j).name for j in range(self.model.njnt))

    @cached_property
    def limits(self) -> Float[np.ndarray, "n 2"]:
        """Joint limits [rad or m]; infinite for a joint without limits."""
        limited = self.model.jnt_limited.astype(bool)[:, None]
        ranges = np.asarray(self.model.jnt_range, np.float64)
        return np.where(limited, ranges, np.array([-np.inf, np.inf]))

    @cached_property
    def turns(self) -> np.ndarray:
        """(n,) mask of the hinges."""
        return np.asarray(self.model.jnt_type == int(mujoco.mjtJoint.mjJNT_HINGE))

    @cached_property
    def moves(self) -> np.ndarray:
        """(n,) mask of the hinges and slides."""
        slides = np.asarray(self.model.jnt_type == int(mujoco.mjtJoint.mjJNT_SLIDE))
        moves: np.ndarray = self.turns | slides
        return moves

    @cached_property
    def bounded(self) -> np.ndarray:
        """(n,) mask of the hinges and slides with finite limits."""
        bounded: np.ndarray = self.moves & np.isfinite(self.limits).all(axis=1)
        return bounded

    def turns_freely(self, joint: int) -> bool:
        """True if a joint follows no other joint and can make a full turn, like the pin of a
        linkage."""
        span = float(np.ptp(self.limits[joint]))
        return span >= _FULL_TURN and joint not in self.leaders

    @cached_property
    def leaders(self) -> Mapping[int, tuple[int, Polynomial]]:
        """Maps each follower to its leader, which follows no other joint, and to the polynomial
        that gives the follower's position."""
        index = {name: j for j, name in enumerate(self.joint_names)}
        direct: dict[int, tuple[int, Polynomial]] = {}
        for c in self.couplings:
            if c.joint not in index or c.follows not in index:
                absent = c.joint if c.joint not in index else c.follows
                raise HandModelError(
                    f"joint {c.joint!r} should follow {c.follows!r}, but the model has no "
                    f"joint {absent!r}; correct the name in the file's mimic or equality "
                    "element, or in --couple"
                )
            direct[index[c.joint]] = (index[c.follows], Polynomial(c.coefficients))
        resolved = {}
        for joint in direct:
            leader, curve = direct[joint]
            visited = {joint}
            while leader in direct:
                if leader in visited:
                    raise HandModelError(
                        f"joint {self.joint_names[joint]!r} follows itself through other "
                        "joints; remove one of the couplings"
                    )
                visited.add(leader)
                leader, inner = direct[leader]
                curve = curve(inner)
            resolved[joint] = (leader, curve)
        return resolved

    @cached_property
    def reference(self) -> Float[np.ndarray, " n"]:
        """Pose with all joints at zero, or at the nearest limit."""
        low, high = self.limits.T
        return self.coupled(np.clip(np.zeros(len(low)), low, high))

    def coupled(self, q: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Returns the pose with each follower at the position that its leader determines, within
        its limits."""
        out = np.array(q, float)
        for joint, (leader, curve) in self.leaders.items():
            out[joint] = np.clip(curve(q[leader]), *self.limits[joint])
        return out

    def posed(self, named: Mapping[str, float]) -> Float[np.ndarray, " n"]:
        """Returns the reference pose with some joints, and the joints that follow them, at other
        positions."""
        q = self.reference.copy()
        q[[self.joint_names.index(name) for name in named]] = list(named.values())
        return self.coupled(q)

    def free(self, joints: tuple[int, ...]) -> tuple[int, ...]:
        """Returns the joints that determine the given ones: each follower is replaced by its
        leader."""
        leaders = [self.leaders[j][0] if j in self.leaders else j for j in joints]
        return tuple(dict.fromkeys(leaders))

    def place(self, q: Float[np.ndarray, " n"]) -> Placement:
        """Computes the positions of all parts in a pose."""
        data = self.posed_data(q)
        return Placement(
            data.xpos.copy(),
            data.xmat.reshape(-1, 3, 3).copy(),
            data.xanchor.copy(),
            data.xaxis.copy(),
            data.site_xpos.copy(),
        )

    def posed_data(self, q: Float[np.ndarray, " n"]) -> mujoco.MjData:
        """MuJoCo's kinematics of a pose, valid until the next call. Free and ball joints stay at
        their initial positions."""
        data = self._data
        data.qpos[:] = self.model.qpos0
        single = np.flatnonzero(self.moves)
        data.qpos[self.model.jnt_qposadr[single]] = q[single]
        mujoco.mj_kinematics(self.model, data)
        return data

    @cached_property
    def _data(self) -> mujoco.MjData:
        return mujoco.MjData(self.model)

    def body(self, name: str) -> int:
        """Index of a body; UnknownNameError if there is no such body."""
        names = [self.body_name(b) for b in range(self.model.nbody)]
        if name not in names:
            raise UnknownNameError("body", name, names)
        return names.index(name)

    def body_name(self, body: int) -> str:
        """Name of a body."""
        return str(self.model.body(body).name)

    def point(self, body: int, place: np.ndarray) -> Point:
        """A point in a body's frame [m] for the hand's description, rounded to a micrometre."""
        x, y, z = (round(float(c), 6) + 0.0 for c in place)
        return Point(self.body_name(body), (x, y, z))

    def path(self, body: int) -> tuple[int, ...]:
        """Bodies on the path from the world, which is left out, down to this body."""
        out = []
        while body > 0:
            out.append(body)
            body = int(self.model.body_parentid[body])
        return tuple(reversed(out))

    def joints_of(self, body: int) -> tuple[int, ...]:
        """Joints between a body and its parent."""
        first = int(self.model.body_jntadr[body])
        return tuple(range(first, first + int(self.model.body_jntnum[body])))

    def rigid(self, body: int) -> tuple[int, ...]:
        """Bodies that are fixed to this one, including itself."""
        weld = self.model.body_weldid
        return tuple(int(b) for b in np.flatnonzero(weld == weld[body]))


_UNIQUE: Final = {"robot": ("link", "joint"), "mujoco": ("body", "joint", "site")}


def read_skeleton(
    path: Path, couplings: tuple[Coupling, ...] = ()
) -> tuple[Skeleton, tuple[str, ...]]:
    """Reads a model.

    Args:
        path: URDF or MJCF file.
        couplings: joints that follow another one; they replace the file's couplings.

    Returns:
        The skeleton, and notes for the user, such as on missing meshes.

    Raises:
        HandModelError: there is no such file, it is not well-formed XML, names occur twice, limits
            are reversed, it has no joints, or MuJoCo can't compile it.
    """
    root = _parse(path)
    check_model_limits(path)
    _check_names(root, path)
    pinned = _check_limits(root, path)
    loaded = load_model(path)
    model = loaded.model
    if not model.njnt:
        raise HandModelError(
            f"{path} has no joints, so it has no fingers; use the model of a hand with "
            "movable joints (a mesh file or a scene is not enough)"
        )
    clouds = {b: list(shapes) for b, shapes in geom_points(model).items()}
    notes = []
    meshes = [m for m in root.iter("mesh") if m.get("filename") or m.get("file")]
    if loaded.oversize:
        notes.append(
            f"{loaded.why}. These meshes are not used, so the fingertips and the wrist are "
            "estimated less reliably. Use smaller meshes, or correct the points with --tip and "
            "--wrist"
        )
    elif meshes and not model.nmesh:
        points: dict[str, list[np.ndarray]] = {}
        missing = len(meshes)
        if root.tag == "robot":
            points, missing = urdf_mesh_points(root, read_model_files(path).assets)
        for name, shapes in points.items():
            body = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, name)
            # MuJoCo makes a root link that is called world the world itself
            clouds.setdefault(max(int(body), 0), []).extend(shapes)
        if missing:
            remedy = (
                "run 'git lfs pull' in the clone of the model"
                if loaded.pointers
                else "put them at the paths in the file"
            )
            notes.append(
                f"{missing} of {len(meshes)} meshes could not be read. Joints are unaffected, but "
                f"fingertips and wrist are estimated less reliably without meshes: {remedy}, or "
                "correct the points with --tip and --wrist"
            )
    if loaded.inertias:
        notes.append(
            f"the inertia of {len(loaded.inertias)} links (such as {loaded.inertias[0]!r}) is "
            "incomplete or not positive, and is not used; a simulation estimates it from the "
            "shapes. Correct it in the file"
        )
    bodies, joints = (
        sum(not e.get("name") for world in root.iter("worldbody") for e in world.iter(tag))
        for tag in ("body", "joint")
    )
    if bodies or joints:
        notes.append(
            f"{bodies} bodies and {joints} joints have no name in the file; they are numbered in "
            "the order of the file (body_1, joint_1, ...). Name the joints in the file, so that "
            "drivers can match commands and motors"
        )
    bars = [int(mujoco.mjtEq.mjEQ_CONNECT), int(mujoco.mjtEq.mjEQ_WELD)]
    loops = int(np.isin(model.eq_type, bars).sum())
    if loops:
        notes.append(
            f"{loops} closed loops (equality connect or weld) are ignored: fingers driven by "
            "bars will not move like the real ones; describe them with joint couplings "
            "instead"
        )
    shapes_of = {b: tuple(shapes) for b, shapes in clouds.items()}
    merged = merged_couplings(loaded.couplings, couplings)
    return Skeleton(model, merged, shapes_of, pinned), tuple(notes)


def _parse(path: Path) -> ElementTree.Element:
    if os.path.isdir(path):  # unlike Path.is_dir, False for a name that is too long
        inside = sorted(p.name for p in path.iterdir() if p.suffix in (".urdf", ".xml"))
        raise HandModelError(
            f"{path} is a folder; name the model file in it"
            + (f": {', '.join(inside[:5])}" + (", …" if len(inside) > 5 else "") if inside else "")
        )
    root = read_model_xml(path)
    if any("xacro" in element.tag for element in root.iter()):
        raise HandModelError(
            f"{path} is a xacro template; expand it first: xacro {path.name} > hand.urdf"
        )
    return root


def _check_names(root: ElementTree.Element, path: Path) -> None:
    for tag in _UNIQUE.get(root.tag, ()):
        # In a URDF only the direct children count, since transmissions name joints again.
        elements = root.findall(tag) if root.tag == "robot" else root.iter(tag)
        count: dict[str, int] = defaultdict(int)
        for element in elements:
            count[element.get("name", "")] += 1
        twice = sorted(name for name, n in count.items() if name and n > 1)
        if twice:
            raise HandModelError(
                f"{path} names the {tag} {', '.join(map(repr, twice))} twice; use a "
                "different name for each, so that fingertips and joints can be distinguished"
            )


def _check_limits(root: ElementTree.Element, path: Path) -> dict[str, float]:
    """Joints with equal limits, which can't move, and their positions."""
    pinned = {}
    for joint in root.iter("joint"):
        limit = joint.find("limit")
        text = joint.get("range")
        try:
            if limit is not None and (limit.get("lower") or limit.get("upper")):
                low, high = float(limit.get("lower", 0)), float(limit.get("upper", 0))
            elif text:
                low, high = (float(word) for word in text.split())
            else:
                continue
        except ValueError as error:
            raise HandModelError(
                f"{path}: the limits of joint {joint.get('name')!r} are not two numbers ({error})"
            ) from error
        if low > high:
            raise HandModelError(
                f"{path}: the limits of joint {joint.get('name')!r} are reversed, {low:g} to "
                f"{high:g}; expected the lower one first: swap them in the file"
            )
        if low == high and joint.get("type") not in ("continuous", "fixed"):
            pinned[joint.get("name", "")] = low
    return pinned


_RINGS: Final = 13  # number of points along a cylinder or the edge of a box
_COARSE: Final = 300  # number of vertices below which a mesh gets points on its edges
_ROUND: Final = 400  # number of points on a sphere; its extent is then right to half a per cent


def geom_points(model: mujoco.MjModel) -> dict[int, list[Float[np.ndarray, "p 3"]]]:
    """Points on each shape of a compiled model.

    Returns:
        Body -> a (p, 3) array for each shape, in the body's frame [m], without planes and terrain.
    """
    out: dict[int, list[np.ndarray]] = defaultdict(list)
    rotation = np.empty(9)
    for g in range(model.ngeom):
        kind = mujoco.mjtGeom(int(model.geom_type[g]))
        if kind == mujoco.mjtGeom.mjGEOM_MESH:
            mesh = int(model.geom_dataid[g])
            first = int(model.mesh_vertadr[mesh])
            points = np.asarray(model.mesh_vert[first : first + int(model.mesh_vertnum[mesh])])
            face = int(model.mesh_faceadr[mesh])
            faces = model.mesh_face[face : face + int(model.mesh_facenum[mesh])]
            points = _denser(points.astype(np.float64), np.asarray(faces))
        else:
            points = shape_points(kind, model.geom_size[g])
        if len(points):
            mujoco.mju_quat2Mat(rotation, model.geom_quat[g])
            placed = points.astype(float) @ rotation.reshape(3, 3).T + model.geom_pos[g]
            out[int(model.geom_bodyid[g])].append(placed)
    return dict(out)


def urdf_mesh_points(
    root: ElementTree.Element, files: Mapping[str, Path]
) -> tuple[dict[str, list[Float[np.ndarray, "p 3"]]], int]:
    """Points of the meshes of a URDF that MuJoCo could not load.

    Args:
        files: mesh files by the names in the URDF.

    Returns:
        Link -> a (p, 3) array for each mesh, in the link's frame [m]; and the number of meshes that
        could not be read.
    """
    out: dict[str, list[np.ndarray]] = defaultdict(list)
    missing = 0
    for link in root.findall("link"):
        for part in [*link.findall("visual"), *link.findall("collision")]:
            mesh = part.find("geometry/mesh")
            if mesh is None:
                continue
            file = files.get(mesh.get("filename", ""))
            vertices = _vertices(file) if file else None
            if vertices is None:
                missing += 1
                continue
            try:
                scale = np.array([float(s) for s in mesh.get("scale", "1 1 1").split()])
                rotation, position = _origin(part.find("origin"))
            except ValueError:
                missing += 1
                continue
            out[link.get("name", "")].append(vertices * scale @ rotation.T + position)
    return dict(out), missing


def _vertices(path: Path) -> np.ndarray | None:
    require("the shape of a mesh", "teleop", "trimesh")
    import trimesh

    try:
        mesh: Any = trimesh.load(path, force="mesh", process=False)
        vertices = _denser(np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces))
    except Exception:  # its readers raise all kinds of errors; an unreadable mesh counts as missing
        return None
    return vertices if len(vertices) and np.isfinite(vertices).all() else None


def _denser(vertices: np.ndarray, faces: np.ndarray) -> Float[np.ndarray, "p 3"]:
    """Vertices of a mesh, with points along the edges of a coarse one."""
    if len(vertices) >= _COARSE or not len(faces):
        return vertices
    corners = vertices[faces]  # (f, 3, 3)
    share = np.linspace(0, 1, _RINGS)[1:-1, None, None, None]
    edges = corners + share * (np.roll(corners, 1, axis=1) - corners)
    return np.concatenate([vertices, edges.reshape(-1, 3)])


def _origin(element: ElementTree.Element | None) -> tuple[np.ndarray, np.ndarray]:
    if element is None:
        return np.eye(3), np.zeros(3)
    roll, pitch, yaw = (float(a) for a in element.get("rpy", "0 0 0").split())
    quat, out = np.empty(4), np.empty(9)
    mujoco.mju_euler2Quat(quat, [roll, pitch, yaw], "XYZ")  # fixed axes, as URDF has them
    mujoco.mju_quat2Mat(out, quat)
    position = np.array([float(c) for c in element.get("xyz", "0 0 0").split()])
    return out.reshape(3, 3), position


def shape_points(kind: mujoco.mjtGeom, sizes: np.ndarray) -> Float[np.ndarray, "p 3"]:
    """Points all over the surface of a shape that is not a mesh, in the shape's own frame [m]."""
    size = np.asarray(sizes, np.float64)
    points: np.ndarray
    ball = _sphere()
    steps = np.linspace(-1, 1, _RINGS)
    if kind == mujoco.mjtGeom.mjGEOM_BOX:
        grid = np.stack(np.meshgrid(steps, steps, steps), axis=-1).reshape(-1, 3)
        points = grid[abs(grid).max(axis=1) == 1] * size
    elif kind == mujoco.mjtGeom.mjGEOM_SPHERE:
        points = ball * size[0]
    elif kind == mujoco.mjtGeom.mjGEOM_ELLIPSOID:
        points = ball * size
    elif kind in (mujoco.mjtGeom.mjGEOM_CYLINDER, mujoco.mjtGeom.mjGEOM_CAPSULE):
        angle = np.linspace(0, 2 * np.pi, 48, endpoint=False)
        ring = np.stack([np.cos(angle), np.sin(angle), np.zeros(48)], axis=1) * size[0]
        up = np.array([0.0, 0.0, size[1]])
        parts = [ring + step * up for step in steps]
        if kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
            parts += [ball * size[0] + up, ball * size[0] - up]
        points = np.concatenate(parts)
    else:
        points = np.empty((0, 3))
    return points


def _sphere() -> np.ndarray:
    """Fibonacci lattice on the unit sphere, with both poles."""
    i = np.arange(_ROUND)
    z = np.linspace(-1, 1, _ROUND)
    angle = i * np.pi * (3 - np.sqrt(5))
    radius = np.sqrt(1 - z**2)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), z], axis=1)
