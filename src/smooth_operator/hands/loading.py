"""Loads MJCF and URDF files as a compiled MuJoCo model with the couplings that the file declares.

MuJoCo's compiler reads both formats. This module adds URDF ``mimic``, names of files that MuJoCo
does not resolve, models whose meshes are missing or far too large, corrected inertias, and
mirroring of a right hand into a left one.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Final

import mujoco
import numpy as np
from jaxtyping import Float
from numpy.polynomial import Polynomial

from smooth_operator.errors import HandModelError
from smooth_operator.hands.mujoco_messages import MUJOCO_ERRORS, refused
from smooth_operator.hands.spec import Coupling

if TYPE_CHECKING:
    import xml.etree.ElementTree as ElementTree

    from smooth_operator.hands.model_assets import ModelFiles

MODELS: Final = Path(__file__).parent / "models"
"""Folder of the built-in spec files and models."""

NO_ROOM: Final = 0.25
"""``shared_range`` below which a coupling is a mistake in the file."""
_SAMPLES: Final = 101  # positions of a leader
_LEAST_RATIO: Final = 1e-6  # of a joint that follows another
_ROOM: Final = 0.75  # ``shared_range`` above which the coupling of the other sign is the right one


@dataclass(frozen=True, eq=False)
class LoadedModel:
    """A compiled model file.

    Attributes:
        model: the compiled model.
        couplings: couplings of its joints, as in the file, except for signs that no pose within
            the limits allows.
        unreadable: names of bodies that lost colliding shapes, because their mesh files can't be
            read or are far too large.
        why: problem of the meshes that were left out, with advice; empty if there are none.
        oversize: True if meshes of another unit than the links were left out.
        inertias: links whose inertia was left out, because MuJoCo refuses it.
        pointers: number of meshes that Git LFS has not downloaded.
    """

    model: mujoco.MjModel
    couplings: tuple[Coupling, ...]
    unreadable: tuple[str, ...]
    why: str = ""
    oversize: bool = False
    inertias: tuple[str, ...] = ()
    pointers: int = 0


def load_model(path: Path, *, mirror: bool = False) -> LoadedModel:
    """Compiles a model file.

    Args:
        path: MJCF (.xml) or URDF file.
        mirror: reflect the model across its x = 0 plane, right hand to left hand.

    Raises:
        HandModelError: if there is no such file, it is too large (``read_model_files``), or MuJoCo
            can't compile it.
    """
    path, files = _model_files(path)
    spec = _read(path, files, mirror)
    if files is not None and _has_assets(spec):
        from smooth_operator.hands.model_meshes import compile_with_meshes

        read = partial(_read, path, files, mirror)
        model, _, unreadable, why, large = compile_with_meshes(path, files, read)
    else:
        model, unreadable, why, large = _compiled(spec, path), (), (), False
    _check_finite(model, path)
    if files is not None and files.root.tag == "robot":
        couplings = _urdf_mimics(files.root, path)
    else:
        equalities = _equalities(model)
        tendons = _tendons(model, {coupling.joint for coupling in equalities})
        couplings = (*equalities, *tendons)
    possible = tuple(_possible(model, coupling) for coupling in couplings)
    inertias, pointers = ((), 0) if files is None else (files.inertias, len(files.pointers))
    return LoadedModel(model, possible, unreadable, "; ".join(why), large, inertias, pointers)


def _model_files(path: Path) -> tuple[Path, ModelFiles | None]:
    """The path for MuJoCo, which takes ``link/..`` for nothing, and the files of a model; None for
    a built-in model, which is one file."""
    if path.parent == MODELS:
        return path, None
    from smooth_operator.hands.model_assets import model_path, read_model_files

    return model_path(path), read_model_files(path)


def _check_finite(model: mujoco.MjModel, path: Path) -> None:
    """Refuses a NaN in a position or an axis, which MuJoCo compiles."""
    for kind, fields in (("body", ("pos", "quat")), ("jnt", ("pos", "axis", "range"))):
        for field in fields:
            broken = np.flatnonzero(~np.isfinite(getattr(model, f"{kind}_{field}")).all(axis=1))
            if len(broken):
                raise HandModelError(
                    f"{path}: the {field} of {getattr(model, kind)(int(broken[0])).name!r} "
                    "contains numbers that are not finite; correct them in the file"
                )


def driven_joints(model: mujoco.MjModel) -> set[int]:
    """Joints with an actuator of their own, the first joint of each driven fixed tendon, and
    leaders that a driven joint follows by a polynomial of degree 2 or more."""
    driven = _actuated(model) | {joints[0] for joints, _ in _driven_tendons(model)}
    curved = (model.eq_type == mujoco.mjtEq.mjEQ_JOINT) & model.eq_data[:, 2:5].any(axis=1)
    return driven | {
        int(model.eq_obj2id[i])
        for i in np.flatnonzero(curved & model.eq_active0)
        if model.eq_obj1id[i] in driven
    }


def _read(path: Path, files: ModelFiles | None, mirror: bool) -> mujoco.MjSpec:
    try:
        spec = mujoco.MjSpec.from_file(str(path)) if files is None else _parsed(path, files)
    except MUJOCO_ERRORS as error:
        raise refused("read", path, error) from error
    _name_all(spec)
    if files is not None and not files.attaches:
        _name_assets(spec, files)
    # Fusing would lose the names of links on fixed joints, such as a URDF's palm and fingertips.
    spec.compiler.fusestatic = False
    # Vendors publish inertias that break the triangle inequality, and links without inertia.
    spec.compiler.balanceinertia = True
    spec.compiler.boundmass = max(spec.compiler.boundmass, 1e-6)
    spec.compiler.boundinertia = max(spec.compiler.boundinertia, 1e-9)
    if mirror:
        mirror_spec(spec)
    return spec


def _name_assets(spec: mujoco.MjSpec, files: ModelFiles) -> None:
    """Replaces the file names in the model by full paths."""
    spec.strippath = False
    for asset in (*spec.meshes, *spec.textures, *spec.hfields, *spec.skins):
        if file := files.assets.get(asset.file):
            if not asset.name:  # MuJoCo would take it from the file's name
                asset.name = Path(asset.file).stem
            asset.file = str(file)


def _parsed(path: Path, files: ModelFiles) -> mujoco.MjSpec:
    """The model of a file in any encoding and with any suffix; MuJoCo itself reads UTF-8 only, and
    only .xml and .urdf."""
    from xml.etree import ElementTree

    from smooth_operator.hands.model_assets import decode_xml

    data = path.read_bytes()
    text = ElementTree.tostring(files.root, "unicode") if files.changed else decode_xml(data, path)
    same = data.isascii() or data.endswith(text.encode("utf-8"))
    if same and not files.changed and path.suffix.lower() in (".xml", ".urdf"):
        return mujoco.MjSpec.from_file(str(path))
    spec = mujoco.MjSpec.from_string(text)
    spec.modelfiledir = str(path.parent)
    return spec


def _name_all(spec: mujoco.MjSpec) -> None:
    """Names unnamed bodies and joints, in the file's order: a description needs names."""
    for kind, elements in (("body", spec.bodies), ("joint", spec.joints)):
        names = {element.name for element in elements}
        for number, element in enumerate(elements):
            if not element.name:
                name = f"{kind}_{number}"
                while name in names:
                    name += "_"
                element.name = name
                names.add(name)


