"""Joints that follow another by a polynomial, from the model file to commands and drivers."""

import json
from dataclasses import replace
from pathlib import Path

import jax
import mujoco
import numpy as np
import pytest
from linkage_hands import polynomial_hand
from test_hands import equality
from test_objective import plain_cost, random_goal
from trees import float64, limited_poses, pincer

import smooth_operator as so
from smooth_operator.errors import HandModelError
from smooth_operator.hand_discovery.discover import discover
from smooth_operator.hand_files.spec_writer import write_hand_spec
from smooth_operator.hands.hand import Hand, load_hand_spec
from smooth_operator.hands.spec import Coupling
from smooth_operator.hands.spec_file import read_hand_spec
from smooth_operator.hands.transmission import leader_range
from smooth_operator.retargeting.sbr.published import ObjectiveConfig
from smooth_operator.retargeting.sbr.sampled import SampledObjective
from smooth_operator.retargeting.trajectory_retargeter import fingertips, joint_motion
from smooth_operator.simulation.physics import HandPhysics
from smooth_operator.teleop.runtime.limiter import Limiter
from smooth_operator.teleop.runtime.settings import LimitsConfig
from smooth_operator_devices.hands.actuator_map import Actuator, ActuatorMap, BoundMap

pytestmark = pytest.mark.usefixtures("elsewhere")


@pytest.fixture
def hand(tmp_path: Path) -> Hand:
    """pip = 0.75 mcp + 0.2 mcp^2 in four fingers."""
    return polynomial(tmp_path)


def polynomial(folder: Path, polycoef: str = "0 0.75 0.2 0 0") -> Hand:
    path = folder / "curved.xml"
    path.write_text(polynomial_hand(polycoef))
    return load_hand_spec(discover(path).spec)


@pytest.mark.parametrize(
    "text",
    [
        '<joint joint1="i3" joint2="i2" polycoef="0.1 0.4 -0.2 0.05 0.03"/>',
        equality("i2", "i3", 0.1, 0.5),  # i3 follows by the inverse
    ],
)
def test_an_equality_is_exact(tmp_path, text):
    """Also with reference positions: held against MuJoCo's own residual."""
    spec = pincer(
        tmp_path, equality=text, i2='ref="0.3" range="-1 2"', i3='ref="-0.2" range="-4 6"'
    )
    hand = so.load_hand(spec)
    assert hand.couplings[0].joint == "i3"
    data = mujoco.MjData(hand.model)
    for i2 in np.linspace(-1, 2, 7):
        data.qpos[:] = hand.full_configuration([0.1, 0.2, 0.3, i2])
        mujoco.mj_forward(hand.model, data)
        residual = data.efc_pos[data.efc_type == mujoco.mjtConstraint.mjCNSTR_EQUALITY]
        np.testing.assert_allclose(residual, [0.0], atol=1e-12)


def test_a_follower_of_a_polynomial_follower_has_the_composed_polynomial(tmp_path):
    text = equality("i3", "i2", 0.1, 0.5, 0.3) + equality("i2", "i1", -0.2, 0.5, 0.1)
    hand = so.load_hand(
        pincer(tmp_path, equality=text, actuated=("t1", "t2", "i1"), i2="", i3='range="-9 9"')
    )
    q = np.random.default_rng(1).uniform(-1, 1, (20, 3))
    i2 = -0.2 + 0.5 * q[:, 2] + 0.1 * q[:, 2] ** 2
    every = hand.full_configuration(q)
    np.testing.assert_allclose(every[:, 3], i2, atol=1e-12)
    np.testing.assert_allclose(every[:, 4], 0.1 + 0.5 * i2 + 0.3 * i2**2, atol=1e-12)


def test_a_motor_on_the_follower_leaves_the_leader_commanded(tmp_path):
    text = equality("i3", "i2", 0.1, 0.0, 0.3)  # i2 and -i2 give the same i3: no inverse
    hand = so.load_hand(
        pincer(tmp_path, equality=text, actuated=("t1", "t2", "i1", "i3"), i3='range="-3 0.4"')
    )
    assert hand.actuated_names == ("t1", "t2", "i1", "i2")
    assert hand.couplings == (Coupling.of("i3", "i2", (0.1, 0.0, 0.3)),)
    np.testing.assert_allclose(hand.limits[-1], [-1, 1])  # within the limits of i3


def test_limits_are_narrowed_by_polynomial_followers(tmp_path):
    text = equality("i3", "i2", 0.0, 0.0, 0.5)  # i2^2 / 2
    hand = so.load_hand(pincer(tmp_path, equality=text, i3='range="-0.1 0.32"'))
    np.testing.assert_allclose(hand.limits[-1], [-0.8, 0.8])
    # of two parts of the range the wider one
    assert leader_range((0, 0, 1.0), np.array([-1, 3.0]), np.array([0.25, 9])) == pytest.approx(
        (0.5, 3.0)
    )
    low, high = leader_range((0, 1.0, 0, 1.0), np.array([-np.inf, np.inf]), np.array([-2.0, 10]))
    assert (low, high) == pytest.approx((-1, 2))
    low, high = leader_range((5.0, 0, 1.0), np.array([-1, 1.0]), np.array([0, 1.0]))
    assert low > high


