"""Simulated hands answer the frames that the makers' texts give literally."""

import asyncio
import enum
import inspect
import socket
import struct
import time

import numpy as np
import pytest
from live_time import PATIENCE_S
from simulators.common import Faults, ManualClock, Motors, SerialLine


def _hex(text: str) -> bytes:
    return bytes.fromhex(text)


def test_motors_follow_their_targets_at_a_limited_speed():
    clock = ManualClock()
    motors = Motors([0.0, 0.0, 0.0], 10.0, clock=clock)
    motors.stuck.add(1)
    motors.set_power(False, [2])
    motors.move([5.0, 5.0, 5.0])
    clock.advance(0.2)
    assert np.allclose(motors.positions, [2.0, 0.0, 0.0])
    assert motors.currents.tolist() == [150.0, 800.0, 0.0]
    assert motors.velocities.tolist() == [10.0, 0.0, 0.0]
    clock.advance(10)
    assert np.allclose(motors.positions, [5.0, 0.0, 0.0])


def test_faults_refuse_a_kind_that_the_connection_does_not_have():
    with pytest.raises(ValueError, match="expected one of"):
        Faults("short").answer_wrongly("checksum")


# --- Feetech: examples of the maker's "Communication Protocol User Manual" 191218-0923

from simulators.feetech_bus import FeetechBus, packet  # noqa: E402


def _sts(count: int = 1) -> FeetechBus:
    bus = FeetechBus(dict.fromkeys(range(1, count + 1), "sts3215"), clock=ManualClock())
    bus.motors.place([2048] * count)
    return bus


def test_feetech_ping_and_read_of_the_manual():
    bus = _sts()
    assert bus.receive(_hex("FF FF 01 02 01 FB")) == _hex("FF FF 01 02 00 FC")
    bus.motors.place([1304])
    assert bus.receive(_hex("FF FF 01 04 02 38 02 BE")) == _hex("FF FF 01 04 00 18 05 DD")


def test_feetech_writes_of_the_manual_move_the_servo():
    bus = _sts()
    bus.receive(_hex("FF FF 01 04 03 28 01 CE"))
    bus.motors.place([48])
    command = _hex("FF FF 01 09 03 2A 00 08 00 00 E8 03 D5")
    assert bus.receive(command[:5]) == b""
    assert bus.receive(command[5:]) == _hex("FF FF 01 02 00 FC")
    bus.motors._clock.advance(1.0)
    assert bus.motors.positions[0] == 1048  # 1000 steps a second
    bus.motors._clock.advance(9.0)
    assert bus.motors.positions[0] == 2048


def test_feetech_registered_write_of_the_manual_waits_for_the_action():
    bus = _sts()
    bus.receive(_hex("FF FF 01 04 03 28 01 CE"))
    bus.motors.place([0])
    reply = bus.receive(_hex("FF FF 01 09 04 2A 00 08 00 00 E8 03 D4"))
    assert reply == _hex("FF FF 01 02 00 FC")
    assert bus.motors.targets[0] == 0
    assert bus.receive(_hex("FF FF FE 02 05 FA")) == b""
    assert bus.motors.targets[0] == 2048


def test_feetech_sync_write_of_the_manual_is_not_answered():
    bus = _sts(4)
    bus.motors.place([0] * 4)
    command = "FF FF FE 20 83 2A 06" + "".join(f" {i:02X} 00 08 00 00 E8 03" for i in range(1, 5))
    assert bus.receive(_hex(command + " 58")) == b""
    assert bus.motors.targets.tolist() == [2048] * 4


def test_feetech_sync_read_of_the_manual():
    bus = _sts(2)
    bus.motors.place([2048, 2047])
    bus.motors.temperatures[:] = [30, 35]
    bus.servos[1].memory[62], bus.servos[2].memory[62] = 0x79, 0x77
    assert bus.receive(_hex("FF FF FE 06 82 38 08 01 02 36")) == _hex(
        "FF FF 01 0A 00 00 08 00 00 00 00 79 1E 55 FF FF 02 0A 00 FF 07 00 00 00 00 77 23 53"
    )


