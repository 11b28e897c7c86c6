"""The Inspire driver on a simulated RH56 DFTP: touch pads, and transaction numbers that differ."""

import contextlib
import json
import socket
import struct
import threading
import time
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from live_time import until
from simulators.inspire_touch import InspireTouchHand

from smooth_operator.cli import main
from smooth_operator_devices.hands.actuator_map import ActuatorMap, built_in_tables, read_table
from smooth_operator_devices.hands.device import Reading, WrongAnswerError
from smooth_operator_devices.hands.drivers import modbus_line
from smooth_operator_devices.hands.drivers.inspire import InspireDevice
from smooth_operator_devices.hands.drivers.inspire_touch import BLOCKS

pytest.importorskip("pymodbus", reason="the extra inspire is not installed")


@pytest.fixture(autouse=True)
def patience(monkeypatch) -> None:
    """The machine may be busy."""
    monkeypatch.setattr(modbus_line, "TIMEOUT", 2.0)


@pytest.fixture
def hand() -> Iterator[InspireTouchHand]:
    with InspireTouchHand() as hand:
        yield hand


def table(**settings: object) -> ActuatorMap:
    found = read_table(built_in_tables() / "inspire_ftp_right.toml")
    return replace(found, settings={**found.settings, **settings})


@contextlib.contextmanager
def opened(hand: InspireTouchHand, **settings: object) -> Iterator[InspireDevice]:
    host, port = hand.address
    device = InspireDevice(table(**settings), f"{host}:{port}")
    device.open()
    try:
        yield device
    finally:
        device.close()


def whole(device: InspireDevice) -> Reading:
    """A reading of all pads, each read after now."""
    for _ in BLOCKS:
        reading = device.read()
    return reading


def test_every_pad_has_its_cells_in_rows_and_columns(hand):
    random = np.random.default_rng(1)
    for cells in hand.touch.values():
        cells[:] = random.integers(0, 4096, cells.shape)
    hand.forces[:] = 1, 2, 3, 4, 5, 6
    with opened(hand) as device:
        first = device.read()
        reading = whole(device)
    assert (first.touch, first.pads) == (None, {})
    names = {
        f"{finger}_{part}".removesuffix("_palm"): (finger, part) for finger, part in hand.touch
    }
    assert set(reading.pads) == set(names)
    for name, key in names.items():
        np.testing.assert_array_equal(reading.pads[name], hand.touch[key], name)
    assert reading.touch[:6].tolist() == [1, 2, 3, 4, 5, 6]
    assert reading.touch[6:].tolist() == [pad.sum() for pad in reading.pads.values()]


def test_no_question_has_more_words_than_the_protocol_allows(hand):
    with opened(hand) as device:
        whole(device)
    asked = [struct.unpack(">HH", request[8:12]) for request in hand.received if request[7] == 3]
    assert max(count for _, count in asked) <= 125
    assert {block for block in asked if block[0] >= 3000} == set(BLOCKS)
    assert sum(count for _, count in BLOCKS) == sum(pad.size for pad in hand.touch.values())


def test_a_hand_without_touch_pads_is_not_asked_for_them(hand):
    with opened(hand, touch=0) as device:
        reading = whole(device)
    assert reading.pads == {}
    assert len(reading.touch) == 6
    assert not any(struct.unpack(">H", request[8:10])[0] >= 3000 for request in hand.received)


@pytest.mark.parametrize("shift", [-1, 0, 1, 7])
def test_a_transaction_number_that_is_off_costs_nothing(hand, shift):
    hand.transaction_shift = shift
    with opened(hand) as device:
        for k in range(100):
            device.write(np.full(6, 900.0 - k))
            device.read()
        assert len(hand._clients) == 1  # it was never closed
        hand.motors.place([500.0] * 6)
        assert device.read().positions.tolist() == [500.0] * 6


def test_a_shift_that_changes_costs_one_answer(hand, monkeypatch):
    with opened(hand) as device:
        device.read()
        monkeypatch.setattr(modbus_line, "TIMEOUT", 0.2)
        hand.transaction_shift = -1
        with pytest.raises(WrongAnswerError, match="no valid answer from device 1"):
            device.read()
        for _ in range(50):
            device.read()


def test_an_answer_that_comes_too_late_is_not_taken_for_the_next_one(monkeypatch):
    monkeypatch.setattr(modbus_line, "TIMEOUT", 0.3)
    with InspireTouchHand() as hand:
        hand.transaction_shift = 1
        receive, late = hand.receive, threading.Event()

        def slow(request: bytes) -> bytes:
            answer = receive(request)
            if late.is_set():
                late.clear()
                time.sleep(0.6)
            return answer

        monkeypatch.setattr(hand, "receive", slow)
        with opened(hand) as device:
            hand.motors.place([100.0] * 6)
            device.read()
            late.set()
            with pytest.raises(WrongAnswerError):
                device.read()
            hand.motors.place([700.0] * 6)
            assert until(lambda: quiet(device)).positions.tolist() == [700.0] * 6


def quiet(device: InspireDevice) -> Reading | None:
    """A reading; None for a wrong answer."""
    with contextlib.suppress(WrongAnswerError):
        return device.read()
    return None


@pytest.mark.parametrize("kind", ["unit", "short"])
def test_one_wrong_answer_is_an_error_and_the_next_one_is_read(hand, kind, monkeypatch):
    hand.transaction_shift = 1
    with opened(hand) as device:
        monkeypatch.setattr(modbus_line, "TIMEOUT", 0.2)
        device.read()
        hand.faults.answer_wrongly(kind)
        with pytest.raises(WrongAnswerError, match="no valid answer"):
            device.read()
        assert until(lambda: quiet(device)).positions.tolist() == [1000.0] * 6


def test_a_second_program_changes_no_answer(hand):
    with opened(hand) as device, socket.create_connection(hand.address) as other:
        for k in range(50):
            other.sendall(struct.pack(">HHHBBHH", k, 0, 6, 1, 3, 1486, 6))
            device.write(np.full(6, 1000.0 - k))
            device.read()
        assert hand.motors.targets.tolist() == [951.0] * 6


def test_the_monitor_prints_the_pads(hand, capsys, tmp_path, monkeypatch):
    hand.touch["index", "tip"][1, 2] = 900
    host, port = hand.address
    text = (built_in_tables() / "inspire_ftp_right.toml").read_text()
    for ours, theirs in (
        ("right_thumb_1_joint", "thumb_proximal_yaw_joint"),
        ("right_thumb_2_joint", "thumb_proximal_pitch_joint"),
        ("right_little_1_joint", "pinky_proximal_joint"),
        *((f"right_{f}_1_joint", f"{f}_proximal_joint") for f in ("ring", "middle", "index")),
        ("inspire_ftp", "inspire_hand"),
    ):
        text = text.replace(ours, theirs)
    path = tmp_path / "touch.toml"
    path.write_text(text)
    argv = ["hardware", "monitor", f"inspire:{host}:{port},table={path}", "--json", "--seconds"]
    until(lambda: main([*argv, "2"]) == 0)
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    pads = [line["pads"] for line in lines if "pads" in line]
    assert pads[-1]["index_tip"] == [[0, 0, 0], [0, 0, 900], [0, 0, 0]]