def test_derivatives_agree_with_finite_differences(hand):
    q = np.random.default_rng(0).uniform(*hand.limits.T)
    step = 1e-6
    nudged = q + step * np.eye(len(q))
    expected = (hand.full_configuration(nudged) - hand.full_configuration(q)).T / step
    np.testing.assert_allclose(hand.transmission.slopes(q), expected, atol=1e-5)
    tips = lambda poses: hand.tips(hand.full_configuration(poses))  # noqa: E731
    with float64():
        every, slopes = joint_motion(hand, jax.numpy.asarray(q))
        np.testing.assert_allclose(every, hand.full_configuration(q), atol=1e-12)
        np.testing.assert_allclose(slopes, hand.transmission.slopes(q), atol=1e-12)
        points, jacobian = fingertips(hand, jax.numpy.asarray(q))
    np.testing.assert_allclose(points, tips(q), atol=1e-9)
    expected = np.moveaxis(tips(nudged) - tips(q), 0, -1) / step
    np.testing.assert_allclose(jacobian, expected, atol=1e-6)
    rows = hand.full_configuration_rows([np.asarray(row) for row in nudged.T])
    np.testing.assert_allclose(np.stack(rows, axis=-1), hand.full_configuration(nudged), atol=1e-12)


def test_derivatives_of_the_objective_are_exact(hand):
    config = ObjectiveConfig(transition=0.013)
    objective, goal = SampledObjective(hand, config), random_goal(hand, 4)
    (q,), step = limited_poses(np.random.default_rng(5), hand.limits, 1), 1e-6
    with float64():
        derivatives = jax.jit(objective.value_grad_hess)
        value, gradient, hessian = derivatives(q, goal)
        batch = objective([jax.numpy.asarray(row)[None] for row in q], goal, within_limits=False)
        nudges = step * np.eye(len(q))
        slope = [derivatives(q + e, goal)[1] - derivatives(q - e, goal)[1] for e in nudges]
    np.testing.assert_allclose(value, plain_cost(hand, config, q, goal), rtol=1e-12)
    np.testing.assert_allclose(batch, value, rtol=1e-12)
    ahead, behind = (
        np.array([plain_cost(hand, config, q + sign * e, goal) for e in nudges]) for sign in (1, -1)
    )
    np.testing.assert_allclose(gradient, (ahead - behind) / (2 * step), atol=1e-8)
    np.testing.assert_allclose(hessian, np.stack(slope) / (2 * step), atol=1e-6)


def test_a_method_retargets_and_metrics_measure(hand):
    """``smooth`` does so as well: ``test_loops.py``."""
    recording = so.SyntheticOperator(seed=5, rate_hz=50).record(duration=1.0)
    commands, _ = so.Retargeter(hand, method="joint_angle").run(recording)
    every = dict(zip(commands.joint_names, commands.joint_positions.T, strict=True))
    for finger in hand.fingers[1:]:
        mcp, pip = every[f"{finger}_mcp"], every[f"{finger}_pip"]
        np.testing.assert_allclose(pip, 0.75 * mcp + 0.2 * mcp**2, atol=1e-9)
    assert np.ptp(every["index_mcp"]) > 0.1
    values = so.evaluate(so.assemble_trace(recording, commands, hand, reach_samples=200))
    assert values["cosine_similarity"] > 0.6


def test_discovery_reads_the_polynomial_and_it_survives_a_spec_file(hand, tmp_path):
    assert {c.joint: c.coefficients for c in hand.couplings} == {
        f"{finger}_pip": (0.0, 0.75, 0.2) for finger in hand.fingers[1:]
    }
    given = Coupling.of("index_pip", "index_mcp", (0.05, 0.6, 0.0, 0.1, 0.0))
    assert given.higher == (0.0, 0.1)
    spec = replace(hand.spec, couplings=(given,))
    write_hand_spec(spec, tmp_path / "hand.toml")
    assert "coefficients = [0.05, 0.6, 0.0, 0.1]" in (tmp_path / "hand.toml").read_text()
    again = read_hand_spec(tmp_path / "hand.toml")
    assert again.couplings == (given,)
    q = hand.neutral + 0.1
    mcp = q[hand.actuated_names.index("index_mcp")]
    at = hand.joint_names.index("index_pip")
    assert load_hand_spec(again).full_configuration(q)[at] == pytest.approx(
        0.05 + 0.6 * mcp + 0.1 * mcp**3
    )


