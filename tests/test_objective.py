"""Keyvectors, DexPilot's latches, and Eq. (1) with its derivatives, against plain NumPy."""

from dataclasses import replace
from itertools import combinations
from typing import Literal

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from trees import float64, limited_poses

from smooth_operator import Hand, load_hand
from smooth_operator.landmarks import FINGERS, LANDMARKS
from smooth_operator.retargeting.objective import FrameGoal
from smooth_operator.retargeting.sbr.published import (
    DexPilotTargets,
    LatchState,
    ObjectiveConfig,
    PlainTargets,
)
from smooth_operator.retargeting.sbr.sampled import SampledObjective
from smooth_operator.retargeting.targets import KeyvectorLayout, Targets

FIVE = KeyvectorLayout(FINGERS)


def pairs(layout: KeyvectorLayout) -> tuple[tuple[int, int], ...]:
    """(from, to) of each vector: 0 for the wrist, i for the i-th tip."""
    row = layout.landmarks.index
    return tuple((row(start), row(end)) for start, end in layout.vectors if start is not None)


@pytest.mark.parametrize("fingers", [FINGERS, FINGERS[:2], ("thumb", "middle", "pinky")])
def test_keyvectors_are_in_order(fingers):
    """From the wrist to each tip, then between tips, those of the thumb first."""
    layout = KeyvectorLayout(fingers)
    assert pairs(layout) == tuple(combinations(range(len(fingers) + 1), 2))
    assert pairs(layout)[layout.thumb] == tuple((1, k) for k in range(2, len(fingers) + 1))
    assert [LANDMARKS[i] for i in layout.landmarks] == ["wrist", *(f"{f}_tip" for f in fingers)]


def test_human_and_robot_keyvectors():
    rng = np.random.default_rng(0)
    landmarks = rng.normal(0, 0.1, (7, 21, 3))
    points = landmarks[:, [0, 4, 8, 12, 16, 20]]
    by_hand = np.stack([points[:, j] - points[:, i] for i, j in pairs(FIVE)], axis=1)
    np.testing.assert_allclose(FIVE.human(landmarks), by_hand, atol=1e-15)
    robot = FIVE.among(points - points[:, :1])
    np.testing.assert_allclose(robot, FIVE.human(landmarks), atol=1e-12)
    assert isinstance(FIVE.human(jnp.asarray(landmarks)), jax.Array)


