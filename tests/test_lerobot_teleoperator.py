"""The LeRobot teleoperator: keys and units, commands that stop, come late or come back."""

import contextlib
import importlib
import itertools
import json
import math
import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from free_port import free_port
from lerobot_stand_in import REAL, TELEOPERATOR, plugins, with_lerobot
from live_time import PATIENCE_S, until
from ticks import make_tick

from smooth_operator import Retargeter, load_hand
from smooth_operator.calibration.operator_file import (
    OperatorProfile,
    read_operator,
    write_operator,
)
from smooth_operator.calibration.segments import PROMPTS
from smooth_operator.synthetic import SyntheticOperator
from smooth_operator.teleop.control.bindings import ACTIONS
from smooth_operator.teleop.sinks.sink import sink_actions
from smooth_operator.teleop.sinks.tick import ArmCommand
from smooth_operator.teleop.sinks.zmq_sink import ZmqSink, command_message

pytest.importorskip("zmq")


@pytest.fixture
def plugin() -> Iterator[SimpleNamespace]:
    with plugins():
        import lerobot_teleoperator_smooth_operator as package
        from lerobot.utils import errors
        from lerobot_teleoperator_smooth_operator import following

        yield SimpleNamespace(package=package, following=following, errors=errors)


class Session:
    """A teleoperator whose time and messages come from the test.

    Attributes:
        more: fields of each message besides those of every command.
    """

    def __init__(self, plugin: SimpleNamespace, monkeypatch: Any, **settings: Any) -> None:
        self.clock, self.number = SimpleNamespace(now=100.0), 0
        self.angles, self.wrist, self.sides = [0.1, 0.2], None, ("right",)
        self.names, self.more = ["i-mcp", "i-pip"], {}
        config = plugin.package.SmoothOperatorConfig(**settings)
        self.device = plugin.package.SmoothOperator(config, lambda: self.clock.now)

        def subscribe(address: str, newest: Any) -> Any:
            self.newest = newest
            self.send()
            return SimpleNamespace(error=None, close=lambda: None)

        monkeypatch.setattr(
            sys.modules[f"{TELEOPERATOR}.smooth_operator"], "Subscription", subscribe
        )

    def send(self, sent: float | None = None, **more: Any) -> None:
        self.number += 1
        for side in self.sides:
            message = {
                "side": side,
                "type": "command",
                "format": 1,
                "hand": "orca_v2",
                "number": self.number,
                "mode": "tracking",
                "names": self.names,
                "positions": self.angles,
                "velocities": [0.0, 0.0],
                "stamp": 0.0,
                "time": self.clock.now - 5000.0 if sent is None else sent,
                "unix_time": 0.0,
                "valid_for_s": 0.2,
                "wrist": self.wrist,
                **self.more,
                **more,
            }
            self.newest.receive(json.dumps(message).encode())

    def act(self, after: float = 0.03, **more: Any) -> dict[str, float]:
        """The action for a message that comes some time [s] after the last one."""
        self.clock.now += after
        self.send(**more)
        return dict(self.device.get_action())


@pytest.fixture
def session(plugin: SimpleNamespace, monkeypatch: pytest.MonkeyPatch) -> Callable[..., Session]:
    return lambda **settings: Session(plugin, monkeypatch, **settings)


POSE = [f"tcp.{name}" for name in ("x", "y", "z", "qw", "qx", "qy", "qz")]
EE = ("ee.x", "ee.y", "ee.z", "ee.wx", "ee.wy", "ee.wz", "ee.gripper_pos")
JOINTS = {"i-mcp": "index_mcp", "i-pip": "index_pip"}


def test_an_action_has_the_robots_keys_in_its_unit(session):
    made = {
        "degrees": ({}, [math.degrees(0.1), math.degrees(0.2)]),
        "radians": ({"signs": {"index_mcp": -1}, "offsets": {"index_pip": 0.5}}, [-0.1, 0.7]),
        "range_m100_100": (
            {"ends": {"index_mcp": [0.0, 0.4], "index_pip": [0.4, 0.0]}},
            [-50.0, 0.0],
        ),
        "range_0_100": ({"ends": {"index_mcp": [0.0, 0.05], "index_pip": [0.4, 0.0]}}, [100, 50]),
    }
    for unit, (more, expected) in made.items():
        now = session(joints=JOINTS, unit=unit, **more)
        assert now.device.action_features == {"index_mcp.pos": float, "index_pip.pos": float}
        now.device.connect()
        action = now.device.get_action()
        assert list(action) == ["index_mcp.pos", "index_pip.pos"]
        np.testing.assert_allclose(list(action.values()), expected, atol=1e-9)
        now.device.disconnect()


