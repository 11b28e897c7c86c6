"""Metrics on runs whose values are known on paper."""

import dataclasses
import json
import math

import numpy as np
import pytest
from metrics_cases import RATE, WRIST, human_motion, make_trace, rotation

from smooth_operator.errors import ConfigError, RecordingError, UnknownNameError
from smooth_operator.landmarks import FINGERS, TIPS
from smooth_operator.metrics import METRICS, evaluate
from smooth_operator.metrics.safety import workspace_utilisation
from smooth_operator.types import Status


@pytest.mark.parametrize("fingers", [FINGERS, FINGERS[:4], ("thumb", "middle"), FINGERS[:3]])
def test_a_perfect_copy_is_perfect(fingers):
    result = evaluate(make_trace(human_motion(80), fingers=fingers))
    ones = ("scale_ratio", "motion_preservation", "velocity_correlation")
    for name in ("cosine_similarity", "cosine_similarity_all", *ones):
        assert result[name] == pytest.approx(1, abs=1e-12), name
    assert result["lag_ms"] == result["frozen_share"] == 0
    assert list(result["pinch_touch_share_per_finger"]) == list(fingers[1:])


def test_a_scaled_and_turned_copy_shows_its_scale_and_its_angle():
    human = human_motion(60, seed=3)
    human[..., 2] = WRIST[2]  # planar, so every vector turns by the same angle
    turn = rotation(np.array([0, 0, 1.0]), 0.4)
    tips = WRIST + 0.7 * (human[:, list(TIPS)] - WRIST) @ turn.T
    result = evaluate(make_trace(human, tips))
    for name in ("cosine_similarity", "cosine_similarity_all", "motion_preservation"):
        assert result[name] == pytest.approx(math.cos(0.4), abs=1e-12), name
    assert result["scale_ratio"] == pytest.approx(0.7, abs=1e-12)


def test_pinches_touch_by_their_surfaces():
    distances = np.full((40, 4), np.nan)
    distances[:20, 0] = np.tile([0.0011, 0.0009, -0.0019, -0.0021], 5)  # apart, two touch, too deep
    distances[20:30, 1] = 0.004
    distances[30:39, 2] = 0.0  # too few to be told
    result = evaluate(make_trace(human_motion(40), pinch_distances=distances))
    assert result["pinch_touch_share"] == pytest.approx((15 + 9) / 39)
    assert result["pinch_deep_share"] == pytest.approx(5 / 39)
    assert result["pinch_touch_share_per_finger"] == {
        "index": pytest.approx(3 / 4),
        "middle": 0.0,
        "ring": None,
        "pinky": None,
    }
    for unknown in (None, np.full((40, 4), np.nan)):  # no shapes, no pinches
        result = evaluate(make_trace(human_motion(40), pinch_distances=unknown))
        assert result["pinch_touch_share"] is result["pinch_deep_share"] is None


@pytest.mark.parametrize("share", [0.0, 0.5, 1.4])
def test_shake_at_rest_is_the_share_that_the_robot_passes_on(share):
    rng = np.random.default_rng(0)
    human = np.tile(human_motion(1), (600, 1, 1))
    human[300:, list(TIPS), 0] += np.linspace(0, 0.2, 300)[:, None]  # it moves: not measured
    shake = rng.uniform(-0.0005, 0.0005, (600, 5, 3))
    human[:, list(TIPS)] += shake
    tips = human[:, list(TIPS)] - (1 - share) * shake
    tips[330:] *= 3.0
    result = evaluate(make_trace(human, tips))
    assert result["shake_at_rest"] == pytest.approx(share, abs=1e-6)
    assert evaluate(make_trace(human_motion(600)))["shake_at_rest"] is None  # never at rest
    still = np.tile(human_motion(1), (60, 1, 1))
    assert evaluate(make_trace(still))["shake_at_rest"] is None  # a tracker without any shake


