"""ARCTIC: two hands and an articulated object, from motion capture.

Source: Fan et al., *ARCTIC: A Dataset for Dexterous Bimanual Hand-Object Manipulation*, CVPR 2023,
and https://github.com/zc-alexfan/arctic. ``raw_seqs/SUBJECT/NAME.mano.npy`` has the hands;
``NAME.object.npy`` and ``NAME.egocam.dist.npy`` are in the same folder.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Final

import numpy as np

from smooth_hand_datasets.mano_model import load_model
from smooth_hand_datasets.scene import Scene, Thing, checked_count, nearby, rigid
from smooth_hand_datasets.unpickle import array, load_restricted, numbers, table
from smooth_operator import poses
from smooth_operator.formats.checks import stamps_from_rate
from smooth_operator.formats.clip import Clip, ClipRef, ReadingOptions
from smooth_operator.types import Side

RATE_HZ: Final = 30.0
_SUFFIX: Final = ".mano.npy"
_OTHERS: Final = (".object.npy", ".egocam.dist.npy", ".smplx.npy")
_MM: Final = 0.001
_HINGE: Final = np.array([0.0, 0.0, -1.0])  # of the top part, in the object's frame


class Arctic:
    """Reader of ARCTIC's sequences, ``raw_seqs/SUBJECT/NAME.mano.npy``."""

    what = "a sequence of ARCTIC"
    expects = (
        "NAME.mano.npy with right and left, each with rot (T, 3), pose (T, 45), trans (T, 3) and "
        "shape (10,); in the same folder NAME.object.npy (T, 7)"
    )

    def matches(self, path: Path) -> bool:
        """True for a file of hands and for the files that belong to one."""
        for suffix in (_SUFFIX, *_OTHERS):
            if path.name.endswith(suffix):
                return path.with_name(path.name.removesuffix(suffix) + _SUFFIX).is_file()
        return False

    def clips(self, path: Path) -> Iterator[ClipRef]:
        """List the sequence; yields nothing for its other files."""
        if path.name.endswith(_SUFFIX):
            name = path.name.removesuffix(_SUFFIX)
            yield ClipRef(name, path, layout="arctic", size=path.stat().st_size)

    def read(self, ref: ClipRef, options: ReadingOptions) -> Clip:
        """Read the hands, the two parts of the object, and the camera on the head."""
        where = str(ref.path)
        held = table(load_restricted(ref.path), where, ("right", "left"))
        stem = ref.path.name.removesuffix(_SUFFIX)
        placed, shape, counts = {}, {}, {}
        side: Side
        for side in ("right", "left"):
            part = table(held[side], f"{where}, {side}", ("rot", "pose", "trans", "shape"))
            root = array(part["rot"], f"{where}, {side} rot", (None, 3))
            pose = array(part["pose"], f"{where}, {side} pose", (None, 45))
            at = array(part["trans"], f"{where}, {side} trans", (None, 3))
            for name, rows in (("rot", root), ("pose", pose), ("trans", at)):
                counts[f"{side} {name}"] = len(rows)
            checked_count(counts, where)
            betas = numbers(part["shape"])
            betas = betas if betas.ndim == 2 else betas[None]
            betas = array(betas, f"{where}, {side} shape", (None, 10), finite=True)
            if len(betas) not in (1, len(root)):
                checked_count({**counts, f"{side} shape": len(betas)}, where)
            shape[side] = np.median(betas, axis=0)
            model = load_model(options.mano, side)
            turns = model.rotations(root, pose, flat_hand_mean=False)
            placed[side] = model.place(turns, betas, at, tips="smplx")
        count = checked_count(counts, where)

        source = [ref.path]
        things: list[Thing] = []
        file = ref.path.with_name(f"{stem}.object.npy")
        if file.is_file():
            rows = array(load_restricted(file), str(file), (None, 7))
            checked_count({**counts, file.name: len(rows)}, where)
            things = _parts(rows, stem.split("_")[0], ref.path, options)
            source.append(file)
        camera = None
        file = ref.path.with_name(f"{stem}.egocam.dist.npy")
        if file.is_file():
            camera = _camera(file, count)
            source.append(file)
        return Scene(
            placed,
            stamps_from_rate(count, options.rate or RATE_HZ, where),
            "arctic",
            tuple(source),
            shape=shape,
            camera=camera,
            things=things,
            task=_task(stem),
        ).clip(ref, "arctic", self.expects)


def _parts(rows: np.ndarray, name: str, path: Path, options: ReadingOptions) -> list[Thing]:
    """The object's bottom, and its top, which is rotated about the hinge by a row's first number
    [rad]."""
    folder = options.objects or nearby(path.resolve().parent, "meta/object_vtemplates")
    base = np.concatenate([rows[:, 4:] * _MM, poses.from_rotation_vectors(rows[:, 1:4])], axis=1)
    turn = poses.from_rotation_vectors(rows[:, :1] * _HINGE)
    hinged = poses.compose(base, np.concatenate([np.zeros((len(rows), 3)), turn], axis=1))
    return [
        Thing(
            f"{name}/{part}", pose, None if folder is None else folder / name / f"{part}.obj", _MM
        )
        for part, pose in (("bottom", base), ("top", hinged))
    ]


def _camera(file: Path, count: int) -> np.ndarray:
    held = table(load_restricted(file), str(file), ("R_k_cam_np", "T_k_cam_np"))
    matrices = np.zeros((count, 4, 4))
    matrices[:, :3, :3] = array(held["R_k_cam_np"], f"{file}, R_k_cam_np", (count, 3, 3))
    at = numbers(held["T_k_cam_np"])
    at = at[..., 0] if at.ndim == 3 else at
    matrices[:, :3, 3] = array(at, f"{file}, T_k_cam_np", (count, 3))
    matrices[:, 3, 3] = 1.0
    return rigid(matrices, str(file), inverse=True)


def _task(stem: str) -> str | None:
    """From ``box_grab_01`` to "grab the box"."""
    words = stem.split("_")
    return f"{words[1]} the {words[0]}" if len(words) > 2 else None


ARCTIC: Final = Arctic()
