"""Simulated hands on a CAN bus answer the frames that the makers' texts give literally."""

import importlib
import time

import numpy as np
import pytest
from simulators.common import ManualClock, serve_can

can = pytest.importorskip("can", reason="python-can is not installed")
from simulators.dexhand021_can import DexHand021  # noqa: E402
from simulators.linkerhand_can import LinkerHand  # noqa: E402


def _hex(text: str) -> bytes:
    return bytes.fromhex(text)


# --- LinkerHand: data[0] is the kind; linkerbot 0.5.4 and linkerhand-python-sdk b3713618


def _ask(hand: LinkerHand, *data: int, identifier: int | None = None) -> list[str]:
    frame = can.Message(
        arbitration_id=hand.identifier if identifier is None else identifier,
        data=data,
        is_extended_id=False,
    )
    answers = hand.answer(frame)
    assert all(answer.arbitration_id == hand.identifier for answer in answers)
    return [answer.data.hex(" ") for answer in answers]


@pytest.mark.parametrize(
    ("model", "request_", "answers"),
    [
        ("L6", [0x33], ["33 1e 1e 1e 1e 1e 1e"]),
        ("L6", [0x35], ["35 00 00 00 00 00 00"]),
        ("L6", [0x02, 1, 2, 3, 4, 5, 6], ["02 01 02 03 04 05 06"]),
        ("L7", [0x01], ["01 ff ff ff ff ff ff ff"]),
        ("L20 lite", [0x04], ["04 ff ff ff ff"]),
        ("L20 lite", [0x06, 1, 2, 3, 4, 5], ["06 01 02 03 04 05"]),
        ("L10", [0x34], ["34 1e 1e 1e 1e 1e"]),
        ("L20", [0x03], ["03 ff 00 00 00 00"]),
        ("L20", [0x11, 1, 2, 3, 4, 5], []),
        ("L21", [0x41], ["41 ff ff ff ff 00 ff"]),
        ("L21", [0x42], ["42 00 ff ff 00 00 ff"]),
        ("L25", [0x42], ["42 00 ff ff ff 00 ff"]),
        ("L25 linkerbot", [0x42], ["42 ff 00 ff 00 00 ff"]),
        ("G20", [0x41], ["41 ff ff ff 00 00 ff"]),
        ("L21", [0x83, 1, 1, 1, 1, 1], ["83 01 01 01 01 01"]),
        ("L6", [0x01, 1, 2], []),
    ],
)
def test_linkerhand_frames_have_the_values_of_their_model(model, request_, answers):
    assert _ask(LinkerHand(model, "right", clock=ManualClock()), *request_) == answers


def test_linkerhand_by_kind_and_by_finger_write_the_same_joints():
    clock = ManualClock()
    hand = LinkerHand("L21", "right", clock=clock)
    _ask(hand, 0x03, 10, 20, 30, 40, 50)  # roots of the five fingers
    _ask(hand, 0x43, 0, 7, 31, 0, 0, 9)
    clock.advance(5)
    assert _ask(hand, 0x03) == ["03 0a 14 1f 28 32"]
    assert _ask(hand, 0x43) == ["43 00 07 1f 00 00 09"]


@pytest.mark.parametrize(
    ("name", "model", "joints"),
    [
        ("o6.O6", "O6", 6),
        ("l6.L6", "L6", 6),
        ("l20lite.L20lite", "L20 lite", 10),
        ("l25.L25", "L25 linkerbot", 16),
    ],
)
@pytest.mark.parametrize("side", ["left", "right"])
def test_linkerhand_works_with_the_package_of_its_maker(name, model, joints, side):
    pytest.importorskip("linkerbot", reason="the maker's package linkerbot is not installed")
    module, cls = name.split(".")
    hand = LinkerHand(model, side)
    channel = f"{model} {side}"
    with serve_can(hand, can.Bus(channel, interface="virtual")):
        make = getattr(importlib.import_module(f"linkerbot.hand.{module}"), cls)
        host = make(side=side, interface_name=channel, interface_type="virtual")
        try:
            host.angle.set_angles([20.0] * joints)
            time.sleep(0.8)
            angles = host.angle.get_blocking(timeout_ms=1000).angles.to_list()
            assert angles == pytest.approx([20.0] * joints)
            temperatures = host.temperature.get_blocking(timeout_ms=1000).temperatures
            assert temperatures.to_list() == [30.0] * joints
        finally:
            host.close()


# --- DexHand021: tests/test_dexhand_protocol.py and commands.py of DexRobot's pyzlg_dexhand


def _fd(hand: DexHand021, identifier: int, data: str) -> list[tuple[int, str]]:
    frame = can.Message(
        arbitration_id=identifier, data=_hex(data), is_extended_id=False, is_fd=True
    )
    return [(m.arbitration_id, bytes(m.data).hex(" ")) for m in hand.answer(frame)]


def test_dexhand021_confirms_configurations_as_the_maker_checks_them():
    hand = DexHand021("left", clock=ManualClock())
    assert _fd(hand, 0x001, "03 A4") == [(0x081, "03 a4 00 01")]
    assert _fd(hand, 0x001, "03 74 01 32 01") == [(0x081, "03 74 00 01")]
    assert _fd(hand, 0x007, "03 A4") == []  # a board of the right hand
    classic = can.Message(arbitration_id=0x001, data=_hex("03 A4"), is_extended_id=False)
    assert hand.answer(classic) == []


def test_dexhand021_moves_in_hundredths_of_a_degree_and_sends_feedback():
    clock = ManualClock()
    hand = DexHand021("left", clock=clock)
    _fd(hand, 0x001, "03 74 01 32 01")
    # cascaded, both motors, 1000 and -2000: the values of the maker's test
    assert _fd(hand, 0x101, "44 03 E8 03 30 F8") == []
    clock.advance(1)
    (feedback,) = hand.poll()
    data = bytes(feedback.data)
    assert feedback.arbitration_id == 0x181
    assert len(data) == 48
    assert np.allclose(hand.motors.positions[:2], [10, -20])
    assert data[12:16] == _hex("E8 03 30 F8")
    assert int.from_bytes(data[4:6], "little", signed=True) == 140  # 10 x 2.1 x 6*25*16/360
    assert hand.poll() == []
    clock.advance(0.5)  # 50 x 10 ms
    assert len(hand.poll()) == 1


def test_dexhand021_stalled_motor_sends_the_frame_that_was_captured_from_a_hand():
    clock = ManualClock()
    hand = DexHand021("right", clock=clock)
    hand.motors.stuck.add(4)  # motor 1 of board 9
    _fd(hand, 0x109, "44 01 E8 03 00 00")
    assert hand.poll() == []
    clock.advance(0.6)
    (error,) = hand.poll()
    assert error.arbitration_id == 0x609
    assert bytes(error.data) == b"\xee\x01\x04".ljust(64, b"\0")
    hand.motors.stuck.clear()
    _fd(hand, 0x109, "44 01 E8 03 00 00")
    clock.advance(1)
    assert hand.motors.positions[4] == 0
    _fd(hand, 0x009, "03 A4")
    _fd(hand, 0x109, "44 01 E8 03 00 00")
    clock.advance(1)
    assert hand.motors.positions[4] == 10