def test_feetech_scs_words_have_the_high_byte_first_and_no_sync_read():
    bus = FeetechBus({1: "scs0009"}, clock=ManualClock())
    assert bus.receive(packet(1, 2, bytes([56, 2])))[5:7] == bytes([0x01, 0xFF])  # 511
    assert bus.receive(packet(1, 2, bytes([3, 2])))[5:7] == (1284).to_bytes(2, "big")
    assert bus.receive(packet(0xFE, 0x82, bytes([56, 2, 1]))) == b""


def test_feetech_servo_has_no_torque_and_its_default_limit_after_power_on():
    bus = _sts()
    bus.receive(packet(1, 3, bytes([40, 1])))
    bus.receive(packet(1, 3, bytes([48, 0x2C, 0x01])))
    assert bus.servos[1].word(48) == 300
    bus.reboot()
    assert bus.servos[1].word(48) == 1000
    assert bus.servos[1].memory[40] == 0
    bus.receive(packet(1, 3, bytes([42, 0, 0])))
    bus.motors._clock.advance(5)
    assert bus.motors.positions[0] == 2048


def test_feetech_overload_after_two_seconds_ends_with_a_new_goal():
    bus = _sts()
    bus.receive(packet(1, 3, bytes([40, 1])))
    bus.motors.stuck.add(0)
    bus.receive(packet(1, 3, bytes([42, 0, 0])))
    read = packet(1, 2, bytes([60, 2]))
    assert bus.receive(read)[4] == 0
    bus.motors._clock.advance(2.1)
    answer = bus.receive(read)
    assert answer[4] == 32
    assert int.from_bytes(answer[5:7], "little") & 0x3FF == 200  # 20 % are left
    bus.motors.stuck.clear()
    assert bus.receive(packet(1, 3, bytes([42, 0, 4])))[4] == 0


def _ask_until_it_fails(port, request: bytes) -> None:
    for _ in range(50):
        port.write(request)
        port.read(6)
        time.sleep(0.02)


def test_feetech_line_is_silent_unplugged_wrong_and_shared():
    serial = pytest.importorskip("serial", reason="pyserial is not installed")
    pytest.importorskip("termios", reason="this platform has no pseudo terminals")
    bus = FeetechBus({1: "sts3215", 2: "sts3215"})
    ping, pong = _hex("FF FF 01 02 01 FB"), _hex("FF FF 01 02 00 FC")
    with SerialLine(bus) as line:
        with serial.Serial(line.port, 1_000_000, timeout=PATIENCE_S) as port:
            port.write(ping)
            assert port.read(6) == pong
            bus.faults.answer_wrongly("checksum")
            port.write(ping)
            assert port.read(6)[:5] == pong[:5]
            line.second_program(packet(2, 1))
            assert port.read(6) == packet(2, 0)
            bus.faults.silent = True
            port.timeout = 0.2
            port.write(ping)
            assert port.read(6) == b""
            bus.faults.silent = False
            line.unplug()
            with pytest.raises((serial.SerialException, OSError)):
                _ask_until_it_fails(port, ping)
        line.plug()
        with serial.Serial(line.port, 1_000_000, timeout=PATIENCE_S) as port:
            port.write(ping)
            assert port.read(6) == pong


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

from simulators.aero_hand import AeroHand, frame  # noqa: E402


