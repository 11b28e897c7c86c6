"""Driver of the XHand against a stand-in of the maker's package."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from simulators.common import opening
from simulators.sdk import installed
from simulators.xhand_sdk import XHand, xhand_modules

from smooth_operator.errors import ConfigError, SinkError
from smooth_operator.teleop.components import build_sink
from smooth_operator_devices.hands.actuator_map import built_in_tables, read_table
from smooth_operator_devices.hands.device import DeviceLostError, WrongAnswerError
from smooth_operator_devices.hands.drivers.xhand import XHandDevice

PORT = "/dev/ttyXHand"
TABLE = read_table(built_in_tables() / "xhand_right.toml")


@pytest.fixture
def hands() -> list[XHand]:
    return [XHand("right", PORT, 5)]


@pytest.fixture
def open_device(hands) -> Iterator[Callable[..., XHandDevice]]:
    def made(**settings: Any) -> XHandDevice:
        return XHandDevice(replace(TABLE, settings={**TABLE.settings, **settings}), PORT)

    with installed(xhand_modules(*hands)), opening(made) as opened:
        yield opened


def test_xhand_commands_have_position_mode_gains_and_limit(hands, open_device):
    device = open_device(kp=120)
    assert hands[0].commands == []
    goal = np.linspace(-0.1, 1.0, 12)
    device.write(goal)
    sent = hands[0].commands[-1]
    assert [row[:4] for row in sent] == [(k, 120, 0, 0) for k in range(12)]
    assert [row[4] for row in sent] == pytest.approx(goal)
    assert {row[5:] for row in sent} == {(300, 3)}
    device.relax()
    assert len(hands[0].commands) == 1  # nothing is known to free it: it holds


def test_xhand_reports_torques_heat_touch_and_errors(hands, open_device):
    device = open_device()
    hand = hands[0]
    hand.motors.stuck.add(5)
    hand.motors.temperatures[3] = 0x0141  # the low byte is the temperature
    hand.joint_errors[4] = 2
    hand.touch[1, :, 2] = 1
    device.write(np.full(12, 0.5))
    reading = device.read()
    assert reading.currents[5] == 800
    assert reading.temperatures[3] == 65
    assert reading.errors == ("index_1: error 0x2 of the joint board",)
    assert reading.touch.tolist() == [0, 0, 0, 0, 0, 120, *[0] * 9]


def test_xhand_that_restarts_is_found_by_its_new_identifier(hands, open_device):
    device = open_device()
    hands[0].reboot()
    with pytest.raises(DeviceLostError, match="no hand 5"):
        device.read()
    device.close()
    device.open()
    device.write(np.full(12, 0.1))
    assert len(hands[0].commands) == 1


def test_xhand_failed_calls_and_outages_are_errors(hands, open_device):
    device = open_device()
    hands[0].faults.answer_wrongly("error")
    with pytest.raises(WrongAnswerError, match=r"communication error .error 1501050"):
        device.read()
    assert device.read().positions.tolist() == [0.0] * 12
    hands[0].faults.silent = True
    with pytest.raises(WrongAnswerError):
        device.write(np.zeros(12))
    device.close()
    with pytest.raises(SinkError, match=r"the hands .. answer at .*, expected one"):
        device.open()


def test_xhand_of_the_other_side_or_with_a_second_program_is_refused(hands, open_device):
    hands[0].side = "left"
    with pytest.raises(SinkError, match="is a left hand"):
        open_device()
    hands[0].occupied = True
    with pytest.raises(SinkError, match=r"failed .* check .* that no other program uses it"):
        open_device()


def test_xhand_is_chosen_among_two_on_a_port(hands, open_device):
    hands.append(XHand("right", PORT, 6))
    with (
        installed(xhand_modules(*hands)),
        pytest.raises(SinkError, match=r"name one by settings\.device_id"),
    ):
        open_device()
    with installed(xhand_modules(*hands)):
        open_device(device_id=6).write(np.zeros(12))
    assert [len(hand.commands) for hand in hands] == [0, 1]


def test_xhand_without_the_makers_package_says_where_to_get_it():
    sink = build_sink("xhand")
    with pytest.raises(ConfigError, match="install the wheel that RobotEra gives"):
        sink.device(TABLE)
