"""Simulated hands: they follow, they stop where they should, and they do not come apart."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from live_time import until
from ticks import make_tick

from smooth_operator.errors import ConfigError, SinkError, UnknownNameError
from smooth_operator.hands.hand import Hand, load_hand_spec
from smooth_operator.hands.registry import hand_names, load_hand
from smooth_operator.lab.discovery import discover
from smooth_operator.simulation.physics import HandPhysics
from smooth_operator.teleop.components import build_sink
from smooth_operator.teleop.sinks.simulation import Simulation
from smooth_operator.types import Side

BUILT_IN = [
    "mimic_p050", "shadow_hand", "allegro_hand", "leap_hand", "wuji_hand",
    "shadow_dexee", "orca_v2", "ability_hand", "inspire_hand", "schunk_svh",
]  # fmt: skip


@pytest.fixture(autouse=True)
def elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """MuJoCo writes its warnings into the working folder."""
    monkeypatch.chdir(tmp_path)


def test_all_built_in_hands_are_tried() -> None:
    assert set(BUILT_IN) <= set(hand_names())


@pytest.mark.parametrize("name", BUILT_IN)
def test_follows_a_sine(name: str) -> None:
    """1 Hz, up to 0.3 rad, joint by joint where it touches nothing; left and right in turn."""
    hand = load_hand(name, "left" if BUILT_IN.index(name) % 2 else "right")
    physics = HandPhysics(hand)
    low, high = hand.limits.T
    amplitude = np.minimum(0.3, (high - low) / 4)
    centre = np.clip(hand.neutral, low + amplitude, high - amplitude)
    free = 0
    for joint in range(len(hand.actuated)):
        pose = hand.neutral.copy()
        pose[joint] = centre[joint]
        physics.command(hand.full_configuration(pose))
        physics.advance(0.3)
        worst, touched = 0.0, False
        for k in range(110):
            pose[joint] = centre[joint] + amplitude[joint] * np.sin(2 * np.pi * 0.01 * k)
            target = hand.full_configuration(pose)
            physics.command(target)
            assert physics.advance(0.01)
            touched |= physics.contacts > 0
            if k > 10:
                worst = max(worst, float(np.abs(physics.positions - target).max()))
        if not touched:
            free += 1
            assert np.degrees(worst) < 2.0, hand.actuated_names[joint]
    assert free >= 0.5 * len(hand.actuated)


@pytest.mark.parametrize("name", BUILT_IN)
def test_a_minute_of_random_commands(name: str) -> None:
    """Twelve jumps a second to anywhere, fingers through fingers: it stays whole and in bounds."""
    hand = load_hand(name, "right" if BUILT_IN.index(name) % 2 else "left")
    physics = HandPhysics(hand)
    rng = np.random.default_rng(0)
    low, high = hand.joint_limits.T
    outside, fastest = 0.0, 0.0
    for _ in range(720):
        physics.command(hand.full_configuration(rng.uniform(hand.limits[:, 0], hand.limits[:, 1])))
        physics.advance(1 / 12)
        q = physics.positions
        outside = max(outside, float(np.maximum(q - high, low - q).max()))
        fastest = max(fastest, float(np.abs(physics.velocities).max()))
    assert physics.time == pytest.approx(60.0, abs=0.01)
    assert physics.resets == 0
    assert np.degrees(outside) < 15.0
    assert fastest < 100.0


def test_fingers_stop_at_fingers() -> None:
    """A thumb that is sent through the fist stays outside; without contacts it would arrive."""
    hand = load_hand("mimic_p050")
    physics = HandPhysics(hand)
    fist = hand.limits[:, 1].copy()
    thumb = [i for i, n in enumerate(hand.actuated_names) if n.startswith("thumb")]
    fist[thumb] = hand.neutral[thumb]
    physics.command(hand.full_configuration(fist))
    physics.advance(1.0)
    closed = fist.copy()
    closed[thumb] = hand.limits[thumb].max(axis=1)
    physics.command(hand.full_configuration(closed))
    physics.advance(1.0)
    assert physics.contacts > 0
    assert np.degrees(np.abs(physics.positions - hand.full_configuration(closed)).max()) > 5.0


def test_motors_give_what_their_makers_state() -> None:
    assert np.all(load_hand("leap_hand").torques == 0.28)
    shadow = load_hand("shadow_hand")
    torques = dict(zip(shadow.actuated_names, shadow.torques, strict=True))
    assert (torques["rh_THJ5"], torques["rh_FFJ3"]) == (5.0, 2.0)
    mimic = load_hand("mimic_p050")
    assert np.isnan(mimic.torques).all()
    weak = load_hand_spec(replace(mimic.spec, torque={"index_mcp2pp": 0.01}))
    with pytest.raises(UnknownNameError, match="elbow"):
        load_hand_spec(replace(mimic.spec, torque={"elbow": 1.0}))
    joint = mimic.actuated_names.index("index_mcp2pp")
    turned = []
    for hand in (mimic, weak):
        physics = HandPhysics(hand)
        start = physics.positions[list(hand.actuated)][joint]
        pose = hand.neutral.copy()
        pose[joint] = hand.limits[joint, 1]
        physics.command(hand.full_configuration(pose))
        physics.advance(0.04)
        turned.append(physics.positions[list(hand.actuated)][joint] - start)
    # 0.01 N m turns a rotor of 5e-4 kg m^2 by at most 16 mrad in 40 ms
    assert turned[0] > 0.1
    assert 0.0 < turned[1] < 0.5 * (0.01 / 5e-4) * 0.04**2


def test_critically_damped_and_back_at_rest() -> None:
    hand = load_hand("allegro_hand")
    physics = HandPhysics(hand)
    start = hand.neutral
    step = start.copy()
    step[1] += 0.4
    physics.command(hand.full_configuration(step))
    path = []
    for _ in range(200):
        physics.advance(0.002)
        path.append(physics.positions[hand.actuated[1]])
    assert max(path) < step[1] + 0.02  # no overshoot to speak of
    assert path[-1] == pytest.approx(step[1], abs=0.005)
    reached = next(i for i, q in enumerate(path) if q > start[1] + 0.9 * 0.4)
    assert 0.02 < reached * 0.002 < 0.1


@pytest.mark.parametrize("gravity", [False, True])
def test_gravity_bends_it_a_little(gravity: bool) -> None:
    hand = load_hand("leap_hand")
    physics = HandPhysics(hand, gravity=gravity)
    physics.advance(2.0)
    sag = np.degrees(np.abs(physics.positions - hand.full_configuration(hand.neutral)).max())
    assert (0.02 < sag < 3.0) if gravity else sag < 0.01


def test_bad_commands_change_nothing_and_hold_stands() -> None:
    hand = load_hand("mimic_p050")
    physics = HandPhysics(hand)
    physics.advance(0.5)
    before = physics.positions
    physics.command(np.full(len(hand.joint_names), np.nan))
    physics.advance(0.5)
    np.testing.assert_allclose(physics.positions, before, atol=1e-3)
    physics.command(np.full(len(hand.joint_names), 99.0))  # as far as the limits go
    physics.advance(0.05)
    physics.hold()
    at = physics.positions
    physics.advance(1.0)
    assert np.degrees(np.abs(physics.positions - at).max()) < 25.0
    assert (physics.positions <= hand.joint_limits[:, 1] + 0.05).all()


def test_physics_that_comes_apart_is_set_back() -> None:
    hand = load_hand("mimic_p050")
    physics = HandPhysics(hand)
    physics._data.qvel[:] = 1e5
    assert physics.advance(0.01) is False
    assert physics.resets == 1
    assert physics.advance(0.1) is True
    np.testing.assert_allclose(physics.positions, hand.full_configuration(hand.neutral), atol=0.01)
    physics._data.qpos[:] = np.nan
    assert physics.advance(0.01) is False
    assert physics.advance(0.1) is True
    assert np.isfinite(physics.positions).all()


def test_an_arm_is_taken_out(tmp_path: Path) -> None:
    from dataclasses import replace

    import mujoco

    bare = load_hand("mimic_p050")
    palm = mujoco.MjSpec.from_file(str(bare.spec.model))
    body = palm.worldbody.first_body()
    shoulder = body.add_joint()
    shoulder.name, shoulder.axis = "shoulder", (0, 0, 1)
    palm.compile()
    (tmp_path / "arm.xml").write_text(palm.to_xml())
    hand = load_hand_spec(replace(bare.spec, model=tmp_path / "arm.xml"))
    physics = HandPhysics(hand, gravity=True)
    assert physics._built.model.nv == len(hand.joint_names)
    physics.advance(1.0)
    assert np.isfinite(physics.positions).all()


@pytest.mark.shared
@pytest.mark.parametrize(
    "file",
    [
        "hands/orca_v2_hand/right_hand_kinematics_only.xml",
        "hands/shadow_hand/right_hand.xml",
        "hands_urdf/leap_hand/leap_hand_right.urdf",
        "hands_urdf/schunk_hand/schunk_svh_hand_left.urdf",
    ],
)
def test_vendors_models_stay_whole(shared: Path, file: str) -> None:
    """With their own defaults, actuators, tendons, meshes that are there or missing."""
    found = next(iter(shared.glob(file)), None)
    if found is None:
        pytest.skip(f"no {file}")
    hand = load_hand_spec(discover(found).spec)
    physics = HandPhysics(hand)
    rng = np.random.default_rng(0)
    for _ in range(30):
        physics.command(hand.full_configuration(rng.uniform(hand.limits[:, 0], hand.limits[:, 1])))
        assert physics.advance(0.1)
    pose = hand.neutral + 0.1 * (hand.limits.mean(axis=1) - hand.neutral)
    fresh = HandPhysics(hand)
    fresh.command(hand.full_configuration(pose))
    fresh.advance(1.0)
    assert np.degrees(np.median(np.abs(fresh.positions - hand.full_configuration(pose)))) < 1.0


@pytest.mark.parametrize("text", ["mujoco:rate=50", "mujoco:bandwidth=100", "mujoco:bandwidth=0"])
def test_bad_settings(text: str) -> None:
    with pytest.raises(ConfigError, match="mujoco"):
        build_sink(text)


def test_sink_follows_in_real_time_and_holds_when_commands_stop() -> None:
    hands: dict[Side, Hand] = {s: load_hand("mimic_p050", s) for s in ("right", "left")}
    sim = Simulation()
    assert sim.state("right") is None
    with pytest.raises(SinkError, match="not open"):
        sim.send(make_tick(hands["right"]))
    sim.open(hands, {})
    cpu, start = time.process_time(), time.perf_counter()
    for i in range(100):
        for hand in hands.values():
            sim.send(make_tick(hand, i // 4))
        time.sleep(0.01)
    last = make_tick(hands["left"], 24)
    time.sleep(0.3)

    def arrived() -> bool:
        """In real time: the hand is where it was sent, and its state is a present one."""
        state = sim.state("left")
        assert state is not None
        assert state.time <= time.perf_counter()
        age = time.perf_counter() - state.time
        off = np.degrees(np.abs(state.positions - last.command.positions).max())
        return bool(off < 10.0 and age < 0.2)

    until(arrived)
    busy = (time.process_time() - cpu) / (time.perf_counter() - start)
    assert busy < 0.25 + 0.2  # both hands, and this test's own share
    sim.send(make_tick(hands["left"], 60))  # a long way off
    time.sleep(0.02)
    for k in range(5):
        sim.stalled(0.2 + 0.05 * k)
        time.sleep(0.05)
    time.sleep(0.2)
    halted, again = sim.state("left"), None
    time.sleep(0.1)
    again = sim.state("left")
    assert halted is not None
    assert again is not None
    np.testing.assert_allclose(again.positions, halted.positions, atol=1e-3)
    sim.close()
    sim.close()
    assert sim.state("left") is None
    assert sim.note == ""


def test_sink_tells_of_physics_that_came_apart() -> None:
    hand = load_hand("mimic_p050")
    sim = Simulation()
    sim.open({"right": hand}, {})
    assert sim._world is not None
    sim._world.physics["right"]._data.qvel[:] = 1e5
    end = time.perf_counter() + 5.0
    while not sim.note and time.perf_counter() < end:
        time.sleep(0.01)
    assert "came apart" in sim.note
    sim.send(make_tick(hand, 3))
    state = sim.state("right")
    assert state is not None
    assert np.isfinite(state.positions).all()
    sim.close()
