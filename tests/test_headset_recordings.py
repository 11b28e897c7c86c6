"""Recordings of headset apps, written by encoders of their own and read as any other."""

import json
from collections.abc import Iterator
from typing import Any

import headset_apps as app
import numpy as np
import pytest

from smooth_operator.errors import RecordingError
from smooth_operator.formats.checks import reading_notes
from smooth_operator.formats.readers import read_recording
from smooth_operator.poses import separation
from smooth_operator.types import HandRecording, Side

FRAMES = 12
JOINTS: dict[Side, np.ndarray] = {"right": app.hand("right"), "left": app.hand("left")}


def pose(k: int) -> app.Pose:
    return (0.4 + 0.01 * k, -0.3, 1.1, 0.6, -0.48, 0.384, 0.512)


def avp_lines(sides: tuple[Side, ...] = ("right", "left")) -> Iterator[str]:
    for k in range(FRAMES):
        line: dict[str, Any] = {"videoWidth": 0, "timestamp": k / 60, "systemTime": 1.7e9 + k / 60}
        line["headMatrix"] = np.eye(4).ravel().tolist()
        for side, key in (("left", "leftHand"), ("right", "rightHand")):
            wrist, joints = app.arkit_wrist(side, pose(k)), app.arkit_joints(side, JOINTS[side])
            if side not in sides:
                wrist, joints = np.eye(4), np.stack([np.eye(4)] * 27)
            line[key] = app.avp_jsonl_hand(wrist, joints)
        yield json.dumps(line, separators=(",", ":"))


def hts_lines(stamped: bool, sides: tuple[Side, ...] = ("right",)) -> Iterator[bytes]:
    for k in range(FRAMES):
        meta = f" | f = {k} | t = {10**9 + 14_000_000 * k}" if stamped else ""
        for side in sides:
            yield app.hts_packet(side, pose(k), app.landmarks(JOINTS[side]), meta)
        yield b"Head pose:, 0, 1.5, 0, 0, 0, 0, 1"


def check(found: HandRecording, tolerance: float, world: str) -> None:
    points = app.landmarks(JOINTS[found.side])
    assert len(found) == FRAMES
    np.testing.assert_allclose(found.landmarks, np.tile(points, (FRAMES, 1, 1)), atol=tolerance)
    assert found.world == world
    apart = separation(found.T_world_wrist, np.array([pose(k) for k in range(FRAMES)]))
    assert (apart < [2 * tolerance, 50 * tolerance]).all()
    assert not found.meta.get("side_assumed")


def test_a_recording_of_tracking_streamer(tmp_path):
    path = tmp_path / "tracking.jsonl"
    path.write_text("\n".join(avp_lines()) + "\n")
    for side in ("right", "left"):
        found = read_recording(path, side=side)
        assert (found.side, found.meta["format"]) == (side, "avp")
        check(found, 1e-7, "avp")
        np.testing.assert_allclose(found.stamps, np.arange(FRAMES) / 60)
        assert found.metacarpals is not None
    with pytest.raises(RecordingError, match="both hands; choose one with --side right"):
        read_recording(path)
    path.write_text("\n".join(avp_lines(("left",))))
    assert read_recording(path).side == "left"  # the right one was never seen
    with pytest.raises(RecordingError, match="contains no right hand"):
        read_recording(path, side="right")


def test_what_was_not_new_or_is_damaged_is_left_out(tmp_path):
    lines = list(avp_lines(("right",)))
    stale = json.loads(lines[-1])
    lines += [json.dumps({**stale, "timestamp": 5.0 + k}) for k in range(3)]  # the hand is lost
    lines += ["[1]", lines[-1][: len(lines[-1]) // 2]]
    path = tmp_path / "tracking.jsonl"
    path.write_text("\n".join(lines))
    found = read_recording(path)
    check(found, 1e-7, "avp")
    assert (found.meta["repeated_frames"], found.meta["damaged_lines"]) == (3, 2)
    assert "2 lines are damaged" in reading_notes(found, "x")[0]


@pytest.mark.parametrize("joined", [False, True])
def test_a_recording_of_hts_lines(tmp_path, joined):
    path = tmp_path / "hand.hts"
    path.write_bytes((b"" if joined else b"\n").join(hts_lines(True)))
    found = read_recording(path)
    check(found, 1e-4, "hts")
    np.testing.assert_allclose(found.stamps, 1.0 + 0.014 * np.arange(FRAMES))
    path.write_bytes(b"\n".join(hts_lines(False, ("left", "right"))))
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
