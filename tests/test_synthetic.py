"""The synthetic operator: anatomy, motion, pinches, tracker imperfections, and its form."""

import itertools
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from smooth_operator.errors import ConfigError, UnknownNameError
from smooth_operator.landmarks import (
    BASES,
    BONES,
    FROM_MANUS_25,
    METACARPALS_MANUS_25,
    TIPS,
)
from smooth_operator.retargeting.flat_hand import FLAT_HAND
from smooth_operator.synthetic import (
    GESTURES,
    TRACKERS,
    SyntheticOperator,
    TrackerModel,
    WristMotion,
)
from smooth_operator.synthetic.gestures import FREE_LOWER, FREE_UPPER, Programme, pinch_postures
from smooth_operator.synthetic.hand_anatomy import (
    JOINTS,
    LOWER,
    UPPER,
    couple,
    draw_anatomy,
    pose_hand,
)
from smooth_operator.types import HandRecording

PINCHES = GESTURES[1:5]
SMALL = 1e-12


@pytest.fixture(scope="module")
def recording() -> HandRecording:
    return SyntheticOperator(seed=3).record(40.0)


def bone_lengths(landmarks: np.ndarray) -> np.ndarray:
    parents, children = np.array(BONES).T
    return np.linalg.norm(landmarks[:, children] - landmarks[:, parents], axis=-1)


def rotate(quaternion: np.ndarray, vector: np.ndarray) -> np.ndarray:
    w, v = quaternion[..., :1], quaternion[..., 1:]
    turn = 2.0 * np.cross(v, np.broadcast_to(vector, v.shape))
    return vector + w * turn + np.cross(v, turn)


def tip_gaps(landmarks: np.ndarray) -> np.ndarray:
    return np.linalg.norm(landmarks[:, TIPS[1:]] - landmarks[:, [TIPS[0]]], axis=-1)


@pytest.mark.parametrize("seed", [0, 7, 123])
def test_bones_are_rigid_and_scale_with_the_hand(seed):
    lengths = {}
    for hand_length in (0.15, 0.19, 0.22):
        recorded = SyntheticOperator(seed=seed, hand_length=hand_length).record(6.0)
        bones = bone_lengths(recorded.landmarks)
        assert np.ptp(bones, axis=0).max() < SMALL
        assert 0.05 < np.linalg.norm(recorded.landmarks[0, 9]) < 0.14  # the readers' unit check
        lengths[hand_length] = bones[0] / hand_length
    np.testing.assert_allclose(lengths[0.15], lengths[0.22], rtol=1e-12)
    np.testing.assert_allclose(lengths[0.19], lengths[0.22], rtol=1e-12)
    # Bones 8 .. 11 go from the wrist to the middle fingertip.
    assert lengths[0.19][8:12].sum() == pytest.approx(1.0)


def test_proportions_are_the_published_ones_within_a_few_percent():
    # Buryanov & Kotiuk 2010, [mm]: proximal, middle, distal + tip of index, middle, ring, pinky.
    published = np.array(
        [[39.78, 22.38, 19.66], [44.63, 26.33, 21.35], [41.37, 25.65, 21.25], [32.74, 18.11, 19.69]]
    )
    people = [SyntheticOperator(seed=seed).anatomy for seed in range(40)]
    hands = np.concatenate([pose_hand(person, np.zeros((1, 20))).landmarks for person in people])
    drawn = bone_lengths(hands).reshape(40, 5, 4)
    fingers = drawn[:, 1:, 1:]
    ratio = fingers / fingers.mean((1, 2), keepdims=True) / (published / published.mean())
    assert np.abs(ratio.mean(0) - 1.0).max() < 0.02
    assert 0.01 < ratio.std(0).mean() < 0.03
    wrist_to_middle = drawn[:, 2, 0]
    assert 0.085 < wrist_to_middle.min() < wrist_to_middle.max() < 0.10


