"""The parts of the method ``smooth``, one by one."""

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from capsule_depths import depths, ends_of
from compact_hands import long_test_hands
from trees import float64, limited_poses

from smooth_operator import Hand, load_hand
from smooth_operator.hands.capsules import MOST, capsule_pairs, parts_apart
from smooth_operator.hands.finger_circles import spread_joints
from smooth_operator.hands.penetration import penetration_depths
from smooth_operator.retargeting.batching import ticks_of
from smooth_operator.retargeting.levenberg import damped_newton
from smooth_operator.retargeting.objective import FrameGoal, Objective
from smooth_operator.retargeting.program import FrameClock, tick_after
from smooth_operator.retargeting.sbr.published import ObjectiveConfig
from smooth_operator.retargeting.smooth_terms import (
    DirectionLength,
    DirectionLengthConfig,
    FingerSpread,
    FingertipPositionConfig,
    FingertipTracking,
    SelfCollision,
    SelfCollisionConfig,
)
from smooth_operator.retargeting.targets import CloseTargets

NO_GOAL = FrameGoal(np.zeros((0, 3)), np.zeros(0), np.zeros(0), 0.0)
HANDS = ("mimic_p050", "leap_hand", "shadow_hand", "inspire_hand")


@pytest.mark.parametrize("side", ["right", "left"])
@pytest.mark.parametrize("name", long_test_hands())
def test_what_the_measure_calls_a_collision_has_a_price(name, side):
    """Or the solver rests where its answers are thrown away."""
    hand = load_hand(name, side)
    pairs, margin = capsule_pairs(hand), SelfCollisionConfig().margin
    assert len(pairs.pairs) <= MOST
    q = np.random.default_rng(1).uniform(*hand.limits.T, (120, len(hand.limits)))
    measured = penetration_depths(hand, hand.full_configuration(q))
    deep = measured > 0.002
    assert deep.mean() > 0.03  # such poses are among them
    priced = depths(pairs, ends_of(pairs, hand, q)).max(axis=-1)
    assert (priced[deep] + margin > 0).all()
    # and no more: what has a price is a collision of that depth
    np.testing.assert_allclose(priced[priced > 0], measured[priced > 0], atol=1e-9)


@pytest.mark.parametrize("name", HANDS)
def test_the_measure_is_near_that_of_mujoco_on_the_models_shapes(name):
    """Palms are boxes, filled from within: there, capsules are less deep, at edges most."""
    hand = load_hand(name)
    counts = {frozenset(pair) for pair in parts_apart(hand).shapes.tolist()}
    data = mujoco.MjData(hand.model)
    q = np.random.default_rng(1).uniform(*hand.limits.T, (150, len(hand.limits)))
    ours, theirs = penetration_depths(hand, hand.full_configuration(q)), np.zeros(len(q))
    for pose, joints in enumerate(hand.full_configuration(q)):
        data.qpos[:] = hand.qpos(joints)
        mujoco.mj_kinematics(hand.model, data)
        mujoco.mj_comPos(hand.model, data)
        mujoco.mj_collision(hand.model, data)
        for geoms, apart in zip(data.contact.geom.tolist(), data.contact.dist, strict=True):
            if frozenset(geoms) in counts:
                theirs[pose] = max(theirs[pose], -float(apart))
    assert (theirs > 0.002).mean() > 0.1  # such poses are among them
    assert np.abs(ours - theirs).max() < (1e-9 if name == "mimic_p050" else 0.02)
    assert np.median(np.abs(ours - theirs)) < 1e-3


def test_the_price_is_that_of_the_depths():
    hand = load_hand()
    pairs, config = capsule_pairs(hand), SelfCollisionConfig(weight=7.0, margin=0.001)
    q = np.random.default_rng(2).uniform(*hand.limits.T, (20, len(hand.limits)))
    ends = ends_of(pairs, hand, q)
    inside = np.maximum(depths(pairs, ends) + config.margin, 0.0)
    expected = 7.0 * (inside**2).sum(axis=-1) / (2 * 0.02)
    assert (expected > 0).sum() > 5
    with float64():
        term, no_joints = SelfCollision(hand, config), jnp.zeros((len(pairs.names), 0, 3))
        price = jax.jit(lambda one: term.expand(one, no_joints, NO_GOAL).cost)
        found = [price(jnp.asarray(one)) for one in ends]
    np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-9)


