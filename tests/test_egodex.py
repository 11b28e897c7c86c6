"""Files of EgoDex: both hands as 4 x 4 transforms in ARKit's world, written here by another way."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from smooth_operator import poses, read_recording
from smooth_operator.errors import RecordingError
from smooth_operator.landmarks import FROM_WEBXR_25, METACARPALS_WEBXR_25
from smooth_operator.synthetic import SyntheticOperator, WristMotion
from smooth_operator.types import HandRecording, Side

h5py = pytest.importorskip("h5py", reason="needs the extra hdf5")

ORDER = ["Hand"] + ["Thumb" + bone for bone in ("Knuckle", "IntermediateBase")]
ORDER += ["ThumbIntermediateTip", "ThumbTip"]
for finger in ("Index", "Middle", "Ring", "Little"):
    ORDER += [f"{finger}FingerMetacarpal", f"{finger}FingerKnuckle"]
    ORDER += [f"{finger}FingerIntermediateBase", f"{finger}FingerIntermediateTip"]
    ORDER += [f"{finger}FingerTip"]


def operator(side: Side) -> HandRecording:
    motion = WristMotion(0.1, 0.4, seed=3)
    return SyntheticOperator(seed=1, side=side, wrist=motion, rate_hz=30.0).record(1.0)


def write(path: Path, confidence: float = 1.0, **left_out: Any) -> dict[Side, np.ndarray]:
    """A file of both hands; the landmarks of each in our world."""
    worlds: dict[Side, np.ndarray] = {}
    with h5py.File(path, "w") as file:
        for side in ("right", "left"):
            hand = operator(side)
            # The operator's x is palmar, y radial of the right hand, z distal: palm down, ahead.
            ours = np.stack([hand.landmarks[..., 2], hand.landmarks[..., 1]], -1)
            ours = np.concatenate([ours, -hand.landmarks[..., :1]], axis=-1)
            worlds[side] = ours
            nodes = np.zeros((len(hand), 25, 3))
            nodes[:, FROM_WEBXR_25] = ours
            nodes[:, METACARPALS_WEBXR_25] = hand.metacarpals[..., [2, 1, 0]] * (1, 1, -1)
            # ARKit: x to the right, y up, z to the viewer.
            arkit = np.stack([-nodes[..., 1], nodes[..., 2], -nodes[..., 0]], axis=-1)
            wrist = poses.rotation_matrices(hand.T_world_wrist[:, 3:])
            turn = np.array([[0, -1.0, 0], [0, 0, 1], [-1, 0, 0]]) @ wrist  # of our wrist axes
            fingers, thumb, back = np.moveaxis(turn, -1, 0)
            # the right hand's x points to the forearm, y out of the back; the left hand's x to the
            # fingers, y out of the palm; z completes both
            x, y = (-fingers, back) if side == "right" else (fingers, -back)
            assert np.allclose(np.cross(x, y), thumb)  # for both
            for k, name in enumerate(ORDER):
                joint = np.tile(np.eye(4), (len(hand), 1, 1))
                joint[:, :3, 3] = arkit[:, k]
                joint[:, :3, 0], joint[:, :3, 1], joint[:, :3, 2] = x, y, np.cross(x, y)
                if side + name != left_out.get("joint"):
                    file[f"transforms/{side}{name}"] = joint.astype(np.float32)
                seen = np.ones(len(hand), np.float32)
                seen[3] = confidence
                file[f"confidences/{side}{name}"] = seen
        file["transforms/camera"] = np.tile(np.eye(4), (len(hand), 1, 1))
        file["camera/intrinsic"] = np.eye(3)
    return worlds


@pytest.mark.parametrize("side", ["right", "left"])
def test_a_hand_and_its_wrist_come_in_our_axes(tmp_path: Path, side: Side) -> None:
    worlds = write(tmp_path / "0.hdf5")
    read = read_recording(tmp_path / "0.hdf5", rate=30, side=side)
    np.testing.assert_allclose(read.landmarks, worlds[side], atol=1e-6)
    sent = operator(side)
    np.testing.assert_allclose(read.T_world_wrist[:, :3], sent.T_world_wrist[:, :3], atol=1e-6)
    assert poses.separation(read.T_world_wrist, sent.T_world_wrist)[:, 1].max() < 1e-3
    found = poses.wrist_from_landmarks(read.landmarks, side)
    assert poses.separation(read.T_world_wrist, found)[:, 1].max() < 0.06
    assert read.world == "egodex"
    assert read.meta["format"] == "egodex"
    assert read.metacarpals is not None
    assert read.rate_hz == pytest.approx(30.0)


def test_what_arkit_did_not_see_is_not_valid(tmp_path: Path) -> None:
    write(tmp_path / "0.hdf5", confidence=0.0)
    read = read_recording(tmp_path / "0.hdf5", rate=30, side="right")
    assert read.valid is not None
    assert np.flatnonzero(~read.valid.any(axis=1)).tolist() == [3]
    assert np.flatnonzero(~poses.is_valid(read.T_world_wrist)).tolist() == [3]


def test_a_file_needs_a_rate_and_all_joints(tmp_path: Path) -> None:
    write(tmp_path / "0.hdf5", joint="rightRingFingerTip")
    with pytest.raises(RecordingError, match="rate"):
        read_recording(tmp_path / "0.hdf5", side="left")
    with pytest.raises(RecordingError, match="transforms/rightRingFingerTip"):
        read_recording(tmp_path / "0.hdf5", rate=30)
