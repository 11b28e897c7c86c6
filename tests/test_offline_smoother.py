"""Whole recordings at once: the solver of trajectories, gaps, and the retargeter around it."""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from smooth_operator import HandRecording, Retargeter, Status
from smooth_operator.errors import ConfigError
from smooth_operator.execution import answers, build, execute
from smooth_operator.metrics import evaluate
from smooth_operator.metrics.assemble import assemble_trace
from smooth_operator.planning import make_request, plan
from smooth_operator.retargeting import trajectory_retargeter as trajectory_module
from smooth_operator.retargeting.aligned_recording import align_recording
from smooth_operator.retargeting.preset_files import method_config
from smooth_operator.retargeting.presets import PRESETS, live_presets
from smooth_operator.retargeting.sbr.method import SbrConfig
from smooth_operator.retargeting.sbr.newton import NewtonConfig
from smooth_operator.retargeting.sbr.sampling import SamplingConfig
from smooth_operator.retargeting.trajectory import TrajectoryConfig, TrajectoryMethodConfig
from smooth_operator.retargeting.trajectory_retargeter import (
    TrajectoryRetargeter,
    check_method,
    windows,
)
from smooth_operator.retargeting.trajectory_solver import Led, motion_price, smooth_trajectory
from smooth_operator.synthetic import SyntheticOperator, TrackerModel
from smooth_operator.types import CommandTrajectory

# -- the solver ----------------------------------------------------------------------------------

WIDE = np.array([[-10.0, 10.0], [-10.0, 10.0]])