def test_both_hands_and_the_wrist_have_keys_of_their_own(session):
    now = session(joints={"i-pip": "pip"}, side="both", unit="radians", wrist="rotation_6d")
    now.sides = ("right", "left")
    half = math.sqrt(0.5)  # a quarter turn about z: x of the wrist is y of the base
    now.wrist = {"pose": [0.3, 0.2, 0.1, half, 0, 0, half], "valid": True, "engaged": True}
    now.device.connect()
    action = now.device.get_action()
    assert action.keys() == now.device.action_features.keys()
    pose = [action[f"left_tcp.{n}"] for n in ("x", "y", "z", "r1", "r2", "r3", "r4", "r5", "r6")]
    np.testing.assert_allclose(pose, [0.3, 0.2, 0.1, 0, 1, 0, -1, 0, 0], atol=1e-12)
    assert action["left_pip.pos"] == action["right_pip.pos"] == 0.2

    now = session(joints={"i-pip": "pip"}, unit="radians", wrist="quaternion")
    now.wrist = {"pose": [0.3, 0.2, 0.1, half, 0, 0, half], "valid": True, "engaged": True}
    now.device.connect()
    assert now.device.get_action()["tcp.qz"] == half


def test_joints_of_an_arm_are_among_the_keys(session):
    """As the sink zmq sends them."""
    arm = ArmCommand("panda", ("joint1", "joint2"), np.array([0.3, -0.4]), np.zeros(2), np.zeros(7))
    message = command_message(replace(make_tick(load_hand("mimic_p050")), arm=arm), 0.2)
    now = session(joints={"index_mcp2pp": "index", "arm_joint2": "shoulder"})
    now.names, now.angles = message["names"], message["positions"]
    now.more = {"arm": message["arm"]}
    now.device.connect()
    assert now.device.get_action()["shoulder.pos"] == -0.4
    assert now.device.get_action().keys() == {"index.pos", "shoulder.pos"}


def test_without_names_all_joints_are_known_once_commands_come(session, plugin):
    now = session()
    with pytest.raises(plugin.errors.DeviceNotConnectedError, match="connect first"):
        _ = now.device.action_features
    now.device.connect()
    assert list(now.device.action_features) == ["i-mcp.pos", "i-pip.pos"]

    hand = load_hand("orca_v2")
    named = session(hand="orca_v2", wrist="quaternion")  # an arm has the wrist
    fingers = [f"{name}.pos" for name in hand.joint_names]
    assert list(named.device.action_features) == [*fingers, *POSE]
    with_wrist = session(hand="orca_v2")
    assert list(with_wrist.device.action_features) == [*fingers, "right_wrist.pos"]
    with pytest.raises(
        ValueError, match=r"--teleop.hand=orca_v2 has .*, but .* sends i-mcp, i-pip"
    ):
        with_wrist.device.connect()


def test_an_old_command_is_not_followed_and_a_new_one_not_jumped_to(session, plugin):
    now = session(joints=JOINTS, unit="radians", hold_s=1.0)
    device, clock = now.device, now.clock
    device.connect()
    first = device.get_action()
    clock.now += 0.15
    assert device.get_action() == first
    now.angles = [1.1, 0.2]
    clock.now += 0.5  # nothing came: what was sent last stays
    assert device.get_action() == first
    now.send()  # and the command that comes then is new
    back = device.get_action()
    assert abs(back["index_mcp.pos"] - first["index_mcp.pos"]) < 0.02
    steps = []
    for _ in range(150):
        clock.now += 0.01
        now.send()
        steps.append(device.get_action()["index_mcp.pos"])
    assert steps[-1] == 1.1
    assert np.all(np.diff(steps) >= 0)
    assert np.diff(steps).max() < 0.02  # 1 rad/s on average, 1.5 at most
    clock.now += 0.9
    assert device.get_action()["index_mcp.pos"] == 1.1
    clock.now += 0.3
    with pytest.raises(plugin.errors.DeviceNotConnectedError, match=r"right hand for 1\.2 s"):
        device.get_action()


def test_an_approach_stays_between_what_was_held_and_the_target(plugin):
    """Also if the target turns back meanwhile, so that a joint's limits are kept."""
    follower = plugin.following.Follower()
    follower.put([0.5])
    follower.follow([2.0], 0.0)
    values = [follower.follow([0.0], 0.1 * step)[0] for step in range(1, 20)]
    assert 0.0 <= min(values) <= max(values) <= 0.5


def test_commands_that_waited_in_a_queue_are_old(session):
    now = session(joints=JOINTS, unit="radians")
    now.device.connect()
    before = now.device.get_action()
    sent = now.clock.now - 5000.0  # the sender's clock is another one
    now.clock.now += 1.0
    now.angles = [0.9, 0.9]
    now.send(sent + 0.01)
    now.send(sent + 0.02)  # both were on the way for a second
    assert now.device.get_action() == before
    now.send(sent + 1.0)  # new, and the way to it begins without a jump
    np.testing.assert_allclose(list(now.device.get_action().values()), list(before.values()))
    now.clock.now += 2.0
    now.send()
    assert now.device.get_action()["index_mcp.pos"] == 0.9


def test_a_session_that_ended_is_not_followed(session, plugin):
    now = session(joints=JOINTS, hold_s=0.0)
    now.device.connect()
    now.device.get_action()
    now.newest.take({"side": "right", "type": "end", "format": 1})
    now.clock.now += 0.01
    with pytest.raises(plugin.errors.DeviceNotConnectedError, match="teleop has ended"):
        now.device.get_action()
    now.send()
    assert now.device.get_action()


