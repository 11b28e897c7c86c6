"""Reads a model file into a ``Skeleton`` and reports faults of the file."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from collections import defaultdict
from pathlib import Path
from typing import Final

import mujoco
import numpy as np

from smooth_operator.errors import HandModelError
from smooth_operator.hands.loading import load_model
from smooth_operator.hands.model_assets import read_model_files, read_model_xml
from smooth_operator.lab.discovery.shapes import geom_points, urdf_mesh_points
from smooth_operator.lab.discovery.skeleton import Skeleton

_UNIQUE: Final = {"robot": ("link", "joint"), "mujoco": ("body", "joint", "site")}


def read_skeleton(path: Path) -> tuple[Skeleton, tuple[str, ...]]:
    """Reads a model.

    Args:
        path: URDF or MJCF file.

    Returns:
        the skeleton, and what a person should know about the file, such as meshes that are missing.

    Raises:
        HandModelError: no such file, broken XML, names given twice, limits reversed, no joints, or
            what MuJoCo can't compile; each says what to do.
    """
    root = _parse(path)
    _check_names(root, path)
    pinned = _check_limits(root, path)
    loaded = load_model(path)
    model = loaded.model
    if not model.njnt:
        raise HandModelError(
            f"{path} has no joints, so no fingers; give the model of a hand whose joints can move "
            "(a file of meshes or a scene is not enough)"
        )
    clouds = {b: list(shapes) for b, shapes in geom_points(model).items()}
    notes = []
    meshes = [m for m in root.iter("mesh") if m.get("filename") or m.get("file")]
    if loaded.oversize:
        notes.append(
            f"{loaded.why}. They are left out; fingertips and wrist are surer with them, or with "
            "--tip and --wrist"
        )
    elif meshes and not model.nmesh:
        points: dict[str, list[np.ndarray]] = {}
        missing = len(meshes)
        if root.tag == "robot":
            points, missing = urdf_mesh_points(root, read_model_files(path).assets)
        for name, shapes in points.items():
            clouds.setdefault(_body(model, name), []).extend(shapes)
        if missing:
            notes.append(
                f"{missing} of {len(meshes)} meshes could not be read; joints need none, but "
                "fingertips and wrist are surer with them: put them where the file says, or set "
                "what is wrong with --tip and --wrist"
            )
    bodies, joints = (
        sum(not e.get("name") for world in root.iter("worldbody") for e in world.iter(tag))
        for tag in ("body", "joint")
    )
    if bodies or joints:
        notes.append(
            f"{bodies} bodies and {joints} joints have no name in the file, and are called body_1, "
            "joint_1 and so on, in its order; name the joints there, or no driver knows what a "
            "command is for"
        )
    loops = sum(
        int(kind) in (int(mujoco.mjtEq.mjEQ_CONNECT), int(mujoco.mjtEq.mjEQ_WELD))
        for kind in model.eq_type
    )
    if loops:
        notes.append(
            f"{loops} closed loops (equality connect or weld) are left out: fingers driven by bars "
            "will not move as the real ones do; describe them with joint couplings instead"
        )
    shapes_of = {b: tuple(shapes) for b, shapes in clouds.items()}
    return Skeleton(model, loaded.couplings, shapes_of, pinned), tuple(notes)


def _parse(path: Path) -> ElementTree.Element:
    if path.is_dir():
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
        # of a URDF only the direct children: transmissions name joints again
        elements = root.findall(tag) if root.tag == "robot" else root.iter(tag)
        count: dict[str, int] = defaultdict(int)
        for element in elements:
            count[element.get("name", "")] += 1
        twice = sorted(name for name, n in count.items() if name and n > 1)
        if twice:
            raise HandModelError(
                f"{path} names the {tag} {', '.join(map(repr, twice))} twice; give each its own "
                "name, so that fingertips and joints can be distinguished"
            )


def _check_limits(root: ElementTree.Element, path: Path) -> dict[str, float]:
    """The joints that can't move, as their limits are equal, and where they are."""
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


def _body(model: mujoco.MjModel, name: str) -> int:
    """Body of a URDF link; MuJoCo makes a root link called world the world itself."""
    body = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, name)
    return max(int(body), 0)