def test_flatness_and_acceleration_of_constant_acceleration():
    """The figures in seconds are the same at an uneven rate; those in frames are not."""
    uneven = np.cumsum(np.random.default_rng(5).uniform(0.004, 0.03, 50))
    for t in (np.arange(50) / RATE, uneven):
        acceleration = np.array([0.3, -0.4, 1.2])  # 1.3 m/s^2 in all
        tips = WRIST + 0.5 * t[:, None, None] ** 2 * acceleration * np.ones((1, 5, 1))
        joints = 0.5 * 0.8 * t[:, None] ** 2 * np.ones((1, 3))
        result = evaluate(make_trace(human_motion(50), tips, joints=joints, stamps=t))
        assert result["fingertip_acceleration"] == pytest.approx(1.3, rel=1e-9)
        assert result["joint_jitter_rate_free"] == pytest.approx(0.8, rel=1e-9)
        if t is not uneven:
            assert result["flatness"] == pytest.approx((1.3 / RATE**2) ** 2, rel=1e-9)
            assert result["joint_jitter"] == pytest.approx(0.8 / RATE**2, rel=1e-9)


@pytest.mark.parametrize("delay", [1, 2.5, 9])
def test_lag_of_a_pure_delay(delay):
    """Frames become time by the median frame: a pause stretches neither the lag nor the rate."""
    fine, shift = human_motion(1200 + 2 * 9), round(2 * delay)  # two fine steps make one frame
    human, late = fine[shift : shift + 1200 : 2], fine[:1200:2]
    stamps = 2 * np.arange(600) / RATE
    stamps[300:] += 2.0
    result = evaluate(make_trace(human, late[:, list(TIPS)], stamps=stamps))
    assert result["lag_ms"] == pytest.approx(1e3 * 2 * delay / RATE, abs=0.5)
    assert result["rate_hz"] == pytest.approx(RATE / 2)


def test_a_frozen_hand():
    human = human_motion(50)
    tips = np.repeat(human[:1, list(TIPS)], 50, axis=0)
    result = evaluate(make_trace(human, tips, joints=np.full((50, 4), 0.2)))
    assert result["frozen_share"] == 1
    assert result["flatness"] == result["max_joint_step"] == 0
    absent = ("motion_preservation", "lag_ms", "velocity_correlation")
    assert [result[name] for name in absent] == [None] * 3


def test_frozen_share_counts_only_frames_in_which_the_human_moves():
    human = human_motion(41)
    human[21:] = human[20]  # rests for the second half
    joints = np.repeat(np.arange(21.0)[:, None] * 0.01, 2, axis=0)[:41]  # every other frame
    assert evaluate(make_trace(human, joints=joints))["frozen_share"] == pytest.approx(0.5)
    still = np.repeat(human[:1], 41, axis=0)
    assert evaluate(make_trace(still, joints=joints))["frozen_share"] is None
    still[:, TIPS[1], 0] += 0.001 * np.arange(41)  # one moving finger is a moving human
    assert evaluate(make_trace(still, joints=joints))["frozen_share"] == pytest.approx(0.5)


def test_still_frames_do_not_dilute_motion_preservation():
    human = human_motion(60)
    slow = human.copy()
    slow[30:] = human[29] + 1e-3 * (human[30:] - human[29])  # under the threshold of motion
    tips = slow[:, list(TIPS)].copy()
    tips[30:] += np.random.default_rng(0).normal(scale=1e-3, size=tips[30:].shape)
    result = evaluate(make_trace(slow, tips))
    assert result["motion_preservation"] == pytest.approx(1, abs=1e-9)
    assert evaluate(make_trace(slow, tips), "paper")["motion_preservation"] < 0.6


def test_limits_steps_and_joints_without_limits():
    joints = np.zeros((10, 3))
    joints[4, 0], joints[5, 1], joints[6, 2] = 1.25, -1.1, 40.0
    limits = np.array([[-1.0, 1.0], [-1.0, 1.0], [np.nan, np.inf]])
    result = evaluate(make_trace(human_motion(10), joints=joints, joint_limits=limits))
    assert result["limit_violation_rad"] == pytest.approx(0.25)
    assert result["limit_violation_share"] == pytest.approx(0.2)
    assert result["max_joint_step"] == pytest.approx(40)
    one_sided = np.array([[np.nan, 1.0], [-np.inf, np.inf], [-1.0, np.nan]])
    result = evaluate(make_trace(human_motion(10), joints=joints, joint_limits=one_sided))
    assert result["limit_violation_share"] == pytest.approx(0.1)