def test_a_wrist_that_is_lost_stays_and_comes_back_without_a_jump(session):
    now = session(joints=JOINTS, wrist="quaternion")
    pose = [0.3, 0.2, 0.1, 1.0, 0.0, 0.0, 0.0]
    there = {"pose": pose, "valid": True, "engaged": True}
    now.wrist = there
    now.device.connect()

    def step(wrist: Any) -> list[float]:
        action = now.act(0.01, wrist=wrist)
        return [action[key] for key in POSE]

    step(there)
    assert step({"pose": pose, "valid": False, "engaged": False}) == pose
    assert step(None) == pose
    away = {"pose": [0.5, 0.2, 0.1, 0.0, 0.0, 0.0, 1.0], "valid": True, "engaged": True}
    path = np.array([step(away) for _ in range(400)])
    np.testing.assert_allclose(path[0], pose, atol=1e-9)
    np.testing.assert_allclose(path[-1], away["pose"], atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(path[:, 3:], axis=1), 1.0)
    assert np.linalg.norm(np.diff(path[:, :3], axis=0), axis=1).max() < 0.002
    turns = 2 * np.arccos(np.clip(np.abs((path[1:, 3:] * path[:-1, 3:]).sum(1)), 0, 1))
    assert turns.max() < 0.02


def test_messages_that_cannot_be_read_are_left_out(session):
    now = session(joints=JOINTS)
    now.device.connect()
    before = now.device.get_action()
    for wrong in (b"\xff", b"[]", b"{}", b'{"type":"command","side":"right","format":1}'):
        now.newest.receive(wrong)
    now.send(positions=[0.5])
    now.send(positions=[math.nan, 0.0])
    assert now.device.get_action() == before
    now.send(format=2, positions=[0.5, 0.5])
    assert now.device.get_action() == before
    assert "format 2" in now.newest.refused
    now.send(type="state", positions=[0.5, 0.5])  # what else a program may publish there
    assert now.device.get_action() == before


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"side": "up"}, "right, left or both"),
        ({"unit": "deg"}, "unit must be one of degrees, radians"),
        ({"wrist": "euler"}, "wrist must be one of"),
        ({"gripper": "fist"}, "gripper must be pinch or hand, not 'fist'"),
        ({"wrist": "delta", "joints": JOINTS}, "delta works for one hand, without joints"),
        ({"wrist_yaw": 180.0}, "give --wrist.scale and --wrist.yaw to teleop"),
        ({"wrist": "delta", "delta_step_m": 0.0}, "delta_step_m must be positive"),
        ({"joints": {"i-mcp": "gripper"}, "gripper": "pinch"}, "gripper.pos is the gripper's key"),
        ({"unit": "range_0_100", "joints": JOINTS}, "needs the model's angles at both ends"),
        ({"joints": {"a": "one", "b": "one"}}, "robot's key one.pos"),
        ({"joints": JOINTS, "signs": {"index_mcp": 2}}, "1 or -1"),
        ({"joints": JOINTS, "offsets": {"indx": 2}}, "'indx' is not one of"),
        ({"joints": JOINTS, "ends": {"index_mcp": [0, 1]}}, "signs and offsets"),
        ({"left_joints": JOINTS}, "side=both"),
        ({"hold_s": -1.0}, r"hold_s must be 0 to 1e\+09, not -1"),
    ],
)
def test_a_wrong_setting_is_refused(plugin, settings, message):
    with pytest.raises(ValueError, match=message):
        plugin.package.SmoothOperator(plugin.package.SmoothOperatorConfig(**settings))


def test_it_reads_what_the_sink_zmq_sends_and_says_what_is_missing(plugin):
    address, hand = f"tcp://127.0.0.1:{free_port()}", load_hand("mimic_p050")

    def made(**settings: Any) -> Any:
        return plugin.package.SmoothOperator(plugin.package.SmoothOperatorConfig(**settings))

    def refused(expected: str, **settings: Any) -> None:
        for patience in (0.3, 2.0, 20.0):  # the longer ones for a machine that is busy
            device = made(address=address, timeout_s=patience, **settings)
            with pytest.raises((ConnectionError, ValueError)) as caught:
                device.connect()
            assert not device.is_connected
            if expected in str(caught.value):
                return
        pytest.fail(f"{caught.value}, not: {expected}")

    with pytest.raises(plugin.errors.DeviceNotConnectedError, match="start smooth-operator teleop"):
        made(address=address, timeout_s=0.05).connect()
    with pytest.raises(ValueError, match="not a ZeroMQ address"):
        made(address="nowhere").connect()
    device = made(address=address, unit="radians")
    with publishing(address, hand):
        refused("set --teleop.side=right", side="left")
        refused("without the pose of a wrist", wrist="quaternion")
        refused("no_joint are not joints of", joints={"no_joint": "thumb"})
        device.connect()
        assert set(device.action_features) == {f"{name}.pos" for name in hand.joint_names}
        seen: set[tuple[float, ...]] = set()
        until(lambda: seen.add(tuple(device.get_action().values())) or len(seen) >= 20)
        assert device.modes == {"right": "tracking"}
        low, high = hand.limits.T
        angles = dict(zip(device.action_features, seen.pop(), strict=True))
        actuated = [angles[f"{name}.pos"] for name in hand.actuated_names]
        assert np.all((actuated >= low - 1e-9) & (actuated <= high + 1e-9))
    device.disconnect()
    with pytest.raises(plugin.errors.DeviceNotConnectedError):
        device.get_action()