def test_aero_hand_answers_what_its_firmware_answers():
    clock = ManualClock()
    hand = AeroHand("right", clock=clock)
    ask = lambda text: hand.receive(_hex(text)).hex(" ")  # noqa: E731
    zeros = " 00 00" * 5
    assert ask("31 00 03 00 E8 03" + zeros) == "31 00 03 00 e8 03" + zeros
    assert ask("31 00 03 00 FF FF" + zeros) == "31 00 03 00 fe 7f" + zeros  # 32766
    assert ask("32 00 06 00 FF FF" + zeros) == "32 00 06 00 ff 03" + zeros  # 1023
    assert ask("32 00 07 00 01 00" + zeros) == "32 00 ff ff 00 00" + zeros
    assert ask("03 00 00 00 0A 00" + zeros) == "03 00 00 00 ff 03" + zeros  # 910 + 113
    assert ask("25 00" + " 00 00" * 7) == "25 00" + " 1e 00" * 7
    assert ask("21 00" + " 00 00" * 7) == ""
    assert ask("11 00" + " FF FF" * 7) == ""
    clock.advance(0.25)
    assert ask("22 00" + " 00 00" * 7) == "22 00" + " 00 80" * 7
    assert ask("24 00" + " 00 00" * 7) == "24 00" + " 17 00" * 7  # 150 mA


def test_aero_hand_keeps_all_values_while_one_servo_is_dead():
    clock = ManualClock()
    hand = AeroHand("left", clock=clock)
    hand.receive(frame(0x11, *[1000] * 7))
    clock.advance(1)
    assert hand.receive(frame(0x22)) == frame(0x22, *[1000] * 7)
    hand.dead.add(2)
    hand.receive(frame(0x11, *[2000] * 7))
    clock.advance(1)
    assert hand.receive(frame(0x22)) == frame(0x22, *[1000] * 7)


def test_aero_hand_is_deaf_while_it_homes_and_prints_text_at_power_on():
    clock = ManualClock()
    hand = AeroHand("right", homing_time=5, clock=clock)
    assert hand.receive(frame(0x01)) == b""
    clock.advance(4)
    assert hand.receive(frame(0x22)) == b""
    clock.advance(2)
    assert hand.poll() == frame(0x01)
    hand.receive(frame(0x31, 0, 5))
    hand.reboot()
    assert hand.poll().startswith(b"[BOOT] Hand Type: RIGHT_HAND\r\n")
    assert hand.speeds[0] == 32766


def test_aero_hand_counts_bytes_and_is_shifted_by_a_lost_one():
    hand = AeroHand("right", clock=ManualClock())
    assert hand.receive(frame(0x25)[:15]) == b""
    assert hand.receive(frame(0x25)) == frame(0x25, *[30] * 7)  # completed by the first byte
    assert hand.receive(frame(0x25)) == b""  # begins with a filler, which is no operation
    hand = AeroHand("right", clock=ManualClock())
    hand.faults.answer_wrongly("short")
    assert hand.receive(frame(0x25)) == frame(0x25, *[30] * 7)[:13]


def test_aero_hand_works_with_the_package_of_its_maker():
    sdk = pytest.importorskip(
        "aero_open_sdk.aero_hand", reason="the maker's package aero-open-sdk is not installed"
    )
    pytest.importorskip("termios", reason="this platform has no pseudo terminals")
    hand = AeroHand("right", homing_time=0.2)
    with SerialLine(hand) as line:
        host = sdk.AeroHand(line.port)
        host.ser.timeout = 2  # 10 ms are too few for a busy machine
        assert host.set_speed(2, 30000) == {"Servo ID": 2, "Speed": 30000}
        host.set_joint_positions([10.0] * 16)
        time.sleep(1.0)
        assert host.get_joint_positions_compact() == pytest.approx([10.0] * 7, abs=0.05)
        assert host.get_actuator_temperatures() == [30.0] * 7
        assert host.send_homing(5)
        assert host.get_actuations() == pytest.approx([0, 0, -15.2789, 0, 0, 0, 0])
        host.close()


# --- ROHand: registers and errors of OYMotion's Modbus RTU protocol V1.0 and V2.0

from simulators.rohand_modbus import RoHand, crc  # noqa: E402


def _rtu(hand: RoHand, *body: int) -> bytes:
    request = bytes(body)
    return hand.receive(request + crc(request))


