"""Readers of clips: recordings of one hand, headset apps, EgoDex, and plain arrays of both hands.

EgoDex: both hands, the camera and the task from one HDF5 file, and its video. Source: the README
and ``visualize_2d.py`` of apple/ml-egodex; the paper, arXiv 2505.11709.

Plain arrays: an ``.npz`` with the landmarks of both hands, for data of any origin:

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

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from smooth_operator.datasets.clip import (
    CAMERA,
    NOTES,
    ORDER,
    RATE,
    SIDES,
    Clip,
    ObjectTrack,
)
from smooth_operator.datasets.readers.both_hands import (
    checked_hands,
    first_video,
    on_common_stamps,
)
from smooth_operator.datasets.registry import ClipRef, ReadingOptions
from smooth_operator.episode_files.hdf5_tree import (
    EGODEX_JOINTS,
    RATE_HZ,
    Hdf5Group,
    egodex_camera,
    egodex_confidences,
    egodex_hand,
    read_tree,
)
from smooth_operator.errors import MissingExtraError, RecordingError, listed
from smooth_operator.formats.arrays import StoredArrays, open_arrays
from smooth_operator.formats.checks import check_rate, check_stamps, stamps_from_rate
from smooth_operator.formats.commands import only_commands
from smooth_operator.formats.hand_arrays import (
    own_stamps,
    pose_rows,
    quaternion_order,
    shares,
    validity,
)
from smooth_operator.formats.readers import rated_if_unstamped, read_assumed
from smooth_operator.formats.registry import AVP, HTS, Reader, recording_suffixes
from smooth_operator.headsets.recordings import read_both_hands
from smooth_operator.landmarks import NODE_LAYOUTS
from smooth_operator.types import HandRecording, Side


class Files:
    """One file, one hand, one clip."""

    what = "a recording of one hand"
    expects = "a file that 'smooth-operator retarget' reads"

    def matches(self, path: Path) -> bool:
        """True if its name ends as those of recordings do, and it holds more than commands."""
        ending = path.suffix.lower() in recording_suffixes()
        return ending and path.is_file() and not only_commands(path)

    def clips(self, path: Path) -> Iterator[ClipRef]:
        """The file."""
        yield ClipRef(path.stem, path, layout="files", size=path.stat().st_size)

    def read(self, ref: ClipRef, options: ReadingOptions) -> Clip:
        """Its hand.

        Raises:
            RecordingError: as ``read_recording``.
        """
        recording, rate = rated_if_unstamped(
            lambda rate: read_assumed(
                ref.path, options.assumed, rate=rate, side=options.side, layout=options.order
            ),
            options.rate,
        )
        notes = []
        if recording.meta.get("side_assumed"):
            notes.append("the side is not stated; assuming right. Use --side left otherwise")
        if ignored := recording.meta.get("ignored"):
            notes.append(f"not read: {listed(ignored)}")
        facts = {NOTES: notes, RATE: rate, ORDER: options.order}
        meta = {name: value for name, value in facts.items() if value}
        return Clip(ref.name, {recording.side: recording}, "files", (ref.path,), meta=meta)


FILES: Final = Files()


_FORM_BYTES: Final = 128


@dataclass(frozen=True)
class HeadsetRecording:
    """A format of one app: one file, one clip.

    Attributes:
        layout: its name.
        what: kind of its files.
        expects: expected content of a file.
        forms: name -> how a file is recognised; the names are those of ``read_both_hands``.
    """

    layout: str
    what: str
    expects: str
    forms: dict[str, Reader]

    def matches(self, path: Path) -> bool:
        """True if a file begins as those of the app do."""
        return path.is_file() and self._form(path) is not None

    def clips(self, path: Path) -> Iterator[ClipRef]:
        """The file."""
        yield ClipRef(path.stem, path, layout=self.layout, size=path.stat().st_size)

    def read(self, ref: ClipRef, options: ReadingOptions) -> Clip:
        """Its hands on common stamps; where the app had nothing new of one, it is NaN.

        Raises:
            RecordingError: there is no hand in it; it has no stamps and there is no rate; units,
                order or side are wrong.
        """
        form = self._form(ref.path) or next(iter(self.forms))
        hands = read_both_hands(ref.path, options.rate, form)
        where = str(ref.path)
        checked = checked_hands(on_common_stamps(hands, where), where, self.expects)
        return Clip(ref.name, checked, self.layout, (ref.path,), meta={"form": form})

    def _form(self, path: Path) -> str | None:
        suffixes = {suffix for reader in self.forms.values() for suffix in reader.suffixes}
        if path.suffix.lower() not in suffixes:
            return None
        with path.open("rb") as stream:
            head = stream.read(_FORM_BYTES)
        forms = (name for name, reader in self.forms.items() if reader.recognises(path, head))
        return next(forms, None)


AVP_RECORDING: Final = HeadsetRecording(
    "avp",
    AVP.what,
    "lines of JSON with 'timestamp', 'leftHand' and 'rightHand', the hands with 'wrist' and 24 "
    "joints of 16 numbers each",
    {"avp": AVP},
)
HTS_RECORDING: Final = HeadsetRecording(
    "hts",
    HTS.what,
    "lines 'Right wrist:, ...' and 'Right landmarks:, ...', or the same of 'Left'",
    {"hts": HTS},
)


_MAGIC: Final = b"\x89HDF\r\n\x1a\n"
_HEAD_BYTES: Final = 4096
_ABOUT: Final = ("task", "environment", "object", "session_name", "llm_verbs", "llm_objects")


class Egodex:
    """One file, one clip of 30 frames a second."""

    what = "an HDF5 file of EgoDex"
    expects = (
        "an .hdf5 file with transforms/rightHand (frames, 4, 4), transforms/leftHand and the 24 "
        "other joints of each hand, and perhaps transforms/camera and confidences"
    )

    def matches(self, path: Path) -> bool:
        """True if it is an HDF5 file with the group ``transforms``."""
        if path.suffix.lower() not in (".hdf5", ".h5") or not path.is_file():
            return False
        with path.open("rb") as stream:
            head = stream.read(_HEAD_BYTES)
        if not head.startswith(_MAGIC):
            return False
        if b"transforms\0" in head:  # a name of the top group; HDF5 itself takes 70 times as long
            return True
        try:
            return "transforms" in read_tree(path, head=True)["/"].names
        except (RecordingError, MissingExtraError):
            return False  # the reader of plain recordings says what is wrong

    def clips(self, path: Path) -> Iterator[ClipRef]:
        """The file."""
        yield ClipRef(path.stem, path, layout="egodex", size=path.stat().st_size)

    def read(self, ref: ClipRef, options: ReadingOptions) -> Clip:
        """Its hands, camera and task; frames that ARKit did not see are NaN and not valid.

        Raises:
            RecordingError: it is damaged, or joints are missing or have another shape.
            MissingExtraError: h5py is not installed.
        """
        path = ref.path
        tree = read_tree(path)
        if "transforms" not in tree:
            raise RecordingError(
                f"{path}: no file of EgoDex: it holds {tree['/'].describe()}; expected is "
                f"{self.expects}"
            )
        rate = options.rate or RATE_HZ
        held = tree["transforms"].arrays
        hands = {
            side: egodex_hand(tree, path, rate, side)
            for side in SIDES
            if any(name in held for name in EGODEX_JOINTS[side])
        }
        checked = checked_hands(hands, str(path), self.expects)
        video = first_video(path.with_suffix(".mp4"))
        top = tree["/"].attributes
        return Clip(
            ref.name,
            checked,
            "egodex",
            (path,) if video is None else (path, video),
            task=_task(top),
            confidence={
                side: shares(np.nanmean(sure, axis=1), f"{path}, {side} hand")
                for side, hand in checked.items()
                if (sure := _confidences(tree, side, len(hand))) is not None
            },
            T_world_camera=egodex_camera(tree, path),
            video=video,
            meta=_meta(tree, top),
        )


def _confidences(tree: Mapping[str, Hdf5Group], side: Any, count: int) -> np.ndarray | None:
    """Those of the joints that have any in every frame; None if there is none."""
    sure = egodex_confidences(tree, side, count)
    if sure is None:
        return None
    return np.asarray(sure[:, ~np.isnan(sure).all(axis=0)])


def _task(attributes: Mapping[str, Any]) -> str | None:
    """Task in words.

    A task that can be done and undone (``llm_type`` is ``reversible``) has two descriptions, and
    ``which_llm_description`` says which of them is meant.
    """
    key = "llm_description"
    if attributes.get("llm_type") == "reversible":
        second = str(attributes.get("which_llm_description", "1")).strip() == "2"
        key = "llm_description2" if second else key
    for name in (key, "llm_description", "task"):
        text = attributes.get(name)
        if isinstance(text, str) and text.strip():
            return text.strip()
    return None


def _meta(tree: Mapping[str, Hdf5Group], attributes: Mapping[str, Any]) -> dict[str, Any]:
    meta: dict[str, Any] = {name: attributes[name] for name in _ABOUT if name in attributes}
    stored = tree["camera"].arrays.get("intrinsic") if "camera" in tree else None
    matrix = None if stored is None or stored.shape != (3, 3) else stored.data
    if matrix is not None and np.isfinite(matrix).all():
        meta["intrinsic"] = matrix.tolist()
    return meta


EGODEX: Final = Egodex()


_OBJECT: Final = "T_world_object_"
_MESHES: Final = ("obj", "ply", "stl", "off", "glb")
_WORLD: Final = "world"
_MOST_TEXT: Final = 2000


class LandmarksOfBothHands:
    """One file, one clip."""

    what = "an .npz with the landmarks of both hands"
    expects = (
        "an .npz with 'right' and 'left', or one of them, of shape (frames, 21, 3) [m], and "
        "'timestamps' (frames,) [s]"
    )

    def matches(self, path: Path) -> bool:
        """True if it is an ``.npz`` that has ``right`` or ``left`` with three axes."""
        if path.suffix.lower() != ".npz" or not path.is_file():
            return False
        try:
            arrays = open_arrays(path)
        except RecordingError:
            return False  # the reader of plain recordings says what is wrong
        return any(side in arrays and len(arrays[side].shape) == 3 for side in SIDES)

    def clips(self, path: Path) -> Iterator[ClipRef]:
        """The file."""
        yield ClipRef(path.stem, path, layout="landmarks", size=path.stat().st_size)

    def read(self, ref: ClipRef, options: ReadingOptions) -> Clip:
        """Its hands, wrists, camera, objects and task.

        Raises:
            RecordingError: an array has another shape than the others ask for; units, order, side
                or stamps are wrong.
        """
        path, arrays = ref.path, open_arrays(ref.path)
        sides = [side for side in SIDES if side in arrays]
        if not sides:
            raise RecordingError(
                f"{path}: it holds {arrays.describe()}; expected is {self.expects}"
            )
        count = arrays[sides[0]].shape[0] if arrays[sides[0]].shape else 0
        stamps = _stamps(arrays, count, options.rate)
        world = _text(arrays, "world") or _WORLD
        hands = {side: _hand(arrays, side, stamps, world) for side in sides}
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


def _hand(arrays: StoredArrays, side: Side, stamps: np.ndarray, world: str) -> HandRecording:
    stored, count = arrays[side], len(stamps)
    nodes = stored.shape[1] if len(stored.shape) == 3 else 0
    if nodes not in NODE_LAYOUTS or stored.shape != (count, nodes, 3):
        raise RecordingError(
            f"{arrays.path}: array {side!r} must have shape ({count}, 21, 3), or 25 or 26 nodes in "
            f"place of 21, not {stored.shape}"
        )
    points = stored.numbers()
    picked, bases = NODE_LAYOUTS[nodes]
    valid: np.ndarray = np.isfinite(points[:, picked]).all(axis=-1)
    if f"valid_{side}" in arrays:
        valid &= validity(arrays[f"valid_{side}"], count, picked, nodes)
    else:  # "no hand in view" is all zeros in some trackers
        there: np.ndarray = np.any(points[:, picked], axis=(1, 2))
        valid &= there[:, None]
    wrist = f"T_world_wrist_{side}"
    tracked = wrist in arrays
    return HandRecording(
        points[:, picked],
        stamps,
        side,
        valid=valid,
        metacarpals=None if bases is None else points[:, bases],
        name=arrays.path.stem,
        meta={"format": "landmarks"},
        T_world_wrist=_pose(arrays, wrist, count) if tracked else None,
        world=world if tracked else None,
    )


def _stamps(arrays: StoredArrays, count: int, rate: float | None) -> np.ndarray:
    where = str(arrays.path)
    name = next((key for key in ("timestamps", "stamps") if key in arrays), None)
    if name is None:
        return stamps_from_rate(count, rate, where)
    stamps = own_stamps(_shaped(arrays, name, (count,)), rate, where)
    check_stamps(stamps, where)
    check_rate(stamps, rate, where)
    return stamps


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
