"""Reads an ``.npz`` file with the landmarks of both hands, whatever program wrote it.

=================================  ===========  ===================================================
array                              shape        content
=================================  ===========  ===================================================
``right``, ``left``                (T, 21, 3)   landmarks [m], NaN where missing; one of the two is
                                                enough; also 25 (WebXR, MANUS) or 26 (OpenXR) nodes
``timestamps`` or ``stamps``       (T,)         times [s]; without them a rate is needed
``valid_right``, ``valid_left``    (T, 21)      true or 1 where a landmark was seen; also (T,)
``T_world_wrist_right``, ``_left`` (T, 7)       x y z [m] and quaternion w x y z, in ``world``; also
                                                (T, 4, 4), as all poses
``confidence_right``, ``_left``    (T,)         0 to 1
``T_world_camera``                 (T, 7)       the camera, x right, y down, z into the picture
``T_world_object_NAME``            (T, 7)       an object
``world``, ``task``, ``video``     text         name of the world, the task, the video's file
=================================  ===========  ===================================================
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from smooth_operator.errors import RecordingError
from smooth_operator.formats.arrays import StoredArrays, npz_arrays, open_arrays
from smooth_operator.formats.both_hands import checked_hands, first_video
from smooth_operator.formats.checks import check_rate
from smooth_operator.formats.clip import CAMERA, SIDES, Clip, ClipRef, ObjectTrack, ReadingOptions
from smooth_operator.formats.hand_arrays import pose_rows, quaternion_order, shares
from smooth_operator.formats.readers import array_hand
from smooth_operator.types import HandRecording, Side

_OBJECT: Final = "T_world_object_"
_MESHES: Final = ("obj", "ply", "stl", "off", "glb")
_WORLD: Final = "world"
_MOST_TEXT: Final = 2000


class LandmarksOfBothHands:
    """Reader of ``.npz`` files with the landmarks of both hands; each file is one clip."""

    what = "an .npz with the landmarks of both hands"
    expects = (
        "an .npz with 'right' and 'left', or one of them, of shape (frames, 21, 3) [m], and "
        "'timestamps' (frames,) [s]"
    )

    def matches(self, path: Path) -> bool:
        """True for an ``.npz`` file that has an array ``right`` or ``left`` with three axes."""
        arrays = npz_arrays(path)  # of a damaged file the reader of recordings says what is wrong
        return any(side in arrays and len(arrays[side].shape) == 3 for side in SIDES)

    def clips(self, path: Path) -> Iterator[ClipRef]:
        """Yields the file as one clip."""
        yield ClipRef(path.stem, path, layout="landmarks", size=path.stat().st_size)

    def read(self, ref: ClipRef, options: ReadingOptions) -> Clip:
        """Reads the hands, wrists, camera, objects and task of a file. Raises RecordingError if the
        shape of an array does not match the others, or if units, order, side or timestamps are
        wrong."""
        path, arrays = ref.path, open_arrays(ref.path)
        sides = [side for side in SIDES if side in arrays]
        if not sides:
            raise RecordingError(
                f"{path}: it contains {arrays.describe()}; expected {self.expects}"
            )
        shapes = [arrays[side].shape for side in sides]
        if len({shape[:1] for shape in shapes}) > 1:
            raise RecordingError(
                f"{path}: 'right' and 'left' must have the same number of frames, not the shapes "
                f"{shapes[0]} and {shapes[1]}"
            )
        world = _text(arrays, "world") or _WORLD
        hands = {side: _hand(arrays, side, options.rate, world) for side in sides}
        stamps = hands[sides[0]].stamps
        check_rate(stamps, options.rate, str(path))
        count = len(stamps)
        checked = checked_hands(hands, str(path), self.expects)
        task, named = _text(arrays, "task"), _text(arrays, "video")
        video = None if named is None else first_video(path.with_name(Path(named).name))
        return Clip(
            ref.name,
            checked,
            "landmarks",
            (path,) if video is None else (path, video),
            task=task,
            confidence={
                side: shares(
                    _shaped(arrays, f"confidence_{side}", (count,)), f"{path}, confidence_{side}"
                )
                for side in checked
                if f"confidence_{side}" in arrays
            },
            T_world_camera=_camera(arrays, count, world),
            objects=tuple(
                ObjectTrack(
                    name.removeprefix(_OBJECT),
                    _pose(arrays, name, count),
                    _mesh(options.objects or path.parent, name.removeprefix(_OBJECT)),
                )
                for name in arrays
                if name.startswith(_OBJECT)
            ),
            video=video,
        )


def _mesh(folder: Path, name: str) -> Path | None:
    """The mesh of an object [m], if its file is in the folder."""
    files = (folder / f"{Path(name).name}.{suffix}" for suffix in _MESHES)
    return next((file for file in files if file.is_file()), None)


def _hand(arrays: StoredArrays, side: Side, rate: float | None, world: str) -> HandRecording:
    hand = array_hand(arrays, arrays[side], rate, side)
    tracked = hand.T_world_wrist is not None
    return replace(hand, meta={"format": "landmarks"}, world=world if tracked else None)


def _camera(arrays: StoredArrays, count: int, world: str) -> np.ndarray | None:
    if "T_world_camera" not in arrays or world == CAMERA:
        return None
    return _pose(arrays, "T_world_camera", count)


def _pose(arrays: StoredArrays, name: str, count: int) -> np.ndarray:
    return pose_rows(arrays[name], count, quaternion_order(arrays))


def _shaped(arrays: StoredArrays, name: str, shape: tuple[int, ...]) -> np.ndarray:
    stored = arrays[name]
    if stored.shape != shape:
        raise RecordingError(
            f"{arrays.path}: array {name[:80]!r} must have shape {shape} to fit the hands, not "
            f"{stored.shape}"
        )
    return stored.numbers()


def _text(arrays: StoredArrays, name: str) -> str | None:
    stored: Any = arrays.get(name)
    if stored is None or stored.dtype.kind not in "US" or stored.shape not in ((), (1,)):
        return None
    return stored.text()[:_MOST_TEXT].strip() or None


LANDMARKS_OF_BOTH_HANDS: Final = LandmarksOfBothHands()