def test_rounding_at_a_limit_is_no_violation():
    joints = np.full((6, 1), np.float32(1.1), np.float32)  # rounds to above 1.1
    trace = make_trace(human_motion(6), joints=joints, joint_limits=np.array([[-1, 1.1]]))
    result = evaluate(trace)
    assert 0 < result["limit_violation_rad"] < 1e-6
    assert result["limit_violation_share"] == 0
    joints[:2] += 1e-4  # a hundredth of a degree is a violation
    beyond = evaluate(dataclasses.replace(trace, joint_positions=joints))
    assert beyond["limit_violation_share"] == pytest.approx(2 / 6)


def test_self_collision():
    penetration = np.array([0.003, 0.001, -0.02, 0.005, np.nan])
    result = evaluate(make_trace(human_motion(5), penetration=penetration))
    assert result["self_collision"] == pytest.approx(
        {"share": 0.5, "mean_depth_mm": 9 / 4, "max_depth_mm": 5}
    )
    absent = evaluate(make_trace(human_motion(5)))["self_collision"]
    assert absent == {"share": None, "mean_depth_mm": None, "max_depth_mm": None}


def test_workspace_utilisation_counts_points_near_a_visited_one():
    line = np.linspace(0, 0.1, 1001)  # 0.1 mm apart
    reach = np.zeros((1001, 5, 3))
    reach[..., 0] = line[:, None]
    tips = np.zeros((3, 5, 3))
    tips[:, 0, 0] = 0.05  # one point inside: 10 mm of 100 mm
    tips[:, 1, 0] = [0.02, 0.05, 0.08]  # three apart
    tips[:, 2, 1] = 0.5  # nowhere near
    tips[:, 3] = np.nan
    thumb, index, middle, ring, _ = workspace_utilisation(tips, reach)
    assert thumb == pytest.approx(0.1, abs=0.0011)
    assert index == pytest.approx(0.3, abs=0.0031)
    assert middle == 0
    assert ring is None
    result = evaluate(make_trace(human_motion(3), np.nan_to_num(tips), reach=reach))
    per_finger = result["workspace_utilisation_per_finger"]
    assert list(per_finger) == list(FINGERS)
    assert result["workspace_utilisation"] == pytest.approx(np.mean([*per_finger.values()]))
    reach = np.zeros((2, 2, 3))
    reach[:, :, 0] = [[0.25], [0.2500001]]
    assert workspace_utilisation(np.zeros((1, 2, 3)), reach, radius=0.25) == [0.5, 0.5]


def test_latency_and_status():
    latency = np.arange(101.0)[::-1].copy()
    status = np.zeros(101, int)
    status[:3], status[5], status[6] = Status.INVALID_LANDMARKS, Status.DEGENERATE_PALM, 77
    result = evaluate(make_trace(human_motion(101), latency_ms=latency, status=status))
    assert result["latency_ms"] == pytest.approx(
        {"mean": 50, "p50": 50, "p95": 95, "p99": 99, "first": 100}
    )
    counts = {name: count for name, count in result["status"].items() if count}
    assert counts == {"ok": 96, "invalid_landmarks": 3, "degenerate_palm": 1, "unknown": 1}
    silent = evaluate(make_trace(human_motion(9), latency_ms=np.full(9, np.nan)))
    assert set(silent["latency_ms"].values()) == {None}


@pytest.mark.parametrize("definition", ["sound", "paper"])
def test_invalid_frames_are_left_out_and_not_bridged(definition):
    human = human_motion(120)
    tips = human[:, list(TIPS)].copy()
    gap = human.copy()
    gap[40:44] = np.nan
    tips[40:44] = tips[39]  # the command is held
    with np.errstate(all="raise"):
        result = evaluate(make_trace(gap, tips), definition)
    for name in ("cosine_similarity", "scale_ratio"):
        assert result[name] == pytest.approx(1, abs=1e-4), name
    if definition == "sound":
        assert result["motion_preservation"] == pytest.approx(1, abs=1e-12)
    assert result["lag_ms"] == 0
    json.dumps(result, allow_nan=False)