def test_joints_stay_in_their_ranges_and_dips_follow(recording):
    angles = recording.meta["joint_angles"]
    assert angles.shape == (len(recording), len(JOINTS)) == (len(recording), 20)
    assert (angles >= LOWER - SMALL).all()
    assert (angles <= UPPER + SMALL).all()
    names = recording.meta["joint_names"]
    for finger in ("index", "middle", "ring", "pinky"):
        pip, dip = names.index(f"{finger}_pip"), names.index(f"{finger}_dip")
        np.testing.assert_allclose(angles[:, dip], angles[:, pip] * 2.0 / 3.0)
        assert np.ptp(angles[:, pip]) > np.deg2rad(70.0)  # the programme uses the range


def test_frames_are_what_the_joint_angles_say(recording):
    operator = SyntheticOperator(seed=3)
    poses = pose_hand(operator.anatomy, recording.meta["joint_angles"])
    np.testing.assert_array_equal(poses.landmarks, recording.landmarks)
    # Angles read off the bones, not through the model's own formulas.
    for k, base in enumerate((5, 9, 13, 17)):
        bones = np.diff(recording.landmarks[:, base : base + 4], axis=1)
        bones /= np.linalg.norm(bones, axis=-1, keepdims=True)
        bend = np.arccos(np.clip((bones[:, :-1] * bones[:, 1:]).sum(-1), -1.0, 1.0))
        measured = recording.meta["joint_angles"][:, 6 + 4 * k : 8 + 4 * k]
        np.testing.assert_allclose(bend, measured, atol=1e-6)


def test_flexion_is_towards_the_palm_and_the_thumb_is_radial():
    angles = np.zeros((3, 20))
    angles[1, [5, 9, 13, 17]] = np.deg2rad(60.0)
    angles[2, [4, 8, 12, 16]] = np.deg2rad(15.0)
    straight, bent, radial = pose_hand(SyntheticOperator().anatomy, angles).landmarks
    tips = list(TIPS[1:])
    assert (bent[tips, 0] - straight[tips, 0] > 0.03).all()  # x is palmar
    assert (radial[tips, 1] - straight[tips, 1] > 0.01).all()  # y is towards the thumb
    assert straight[4, 1] > straight[8, 1] > straight[12, 1] > straight[16, 1] > straight[20, 1]


@pytest.mark.parametrize("tracker", [TrackerModel(), TrackerModel(frame_loss=0.1)])
def test_left_mirrors_right_exactly(tracker):
    right = SyntheticOperator(seed=5, side="right", tracker=tracker).record(10.0)
    left = SyntheticOperator(seed=5, side="left", tracker=tracker).record(10.0)
    flip = np.array([1.0, -1.0, 1.0])
    assert (right.side, left.side) == ("right", "left")
    np.testing.assert_array_equal(left.landmarks, right.landmarks * flip)
    np.testing.assert_array_equal(left.metacarpals, right.metacarpals * flip)
    np.testing.assert_array_equal(left.stamps, right.stamps)
    dorsal = np.array([0.0, 0.0, 1.0])
    np.testing.assert_allclose(
        rotate(left.orientations, dorsal), rotate(right.orientations, dorsal) * flip, atol=1e-14
    )


def test_orientations_point_along_the_bones_and_never_jump(recording):
    quaternions = recording.orientations
    np.testing.assert_allclose(np.linalg.norm(quaternions, axis=-1), 1.0)
    assert np.abs(np.diff(quaternions, axis=0)).max() < 0.1  # no sign flips either
    axis = rotate(quaternions, np.array([1.0, 0.0, 0.0]))
    for base in (1, 5, 9, 13, 17):
        bones = np.diff(recording.landmarks[:, base : base + 4], axis=1)
        bones /= np.linalg.norm(bones, axis=-1, keepdims=True)
        np.testing.assert_allclose(axis[:, base : base + 3], bones, atol=1e-12)
        np.testing.assert_array_equal(quaternions[:, base + 3], quaternions[:, base + 2])


