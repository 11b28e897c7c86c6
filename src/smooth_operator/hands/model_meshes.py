"""Compiles a model with as many of its meshes as possible, and names links without shapes."""

from __future__ import annotations

from collections.abc import Callable, Container
from pathlib import Path
from typing import Final, NamedTuple

import mujoco
import numpy as np

from smooth_operator.errors import brief
from smooth_operator.hands.model_assets import MOST_MESH_BYTES, ModelFiles
from smooth_operator.hands.mujoco_messages import MUJOCO_ERRORS, refused

_TIMES: Final = 5.0  # length of a mesh over its chain above which it has another unit
_LONGEST: Final = 0.5  # length up to which a mesh has the right unit [m]
_TINY: Final = 1e-9


class CompiledModel(NamedTuple):
    """A compiled model, and the parts of it that had to be left out.

    Attributes:
        model: the model.
        dropped: names of the meshes that it lacks; None if it is complete.
        lost: names of the bodies that lost a colliding shape.
        why: reasons for the losses.
        oversize: True if meshes of another unit are among them.
    """

    model: mujoco.MjModel
    dropped: frozenset[str] | None
    lost: tuple[str, ...]
    why: tuple[str, ...]
    oversize: bool


def compile_with_meshes(
    path: Path, files: ModelFiles, read: Callable[[], mujoco.MjSpec]
) -> CompiledModel:
    """Compiles a model with as many of its meshes as possible, since kinematics needs none.

    Args:
        path: the model file, for messages.
        files: the files that it names.
        read: reads the model; a model that failed to compile is read again.

    Raises:
        HandModelError: MuJoCo can't compile it without its meshes, either.
    """
    spec = read()
    names = {mesh.name: mesh.file for mesh in spec.meshes}
    present = {"", *map(str, files.assets.values())}
    absent = {} if files.attaches else {k: v for k, v in names.items() if v not in present}
    why, dropped = [], frozenset(absent) or None
    pointers = [file for file in absent.values() if file in files.pointers]
    missing = [file for file in absent.values() if file not in files.pointers]
    if pointers:
        why.append(
            f"{len(pointers)} mesh files are Git LFS pointers (such as {brief(pointers[0])}): run "
            "'git lfs pull' in the clone of the model"
        )
    if missing:
        why.append(
            f"{len(missing)} mesh files are not at the paths in the model, or are larger than "
            f"{MOST_MESH_BYTES / 1e6:.0f} MB ({brief(missing[0])} first): "
            "put them there, or correct the paths"
        )
    try:
        model, lost = _without(spec, dropped)
    except MUJOCO_ERRORS as error:  # a spec that failed to compile can't be edited: read again
        unreadable = _unreadable_meshes(read(), absent)
        if not unreadable and not _is_missing_asset(error):
            raise refused("compile", path, error) from error
        try:
            dropped = frozenset(absent) | unreadable
            model, lost = _without(read(), dropped)
        except MUJOCO_ERRORS:
            try:
                dropped = unreadable = frozenset(names)
                model, lost = _without(read(), dropped)
            except MUJOCO_ERRORS as last:
                raise refused("compile without its meshes", path, last) from last
        if unreadable:
            why.append(
                f"MuJoCo can't read {len(unreadable)} meshes ({brief(min(unreadable))} "
                "first): export them as OBJ, or as binary STL of at most 200,000 triangles"
            )
    large, text = _oversize(model)
    if large:
        dropped = (dropped or frozenset()) | large
        why.append(text)
        model, lost = _without(read(), dropped)
    return CompiledModel(model, dropped, lost, tuple(why), bool(large))


def _without(
    spec: mujoco.MjSpec, meshes: frozenset[str] | None
) -> tuple[mujoco.MjModel, tuple[str, ...]]:
    """The model without these meshes, and the bodies that lost a colliding shape."""
    lost = () if meshes is None else drop_meshes(spec, meshes)
    return spec.compile(), lost


