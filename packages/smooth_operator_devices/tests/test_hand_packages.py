"""Drivers of hands through their makers' packages: commands and answers, on stand-ins of them."""

import importlib.util
import inspect
import sys
import time
import types
from dataclasses import replace

import numpy as np
import pytest
from driven_hands import read
from fake_hand_sdks import StarkContext, StarkWorld, WujiController, WujiHand
from live_time import until
from simulators import revo3_sdk, wuji_sdk, xhand_sdk
from ticks import make_tick

from smooth_operator import Hand, load_hand
from smooth_operator.errors import ConfigError, MissingExtraError, SinkError
from smooth_operator.hands.wrist_joints import with_wrist_joints
from smooth_operator.teleop.components import build_sink
from smooth_operator.types import JointCommand
from smooth_operator_devices.hands.actuator_map import (
    ActuatorMap,
    BoundMap,
    built_in_tables,
    read_table,
)
from smooth_operator_devices.hands.device import DeviceLostError, WrongAnswerError
from smooth_operator_devices.hands.drivers import revo3
from smooth_operator_devices.hands.drivers.orca import OrcaSink

pytest_plugins = ["hand_rig_fixtures"]


def table(name: str) -> ActuatorMap:
    return read_table(built_in_tables() / f"{name}_right.toml")


def test_wuji_limits_efforts_and_reports_faults(rigs):
    rig = rigs("wuji")
    world, device = rig.hand, rig.open()
    assert (world.effort_limit == 1.0).all()  # ampere, of the table's 1000 mA
    assert world.switched == []
    world.codes[1, 2] = 0x20
    device.write(device.read().positions)
    reading = read(device, 60)
    assert reading.errors == ("index_3: error 0x20",)
    assert (reading.temperatures == 41.0).all()
    assert np.abs(reading.currents).max() <= 1500.0
    device.relax()
    device.close()
    assert world.switched == [True, False]


def test_revo2_reports_who_stalls(rigs):
    rig = rigs("revo2")
    device = rig.open()
    rig.hand.motors.stuck.add(2)
    device.write(np.array([0, 0, 500, 0, 0, 0.0]))
    reading = device.read()
    assert reading.errors == ("index: stalled",)
    assert reading.currents.tolist() == [0, 0, 1000, 0, 0, 0]


def test_wuji2_sets_limits_before_it_switches_the_motors_on(rigs):
    rig = rigs("wuji2")
    hand, device = rig.hand, rig.open(limit=600.0)
    assert (hand.commands, any(hand.enabled), hand.effort_limits[0]) == ([], False, 1.5)
    device.write(np.linspace(0, 0.5, 20))
    assert hand.effort_limits == [0.6] * 20
    assert all(hand.enabled)
    until(lambda: np.abs(device.read().positions - np.linspace(0, 0.5, 20)).max() < 1e-6)
    assert device.settings()[0].measured.tolist() == [0.6] * 20
    device.close()
    assert not any(hand.enabled)


def test_wuji2_joints_are_mapped_by_their_nid(rigs):
    rig = rigs("wuji2")
    device = rig.open()
    rig.hand.motors.place(np.arange(20) / 100)
    rig.hand.offline.update({0, 7})
    reading = device.read()
    expected = np.arange(20) / 100
    expected[[0, 7]] = np.nan
    np.testing.assert_allclose(reading.positions, expected)
    assert reading.errors == ("thumb_1: offline", "index_4: offline")
    with pytest.raises(WrongAnswerError, match="a joint is offline"):
        device.settings()


def test_wuji2_reports_faults_by_name_and_clears_them_with_the_first_command(rigs):
    rig = rigs("wuji2")
    hand, device = rig.hand, rig.open()
    hand.motors.temperatures[9] = 71
    hand.set_fault(3, wuji_sdk.OVERCURRENT)
    hand.set_fault(4, wuji_sdk.STALL)
    reading = until(lambda: (r := device.read()).errors and r)
    assert reading.errors == ("thumb_4: Overcurrent (0x2102)", "index_1: Stall (0x0007)")
    assert reading.temperatures[9] == 71
    device.write(np.zeros(20))
    until(lambda: not device.read().errors)
    assert hand.motors.powered.all()