def test_digits_do_not_pass_through_one_another(recording):
    # Points along the bones; pinching tips may meet, whole fingers may not.
    share = np.linspace(0.0, 1.0, 6)[:, None]
    digits = []
    for base in (1, 5, 9, 13, 17):
        joints = recording.landmarks[::5, base : base + 4]
        points = joints[:, :-1, None] + share * np.diff(joints, axis=1)[:, :, None]
        digits.append(points.reshape(len(points), -1, 3))
    labels = np.array(recording.meta["gesture"])[::5]
    for a, b in itertools.combinations(range(5), 2):
        apart = np.linalg.norm(digits[a][:, :, None] - digits[b][:, None], axis=-1).min((1, 2))
        if a == 0:
            apart = apart[labels != f"pinch_{('index', 'middle', 'ring', 'pinky')[b - 1]}"]
        assert apart.min() > 0.007


@pytest.mark.parametrize("seed", range(12))
def test_pinching_tips_really_meet_within_the_joint_ranges(seed):
    postures = pinch_postures(seed)
    assert (postures > FREE_LOWER).all()
    assert (postures < FREE_UPPER).all()
    for hand_length in (0.15, 0.22):
        anatomy = SyntheticOperator(seed=seed, hand_length=hand_length).anatomy
        gaps = tip_gaps(pose_hand(anatomy, couple(postures)).landmarks)
        assert (np.diag(gaps) < 0.003).all()
        assert gaps[~np.eye(4, dtype=bool)].min() > 0.02  # and no other tip does


def test_each_pinch_closes_in_motion_and_opens_again(recording):
    gaps, labels = tip_gaps(recording.landmarks), np.array(recording.meta["gesture"])
    for finger, name in enumerate(PINCHES):
        (rows,) = np.nonzero(labels == name)
        runs = np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1)
        assert runs
        for run in runs[:-1] or runs:  # the last may be cut off by the recording's end
            gap = gaps[run, finger]
            assert gap.min() < 0.003
            assert (gap < 0.003).sum() > 20  # held, not brushed
            assert min(gap[0], gap[-1]) > 0.03
            closing = gap[: gap.argmin()]
            assert np.diff(closing).max() < 2e-4  # never away again on the way
    assert gaps[~np.isin(labels, PINCHES)].min() > 0.01


@pytest.mark.parametrize(("max_jerk", "speed"), [(500.0, 1.0), (150.0, 1.0), (2000.0, 2.0)])
def test_jerk_is_bounded_across_all_joins(max_jerk, speed):
    # A third difference is a mean of the third derivative wherever two derivatives are continuous;
    # a jump in velocity or acceleration at a join would make it grow with the rate.
    rate = 1000.0
    recorded = SyntheticOperator(seed=1, rate_hz=rate, max_jerk=max_jerk, speed=speed).record(30.0)
    jerk = np.diff(recorded.meta["joint_angles"], 3, axis=0) * rate**3
    assert np.abs(jerk).max() <= max_jerk * 1.001
    assert np.abs(jerk).max() > 0.3 * max_jerk
    assert len(set(recorded.meta["gesture"])) == len(GESTURES)


def test_speed_and_jerk_settings_change_the_tempo():
    def first_round(operator: SyntheticOperator) -> float:
        recorded = operator.record(80.0)
        labels = np.array(recorded.meta["gesture"])
        return float(recorded.stamps[np.flatnonzero(labels == "wander")[0]])

    natural = first_round(SyntheticOperator(rate_hz=20))
    assert 12.0 < natural < 20.0
    assert first_round(SyntheticOperator(rate_hz=20, speed=0.5)) == pytest.approx(
        2 * natural, rel=0.1
    )
    assert first_round(SyntheticOperator(rate_hz=20, max_jerk=50.0)) > 1.3 * natural


