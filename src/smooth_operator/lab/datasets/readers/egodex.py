"""Clips of EgoDex: both hands, the camera and the task from one HDF5 file, and its video.

Source: the README and ``visualize_2d.py`` of apple/ml-egodex; the paper, arXiv 2505.11709.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np

from smooth_operator.episode_files.egodex import (
    RATE_HZ,
    egodex_camera,
    egodex_confidences,
    egodex_hand,
)
from smooth_operator.episode_files.hdf5_tree import EGODEX_JOINTS, Hdf5Group, read_tree
from smooth_operator.errors import MissingExtraError, RecordingError
from smooth_operator.lab.datasets.clip import SIDES, Clip
from smooth_operator.lab.datasets.readers.both_hands import checked_hands, first_video, shares
from smooth_operator.lab.datasets.registry import ClipRef, ReadingOptions

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
                side: shares(np.nanmean(sure, axis=1))
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