def test_rohand_crc_is_the_one_of_modbus():
    # the request of node 17 in the Modbus specification's example of function 3
    assert crc(bytes([0x11, 0x03, 0x00, 0x6B, 0x00, 0x03])) == bytes([0x76, 0x87])


def test_rohand_reads_defaults_and_follows_a_target():
    clock = ManualClock()
    hand = RoHand(2, clock=clock)
    answer = _rtu(hand, 2, 3, 0x04, 0x47, 0, 6)  # 1095: current limits
    assert answer[:-2] == bytes([2, 3, 12]) + (1178).to_bytes(2, "big") * 6
    assert crc(answer[:-2]) == answer[-2:]
    echo = _rtu(hand, 2, 6, 0x04, 0x70, 0xFF, 0xFF)  # 1136: index
    assert echo[:-2] == bytes([2, 6, 0x04, 0x70, 0xFF, 0xFF])
    clock.advance(0.5)
    assert hand.read(1086, 1) == [1]
    assert hand.read(1146, 1) == [32768]
    clock.advance(1)
    assert hand.read(1085, 2) == [2, 2]
    assert hand.read(1166, 1) == [10022]
    many = _rtu(hand, 2, 16, 0x04, 0x6F, 0, 2, 4, 0, 10, 1, 2)  # 1135, two registers
    assert many[:-2] == bytes([2, 16, 0x04, 0x6F, 0, 2])
    assert hand.motors.targets[:2].tolist() == [10, 258]


def test_rohand_reports_errors_and_forgets_limits_at_power_on():
    clock = ManualClock()
    hand = RoHand(2, init_time=3, clock=clock)
    assert _rtu(hand, 2, 4, 0x04, 0x47, 0, 1)[:-2] == bytes([2, 0x84, 1])
    assert _rtu(hand, 2, 3, 0x17, 0x70, 0, 1)[:-2] == bytes([2, 0x83, 2])
    _rtu(hand, 2, 6, 0x04, 0x47, 0, 200)
    assert hand.read(1095, 1) == [200]
    _rtu(hand, 2, 6, 0x03, 0xF6, 0, 0)  # 1014: reset
    assert _rtu(hand, 2, 3, 0x04, 0x47, 0, 1)[:-2] == bytes([2, 0x83, 4])
    assert _rtu(hand, 2, 3, 0x03, 0xEE, 0, 1)[:-2] == bytes([2, 3, 2, 0, 1])  # 1006
    clock.advance(4)
    assert hand.read(1095, 1) == [1178]
    assert _rtu(hand, 3, 3, 0x04, 0x47, 0, 1) == b""


def test_rohand_stuck_finger_stops_over_its_current_limit_until_the_next_target():
    clock = ManualClock()
    hand = RoHand(1, clock=clock)
    hand.motors.stuck.add(1)
    _rtu(hand, 2, 6, 0x04, 0x70, 0xFF, 0xFF)
    clock.advance(1)
    assert hand.read(1086, 1) == [5]
    _rtu(hand, 2, 6, 0x04, 0x48, 0, 200)
    assert hand.read(1086, 1) == [3]
    hand.motors.stuck.clear()
    clock.advance(1)
    assert hand.motors.positions[1] == 0
    _rtu(hand, 2, 6, 0x04, 0x70, 0xFF, 0xFF)
    clock.advance(1)
    assert hand.read(1086, 1) == [2]


@pytest.mark.parametrize(("generation", "force", "limit"), [(1, 1120, 15000), (2, 1175, 0)])
def test_rohand_force_registers_depend_on_the_generation(generation, force, limit):
    hand = RoHand(generation, clock=ManualClock())
    hand.forces[:] = [1, 2, 3, 4, 5]
    assert hand.read(force, 5) == [1, 2, 3, 4, 5]
    assert hand.read(1115, 1) == [limit]


