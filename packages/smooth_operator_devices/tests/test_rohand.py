"""Driver of the ROHand against the simulator of its Modbus registers."""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from live_time import until

from smooth_operator.errors import ConfigError, SinkError
from smooth_operator_devices.hands.actuator_map import built_in_tables, read_table
from smooth_operator_devices.hands.device import WrongAnswerError
from smooth_operator_devices.hands.drivers import modbus_line
from smooth_operator_devices.hands.drivers.rohand import RohandDevice

pytest.importorskip("pymodbus", reason="needs pymodbus")
pytest.importorskip("termios", reason="needs a pty")

from simulators.common import SerialLine
from simulators.rohand_modbus import OVER_CURRENT, STUCK, RoHand, crc

TABLE = read_table(built_in_tables() / "rohand_right.toml")


GENERATIONS = pytest.mark.parametrize("hand", [1, 2], indirect=True)


@pytest.fixture
def hand(request, monkeypatch) -> RoHand:
    monkeypatch.setattr(modbus_line, "TIMEOUT", 3.0)  # the machine may be busy
    return RoHand(getattr(request, "param", 2))


@pytest.fixture
def line(hand) -> Iterator[SerialLine]:
    with SerialLine(hand) as serial:
        yield serial


def opened(line: SerialLine, **settings: Any) -> RohandDevice:
    device = RohandDevice(replace(TABLE, settings={**TABLE.settings, **settings}), line.port)
    device.open()
    return device


@GENERATIONS
def test_rohand_sets_limits_by_generation_and_never_starts_force_control(hand, line):
    device = opened(line, speed=30000, force=9000)
    device.write(np.zeros(6))
    assert hand.read(1095, 6) == [900] * 6
    assert hand.read(1125, 6) == [30000] * 6
    assert hand.read(1115, 5) == ([9000] * 5 if hand.generation == 1 else [0] * 5)
    assert all((s.measured == s.expected).all() for s in device.settings())
    hand.reboot()
    lost = {s.name for s in device.settings() if (s.measured != s.expected).any()}
    assert lost >= {"speed", "current limit"}
    device.close()


@GENERATIONS
def test_rohand_reports_forces_currents_and_why_a_motor_stopped(hand, line):
    device = opened(line)
    hand.forces[:] = [100, 200, 300, 400, 500]
    hand.motors.stuck.update({1, 2})
    device.write(np.full(6, 60000.0))
    hand.motors.stall_current = 500.0

    def reading() -> Any:
        device.read()
        device.read()
        device.read()
        return device.read()

    first = until(lambda: (r := reading()).errors and r)
    assert first.errors == ("index: stuck", "middle: stuck")
    assert first.currents[1] == 500
    assert first.touch.tolist() == [100, 200, 300, 400, 500]
    assert first.temperatures is None
    assert hand.read(1086, 1) == [STUCK]
    hand.motors.stall_current = 1000.0
    second = until(lambda: (r := reading()).errors != first.errors and r)
    assert second.errors == tuple(f"{n}: stopped by its current limit" for n in ("index", "middle"))
    hand.motors.stuck.clear()
    assert hand.read(1086, 1) == [OVER_CURRENT]
    device.write(np.full(6, 60000.0))  # starts it again
    until(lambda: hand.motors.positions[1] > 1000)
    device.close()


def test_rohand_of_an_unknown_generation_or_without_modbus_is_refused(hand, line, monkeypatch):
    hand._registers[1000] = 3 << 8
    with pytest.raises(SinkError, match=r"has version 3 of the protocol, not 1 or 2; check"):
        opened(line)
    monkeypatch.setattr(modbus_line, "TIMEOUT", 0.1)
    with pytest.raises(SinkError, match=r"no valid answer from device 3 .* is device 3"):
        opened(line, device_id=3)
    with pytest.raises(ConfigError, match="rohand has no setting 'baud'"):
        opened(line, baud=9600)


def test_rohand_that_initialises_says_so_and_is_used_afterwards(hand, line):
    hand.init_time = 0.5
    hand.reboot()
    with pytest.raises(WrongAnswerError, match=r"refused register 1000 .it is initialising"):
        opened(line)
    until(lambda: hand.read(1095, 1) and hand._clock() >= hand._ready_at)
    opened(line).close()


@pytest.mark.parametrize("kind", ["checksum", "identifier", "short"])
def test_rohand_answers_with_an_error_are_dropped(hand, line, kind, monkeypatch):
    monkeypatch.setattr(modbus_line, "TIMEOUT", 0.3)
    device = opened(line)
    hand.faults.answer_wrongly(kind)
    with pytest.raises(WrongAnswerError, match="no valid answer"):
        device.read()
    until(lambda: works(device))
    device.close()


def works(device: RohandDevice) -> bool:
    try:
        return bool((device.read().positions == 0).all())
    except WrongAnswerError:
        return False


def test_rohand_recovers_from_the_questions_of_another_program(hand, line):
    device = opened(line)
    request = bytes([2, 3, *(1135).to_bytes(2, "big"), 0, 1])
    line.second_program(request + crc(request))
    until(lambda: works(device) and works(device))
    device.close()
