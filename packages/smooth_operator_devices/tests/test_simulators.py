"""Simulated hands answer the frames that the makers' texts give literally."""

import enum
import importlib
import inspect
import struct
import time

import numpy as np
import pytest
from simulators import revo3_sdk, wuji_sdk
from simulators.aero_hand import AeroHand
from simulators.common import SerialLine, serve_can
from simulators.feetech_bus import FeetechBus, packet
from simulators.inspire_touch import TOUCH, InspireTouchHand
from simulators.modbus_rtu import crc
from simulators.rohand_modbus import RoHand
from simulators.sdk import stub_methods

pytest.importorskip("can", reason="python-can is not installed")

import can
from simulators.dexhand021_can import DexHand021
from simulators.linkerhand_can import LinkerHand


class ManualClock:
    """Time [s] that moves only when a test says so."""

    def __init__(self) -> None:
        self.now = 0.0

    def __call__(self) -> float:
        return self.now

    def advance(self, seconds: float) -> None:
        self.now += seconds


@pytest.fixture
def clock(monkeypatch) -> ManualClock:
    """The time of simulators that are made from now on."""
    clock = ManualClock()
    monkeypatch.setattr(time, "monotonic", clock)
    return clock


def _hex(text: str) -> bytes:
    return bytes.fromhex(text)


# --- Feetech: examples of the maker's "Communication Protocol User Manual" 191218-0923


def _bus(*places: int) -> FeetechBus:
    bus = FeetechBus(dict.fromkeys(range(1, len(places) + 1), "sts3215"))
    bus.receive(packet(0xFE, 3, bytes([40, 1])))  # torque
    bus.motors.place(places)
    return bus


@pytest.mark.parametrize(
    ("places", "requests", "answers", "targets"),
    [
        ([2048], ["FF FF 01 02 01 FB"], ["FF FF 01 02 00 FC"], [2048]),
        ([1304], ["FF FF 01 04 02 38 02 BE"], ["FF FF 01 04 00 18 05 DD"], [1304]),
        ([48], ["FF FF 01 09 03", "2A 00 08 00 00 E8 03 D5"], ["", "FF FF 01 02 00 FC"], [2048]),
        (
            [0] * 4,
            [
                "FF FF FE 20 83 2A 06 01 00 08 00 00 E8 03 02 00 08 00 00 E8 03 "
                "03 00 08 00 00 E8 03 04 00 08 00 00 E8 03 58"
            ],
            [""],
            [2048] * 4,
        ),
    ],
)
def test_feetech_frames_of_the_manual(places, requests, answers, targets, clock):
    bus = _bus(*places)
    assert [bus.receive(_hex(request)) for request in requests] == [_hex(a) for a in answers]
    assert bus.motors.targets.tolist() == targets
    clock.advance(1.0)
    assert (np.abs(bus.motors.positions - places) <= 1000).all()  # 1000 steps a second
    clock.advance(9.0)
    assert bus.motors.positions.tolist() == targets


def test_feetech_sync_read_of_the_manual():
    bus = _bus(2048, 2047)
    bus.motors.temperatures[:] = [30, 35]
    bus.servos[1].memory[62], bus.servos[2].memory[62] = 0x79, 0x77
    assert bus.receive(_hex("FF FF FE 06 82 38 08 01 02 36")) == _hex(
        "FF FF 01 0A 00 00 08 00 00 00 00 79 1E 55 FF FF 02 0A 00 FF 07 00 00 00 00 77 23 53"
    )


def test_feetech_scs_words_have_the_high_byte_first_and_no_sync_read():
    bus = FeetechBus({1: "scs0009"})
    assert bus.receive(packet(1, 2, bytes([56, 2])))[5:7] == bytes([0x01, 0xFF])  # 511
    assert bus.receive(packet(1, 2, bytes([3, 2])))[5:7] == (1284).to_bytes(2, "big")
    assert bus.receive(packet(0xFE, 0x82, bytes([56, 2, 1]))) == b""


@pytest.mark.parametrize(
    ("model", "series", "number", "goal"),
    [("sts3215", "sms_sts", 777, (3000, 2000, 0)), ("scs0009", "scscl", 1284, (700, 0, 1000))],
)
def test_feetech_servo_works_with_the_package_of_its_maker(model, series, number, goal):
    sdk = pytest.importorskip(
        "scservo_sdk", reason="the maker's package ftservo-python-sdk is not installed"
    )
    pytest.importorskip("termios", reason="this platform has no pseudo terminals")
    bus = FeetechBus({1: model})
    with SerialLine(bus) as line:
        port = sdk.PortHandler(line.port)
        assert port.openPort()
        port.setBaudRate(1_000_000)
        port.setPacketTimeout = lambda length: port.setPacketTimeoutMillis(2000)
        servo = getattr(sdk, series)(port)
        assert servo.ping(1) == (number, 0, 0)
        servo.write1ByteTxRx(1, 40, 1)
        (servo.WritePosEx if series == "sms_sts" else servo.WritePos)(1, *goal)
        time.sleep(1.0)
        assert servo.ReadPos(1) == (goal[0], 0, 0)
        bus.faults.answer_wrongly("checksum")
        assert servo.ReadPos(1)[1] == -7  # COMM_RX_CORRUPT
        port.closePort()