def test_rohand_speaks_with_pymodbus_over_a_serial_line():
    client_module = pytest.importorskip("pymodbus.client", reason="pymodbus is not installed")
    pytest.importorskip("serial", reason="pyserial is not installed")
    pytest.importorskip("termios", reason="this platform has no pseudo terminals")
    hand = RoHand(2)
    with SerialLine(hand) as line:
        client = client_module.ModbusSerialClient(
            line.port, baudrate=115200, timeout=0.5, retries=0
        )
        assert client.connect()
        assert not client.write_registers(1135, [1, 2, 3, 4, 5, 6], device_id=2).isError()
        assert client.read_holding_registers(1135, count=6, device_id=2).registers == [
            1,
            2,
            3,
            4,
            5,
            6,
        ]
        hand.faults.silent = True
        with pytest.raises(Exception, match="No response"):
            client.read_holding_registers(1135, count=6, device_id=2)
        client.close()


# --- Inspire with touch: manual RH56DFTP R1, and Unitree's inspire_hand_sdk

from simulators.inspire_touch import TOUCH, InspireTouchHand  # noqa: E402


def test_inspire_touch_addresses_are_those_of_the_manual():
    assert TOUCH["little", "nail"] == (3018, (12, 8))
    assert TOUCH["index", "pad"] == (4320, (10, 8))
    assert TOUCH["thumb", "pad"] == (4708, (12, 8))
    ends = [start + 2 * rows * columns for start, (rows, columns) in TOUCH.values()]
    assert sorted(start for start, _ in TOUCH.values())[1:] == sorted(ends)[:-1]
    assert max(ends) == 5124


def test_inspire_reads_and_writes_as_the_manual_frames_them():
    clock = ManualClock()
    hand = InspireTouchHand(clock=clock)
    # transaction 7, unit 255: write 100, 100, 100, 100, 2000 (refused), 0 from 1486
    written = hand.receive(
        _hex("00 07 00 00 00 13 FF 10 05 CE 00 06 0C 00 64 00 64 00 64 00 64 07 D0 00 00")
    )
    assert written == _hex("00 07 00 00 00 06 FF 10 05 CE 00 06")
    clock.advance(1)
    read = hand.receive(_hex("00 08 00 00 00 06 FF 03 06 0A 00 06"))
    assert read == _hex("00 08 00 00 00 0F FF 03 0C 00 64 00 64 00 64 00 64 03 E8 00 00")
    assert hand.receive(_hex("00 09 00 00 00 06 FF 06 05 D4 02 58"))[7:] == _hex("06 05 D4 02 58")
    clock.advance(0.3)  # from 100 to 600 at 1000 in 0.6 s
    assert hand.motors.positions[3] == 600


def test_inspire_touch_cells_run_by_rows_and_the_palm_by_columns():
    hand = InspireTouchHand(clock=ManualClock())
    hand.touch["little", "nail"][1, 0] = 0x0102  # the ninth point
    hand.touch["palm", "palm"][7, 1] = 0x0304  # the ninth point of the palm: row 8, column 2
    request = lambda address, count: struct.pack(">HHHBBHH", 1, 0, 6, 255, 3, address, count)  # noqa: E731
    assert hand.receive(request(3018, 9))[-2:] == _hex("01 02")
    assert hand.receive(request(4900, 9))[-2:] == _hex("03 04")
    assert hand.receive(request(3000, 126))[7:] == _hex("83 03")
    assert hand.receive(request(5200, 1))[7:] == _hex("83 02")


def test_inspire_heat_stays_when_faults_are_cleared():
    hand = InspireTouchHand(clock=ManualClock())
    hand.errors[3] |= 1
    hand.motors.temperatures[2] = 90
    request = _hex("00 01 00 00 00 06 FF 03 06 46 00 03")  # 1606, three registers
    assert hand.receive(request)[9:] == _hex("00 00 01 02 00 00")
    hand.receive(_hex("00 01 00 00 00 06 FF 06 03 EC 00 01"))
    assert hand.receive(request)[9:] == _hex("00 00 00 02 00 00")
    hand.motors.temperatures[2] = 40
    assert hand.receive(request)[9:] == _hex("00 00 00 00 00 00")


