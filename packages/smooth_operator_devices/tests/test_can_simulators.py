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
