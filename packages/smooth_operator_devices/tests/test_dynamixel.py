"""The Dynamixel driver against servos on a serial line that speak protocol 2.0."""

import numpy as np
import pytest
from driven_hands import Driven
from dynamixel_bank import ServoBank, crc16, packet
from hand_rigs import Rig
from live_time import until

from smooth_operator import Hand, load_hand
from smooth_operator.errors import ConfigError, SinkError
from smooth_operator.teleop import TeleopRequest, teleoperate
from smooth_operator.teleop.components import build_sink
from smooth_operator.teleop.recording.log_reader import read_log
from smooth_operator_devices.hands.device import WrongAnswerError
from smooth_operator_devices.hands.drivers.dynamixel import LeapSink

pytest_plugins = ["hand_rig_fixtures"]


@pytest.fixture(scope="module")
def hand() -> Hand:
    return load_hand("leap_hand")


@pytest.fixture
def rig(rigs) -> Rig:
    return rigs("leap", patience=0.036)  # as it is without a test


@pytest.fixture
def bank(rig) -> ServoBank:
    return rig.hand


def calm(driven: Driven) -> bool:
    """True if the hand follows; its note may still count earlier faults."""
    words = ("approaches", "waiting", "retrying", "no answer")
    return not any(word in driven.sink.note for word in words)


def test_checksum_and_packets_are_those_of_the_published_protocol():
    # the examples of the protocol's description: ping of servo 1, and its answer
    assert crc16(bytes.fromhex("fffffd0001030001")) == 0x4E19
    assert packet(1, bytes([0x06, 0x04, 0x26])) == bytes.fromhex("fffffd000107005500060426655d")
    assert b"\xff\xff\xfd\xfd" in packet(1, b"\xff\xff\xfd")


@pytest.mark.parametrize("fast", [True, False])
def test_a_leap_hand_boots_approaches_and_is_read_back(rig, bank, fast):
    bank.fast = fast
    with Driven(rig, approach=10.0, speed=20.0) as driven:
        state = driven.sink.state("right")
        assert state.positions == pytest.approx(0.0, abs=0.001)  # pi is open
        assert not rig.powered()  # nothing moves yet
        servo = bank.servos[0]
        assert servo.get(11, 1) == 5
        assert [servo.get(102, 2), servo.get(84, 2), servo.get(80, 2)] == [350, 450, 150]
        assert bank.servos[1].get(84, 2) == 600
        wanted = driven.ask(0.5)
        until(lambda: calm(driven) and rig.near(wanted))
        assert all(abs(goal - 2048) < 10 * 0.04 * 652 for goal in bank.goals[0].values())
        joints = driven.tick.command.joint_positions
        until(lambda: np.abs(driven.sink.state("right").positions - joints).max() < 0.02)
        assert servo.get(98, 1) == 25  # the servos' own watchdog: half a second
        assert set(driven.sink.state("right").temperatures.tolist()) == {33.0}
    until(lambda: not rig.powered())
    until(lambda: servo.get(98, 1) == 0)
    assert bank.bad == 0


def test_servos_that_stopped_themselves_follow_again(rig, bank):
    """A machine stood still longer than the servos' watchdog allows: they refuse goals then."""
    with Driven(rig) as driven:
        wanted = driven.ask(0.4)
        until(lambda: calm(driven) and rig.near(wanted))
        for servo in bank.servos.values():
            servo.table[98] = 255
        wanted = driven.ask(0.6)
        until(lambda: driven.sink.figures["device_lost"])
        assert "stopped themselves" in driven.sink.note
        until(lambda: calm(driven) and rig.near(wanted))


def test_a_servo_whose_torque_stays_off_is_a_wrong_answer(rigs):
    rig = rigs("leap")
    device, servo = rig.open(), rig.hand.servos[3]
    start, takes = device.read().positions, servo.write
    servo.write = lambda address, data: 0 if address == 64 else takes(address, data)
    with pytest.raises(WrongAnswerError, match="a servo did not switch its torque on"):
        device.write(start)
    servo.write = takes
    device.write(start)
    until(lambda: servo.torque)