def test_inspire_server_answers_off_by_one_hangs_up_and_comes_back():
    with InspireTouchHand() as hand:
        request = _hex("00 10 00 00 00 06 FF 03 06 0A 00 01")
        with socket.create_connection(hand.address, 2) as client:
            client.sendall(request[:5])
            client.sendall(request[5:])
            assert client.recv(100) == _hex("00 10 00 00 00 05 FF 03 02 03 E8")
            hand.transaction_shift = -1
            client.sendall(request)
            assert client.recv(100)[:2] == _hex("00 0F")
            hand.hang_up()
            assert client.recv(100) == b""
        with socket.create_connection(hand.address, 2) as client:
            client.sendall(request)
            assert client.recv(100)


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


def test_dex3_motor_is_free_until_its_mode_byte_says_on(dex3):
    clock = ManualClock()
    hand = dex3.Dex3Hand("left", clock=clock)
    hand.obey(_dex3_command(dex3, 0.5, status=0))
    clock.advance(1)
    assert hand.motors.positions.tolist() == [0.0] * 7
    hand.obey(_dex3_command(dex3, 0.5))
    clock.advance(1)
    assert [motor.q for motor in hand.state().motor_state] == [0.5] * 7
    hand.reboot()
    hand.obey(_dex3_command(dex3, 0.0, status=0))
    clock.advance(1)
    assert hand.motors.positions.tolist() == [0.5] * 7


def test_dex3_speaks_over_dds(dex3):
    from cyclonedds.domain import DomainParticipant
    from cyclonedds.pub import DataWriter
    from cyclonedds.sub import DataReader
    from cyclonedds.topic import Topic

    with dex3.Dex3Hand("right", domain=91) as hand:
        try:
            participant = DomainParticipant(91)
        except Exception as error:  # no network interface
            pytest.skip(f"DDS does not start here: {error}")
        writer = DataWriter(participant, Topic(participant, "rt/dex3/right/cmd", dex3.HandCmd))
        reader = DataReader(participant, Topic(participant, "rt/dex3/right/state", dex3.HandState))
        deadline = time.monotonic() + PATIENCE_S
        reached = False
        while not reached and time.monotonic() < deadline:
            writer.write(_dex3_command(dex3, 0.25))
            time.sleep(0.02)
            states = reader.take(100)
            reached = bool(states) and abs(states[-1].motor_state[6].q - 0.25) < 1e-6
        assert reached
        hand.faults.silent = True
        time.sleep(0.1)
        reader.take(100)
        time.sleep(0.1)
        assert not reader.take(100)


# --- Stand-ins of makers' Python packages

from simulators import revo3_sdk, wuji_sdk, xhand_sdk  # noqa: E402
from simulators.sdk import installed, stub_methods  # noqa: E402


@pytest.mark.parametrize(
    ("package", "file", "modules", "own"),
    [
        ("wuji_sdk", "__init__.pyi", wuji_sdk.wuji_modules, set()),
        ("bc_revo3_sdk", "main_mod.pyi", revo3_sdk.revo3_modules, {"value", "name"}),
    ],
)
def test_stand_ins_have_the_calls_of_the_package_that_is_installed(package, file, modules, own):
    stubs = stub_methods(package, file)
    if stubs is None:
        pytest.skip(f"{package} is not installed")
    stand_in = list(modules().values())[-1]
    compared = 0
    for name, cls in vars(stand_in).items():
        if not inspect.isclass(cls) or issubclass(cls, enum.Enum | Exception):
            continue
        assert name in stubs
        for method, function in vars(cls).items():
            if method.startswith("_") or method in own:
                continue
            if isinstance(function, property):
                continue
            if callable(function) or isinstance(function, staticmethod):
                function = getattr(cls, method)
                expected = stubs[name][method]
                assert list(inspect.signature(function).parameters) == expected, f"{name}.{method}"
                compared += 1
    assert compared > 15