def test_the_loop_may_run_in_the_same_process(plugin):
    """Both hands and their wrists, from the built-in operator, who pinches as an input."""
    from lerobot.teleoperators.utils import TeleopEvents

    config = plugin.package.SmoothOperatorConfig(
        source="synthetic:gestures=pinch_index",
        hand="mimic_p050",
        method="joint_angle",
        side="both",
        wrist="quaternion",
        bind=["success=pinch:left-index"],
    )
    device = plugin.package.SmoothOperator(config)
    device.connect()
    first, deadline = device.get_action(), time.monotonic() + PATIENCE_S
    joints = [f"{name}.pos" for name in load_hand("mimic_p050").joint_names]
    expected = [f"{side}_{key}" for side in ("right", "left") for key in (*joints, *POSE)]
    assert list(first) == list(device.action_features) == expected
    still = {f"{side}_{key}" for side in ("right", "left") for key in ("index_mcp2pp.pos", "tcp.x")}
    success = False
    while (still or not success) and time.monotonic() < deadline:
        now = device.get_action()
        still = {key for key in still if now[key] == first[key]}
        success |= device.get_teleop_events()[TeleopEvents.SUCCESS]
        time.sleep(0.01)
    assert not still
    assert success
    device.disconnect()

    config = plugin.package.SmoothOperatorConfig(source="no_such_source")
    with pytest.raises(plugin.errors.DeviceNotConnectedError, match="no_such_source"):
        plugin.package.SmoothOperator(config).connect()


def test_a_calibration_is_guided_and_stored_and_used(plugin, monkeypatch, tmp_path, capsys):
    """With the steps of lerobot-calibrate; the built-in operator pinches as the prompt says."""
    module = importlib.import_module(f"{TELEOPERATOR}.operator_calibration")
    monkeypatch.setattr(module, "PROMPTS", (replace(PROMPTS[0], settle=0.2, hold=1.0),))

    def operator(**settings: Any) -> Any:
        config = plugin.package.SmoothOperatorConfig(
            source="synthetic:gestures=pinch_index,seed=1",
            method="joint_angle",
            calibration_dir=tmp_path,
            **settings,
        )
        return plugin.package.SmoothOperator(config)

    device, file = operator(operator="anna"), tmp_path / "anna.operator.json"
    with pytest.raises(plugin.errors.DeviceNotConnectedError, match="not connected"):
        device.calibrate()
    mount = (0.1, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)
    assert not device.is_calibrated
    device.connect(calibrate=False)
    write_operator(file, OperatorProfile("right", mounts={"right": mount}))
    device.calibrate()
    device.disconnect()
    assert "thumb pad on index finger pad" in capsys.readouterr().err
    stored = read_operator(file)
    assert stored.pinch_gaps.keys() == {"index"}
    assert stored.mounts == {"right": mount}
    assert device.is_calibrated
    assert operator(id="anna").is_calibrated
    assert not operator(operator=str(tmp_path / "none.json")).is_calibrated

    file.write_text("{}")  # the loop reads it
    with pytest.raises(plugin.errors.DeviceNotConnectedError, match="not describe an operator"):
        operator(operator="anna").connect()
    unnamed = operator()
    unnamed.connect()
    with pytest.raises(ValueError, match=r"--teleop.operator=anna"):
        unnamed.calibrate()
    unnamed.disconnect()


@contextlib.contextmanager
def publishing(address: str, hand: Any) -> Iterator[None]:
    """The sink zmq sends commands, each as if the loop had made it, until the block ends."""
    sink, over = ZmqSink(address), threading.Event()
    sink.open({"right": hand}, {})

    def run() -> None:
        for number in itertools.count():
            if over.wait(0.005):
                return
            sink.send(make_tick(hand, number))

    thread = threading.Thread(target=run)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()
        sink.close()


def test_the_human_hand_of_each_action_is_known(session):
    now = session(joints=JOINTS)
    now.device.connect()

    def step(**human: Any) -> dict[str, Any]:
        now.act(**human)
        values = dict(now.device.human.values)
        kinds = {name: (str(each.dtype), each.shape) for name, each in values.items()}
        features = now.device.human.features.items()
        assert kinds == {name: (each["dtype"], each["shape"]) for name, each in features}
        return values

    points = np.arange(63.0).reshape(21, 3) / 1000
    pose = [0.1, 0.2, 0.3, 1.0, 0.0, 0.0, 0.0]
    first = step(landmarks=points.tolist(), operator_wrist={"pose": pose, "world": "room"})
    np.testing.assert_array_equal(first["right_landmarks"], points.ravel())
    assert first["right_landmarks_valid"].all()
    assert first["right_human_wrist"].tolist() == pose
    assert first["stamp"] == now.clock.now
    lost = [*(points + 1.0).tolist()[:20], None]
    second = step(landmarks=lost, operator_wrist={"pose": None, "world": "room"})
    np.testing.assert_array_equal(second["right_landmarks"].reshape(21, 3)[:20], points[:20] + 1.0)
    np.testing.assert_array_equal(second["right_landmarks"].reshape(21, 3)[20], points[20])
    assert second["right_landmarks_valid"].tolist() == [True] * 20 + [False]
    assert second["right_human_wrist"].tolist() == pose
    assert not second["right_human_wrist_valid"]
    third = step()  # without a hand
    assert not third["right_landmarks_valid"].any()
    stamps = [each["stamp"][0] for each in (first, second, third)]
    assert stamps == pytest.approx([100.03, 100.06, 100.09])


