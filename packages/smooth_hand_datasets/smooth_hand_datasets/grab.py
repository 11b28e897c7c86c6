"""GRAB: whole bodies that grasp objects; its two hands and the object are read.

Source: Taheri et al., *GRAB: A Dataset of Whole-Body Human Grasping of Objects*, ECCV 2020, and
https://github.com/otaheri/GRAB. ``grab/SUBJECT/NAME.npz`` has a sequence at 120 Hz; the hands of
the subjects are meshes in ``tools/subject_meshes``. The world has z up.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import numpy as np

from smooth_hand_datasets.mano_model import PlacedHand, load_model
from smooth_hand_datasets.scene import Scene, Thing, checked_count
from smooth_hand_datasets.unpickle import array, load_restricted, numbers, table, text
from smooth_operator import poses
from smooth_operator.errors import RecordingError, brief, reason, require
from smooth_operator.formats.arrays import npz_arrays
from smooth_operator.formats.checks import stamps_from_rate
from smooth_operator.formats.clip import Clip, ClipRef, ReadingOptions
from smooth_operator.io.plain_files import check_plain_file
from smooth_operator.types import Side

RATE_HZ: Final = 120.0
_MOST_MESH_BYTES: Final = 2_000_000
_SIDES: Final[dict[str, Side]] = {"rhand": "right", "lhand": "left"}
_KEYS: Final = ("rhand", "lhand", "object", "obj_name")
_PARAMS: Final = ("global_orient", "hand_pose", "transl")


class Grab:
    """Reader of GRAB's sequences, ``grab/SUBJECT/NAME.npz``."""

    what = "a sequence of GRAB"
    expects = (
        "NAME.npz with rhand, lhand (params: global_orient (T, 3), hand_pose (T, 24), transl "
        "(T, 3); vtemp), object (params: global_orient, transl; object_mesh) and obj_name"
    )

    def matches(self, path: Path) -> bool:
        """True if a path is an ``.npz`` file with GRAB's tables, or the folder of its tools."""
        return (path / "subject_meshes").is_dir() or set(_KEYS) <= npz_arrays(path).keys()

    def clips(self, path: Path) -> Iterator[ClipRef]:
        """List the sequence; yields nothing for the folder of tools."""
        if path.is_file():
            yield ClipRef(path.stem, path, layout="grab", size=path.stat().st_size)

    def read(self, ref: ClipRef, options: ReadingOptions) -> Clip:
        """Read the hands and the object."""
        where = str(ref.path)
        names = (*_KEYS, "framerate", "motion_intent", "n_frames")
        held = table(load_restricted(ref.path, names=names), where, _KEYS)
        root = ref.path.resolve().parent.parent.parent
        placed: dict[Side, PlacedHand] = {}
        counts: dict[str, int] = {}
        for key, side in _SIDES.items():
            part = table(held[key], f"{where}, {key}", ("params", "vtemp"))
            params = table(part["params"], f"{where}, {key} params", _PARAMS)
            turn = array(params["global_orient"], f"{where}, {key} global_orient", (None, 3))
            pose = array(params["hand_pose"], f"{where}, {key} hand_pose", (None, None))
            at = array(params["transl"], f"{where}, {key} transl", (None, 3))
            if not 0 < pose.shape[1] <= 45:
                raise RecordingError(f"{where}: hand_pose of {key} has {pose.shape[1]} numbers")
            counts |= {f"{key} {n}": len(a) for n, a in zip(_PARAMS, (turn, pose, at), strict=True)}
            checked_count(counts, where)
            model = load_model(options.mano, side)
            turns = model.rotations(turn, pose, pca=True, flat_hand_mean=True)
            template = _vertices(root, part["vtemp"], where)
            placed[side] = model.place(turns, np.zeros(10), at, tips="smplx", template=template)
        count = checked_count(counts, where)
        thing = _object(held, root, options, where)
        checked_count({**counts, "object": len(thing.poses)}, where)
        rate = options.rate or _rate(held.get("framerate"), where)
        name = thing.name
        intent = text(held.get("motion_intent"))
        return Scene(
            placed,
            stamps_from_rate(count, rate, where),
            "grab",
            (ref.path,),
            things=[thing],
            task=f"{intent.replace('_', ' ')} the {name}" if intent else None,
        ).clip(ref, "grab", self.expects)


def _rate(value: Any, where: str) -> float:
    if value is None:
        return RATE_HZ
    return float(array(np.ravel(numbers(value)), f"{where}, framerate", (1,), finite=True)[0])


def _object(held: dict[Any, Any], root: Path, options: ReadingOptions, where: str) -> Thing:
    part = table(held["object"], f"{where}, object", ("params",))
    params = table(part["params"], f"{where}, object params", ("global_orient", "transl"))
    turn = array(params["global_orient"], f"{where}, object global_orient", (None, 3))
    at = array(params["transl"], f"{where}, object transl", (None, 3))
    checked_count({"object global_orient": len(turn), "object transl": len(at)}, where)
    # GRAB multiplies row vectors by the matrix, which turns them by the negative angle.
    pose = np.concatenate([at, poses.from_rotation_vectors(-turn)], axis=1)
    mesh = _inside(root, text(part.get("object_mesh")))
    if options.objects is not None and mesh is not None:
        mesh = options.objects / mesh.name
    return Thing(text(held["obj_name"]) or "object", pose, mesh)


def _inside(root: Path, relative: str | None) -> Path | None:
    """Path of a file; None if it is outside the data set's folder."""
    if relative is None:
        return None
    parts = Path(relative.replace("\\", "/")).parts
    if Path(relative).is_absolute() or ".." in parts:
        return None
    return root.joinpath(*parts)


def _vertices(root: Path, relative: Any, where: str) -> np.ndarray:
    """(778, 3) vertices of the subject's hand."""
    path = _inside(root, text(relative))
    if path is None or not path.is_file():
        raise RecordingError(
            f"{where}: the subject's hand, {brief(text(relative) or 'vtemp')}, is not in {root}; "
            "extract the data set's tools/subject_meshes, which contain the shapes of the hands, "
            "to that folder"
        )
    require("reading the shape of a hand in GRAB", "objects", "trimesh")
    import trimesh

    size = check_plain_file(path)
    if size > _MOST_MESH_BYTES:
        raise RecordingError(f"{path}: it has {size} bytes, too many for a mesh of a hand")
    try:
        with path.open("rb") as stream:
            mesh: Any = trimesh.load(stream, file_type=path.suffix[1:], process=False)
            points = np.asarray(mesh.vertices, np.float64)
    except Exception as error:  # trimesh documents no list of errors
        raise RecordingError(f"{path}: it can't be read as a mesh: {reason(error)}") from error
    return array(points, str(path), (778, 3), finite=True)


GRAB: Final = Grab()
