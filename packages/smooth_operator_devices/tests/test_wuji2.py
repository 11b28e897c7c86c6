"""Driver of the Wuji Hand 2 against a stand-in of the maker's package."""

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
import pytest
from live_time import until
from simulators.common import opening
from simulators.sdk import installed
from simulators.wuji_sdk import OVERCURRENT, STALL, Hand, wuji_modules

from smooth_operator.errors import SinkError
from smooth_operator_devices.hands.actuator_map import built_in_tables, read_table
from smooth_operator_devices.hands.device import DeviceLostError, WrongAnswerError
from smooth_operator_devices.hands.drivers import wuji2
from smooth_operator_devices.hands.drivers.wuji2 import Wuji2Device

TABLE = read_table(built_in_tables() / "wuji2_right.toml")


@pytest.fixture
def hand() -> Hand:
    return Hand("right")


@pytest.fixture
def open_device(hand, monkeypatch) -> Iterator[Callable[..., Wuji2Device]]:
    monkeypatch.setattr(wuji2, "_TIMEOUT", 3.0)  # the machine may be busy

    def made(port: str = "", limit: float | None = 600.0) -> Wuji2Device:
        return Wuji2Device(replace(TABLE, limit=limit), port)

    with installed(wuji_modules(hand)), opening(made) as opened:
        yield opened


def test_wuji2_sets_limits_before_it_switches_the_motors_on(hand, open_device):
    device = open_device()
    assert (hand.commands, any(hand.enabled), hand.effort_limits[0]) == ([], False, 1.5)
    device.write(np.linspace(0, 0.5, 20))
    assert hand.effort_limits == [0.6] * 20
    assert all(hand.enabled)
    until(lambda: np.abs(device.read().positions - np.linspace(0, 0.5, 20)).max() < 1e-6)
    assert device.settings()[0].measured.tolist() == [0.6] * 20
    device.relax()
    assert not any(hand.enabled)
    device.write(device.read().positions)
    device.close()
    assert not any(hand.enabled)


def test_wuji2_joints_are_mapped_by_their_nid(hand, open_device):
    device = open_device()
    hand.motors.place(np.arange(20) / 100)
    hand.offline.update({0, 7})
    reading = device.read()
    expected = np.arange(20) / 100
    expected[[0, 7]] = np.nan
    np.testing.assert_allclose(reading.positions, expected)
    assert reading.errors == ("thumb_1: offline", "index_4: offline")
    with pytest.raises(WrongAnswerError, match="a joint is offline"):
        device.settings()


def test_wuji2_reports_faults_by_name_and_clears_them_with_the_first_command(hand, open_device):
    device = open_device()
    hand.motors.temperatures[9] = 71
    hand.set_fault(3, OVERCURRENT)
    hand.set_fault(4, STALL)
    reading = until(lambda: (r := device.read()).errors and r)
    assert reading.errors == ("thumb_4: Overcurrent (0x2102)", "index_1: Stall (0x0007)")
    assert reading.temperatures[9] == 71
    device.write(np.zeros(20))
    until(lambda: not device.read().errors)
    assert hand.motors.powered.all()


def test_wuji2_outage_is_a_wrong_answer_and_a_restart_a_lost_hand(hand, open_device, monkeypatch):
    device = open_device()
    monkeypatch.setattr(wuji2, "_TIMEOUT", 0.05)
    hand.faults.silent = True
    with pytest.raises(WrongAnswerError, match="no state of the hand within"):
        device.read()
    hand.faults.silent = False
    assert np.isfinite(device.read().positions).all()
    hand.reboot()
    with pytest.raises(DeviceLostError, match="wuji2: StreamClosed"):
        device.read()
    device.close()
    device.open()
    device.write(np.zeros(20))
    assert hand.effort_limits == [0.6] * 20


def test_wuji2_of_the_other_side_or_an_unknown_number_is_refused(hand, open_device):
    with pytest.raises(SinkError, match="Device not found; check the hand's power"):
        open_device("WH2K999")
    other = Hand("left")
    with (
        installed(wuji_modules(other)),
        pytest.raises(SinkError, match="the hand is a left hand"),
    ):
        open_device(other.sn)


def test_wuji2_without_a_limit_keeps_that_of_the_hand(hand, open_device):
    hand.effort_limits = [1.1] * 20
    open_device(limit=None).write(np.zeros(20))
    assert hand.effort_limits == [1.1] * 20
