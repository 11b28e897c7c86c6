"""Driver of the Dex3-1 against a simulated hand on a DDS domain."""

import os
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
import pytest
from live_time import until

from smooth_operator.errors import ConfigError, SinkError
from smooth_operator.teleop.components import build_sink
from smooth_operator_devices.hands.actuator_map import built_in_tables, read_table
from smooth_operator_devices.hands.device import WrongAnswerError
from smooth_operator_devices.hands.drivers import dex3
from smooth_operator_devices.hands.drivers.dex3 import Dex3Device

pytest.importorskip("cyclonedds", reason="needs cyclonedds")

from hand_rigs import ON_LOOPBACK
from simulators.common import opening
from simulators.dex3_dds import ORDER, Dex3Hand, HandCmd, MotorCmd

DOMAIN = 101 + os.getpid() % 100


@pytest.fixture(params=["right", "left"])
def hand(request, monkeypatch) -> Iterator[Dex3Hand]:
    monkeypatch.setenv("CYCLONEDDS_URI", ON_LOOPBACK)
    monkeypatch.setattr(dex3, "_TIMEOUT", 3.0)  # the machine may be busy
    with Dex3Hand(request.param, domain=DOMAIN) as simulated:
        yield simulated


@pytest.fixture
def open_device(hand) -> Iterator[Callable[..., Dex3Device]]:
    table = read_table(built_in_tables() / f"dex3_{hand.side}.toml")
    with opening(lambda **more: Dex3Device(replace(table, settings=more), DOMAIN)) as opened:
        yield opened


def test_dex3_motors_are_in_the_order_of_their_side(hand, open_device):
    device = open_device(kp=1.0, kd=0.1)
    assert device._table.names == ORDER[hand.side]
    sign = 1.0 if hand.side == "right" else -1.0
    goal = np.array([{"t": -0.1, "m": 0.4, "i": 0.9}[n[0]] for n in ORDER[hand.side]]) * sign
    device.write(goal)
    until(lambda: np.abs(device.read().positions - goal).max() < 1e-6)
    assert np.abs(hand.motors.positions - goal).max() < 1e-6
    motor = hand.commands[-1].motor_cmd[6]
    assert (motor.mode, motor.tau) == (0x16, 0.0)
    assert (motor.kp, motor.kd) == pytest.approx((1.0, 0.1))
    device.relax()
    until(lambda: not hand.motors.powered.any())
    assert {(m.mode >> 4 & 7, m.kp, m.kd) for m in hand.commands[-1].motor_cmd} == {(1, 0.0, 0.0)}


def test_dex3_reports_heat_torque_pressure_and_errors(hand, open_device):
    device = open_device()
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


def test_dex3_names_another_program_that_commands_the_hand(hand, open_device):
    from cyclonedds.domain import DomainParticipant
    from cyclonedds.pub import DataWriter
    from cyclonedds.topic import Topic

    device = open_device()
    for _ in range(5):
        device.write(np.zeros(7))
        assert not device.read().errors
    participant = DomainParticipant(DOMAIN)
    other = DataWriter(participant, Topic(participant, f"rt/dex3/{hand.side}/cmd", HandCmd))
    motors = [MotorCmd(k | 0x10, 0.3, 0.0, 0.0, 1.5, 0.2, 0) for k in range(7)]

    def named() -> bool:
        other.write(HandCmd(motors, [0] * 4))
        return device.read().errors == ("another program commands the hand: end it",)

    until(named)


def read(device: Dex3Device, times: int) -> None:
    for _ in range(times):
        device.read()


def test_dex3_state_of_fewer_motors_and_an_outage_are_wrong_answers(hand, open_device, monkeypatch):
    device = open_device()
    hand.faults.answer_wrongly("short", 5)
    with pytest.raises(WrongAnswerError, match="a state with 5 motors"):
        read(device, 20)
    monkeypatch.setattr(dex3, "_TIMEOUT", 0.1)
    monkeypatch.setattr(dex3, "_FINDING_S", 0.1)
    hand.faults.silent = True
    with pytest.raises(WrongAnswerError, match="no state of the hand"):
        read(device, 5)
    device.close()
    with pytest.raises(SinkError, match=f"check the hand's power, that it is the {hand.side} one"):
        device.open()


def test_dex3_settings_and_the_lock_of_a_side():
    assert build_sink("dex3:side=left,domain=1").bus == "dex3:1-left"
    assert build_sink("dex3").bus == "dex3"
    with pytest.raises(ConfigError, match="dex3: domain"):
        build_sink("dex3:domain=300")