def problem(
    hand: Hand, seed: int, self_collision: float = 20.0, held: bool = True
) -> tuple[Objective, FrameGoal]:
    """The terms of ``smooth`` with other weights, and a random goal.

    Args:
        hand: the robot hand.
        seed: of the goal.
        self_collision: weight of that term.
        held: whether the term of direction and length is there.
    """
    rng = np.random.default_rng(seed)
    config = ObjectiveConfig(targets=CloseTargets(), pose_weight=0.03, transition=0.013)
    eq_1 = Objective(hand, config)
    count = len(eq_1.layout.vectors)
    goal = FrameGoal(
        jnp.asarray(rng.normal(0, 0.05, (count, 3))),
        jnp.asarray(rng.uniform(0, 3, count)),
        jnp.asarray(limited_poses(rng, hand.limits, 1)[0]),
        0.2,
        jnp.asarray(
            hand.tips(hand.full_configuration(hand.neutral))
            - hand.wrist
            + rng.normal(0, 0.01, (len(hand.fingers), 3))
        ),
        jnp.asarray(rng.uniform(0, 40, len(hand.fingers))),
    )
    direction_length = DirectionLengthConfig(*((1.5, 3.0) if held else (0.0, 0.0)), 0.002, 0.04)
    more = (
        FingertipTracking(eq_1.layout, FingertipPositionConfig(0.0)),
        DirectionLength(eq_1.layout, direction_length),
        SelfCollision(hand, SelfCollisionConfig(self_collision, margin=0.002)),
    )
    return Objective(hand, config, more), goal


@pytest.mark.parametrize(
    "name", ["inspire_hand", pytest.param("mimic_p050", marks=pytest.mark.weekly)]
)
def test_gradient_and_hessian_against_finite_differences(name):
    hand = load_hand(name)
    with float64():
        _, goal = problem(hand, 3)
        derivatives = jax.jit(
            lambda q, weight: problem(hand, 3, weight, held=weight > 0)[0].value_grad_hess(q, goal),
            static_argnums=1,
        )
        poses = limited_poses(np.random.default_rng(4), hand.limits, 30)
        pairs = capsule_pairs(hand)
        deep = depths(pairs, ends_of(pairs, hand, poses)).max(axis=-1)
        poses = poses[deep > 0.001][:3]  # parts touch in each
        assert len(poses) > 1
        step = 1e-6
        for weight, exact in ((20.0, False), (0.0, True)):
            for q in poses:
                around = [
                    (derivatives(q + e, weight), derivatives(q - e, weight))
                    for e in step * np.eye(len(q))
                ]
                _, gradient, hessian = derivatives(q, weight)
                slopes = [(a[0] - b[0]) / (2 * step) for a, b in around]
                np.testing.assert_allclose(gradient, slopes, atol=1e-6, rtol=1e-5)
                np.testing.assert_allclose(hessian, hessian.T, atol=1e-9)
                if exact:  # but for the line between parts that touch, and turned vectors
                    bends = [(a[1] - b[1]) / (2 * step) for a, b in around]
                    np.testing.assert_allclose(hessian, bends, atol=1e-4, rtol=1e-4)


def test_it_is_eq_1_where_nothing_is_added():
    hand = load_hand()
    with float64():
        plain, goal = problem(hand, 5, 0.0, held=False)
        goal = goal._replace(motion_weights=jnp.zeros_like(goal.motion_weights))
        poses = limited_poses(np.random.default_rng(6), hand.limits, 4)
        costs = jax.jit(jax.vmap(lambda q: plain.value_grad_hess(q, goal)[0]))(jnp.asarray(poses))
    tips = hand.tips(hand.full_configuration(poses))
    points = np.concatenate([np.broadcast_to(hand.wrist, (4, 1, 3)), tips], axis=1)
    wrist, thumb = points[:, 1:] - points[:, :1], points[:, 2:] - points[:, 1:2]
    error = np.abs(np.concatenate([wrist, thumb], axis=1) - np.asarray(goal.vectors))
    loss = np.where(error < 0.013, error**2 / (2 * 0.013), error - 0.013 / 2).sum(axis=-1)
    pose, change = ((poses - np.asarray(at)) ** 2 for at in (hand.neutral, goal.previous))
    expected = (np.asarray(goal.weights) * loss).sum(axis=1) + (0.03 * pose + 0.2 * change).sum(
        axis=1
    )
    np.testing.assert_allclose(costs, expected, rtol=1e-9)