def test_gestures_can_be_chosen_and_go_on_for_ever_with_new_draws():
    chosen = ("spread", "pinch_ring", "spread")
    recorded = SyntheticOperator(gestures=chosen, rate_hz=50).record(60.0)
    labels = [name for name, _ in itertools.groupby(recorded.meta["gesture"])]
    # The third and the first of the next round are both "spread".
    assert labels[:4] == ["spread", "pinch_ring", "spread", "pinch_ring"]
    assert set(labels) == set(chosen)
    assert len(labels) > 12
    pinching = np.array([name == "pinch_ring" for name in recorded.meta["gesture"]], int)
    (begun,) = np.nonzero(np.diff(pinching) == 1)
    tops = [recorded.meta["joint_angles"][i : i + 60].max(0) for i in begun[:5]]
    assert np.abs(np.diff(np.array(tops), axis=0)).max(1).min() > 1e-3
    assert SyntheticOperator(gestures="wander").gestures == ("wander",)


@pytest.mark.parametrize("gesture", GESTURES)
def test_every_gesture_works_alone(gesture):
    recorded = SyntheticOperator(seed=2, gestures=(gesture,), rate_hz=60, side="left").record(12.0)
    assert set(recorded.meta["gesture"]) == {gesture}
    assert np.ptp(recorded.landmarks[:, TIPS], axis=0).max() > 0.01


def test_wandering_does_not_repeat_or_stand_still():
    recorded = SyntheticOperator(seed=4, gestures=("wander",)).record(20.0)
    free = recorded.meta["joint_angles"]
    moving = np.abs(np.diff(free, axis=0)).max(1) > 1e-5
    assert moving.mean() > 0.95
    fresh = SyntheticOperator(seed=5, gestures=("wander",)).record(20.0).meta["joint_angles"]
    assert np.abs(np.corrcoef(free[:, 6], fresh[:, 6])[0, 1]) < 0.6


def test_same_seed_same_bits_other_seed_other_person():
    noisy = TrackerModel(shake=1e-3, rate_jitter=0.1, frame_loss=0.05, landmark_loss=0.05, seed=9)
    operator = SyntheticOperator(seed=11, tracker=noisy, wrist=WristMotion(0.1, 0.4))
    a, b = operator.record(5.0), replace(operator).record(5.0)
    np.testing.assert_array_equal(a.landmarks, b.landmarks)
    np.testing.assert_array_equal(a.stamps, b.stamps)
    other = SyntheticOperator(seed=12).record(5.0)
    same = SyntheticOperator(seed=11).record(5.0)
    assert np.abs(bone_lengths(other.landmarks)[0] - bone_lengths(same.landmarks)[0]).max() > 5e-4
    assert np.abs(other.meta["joint_angles"] - same.meta["joint_angles"]).max() > 0.05


@pytest.mark.parametrize(
    "tracker",
    [
        TrackerModel(),
        TrackerModel(
            shake=2e-3, shake_time=0.1, rate_jitter=0.2, frame_loss=0.2, landmark_loss=0.1, seed=1
        ),
    ],
)
def test_frames_are_those_of_the_recording(tracker):
    operator = SyntheticOperator(seed=6, side="left", tracker=tracker)
    longer, shorter = operator.record(9.0), operator.record(3.0)
    endless = operator.frames()
    for k, frame in enumerate(itertools.islice(endless, len(longer))):
        np.testing.assert_array_equal(frame.landmarks, longer.landmarks[k])
        np.testing.assert_array_equal(frame.orientations, longer.orientations[k])
        np.testing.assert_array_equal(frame.valid, longer.valid[k])
        assert (frame.stamp, frame.side) == (longer.stamps[k], "left")
    np.testing.assert_array_equal(shorter.landmarks, longer.landmarks[: len(shorter)])
    assert next(endless).stamp > longer.stamps[-1]
    assert sum(1 for _ in operator.frames(3.0)) == len(shorter)


def test_motion_underneath_is_the_same_with_and_without_imperfections():
    clean = SyntheticOperator(seed=8).record(15.0)
    tracker = TrackerModel(shake=2e-3, frame_loss=0.1, landmark_loss=0.1, seed=4)
    real = SyntheticOperator(seed=8, tracker=tracker).record(15.0)
    rows = np.searchsorted(clean.stamps, real.stamps)
    np.testing.assert_array_equal(clean.stamps[rows], real.stamps)
    np.testing.assert_array_equal(clean.meta["joint_angles"][rows], real.meta["joint_angles"])
    assert [clean.meta["gesture"][k] for k in rows] == real.meta["gesture"]
    error = (real.landmarks - clean.landmarks[rows])[real.valid]
    assert np.abs(error).max() < 2e-3 * 6
    # Another tracker seed: same motion, other noise.
    again = SyntheticOperator(seed=8, tracker=replace(tracker, seed=5)).record(15.0)
    assert len(again) != len(real) or not np.array_equal(again.valid, real.valid)