def test_a_run_of_invalid_frames_only():
    human = np.full((30, 21, 3), np.nan)
    robot_landmarks = human_motion(30)
    with np.errstate(all="raise"):
        for definition in ("sound", "paper"):
            trace = make_trace(human, np.zeros((30, 5, 3)), robot_landmarks=robot_landmarks)
            result = evaluate(trace, definition)
            absent = ("cosine_similarity", "motion_preservation", "lag_ms", "frozen_share")
            assert [result[name] for name in absent] == [None] * 4
            assert result["flatness"] == 0


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("frames", [0, 1, 2, 3])
@pytest.mark.parametrize("definition", ["sound", "paper"])
def test_tiny_recordings_give_none_and_no_warning(frames, definition):
    human = human_motion(frames)
    trace = make_trace(human, penetration=np.zeros(frames), robot_landmarks=human)
    result = evaluate(trace, definition)
    json.dumps(result, allow_nan=False)
    assert result["frames"] == frames
    assert (result["flatness"] is None) == (frames < 3)
    assert (result["joint_jitter_rate_free"] is None) == (frames < 3)
    assert (result["motion_preservation"] is None) == (frames < 2)
    assert (result["rate_hz"] is None) == (frames < 2)
    assert (result["cosine_similarity"] is None) == (frames < 1)
    assert result["lag_ms"] is None


@pytest.mark.parametrize(
    ("changes", "error", "message"),
    [
        ({"robot_tips": np.zeros((20, 4, 3))}, RecordingError, "robot_tips must have shape"),
        ({"human": np.zeros((20, 25, 3))}, RecordingError, "human must have shape"),
        ({"stamps": np.r_[0.0, 0.1, 0.1, np.arange(1, 18)]}, RecordingError, "frame 2 is not"),
        ({"stamps": np.full(20, np.nan)}, RecordingError, "strictly increasing"),
        ({"status": np.zeros(19)}, RecordingError, "status must have shape"),
        ({"reach": np.zeros((9, 3, 3))}, RecordingError, "reach must have shape"),
        ({"penetration": 0.0}, RecordingError, "penetration must have shape"),
        ({"joint_limits": np.zeros((3, 2))}, RecordingError, "joint_limits must have shape"),
        ({"fingers": ("index", "thumb")}, RecordingError, "thumb first"),
        ({"fingers": ("thumb",)}, RecordingError, "2 to 5"),
        ({"fingers": ("thumb", "indx")}, UnknownNameError, "Did you mean 'index'"),
    ],
)
def test_a_trace_that_does_not_fit_together_says_why(changes, error, message):
    trace = make_trace(human_motion(20))
    with pytest.raises(error, match=message):
        dataclasses.replace(trace, **changes)


def test_extra_figures_join_but_do_not_overrule():
    trace = make_trace(human_motion(20))
    assert evaluate(trace)["tracking_loss"] is None
    result = evaluate(trace, extra={"tracking_loss": 0.25, "my_own": math.nan})
    assert result["tracking_loss"] == 0.25
    assert result["my_own"] is None
    with pytest.raises(ConfigError, match="flatness"):
        evaluate(trace, extra={"flatness": 0.0})
    with pytest.raises(UnknownNameError, match="paper"):
        evaluate(trace, "papr")


def test_the_table_names_every_key_and_no_other():
    trace = make_trace(human_motion(40), penetration=np.zeros(40), reach=np.zeros((5, 5, 3)))
    for definition in ("sound", "paper"):
        result = evaluate(trace, definition)
        assert list(result) == list(dict.fromkeys(m.name.split(".")[0] for m in METRICS))
        for key in ("latency_ms", "self_collision"):
            named = {m.name.split(".")[1] for m in METRICS if m.name.startswith(f"{key}.")}
            assert named == set(result[key])
    with pytest.raises(UnknownNameError, match="metric"):
        METRICS[0].of({})
