"""Drivers of hands on CAN: their frames, and how they read answers."""

import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from driven_hands import quiet
from hand_rigs import DRIVERS, Rig
from live_time import PATIENCE_S, until

from smooth_operator_devices.hands.device import Reading, WrongAnswerError
from smooth_operator_devices.hands.drivers.allegro import AllegroSink
from smooth_operator_devices.hands.drivers.dexhand021 import DexHand021Device
from smooth_operator_devices.hands.drivers.linker_models import MODELS

pytest.importorskip("can", reason="needs python-can")

import can
from simulators import linkerhand_can
from simulators.dexhand021_can import JOINTS, OVERLOAD, STALL

pytest_plugins = ["hand_rig_fixtures"]


@pytest.fixture
def spy(rigs) -> Callable[[Rig], Any]:
    """A function that connects another program to the bus of a rig."""

    def connect(rig: Rig) -> Any:
        bus = can.Bus(rig.channel, interface="virtual")
        rig.served.callback(bus.shutdown)
        return bus

    return connect


def frame(identifier: int, data: list[int]) -> Any:
    return can.Message(arbitration_id=identifier, data=data, is_extended_id=False)


def test_linker_frames(rigs):
    rig = rigs("linker-l20", "left")
    hand, device = rig.hand, rig.open(speed=120)
    device.write(np.arange(16) * 10.0)
    device.read()
    seen = [each.hex() for each in hand.received]
    assert {"01000a141e28", "02323c46505a", "036400000000", "046e78828c96"} <= set(seen)
    assert seen.index("07" + "01" * 5) > seen.index("046e78828c96")  # clears when it is commanded
    assert hand.speeds[:5].tolist() == [120] * 5
    hand.raise_fault("index_root", 3)
    device.read()
    time.sleep(0.02)
    assert device.read().errors == ("index: fault 0x03",)


@pytest.mark.parametrize("name", ["linker-o6", "linker-l10"])
def test_linker_touch_matrices(rigs, name, spy):
    rig = rigs(name)
    other, plain = spy(rig), rig.open()
    assert plain.read().touch is None
    while (asked := other.recv(timeout=0.05)) is not None:
        assert asked.data[0] < 0xB1  # it is not asked for them
    plain.close()
    hand = rig.hand
    for k, matrix in enumerate(hand.touch.values()):
        matrix[:] = np.arange(matrix.size).reshape(matrix.shape) + k
    device = rig.open(touch=1)
    assert device.read().pads == {}
    reading = until(lambda: (r := device.read()).pads and r)
    assert list(reading.pads) == ["thumb", "index", "middle", "ring", "little"]
    for cells, matrix in zip(reading.pads.values(), hand.touch.values(), strict=True):
        np.testing.assert_array_equal(cells, matrix)
    assert reading.touch.tolist() == [matrix.sum() for matrix in hand.touch.values()]


@pytest.mark.parametrize(("side", "identifier"), [("left", 0x28), ("right", 0x27)])
@pytest.mark.parametrize("name", ["linker-o6", "linker-l10", "linker-l20", "linker-l21"])
def test_linker_identifiers_are_those_of_the_makers_sdk(name, side, identifier, rigs, spy):
    """The maker's enumeration of sides: LEFT = 0x28, RIGHT = 0x27."""
    rig = rigs(name, side)
    other = spy(rig)
    rig.open()
    assert other.recv(timeout=PATIENCE_S).arbitration_id == identifier


def test_linker_answers_from_before_a_command_are_not_taken_for_answers_to_it(rigs, spy):
    rig = rigs("linker-l20")
    other, device = spy(rig), rig.open()
    device.read()
    rig.faults.silent = True
    time.sleep(0.05)  # until it has answered what was asked
    rig.patience(0.1)
    for kind in (1, 2, 3, 4):
        other.send(frame(0x27, [kind, *[7] * 5]))
    device.write(np.full(16, 200.0))
    with pytest.raises(WrongAnswerError, match="did not answer frame 0x01"):
        device.read()


def test_linker_questions_of_another_program_are_not_taken_for_answers(rigs, spy):
    """A question has the same identifier as the answer, and no values."""
    rig = rigs("linker-l21")
    other, device = spy(rig), rig.open()
    rig.hand.motors.place(np.arange(17) * 10.0)
    rig.faults.delay_s = 0.005  # so that the questions are alone when the driver reads
    for _ in range(5):
        for kind in range(0x41, 0x46):
            other.send(frame(0x27, [kind]))
        assert device.read().positions.tolist() == (np.arange(17) * 10.0).tolist()