def human_vectors(distances: list[float]) -> jax.Array:
    """Keyvectors of a hand whose thumb tip is so far from each other tip."""
    rng = np.random.default_rng(1)
    thumb = np.array([0.05, 0.0, 0.1])
    directions = rng.standard_normal((len(distances), 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    tips = np.vstack([thumb, thumb + directions * np.array(distances)[:, None]])
    return jnp.asarray(FIVE.among(np.vstack([np.zeros(3), tips])), jnp.float32)


def first_frame(human: jax.Array) -> tuple[Targets, LatchState]:
    policy = DexPilotTargets()
    return policy(policy.init(FIVE), FIVE, human)


def latches(sequence: list[list[float]]) -> list[list[bool]]:
    policy, seen = DexPilotTargets(), []
    state = policy.init(FIVE)
    for distances in sequence:
        _, state = policy(state, FIVE, human_vectors(distances))
        seen.append([bool(one) for one in policy.latched(state)])
    return seen


def test_a_latch_closes_under_project_and_opens_above_escape():
    far = [0.1, 0.1, 0.1]
    distances = [0.05, 0.012, 0.0101, 0.0099, 0.012, 0.0149, 0.0151, 0.012, 0.0099, 0.03]
    closed = [False, False, False, True, True, True, False, False, True, False]
    seen = latches([[d, *far] for d in distances])
    assert [row[0] for row in seen] == closed
    assert not any(any(row[1:]) for row in seen)


def test_fingers_latch_on_their_own():
    seen = latches(
        [[0.009, 0.1, 0.012, 0.1], [0.012, 0.009, 0.012, 0.1], [0.1, 0.012, 0.1, 0.005]],
    )
    assert seen == [
        [True, False, False, False],
        [True, True, False, False],
        [False, True, False, True],
    ]


def test_targets_and_weights_of_open_closed_and_latched_pairs():
    policy = DexPilotTargets(eta2=0.004, w_set2=0.5, beta=1.2, w_thumb=3.0, w_between=4.0)
    human = human_vectors([0.005, 0.05, 0.008, 0.06])
    out, _ = policy(policy.init(FIVE), FIVE, human)
    length = np.linalg.norm(human, axis=1)
    closed, both = [5, 7], [10]  # index and ring to the thumb; index to ring
    for k in range(15):
        direction = human[k] / length[k]
        if k in closed:
            vector, weight = 0.001 * direction, 2.0
        elif k in both:
            vector, weight = 0.004 * direction, 0.5
        else:
            vector, weight = 1.2 * human[k], 1.0 if k < 5 else 3.0 if k < 9 else 4.0
        np.testing.assert_allclose(out.vectors[k], vector, atol=1e-7)
        assert float(out.weights[k]) == weight
    assert out.vectors.dtype == out.weights.dtype == jnp.float32


def test_the_papers_table():
    out, _ = first_frame(human_vectors([0.005, 0.008, 0.1, 0.1]))
    lengths = np.linalg.norm(out.vectors, axis=1)
    np.testing.assert_allclose(lengths[[5, 6, 9]], [0.001, 0.001, 0.0], atol=1e-8)
    np.testing.assert_array_equal(out.weights, [1, 1, 1, 1, 1, 2, 2, 1, 1, 0, 1, 1, 1, 1, 1])


def test_tips_that_coincide_have_no_direction_and_stay_finite():
    out, state = first_frame(human_vectors([0.0, 0.1, 0.1, 0.1]))
    assert np.isfinite(out.vectors).all()
    assert bool(state.latched[0])


def test_blending_spreads_a_latch_over_frames():
    policy = DexPilotTargets(blend=0.25)
    state = policy.init(FIVE)
    human = human_vectors([0.005, 0.005, 0.1, 0.1])
    away = human_vectors([0.05, 0.05, 0.1, 0.1])
    shares = []
    for seen in [human] * 6 + [away] * 5:
        out, state = policy(state, FIVE, seen)
        share = float(state.closure[0])
        shares.append(share)
        open_, shut = np.asarray(seen[5]), 0.001 * np.asarray(seen[5] / np.linalg.norm(seen[5]))
        np.testing.assert_allclose(out.vectors[5], (1 - share) * open_ + share * shut, atol=1e-7)
        np.testing.assert_allclose(out.weights[5], 1 + share, rtol=1e-6)
        np.testing.assert_allclose(out.weights[9], 1 - share, atol=1e-6)  # index to middle
        np.testing.assert_allclose(out.vectors[6 + 1], seen[7], atol=1e-7)  # an open finger's
    assert shares == [0.25, 0.5, 0.75, 1, 1, 1, 0.75, 0.5, 0.25, 0, 0]


def test_plain_targets_follow_the_human():
    human = human_vectors([0.005, 0.1, 0.1, 0.1])
    policy = PlainTargets(beta=0.9, w_wrist=1.0, w_thumb=2.0, w_between=3.0)
    out, state = policy((), FIVE, human)
    np.testing.assert_allclose(out.vectors, 0.9 * human, rtol=1e-6)
    np.testing.assert_array_equal(out.weights, [1] * 5 + [2] * 4 + [3] * 6)
    assert state == policy.init(FIVE) == ()
    assert policy.latched(state) is None


Loss = Literal["smooth_l1", "squared"]
LOSSES: tuple[Loss, ...] = ("smooth_l1", "squared")


def random_goal(hand: Hand, seed: int, velocity_weight: float = 0.1) -> FrameGoal:
    """Targets some centimetres from a random pose: components on both sides of the transition."""
    rng = np.random.default_rng(seed)
    layout = KeyvectorLayout(hand.fingers)
    q = limited_poses(rng, hand.limits, 2)
    vectors = layout.among(np.vstack([hand.wrist, hand.tips(hand.full_configuration(q[0]))]))
    vectors = vectors + rng.normal(0, 0.02, vectors.shape)
    return FrameGoal(vectors, rng.uniform(0, 2, len(vectors)), q[1], velocity_weight)


def plain_cost(hand: Hand, config: ObjectiveConfig, q: np.ndarray, goal: FrameGoal) -> float:
    """Eq. (1), one term after the other."""
    tips = hand.tips(hand.full_configuration(q))
    points = np.vstack([hand.wrist, tips])
    total = 0.0
    for k, (i, j) in enumerate(pairs(KeyvectorLayout(hand.fingers))):
        for e in points[j] - points[i] - goal.vectors[k]:
            if config.loss == "squared":
                loss = e**2
            elif abs(e) < config.transition:
                loss = 0.5 * e**2 / config.transition
            else:
                loss = abs(e) - 0.5 * config.transition
            total += goal.weights[k] * loss
    total += config.pose_weight * ((q - hand.neutral) ** 2).sum()
    return total + goal.velocity_weight * ((q - goal.previous) ** 2).sum()


def named_hand(name: str) -> Hand:
    if name != "three fingers":
        return load_hand("mimic_p050", name)
    spec = load_hand().spec
    return load_hand(replace(spec, fingers=spec.fingers[:3], align=("thumb", "index", "middle")))


@pytest.mark.parametrize(
    ("name", "loss", "pose", "velocity"),
    [
        ("right", "smooth_l1", 0.05, 0.1),
        ("right", "squared", 0.05, 0.0),
        pytest.param("right", "smooth_l1", 0.0, 0.0, marks=pytest.mark.weekly),
        ("left", "squared", 0.0, 0.3),
        ("three fingers", "smooth_l1", 0.05, 0.1),
    ],
)
def test_the_batch_objective_is_eq_1(name, loss, pose, velocity):
    hand = named_hand(name)
    config = ObjectiveConfig(loss=loss, pose_weight=pose, velocity_weight=velocity)
    objective, goal = SampledObjective(hand, config), random_goal(hand, 2, velocity)
    q = limited_poses(np.random.default_rng(3), hand.limits, 40)
    expected = [plain_cost(hand, config, row, goal) for row in q]
    pulls = [
        config.pose_weight * ((row - hand.neutral) ** 2).sum()
        + velocity * ((row - goal.previous) ** 2).sum()
        for row in q
    ]
    with float64():
        # one program for both, compiled once
        exact, fast, tracking = jax.jit(
            lambda rows, goal: (
                objective(rows, goal, within_limits=False),
                objective(rows, goal),
                objective.tracking(rows, goal, within_limits=False),
            )
        )(list(q.T), goal)
    np.testing.assert_allclose(exact, expected, rtol=1e-12)
    np.testing.assert_allclose(fast, expected, rtol=1e-5)
    np.testing.assert_allclose(tracking, np.subtract(expected, pulls), rtol=1e-10)


@pytest.mark.parametrize("loss", LOSSES)
def test_one_pose_has_the_same_objective_and_its_derivatives_are_exact(loss):
    hand = load_hand()
    config = ObjectiveConfig(loss=loss, transition=0.013)
    objective = SampledObjective(hand, config)
    goal, step = random_goal(hand, 4), 1e-6
    q = limited_poses(np.random.default_rng(5), hand.limits, 3)
    expected = [plain_cost(hand, config, row, goal) for row in q]
    with float64():
        derivatives = jax.jit(objective.value_grad_hess)
        slope = jax.jit(lambda row: derivatives(row, goal)[1])
        for row, cost in zip(q, expected, strict=True):
            value, gradient, hessian = derivatives(row, goal)
            np.testing.assert_allclose(value, cost, rtol=1e-12)
            pull = objective.regularisation(jnp.asarray(row), goal).cost
            loose = goal._replace(velocity_weight=0.0)
            tracking = plain_cost(hand, replace(config, pose_weight=0.0), row, loose)
            np.testing.assert_allclose(value - pull, tracking, rtol=1e-12)
            steps = step * np.eye(len(row))
            ahead, behind = (
                np.array([plain_cost(hand, config, row + sign * e, goal) for e in steps])
                for sign in (1, -1)
            )
            np.testing.assert_allclose(gradient, (ahead - behind) / (2 * step), atol=1e-8)
            around = [(slope(row + e) - slope(row - e)) / (2 * step) for e in steps]
            # smooth-L1 bends at the transition: a step across it, of 1e-6, is improbable
            np.testing.assert_allclose(hessian, np.stack(around), atol=1e-6)
            np.testing.assert_allclose(hessian, hessian.T, atol=1e-14)


def test_no_velocity_term_without_a_previous_command():
    """With weight 0 the previous pose must not matter at all, not even to rounding."""
    hand = load_hand()
    objective, goal = SampledObjective(hand, ObjectiveConfig()), random_goal(hand, 8, 0.0)
    rows = [jnp.float32(v) for v in limited_poses(np.random.default_rng(9), hand.limits, 1)[0]]
    goal = jax.tree.map(lambda leaf: jnp.asarray(leaf, jnp.float32), goal)
    moved = goal._replace(previous=goal.previous + 1.0)
    assert float(objective(rows, goal)) == float(objective(rows, moved))
