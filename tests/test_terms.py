"""A term of one's own: derivatives, both forms of the objective, and every kind of method."""

from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import Array
from trees import float64, limited_poses

from smooth_operator import Retargeter, SyntheticOperator, load_hand, method_config
from smooth_operator.baselines.ako import AkoObjectiveConfig
from smooth_operator.geometry import AnyArray
from smooth_operator.retargeting import LeastSquaresTerm, ObjectiveConfig
from smooth_operator.retargeting.objective import Derivatives, FrameGoal, JointTerm, smooth_l1
from smooth_operator.retargeting.sbr.sampled import SampledObjective


@dataclass(frozen=True)
class Apart(LeastSquaresTerm):
    """Tips that are not neighbours in the order of points, with a residual for each direction."""

    weight: float = 300.0

    def points(self) -> tuple[str, ...]:
        return ("pinky_tip", "index_tip")

    def residuals(self, points: Array, goal: FrameGoal) -> Array:
        return jnp.sqrt(self.weight) * (points[0] - points[1] - 0.05)


@dataclass(frozen=True)
class EvenBend(JointTerm):
    """A fourth power, which is no square about a pose."""

    weight: float = 2.0

    def expand(self, q: AnyArray, goal: FrameGoal) -> Derivatives:
        weight = self.weight
        return Derivatives(weight * (q**4).sum(axis=-1), 4 * weight * q**3, 12 * weight * q**2)


def test_terms_of_points_and_of_joints_add_to_eq_1_in_both_forms():
    hand = load_hand()
    rng = np.random.default_rng(0)
    poses = limited_poses(rng, hand.limits, 3)
    plain = SampledObjective(hand, ObjectiveConfig())
    more = SampledObjective(hand, ObjectiveConfig(terms=(Apart(), EvenBend())))
    count = len(plain.layout.vectors)
    goal = FrameGoal(rng.normal(0, 0.05, (count, 3)), rng.uniform(0, 2, count), poses[0], 0.1)
    tips = hand.tips(hand.full_configuration(poses))
    apart = tips[:, hand.fingers.index("pinky")] - tips[:, hand.fingers.index("index")] - 0.05
    added = 150.0 * (apart**2).sum(axis=-1) + 2.0 * (poses**4).sum(axis=-1)
    with float64():
        batch = jax.jit(
            lambda rows: [one(rows, goal, within_limits=False) for one in (plain, more)]
        )(list(poses.T))
        np.testing.assert_allclose(batch[1] - batch[0], added, rtol=1e-8)
        near = jax.jit(lambda q: more.value_grad_hess(q, goal))
        value, gradient, hessian = near(poses[1])
        assert abs(value - batch[1][1]) < 1e-10
        ends = [[near(poses[1] + s * e) for s in (1e-6, -1e-6)] for e in np.eye(len(gradient))]
        np.testing.assert_allclose(gradient, [(a[0] - b[0]) / 2e-6 for a, b in ends], atol=1e-6)
        np.testing.assert_allclose(hessian, [(a[1] - b[1]) / 2e-6 for a, b in ends], atol=1e-5)


@pytest.mark.parametrize("kind", [ObjectiveConfig, AkoObjectiveConfig])
def test_a_velocity_weight_of_each_joint_is_that_joints_in_all_forms(kind):
    hand = load_hand()
    objective = SampledObjective(hand, kind())
    rng = np.random.default_rng(1)
    poses, count = limited_poses(rng, hand.limits, 3), len(objective.layout.vectors)
    weights = rng.uniform(0, 2, poses.shape[1])
    goal = FrameGoal(rng.normal(0, 0.05, (count, 3)), rng.uniform(0, 2, count), poses[0], weights)
    with float64():
        goal = goal._replace(velocity_weight=jnp.asarray(weights))
        still = goal._replace(velocity_weight=jnp.zeros(len(weights)))
        many = jax.jit(lambda q, goal: objective(list(q.T), goal, within_limits=False))
        costs = jax.vmap(lambda q, goal: objective.value_grad_hess(q, goal)[0], (0, None))
        few = jax.jit(costs)
        np.testing.assert_allclose(many(poses, goal), few(poses, goal), rtol=1e-9)
        change = poses - poses[0]
        squares = (weights * change**2).sum(axis=1)
        huber = smooth_l1(weights * change, 0.02)[0].sum(axis=1)
        expected = squares if kind is ObjectiveConfig else huber
        np.testing.assert_allclose(many(poses, goal) - many(poses, still), expected, atol=1e-9)


def test_a_heavy_term_wins():
    """By a method that solves on the host, which compiles in the shortest time."""
    hand, recording = load_hand(), SyntheticOperator(seed=2).record(0.1)
    config = method_config("keyvector")
    mine = replace(config, objective=replace(config.objective, terms=(Apart(1e5),)))
    commands, _ = Retargeter(hand, config=mine).run(recording)
    tips = hand.tips(commands.joint_positions)
    gap = tips[:, hand.fingers.index("pinky")] - tips[:, hand.fingers.index("index")] - 0.05
    assert np.abs(gap).mean() < 0.05  # without the term, each direction is off by 61 to 106 mm