def load_spec(path: Path, *, mirror: bool = False) -> mujoco.MjSpec:
    """The model that ``load_model`` compiles, in editable form; HandModelError if that fails."""
    path, files = _model_files(path)
    read = partial(_read, path, files, mirror)
    spec = read()
    if files is None or not _has_assets(spec):
        _compiled(spec, path)
        return read()  # compiling fixes values of a spec that further edits should derive
    from smooth_operator.hands.model_meshes import compile_with_meshes, drop_meshes

    dropped, spec = compile_with_meshes(path, files, read).dropped, read()
    if dropped is not None:
        drop_meshes(spec, dropped)
    return spec


def _has_assets(spec: mujoco.MjSpec) -> bool:
    """True if the model has meshes, terrain, skins or textures, some of which may be unusable."""
    return any(map(len, (spec.meshes, spec.hfields, spec.skins, spec.textures)))


def _compiled(spec: mujoco.MjSpec, path: Path) -> mujoco.MjModel:
    try:
        return spec.compile()
    except MUJOCO_ERRORS as error:
        raise refused("compile", path, error) from error


def _urdf_mimics(root: ElementTree.Element, path: Path) -> tuple[Coupling, ...]:
    couplings = []
    for joint in root.iter("joint"):
        mimic = joint.find("mimic")
        if mimic is not None:
            name = joint.get("name", "")
            try:
                multiplier = float(mimic.get("multiplier", 1.0))
                offset = float(mimic.get("offset", 0.0))
            except ValueError as error:
                raise HandModelError(
                    f"{path}: mimic of joint {name!r}: multiplier and offset must be numbers "
                    f"({error})"
                ) from error
            if not (math.isfinite(multiplier) and math.isfinite(offset)):
                raise HandModelError(
                    f"{path}: mimic of joint {name!r}: multiplier and offset must be finite, "
                    f"not {multiplier} and {offset}; correct them in the file"
                )
            couplings.append(Coupling(name, mimic.get("joint", ""), multiplier, offset))
    return tuple(couplings)


