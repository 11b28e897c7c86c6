"""Drivers of hands on serial lines, Modbus and DDS: their frames, and how they read answers."""

import importlib.util
import json
import os
import socket
import struct
import time

import numpy as np
import pytest
from driven_hands import quiet, read
from live_time import until
from simulators.rohand_modbus import STUCK

from smooth_operator.cli import main
from smooth_operator.errors import ConfigError, SinkError
from smooth_operator.teleop.components import build_sink
from smooth_operator_devices.hands.actuator_map import built_in_tables, read_table
from smooth_operator_devices.hands.device import DeviceLostError, WrongAnswerError
from smooth_operator_devices.hands.drivers import aero
from smooth_operator_devices.hands.drivers.ability import framed, unstuffed
from smooth_operator_devices.hands.drivers.inspire_touch import BLOCKS

pytest_plugins = ["hand_rig_fixtures"]


def test_ability_frames():
    # address, command, six positions of 0, and what makes the sum 0: 0x50 + 0x10 + 0xA0 = 0x100
    assert framed(bytes.fromhex("5010" + "00" * 12 + "a0")).hex() == "7e5010" + "00" * 12 + "a07e"
    assert framed(b"\x7e\x7d\x01") == b"\x7e\x7d\x5e\x7d\x5d\x01\x7e"
    for body in (os.urandom(40), b"\x7e" * 5, b""):
        assert unstuffed(framed(body)[1:-1]) == body


def test_ability_reads_touch_and_heat_and_keeps_the_hand_awake(rigs):
    rig = rigs("ability")
    hand, device = rig.hand, rig.open()
    hand.hot = 0b100010
    hand.motors.stuck.add(2)
    device.write(np.array([15, 15, 60, 15, 15, -15.0]))
    reading = device.read()
    assert reading.touch.tolist() == hand.touch
    assert reading.currents[2] == pytest.approx(1100.0, abs=2.0)
    assert reading.errors == ("middle: too hot", "thumb_rotator: too hot")
    assert not hand.gaps
    assert not hand.bad_frames


@pytest.mark.skipif(not importlib.util.find_spec("ah_wrapper"), reason="needs ability-hand")
def test_ability_speaks_as_the_makers_package(tmp_path, monkeypatch, rigs):
    monkeypatch.chdir(tmp_path)  # the package writes files into the current folder
    from ah_wrapper.ah_api import create_misc_msg, create_pos_msg
    from ah_wrapper.ah_parser import parse_packet

    degrees = [0.0, 12.5, 99.0, 33.3, 57.0, -81.0]
    body = struct.pack("<BB6h", 0x50, 0x10, *[int(d * 32767 / 150) for d in degrees])
    mine = framed(body + bytes([-sum(body) & 0xFF]))
    assert mine == bytes(create_pos_msg(reply_mode=0, positions=degrees))
    asked = bytes([0x50, 0xA0])
    assert framed(asked + bytes([-sum(asked) & 0xFF])) == bytes(create_misc_msg(0xA0))
    # and the simulator answers what the package understands
    answer = rigs("ability").hand.receive(mine)
    packet = parse_packet(bytearray(unstuffed(answer.strip(b"~"))))
    assert packet.valid
    assert packet.pos == pytest.approx([15] * 5 + [-15], abs=2.0)


def test_aero_limits_are_set_before_the_first_command_and_again_after_power_on(rigs):
    rig = rigs("aero")
    hand, device = rig.hand, rig.open(speed=9000, torque=400)
    assert (hand.speeds, hand.torques) == ([9000] * 7, [400] * 7)
    device.write(np.zeros(7))
    device.read()
    hand.reboot()
    with pytest.raises(DeviceLostError, match="restarted"):
        until(lambda: device.read() and False)
    device.close()
    device.open()
    device.write(np.full(7, 100.0))
    device.read()
    assert (hand.speeds, hand.torques) == ([9000] * 7, [400] * 7)
    kinds = [frame[0] for frame in hand.received]
    assert 0x32 in kinds[-20 : kinds.index(0x11, len(kinds) - 8)]


def test_aero_opens_while_the_hand_prints_text_or_another_program_began_a_frame(rigs, monkeypatch):
    monkeypatch.setattr(aero, "_PROBE", 0.1)
    rig = rigs("aero")
    rig.hand.motors.place(np.arange(7) * 9000.0)
    rig.hand.reboot()
    assert len(rig.hand.boot_text) % 16
    device = rig.open()
    assert device.read().positions.tolist() == (np.arange(7) * 9000.0).tolist()
    device.close()
    rig.hand._buffer = bytes(5)
    device.open()
    assert device.read().positions.tolist() == (np.arange(7) * 9000.0).tolist()


