"""Recordings of headset apps, written by encoders of their own and read as any other."""

import json

import dataset_files as files
import headset_apps as app
import numpy as np
import pytest

from smooth_operator.errors import RecordingError
from smooth_operator.formats.checks import reading_notes
from smooth_operator.formats.readers import read_recording
from smooth_operator.poses import matrices, separation
from smooth_operator.types import HandRecording

COUNT = 30


def check(found: HandRecording, tolerance: float, world: str) -> None:
    """The landmarks in the wrist's frame, and the wrist in the world."""
    sent = files.hand(found.side)
    reaches = sent.points - sent.points[:, :1]
    points = np.einsum("tni,tij->tnj", reaches, matrices(sent.wrist)[:, :3, :3])
    np.testing.assert_allclose(found.landmarks, points, atol=tolerance)
    assert found.world == world
    apart = separation(found.T_world_wrist, sent.wrist)
    assert (apart < [2 * tolerance, 50 * tolerance]).all()
    assert not found.meta.get("side_assumed")


def test_a_recording_of_tracking_streamer(tmp_path):
    path = tmp_path / "tracking.jsonl"
    files.avp_file(path)
    for side in ("right", "left"):
        found = read_recording(path, side=side)
        assert (found.side, found.meta["format"]) == (side, "avp")
        check(found, 1e-6, "avp")
        np.testing.assert_allclose(found.stamps, np.arange(COUNT) / 30)
        assert found.metacarpals is not None
    with pytest.raises(RecordingError, match="both hands; choose one with --side right"):
        read_recording(path)
    files.avp_file(path, sides=["left"])
    assert read_recording(path).side == "left"  # the right one was never seen
    with pytest.raises(RecordingError, match="contains no right hand"):
        read_recording(path, side="right")


def test_what_was_not_new_or_is_damaged_is_left_out(tmp_path):
    path = tmp_path / "tracking.jsonl"
    files.avp_file(path, sides=["right"])
    lines = path.read_text().splitlines()
    stale = json.loads(lines[-1])
    lines += [json.dumps({**stale, "timestamp": 5.0 + k}) for k in range(3)]  # the hand is lost
    lines += ["[1]", lines[-1][: len(lines[-1]) // 2]]
    path.write_text("\n".join(lines))
    found = read_recording(path)
    check(found, 1e-6, "avp")
    assert (found.meta["repeated_frames"], found.meta["damaged_lines"]) == (3, 2)
    assert "2 lines are damaged" in reading_notes(found, "x")[0]


@pytest.mark.parametrize("joined", [False, True])
def test_a_recording_of_hts_lines(tmp_path, joined):
    path = tmp_path / "hand.hts"
    files.hts_file(path, sides=["right"], between=b"" if joined else b"\n")
    found = read_recording(path)
    check(found, 1e-4, "hts")
    np.testing.assert_allclose(found.stamps, 1.0 + np.arange(COUNT) / 30, atol=1e-6)
    files.hts_file(path, stamped=False)
    with pytest.raises(RecordingError, match="both hands"):
        read_recording(path, rate=70)
    with pytest.raises(RecordingError, match="--rate 100"):
        read_recording(path, side="left")
    found = read_recording(path, rate=70, side="left")
    check(found, 1e-4, "hts")
    assert found.rate_hz == pytest.approx(70)


def test_a_small_file_of_many_frames_does_not_fill_the_memory(tmp_path, monkeypatch):
    monkeypatch.setattr("smooth_operator.formats.arrays.FREE_BYTES", 1 << 16)
    path = tmp_path / "tracking.jsonl"
    tip = app.transform(np.eye(3), np.array([0.1, 0.0, 0.0])).T.ravel().tolist()
    lines = []
    for k in range(60):  # hands of one joint that moves
        tip[13] = 0.01 * k
        lines.append(json.dumps({"timestamp": k / 60, "leftHand": {"thumbTip": tip}}))
    path.write_text("\n".join(lines))
    with pytest.raises(RecordingError, match="reading 'left' would take"):
        read_recording(path)