BY_FINGER = [*range(0x51, 0x56)]


@pytest.mark.parametrize(
    ("name", "kinds", "joint", "bits", "said"),
    [
        ("o6", [2], "middle", 0b101000, "middle_base: overcurrent, overload"),
        ("l6", [2], "pinky", 0b1100000, "little_base: motor too hot, controller too hot"),
        ("l7", [2], "thumb_roll", 8, "thumb_turn: fault 0x08"),
        ("l10", [2, 3], "thumb_yaw", 4, "thumb_turn: fault 0x04"),
        ("l20lite", [2, 3], "index_abd", 4, "index_side: too hot"),
        ("l21", BY_FINGER, "ring_tip", 0b10000010, "ring_tip: overcurrent, motor does not answer"),
        ("l25", BY_FINGER, "pinky_middle", 1, "little_middle: rotor locked"),
    ],
)
def test_linker_models_report_heat_and_faults_and_take_limits(name, kinds, joint, bits, said, rigs):
    rig = rigs(f"linker-{name}")
    hand, device = rig.hand, rig.open(limit=150.0)
    motors = len(hand.motors)
    hand.motors.temperatures[:] = 30 + np.arange(motors)
    hand.raise_fault(joint, bits)
    goals = 255.0 - 10.0 * np.arange(motors)
    device.write(np.full(motors, 255.0))
    found = {setting.name: setting for setting in device.settings()}
    assert {f"frame 0x{kind:02X}" for kind in kinds} <= found.keys()
    assert all((setting.measured == setting.expected).all() for setting in found.values())
    assert hand.torques.tolist() == [150] * motors
    assert hand.speeds.tolist() == [250] * motors
    hand.raise_fault(joint, bits)

    def whole() -> Reading | None:
        device.write(goals)
        reading = device.read()
        heat = reading.temperatures
        warm = heat is not None and heat.tolist() == hand.motors.temperatures.tolist()
        return reading if reading.errors and warm else None

    assert until(whole).errors == (said,)
    device.relax()  # the next command clears the fault
    if device._model.clear:
        until(lambda: not whole())
        until(lambda: np.abs(device.read().positions - goals).max() < 1)


def test_linker_o6_reports_currents(rigs):
    rig = rigs("linker-o6")
    device = rig.open()
    rig.hand.motors.stuck.add(2)
    rig.hand.motors.stall_current = 700.0

    def pressing() -> bool:
        device.write(np.zeros(6))
        currents = device.read().currents
        return currents is not None and currents[2] == 127  # of 255 for 1400 mA

    until(pressing)


@pytest.mark.parametrize("model", [*MODELS])
def test_linker_models_are_those_of_the_simulator(model):
    """Motors and frames, as another author read them from the maker's texts."""
    other = {"l20lite": "L20 lite", "l25_16": "L25 linkerbot"}.get(model, model.upper())
    theirs, mine = linkerhand_can.MODELS[other], MODELS[model]
    assert mine.motors == len(theirs.joints)
    for name, frames in (
        ("positions", mine.positions),
        ("speeds", mine.speeds),
        ("temperatures", mine.temperatures),
        ("faults", mine.faults),
        ("currents" if model == "l20" else "torques", mine.limits),
    ):
        layout = getattr(theirs, name)
        for kind, row in frames.items():
            assert [m is None for m in row] == [m is None for m in layout[kind]]


@pytest.mark.parametrize(
    ("name", "error"),
    [("allegro-v4", "hand: too hot"), ("allegro-v5", "middle_1: input voltage, too hot, overload")],
)
def test_allegro_torques_have_the_sign_and_the_limit(name, error, rigs, monkeypatch):
    monkeypatch.setattr(f"{DRIVERS}.allegro._ASK_S", 0.05)
    rig = rigs(name)
    hand, device = rig.hand, rig.open()
    assert hand.switched == [False]
    start = until(lambda: quiet(device)).positions
    device.write(start)
    hand.stuck.update(range(16))
    goal = start + np.where(np.arange(16) % 2, 0.5, -0.5)
    device.write(goal)
    until(lambda: hand.torque.all())
    assert (np.sign(hand.torque) == np.sign(goal - start)).all()
    assert hand.largest_torque <= np.nanmax(device._table.limits)
    assert (np.abs(until(lambda: quiet(device)).currents) > 0).all()
    device.relax()
    until(lambda: not hand.servo_on)
    assert hand.switched == [False, True, False]
    hand.error = (5, 0b100101)
    until(lambda: (reading := quiet(device)) and reading.errors == (error,))