def test_the_recorder_says_which_lerobot_and_which_teleoperator_it_needs(plugin, monkeypatch):
    name = f"{TELEOPERATOR}.record"
    if REAL:
        record = importlib.import_module(name)
        words = ["record", "--robot.type=so100_follower", "--robot.port=x", "--dataset.repo_id=a/b"]
        monkeypatch.setattr(sys, "argv", [*words, "--teleop.type=keyboard"])
        with pytest.raises(SystemExit, match=r"smooth_operator, but got --teleop.type=keyboard"):
            record.record()
    monkeypatch.delitem(sys.modules, name, raising=False)
    monkeypatch.setitem(sys.modules, "lerobot.datasets", None)
    with pytest.raises(SystemExit, match=r"needs LeRobot 0.6 or newer .* pip install"):
        importlib.import_module(name)


def test_steps_turn_landmarks_into_joints_or_a_gripper(session, plugin):
    operator = SyntheticOperator(seed=0)
    frames = operator.record(0.1).landmarks
    now = session(joints=JOINTS, landmarks=True, wrist="quaternion")
    now.wrist = {"pose": [0.3, 0.2, 0.1, *[math.sqrt(0.5), 0, 0, math.sqrt(0.5)]]}
    now.device.connect()

    def step(points: np.ndarray | None) -> dict[str, float]:
        action = now.act(landmarks=None if points is None else points.tolist())
        assert action.keys() == now.device.action_features.keys()
        return action

    rest = {f"{name}.pos" for name in JOINTS.values()}
    joints = plugin.package.LandmarksToJoints(hand="mimic_p050", method="joint_angle")
    model = load_hand("mimic_p050")
    names = [f"{name}.pos" for name in model.joint_names]
    before = joints.action(step(None))  # without a hand: the neutral pose
    neutral = model.full_configuration(model.neutral)
    np.testing.assert_allclose([before[name] for name in names], neutral, atol=1e-9)
    made = [joints.action(step(points)) for points in frames]
    assert made[0].keys() == {*names, *rest, *POSE}
    expected = Retargeter("mimic_p050", method="joint_angle")(frames[0]).command.joint_positions
    np.testing.assert_allclose([made[0][name] for name in names], expected, atol=1e-5)
    assert joints.action(step(None)) == made[-1]  # it holds
    from lerobot.configs.types import PipelineFeatureType

    kind = PipelineFeatureType.ACTION
    described = {kind: dict.fromkeys(now.device.action_features, float)}
    assert joints.transform_features(described)[kind].keys() == made[0].keys()

    gripper = plugin.package.LandmarksToEndEffector()
    pinch = frames[0].copy()
    pinch[4] = pinch[8]  # the tips of thumb and index finger
    wide = frames[0].copy()
    wide[4] = wide[8] + [0.0, 0.3, 0.0]
    openings = []
    assert gripper.get_config() == {"prefix": "", "gripper": "pinch", "touch_m": 0.01}
    for points in (None, pinch, None, wide):
        action = gripper.action(step(points))
        assert action.keys() == rest | set(EE)
        openings.append(action["ee.gripper_pos"])
    assert openings == [100.0, 0.0, 0.0, 100.0]
    np.testing.assert_allclose([action[key] for key in EE[:3]], [0.3, 0.2, 0.1])
    np.testing.assert_allclose([action[key] for key in EE[3:6]], [0, 0, math.pi / 2], atol=1e-9)
    with pytest.raises(ValueError, match=r"expected the keys landmarks.wrist.x .*landmarks=true"):
        gripper.action({"index_mcp.pos": 0.1})
    without = {key: value for key, value in step(wide).items() if key not in POSE}
    with pytest.raises(ValueError, match=r"expected the keys tcp.x to tcp.qz .*wrist=quaternion"):
        gripper.action(without)


OPEN_HAND = SyntheticOperator(seed=0).record(0.02).landmarks[0]


def hand_of(opening: float, by: str = "pinch") -> np.ndarray:
    """Landmarks [m] of a hand: finger pinched or closed (0) to open (1)."""
    points = OPEN_HAND.copy()
    if by == "pinch":
        length = np.linalg.norm(np.diff(points[5:9], axis=0), axis=1).sum()
        points[4] = points[8] + [0.0, 0.01 + opening * (length - 0.01), 0.0]
        return points
    for base in (5, 9, 13, 17):
        lengths = np.linalg.norm(np.diff(points[base : base + 4], axis=0), axis=1)
        bend = (1.0 - opening) * 1.6  # [rad] in each joint
        angles = bend * np.arange(1, 4)
        steps = lengths[:, None] * np.stack([np.cos(angles), 0 * angles, np.sin(angles)], axis=1)
        points[base + 1 : base + 4] = points[base] + np.cumsum(steps, axis=0)
    return points


