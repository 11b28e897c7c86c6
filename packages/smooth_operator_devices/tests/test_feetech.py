"""The Feetech driver against simulated servos of both series on a serial line."""

from dataclasses import replace

import numpy as np
import pytest
from hand_rigs import Rig
from live_time import until
from simulators.common import SerialLine
from simulators.feetech_bus import MODELS, READ, SYNC_WRITE, WRITE, packet

from smooth_operator.cli import main
from smooth_operator.errors import ConfigError, SinkError
from smooth_operator_devices.hands.actuator_map import read_table
from smooth_operator_devices.hands.device import WrongAnswerError
from smooth_operator_devices.hands.drivers.feetech import FeetechHand
from smooth_operator_devices.hands.table_check import ActuatorMover

pytest_plugins = ["hand_rig_fixtures"]

EACH_SERIES = pytest.mark.parametrize("rig", ["feetech-scs", "feetech-sts"], indirect=True)


def writes(rig: Rig, address: int) -> list[bytes]:
    """Parameters of the sync writes at an address."""
    data = [body[5:-1] for body in rig.hand.received if body[4] == SYNC_WRITE]
    return [parameters for parameters in data if parameters[0] == address]


@EACH_SERIES
def test_words_have_the_byte_order_and_steps_of_the_series(rig):
    device = rig.open()
    device.write(device.read().positions)
    goals = [300, 500, 501, 400, 511, 600]
    device.write(np.array(goals) + 0.4)
    until(lambda: device.read().positions.tolist() == goals)
    order = "little" if MODELS[rig.model].little_endian else "big"
    words = b"".join(bytes([k + 1]) + goal.to_bytes(2, order) for k, goal in enumerate(goals))
    assert writes(rig, 42)[-1] == bytes([42, 2]) + words
    radians = rig.build().device(replace(device._table, unit="rad"))
    device.close()
    radians.open()
    scale = 4096 / (2 * np.pi) if rig.model == "sts3215" else 1024 / np.deg2rad(300)
    assert radians.read().positions == pytest.approx(np.array(goals) / scale)
    radians.close()


@EACH_SERIES
def test_the_first_goals_are_the_positions_and_come_before_the_torque(rig):
    places = [100.0, 200.0, 900.0, 400.0, 500.0, 600.0]
    rig.hand.motors.place(places)
    device = rig.open()
    assert not rig.hand.motors.powered.any()
    assert not writes(rig, 42)
    device.write(device.read().positions)
    assert rig.hand.motors.powered.all()
    order = [body[5] for body in rig.hand.received if body[4] == SYNC_WRITE]
    assert order[-3:] == [42, 40, 42]
    assert rig.hand.motors.positions.tolist() == places
    lock = 0x0100  # of the SCS, where the STS has its limit of torque
    assert {servo.word(48) for servo in rig.hand.servos.values()} == {600 if rig.limits() else lock}


@EACH_SERIES
def test_loads_temperatures_and_errors_are_read(rig):
    device, (first, second, third) = rig.open(), rig.joints[:3]
    device.write(device.read().positions)
    motors = rig.hand.motors
    motors.temperatures[:3] = 31, 32, 71
    motors.stuck.add(1)
    device.write(rig.middle + np.array([0.0, -90.0, 0.0, 0.0, 0.0, 0.0]))
    reading = device.read()
    assert reading.temperatures[:3].tolist() == [31, 32, 71]
    assert reading.currents[:3].tolist() == [0.0, -100.0, 0.0]
    assert reading.errors == (f"{third}: too hot",)
    rig.hand.servos[2].error = 32
    reading = device.read()
    assert reading.errors == (f"{second}: overload", f"{third}: too hot")
    assert reading.currents[1] == -20.0  # its protective torque
    assert first not in " ".join(reading.errors)