def test_xhand_commands_have_the_fields_and_widths_of_the_binding():
    clock = ManualClock()
    hand = xhand_sdk.XHand("right", identifier=1, clock=clock)
    with installed(xhand_sdk.xhand_modules(hand)):
        from xhand_controller import xhand_control

        device = xhand_control.XHandControl()
        command = xhand_control.HandCommand_t()
        assert device.send_command(1, command).error_code == 1501038  # not opened
        assert device.enumerate_devices("RS485") == ["/dev/ttyUSB0"]
        assert device.open_serial("/dev/ttyUSB0", 3_000_000).error_code == 0
        assert device.list_hands_id() == [1]
        for i in range(12):
            finger = command.finger_command[i]
            finger.id, finger.kp, finger.ki, finger.kd = i, 100, 0, 0
            finger.position, finger.tor_max, finger.mode = 0.5, 300, 3
        with pytest.raises(TypeError):
            command.finger_command[0].kp = 100.0
        with pytest.raises(TypeError):
            command.finger_command[0].tor_max = -1
        command.finger_command[0] = xhand_control.FingerCommand_t()  # of a copy of the list
        assert device.send_command(1, command).error_code == 0
        assert device.send_command(2, command).error_code == 1501037
        clock.advance(1)
        error, state = device.read_state(1, False)
        assert error.error_code == 0
        assert [finger.position for finger in state.finger_state] == [0.5] * 12
        assert len(state.sensor_data[0].raw_force) == 120
        hand.faults.silent = True
        assert device.read_state(1)[0].error_code == 1501050
        hand.faults.silent = False
        hand.reboot()
        assert device.list_hands_id() == [0]
        hand.occupied = True
        assert device.open_serial("/dev/ttyUSB0", 3_000_000).error_code == 1501039


def test_wuji_frames_hold_the_joints_online_by_their_nid():
    clock = ManualClock()
    hand = wuji_sdk.Hand("left", clock=clock)
    other = wuji_sdk.Hand("right", clock=clock)
    with installed(wuji_sdk.wuji_modules(hand, other)):
        import wuji_sdk as sdk

        manager = sdk.SdkManager.instance()
        with pytest.raises(sdk.WujiException, match="exactly one"):
            manager.connect(device_name="hand")
        device = manager.connect(handedness=sdk.Handedness.Left, device_name="hand")
        assert device.serial_number[3] == "J"
        assert [sdk.WujiHand2.nid_to_joint_index(nid) for nid in (1, 4, 6, 24)] == [0, 3, 4, 19]
        with pytest.raises(sdk.WujiException, match="nid 5 is not a joint nid"):
            sdk.WujiHand2.nid_to_joint_index(5)
        publisher = device.joint_command().publish()
        states = device.joint_states().subscribe()
        publisher.send([sdk.JointCommand(0.5, 0.0, 0.0)] * 20)
        clock.advance(1)
        assert {entry.position for entry in states.recv().joints} == {0.0}  # not enabled
        assert states.recv() is None
        device.enable()
        hand.offline.add(4)
        hand.set_fault(0, wuji_sdk.OVERCURRENT)
        hand.set_fault(1, wuji_sdk.STALL)
        publisher.send([sdk.JointCommand(0.5, 0.0, 0.0)] * 20)
        clock.advance(1)
        frame = states.recv()
        assert [entry.nid for entry in frame.joints[:6]] == [1, 2, 3, 4, 7, 8]
        assert [entry.position for entry in frame.joints[:3]] == [0.0, 0.5, 0.5]
        assert len(frame) == 19
        assert device.effort_limit().get()[4] is None
        device.clear_fault()
        diagnostics = device.joint_diagnostics().subscribe().recv()
        assert {entry.error_code_current for entry in diagnostics.joints} == {0}
        with pytest.raises(sdk.WujiException):
            publisher.send([sdk.JointCommand(0.0, 0.0, 0.0)] * 19)
        hand.faults.silent = True
        assert states.recv() is None
        with pytest.raises(sdk.WujiException):
            device.enable()
        assert sdk.WujiHand2.describe_error(0) is None
        assert sdk.describe_error("E-11-32-2102")["clear_policy"] == "ManualClear"