def test_the_descent_reaches_a_bounded_minimum():
    hand = load_hand("inspire_hand")
    with float64():
        smooth, goal = problem(hand, 7)
        run = jax.jit(
            lambda q: damped_newton(
                lambda one: smooth.value_grad_hess(one, goal),
                q,
                hand.limits,
                300,
                still=1e-9,
            )
        )
        found, reached, _ = run(jnp.asarray(hand.neutral, float))
        derivatives = jax.jit(lambda q: smooth.value_grad_hess(q, goal))
        cost, gradient, _ = derivatives(found)
        np.testing.assert_allclose(reached, cost, rtol=1e-9)
        low, high = hand.limits.T
        free = np.clip(found - gradient, low, high) - found
        assert np.abs(free).max() < 1e-5
        assert cost < derivatives(jnp.asarray(hand.neutral))[0]


def test_a_step_that_does_not_descend_is_tried_shorter():
    """Each damping that is tried first leads beyond the narrow valley; the descent still ends in
    its floor. A hilltop's start, from which nothing descends, stays."""
    steep = 1e4

    def derivatives(q: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
        beyond = jnp.maximum(q - 0.01, 0.0)
        cost, slope = 0.5 * q**2 + steep * beyond**2 - q, q + 2 * steep * beyond - 1
        return cost.sum(), slope, jnp.eye(1)  # as of the side from which it comes

    limits = np.array([[-10.0, 10.0]])
    found, _, steps = damped_newton(derivatives, jnp.zeros(1), limits, 50, 1e-6)
    np.testing.assert_allclose(found, 0.01 + (1 - 0.01) / (1 + 2 * steep), atol=1e-5)
    assert 2 < steps < 50
    held, *_ = damped_newton(
        lambda q: (jnp.where(q[0] == 0, 0.0, jnp.inf), -2 * q, -2 * jnp.eye(1)),
        jnp.zeros(1),
        limits,
        50,
    )
    np.testing.assert_array_equal(held, 0)


def targets_of(config: CloseTargets, human: np.ndarray):
    layout = config.layout(("thumb", "index", "middle"))
    return layout, config(config.init(layout), layout, jnp.asarray(human))[0]


def test_vectors_from_the_wrist_weigh_alike_and_those_from_the_thumb_have_costs_of_their_own():
    human = np.zeros((5, 3))
    human[:, 0] = (0.1, 0.1, 0.1, 0.06, 0.01)
    targets = targets_of(CloseTargets(w_wrist=3.0), human)[1]
    np.testing.assert_allclose(targets.weights, [3, 3, 3, 0, 0])
    np.testing.assert_allclose(targets.vectors, human)


def test_latches_close_near_and_open_far_and_change_no_target():
    config = CloseTargets(project=0.012, escape=0.02)
    layout = config.layout(("thumb", "index", "middle"))
    state, seen = config.init(layout), []
    for gap in (0.03, 0.015, 0.011, 0.019, 0.021, 0.015):
        human = jnp.full((5, 3), 0.03).at[3].set(jnp.array([gap, 0.0, 0.0]))
        targets, state = config(state, layout, human)
        seen.append(np.asarray(config.latched(state)).tolist())
        np.testing.assert_array_equal(targets.vectors, human)
    assert [first for first, _ in seen] == [False, False, True, True, False, False]
    assert not any(second for _, second in seen)


class EveryVector(DirectionLength):
    part = "all"


def test_fingers_spread_a_little_at_no_cost():
    hand = load_hand("leap_hand")
    term, index = FingerSpread(hand, 2.0), hand.joint_names.index("0")  # the index finger's spread
    for name, off, cost in (("0", 0.15, 0.0), ("0", -0.5, 2 * 0.3**2), ("1", 0.9, 0.0)):
        q = hand.neutral.copy()
        q[hand.joint_names.index(name)] += off
        assert float(term.expand(q, NO_GOAL).cost) == pytest.approx(cost, abs=1e-6)
    _, slope, bend = term.expand(jnp.asarray(hand.neutral).at[index].add(-0.5), NO_GOAL)
    expected = np.zeros(len(hand.neutral))
    expected[index] = 2 * 2 * -0.3
    np.testing.assert_allclose(slope, expected, atol=1e-5)
    np.testing.assert_allclose(bend, np.where(expected != 0, 4.0, 0.0), atol=1e-6)
    assert FingerSpread(load_hand("inspire_hand"), 2.0).is_off  # its fingers do not spread


@pytest.mark.parametrize(
    ("name", "joints"),
    [
        ("leap_hand", ["0", "4", "8"]),
        ("shadow_hand", ["rh_FFJ4", "rh_MFJ4", "rh_RFJ4", "rh_LFJ5", "rh_LFJ4"]),
        ("tesollo_dg5f", [f"rj_dg_{f}_1" for f in (2, 3, 4, 5)] + ["rj_dg_5_2"]),
        ("linker_l10", ["index_mcp_roll", "ring_mcp_roll", "pinky_mcp_roll"]),  # one motor bends
        ("schunk_svh", ["right_hand_Finger_Spread"]),  # its thumb's opposition moves the pinky
        ("ability_hand", []),
    ],
)
def test_joints_that_spread_fingers_are_known(name, joints):
    hand = load_hand(name)
    names = np.array(hand.joint_names)[list(hand.actuated)]
    assert names[spread_joints(hand)].tolist() == joints


def cost_of(config: DirectionLengthConfig, vector: np.ndarray, target: np.ndarray) -> float:
    """The cost of a vector, whatever hand it is of."""
    goal = NO_GOAL._replace(vectors=jnp.asarray(target)[None])
    off = jnp.asarray(vector - target)[None]
    return float(EveryVector(None, config).slopes(off, goal).cost)


def test_a_vector_is_priced_by_its_cosine_and_its_length():
    target = np.array([0.0, 0.008, 0.0])
    turned = np.array([0.008 * np.sin(1.2), 0.008 * np.cos(1.2), 0.0])
    with float64():
        only_direction = DirectionLengthConfig(direction=2.0, length=0.0)
        for size in (1.0, 3.0):  # whatever its length; 2 mm round the shortest off
            cosine = np.cos(1.2) / np.sqrt(1 + 0.25**2 / size**2)
            found = cost_of(only_direction, size * turned, target)
            assert found == pytest.approx(2.0 * (1 - cosine))
        only_length = DirectionLengthConfig(
            direction=0.0, length=100.0, huber_width=0.001, near=0.008
        )

        def priced(off: float) -> float:  # by the metre, but for what is within the Huber width
            return 100 / 2 * (np.hypot(off, 0.001) - 0.001)

        for stretch in (1.5, 4.0):
            size = np.hypot(stretch * 0.008, 0.002)
            found = cost_of(only_length, stretch * turned, target)  # wherever it points
            assert found == pytest.approx(priced(size - 0.008), rel=1e-4)
        far = 10 * target  # of long vectors the length counts for nothing
        assert cost_of(only_length, 1.1 * far, far) < 1e-3 * cost_of(
            only_length, 1.1 * target + [0.0, 0.0072, 0.0], target
        )


def test_no_gap_counts_as_a_short_one():
    """2^32 microseconds are 71.6 minutes; a difference of ticks is that modulo 2^32."""
    for gap in (0.01, 0.3, 1800.0, 2147.4, 2148.0, 4294.967, 4295.0, 8589.93, 1e6):
        stamps = np.array([1.7e9, 1.7e9 + 0.01, 1.7e9 + 0.01 + gap])
        one_by_one, answered = [], None
        for stamp in stamps.tolist():
            ticks = tick_after(answered, stamp)
            answered = (stamp, ticks)
            one_by_one.append(ticks)
        for ticks in (ticks_of(stamps), np.array(one_by_one, np.uint32)):
            passed = np.diff(ticks).astype(np.int32) * 1e-6
            np.testing.assert_allclose(passed, [0.01, min(gap, 2147.483647)], rtol=1e-6, atol=2e-6)
    back = np.diff(ticks_of([5.0, 4.0, 4.01])).astype(np.int32)
    np.testing.assert_array_equal(back, [-1, 10000])
    assert ticks_of([np.nan]) == [0]


def test_a_clock_of_frames_believes_stamps_at_every_rate():
    def dt(ticks: int, frames: int = 5) -> float:
        clock = FrameClock.of(np.uint32(ticks), np.uint32(frames))
        return float(clock.dt)

    for ticks in (500, 600, 999, 1000, 1001, 8000):  # 2 kHz is the fastest tracker
        assert dt(ticks) == pytest.approx(ticks * 1e-6)
    assert dt(0) == pytest.approx(0.01)  # stamps that stand still do not tell
    assert dt(20) == pytest.approx(0.00025)  # frames that arrive in a bunch
    assert dt(500, frames=0) == pytest.approx(0.01)