@pytest.mark.parametrize("by", ["pinch", "hand"])
def test_a_gripper_follows_the_hand_and_not_its_noise(plugin, by):
    gripper = sys.modules[f"{TELEOPERATOR}.gripper"].Gripper(by)
    assert gripper.opening == 100.0
    rng = np.random.default_rng(0)
    closing = [gripper.follow(hand_of(x, by)) for x in np.linspace(1.0, 0.0, 200)]
    assert (np.diff(closing) <= 0).all()
    assert (closing[0], closing[-1]) == pytest.approx((100.0, 0.0))
    opening = [gripper.follow(hand_of(x, by)) for x in np.linspace(0.0, 1.0, 200)]
    assert (np.diff(opening) >= 0).all()
    assert opening[-1] == pytest.approx(100.0)
    assert max(np.array(opening[::-1]) - closing) == pytest.approx(0.0, abs=1e-9)
    assert 5.0 < max(closing - np.array(opening[::-1])) < 25.0  # the hysteresis
    half = [gripper.follow(hand_of(0.5, by)) for _ in range(2)]
    noisy = [gripper.follow(hand_of(0.5, by) + rng.normal(0.0, 3e-4, (21, 3))) for _ in range(500)]
    assert half[0] == half[1]
    assert np.ptp(noisy[100:]) < 1.0  # of a tracker's noise of 0.3 mm
    assert np.count_nonzero(np.diff(noisy[100:])) < 10
    lost = hand_of(0.0, by)
    lost[8] = np.nan
    assert gripper.follow(lost) == noisy[-1]


def test_an_end_effector_has_lerobots_keys(session):
    now = session(wrist="ee")
    half = math.sqrt(0.5)
    now.wrist = {"pose": [0.3, 0.2, 0.1, half, 0, 0, half]}
    assert set(now.device.action_features) == set(EE)  # before connect, and no joints of the hand
    now.device.connect()
    action = now.act(landmarks=hand_of(0.0).tolist())
    assert action.keys() == set(EE)
    np.testing.assert_allclose(
        [action[k] for k in EE], [0.3, 0.2, 0.1, 0, 0, math.pi / 2, 0.0], atol=1e-9
    )
    # Paused, or without a hand, the gripper holds what it has.
    assert now.act(landmarks=hand_of(1.0).tolist(), mode="paused")["ee.gripper_pos"] < 1e-9
    assert now.act(landmarks=None)["ee.gripper_pos"] < 1e-9
    now.more = {"landmarks": hand_of(1.0).tolist()}
    assert now.act()["ee.gripper_pos"] == pytest.approx(100.0)
    # DAgger hands over from the pose of a policy.
    now.device.enable_torque()
    policy = dict(zip(EE, [0.1, 0.0, 0.2, 0.0, 0.0, 0.0, 40.0], strict=True))
    now.device.send_feedback(policy)
    assert now.device.get_action() == pytest.approx(policy)
    now.device.disable_torque()
    assert now.act() == pytest.approx(policy, abs=1e-9)


@pytest.mark.parametrize(
    ("hand", "joint", "closed", "opened"),
    [
        ("so101", "gripper", -0.174533, 1.74533),
        ("franka_hand", "panda_finger_joint1", 0.0, 0.04),
        ("robotiq_2f85", "robotiq_85_left_knuckle_joint", 0.8, 0.0),
    ],
)
def test_a_gripper_of_the_catalogue_follows_its_retargeted_jaw(
    session, hand, joint, closed, opened
):
    """The method closes it where the tracker leaves a gap between fingers that touch."""
    now = session(hand=hand, gripper="pinch")
    assert now.device.action_features == {"gripper.pos": float}
    now.more = {"hand": hand, "landmarks": hand_of(0.5).tolist()}
    now.names, now.angles = [joint], [opened]
    now.device.connect()

    def act(position: float, mode: str = "tracking") -> float:
        action = now.act(positions=[position], mode=mode)
        assert list(action) == ["gripper.pos"]
        return action["gripper.pos"]

    assert [act(opened), act(closed)] == pytest.approx([100.0, 0.0], abs=1e-9)
    assert act((closed + opened) / 2) == pytest.approx(50.0, abs=6.0)
    held = act(closed)
    assert act(opened, "easing") == held  # what is in the gripper is not dropped
    other = session(gripper="pinch")  # of another hand: the landmarks
    other.device.connect()
    for opening, expected in ((1.0, 100.0), (0.0, 0.0)):
        action = other.act(landmarks=hand_of(opening).tolist())
        assert action == {"gripper.pos": pytest.approx(expected, abs=1e-9)}


def test_deltas_add_up_to_the_motion(session):
    now = session(wrist="delta", delta_step_m=0.02)
    names = ("delta_x", "delta_y", "delta_z", "gripper")
    described = {"dtype": "float32", "shape": (4,), "names": {n: i for i, n in enumerate(names)}}
    assert now.device.action_features == described
    pose = np.array([0.3, 0.0, 0.2, 1.0, 0.0, 0.0, 0.0])
    now.wrist = {"pose": pose.tolist()}
    now.device.connect()
    made = []
    for number in range(40):
        moved = pose.copy()
        moved[:3] += [0.05, -0.03, 0.002] if number > 2 else 0.0
        now.wrist = {"pose": moved.tolist()}
        action = now.act(landmarks=hand_of(0.0 if number < 20 else 1.0).tolist())
        assert tuple(action) == (names[3], *names[:3])
        made.append([action[name] for name in names])
    steps = np.array(made)
    assert np.abs(steps[:, :3]).max() == 1.0
    np.testing.assert_allclose(0.02 * steps[:, :3].sum(axis=0), [0.05, -0.03, 0.002], atol=1e-12)
    assert (steps[:3, :3] == 0.0).all()
    assert (steps[5:, :3] == 0.0).any()
    assert (steps[0, 3], steps[-1, 3]) == (0.0, 2.0)  # close, open


