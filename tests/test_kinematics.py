"""Kinematics against MuJoCo's, on the built-in hands and on random trees, and by differences."""

from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from trees import float64, limited_poses, mujoco_points, random_model, random_palm

from smooth_operator.errors import HandModelError
from smooth_operator.hands.differential import PointKinematics, moments
from smooth_operator.hands.kinematics import KinematicTree, build_tree
from smooth_operator.hands.registry import load_hand

SEEDS = range(12)


def random_tree(
    seed: int,
) -> tuple[mujoco.MjModel, int, list[tuple[int, np.ndarray]], KinematicTree]:
    model = random_model(seed)
    rng = np.random.default_rng([seed, 1])
    palm, under = random_palm(model, rng)
    points = [(b, rng.normal(0, 0.03, 3)) for b in [palm, *under]]
    tree = build_tree(model, palm, {f"p{i}": point for i, point in enumerate(points)})
    return model, palm, points, tree


@pytest.mark.parametrize("seed", SEEDS)
def test_random_trees_equal_mujoco(seed):
    model, palm, points, tree = random_tree(seed)
    # over any angle, not only within the limits, and with whatever moves the palm itself
    q = np.random.default_rng([seed, 2]).uniform(-3, 3, (25, model.njnt))
    ours = tree.positions(q)
    assert ours.shape == (25, len(points), 3)
    assert ours.dtype == np.float64
    np.testing.assert_allclose(ours, mujoco_points(model, palm, points, q), atol=1e-12)


@pytest.mark.parametrize("seed", [0, 3])
def test_polynomials_within_limits_are_accurate(seed):
    hand = load_hand("mimic_p050", "right") if seed == 0 else None
    tree = hand.tree if hand else random_tree(seed)[3]
    q = limited_poses(np.random.default_rng(seed), tree.limits, 5000)
    ends = np.stack([tree.limits[:, 0], tree.limits[:, 1]])
    q = np.concatenate([q, ends])  # where Chebyshev polynomials are at their worst
    rows = [jnp.asarray(row, jnp.float32) for row in q.T]
    fast = jax.jit(lambda rows: tree.forward_kinematics(rows, tree.names, within_limits=True))(rows)
    got = np.stack([np.stack([np.broadcast_to(c, len(q)) for c in p], -1) for p in fast], -2)
    assert abs(got - tree.positions(q)).max() < 1e-6


def test_batch_shapes_and_kinds():
    tree = load_hand().tree
    q = limited_poses(np.random.default_rng(1), np.nan_to_num(tree.limits), 12)
    flat = tree.positions(q)
    assert tree.positions(q[0]).shape == (len(tree.names), 3)
    np.testing.assert_array_equal(tree.positions(q.reshape(3, 4, -1)).reshape(flat.shape), flat)
    assert tree.positions(q[:0]).shape == (0, len(tree.names), 3)
    traced = jax.jit(tree.positions)(jnp.asarray(q, jnp.float32))
    assert traced.dtype == jnp.float32
    np.testing.assert_allclose(traced, flat, atol=1e-6)


@pytest.mark.parametrize("seed", [1, 6])
def test_automatic_derivatives_by_finite_differences(seed):
    tree = random_tree(seed)[3]
    q = limited_poses(np.random.default_rng(seed), tree.limits, 1)[0]
    steps = 1e-6 * np.eye(len(q))
    differences = (tree.positions(q + steps) - tree.positions(q - steps)) / 2e-6
    with float64():
        exact = jax.jit(jax.jacfwd(tree.positions))(jnp.asarray(q))
    np.testing.assert_allclose(exact, np.moveaxis(differences, 0, -1), atol=1e-8)
    assert abs(differences).max() > 0.1


@pytest.mark.parametrize("seed", [1, 5, 8])
def test_points_with_derivatives(seed):
    """Points, Jacobian and curvature against forward kinematics and against differences of it."""
    _, _, _, tree = random_tree(seed)
    rng = np.random.default_rng(seed)
    names = tree.names[:2] + tree.names[-3:]  # the first is on the palm: nothing moves it
    at = [tree.names.index(name) for name in names]
    motion_of = PointKinematics(tree, names)
    order = list(motion_of.order)
    assert sorted(order) == sorted(joint.source for joint in tree.joints)
    q, force = limited_poses(rng, tree.limits, 1)[0], rng.standard_normal((len(names), 3))
    step = 1e-6
    around = [q + sign * step * e for e in np.eye(len(q))[order] for sign in (1, -1)]
    with float64():

        def derivatives(q: Any) -> Any:
            motion = motion_of(q)
            jacobian = motion_of.jacobian(motion)
            some = motion_of.jacobian(motion, np.array([2, 1]))
            along = motion.along(motion.points[-1:], jnp.asarray(force[-1:]))
            total = motion_of.moves.T @ moments(motion.points, force)
            return motion.points, jacobian, some, along, motion_of.derivatives(motion, total)

        program = jax.jit(derivatives)
        found, jacobian, some, along, (slope, bend) = program(q)
        slopes = np.array([program(p)[-1][0] for p in around])
        jacobian, some, along = (np.asarray(each) for each in (jacobian, some, along))
    points = tree.positions(np.stack(around))[:, at]
    np.testing.assert_allclose(found, tree.positions(q)[at], atol=1e-12)
    velocities = (points[0::2] - points[1::2]) / (2 * step)
    np.testing.assert_allclose(jacobian, np.moveaxis(velocities, 0, 1), atol=1e-8)
    hessian = (slopes[0::2] - slopes[1::2]) / (2 * step)
    np.testing.assert_allclose(bend, hessian, atol=1e-8)
    np.testing.assert_array_equal(some, jacobian[np.array([2, 1])])
    np.testing.assert_allclose(slope, np.einsum("fc,fjc->j", force, jacobian), atol=1e-12)
    carried = motion_of.moves[-1]
    np.testing.assert_allclose(
        np.where(carried, along[0], 0.0), jacobian[-1] @ force[-1], atol=1e-12
    )
    assert not np.asarray(jacobian[0]).any()
    assert abs(hessian).max() > 1e-3


@pytest.mark.parametrize("joint", ['type="ball"', 'type="free"'])
def test_ball_and_free_joints_are_refused(joint):
    where = "palm" if "ball" in joint else "worldbody"
    inner = f'<body name="tip"><joint name="loose" {joint}/><geom size="0.1"/></body>'
    text = (
        f'<mujoco><worldbody>{inner if where == "worldbody" else ""}<body name="palm">'
        f'<geom size="0.1"/>{inner if where == "palm" else ""}</body></worldbody></mujoco>'
    )
    model = mujoco.MjModel.from_xml_string(text)
    palm = 0 if where == "worldbody" else model.body("palm").id
    with pytest.raises(HandModelError, match="'loose' is a ball or free joint"):
        build_tree(model, palm, {"p": (model.body("tip").id, np.zeros(3))})


def test_a_point_that_does_not_hang_from_the_palm_is_refused():
    model = random_model(0)
    leaf = next(b for b in range(1, model.nbody) if not (model.body_parentid == b).any())
    with pytest.raises(HandModelError, match="'root' does not hang from the palm"):
        build_tree(model, leaf, {"p": (model.body("root").id, np.zeros(3))})
    other = next(
        b for b in range(1, model.nbody) if b != leaf and not (model.body_parentid == b).any()
    )
    with pytest.raises(HandModelError, match="choose a palm further up the tree"):
        build_tree(model, leaf, {"p": (other, np.zeros(3))})