@EACH_SERIES
def test_an_overloaded_servo_keeps_its_protection_until_it_gets_another_goal(rig):
    device = rig.open()
    device.write(device.read().positions)
    rig.hand.motors.stuck.add(1)
    goals = np.full(6, rig.middle - 90.0)
    device.write(goals)
    device.read()  # the line has taken the goals then
    rig.hand.servos[2].error = 32
    device.read()
    count = len(writes(rig, 42))
    device.write(goals)
    device.read()
    assert len(writes(rig, 42)) == count + 1
    assert writes(rig, 42)[-1][2::3] == b"\x01\x03\x04\x05\x06"  # none for servo 2
    assert rig.hand.servos[2].error == 32
    device.write(goals + 30.0)
    assert device.read().errors == ()


@EACH_SERIES
def test_a_restart_is_noticed_by_the_torque_that_is_off(rig):
    device = rig.open()
    device.write(device.read().positions)
    before = {s.name: s.measured.tolist() for s in device.settings()}
    rig.hand.reboot()
    after = {s.name: s.measured.tolist() for s in device.settings()}
    assert (before["torque"], after["torque"]) == ([1] * 6, [0] * 6)
    assert ("torque limit" in before) == bool(rig.limits())


@EACH_SERIES
def test_an_echo_of_the_adapter_is_skipped(rig):
    with SerialLine(rig.hand, echo=True) as line:
        device = FeetechHand(line.port, rig.build().actuators("right"))
        device.open()
        for _ in range(10):
            line.second_program(packet(1, READ, bytes([56, 2])))
            assert device.read().positions.tolist() == [rig.middle] * 6
            line.second_program(packet(2, WRITE, bytes([41, 0])))
        device.close()


@EACH_SERIES
def test_servos_that_are_absent_or_of_another_kind_are_named(rig):
    second, third = rig.joints[1:3]
    rig.patience(0.05)
    rig.hand.absent.add(2)
    with pytest.raises(SinkError, match=rf"no answer from the servos 2 \({second}\)"):
        rig.open()
    rig.patience(1.0)
    rig.hand.absent.clear()
    rig.hand.servos[3].set_word(3, 0x0909)
    with pytest.raises(SinkError, match=rf"servo 3 \({third}\) is of model number 2313.*series="):
        rig.open()
    rig.sink += f",series={rig.model[:3]}"
    device = rig.open()
    assert device.read().positions.tolist() == [rig.middle] * 6
    device._bus._answer_s = 0.1
    rig.faults.answer_wrongly("checksum")
    with pytest.raises(WrongAnswerError, match=rf"answer from servo 1 \({rig.joints[0]}\)"):
        device.read()


def test_servos_of_both_series_on_one_line_are_refused(rigs):
    rig = rigs("feetech-sts")
    rig.hand.servos[6].model = MODELS["scs0009"]
    rig.hand.servos[6].set_word(3, MODELS["scs0009"].number)
    with pytest.raises(SinkError, match="the servos are of both series"):
        rig.open()


def test_a_limit_above_the_largest_load_is_refused(rigs):
    sink = rigs("feetech-scs").build(limit=150.0)
    with pytest.raises(ConfigError, match="limit must be 1 to 100 % of the largest load"):
        sink.device(sink.actuators("right"))


def test_a_check_writes_a_table_of_servos(rigs, monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(ActuatorMover.__init__, "__defaults__", (0.5,))  # a quick check
    monkeypatch.setattr("smooth_operator_devices.hands.table_check._BLOCKED_S", 0.01)
    rig = rigs("feetech-scs")
    replies = iter(["", "index_proximal_joint", *["k"] * 2, "", "", "q"])
    monkeypatch.setattr("builtins.input", lambda _: next(replies, "q"))
    output = tmp_path / "written.toml"
    argv = ["hardware", "check", f"feetech:{rig.line.port},limit=60", "--hand"]
    argv += ["inspire_hand", "--ids", "1,2,5-6", "--unit", "scs_step", "--ends", "400", "620"]
    assert main([*argv, "--output", str(output)]) == 0
    table = read_table(output)
    assert (table.driver, table.unit, table.limit) == ("feetech", "scs_step", 60.0)
    assert [actuator.id for actuator in table.actuators] == [1, 2, 5, 6]
    until(lambda: not rig.hand.motors.powered.any())