@pytest.mark.parametrize("count", [1, 15])
def test_aero_finds_the_beginning_of_a_frame_after_lost_bytes(rigs, count, monkeypatch):
    rig = rigs("aero")
    hand, device = rig.hand, rig.open()
    monkeypatch.setattr(aero, "_PROBE", 0.1)
    rig.patience(0.3)
    receive = hand.receive

    def without(data: bytes) -> bytes:
        hand.receive = receive
        return receive(data[count:])

    hand.receive = without
    missed = 0
    while quiet(device) is None:
        missed += 1
    assert 0 < missed <= 4
    assert (hand.motors.targets == 0).all()
    device.write(np.full(7, 30000.0))
    until(lambda: (device.read().positions == 30000).all())


def test_aero_reads_currents_and_temperatures(rigs):
    rig = rigs("aero")
    device = rig.open()
    rig.hand.motors.stuck.add(4)
    rig.hand.motors.temperatures[5] = 75
    device.write(np.full(7, 60000.0))
    reading = read(device, 4)
    assert reading.temperatures.tolist() == [30, 30, 30, 30, 30, 75, 30]
    assert abs(reading.currents[4]) == pytest.approx(800, abs=6.5)


def test_aero_that_homes_or_has_other_settings_is_refused(rigs, monkeypatch):
    monkeypatch.setattr(aero, "_PROBE", 0.01)
    rig = rigs("aero")
    rig.hand.homing = True
    with pytest.raises(SinkError, match=r"does not answer; check .* that it is not homing"):
        rig.open()
    with pytest.raises(ConfigError, match="torque must be a whole number from 1 to 1000"):
        rig.open(torque=1023)


def test_aero_table_is_the_coupling_of_the_makers_package():
    """A straight and a closed hand by the maker's coefficients: the ends of its ranges."""
    closed = {"cmc_abd": 100, "cmc_flex": 55, "mcp": 90, "ip": 90}
    closed |= {"mcp_flex": 90, "pip": 90, "dip": 90}
    for actuator in read_table(built_in_tables() / "aero_right.toml").actuators:
        radians = sum(
            weight * np.deg2rad(closed[joint.split("_", 2)[2]])
            for joint, weight in actuator.joints.items()
            if weight > 0
        )
        assert actuator.command(radians) == pytest.approx(65535, abs=15)
        low = 0.27778 * np.deg2rad(55) if actuator.name == "thumb_tendon" else 0.0
        assert actuator.command(-low) == pytest.approx(0, abs=15)


def test_inspire_sets_its_limits_and_reports_what_the_motors_do(rigs):
    rig = rigs("inspire")
    hand = rig.hand
    hand.errors[1] = 4
    device = rig.open(force=300, speed=700)
    assert rig.limits() == [300] * 6 + [700] * 6
    assert not hand.errors.any()  # the driver has cleared them
    hand.errors[:] = [1, 0, 4, 0, 0, 16]
    hand.motors.temperatures[:] = [31, 32, 71, 34, 35, 36]
    hand.motors.stuck.add(3)
    hand.forces[:] = 1, 2, 3, 4, 5, 6
    device.write(np.array([1000, 1000, 1000, 400, 1000, 1000.0]))
    reading = read(device, 8)
    assert reading.errors == (
        "little: rotor locked",
        "middle: too hot",
        "middle: too much current",
        "index: rotor locked",
        "thumb_rotation: motor does not answer",
    )
    assert reading.temperatures.tolist() == [31, 32, 71, 34, 35, 36]
    assert reading.currents.tolist() == [0, 0, 0, 800, 0, 0]
    assert reading.touch.tolist() == [1, 2, 3, 4, 5, 6]