@pytest.mark.parametrize("text", ["[]", "[0.1]", "[0, 1, 2, 3, 4, 5]", '"0 1"', "[0, nan]"])
def test_bad_coefficients_in_a_spec_file_are_refused(hand, tmp_path, text):
    write_hand_spec(hand.spec, tmp_path / "hand.toml")
    with (tmp_path / "hand.toml").open("a") as file:
        file.write(f'[couplings.index_pip]\nfollows = "index_mcp"\ncoefficients = {text}\n')
    with pytest.raises(HandModelError, match=r"couplings\.index_pip\.coefficients"):
        read_hand_spec(tmp_path / "hand.toml")


def test_hands_add_couples_by_a_polynomial(run, tmp_path, own_hands):
    path = tmp_path / "curved.xml"
    path.write_text(polynomial_hand())
    status, out, err = run(
        "hands", "add", str(path), "--couple", "index_pip=index_mcp:0.1,0.5,0,0.2", "--json"
    )
    assert status == 0, err
    rows = {row["joint"]: row for row in json.loads(out)["coupled"]}
    row = rows["index_pip"]
    assert (row["offset"], row["multiplier"], row["higher"]) == (0.1, 0.5, [0.0, 0.2])
    assert rows["ring_pip"]["higher"] == [0.2]


def test_formulas_of_couplings():
    of = lambda *c: Coupling.of("a", "b", c).formula  # noqa: E731
    assert of(0, 1) == "b"
    assert of(-0.05, 1.06) == "1.06 b - 0.05"
    assert of(0.1, -1, 0, 0.25) == "0.25 b^3 - 1 b + 0.1"
    assert of(0, 0) == "0"
    with pytest.raises(HandModelError, match="one to 5 finite"):
        Coupling.of("a", "b", (0, 1, 2, 3, 4, 5))


def test_the_limiter_keeps_the_speed_and_acceleration_of_polynomial_followers(tmp_path):
    hand = polynomial(tmp_path, "0 0.2 0.6 0 0")
    limits, rng = LimitsConfig(velocity=6.0, acceleration=60.0), np.random.default_rng(1)
    limiter = Limiter(hand, limits)
    q = [limiter.q]
    for k in range(600):
        if k % 40 == 0:
            target = np.where(rng.random(len(q[0])) < 0.5, *hand.limits.T)
        q.append(limiter.step(target, 0.01))
    every = hand.full_configuration(np.array(q))
    speed = np.diff(every, axis=0) / 0.01
    assert np.abs(speed).max() <= limits.velocity * (1 + 1e-9)
    assert np.abs(np.diff(speed, axis=0)).max() / 0.01 <= limits.acceleration * 1.01
    assert (np.ptp(every, axis=0) > 0.5 * np.ptp(hand.joint_limits, axis=1)).mean() > 0.5


def test_a_driver_reads_polynomial_followers_back(hand):
    line = ((-2.0, 0.0), (2.0, 1000.0))
    # motors at the PIP joints of index and middle, else at the joints that lead
    moved = {name: name.replace("mcp", "pip") for name in ("index_mcp", "middle_mcp")}
    motors = [moved.get(name, name) for name in hand.actuated_names]
    table = ActuatorMap(
        driver="test",
        hand=hand.name,
        side="right",
        unit="step",
        actuators=tuple(Actuator(name, {name: 1.0}, line, (0, 1000)) for name in motors),
    )
    bound = BoundMap(table, hand)
    q = hand.full_configuration(hand.limits.mean(axis=1))
    commands = bound.commands(bound.angles(q))
    np.testing.assert_allclose(bound.joints(commands), q, atol=1e-9)
    speeds = np.random.default_rng(0).uniform(-1, 1, len(motors))
    later = hand.full_configuration(hand.limits.mean(axis=1) + 1e-6 * speeds)
    rates = (bound.commands(bound.angles(later)) - commands) / 1e-6
    np.testing.assert_allclose(
        bound.joint_velocities(commands, rates), (later - q) / 1e-6, atol=1e-4
    )
    commands[motors.index("index_pip")] = np.nan
    lost = np.isnan(bound.joints(commands))
    assert {hand.joint_names[i] for i in np.flatnonzero(lost)} == {"index_mcp", "index_pip"}


def test_the_simulation_follows_the_polynomial(tmp_path):
    hand = polynomial(tmp_path, "0.05 0.4 0.3 0.05 -0.02")
    physics = HandPhysics(hand)
    for share in (0.3, 0.6):
        pose = hand.limits[:, 0] + share * np.ptp(hand.limits, axis=1)
        pose[-2:] = hand.neutral[-2:]  # the thumb stays out of the way
        physics.command(hand.full_configuration(pose))
        physics.advance(1.0)
        np.testing.assert_allclose(physics.positions, hand.full_configuration(pose), atol=0.02)