def test_wuji_hand_stops_without_commands_if_it_watches_them():
    clock = ManualClock()
    hand = wuji_sdk.Hand("right", clock=clock, command_timeout=0.1)
    with installed(wuji_sdk.wuji_modules(hand)):
        import wuji_sdk as sdk

        device = sdk.SdkManager.instance().auto_connect("hand")
        device.enable()
        device.joint_command().publish().send([sdk.JointCommand(1.0, 0.0, 0.0)] * 20)
        clock.advance(0.2)
        entry = device.joint_diagnostics().subscribe().recv().joints[0]
        assert entry.error_code_current == wuji_sdk.COMM_TIMEOUT


def test_revo3_order_begins_with_the_pinky():
    assert revo3_sdk.JOINTS[:2] == ("pinky_abd", "pinky_mcp")
    assert revo3_sdk.JOINTS[16] == "thumb_cmc_rot"
    assert revo3_sdk.RANGES.shape == (21, 2)
    assert revo3_sdk.RANGES[18].tolist() == [-10, 103]
    assert revo3_sdk.RANGES[4].tolist() == [-15, 15]


def test_revo3_servo_session_expires_and_conflicts_with_single_commands():
    clock = ManualClock()
    hand = revo3_sdk.Revo3("left", clock=clock)

    async def run(sdk) -> None:
        async with sdk.Manager() as manager:
            device = await manager.connect_auto()
            assert device.device_info.hand_side is sdk.HandSide.Left
            await device.motion.set_position([10.0] * 21)
            clock.advance(1)
            assert (await device.state.snapshot()).positions_deg == [10.0] * 21
            session = device.motion.open_servo()
            with pytest.raises(sdk.SdkError) as conflict:
                await device.motion.set_position([0.0] * 21)
            assert conflict.value.code is sdk.SdkErrorCode.ControlConflict
            await session.send_position([5.0] * 21)
            clock.advance(0.15)
            assert session.state is sdk.ServoSessionState.Expired
            with pytest.raises(sdk.SdkError) as late:
                await session.send_position([5.0] * 21)
            assert late.value.code is sdk.SdkErrorCode.InvalidState
            with pytest.raises(sdk.SdkError, match="expected 21"):
                await device.motion.set_position([0.0] * 20)
            with pytest.raises(sdk.SdkError, match="thumb_cmc_abd"):
                await device.motion.set_joint_position(19, -5.0)
            await device.motion.set_finger_position(1, [0.0, 1.0, 2.0, 3.0])  # the index
            assert hand.motors.targets[12:16].tolist() == [0.0, 1.0, 2.0, 3.0]
            hand.motor_faults[3] = 8
            health = await device.health.snapshot()
            assert (health.faulted_motor_count, int(health.safety_state)) == (1, 2)
            await device.health.clear_motor_faults()
            hand.faults.answer_wrongly("timeout")
            with pytest.raises(sdk.SdkError) as lost:
                await device.state.snapshot()
            assert lost.value.retryable
            await device.motion.software_stop()
            with pytest.raises(sdk.SdkError, match="software stop"):
                await device.motion.set_position([0.0] * 21)
            await device.motion.recover_software_stop()
            await device.motion.set_position([0.0] * 21)

    with installed(revo3_sdk.revo3_modules(hand)):
        from bc_revo3_sdk import main_mod

        asyncio.run(run(main_mod))


def test_revo3_models_other_than_the_ultra_cannot_be_moved():
    hand = revo3_sdk.Hand(revo3_sdk.Revo3(model=revo3_sdk.Revo3Model.Pro))
    with pytest.raises(revo3_sdk.SdkError) as refused:
        _ = hand.motion
    assert refused.value.code is revo3_sdk.SdkErrorCode.UnsupportedCapability
