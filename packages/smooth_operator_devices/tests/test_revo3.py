"""Driver of the Revo 3 against a stand-in of the maker's package."""

import time
from collections.abc import Callable, Iterator

import numpy as np
import pytest
from live_time import until
from simulators.common import opening
from simulators.revo3_sdk import JOINTS, RANGES, Revo3, Revo3Model, revo3_modules
from simulators.sdk import installed

from smooth_operator.errors import SinkError
from smooth_operator_devices.hands.actuator_map import built_in_tables, read_table
from smooth_operator_devices.hands.device import WrongAnswerError
from smooth_operator_devices.hands.drivers import revo3
from smooth_operator_devices.hands.drivers.revo3 import Revo3Device

PORT = "/dev/ttyRevo3"
TABLE = read_table(built_in_tables() / "revo3_right.toml")


@pytest.fixture
def hand() -> Revo3:
    return Revo3("right", PORT)


@pytest.fixture
def open_device(hand, monkeypatch) -> Iterator[Callable[[], Revo3Device]]:
    monkeypatch.setattr(revo3, "_TIMEOUT", 3.0)  # the machine may be busy
    with installed(revo3_modules(hand)), opening(lambda: Revo3Device(TABLE, PORT)) as opened:
        yield opened


def test_revo3_has_the_order_and_ranges_of_the_maker(hand, open_device):
    assert TABLE.names == JOINTS
    np.testing.assert_array_equal(RANGES, revo3.RANGES)
    np.testing.assert_array_equal([a.ends for a in TABLE.actuators], RANGES)
    device = open_device()
    assert hand.sent == []
    goal = np.arange(21.0)
    goal[20] = 400.0  # the hand refuses targets beyond a range
    device.write(goal)
    kind, sent = hand.sent[-1]
    assert kind == "servo position"
    assert sent == pytest.approx(np.clip(goal, RANGES[:, 0], RANGES[:, 1]))


def test_revo3_opens_a_session_that_expired_again(hand, open_device, monkeypatch):
    monkeypatch.setattr(revo3, "_SESSION_MS", 20)
    device = open_device()
    device.write(np.zeros(21))
    time.sleep(0.05)
    assert hand.sessions[0].state.name == "Expired"
    device.write(np.full(21, 1.0))
    assert len(hand.sent) == 2
    assert len(hand.sessions) >= 2


def test_revo3_relaxes_to_zero_force_and_reports_faults_and_heat(hand, open_device, monkeypatch):
    monkeypatch.setattr(revo3, "_SLOW", 2)
    device = open_device()
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


def test_revo3_outage_restart_and_a_second_program(hand, open_device):
    device = open_device()
    device.write(np.zeros(21))
    hand.faults.silent = True
    with pytest.raises(WrongAnswerError, match="failed"):
        device.write(np.zeros(21))
    device.close()
    with pytest.raises(SinkError, match=r"connecting failed .* check the hand's power"):
        device.open()
    hand.faults.silent = False
    hand.reboot()
    device.open()
    device.write(np.zeros(21))
    other = Revo3Device(TABLE, PORT)  # the hand takes one session
    other.open()
    with pytest.raises(WrongAnswerError, match="a servo session is active"):
        other.write(np.zeros(21))
    other.close()


def test_revo3_of_the_other_side_or_a_model_that_cannot_move_is_refused(hand, open_device):
    hand.side = "left"
    with pytest.raises(SinkError, match="is a left hand"):
        open_device()
    hand.side, hand.model = "right", Revo3Model.Pro
    device = open_device()
    with pytest.raises(WrongAnswerError, match="can't be moved yet"):
        device.write(np.zeros(21))