def following(goal: np.ndarray, weight: np.ndarray | float = 1.0) -> Any:
    """Each frame's cost: weight (q - goal)^2 / 2."""
    w = np.broadcast_to(weight, goal.shape[:1])

    def costs(q: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        off = q - goal
        hessian = w[:, None, None] * np.eye(goal.shape[1])
        return 0.5 * w * (off**2).sum(axis=1), w[:, None] * off, hessian

    return costs


def noisy(count: int = 60, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    stamps = np.cumsum(rng.uniform(0.01, 0.03, count))
    smooth = np.stack([np.sin(3 * stamps), np.cos(2 * stamps)], axis=1)
    return stamps, smooth + rng.normal(scale=0.05, size=smooth.shape)


def accelerations(stamps: np.ndarray) -> np.ndarray:
    """(T - 2, T) a matrix that differentiates twice, the slow way: fitted polynomials."""
    rows = np.zeros((len(stamps) - 2, len(stamps)))
    for t in range(len(rows)):
        at = stamps[t : t + 3] - stamps[t]
        rows[t, t : t + 3] = 2.0 * np.linalg.inv(np.vander(at, increasing=True))[2]
    return rows


def dense_price(stamps: np.ndarray, config: TrajectoryConfig) -> np.ndarray:
    """(T, T) the matrix of the price of motion, from its three bands."""
    price = motion_price(stamps, config)
    lower = sum(np.diag(price[k, : len(stamps) - k], -k) for k in range(3))
    return lower + np.tril(lower, -1).T


def test_bounds_hold_and_what_is_free_is_optimal():
    stamps, goal = noisy()
    limits = np.array([[-0.5, 0.4], [-0.2, 2.0]])
    config = TrajectoryConfig(acceleration_weight=1e-6, tolerance=1e-9)
    q = smooth_trajectory(following(goal), np.zeros_like(goal), stamps, limits, config).q
    assert (q >= limits[:, 0]).all()
    assert (q <= limits[:, 1]).all()
    assert (q == limits[0, 1]).any()
    d = accelerations(stamps)
    slope = q - goal + 2e-6 * d.T @ d @ q
    free = (q > limits[:, 0]) & (q < limits[:, 1])
    assert np.abs(slope[free]).max() < 1e-6
    assert (slope[q == limits[:, 0]] >= -1e-6).all()
    assert (slope[q == limits[:, 1]] <= 1e-6).all()


def test_the_beginning_may_be_fixed():
    stamps, goal = noisy()
    config = TrajectoryConfig(acceleration_weight=1e-5)
    whole = smooth_trajectory(following(goal), goal, stamps, WIDE, config).q
    rest = smooth_trajectory(
        following(goal[20:]),
        np.concatenate([whole[20:23], goal[23:]]),
        stamps[20:],
        WIDE,
        config,
        3,
    ).q
    np.testing.assert_allclose(rest, whole[20:], atol=1e-6)


def test_joints_keep_to_the_speed_limit():
    stamps = np.arange(40) * 0.01
    goal = np.where(stamps < 0.2, 0.0, 1.0)[:, None]
    steps = {}
    for limit in (1e9, 10.0):
        config = TrajectoryConfig(acceleration_weight=1e-9, speed_limit=limit)
        q, cost, _, _ = smooth_trajectory(following(goal), goal, stamps, WIDE[:1], config)
        steps[limit] = np.abs(np.diff(q[:, 0])).max()
        d = accelerations(stamps)
        expected = 0.5 * ((q - goal) ** 2).sum() + 1e-9 * ((d @ q) ** 2).sum()
        beyond = np.maximum(np.abs(np.diff(q[:, 0])) - limit * 0.01, 0)
        assert cost == pytest.approx(expected + 250 * (beyond**2).sum(), rel=1e-6)
    assert steps[1e9] > 0.5
    assert steps[10.0] < 0.1 + 0.01


def test_points_move_as_others_do():
    stamps, goal = noisy(50)
    rng = np.random.default_rng(4)
    mix = rng.normal(size=(3, 2))  # three points that depend on two joints

    def points(q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return q @ mix.T, np.broadcast_to(mix, (len(q), 3, 2))

    steps, weights = rng.normal(scale=0.02, size=(49, 3)), rng.uniform(0, 5, (49, 3))
    weights[20:25] = 0.0
    config = TrajectoryConfig(acceleration_weight=1e-7)
    found = smooth_trajectory(
        following(goal), goal, stamps, WIDE, config, led=Led(points, steps, weights)
    )
    # the same as one linear system
    d = accelerations(stamps)
    matrix = np.kron(np.eye(50) + 2e-7 * d.T @ d, np.eye(2))
    right = goal.ravel().copy()
    for t in range(49):
        rows = np.zeros((3, 100))
        rows[:, 2 * t : 2 * t + 2], rows[:, 2 * t + 2 : 2 * t + 4] = -mix, mix
        matrix += rows.T @ (weights[t, :, None] * rows)
        right += rows.T @ (weights[t] * steps[t])
    expected = np.linalg.solve(matrix, right).reshape(50, 2)
    np.testing.assert_allclose(found.q, expected, atol=1e-6)


def test_a_cost_with_hills_never_rises():
    stamps, goal = noisy(80)

    def costs(q: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        off = 6 * (q - goal)
        hessian = np.einsum("tj,jk->tjk", 36 * np.cos(off), np.eye(2))  # bends down beyond the hill
        return (1 - np.cos(off)).sum(axis=1), 6 * np.sin(off), hessian

    config = TrajectoryConfig(acceleration_weight=1e-5)
    start = goal + np.random.default_rng(1).uniform(-0.6, 0.6, goal.shape)
    found = smooth_trajectory(costs, start, stamps, WIDE, config)
    dense = dense_price(stamps, config)
    first, last = (costs(q)[0].sum() + 0.5 * (q * (dense @ q)).sum() for q in (start, found.q))
    assert found.converged
    assert last == pytest.approx(found.cost)
    assert last < 0.5 * first


def test_a_recording_of_one_or_two_frames():
    config = TrajectoryConfig(acceleration_weight=1.0)
    for count in (1, 2, 3):
        goal = np.arange(2.0 * count).reshape(count, 2)
        q = smooth_trajectory(following(goal), goal, np.arange(count) * 0.1, WIDE, config).q
        assert q.shape == goal.shape
        assert np.isfinite(q).all()


CAUSAL = SbrConfig(
    sampling=SamplingConfig(samples=64, elites=12, cycles=3, draws="quasi"),
    polish=NewtonConfig(iterations=3, damping=(0.0, 1.0)),
)
CONFIG = TrajectoryMethodConfig(
    CAUSAL, TrajectoryConfig(acceleration_weight=1e-7, speed_limit=28.0), jump=0.03
)
LED = replace(CONFIG, future=replace(CONFIG.future, motion_weight=0.05, motion_speed=0.6))


@pytest.fixture(scope="module")
def whole(hand) -> TrajectoryRetargeter:
    return TrajectoryRetargeter(hand, CONFIG)


@pytest.fixture(scope="module")
def recording() -> HandRecording:
    tracker = TrackerModel(shake=5e-4, seed=3)
    return SyntheticOperator(seed=12, rate_hz=60.0, tracker=tracker).record(4.0)[40:200]


@pytest.fixture(scope="module")
def full(whole, recording) -> tuple[CommandTrajectory, np.ndarray]:
    """Commands and loss of the undisturbed recording."""
    return whole.run(recording)


def lost(recording: HandRecording, *frames: slice) -> HandRecording:
    landmarks = recording.landmarks.copy()
    for part in frames:
        landmarks[part] = np.nan
    return replace(recording, landmarks=landmarks, valid=None)


def test_it_is_smoother_than_frame_by_frame_and_no_later(whole, full, recording, hand):
    found, loss = full
    causal, _ = whole.causal.run(recording)
    ours, theirs = (
        evaluate(assemble_trace(recording, c, hand, CAUSAL.alignment, reach_samples=0))
        for c in (found, causal)
    )
    assert ours["flatness"] < 0.5 * theirs["flatness"]
    assert ours["cosine_similarity"] > theirs["cosine_similarity"] - 1e-3
    assert ours["lag_ms"] == 0.0
    assert ours["limit_violation_share"] == 0.0
    assert (found.status == Status.OK).all()
    assert np.isfinite(loss).all()
    assert np.isnan(found.latency_ms).all()
    # what is followed is the human without noise, better than the causal method does
    clean = SyntheticOperator(seed=12, rate_hz=60.0).record(4.0)[40:200]
    human = align_recording(clean, hand, CAUSAL.alignment)
    speed = np.diff(human[:, 8] - human[:, 0], axis=0)
    correlation = []
    for commands in (found, causal):
        tips = np.diff(hand.tips(commands.joint_positions)[:, 1], axis=0)
        correlation.append(np.corrcoef(speed.ravel(), tips.ravel())[0, 1])
    assert correlation[0] > correlation[1]


def test_led_fingertips_move_as_the_humans(full, recording, hand):
    free, led = (
        evaluate(assemble_trace(recording, commands, hand, reach_samples=0))
        for commands, _ in (full, TrajectoryRetargeter(hand, LED).run(recording))
    )
    assert led["motion_preservation"] > free["motion_preservation"] + 0.1
    assert led["velocity_correlation"] > free["velocity_correlation"] + 0.1
    assert led["cosine_similarity"] > free["cosine_similarity"] - 0.03


def test_windows_do_not_show(whole, full, recording, monkeypatch):
    monkeypatch.setattr(trajectory_module, "WINDOW", 50)
    monkeypatch.setattr(trajectory_module, "AHEAD_S", 0.6)
    parts, _ = whole.run(recording)
    assert len(windows(len(recording), 50, 36)) > 2
    assert np.abs(parts.joint_positions - full[0].joint_positions).max() < 5e-3


def test_short_gaps_are_bridged_long_ones_held(whole, full, recording, hand):
    gaps = (slice(0, 3), slice(30, 36), slice(70, 110), slice(155, 160))
    found, loss = whole.run(lost(recording, *gaps))
    undisturbed = full[0].joint_positions
    q = found.joint_positions
    missing = np.concatenate([np.arange(160)[gap] for gap in gaps])
    assert (found.status[missing] == Status.INVALID_LANDMARKS).all()
    assert (np.delete(found.status, missing) == Status.OK).all()
    assert np.array_equal(np.isnan(loss), found.status != Status.OK)
    assert np.isfinite(q).all()
    # before the first good frame the neutral pose, over the long gap and at the end the last one
    neutral = np.asarray(hand.full_configuration(hand.neutral))
    np.testing.assert_allclose(q[:3], neutral[None].repeat(3, 0), atol=1e-9)
    assert (q[70:110] == q[69]).all()
    assert (q[155:] == q[154]).all()
    # over the short one the hand goes on, and near where it would have been
    steps, usual = (np.abs(np.diff(each, axis=0)).max() for each in (q[29:37], undisturbed))
    assert steps < 2.0 * usual
    assert np.abs(q[30:36] - undisturbed[30:36]).max() < 0.1


def test_frames_that_never_came_are_bridged_in_time(whole, full, recording):
    kept = np.delete(np.arange(160), [60, 61, 62])
    found, _ = whole.run(HandRecording(recording.landmarks[kept], recording.stamps[kept]))
    assert np.abs(found.joint_positions - full[0].joint_positions[kept]).max() < 0.15


def test_no_hand_and_a_single_frame(whole, recording, hand):
    found, loss = whole.run(lost(recording[:5], slice(0, 5)))
    assert (found.status == Status.INVALID_LANDMARKS).all()
    assert (found.joint_positions == np.asarray(hand.full_configuration(hand.neutral))).all()
    assert np.isnan(loss).all()
    found, loss = whole.run(recording[:1])
    assert found.status.tolist() == [Status.OK]
    assert np.isfinite(loss).all()


def test_live_use_is_refused(hand):
    with pytest.raises(ConfigError, match="whole recording"):
        Retargeter(hand, config=CONFIG)
    assert "offline" not in live_presets()["sbr"]
    assert "realtime" in live_presets()["sbr"]


def test_methods_without_derivatives_are_refused(hand):
    config = TrajectoryMethodConfig(method_config("joint_angle"), CONFIG.future)
    with pytest.raises(ConfigError, match="sbr and smooth can"):
        check_method(config, hand)
    check_method(CONFIG, hand)
    with pytest.raises(ConfigError, match="bridge"):
        replace(CONFIG, bridge=-1.0)
    changed = CONFIG.with_alignment(scale=0.8)
    assert (changed.alignment.scale, changed.future) == (0.8, CONFIG.future)


def test_a_plan_with_the_preset_is_done_as_a_whole(recording, monkeypatch, full):
    monkeypatch.setitem(PRESETS["sbr"], "tiny", CONFIG)
    todo = plan(recording, make_request(method="sbr", preset="tiny"))
    built = build(todo)
    assert isinstance(built[0], TrajectoryRetargeter)
    shown: list[int] = []

    def track(frames: Any) -> Iterator[int]:
        for frame in frames:
            shown.append(frame)
            yield frame

    outcome = execute(todo, built, track)
    assert shown == list(range(160))
    # another run of the same recording, and that of a folder, to the last bit
    ((commands, _),) = answers([todo], keep=False)
    for each in (outcome.commands, commands):
        assert each.joint_positions.tobytes() == full[0].joint_positions.tobytes()