def test_wuji2_that_restarts_is_lost_and_an_unknown_number_is_refused(rigs):
    rig = rigs("wuji2")
    device = rig.open()
    rig.hand.reboot()
    with pytest.raises(DeviceLostError, match="wuji2: StreamClosed"):
        device.read()
    device.close()
    rig.hand.sn = "WH2K999"
    with pytest.raises(SinkError, match="Device not found; check the hand's power"):
        device.open()


def test_wuji2_without_a_limit_keeps_that_of_the_hand(rigs):
    rig = rigs("wuji2")
    rig.hand.effort_limits = [1.1] * 20
    device = rig.build().device(replace(table("wuji2"), limit=None))
    device.open()
    device.write(np.zeros(20))
    assert rig.hand.effort_limits == [1.1] * 20
    device.close()


def test_revo3_has_the_order_and_ranges_of_the_maker(rigs):
    ranges = revo3_sdk.RANGES
    assert table("revo3").names == revo3_sdk.JOINTS
    np.testing.assert_array_equal(ranges, revo3.RANGES)
    np.testing.assert_array_equal([a.ends for a in table("revo3").actuators], ranges)
    rig = rigs("revo3")
    device = rig.open()
    assert rig.hand.sent == []
    goal = np.arange(21.0)
    goal[20] = 400.0  # the hand refuses targets beyond a range
    device.write(goal)
    kind, sent = rig.hand.sent[-1]
    assert kind == "servo position"
    assert sent == pytest.approx(np.clip(goal, ranges[:, 0], ranges[:, 1]))


def test_revo3_opens_a_session_that_expired_again(rigs, monkeypatch):
    monkeypatch.setattr(revo3, "_SESSION_MS", 20)
    rig = rigs("revo3")
    device = rig.open()
    device.write(np.zeros(21))
    time.sleep(0.05)
    assert rig.hand.sessions[0].state.name == "Expired"
    device.write(np.full(21, 1.0))
    assert len(rig.hand.sent) == 2
    assert len(rig.hand.sessions) >= 2


def test_revo3_relaxes_to_zero_force_and_reports_faults_and_heat(rigs, monkeypatch):
    monkeypatch.setattr(revo3, "_SLOW", 2)
    rig = rigs("revo3")
    hand, device = rig.hand, rig.open()
    device.write(np.zeros(21))
    hand.motors.stuck.add(4)
    hand.motors.temperatures[6] = 72
    hand.motor_faults[5] = 8
    device.write(np.full(21, 10.0))
    reading = until(lambda: (r := device.read()).errors and r.currents[4] and r)
    assert reading.errors == ("ring_mcp: fault 0x8",)
    assert reading.temperatures[6] == 72
    assert reading.currents[4] == 800
    device.relax()
    assert not hand.motors.powered.any()
    device.write(device.read().positions)
    assert hand.motor_faults == [0] * 21
    assert hand.motors.powered.all()


def test_revo3_takes_one_session_and_a_model_that_cannot_move_is_refused(rigs):
    rig = rigs("revo3")
    first, second = rig.open(), rig.open()
    first.write(np.zeros(21))
    with pytest.raises(WrongAnswerError, match="a servo session is active"):
        second.write(np.zeros(21))
    second.close()
    rig.hand.model = revo3_sdk.Revo3Model.Pro
    with pytest.raises(WrongAnswerError, match="can't be moved yet"):
        rig.open().write(np.zeros(21))


def test_xhand_commands_have_position_mode_gains_and_limit(rigs):
    rig = rigs("xhand")
    device = rig.open(kp=120)
    assert rig.hand.commands == []
    goal = np.linspace(-0.1, 1.0, 12)
    device.write(goal)
    sent = rig.hand.commands[-1]
    assert [row[:4] for row in sent] == [(k, 120, 0, 0) for k in range(12)]
    assert [row[4] for row in sent] == pytest.approx(goal)
    assert {row[5:] for row in sent} == {(300, 3)}


