"""The LeRobot robot: keys, limits and slow approach, on a simulated hand and on drivers."""

import signal
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from fake_hand import FakeHand, FakeHandSink, write_fake_table
from free_port import free_port
from lerobot_stand_in import ROBOT, plugins
from live_time import PATIENCE_S

from smooth_operator import Hand, load_hand
from smooth_operator.signals import ENDING


@pytest.fixture
def plugin() -> Iterator[SimpleNamespace]:
    with plugins():
        import lerobot_robot_smooth_hand as package
        from lerobot.utils import errors

        yield SimpleNamespace(package=package, errors=errors)


@pytest.fixture
def robot(plugin: SimpleNamespace) -> Iterator[Callable[..., Any]]:
    made = []

    def make(**settings: Any) -> Any:
        made.append(plugin.package.SmoothHand(plugin.package.SmoothHandConfig(**settings)))
        return made[-1]

    yield make
    for device in made:
        if device.is_connected:
            device.disconnect()


@pytest.fixture
def fake(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, plugin: SimpleNamespace) -> FakeHandSink:
    """What ``--robot.sinks`` names then: a driver whose hand is in memory."""
    hand = load_hand("mimic_p050")
    table = write_fake_table(tmp_path / "fake.toml", hand.actuated_names)
    sink = FakeHandSink(port=f"fake-{tmp_path.name}", table=str(table))
    module = sys.modules[f"{ROBOT}.smooth_hand"]
    monkeypatch.setattr(module, "build_sink", lambda text: sink)
    return sink


def goal(hand: Hand, share: float, factor: float = 1.0) -> dict[str, float]:
    """An action: each joint at this share of its range."""
    low, high = hand.limits.T
    values = factor * (low + share * (high - low))
    return dict(zip((f"{name}.pos" for name in hand.actuated_names), values.tolist(), strict=True))


def go(device: Any, action: dict[str, float], near: float) -> list[Any]:
    """Send an action until the hand has come near to it; what was sent on the way."""
    sent, end = [], time.perf_counter() + PATIENCE_S
    while time.perf_counter() < end:
        sent.append(device.send_action(action))
        seen = device.get_observation()
        if max(abs(seen[key] - value) for key, value in action.items()) < near:
            return sent
        time.sleep(0.01)
    pytest.fail(f"the hand did not come to {action}, but to {seen}")


def test_the_wrist_joints_of_a_hand_have_keys_unless_an_arm_follows_the_wrist(robot):
    fingers = [f"{name}.pos" for name in load_hand("orca_v2").actuated_names]
    own = robot(hand="orca_v2")
    assert list(own.action_features) == [*fingers, "right_wrist.pos"]
    assert list(own.observation_features) == [*fingers, "right_wrist.pos"]
    for off in ({"wrist": "quaternion"}, {"wrist_joints": False}):
        assert "right_wrist.pos" not in robot(hand="orca_v2", **off).action_features


def test_a_simulated_hand_goes_slowly_to_the_first_action_and_is_measured(robot, plugin):
    hand = load_hand("mimic_p050")
    device = robot(unit="radians")
    keys = [f"{name}.pos" for name in hand.actuated_names]
    assert list(device.action_features) == list(device.observation_features) == keys
    with pytest.raises(plugin.errors.DeviceNotConnectedError):
        device.get_observation()
    device.connect()
    start = device.get_observation()
    np.testing.assert_allclose(list(start.values()), hand.neutral, atol=0.02)
    sent = go(device, goal(hand, 0.6), near=0.05)
    path = np.array([list(row.values()) for row in sent])
    assert np.abs(path[0] - list(start.values())).max() < 0.03
    low, high = hand.limits.T
    assert np.all((path >= low) & (path <= high))

    with pytest.raises(ValueError, match=r"lacks index_mcp2pp\.pos"):
        device.send_action({key: 0.0 for key in keys if key != "index_mcp2pp.pos"})
    with pytest.raises(ValueError, match="not numbers"):
        device.send_action(dict.fromkeys(keys, float("nan")))
    beyond = device.send_action({**dict.fromkeys(keys, 100.0), "a.key": 1.0})
    assert list(beyond) == keys
    assert np.all(np.array(list(beyond.values())) <= high + 1e-9)
    with pytest.raises(plugin.errors.DeviceAlreadyConnectedError):
        device.connect()
    device.disconnect()
    assert not device.is_connected
    with pytest.raises(plugin.errors.DeviceNotConnectedError):
        device.send_action(start)