# --- Aero Hand Open: firmware v0.1.0 of TetherIA, and aero-open-sdk 0.1.0.dev1


def test_aero_hand_answers_what_its_firmware_answers(clock):
    hand = AeroHand("right")
    ask = lambda text: hand.receive(_hex(text)).hex(" ")  # noqa: E731
    zeros = " 00 00" * 5
    assert ask("31 00 03 00 E8 03" + zeros) == "31 00 03 00 e8 03" + zeros
    assert ask("31 00 03 00 FF FF" + zeros) == "31 00 03 00 fe 7f" + zeros  # 32766
    assert ask("32 00 06 00 FF FF" + zeros) == "32 00 06 00 ff 03" + zeros  # 1023
    assert ask("32 00 07 00 01 00" + zeros) == "32 00 ff ff 00 00" + zeros
    assert ask("25 00" + " 00 00" * 7) == "25 00" + " 1e 00" * 7
    assert ask("21 00" + " 00 00" * 7) == ""
    assert ask("11 00" + " FF FF" * 7) == ""
    clock.advance(0.25)
    assert ask("22 00" + " 00 00" * 7) == "22 00" + " 00 80" * 7
    assert ask("24 00" + " 00 00" * 7) == "24 00" + " 17 00" * 7  # 150 mA


def test_aero_hand_works_with_the_package_of_its_maker():
    sdk = pytest.importorskip(
        "aero_open_sdk.aero_hand", reason="the maker's package aero-open-sdk is not installed"
    )
    pytest.importorskip("termios", reason="this platform has no pseudo terminals")
    hand = AeroHand("right")
    with SerialLine(hand) as line:
        host = sdk.AeroHand(line.port)
        host.ser.timeout = 2  # 10 ms are too few for a busy machine
        assert host.set_speed(2, 30000) == {"Servo ID": 2, "Speed": 30000}
        host.set_joint_positions([10.0] * 16)
        time.sleep(1.0)
        assert host.get_joint_positions_compact() == pytest.approx([10.0] * 7, abs=0.05)
        assert host.get_actuator_temperatures() == [30.0] * 7
        host.close()


# --- ROHand: registers and errors of OYMotion's Modbus RTU protocol V1.0 and V2.0


def _rtu(hand: RoHand, *body: int) -> bytes:
    request = bytes(body)
    return hand.receive(request + crc(request))


def test_rohand_crc_is_the_one_of_modbus():
    # the request of node 17 in the Modbus specification's example of function 3
    assert crc(bytes([0x11, 0x03, 0x00, 0x6B, 0x00, 0x03])) == bytes([0x76, 0x87])


def test_rohand_reads_defaults_and_follows_a_target(clock):
    hand = RoHand(2)
    answer = _rtu(hand, 2, 3, 0x04, 0x47, 0, 6)  # 1095: current limits
    assert answer[:-2] == bytes([2, 3, 12]) + (1178).to_bytes(2, "big") * 6
    assert crc(answer[:-2]) == answer[-2:]
    many = _rtu(hand, 2, 16, 0x04, 0x6F, 0, 2, 4, 0, 10, 0xFF, 0xFF)  # 1135, two registers
    assert many[:-2] == bytes([2, 16, 0x04, 0x6F, 0, 2])
    clock.advance(0.5)
    assert hand.read(1085, 2) == [2, 1]
    assert hand.read(1145, 2) == [10, 32768]
    clock.advance(1)
    assert hand.read(1086, 1) == [2]


# --- Inspire with touch: manual RH56DFTP R1, and Unitree's inspire_hand_sdk


def test_inspire_touch_addresses_are_those_of_the_manual():
    assert TOUCH["little", "nail"] == (3018, (12, 8))
    assert TOUCH["index", "pad"] == (4320, (10, 8))
    assert TOUCH["thumb", "pad"] == (4708, (12, 8))
    ends = [start + 2 * rows * columns for start, (rows, columns) in TOUCH.values()]
    assert sorted(start for start, _ in TOUCH.values())[1:] == sorted(ends)[:-1]
    assert max(ends) == 5124