def _unreadable_meshes(spec: mujoco.MjSpec, absent: Container[str]) -> frozenset[str]:
    """Names of the meshes that MuJoCo can't read, each tried in its own model."""
    out = set()
    for mesh in spec.meshes:
        if not mesh.file or mesh.name in absent:
            continue  # its points are in the model file, or nowhere
        trial = mujoco.MjSpec()
        trial.modelfiledir, trial.meshdir = spec.modelfiledir, spec.meshdir
        trial.strippath = spec.strippath
        trial.add_mesh(name="trial", file=mesh.file, inertia=mesh.inertia)
        trial.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname="trial")
        try:
            trial.compile()
        except MUJOCO_ERRORS:
            out.add(mesh.name)
    return frozenset(out)


def drop_meshes(spec: mujoco.MjSpec, meshes: frozenset[str]) -> tuple[str, ...]:
    """Removes some meshes, and every terrain, skin and texture, from a model. Returns the names of
    the bodies that lost a colliding shape."""
    lost = []
    paired = {name for pair in spec.pairs for name in (pair.geomname1, pair.geomname2)}
    gone_geoms = set()
    for geom in list(spec.geoms):
        terrain = geom.type == mujoco.mjtGeom.mjGEOM_HFIELD
        if terrain or geom.meshname in meshes:
            if geom.contype or geom.conaffinity or geom.name in paired - {""}:
                lost.append(geom.parent.name)
            gone_geoms.add(geom.name)
            spec.delete(geom)
    for pair in list(spec.pairs):
        if {pair.geomname1, pair.geomname2} & gone_geoms:
            spec.delete(pair)
    for material in spec.materials:
        material.textures = [""] * len(material.textures)
    gone = [mesh for mesh in spec.meshes if mesh.name in meshes]
    for asset in (*gone, *spec.skins, *spec.hfields, *spec.textures):
        spec.delete(asset)
    return tuple(dict.fromkeys(lost))


def _oversize(model: mujoco.MjModel) -> tuple[frozenset[str], str]:
    """Names of the meshes of another unit than the links, over ``_TIMES`` as long as their whole
    chain, if one is on a moving body; and the problem as a text."""
    parents = model.body_parentid
    step = np.linalg.norm(model.body_pos, axis=1)
    step[parents == 0] = 0.0  # the place of the model in the world is no length of the model
    up, down = np.zeros(model.nbody), np.zeros(model.nbody)
    for body in range(1, model.nbody):
        up[body] = up[parents[body]] + step[body]
    for body in range(model.nbody - 1, 0, -1):
        down[parents[body]] = max(down[parents[body]], down[body] + step[body])
    bodies = model.geom_bodyid
    length = 2 * model.geom_aabb[:, 3:].max(axis=1, initial=0.0)
    large = model.geom_type == mujoco.mjtGeom.mjGEOM_MESH
    large &= length > np.maximum(_TIMES * (up + down)[bodies], _LONGEST)
    moving = np.flatnonzero(large & (model.body_weldid[bodies] > 0))
    if not len(moving):
        return frozenset(), ""
    links = np.array([max([step[b], *step[parents == b]]) for b in bodies[moving]])
    factor = 10 ** round(np.log10(np.median(length[moving] / np.maximum(links, _TINY))))
    first = moving[0]
    scale = float(model.mesh_scale[model.geom_dataid[first], 0])
    return frozenset(model.mesh(int(m)).name for m in model.geom_dataid[large]), (
        f"meshes are about {factor:,.0f} times as large as the links (that of "
        f"{model.body(int(bodies[first])).name!r} is {length[first]:.3g} m long, its whole "
        f"chain {(up + down)[bodies[first]]:.2g} m): in the model, set scale "
        f"{scale / factor:g} where it has {scale:g}"
    )


def _is_missing_asset(error: Exception) -> bool:
    text = str(error).lower()
    return any(word in text for word in ("opening file", "mesh", "resource", "decoder"))