class PerfectSink:
    """A sink that takes each command at once and measures it; it has no guard of its own."""

    label, note, measures = "perfect", "", True

    def __init__(self, hand: Hand) -> None:
        self.hand, self.positions = hand, hand.full_configuration(hand.neutral)

    def use_arms(self, arms: object) -> None:
        pass

    def open(self, hands: object, configuration: object) -> None:
        pass

    def close(self) -> None:
        pass

    def send(self, tick: Any) -> None:
        self.positions = np.array(tick.command.joint_positions)

    def state(self, side: str) -> Any:
        return SimpleNamespace(time=0.0, positions=self.positions)


@pytest.fixture
def at_30_hz(robot, monkeypatch):
    """A robot on a sink without a guard, on a clock that each action moves by 1/30 s."""
    hand, clock = load_hand("mimic_p050"), SimpleNamespace(now=1000.0)
    perfect = PerfectSink(hand)
    monkeypatch.setattr(sys.modules[f"{ROBOT}.smooth_hand"], "build_sink", lambda text: perfect)
    ports = sys.modules[f"{ROBOT}.hand_port"]
    monkeypatch.setattr(ports, "time", SimpleNamespace(perf_counter=lambda: clock.now))

    def make(**settings: Any) -> Any:
        device = robot(sinks=["perfect"], unit="radians", **settings)

        def send(share: float, times: int = 1) -> None:
            for _ in range(times):
                clock.now += 1 / 30
                device.send_action(goal(hand, share))

        return SimpleNamespace(device=device, send=send, sink=perfect, clock=clock, hand=hand)

    return make


def test_a_pause_ends_in_a_slow_start_from_rest(at_30_hz):
    """The speed of before the pause is gone: it was kept with low limits of acceleration."""
    run = at_30_hz(acceleration=20.0)
    run.device.connect()
    run.send(0.2, 120)
    run.send(1.0, 3)  # it moves
    before = run.sink.positions
    run.clock.now += 10.0
    run.send(0.2)
    assert np.abs(run.sink.positions - before).max() <= 0.5 / 30 + 1e-9
    assert ((run.sink.positions - before) <= 1e-9).all()  # back at once, not on as before


def test_a_quick_reconnect_starts_slowly_where_the_hand_is(at_30_hz):
    run = at_30_hz()
    run.device.connect()
    run.send(0.2, 120)
    run.device.disconnect()
    low, high = run.hand.limits.T
    moved = run.hand.full_configuration(low + 0.9 * (high - low))
    run.sink.positions = moved  # by a person
    run.clock.now += 0.2
    run.device.connect()
    run.send(0.2)
    assert np.abs(run.sink.positions - moved).max() <= 0.5 / 30 + 1e-9


def test_a_signal_is_ctrl_c_while_it_is_connected(robot):
    """After which LeRobot disconnects: the hand comes to rest."""
    before = [signal.getsignal(number) for number in ENDING]
    device = robot()
    device.connect()
    with pytest.raises(KeyboardInterrupt):
        signal.raise_signal(signal.SIGTERM)
    device.disconnect()
    assert [signal.getsignal(number) for number in ENDING] == before
    handler = signal.signal(signal.SIGTERM, signal.SIG_IGN)  # the program's own
    try:
        device.connect()
        assert signal.getsignal(signal.SIGTERM) is signal.SIG_IGN
    finally:
        signal.signal(signal.SIGTERM, handler)


def test_both_hands_have_keys_of_their_own_and_joints_may_be_chosen(robot):
    device = robot(side="both", joints={"index_mcp2pp": "index"}, unit="degrees")
    assert list(device.action_features) == ["right_index.pos", "left_index.pos"]
    device.connect()
    go(device, {"right_index.pos": 60.0, "left_index.pos": 10.0}, near=3.0)
    hand = load_hand("mimic_p050")
    other = hand.joint_names.index("middle_mcp2pp")
    measured = device._sinks[0].state("right").positions[other]
    assert abs(measured - hand.full_configuration(hand.neutral)[other]) < 0.1