def test_inspire_reads_and_writes_as_the_manual_frames_them(clock):
    hand = InspireTouchHand()
    # transaction 7, unit 255: write 100, 100, 100, 100, 2000 (refused), 0 from 1486
    written = hand.receive(
        _hex("00 07 00 00 00 13 FF 10 05 CE 00 06 0C 00 64 00 64 00 64 00 64 07 D0 00 00")
    )
    assert written == _hex("00 07 00 00 00 06 FF 10 05 CE 00 06")
    clock.advance(1)
    read = hand.receive(_hex("00 08 00 00 00 06 FF 03 06 0A 00 06"))
    assert read == _hex("00 08 00 00 00 0F FF 03 0C 00 64 00 64 00 64 00 64 03 E8 00 00")


def test_inspire_touch_cells_run_by_rows_and_the_palm_by_columns():
    hand = InspireTouchHand()
    hand.touch["little", "nail"][1, 0] = 0x0102  # the ninth point
    hand.touch["palm", "palm"][7, 1] = 0x0304  # the ninth point of the palm: row 8, column 2
    request = lambda address, count: struct.pack(">HHHBBHH", 1, 0, 6, 255, 3, address, count)  # noqa: E731
    assert hand.receive(request(3018, 9))[-2:] == _hex("01 02")
    assert hand.receive(request(4900, 9))[-2:] == _hex("03 04")
    assert hand.receive(request(3000, 126))[7:] == _hex("83 03")
    assert hand.receive(request(5200, 1))[7:] == _hex("83 02")


# --- Dex3-1: types of unitree_sdk2_python, order of xr_teleoperate


@pytest.fixture
def dex3():
    pytest.importorskip("cyclonedds", reason="cyclonedds is not installed")
    from simulators import dex3_dds

    return dex3_dds


def _dex3_command(dex3, q: float, status: int = 1):
    motors = [dex3.MotorCmd(i | status << 4, q, 0.0, 0.0, 1.5, 0.2, 0) for i in range(7)]
    return dex3.HandCmd(motors, [0] * 4)


def test_dex3_types_have_the_names_and_fields_of_the_maker(dex3):
    assert dex3.HandState.__idl_typename__ == "unitree_hg.msg.dds_.HandState_"
    message = _dex3_command(dex3, 0.5)
    data = message.serialize()
    # encapsulation, count of motors, then per motor: mode and three bytes of padding, five f32, u32
    assert data[4:8] == (7).to_bytes(4, "little")
    assert data[8] == 0x10
    assert struct.unpack_from("<5f", data, 12) == pytest.approx((0.5, 0.0, 0.0, 1.5, 0.2))
    assert dex3.ORDER["left"][3] == "middle_0"
    assert dex3.ORDER["right"][3] == "index_0"


# --- Stand-ins of makers' Python packages


@pytest.mark.parametrize(
    ("package", "file", "modules"),
    [
        ("wuji_sdk", "__init__.pyi", wuji_sdk.wuji_modules),
        ("bc_revo3_sdk", "main_mod.pyi", revo3_sdk.revo3_modules),
    ],
)
def test_stand_ins_have_the_calls_of_the_package_that_is_installed(package, file, modules):
    stubs = stub_methods(package, file)
    if stubs is None:
        pytest.skip(f"{package} is not installed")
    stand_in = list(modules().values())[-1]
    compared = 0
    for name, cls in vars(stand_in).items():
        if not inspect.isclass(cls) or issubclass(cls, enum.Enum | Exception):
            continue
        for method, function in inspect.getmembers(cls, inspect.isfunction):
            if not method.startswith("_"):
                parameters = list(inspect.signature(function).parameters)
                real = [each for each in stubs[name][method] if each in parameters]
                assert parameters == real, f"{name}.{method}"
                compared += 1
    assert compared > 8


# --- LinkerHand: linkerbot 0.5.4


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
    hand = DexHand021("left")
    assert _fd(hand, 0x001, "03 A4") == [(0x081, "03 a4 00 01")]
    assert _fd(hand, 0x001, "03 74 01 32 01") == [(0x081, "03 74 00 01")]
    assert _fd(hand, 0x007, "03 A4") == []  # a board of the right hand
    classic = can.Message(arbitration_id=0x001, data=_hex("03 A4"), is_extended_id=False)
    assert hand.answer(classic) == []


def test_dexhand021_moves_in_hundredths_of_a_degree_and_sends_feedback(clock):
    hand = DexHand021("left")
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


def test_dexhand021_stalled_motor_sends_the_frame_that_was_captured_from_a_hand(clock):
    hand = DexHand021("right")
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
