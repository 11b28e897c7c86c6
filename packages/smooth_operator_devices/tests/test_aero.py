"""Driver of the Aero Hand Open against the simulator of its frames."""

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
import pytest
from live_time import until

from smooth_operator.errors import ConfigError, SinkError
from smooth_operator_devices.hands.actuator_map import built_in_tables, read_table
from smooth_operator_devices.hands.device import DeviceLostError, WrongAnswerError
from smooth_operator_devices.hands.drivers import aero
from smooth_operator_devices.hands.drivers.aero import AeroDevice

pytest.importorskip("serial", reason="needs pyserial")
pytest.importorskip("termios", reason="needs a pty")

from simulators.aero_hand import AeroHand
from simulators.common import SerialLine, opening

TABLE = read_table(built_in_tables() / "aero_right.toml")


@pytest.fixture
def hand(monkeypatch) -> AeroHand:
    monkeypatch.setattr(aero, "_TIMEOUT", 3.0)  # the machine may be busy
    monkeypatch.setattr(aero, "_PROBE", 0.2)
    return AeroHand("right")


@pytest.fixture
def line(hand) -> Iterator[SerialLine]:
    with SerialLine(hand) as serial:
        yield serial


@pytest.fixture
def open_device(line) -> Iterator[Callable[..., AeroDevice]]:
    with opening(lambda **more: AeroDevice(replace(TABLE, settings=more), line.port)) as opened:
        yield opened


def lose(hand: AeroHand, count: int) -> None:
    """The hand does not get the next bytes."""
    receive = hand.receive

    def without(data: bytes) -> bytes:
        hand.receive = receive  # type: ignore[method-assign]
        return receive(data[count:])

    hand.receive = without  # type: ignore[method-assign]


def test_aero_limits_are_set_before_the_first_command_and_again_after_power_on(hand, open_device):
    device = open_device(speed=9000, torque=400)
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


def test_aero_opens_while_the_hand_prints_text(hand, open_device):
    hand.reboot()
    assert len(hand.boot_text) % 16
    hand.motors.place(np.arange(7) * 9000.0)
    assert open_device().read().positions.tolist() == (np.arange(7) * 9000.0).tolist()


@pytest.mark.parametrize("count", [1, 7, 15])
def test_aero_finds_the_beginning_of_a_frame_after_lost_bytes(
    hand, open_device, count, monkeypatch
):
    device = open_device()
    monkeypatch.setattr(aero, "_TIMEOUT", 0.3)
    lose(hand, count)
    missed = 0

    def answered() -> bool:
        nonlocal missed
        try:
            return bool((device.read().positions == 0).all())
        except WrongAnswerError:
            missed += 1
            return False

    until(answered)
    assert 0 < missed <= 4
    assert (hand.motors.targets == 0).all()
    device.write(np.full(7, 30000.0))
    until(lambda: (device.read().positions == 30000).all())


def test_aero_opens_a_hand_whose_frames_are_shifted(hand, open_device):
    hand._buffer = bytes(5)  # what another program began to send
    assert open_device().read().positions.tolist() == [0.0] * 7


def test_aero_reads_currents_and_temperatures_and_relaxes(hand, open_device):
    device = open_device()
    hand.motors.stuck.add(4)
    hand.motors.temperatures[5] = 75
    device.write(np.full(7, 60000.0))
    for _ in range(4):
        reading = device.read()
    assert reading.temperatures.tolist() == [30, 30, 30, 30, 30, 75, 30]
    assert abs(reading.currents[4]) == pytest.approx(800, abs=6.5)
    device.relax()
    device.read()
    assert hand.torque_mode
    device.write(np.full(7, 60000.0))
    device.read()
    assert not hand.torque_mode


@pytest.mark.parametrize("kind", ["short", "operation"])
def test_aero_wrong_answers_are_dropped(hand, open_device, kind, monkeypatch):
    device = open_device()
    monkeypatch.setattr(aero, "_TIMEOUT", 0.3)
    hand.faults.answer_wrongly(kind)
    with pytest.raises(WrongAnswerError, match="no valid answer to operation 0x22"):
        device.read()
    assert device.read().positions.tolist() == [0.0] * 7


def test_aero_ignores_answers_to_another_program(hand, line, open_device):
    device = open_device()
    hand.motors.place(np.full(7, 500.0))
    for operation in (0x24, 0x25, 0x23):
        line.second_program(bytes([operation, *[0] * 15]))
        assert device.read().positions.tolist() == [500.0] * 7


def test_aero_that_homes_or_has_other_settings_is_refused(hand, open_device, monkeypatch):
    monkeypatch.setattr(aero, "_PROBE", 0.01)
    hand._homed_at = hand._clock() + 60
    with pytest.raises(SinkError, match=r"does not answer; check .* that it is not homing"):
        open_device()
    with pytest.raises(ConfigError, match="torque must be a whole number from 1 to 1000"):
        open_device(torque=1023)


def test_aero_table_is_the_coupling_of_the_makers_package():
    """A straight and a closed hand by the maker's coefficients: the ends of its ranges."""
    closed = {"cmc_abd": 100, "cmc_flex": 55, "mcp": 90, "ip": 90}
    closed |= {"mcp_flex": 90, "pip": 90, "dip": 90}
    for actuator in TABLE.actuators:
        degrees = {
            joint: weight * np.deg2rad(closed[joint.split("_", 2)[2]])
            for joint, weight in actuator.joints.items()
            if weight > 0
        }
        assert actuator.command(sum(degrees.values())) == pytest.approx(65535, abs=15)
        low = 0.27778 * np.deg2rad(55) if actuator.name == "thumb_tendon" else 0.0
        assert actuator.command(-low) == pytest.approx(0, abs=15)
