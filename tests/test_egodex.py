"""Files of EgoDex: both hands as 4 x 4 transforms in ARKit's world, written by another way."""

import numpy as np
import pytest
from dataset_files import egodex_file, hand

from smooth_operator import poses, read_recording
from smooth_operator.errors import RecordingError

pytest.importorskip("h5py", reason="needs the extra hdf5")


@pytest.mark.parametrize("side", ["right", "left"])
def test_a_hand_and_its_wrist_come_in_our_axes(tmp_path, side):
    egodex_file(tmp_path / "0.hdf5")
    read = read_recording(tmp_path / "0.hdf5", rate=30, side=side)
    sent = hand(side)
    np.testing.assert_allclose(read.landmarks, sent.points, atol=1e-6)
    np.testing.assert_allclose(read.T_world_wrist[:, :3], sent.wrist[:, :3], atol=1e-6)
    assert poses.separation(read.T_world_wrist, sent.wrist)[:, 1].max() < 1e-3
    found = poses.wrist_from_landmarks(read.landmarks, side)
    assert poses.separation(read.T_world_wrist, found)[:, 1].max() < 0.06
    np.testing.assert_allclose(read.forearm, np.tile([1.0, 0.0, 0.0], (len(read), 1)), atol=1e-3)
    assert read.world == "egodex"
    assert read.meta["format"] == "egodex"
    assert read.metacarpals is not None
    assert read.rate_hz == pytest.approx(30.0)


def test_what_arkit_did_not_see_is_not_valid(tmp_path):
    egodex_file(tmp_path / "0.hdf5", confidence=0.0)
    read = read_recording(tmp_path / "0.hdf5", rate=30, side="right")
    assert np.flatnonzero(~read.valid.any(axis=1)).tolist() == [3]
    assert np.flatnonzero(~poses.is_valid(read.T_world_wrist)).tolist() == [3]


def test_a_file_needs_a_rate_and_all_joints(tmp_path):
    egodex_file(tmp_path / "0.hdf5", left_out=["rightRingFingerTip"])
    with pytest.raises(RecordingError, match="rate"):
        read_recording(tmp_path / "0.hdf5", side="left")
    with pytest.raises(RecordingError, match="transforms/rightRingFingerTip"):
        read_recording(tmp_path / "0.hdf5", rate=30)