@pytest.mark.parametrize("shake_time", [0.0, 0.1])
def test_shake_has_the_standard_deviation_and_correlation_asked_for(shake_time):
    clean = SyntheticOperator(seed=1).record(40.0)
    noisy = SyntheticOperator(
        seed=1, tracker=TrackerModel(shake=1.5e-3, shake_time=shake_time)
    ).record(40.0)
    np.testing.assert_array_equal(noisy.metacarpals, clean.metacarpals)
    np.testing.assert_array_equal(noisy.landmarks[:, [0, *BASES]], clean.landmarks[:, [0, *BASES]])
    noise = (noisy.landmarks - clean.landmarks)[:, TIPS]
    assert noise.std() == pytest.approx(1.5e-3, rel=0.03)
    assert noise[0].std() == pytest.approx(1.5e-3, rel=0.3)  # from the first frame on
    assert abs(noise.mean()) < 2e-5
    for lag in (1, 10):
        measured = (noise[lag:] * noise[:-lag]).mean() / noise.var()
        expected = np.exp(-lag * 0.01 / shake_time) if shake_time else 0.0
        assert measured == pytest.approx(expected, abs=0.03)


def test_a_named_tracker_has_its_rate_and_shows_the_hand_late():
    tracker = replace(TRACKERS["headset"], shake=0.0, rate_jitter=0.0)
    seen, true = (
        SyntheticOperator(seed=1, tracker=one).record(10.0)
        for one in (tracker, TrackerModel(rate_hz=1000.0))
    )
    assert seen.rate_hz == pytest.approx(30.0)
    at = np.round((seen.stamps - tracker.delay) * 1000).astype(int)
    late = np.abs(seen.landmarks - true.landmarks[np.maximum(at, 0)]).max()
    assert late < 3e-4  # half a millisecond of motion
    now = np.abs(seen.landmarks - true.landmarks[np.round(seen.stamps * 1000).astype(int)]).max()
    assert now > 5e-3
    faster = SyntheticOperator(seed=1, rate_hz=60.0, tracker=tracker).record(2.0)
    assert faster.rate_hz == pytest.approx(60.0)


@pytest.mark.parametrize("jitter", [0.05, 0.45])
def test_stamps_jitter_and_still_increase(jitter):
    even = SyntheticOperator(rate_hz=120).record(20.0)
    np.testing.assert_allclose(even.stamps, np.arange(2400) / 120.0, atol=1e-12)
    recorded = SyntheticOperator(
        rate_hz=120, tracker=TrackerModel(rate_jitter=jitter, frame_loss=0.1)
    ).record(20.0)
    steps = np.diff(recorded.stamps)
    assert (steps > 0.05 / 120).all()
    off = recorded.stamps * 120 - np.round(recorded.stamps * 120)
    assert off.std() == pytest.approx(jitter if jitter < 0.1 else 0.3, rel=0.2)
    assert recorded.rate_hz == pytest.approx(120, rel=0.05)
    # The hand is seen at its stamp, not at the even tick.
    angles = Programme(0, GESTURES, 1.0, 500.0).at(recorded.stamps)[0]
    np.testing.assert_allclose(couple(angles), recorded.meta["joint_angles"], atol=1e-11)


def test_lost_frames_have_the_share_and_bursts_asked_for():
    tracker = TrackerModel(frame_loss=0.2, frame_loss_burst=0.05, seed=2)
    recorded = SyntheticOperator(gestures=("spread",), tracker=tracker).record(300.0)
    assert len(recorded) / 30_000 == pytest.approx(0.8, abs=0.02)
    gaps = np.round(np.diff(recorded.stamps) * 100).astype(int) - 1
    assert gaps[gaps > 0].mean() == pytest.approx(5.0, rel=0.1)
    assert recorded.stamps[0] == 0.0