def test_xhand_reports_torques_heat_touch_and_errors(rigs):
    rig = rigs("xhand")
    hand, device = rig.hand, rig.open()
    hand.motors.stuck.add(5)
    hand.motors.temperatures[3] = 0x0141  # the low byte is the temperature
    hand.joint_errors[4] = 2
    hand.forces[1, 2] = 120
    device.write(np.full(12, 0.5))
    reading = device.read()
    assert reading.currents[5] == 800
    assert reading.temperatures[3] == 65
    assert reading.errors == ("index_1: error 0x2 of the joint board",)
    assert reading.touch.tolist() == [0, 0, 0, 0, 0, 120, *[0] * 9]


def test_xhand_that_restarts_is_found_by_its_new_identifier(rigs):
    rig = rigs("xhand")
    device = rig.open()
    rig.hand.reboot()
    with pytest.raises(DeviceLostError, match="no hand 7"):
        device.read()
    device.close()
    device.open()
    device.write(np.full(12, 0.1))
    assert len(rig.hand.commands) == 1


def test_xhand_is_chosen_among_two_on_a_port_that_no_other_program_uses(rigs, monkeypatch):
    rig = rigs("xhand")
    hand, other = rig.hand, xhand_sdk.XHand("right", rig.hand.port, 6)
    for name, module in xhand_sdk.xhand_modules(hand, other).items():
        monkeypatch.setitem(sys.modules, name, module)
    with pytest.raises(SinkError, match=r"name one by settings\.device_id"):
        rig.open()
    rig.open(device_id=6).write(np.zeros(12))
    assert (len(hand.commands), len(other.commands)) == (0, 1)
    hand.occupied = other.occupied = True
    with pytest.raises(SinkError, match=r"failed .* check .* that no other program uses it"):
        rig.open()


def test_xhand_without_the_makers_package_says_where_to_get_it():
    with pytest.raises(ConfigError, match="install the wheel that RobotEra supplies"):
        build_sink("xhand").device(table("xhand"))


def calls(kind: type) -> dict[str, list[str]]:
    """Name of a method -> names of its parameters, without ``self``."""
    return {
        name: list(inspect.signature(method).parameters)[1:]
        for name, method in inspect.getmembers(kind, inspect.isfunction)
        if not name.startswith("_")
    }


@pytest.mark.skipif(not importlib.util.find_spec("wujihandpy"), reason="needs wujihandpy")
def test_the_stand_in_of_wujihandpy_is_like_the_real_one():
    import wujihandpy

    for mine, real in ((WujiHand, wujihandpy.Hand), (WujiController, wujihandpy.IController)):
        for name, parameters in calls(mine).items():
            text = getattr(real, name).__doc__ or ""  # pybind11 writes the signature there
            for parameter in parameters:
                assert f"{parameter}:" in text, f"{name} of the real one takes no {parameter}"
    assert "serial_number" in (wujihandpy.Hand.__init__.__doc__ or "serial_number")
    wujihandpy.logging.set_log_to_console(False)
    wujihandpy.filter.LowPass(cutoff_freq=10.0)
    with pytest.raises(OSError):  # noqa: PT011 - what the driver turns into a sentence
        wujihandpy.Hand(serial_number="none-of-this-number")


@pytest.mark.skipif(not importlib.util.find_spec("bc_stark_sdk"), reason="needs bc-stark-sdk")
def test_the_stand_in_of_bc_stark_sdk_is_like_the_real_one():
    from bc_stark_sdk import main_mod

    for name, parameters in calls(StarkContext).items():
        real = list(inspect.signature(getattr(main_mod.DeviceContext, name)).parameters)
        assert real[-len(parameters) :] == parameters or not parameters, name
    world = StarkWorld()
    assert list(inspect.signature(main_mod.modbus_open).parameters) == ["port_name", "baudrate"]
    for kind in ("Baudrate", "FingerUnitMode", "HandType", "MotorState"):
        for member in getattr(world.main_mod, kind):
            assert hasattr(getattr(main_mod, kind), member.name), f"{kind}.{member.name}"


@pytest.fixture(scope="module")
def hand() -> Hand:
    return load_hand("orca_v2")