def merged_couplings(
    declared: tuple[Coupling, ...], given: tuple[Coupling, ...]
) -> tuple[Coupling, ...]:
    """Couplings of a model file, except where a description has its own."""
    joints = {coupling.joint for coupling in given}
    return (*(coupling for coupling in declared if coupling.joint not in joints), *given)


def _possible(model: mujoco.MjModel, coupling: Coupling) -> Coupling:
    """The coupling, or that of the other sign if only that one leaves its joints room to move,
    because vendors forget a sign when they mirror a hand."""
    ids = [
        mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, name)
        for name in (coupling.joint, coupling.follows)
    ]
    if coupling.higher or min(ids) < 0 or not model.jnt_limited[ids].all():
        return coupling
    own, leader = np.asarray(model.jnt_range[ids], float)
    turned = [  # the sign of the joint is wrong, or that of its leader
        replace(coupling, multiplier=-coupling.multiplier, offset=offset, turned=True)
        for offset in (0.0 - coupling.offset, coupling.offset)
    ]
    best = max(turned, key=lambda c: shared_range(c.at, own, leader))
    here, there = (shared_range(c.at, own, leader) for c in (coupling, best))
    if here < NO_ROOM and there > _ROOM:
        return best
    return coupling


def shared_range(
    curve: Callable[[float], float], own: Float[np.ndarray, "2"], leader: Float[np.ndarray, "2"]
) -> float:
    """How much of a coupled joint's own range [rad] overlaps with the range of ``curve`` over the
    range of its leader, as a fraction of the smaller range: at most 1; negative if the ranges do
    not meet; 1 if one range is a point inside the other."""
    reached = [curve(float(q)) for q in np.linspace(leader[0], leader[1], _SAMPLES)]
    led = np.array([min(reached), max(reached)])
    overlap = min(own[1], led[1]) - max(own[0], led[0])
    smaller = min(np.ptp(own), np.ptp(led))
    if smaller <= 0:
        return 1.0 if overlap >= 0 else -1.0
    return float(overlap / smaller)


def _equalities(model: mujoco.MjModel) -> tuple[Coupling, ...]:
    """Couplings from joint equalities, q1 - q1_0 = c0 + c1 (q2 - q2_0) + ... The joint without an
    actuator follows; q1 follows if the degree is higher than 1."""
    actuated = _actuated(model)
    couplings = []
    for i in range(model.neq):
        if model.eq_type[i] != mujoco.mjtEq.mjEQ_JOINT or not model.eq_active0[i]:
            continue
        first, second = int(model.eq_obj1id[i]), int(model.eq_obj2id[i])
        names = [model.joint(j).name for j in (first, second) if j >= 0]
        c0, c1, *higher = (float(c) for c in model.eq_data[i, :5])
        zero1, zero2 = (float(model.qpos0[model.jnt_qposadr[j]]) for j in (first, second))
        if second < 0 or (abs(c1) < _LEAST_RATIO and not any(higher)):
            raise HandModelError(
                f"the coupling of joints {names} must be a polynomial, q1 = a + b q2 + ..., that "
                "moves q1; correct it in the file"
            )
        if any(higher):
            shifted = Polynomial((c0, c1, *higher))(Polynomial((-zero2, 1.0))) + zero1
            couplings.append(Coupling.of(names[0], names[1], shifted.coef.tolist()))
            continue
        offset = zero1 + c0 - c1 * zero2
        if first in actuated and second not in actuated:  # inverted: q2 = (q1 - offset) / c1
            couplings.append(Coupling(names[1], names[0], 1 / c1, -offset / c1))
        else:
            couplings.append(Coupling(names[0], names[1], c1, offset))
    return tuple(couplings)