def test_lost_landmarks_are_nan_and_invalid_in_bursts():
    tracker = TrackerModel(landmark_loss=0.15, landmark_loss_burst=0.1, seed=3)
    recorded = SyntheticOperator(gestures=("gait",), tracker=tracker).record(100.0)
    lost = ~recorded.valid
    assert lost.mean() == pytest.approx(0.15, abs=0.015)
    np.testing.assert_array_equal(np.isnan(recorded.landmarks), np.repeat(lost[..., None], 3, -1))
    np.testing.assert_array_equal(np.isnan(recorded.orientations).any(-1), lost)
    begun = np.diff(lost.astype(int), axis=0) == 1
    assert lost.sum() / begun.sum() == pytest.approx(10.0, rel=0.1)
    # Landmarks come and go on their own.
    assert np.abs(np.corrcoef(lost.T.astype(float))[np.triu_indices(21, 1)]).max() < 0.2
    frame = recorded[int(np.flatnonzero(lost.any(1))[0])]
    assert not frame.valid.all()


def test_wrist_motion_carries_the_hand_rigidly():
    still = SyntheticOperator(seed=2, side="left").record(60.0)
    moved = SyntheticOperator(seed=2, side="left", wrist=WristMotion(0.1, 0.5, seed=1)).record(60.0)
    np.testing.assert_allclose(
        bone_lengths(moved.landmarks), bone_lengths(still.landmarks), atol=1e-12
    )
    wrist = moved.landmarks[:, 0]
    assert wrist.std() == pytest.approx(0.1, rel=0.4)
    assert np.linalg.norm(np.diff(wrist, axis=0), axis=-1).max() * 100 < 1.5
    # A point in the wrist's own frame is where it was.
    for name in ("landmarks", "metacarpals"):
        np.testing.assert_allclose(in_wrist(moved, name), in_wrist(still, name), atol=1e-12)


def in_wrist(recorded: HandRecording, name: str) -> np.ndarray:
    inverse = recorded.orientations[:, :1] * np.array([1.0, -1.0, -1.0, -1.0])
    points = getattr(recorded, name) - recorded.landmarks[:, :1]
    return rotate(np.broadcast_to(inverse, (*points.shape[:2], 4)), points)


def test_metacarpals_lie_between_the_wrist_and_their_knuckles(recording):
    assert recording.valid.all()
    np.testing.assert_array_equal(recording.landmarks[:, 0], 0.0)
    knuckles = np.linalg.norm(recording.landmarks[:, [5, 9, 13, 17]], axis=-1)
    assert (np.linalg.norm(recording.metacarpals, axis=-1) < 0.4 * knuckles).all()
    assert recording.name == "synthetic-right-3"


@pytest.mark.shared
def test_palm_and_pinches_resemble_a_real_glove(shared, recording):
    path = shared / "recordings" / "manus_right_subject-000_run-010.npz"
    with np.load(path, allow_pickle=False) as file:
        data = file["data"].astype(float)
    glove = data[:, FROM_MANUS_25, :3]
    palm = [0, 1, 5, 9, 13, 17]

    def fit(ours: np.ndarray, theirs: np.ndarray) -> tuple[float, np.ndarray]:
        a, b = ours - ours.mean(0), theirs - theirs.mean(0)
        u, s, vt = np.linalg.svd(b.T @ a)
        sign = np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))])
        scale = float((s * np.diag(sign)).sum() / (a**2).sum())
        return scale, np.linalg.norm(scale * a @ (u @ sign @ vt).T - b, axis=-1)

    scale, residual = fit(recording.landmarks[0, palm], glove[0, palm])
    assert scale == pytest.approx(1.07, abs=0.08)  # that operator's hand is larger
    assert residual.max() < 0.005
    bases = np.concatenate([data[0, :1, :3], data[0, METACARPALS_MANUS_25, :3]])
    ours = np.concatenate([recording.landmarks[0, :1], recording.metacarpals[0]])
    assert fit(ours, bases)[1].max() < 0.006
    # The hand's own frame is turned as the glove's: x distal, z dorsal in both.
    for source, landmarks in ((data[0, 0, 3:], glove[0]), (None, recording.landmarks[0])):
        quaternion = recording.orientations[0, 0] if source is None else source
        distal = landmarks[9] - landmarks[0]
        assert rotate(quaternion, np.array([1.0, 0, 0])) @ distal / np.linalg.norm(distal) > 0.95
    # Whole pinching hands, each at the glove's closest frame.
    for finger, posture in enumerate(pinch_postures(3)):
        closest = glove[tip_gaps(glove)[:, finger].argmin()]
        pinch = pose_hand(SyntheticOperator(seed=3).anatomy, couple(posture[None])).landmarks[0]
        chains = [*palm, 2, 3, 4, *range(6 + 4 * finger, 9 + 4 * finger)]
        assert fit(pinch[chains], closest[chains])[1].mean() < 0.015