def test_an_arm_has_lerobots_keys_and_units(session):
    joints = ["shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll"]
    keys = [f"{name}.pos" for name in (*joints, "gripper")]
    now = session(arm="so101")
    assert list(now.device.action_features) == keys
    now.names, now.angles = ["gripper"], [0.593]
    with pytest.raises(ValueError, match=r"shoulder_pan.*start teleop with --arm so101"):
        now.device.connect()
    arm = {"names": joints, "positions": [0.1, -0.2, 0.3, -0.4, 0.5]}
    now.angles, now.more = [-0.174533], {"arm": arm, "hand": "so101"}
    now.device.connect()
    action = now.device.get_action()
    assert list(action) == keys
    np.testing.assert_allclose(list(action.values())[:5], np.degrees(arm["positions"]))
    assert action["gripper.pos"] == pytest.approx(0.0, abs=1e-9)


def test_events_come_from_the_mode_and_the_keys_of_teleop(session):
    """Each key counts once; keys from before the connection count for nobody."""
    from lerobot.teleoperators.utils import TeleopEvents

    sink, said = ZmqSink(), []
    press = sink_actions([sink], said.append)
    now = session(joints=JOINTS)
    now.more = {"episode": sink.episode}
    assert not any(now.device.get_teleop_events().values())
    press["success"]()
    now.device.connect()
    names = ("IS_INTERVENTION", "SUCCESS", "TERMINATE_EPISODE", "RERECORD_EPISODE")

    def events(key: str = "", mode: str = "tracking") -> str:
        if key:
            press[key]()
        now.clock.now += 0.03
        now.send(mode=mode)
        found = now.device.get_teleop_events()
        return "".join(str(int(found[TeleopEvents[name]])) for name in names)

    assert [events(), events("success"), events()] == ["1000", "1100", "1000"]
    assert [events("end", "paused"), events("", "paused")] == ["0010", "0000"]
    assert events("again", "blending") == "1011"
    now.clock.now += 5.0  # nothing comes any more
    assert not any(now.device.get_teleop_events().values())
    assert said == [ACTIONS[name][0] for name in ("success", "success", "end", "again")]


