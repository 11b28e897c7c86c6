"""TACO: a tool in one hand, a target in the other.

Source: Liu et al., *TACO: Benchmarking Generalizable Bimanual Tool-ACtion-Object Understanding*,
CVPR 2024, and https://github.com/leolyliu/TACO-Instructions. ``Hand_Poses/(ACTION, TOOL,
TARGET)/SEQUENCE`` has the hands, the folders next to ``Hand_Poses`` objects, cameras and videos.
The world has z up.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Final

import numpy as np

from smooth_hand_datasets.mano_model import load_model
from smooth_hand_datasets.scene import Scene, Thing, checked_count, rigid
from smooth_hand_datasets.unpickle import array, load_restricted, table
from smooth_operator.errors import RecordingError
from smooth_operator.formats.checks import stamps_from_rate
from smooth_operator.formats.clip import Clip, ClipRef, ReadingOptions
from smooth_operator.types import Side

RATE_HZ: Final = 30.0
_CM: Final = 0.01
_OTHERS: Final = ("Object_Poses", "Egocentric_Camera_Parameters", "Allocentric_Camera_Parameters")
_SIDES: Final[tuple[Side, Side]] = ("right", "left")


class Taco:
    """Reader of TACO's sequences, folders ``Hand_Poses/(ACTION, TOOL, TARGET)/SEQUENCE``."""

    what = "a sequence of TACO"
    expects = (
        "right_hand.pkl and left_hand.pkl (frame -> hand_pose (48,), hand_trans (3,)), "
        "right_hand_shape.pkl and left_hand_shape.pkl (hand_shape (10,))"
    )

    def matches(self, path: Path) -> bool:
        """True if a path is a folder with a hand and its shape, or with objects or cameras."""
        if path.name in _OTHERS and (path.parent / "Hand_Poses").is_dir():
            return True
        return any(
            (path / f"{side}_hand.pkl").is_file() and (path / f"{side}_hand_shape.pkl").is_file()
            for side in _SIDES
        )

    def clips(self, path: Path) -> Iterator[ClipRef]:
        """List the sequence; yields nothing for the other folders."""
        if path.name in _OTHERS:
            return
        size = sum(
            (path / f"{side}_hand.pkl").stat().st_size
            for side in _SIDES
            if (path / f"{side}_hand.pkl").is_file()
        )
        yield ClipRef(path.resolve().name, path, layout="taco", size=size)

    def read(self, ref: ClipRef, options: ReadingOptions) -> Clip:
        """Read the hands, the tool, the target and the camera on the head."""
        placed, shape, counts, source = {}, {}, {}, []
        for side in _SIDES:
            file = ref.path / f"{side}_hand.pkl"
            if not file.is_file():
                continue
            source.append(file)
            pose, at = _hand(file)
            counts[file.name] = len(pose)
            held = ref.path / f"{side}_hand_shape.pkl"
            if not held.is_file():
                raise RecordingError(
                    f"{held}: this file, which contains the shape of the hand, is missing"
                )
            value = table(load_restricted(held), str(held), ("hand_shape",))["hand_shape"]
            shape[side] = array(value, f"{held}, hand_shape", (10,), finite=True, batch=True)
            model = load_model(options.mano, side)
            turns = model.rotations(pose[:, :3], pose[:, 3:], flat_hand_mean=True)
            placed[side] = model.place(turns, shape[side], at, moves="wrist", tips="manopth")
        if not source:
            raise RecordingError(f"{ref.path}: it has no hand; expected {self.expects}")
        sequence = ref.path.resolve()
        root = sequence.parent.parent.parent
        part = Path(sequence.parent.name) / sequence.name
        things = []
        for file in sorted((root / "Object_Poses" / part).glob("*.npy")):
            role, _, name = file.stem.partition("_")
            if role in ("tool", "target") and name:
                matrices = array(load_restricted(file), str(file), (None, 4, 4))
                counts[file.name] = len(matrices)
                folder = options.objects or root / "Object_Models"
                mesh = folder / f"{name.split('_')[-1]}_cm.obj"
                things.append(Thing(f"{role}/{name}", rigid(matrices, str(file)), mesh, _CM))
                source.append(file)
        count = checked_count(counts, str(ref.path))
        camera = None
        file = root / "Egocentric_Camera_Parameters" / part / "egocentric_frame_extrinsic.npy"
        if file.is_file():
            matrices = array(load_restricted(file), str(file), (count, 4, 4))
            camera = rigid(matrices, str(file), inverse=True)
            source.append(file)
        return Scene(
            placed,
            stamps_from_rate(count, options.rate or RATE_HZ, str(ref.path)),
            "taco",
            tuple(source),
            shape=shape,
            camera=camera,
            things=things,
            task=_task(sequence.parent.name),
            video=root / "Egocentric_RGB_Videos" / part / "color.mp4",
        ).clip(ref, "taco", self.expects)


def _hand(file: Path) -> tuple[np.ndarray, np.ndarray]:
    """(T, 48) poses and (T, 3) positions, in the order of the frames' names."""
    held = table(load_restricted(file), str(file))
    checked_count({file.name: len(held)}, str(file))
    pose, at = np.zeros((len(held), 48)), np.zeros((len(held), 3))
    try:
        names = sorted(held)
    except TypeError as error:
        raise RecordingError(f"{file}: its frames have names of different kinds") from error
    for number, name in enumerate(names):
        named = f"{file}, {str(name)[:40]}"
        frame = table(held[name], named, ("hand_pose", "hand_trans"))
        pose[number] = array(frame["hand_pose"], f"{named}, hand_pose", (48,))
        at[number] = array(frame["hand_trans"], f"{named}, hand_trans", (3,))
    return pose, at


def _task(triplet: str) -> str | None:
    """From ``(stir, spoon, bowl)`` to "stir the bowl with the spoon"."""
    words = [word.strip() for word in triplet.strip("() ").split(",")]
    if len(words) != 3 or not all(words):
        return None
    action, tool, target = words
    return f"{action} the {target} with the {tool}"


TACO: Final = Taco()