def test_servos_with_another_control_table_are_refused(rig, bank, hand):
    bank.servos[7].put(0, 2, 350)  # XL-320
    written = bytes(bank.servos[7].table[:126])  # what follows is measured
    with pytest.raises(SinkError, match=r"servo 7 \(middle_dip\) is of model number 350.* XL330"):
        rig.build().open({"right": hand}, {})
    assert bytes(bank.servos[7].table[:126]) == written


def test_the_current_limit_is_the_lowest_of_table_run_and_servo(rig, bank):
    bank.servos[5].put(38, 2, 120)
    with Driven(rig, limit=200.0):
        assert bank.servos[4].get(102, 2) == 200
        assert bank.servos[5].get(102, 2) == 120


def test_a_servo_with_an_error_is_shown(rig, bank):
    with Driven(rig) as driven:
        driven.ask(0.4)
        bank.servos[3].error = 0x20
        bank.servos[9].put(146, 1, 72)
        until(lambda: "index_dip: overload; switch its power off and on" in driven.sink.note)
        until(lambda: "hot: ring_forward 72 °C" in driven.sink.note)


def test_a_whole_run_has_measured_joints_in_its_log(bank, hand, tmp_path):
    for duration in (1.5, 15.0):  # a machine that stalls takes longer
        take = tmp_path / f"{duration}.mcap"
        request = TeleopRequest(sink=(f"record:{take}",), method="joint_angle", duration=duration)
        sink = LeapSink(port=bank.path, baud=57600, approach=10.0)
        summary = teleoperate(request, sinks=[sink], hand=hand)
        states = read_log(take).states
        if len(states) > 20:
            break
    assert len(states) > 20
    assert set(states.names) == set(hand.joint_names)
    assert np.ptp(states.positions, axis=0).max() > 0.1  # it moved
    (sink, _) = summary["sinks"]
    assert sink["figures"]["cycles"] > 20
    assert "right" in summary["motion_delay_ms"]


def test_what_can_not_be_opened(rig, bank, hand, tmp_path):
    with pytest.raises(SinkError, match="there is no serial port"):
        LeapSink(port="/dev/ttyNONE").open({"right": hand}, {})
    sink = rig.build()
    bank.silent.add(7)
    with pytest.raises(SinkError, match=r"no answer from the servos 7 \(middle_dip\)"):
        sink.open({"right": hand}, {})
    bank.silent.update(bank.servos)
    with pytest.raises(SinkError, match="no servo answers at 57600 baud"):
        sink.open({"right": hand}, {})
    bank.silent.clear()
    with Driven(rig), pytest.raises(SinkError, match="in use by another run"):
        sink.open({"right": hand}, {})
    text = 'format=1\ndriver="dynamixel"\nhand="leap_hand"\nside="right"\nunit="{}"\n{}\n'
    row = '[[actuators]]\nname="a"\n{}joint="0"\npoints=[[0,0],[1,1]]\n'
    for unit, head, each, said in (
        ("furlong", "", "id=1\n", "the unit of servos"),
        ("rad", "", "", "every servo needs an id"),
        ("rad", "settings={baut=1}", "id=1\n", "no setting 'baut'"),
        ("rad", "settings={watchdog=9}", "id=1\n", "watchdog must be"),
        ("rad", "settings={watchdog=inf}", "id=1\n", "watchdog must be finite"),
        ("rad", "settings={current_unit=0}", "id=1\n", "current_unit must be over 0"),
        ("rad", "limit=inf", "id=1\n", "expected a finite number, not inf"),
        ("rad", "", "id=1\nlimit=-1\n", "limit must be over 0 and finite, not -1"),
    ):
        path = tmp_path / "x.toml"
        path.write_text(text.format(unit, head) + row.format(each))
        sink = build_sink(f"dynamixel:{bank.path},table={path}")
        with pytest.raises(ConfigError, match=said):
            sink.open({"right": hand}, {})