BAD = {
    SyntheticOperator: [
        ({"seed": 1.5}, "seed must be a whole number"),
        ({"side": "both"}, "side must be"),
        ({"hand_length": 190.0}, "hand_length must be 0.12 to 0.25 m, not 190"),
        ({"rate_hz": 0.0}, "rate_hz must be 1 to 10000 Hz"),
        ({"speed": 0.0}, "speed"),
        ({"max_jerk": -5.0}, "max_jerk"),
        ({"gestures": ()}, "gestures must name"),
        ({"gestures": ("pinch_indx",)}, "Did you mean 'pinch_index'"),
    ],
    TrackerModel: [
        ({"shake": 2.0}, "tracker shake must be 0 to 0.05 m"),
        ({"shake_time": float("inf")}, "shake_time must be 0 to 1e\\+09 s, not inf"),
        ({"pinch_gaps": (0.1, 0.1, 0.1, 2.0)}, "pinch_gaps must be 0 to 1 palm lengths"),
        ({"rate_hz": 0.0}, "tracker rate_hz must be 1 to 10000 Hz"),
        ({"delay": -0.1}, "tracker delay must be 0 to 1 s"),
        ({"rate_jitter": 0.6}, "rate_jitter must be 0 to 0.45"),
        ({"frame_loss": 1.0}, "frame_loss must be 0 to 0.9"),
        ({"landmark_loss": float("nan")}, "landmark_loss"),
        ({"landmark_loss_burst": -1.0}, "landmark_loss_burst must be 0 to 1e\\+09 s"),
        ({"seed": "a"}, "tracker seed"),
    ],
    WristMotion: [({"rotation": 90.0}, r"wrist rotation must be 0 to 1\.5 rad")],
}


@pytest.mark.parametrize(
    ("kind", "settings", "said"), [(kind, *case) for kind, cases in BAD.items() for case in cases]
)
def test_bad_settings_are_refused(kind, settings, said):
    with pytest.raises((ConfigError, UnknownNameError), match=said):
        kind(**settings)


def test_impossible_durations_are_refused():
    for duration in (0.0, -1.0, float("nan"), float("inf")):
        with pytest.raises(ConfigError, match="duration must be finite"):
            SyntheticOperator().record(duration)
        with pytest.raises(ConfigError, match="duration must be finite"):
            SyntheticOperator().frames(duration)
    assert len(SyntheticOperator(rate_hz=30).record(1 / 30)) == 1


def test_no_heavy_import():
    code = (
        "import sys; from smooth_operator.synthetic import SyntheticOperator as S; S().record(1.0);"
        "print([m for m in ('jax', 'scipy', 'mujoco', 'matplotlib') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_the_flat_hand_of_the_palm_axes_is_that_of_the_operator():
    posed = pose_hand(draw_anatomy(0.19, 0), np.zeros((1, len(JOINTS)))).landmarks[0]
    np.testing.assert_allclose(FLAT_HAND, posed, rtol=0, atol=1e-15)