def test_a_driver_is_moved_and_its_currents_observed(robot, fake, plugin):
    hand = load_hand("mimic_p050")
    device = robot(unit="degrees", currents=True, sinks=["fake"], stale_s=30.0)
    currents = [f"m{k}.current" for k in range(len(hand.actuated))]
    assert list(device.observation_features)[-len(currents) :] == currents
    device.connect()
    assert set(device.get_observation()) == set(device.observation_features)
    low, high = np.clip(np.degrees(hand.limits), -60.0, 60.0).T
    near = dict(zip(device.action_features, np.clip(20.0, low, high).tolist(), strict=True))
    go(device, near, near=1.0)
    motors: FakeHand = fake.made[-1]
    assert motors.count("write") > 5
    expected = [180.0 + (1 - 2 * (k % 2)) * v for k, v in enumerate(near.values())]
    np.testing.assert_allclose(motors.positions, expected, atol=1.5)

    motors.gone.set()  # the cable
    device.get_observation()  # for a while the last measurement counts
    while device._sinks[0].state("right") is not None:
        time.sleep(0.005)
    device.config.stale_s = 0.0
    with pytest.raises(plugin.errors.DeviceNotConnectedError, match=r"has not been .* cable"):
        device.get_observation()


def test_joints_that_are_not_measured_are_refused_or_observed_as_commanded(
    robot, fake, plugin, monkeypatch
):
    from smooth_operator_devices.hands.device import Reading

    def read(self: FakeHand) -> Reading:
        self._bus("read")
        return Reading(np.full(len(self.positions), np.nan), None, None, None, ())

    monkeypatch.setattr(FakeHand, "read", read)
    with pytest.raises(plugin.errors.DeviceNotConnectedError, match="does not measure"):
        robot(sinks=["fake"]).connect()
    device = robot(sinks=["fake"], unmeasured="command", unit="radians")
    device.connect()
    sent = device.send_action(goal(load_hand("mimic_p050"), 0.5))
    seen = device.get_observation()
    np.testing.assert_allclose(list(seen.values()), list(sent.values()))


def test_a_wrist_goes_to_the_sinks_within_its_limits(robot, plugin, monkeypatch):
    seen: list[Any] = []
    keys = [f"tcp.{name}" for name in ("x", "y", "z", "r1", "r2", "r3", "r4", "r5", "r6")]
    device = robot(joints={"index_mcp2pp": "index"}, wrist="rotation_6d")
    assert list(device.action_features) == ["index.pos", *keys]
    assert list(device.observation_features) == ["index.pos"]
    device.connect()
    send = device._sinks[0].send
    monkeypatch.setattr(
        type(device._sinks[0]), "send", lambda s, tick: seen.append(tick) or send(tick)
    )
    still = [0.3, 0.1, 0.2, 2.0, 0.0, 0.0, 0.1, 1.0, 0.0]  # a policy's rotation is not quite one
    sent = device.send_action({"index.pos": 0.5, **dict(zip(keys, still, strict=True))})
    np.testing.assert_allclose(seen[-1].wrist.pose, [0.3, 0.1, 0.2, 1, 0, 0, 0], atol=1e-9)
    np.testing.assert_allclose(
        [sent[k] for k in keys], [0.3, 0.1, 0.2, 1, 0, 0, 0, 1, 0], atol=1e-9
    )
    away = [0.9, 0.1, 0.2, 0.0, 1.0, 0.0, -1.0, 0.0, 0.0]
    while abs(sent["tcp.x"] - 0.9) + abs(sent["tcp.r2"] - 1.0) > 1e-6:
        sent = device.send_action({"index.pos": 0.5, **dict(zip(keys, away, strict=True))})
        time.sleep(0.005)
    times = np.array([tick.time for tick in seen])
    places = np.array([tick.wrist.pose[:3] for tick in seen])
    speed = np.linalg.norm(np.diff(places, axis=0), axis=1) / np.maximum(np.diff(times), 1e-3)
    assert speed.max() <= 1.0 + 1e-6
    with pytest.raises(ValueError, match="is not a rotation"):
        device.send_action({"index.pos": 0.5, **dict.fromkeys(keys, 0.0)})