@pytest.mark.parametrize("side", ["right", "left"])
def test_the_table_fits_our_model(side):
    orca = read_table(built_in_tables() / f"orca_{side}.toml")
    fingers = load_hand("orca_v2", side)
    hand = with_wrist_joints(fingers)
    bound = BoundMap(orca, hand)
    assert bound.determined.all()
    low, high = hand.limits.T
    for q in (low, high):  # our model's ends are the maker's
        commands = bound.commands(bound.angles(hand.full_configuration(q)))
        assert commands == pytest.approx(bound.clip(commands), abs=0.1)
    q = fingers.full_configuration(fingers.limits[:, 0])
    without = BoundMap(orca, fingers)  # the wrist's motor holds it straight
    held = without.commands(without.angles(q))
    assert held[orca.names.index("wrist")] == 0.0
    assert without.joints(held) == pytest.approx(q)
    assert without.determined.shape == q.shape


def test_without_orca_core_the_extra_is_named(hand, monkeypatch):
    monkeypatch.setitem(sys.modules, "orca_core", None)
    with pytest.raises(MissingExtraError, match="orca"):
        OrcaSink().open({"right": hand}, {})


def test_the_makers_mock_boots_approaches_and_is_read_back(hand, capsys, request):
    pytest.importorskip("orca_core", reason="the extra orca (orca-core) is not installed")
    sink = build_sink("orca:mock=true,approach=5")
    sink.open({"right": hand}, {})
    request.addfinalizer(sink.close)
    state = sink.state("right")
    assert state is not None
    q = hand.full_configuration(hand.neutral)
    tick = replace(make_tick(hand), command=JointCommand(q, hand.joint_names))
    until(lambda: sink.send(tick) or "approaches" not in sink.note)

    until(
        lambda: (
            sink.send(tick)
            or ((now := sink.state("right")) and np.abs(now.positions - q).max() < 0.01)
        )
    )
    assert sink.figures["wrong_answers"] == 0
    until(lambda: "it rests" in sink.note)
    assert capsys.readouterr().out == ""  # what the makers' library says is no result


class _Hand:
    """The part of a hand of orca-core that the driver uses, with the current of its motors [mA]."""

    last_read_ok, calibrated, absent_joints = True, True, ()

    def __init__(self, names: tuple[str, ...]) -> None:
        wired = {name: k + 1 for k, name in enumerate(names)}
        self.config = types.SimpleNamespace(
            joint_ids=list(names),
            motor_ids=list(wired.values()),
            joint_to_motor_map=wired,
            max_current=400.0,
        )
        self.current = 1750.0
        self.at_power: list[float] = []

    def connect(self, interactive: bool) -> tuple[bool, str]:
        return True, "connected"

    def init_joints(self, move_to_neutral: bool) -> None:
        self.current = self.config.max_current

    def set_max_current(self, current: float) -> None:
        self.current = current

    def enable_torque(self) -> list[int]:
        self.at_power.append(self.current)
        return []

    def disable_torque(self) -> None:
        pass

    def set_joint_positions(self, pose: dict[str, float]) -> None:
        pass

    def disconnect(self) -> None:
        pass


@pytest.fixture
def orca(monkeypatch) -> _Hand:
    """The hand of a stand-in for orca-core."""
    hand = _Hand(table("orca").names)
    core = types.ModuleType("orca_core")
    core.load_hand = lambda **_: hand
    monkeypatch.setitem(sys.modules, "orca_core", core)
    return hand


def test_a_hand_that_is_not_calibrated_is_refused(orca):
    orca.calibrated = False
    with pytest.raises(SinkError, match="is not calibrated"):
        OrcaSink().device(table("orca")).open()


@pytest.mark.parametrize(("limit", "current"), [(150.0, 150.0), (None, 400.0)])
def test_the_limit_is_back_before_torque_that_was_off(orca, limit, current):
    actuators = table("orca")
    first = replace(actuators.actuators[0], limit=limit)
    limited = replace(actuators, limit=None, actuators=(first, *actuators.actuators[1:]))
    device = OrcaSink().device(limited)
    device.open()
    commands = np.zeros(len(limited.names))
    device.write(commands)
    device.relax()
    orca.current = 1750.0  # as a motor that restarted has it
    device.write(commands)
    assert orca.at_power == [current, current]
    device.close()