def test_inspire_pads_have_their_cells_in_rows_and_columns(rigs):
    rig = rigs("inspire-touch")
    hand, random = rig.hand, np.random.default_rng(1)
    for cells in hand.touch.values():
        cells[:] = random.integers(0, 4096, cells.shape)
    device = rig.open()
    first = device.read()
    assert (first.touch, first.pads) == (None, {})
    reading = read(device, len(BLOCKS))
    names = {f"{f}_{part}".removesuffix("_palm"): (f, part) for f, part in hand.touch}
    assert set(reading.pads) == set(names)
    for name, key in names.items():
        np.testing.assert_array_equal(reading.pads[name], hand.touch[key], name)
    assert reading.touch[6:].tolist() == [pad.sum() for pad in reading.pads.values()]
    asked = [struct.unpack(">HH", request[8:12]) for request in hand.received if request[7] == 3]
    assert max(count for _, count in asked) <= 125  # what Modbus allows
    assert {block for block in asked if block[0] >= 3000} == set(BLOCKS)
    hand.received.clear()
    plain = rig.open(touch=0)
    reading = read(plain, len(BLOCKS))
    assert (reading.pads, len(reading.touch)) == ({}, 6)
    assert not any(struct.unpack(">H", request[8:10])[0] >= 3000 for request in hand.received)


@pytest.mark.parametrize("shift", [-1, 0, 1, 7])
def test_inspire_transaction_number_that_is_off_costs_nothing(rigs, shift):
    rig = rigs("inspire-touch")
    rig.hand.transaction_shift = shift
    device = rig.open()
    with socket.create_connection(rig.hand.address) as other:  # a second program
        for k in range(50):
            other.sendall(struct.pack(">HHHBBHH", k, 0, 6, 1, 3, 1486, 6))
            device.write(np.full(6, 900.0 - k))
            device.read()
    assert len(rig.hand._clients) == 2  # the driver's connection was never closed
    assert rig.hand.motors.targets.tolist() == [851.0] * 6
    rig.hand.motors.place([500.0] * 6)
    assert device.read().positions.tolist() == [500.0] * 6


def test_inspire_shift_that_changes_costs_one_answer(rigs):
    rig = rigs("inspire-touch", patience=0.3)
    device = rig.open()
    device.read()
    rig.hand.transaction_shift = -1
    with pytest.raises(WrongAnswerError, match="no valid answer from device 1"):
        device.read()
    read(device, 20)


def test_inspire_answer_that_comes_too_late_is_not_taken_for_the_next_one(rigs, monkeypatch):
    rig = rigs("inspire-touch", patience=0.3)
    device, receive = rig.open(), rig.hand.receive
    rig.hand.motors.place([100.0] * 6)
    device.read()

    def slow(request: bytes) -> bytes:
        monkeypatch.setattr(rig.hand, "receive", receive)
        answer = receive(request)
        time.sleep(0.6)
        return answer

    monkeypatch.setattr(rig.hand, "receive", slow)
    with pytest.raises(WrongAnswerError):
        device.read()
    rig.hand.motors.place([700.0] * 6)
    assert until(lambda: quiet(device)).positions.tolist() == [700.0] * 6


def test_the_monitor_prints_the_pads(rigs, capsys):
    rig = rigs("inspire-touch")
    rig.hand.touch["index", "tip"][1, 2] = 900
    argv = ["hardware", "monitor", rig.sink, "--json", "--seconds"]
    until(lambda: main([*argv, "1"]) == 0)
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    pads = [line["pads"] for line in lines if "pads" in line]
    assert pads[-1]["index_tip"] == [[0, 0, 0], [0, 0, 900], [0, 0, 0]]


@pytest.mark.parametrize(("name", "force"), [("rohand-gen1", 9000), ("rohand", 0)])
def test_rohand_sets_limits_by_generation_and_never_starts_force_control(rigs, name, force):
    rig = rigs(name)
    device = rig.open(speed=30000, force=9000)
    device.write(np.zeros(6))
    assert rig.limits() == [900] * 6 + [force] * 5 + [30000] * 6
    assert all((s.measured == s.expected).all() for s in device.settings())


@pytest.mark.parametrize("name", ["rohand-gen1", "rohand"])
def test_rohand_reports_forces_currents_and_why_a_motor_stopped(rigs, name):
    rig = rigs(name)
    hand, device = rig.hand, rig.open()
    hand.forces[:] = [100, 200, 300, 400, 500]
    hand.motors.stuck.update({1, 2})
    hand.motors.stall_current = 500.0
    device.write(np.full(6, 60000.0))
    first = until(lambda: (r := read(device, 4)).errors and r)
    assert first.errors == ("index: stuck", "middle: stuck")
    assert first.currents[1] == 500
    assert first.touch.tolist() == [100, 200, 300, 400, 500]
    assert first.temperatures is None
    assert hand.read(1086, 1) == [STUCK]
    hand.motors.stall_current = 1000.0
    second = until(lambda: (r := read(device, 4)).errors != first.errors and r)
    assert second.errors == tuple(f"{n}: stopped by its current limit" for n in ("index", "middle"))
    hand.motors.stuck.clear()
    device.write(np.full(6, 60000.0))  # starts it again
    until(lambda: hand.motors.positions[1] > 1000)


