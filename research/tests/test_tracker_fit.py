"""Measuring trackers: what is simulated is found again, and named trackers are as they say."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from smooth_operator.formats.episode import Episode
from smooth_operator.hands.registry import load_hand
from smooth_operator.landmarks import BASES, TIPS, WRIST
from smooth_operator.retargeting.alignment import reference_landmarks
from smooth_operator.synthetic.tracker import TRACKERS, TrackerModel, TrackerStream
from smooth_operator.teleop.recording import write_episode
from smooth_operator.types import HandRecording
from smooth_operator_research.tracker_fit import (
    fit_clock,
    fit_shake,
    fit_tracker,
    in_palm,
    main,
    pinch_gap,
)

HAND = reference_landmarks(load_hand("mimic_p050"))
BENT = np.array([0.0, 1.0, 2.0, 3.0]) / 3.0


def recorded(model: TrackerModel, seconds: float, sway: float = 0.0005) -> HandRecording:
    """A hand that floats in the room and whose fingers sway slowly, seen through a tracker."""
    ticks = TrackerStream(model).next(round(seconds * model.rate_hz))
    times = ticks.stamps[:, None]
    landmarks = np.repeat(HAND[None], len(times), axis=0)
    for finger, base in enumerate(BASES):
        landmarks[:, base : base + 4, 0] += (
            BENT * sway * np.sin(2 * np.pi * (0.2 + 0.03 * finger) * times)
        )
    landmarks = ticks.shown(landmarks)
    angle = 0.3 * np.sin(0.5 * times[:, 0])
    turn = np.zeros((len(times), 3, 3))
    turn[:, 0, 0] = turn[:, 1, 1] = np.cos(angle)
    turn[:, 0, 1], turn[:, 1, 0], turn[:, 2, 2] = -np.sin(angle), np.sin(angle), 1.0
    landmarks = landmarks @ turn + 0.1 * np.sin(times)[:, :, None]
    return HandRecording(landmarks[ticks.arrives], ticks.stamps[ticks.arrives], "right")


@pytest.mark.parametrize("kind", list(TRACKERS))
def test_the_parameters_of_a_simulated_tracker_are_found_again(kind):
    model = replace(TRACKERS[kind], seed=3, frame_loss=0.02)
    fit = fit_tracker(recorded(model, 4000.0 / model.rate_hz))
    assert fit.clock.rate_hz == pytest.approx(model.rate_hz, rel=0.01)
    assert fit.clock.rate_jitter == pytest.approx(model.rate_jitter, abs=0.01)
    assert fit.clock.frame_loss == pytest.approx(0.02, abs=0.008)
    assert fit.palm < 1e-9  # a rigid palm
    shake = fit.all_tips
    assert shake.windows > 100
    assert shake.shake == pytest.approx(model.shake, rel=0.12)
    assert shake.shake_time == pytest.approx(model.shake_time, rel=0.35)
    assert shake.outliers < 0.001
    assert fit.joints == pytest.approx((1 / 3, 2 / 3), abs=0.03)
    assert abs(fit.together) < 0.05
    assert all(tip.shake == pytest.approx(model.shake, rel=0.3) for tip in fit.tips)


def test_twice_the_shake_is_twice_the_shake_and_none_is_none():
    model = TRACKERS["headset"]
    double = replace(model, shake=2 * model.shake)
    one, two = (fit_tracker(recorded(m, 120.0)).all_tips.shake for m in (model, double))
    assert two == pytest.approx(2 * one, rel=0.15)
    still = fit_tracker(recorded(replace(model, shake=0.0), 60.0)).all_tips
    assert still.shake < 1e-5


def test_a_moving_hand_has_no_shake_to_measure():
    fit = fit_tracker(recorded(TRACKERS["headset"], 20.0, sway=0.3))
    assert fit.all_tips is None
    assert np.isnan(fit.together)
    with pytest.raises(ValueError, match="12 frames or more, not 0"):
        fit_shake([], 0.01)


def test_a_long_absence_is_no_loss_of_frames():
    recording = recorded(TRACKERS["camera"], 20.0)
    kept = np.r_[0:100, 103:200, 260:600]
    clock = fit_clock(HandRecording(recording.landmarks[kept], recording.stamps[kept], "right"))
    assert clock.frame_loss == pytest.approx(3 / (3 + len(kept)))
    assert clock.frame_loss_burst == pytest.approx(0.1)


def test_the_palm_stays_rigid_and_fingers_shake_as_their_joints_would():
    model = replace(TRACKERS["camera"], pinch_gaps=(0.0,) * 4)
    ticks = TrackerStream(model).next(4000)
    shown = ticks.shown(np.repeat(HAND[None], 4000, axis=0)) - HAND
    assert np.abs(shown[:, [WRIST, *BASES]]).max() < 1e-12
    tips = shown[:, TIPS]
    assert tips.std(axis=(0, 2)) == pytest.approx(model.shake, rel=0.06)
    for share, joint in ((1 / 3, 2), (2 / 3, 1)):
        np.testing.assert_allclose(shown[:, np.array(TIPS) - joint], share * tips, atol=1e-12)
    keep = (tips[1:] * tips[:-1]).mean() / (tips**2).mean()
    assert keep == pytest.approx(np.exp(-1 / model.rate_hz / model.shake_time), abs=0.02)


def test_thumb_and_finger_never_seem_nearer_than_the_gap():
    model = replace(TRACKERS["camera"], shake=0.0)
    palm = np.linalg.norm(HAND[BASES[2]] - HAND[WRIST])
    frames = np.repeat(HAND[None], 4, axis=0)
    for row, (tip, apart) in enumerate(zip(TIPS[1:], (0.0001, 0.01, 0.05, 0.2), strict=True)):
        frames[row, tip] = frames[row, TIPS[0]] + [0.0, apart, 0.0]
    shown = TrackerStream(model).next(4).shown(frames)
    for row, (tip, gap) in enumerate(zip(TIPS[1:], model.pinch_gaps, strict=True)):
        before, after = (np.linalg.norm(x[row, tip] - x[row, TIPS[0]]) for x in (frames, shown))
        assert after == pytest.approx(np.cbrt(before**3 + (gap * palm) ** 3))
    recording = HandRecording(shown, np.arange(4) / 30.0, "right")
    assert pinch_gap(recording, "index", slice(0, 1)) == pytest.approx(0.295, abs=1e-4)


def test_the_palms_frame_follows_the_palm_and_skips_unseen_frames():
    recording = recorded(TRACKERS["glove"], 2.0)
    landmarks = recording.landmarks.copy()
    landmarks[7] = np.nan
    points, residual = in_palm(landmarks)
    assert np.isnan(points[7]).all()
    assert np.isnan(residual[7]).all()
    assert np.ptp(np.delete(points, 7, axis=0)[:, WRIST], axis=0).max() < 1e-9


def test_the_command_prints_tables(tmp_path: Path, capsys):
    file = tmp_path / "camera.npz"
    write_episode(file, Episode(recorded(TRACKERS["camera"], 20.0)))
    main([str(file), "--contacts", "index=3:5"])
    text = capsys.readouterr().out
    assert "| camera | 30 | " in text
    assert "index: thumb and tip" in text