def test_allegro_angles_that_are_old_are_no_answer(rigs, monkeypatch):
    rig = rigs("allegro-v5")
    monkeypatch.setattr(f"{DRIVERS}.allegro._LATE_S", 0.03)
    device = rig.open()
    rig.faults.silent = True
    time.sleep(0.04)
    with pytest.raises(WrongAnswerError, match=r"the newest angles are \d+ ms old"):
        device.read()


def test_a_runs_limit_lowers_every_actuators_own():
    own = AllegroSink().actuators("right").limits
    assert own.min() < 280.0 < own.max()
    weaker = AllegroSink(limit=280.0).actuators("right").limits
    np.testing.assert_array_equal(weaker, np.minimum(own, 280.0))


@pytest.mark.parametrize("side", ["right", "left"])
def test_dexhand021_frames_are_those_of_the_maker(rigs, side):
    rig = rigs("dexhand021", side)
    hand, device = rig.hand, rig.open()
    assert device._table.names == JOINTS
    device.write(np.arange(12.0))

    def sent() -> list[tuple[int, bytes]]:
        return [(i, d[:6]) for i, d in list(hand.received) if i & 0xF80 == 0x100]

    commands = until(lambda: len(sent()) == 6 and sent())
    assert [identifier for identifier, _ in commands] == [0x100 + hand.base + b for b in range(6)]
    assert commands[1][1] == bytes([0x44, 3, 200, 0, 300 - 256, 1])
    until(lambda: np.abs(device.read().positions - np.arange(12.0)).max() < 0.01)
    device.relax()
    until(lambda: not hand.motors.powered.any())
    assert set(hand.modes) == {0}


def test_dexhand021_reports_currents_heat_and_touch(rigs):
    rig = rigs("dexhand021")
    hand, device = rig.hand, rig.open()
    hand.motors.temperatures[4] = 70
    hand.touch[3] = {"normal": 2.5, "tangential": 0.5, "direction": 90}
    hand.motors.stuck.add(5)
    device.write(np.full(12, 20.0))
    reading = until(lambda: (r := device.read()).currents[5] == 800 and r)
    assert reading.temperatures[4:6].tolist() == [70, 70]
    assert np.isnan(reading.temperatures[2:4]).all()  # the palm's board has no fingertip
    assert reading.touch.tolist() == [0, 0, 0, 0, 2.5, 0.5, 0, 0, 0, 0]


def test_dexhand021_motor_that_stalled_follows_again_from_where_it_stands(rigs):
    rig = rigs("dexhand021")
    hand, device = rig.hand, rig.open()
    device.write(np.full(12, 5.0))
    until(lambda: np.abs(device.read().positions - 5.0).max() < 0.01)
    hand.raise_error("ff_mcp", STALL)
    hand.raise_error("mf_dip", OVERLOAD)

    def after(command: float) -> Reading:
        device.write(np.full(12, command))
        return device.read()

    reading = until(lambda: len((r := after(40.0)).errors) == 2 and r)
    assert reading.errors == ("ff_mcp: stalled", "mf_dip: too much current")
    after(40.0)
    assert hand.errors[5] == STALL  # it is not switched on far from its command
    assert hand.motors.positions[5] == pytest.approx(5.0)
    until(lambda: not after(6.0).errors)
    until(lambda: abs(after(40.0).positions[5] - 40.0) < 0.01)


def test_dexhand021_boards_that_do_not_report_are_wrong_answers(rigs):
    rig = rigs("dexhand021")
    hand, device = rig.hand, rig.open()
    rig.patience(0.2)
    hand.dead_boards.add(3)
    with pytest.raises(WrongAnswerError, match=f"no feedback from board {hand.base + 3} within"):
        device.read()
    hand.dead_boards.clear()
    assert device.read().positions.tolist() == [0.0] * 12
    hand.reboot()  # it reports nothing until it is asked again
    time.sleep(0.1)
    with pytest.raises(WrongAnswerError, match=f"no feedback from board {hand.base} within"):
        device.read()
    rig.patience(3.0)
    device.close()
    device.open()
    assert device.read().positions.tolist() == [0.0] * 12


def test_dexhand021_ignores_frames_of_other_devices(rigs, spy):
    rig = rigs("dexhand021")
    other = spy(rig)
    device: DexHand021Device = rig.open()
    for identifier in (0x180 + 40, 0x600 + 40, 0x27, 0x100 + rig.hand.base):
        other.send(frame(identifier, [1, 2, 3]))
    reading = device.read()
    assert (reading.positions.tolist(), reading.errors) == ([0.0] * 12, ())