def test_rohand_of_an_unknown_generation_or_without_modbus_is_refused(rigs):
    rig = rigs("rohand")
    rig.hand._registers[1000] = 3 << 8
    with pytest.raises(SinkError, match=r"has version 3 of the protocol, not 1 or 2; check"):
        rig.open()
    rig.patience(0.1)
    with pytest.raises(SinkError, match=r"no valid answer from device 3 .* is device 3"):
        rig.open(device_id=3)
    with pytest.raises(ConfigError, match="rohand has no setting 'baud'"):
        rig.open(baud=9600)


def test_rohand_that_initialises_says_so_and_is_used_afterwards(rigs):
    rig = rigs("rohand")
    rig.hand.init_time = 0.5
    rig.hand.reboot()
    with pytest.raises(WrongAnswerError, match=r"refused register 1000 .it is initialising"):
        rig.open()
    until(lambda: rig.hand._clock() >= rig.hand._ready_at)
    rig.open()


@pytest.mark.parametrize("side", ["right", "left"])
def test_dex3_motors_are_in_the_order_of_their_side(rigs, side):
    rig = rigs("dex3", side)
    from simulators.dex3_dds import ORDER

    hand, device = rig.hand, rig.open(kp=1.0, kd=0.1)
    assert device._table.names == ORDER[side]
    sign = 1.0 if side == "right" else -1.0
    goal = np.array([{"t": -0.1, "m": 0.4, "i": 0.9}[name[0]] for name in ORDER[side]]) * sign
    device.write(goal)
    until(lambda: np.abs(device.read().positions - goal).max() < 1e-6)
    assert np.abs(hand.motors.positions - goal).max() < 1e-6
    motor = hand.commands[-1].motor_cmd[6]
    assert (motor.mode, motor.tau) == (0x16, 0.0)
    assert (motor.kp, motor.kd) == pytest.approx((1.0, 0.1))
    device.relax()
    until(lambda: not hand.motors.powered.any())
    assert {(m.mode >> 4 & 7, m.kp, m.kd) for m in hand.commands[-1].motor_cmd} == {(1, 0.0, 0.0)}


def test_dex3_reports_heat_torque_pressure_and_errors(rigs):
    rig = rigs("dex3")
    hand, device = rig.hand, rig.open()
    hand.motors.temperatures[0] = 90
    hand.motor_errors[2], hand.error[1] = 4, 0x10
    hand.pressure[8, 11] = 123000.0
    hand.motors.stuck.add(3)
    device.write(np.full(7, 0.2))
    reading = until(lambda: (r := device.read()).currents[3] > 0 and r)
    assert reading.temperatures.tolist() == [90, 30, 30, 30, 30, 30, 30]
    assert reading.currents[3] == pytest.approx(800.0)
    assert reading.touch[-1] == 123000.0
    assert reading.errors == ("thumb_2: error 0x4", "hand: error 0x10")


def test_dex3_names_another_program_that_commands_the_hand(rigs):
    rig = rigs("dex3")
    from cyclonedds.domain import DomainParticipant
    from cyclonedds.pub import DataWriter
    from cyclonedds.topic import Topic
    from simulators.dex3_dds import HandCmd, MotorCmd

    device = rig.open()
    for _ in range(5):
        device.write(np.zeros(7))
        assert not device.read().errors
    participant = DomainParticipant(rig.domain)
    other = DataWriter(participant, Topic(participant, "rt/dex3/right/cmd", HandCmd))
    motors = [MotorCmd(k | 0x10, 0.3, 0.0, 0.0, 1.5, 0.2, 0) for k in range(7)]

    def named() -> bool:
        other.write(HandCmd(motors, [0] * 4))
        return device.read().errors == ("another program commands the hand: end it",)

    until(named)


def test_dex3_settings_and_the_lock_of_a_side():
    assert build_sink("dex3:side=left,domain=1").bus == "dex3:1-left"
    assert build_sink("dex3").bus == "dex3"
    with pytest.raises(ConfigError, match="dex3: domain"):
        build_sink("dex3:domain=300")
