"""Driver of the DexHand021 against the simulator of its CAN FD frames."""

import contextlib
import itertools
import os
import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from live_time import until

from smooth_operator.errors import SinkError
from smooth_operator_devices.hands.actuator_map import built_in_tables, read_table
from smooth_operator_devices.hands.device import Reading, WrongAnswerError
from smooth_operator_devices.hands.drivers import dexhand021
from smooth_operator_devices.hands.drivers.dexhand021 import DexHand021Device

pytest.importorskip("can", reason="needs python-can")

import can
from simulators.common import opening, serve_can
from simulators.dexhand021_can import JOINTS, OVERLOAD, STALL, DexHand021

_channels = itertools.count()


@pytest.fixture(params=["right", "left"])
def side(request) -> str:
    return request.param


@pytest.fixture
def hand(side, monkeypatch) -> DexHand021:
    monkeypatch.setattr(dexhand021, "_TIMEOUT", 3.0)  # the machine may be busy
    return DexHand021(side)


@pytest.fixture
def wire() -> str:
    return f"dexhand-protocol-{next(_channels)}-{os.getpid()}"


@pytest.fixture
def open_device(hand, side, wire) -> Iterator[Callable[[], DexHand021Device]]:
    def made(of: str = "") -> DexHand021Device:
        table = read_table(built_in_tables() / f"dexhand021_{of or side}.toml")
        return DexHand021Device(table, f"virtual:{wire}")

    with serve_can(hand, can.Bus(wire, interface="virtual")), opening(made) as opened:
        yield opened


def test_dexhand021_frames_are_those_of_the_maker(hand, open_device):
    device = open_device()
    assert device._table.names == JOINTS
    device.write(np.arange(12.0))

    def sent() -> list[tuple[int, bytes]]:
        return [(i, d[:6]) for i, d in list(hand.received) if i & 0xF80 == 0x100]

    commands = until(lambda: len(sent()) == 6 and sent())
    assert [identifier for identifier, _ in commands] == [0x100 + hand.base + b for b in range(6)]
    assert commands[1][1] == bytes([0x44, 3]) + (200).to_bytes(2, "little") + (300).to_bytes(
        2, "little"
    )
    until(lambda: np.abs(device.read().positions - np.arange(12.0)).max() < 0.01)
    device.relax()
    until(lambda: not hand.motors.powered.any())
    assert set(hand.modes) == {0}


def test_dexhand021_reports_currents_heat_and_touch(hand, open_device):
    device = open_device()
    hand.motors.temperatures[4] = 70
    hand.touch[3] = {"normal": 2.5, "tangential": 0.5, "direction": 90}
    hand.motors.stuck.add(5)
    device.write(np.full(12, 20.0))
    reading = until(lambda: (r := device.read()).currents[5] == 800 and r)
    assert reading.temperatures[4:6].tolist() == [70, 70]
    assert np.isnan(reading.temperatures[2:4]).all()  # the palm's board has no fingertip
    assert reading.touch.tolist() == [0, 0, 0, 0, 2.5, 0.5, 0, 0, 0, 0]


def test_dexhand021_motor_that_stalled_follows_again_from_where_it_stands(hand, open_device):
    device = open_device()
    device.write(np.full(12, 5.0))
    until(lambda: np.abs(device.read().positions - 5.0).max() < 0.01)
    hand.raise_error("ff_mcp", STALL)
    hand.raise_error("mf_dip", OVERLOAD)

    def after(command: float) -> Reading:
        device.write(np.full(12, command))
        return device.read()

    reading = until(lambda: len((r := after(40.0)).errors) == 2 and r)
    assert reading.errors == ("ff_mcp: stalled", "mf_dip: too much current")
    assert hand.errors[5] == STALL  # it is not switched on far from its command
    assert hand.motors.positions[5] == pytest.approx(5.0)
    until(lambda: not after(6.0).errors)
    until(lambda: abs(after(40.0).positions[5] - 40.0) < 0.01)


def test_dexhand021_boards_that_do_not_report_are_wrong_answers(hand, open_device, monkeypatch):
    device = open_device()
    monkeypatch.setattr(dexhand021, "_TIMEOUT", 0.2)
    hand.dead_boards.add(3)
    with pytest.raises(WrongAnswerError, match=f"no feedback of board {hand.base + 3} within"):
        device.read()
    hand.dead_boards.clear()
    assert device.read().positions.tolist() == [0.0] * 12
    hand.reboot()  # it reports nothing until it is asked again
    time.sleep(0.1)
    with pytest.raises(WrongAnswerError, match=f"no feedback of board {hand.base} within"):
        device.read()
    device.close()
    device.open()
    assert device.read().positions.tolist() == [0.0] * 12


@pytest.mark.parametrize("kind", ["identifier", "short"])
def test_dexhand021_wrong_frames_are_no_feedback(hand, open_device, kind, monkeypatch):
    device = open_device()
    monkeypatch.setattr(dexhand021, "_TIMEOUT", 0.2)
    hand.faults.answer_wrongly(kind, 10**4)
    time.sleep(0.1)
    device._collect(0.0)
    with pytest.raises(WrongAnswerError, match=r"no feedback|of 3 bytes"):
        device.read()
    hand.faults._wrong.clear()
    until(lambda: right(device))


def right(device: DexHand021Device) -> bool:
    with contextlib.suppress(WrongAnswerError):
        return bool((device.read().positions == 0.0).all())
    return False


def test_dexhand021_of_the_other_side_is_refused(hand, open_device, side, monkeypatch):
    monkeypatch.setattr(dexhand021, "_TIMEOUT", 0.2)
    other = "left" if side == "right" else "right"
    with pytest.raises(SinkError, match=f"that it is not a {side} hand"):
        open_device(other)


def test_dexhand021_ignores_frames_of_other_devices(hand, open_device, wire):
    device = open_device()
    spy: Any = can.Bus(wire, interface="virtual")
    for identifier in (0x180 + 40, 0x600 + 40, 0x27, 0x100 + hand.base):
        spy.send(can.Message(arbitration_id=identifier, data=[1, 2, 3], is_extended_id=False))
    reading = device.read()
    spy.shutdown()
    assert (reading.positions.tolist(), reading.errors) == ([0.0] * 12, ())