@with_lerobot
def test_keys_of_teleop_end_an_episode_or_repeat_it(session, plugin, monkeypatch):
    """LeRobot's own loop, with a robot that counts its actions; the keys come after the third."""
    from lerobot.processor import make_default_processors
    from lerobot.scripts.lerobot_record import record_loop

    record = importlib.import_module(f"{TELEOPERATOR}.record")
    monkeypatch.setattr(plugin.package, "SmoothOperator", record.RecordedOperator)
    of_action, to_robot, of_observation = make_default_processors()
    ended = {"exit_early": False, "rerecord_episode": False, "stop_recording": False}
    for key, events in (
        ("end", ended),
        ("success", ended),
        ("again", ended | {"rerecord_episode": True}),
    ):
        now, sent = session(joints=JOINTS), []
        now.device.connect()
        now.device.events = dict(ended)

        def move(action: Any, now: Any = now, sent: list[Any] = sent, key: str = key) -> None:
            sent.append(action)
            now.clock.now += 0.03
            now.send(episode={key: len(sent) // 3})

        record_loop(
            robot=SimpleNamespace(name="arm", get_observation=dict, send_action=move),
            events=now.device.events,
            fps=100,
            teleop_action_processor=of_action,
            robot_action_processor=to_robot,
            robot_observation_processor=of_observation,
            teleop=now.device,
            control_time_s=5.0,
        )
        assert len(sent) == 4
        assert now.device.events == events


@with_lerobot
@pytest.mark.parametrize("wrist", ["quaternion", "rotation_6d", "ee"])
def test_dagger_hands_over_where_the_policy_stopped(session, wrist):
    """As DAgger does it: LeRobot moves us to the robot, then releases us."""
    from lerobot.common.control_utils import teleop_smooth_move_to, teleop_supports_feedback

    now = session(joints=JOINTS, unit="degrees", signs={"index_mcp": -1}, wrist=wrist)
    device, clock = now.device, now.clock
    half = math.sqrt(0.5)
    now.wrist = {"pose": [0.3, 0.2, 0.1, half, 0.0, 0.0, half]}
    device.connect()
    assert teleop_supports_feedback(device)
    human = device.get_action()
    device.send_feedback({"index_mcp.pos": -70.0})  # as lerobot-teleoperate for some robots
    assert device.get_action() == pytest.approx(human)
    x = "ee.x" if wrist == "ee" else "tcp.x"
    policy = human | {"index_mcp.pos": -70.0, x: 0.32, "another.key": 1.0}
    if wrist == "quaternion":  # the same rotation with the other sign: halfway there is none
        policy |= {"tcp.qw": -half, "tcp.qz": -half}
    teleop_smooth_move_to(device, policy, duration_s=0.05, fps=1000)
    clock.now += 60.0  # the operator is not even there: the action is held
    held = device.get_action()
    assert not any(device.get_teleop_events().values())
    assert held["index_mcp.pos"] == pytest.approx(-70.0)
    assert held[x] == pytest.approx(0.32)
    now.send()
    device.disable_torque()
    actions = [held]
    for _ in range(200):
        actions.append(device.get_action())
        clock.now += 0.01
        now.send()
    assert actions[-1] == pytest.approx(human)
    turns = [key for key in human if key.startswith(("tcp.q", "tcp.r", "ee.w"))]
    for key in set(human) - set(turns):
        steps = np.abs(np.diff([action[key] for action in actions]))
        assert steps.max() < (0.0016 if key == x else math.degrees(0.016))
    turned = np.array([[action[key] for key in turns] for action in actions])
    assert np.abs(turned - turned[-1]).max() < 1e-6 or np.allclose(turned[0], -turned[-1])
    device.enable_torque()  # a correction ends: the robot stays
    now.angles = [1.0, 1.0]
    now.send()
    assert device.get_action() == pytest.approx(human)


@with_lerobot
def test_hil_serl_moves_the_arm_by_our_deltas(session):
    """The steps of LeRobot's ``rl/gym_manipulator.py``, in its order; a solver that only adds.

    Also: what the keys of an episode mean for a transition.
    """
    import torch
    from lerobot.processor import TransitionKey, create_transition
    from lerobot.processor import delta_action_processor as deltas
    from lerobot.processor import hil_processor as hil
    from lerobot.robots.so_follower import robot_kinematic_processor as arms
    from lerobot.teleoperators.utils import TeleopEvents

    joints = [*(f"joint{number}" for number in range(5)), "gripper"]
    seen = []

    def forward(angles: np.ndarray) -> np.ndarray:
        pose = np.eye(4)
        pose[:3, 3] = [0.2, 0.0, 0.1]
        return pose

    def inverse(angles: np.ndarray, pose: np.ndarray, **_: Any) -> np.ndarray:
        seen.append(pose[:3, 3].copy())
        return np.zeros(6)

    kinematics = SimpleNamespace(forward_kinematics=forward, inverse_kinematics=inverse)
    now = session(wrist="delta", delta_step_m=0.02)
    now.wrist = {"pose": [0.3, 0.0, 0.2, 1.0, 0.0, 0.0, 0.0]}
    now.device.connect()
    steps = [
        hil.AddTeleopActionAsComplimentaryDataStep(now.device),
        hil.AddTeleopEventsAsInfoStep(now.device),
        hil.InterventionActionProcessorStep(use_gripper=True),
        deltas.MapTensorToDeltaActionDictStep(),
        deltas.MapDeltaActionToRobotActionStep(),
        arms.EEReferenceAndDelta(
            kinematics, {"x": 0.02, "y": 0.02, "z": 0.02}, joints, use_latched_reference=False
        ),
        arms.EEBoundsAndSafety({"min": [-1.0] * 3, "max": [1.0] * 3}),
        arms.GripperVelocityToJoint(clip_max=30.0, speed_factor=1.0, discrete_gripper=True),
        arms.InverseKinematicsEEToJoints(kinematics, joints),
    ]

    def act(opening: float, **more: Any) -> Any:
        now.clock.now += 0.03
        now.send(landmarks=hand_of(opening).tolist(), **more)
        transition = create_transition(
            action=torch.tensor([0.0, 0.0, 1.0, 1.0]),  # the policy moves up, the gripper stays
            observation={f"{name}.pos": 10.0 for name in joints},
        )
        for step in steps:
            transition = step(transition)
        return transition

    first = act(0.0)
    assert first[TransitionKey.INFO][TeleopEvents.IS_INTERVENTION]
    # closed: LeRobot closes towards its maximum
    assert first[TransitionKey.ACTION]["gripper.pos"] == 30.0
    now.wrist = {"pose": [0.31, 0.0, 0.2, 1.0, 0.0, 0.0, 0.0]}
    assert act(1.0)[TransitionKey.ACTION]["gripper.pos"] == 0.0
    np.testing.assert_allclose(seen[-1], [0.21, 0.0, 0.1], atol=1e-6)
    counts = dict.fromkeys(("success", "end", "again"), 0)
    alone = act(1.0, mode="paused", episode=counts)  # the policy has the arm again
    np.testing.assert_allclose(seen[-1], [0.2, 0.0, 0.12], atol=1e-6)
    assert (alone[TransitionKey.DONE], alone[TransitionKey.REWARD]) == (False, 0.0)
    for key, reward in (("success", 1.0), ("end", 0.0), ("again", 0.0)):
        counts[key] += 1
        done = act(1.0, mode="paused", episode=counts)
        assert (done[TransitionKey.DONE], done[TransitionKey.REWARD]) == (True, reward)
    assert done[TransitionKey.INFO][TeleopEvents.RERECORD_EPISODE]