def test_an_arm_carries_the_hand_and_is_measured(robot):
    for library in ("mink", "daqp"):
        pytest.importorskip(library, reason="the extra arm is not installed")
    device = robot(joints={"index_mcp2pp": "index"}, wrist="quaternion", arm="panda")
    pose = [f"tcp.{name}" for name in ("x", "y", "z", "qw", "qx", "qy", "qz")]
    arm = [key for key in device.observation_features if key not in (*pose, "index.pos")]
    assert len(arm) == 7
    assert list(device.observation_features) == ["index.pos", *arm, *pose]
    assert list(device.action_features) == ["index.pos", *pose]
    device.connect()
    start = device.get_observation()
    goal = {"index.pos": 0.5, **{key: start[key] for key in pose}}
    goal["tcp.z"] += 0.05
    first = device.send_action(goal)
    assert abs(first["tcp.z"] - start["tcp.z"]) < 0.002
    go(device, goal, near=0.01)
    now = device.get_observation()
    assert max(abs(now[key] - start[key]) for key in arm) > 0.02


def test_joints_that_follow_others_may_be_among_the_keys(robot):
    hand = load_hand("mimic_p050")
    device = robot(keys="all")
    assert list(device.action_features) == [f"{name}.pos" for name in hand.joint_names]
    device.connect()
    action = goal(hand, 0.5)
    sent = go(device, action, near=0.05)[-1]
    assert sent["index_mp2dp.pos"] == pytest.approx(sent["index_pp2mp.pos"])
    follows = device.get_observation()["index_mp2dp.pos"]
    assert abs(follows - action["index_pp2mp.pos"]) < 0.1


def test_the_contact_of_each_finger_is_observed(robot):
    hand = load_hand("mimic_p050")
    fingers = [f"tactile.{finger}.newtons" for finger in hand.fingers]
    device = robot(tactile="newtons", unit="radians")
    assert list(device.observation_features)[-len(fingers) :] == fingers
    device.connect()
    free = device.get_observation()
    assert max(free[key] for key in fingers) < 0.5
    fist, end = goal(hand, 1.0), time.perf_counter() + PATIENCE_S
    while sum(device.get_observation()[key] for key in fingers) < 1.0:
        assert time.perf_counter() < end
        device.send_action(fist)
        time.sleep(0.01)
    device.disconnect()
    levels = robot(tactile="levels", side="both")
    keys = [f"{side}_tactile.{f}.level" for side in ("right", "left") for f in hand.fingers]
    assert [key for key in levels.observation_features if "tactile" in key] == keys


def test_a_driver_that_knows_no_forces_gives_levels(robot, fake, plugin):
    with pytest.raises(plugin.errors.DeviceNotConnectedError, match=r"set --robot.tactile=levels"):
        robot(tactile="newtons", sinks=["fake"]).connect()
    driven = robot(tactile="levels", sinks=["fake"])
    driven.connect()
    seen = driven.get_observation()
    levels = [seen[f"tactile.{finger}.level"] for finger in load_hand("mimic_p050").fingers]
    assert all(0.0 <= level <= 1.0 for level in levels)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"side": "up"}, "side must be one of"),
        ({"unit": "deg"}, "unit must be one of degrees, radians"),
        ({"sinks": []}, "name at least one"),
        ({"joints": {"index_mp2dp": "a"}}, "index_mp2dp can't be commanded"),
        ({"joints": {"index_mcp2pp": "a", "index_pp2mp": "a"}}, "two joints have the same key"),
        ({"left_joints": {"index_mcp2pp": "a"}}, "side=both"),
        ({"currents": True}, "no driver in --robot.sinks"),
        ({"tactile": "N"}, "tactile must be one of none, newtons, levels"),
        ({"unmeasured": "guess"}, "unmeasured must be one of"),
        ({"arm": "panda"}, "an arm follows the wrist"),
        ({"stale_s": -1.0}, "stale_s must be"),
        ({"stale_s": float("nan")}, "stale_s must be"),
        ({"acceleration": float("inf")}, "acceleration must be positive"),
    ],
)
def test_a_wrong_setting_is_refused(robot, settings, message):
    with pytest.raises(ValueError, match=message):
        robot(**settings)


def test_a_sink_that_measures_nothing_is_refused(robot, plugin, monkeypatch):
    monkeypatch.setattr(sys.modules[f"{ROBOT}.hand_port"], "_PATIENCE_S", 0.05)
    device = robot(sinks=[f"zmq:tcp://127.0.0.1:{free_port()}"])
    with pytest.raises(plugin.errors.DeviceNotConnectedError, match="name mujoco or a driver"):
        device.connect()
    assert not device.is_connected