def _tendons(model: mujoco.MjModel, followers: set[str]) -> tuple[Coupling, ...]:
    """Couplings from driven fixed tendons of length sum c_i q_i; the first joint leads. If springs
    and friction are equal, the tendon bends each joint in proportion to c_i."""
    couplings = []
    for joints, shares in _driven_tendons(model):
        lead = model.joint(joints[0]).name
        for joint, share in zip(joints[1:], shares[1:], strict=True):
            if (name := model.joint(joint).name) not in followers:
                couplings.append(Coupling(name, lead, share / shares[0], 0.0))
    return tuple(couplings)


def _driven_tendons(model: mujoco.MjModel) -> list[tuple[list[int], list[float]]]:
    """Joints and coefficients of fixed tendons with an actuator, the joint nearest the palm first,
    followers last; without joints that have an actuator or that an earlier tendon drives."""
    joints, tendons = _actuated(model), []
    held = (model.eq_type == mujoco.mjtEq.mjEQ_JOINT) & (model.eq_active0 != 0)
    led = {int(j) for j in model.eq_obj1id[held]} - joints
    for i in range(model.nu):
        if model.actuator_trntype[i] != mujoco.mjtTrn.mjTRN_TENDON:
            continue
        tendon = int(model.actuator_trnid[i, 0])
        wraps = range(model.tendon_adr[tendon], model.tendon_adr[tendon] + model.tendon_num[tendon])
        if any(model.wrap_type[w] != mujoco.mjtWrap.mjWRAP_JOINT for w in wraps):
            continue  # a spatial tendon is no linear coupling
        moved = sorted(
            (
                (int(model.wrap_objid[w]), float(model.wrap_prm[w]))
                for w in wraps
                if model.wrap_prm[w] and int(model.wrap_objid[w]) not in joints
            ),
            key=lambda pair: (pair[0] in led, pair[0]),
        )
        joints |= {joint for joint, _ in moved}
        if moved:
            tendons.append(([joint for joint, _ in moved], [share for _, share in moved]))
    return tendons


def _actuated(model: mujoco.MjModel) -> set[int]:
    """Joints with their own actuator."""
    return {
        int(model.actuator_trnid[i, 0])
        for i in range(model.nu)
        if model.actuator_trntype[i] == mujoco.mjtTrn.mjTRN_JOINT
    }


def mirror_spec(spec: mujoco.MjSpec) -> None:
    """Reflects a model across the x = 0 plane of every local frame, in place; HandModelError if it
    has meshes.

    A hinge axis is a pseudo-vector: (x, y, z) becomes (x, -y, -z), so that the same joint angle
    gives the mirrored pose and limits keep their sign; a slide's axis is an ordinary vector.
    """
    if list(spec.meshes):
        raise HandModelError(
            "a model with meshes can't be mirrored; use the side of the model (--side left "
            "or right, or a recording of that side), or add a model of the other side"
        )
    for element in [*spec.bodies, *spec.geoms, *spec.sites, *spec.cameras]:
        element.pos = element.pos * (-1, 1, 1)
        element.quat = element.quat * (1, 1, -1, -1)
    for element in [*spec.geoms, *spec.sites]:
        element.fromto = element.fromto * (-1, 1, 1, -1, 1, 1)  # NaN where unused, and stays so
    for joint in spec.joints:
        slide = joint.type == mujoco.mjtJoint.mjJNT_SLIDE
        joint.pos = joint.pos * (-1, 1, 1)
        joint.axis = joint.axis * ((-1, 1, 1) if slide else (1, -1, -1))
