"""Drivers of real hands on the wire, byte by byte: their commands, and how they read answers."""

import contextlib
import importlib.util
import inspect
import itertools
import os
import struct
import sys
import time
import types
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from ability_simulator import AbilityHand
from allegro_simulator import AllegroHand
from fake_hand_sdks import StarkContext, StarkWorld, WujiController, WujiHand, WujiWorld
from hand_rigs import missing
from inspire_simulator import InspireHand, TcpServer
from live_time import PATIENCE_S, until
from ticks import make_tick

from smooth_operator import Hand, load_hand
from smooth_operator.errors import ConfigError, MissingExtraError, SinkError
from smooth_operator.hands.wrist_joints import with_wrist_joints
from smooth_operator.teleop.components import build_sink
from smooth_operator.types import JointCommand
from smooth_operator_devices.hands.actuator_map import (
    ActuatorMap,
    BoundMap,
    built_in_tables,
    read_table,
)
from smooth_operator_devices.hands.device import Reading, WrongAnswerError
from smooth_operator_devices.hands.drivers.ability import AbilityDevice, framed, unstuffed
from smooth_operator_devices.hands.drivers.allegro import AllegroDevice, AllegroSink
from smooth_operator_devices.hands.drivers.inspire import InspireDevice
from smooth_operator_devices.hands.drivers.linker import LinkerDevice
from smooth_operator_devices.hands.drivers.linker_models import MODELS
from smooth_operator_devices.hands.drivers.orca import OrcaSink
from smooth_operator_devices.hands.drivers.revo2 import Revo2Device
from smooth_operator_devices.hands.drivers.wuji import WujiDevice

_channels = itertools.count()


@pytest.fixture(autouse=True)
def patience(monkeypatch) -> None:
    """The machine may be busy."""
    drivers = "smooth_operator_devices.hands.drivers"
    for name in ("ability._TIMEOUT", "linker._TIMEOUT", "modbus_line.TIMEOUT", "allegro._STALE_S"):
        monkeypatch.setattr(f"{drivers}.{name}", 3.0)
    monkeypatch.setattr(f"{drivers}.allegro._ASK_S", 0.05)


@pytest.fixture
def closing() -> Iterator[Callable[..., None]]:
    """Takes devices, hands and buses, which are closed in this order at the end."""
    things: list[Any] = []
    yield lambda *more: things.extend(more)
    for thing in things:
        (getattr(thing, "shutdown", None) or thing.close)()


def table(name: str, **settings: object) -> ActuatorMap:
    found = read_table(built_in_tables() / f"{name}.toml")
    return replace(found, settings={**found.settings, **settings})


def needs(rig: str) -> None:
    if why := missing(rig):
        pytest.skip(why)


def linker(
    closing: Callable[..., None], model: str, side: str = "right", **settings: Any
) -> tuple[LinkerDevice, Any, Any]:
    """An open device, its simulated hand on a virtual bus, and another program on that bus.

    Args:
        model: of the simulator, such as ``L20 lite``.
    """
    needs("linker-l20")
    import can
    from simulators.common import serve_can
    from simulators.linkerhand_can import LinkerHand

    wire = f"protocol-{next(_channels)}-{os.getpid()}"
    hand = LinkerHand(model, side)
    served, spy = contextlib.ExitStack(), can.Bus(wire, interface="virtual")
    served.enter_context(serve_can(hand, can.Bus(wire, interface="virtual")))
    limit = settings.pop("limit", None)
    name = model.lower().replace(" ", "")
    actuators = replace(table(f"linker_{name}_{side}", **settings), limit=limit)
    device = LinkerDevice(actuators, f"virtual:{wire}", name)
    closing(device, spy, served)
    device.open()
    return device, hand, spy


def allegro(
    closing: Callable[..., None], version: str, *, left: bool = False
) -> tuple[AllegroDevice, AllegroHand]:
    """A device that is not open yet, and its hand on a virtual bus."""
    needs("allegro-v5")
    wire = f"protocol-{next(_channels)}-{os.getpid()}"
    hand = AllegroHand(wire, version, left=left)
    name = "allegro_right" if version == "v4" else "allegro_v5_right"
    device = AllegroDevice(table(name), f"virtual:{wire}")
    closing(device, hand)
    return device, hand


def test_inspire_sets_its_limits_and_says_what_the_motors_report(closing):
    needs("inspire")
    hand = InspireHand()
    hand.errors = [0, 4, 0, 0, 0, 0]
    server = TcpServer(hand)
    device = InspireDevice(table("inspire_right", force=300, speed=700), f"127.0.0.1:{server.port}")
    closing(device, server)
    device.open()
    assert (hand.force_limit, hand.speed, hand.cleared) == ([300] * 6, [700] * 6, 1)
    hand.errors = [1, 0, 2 | 4, 0, 0, 16]
    hand.servos.stuck.add(3)
    device.write(np.array([1000, 1000, 1000, 400, 1000, 1000.0]))
    for _ in range(8):
        reading = device.read()
    assert reading.errors == (
        "little: rotor locked",
        "middle: too hot",
        "middle: too much current",
        "thumb_rotation: motor does not answer",
    )
    assert reading.temperatures.tolist() == [31, 32, 33, 34, 35, 36]
    assert reading.currents.tolist() == [0, 0, 0, 1500, 0, 0]
    assert reading.touch.tolist() == [0, 0, 0, 300, 0, 0]


def test_linker_frames(monkeypatch, closing):
    device, hand, _ = linker(closing, "L20", "left", speed=120)
    device.write(np.arange(16) * 10.0)
    device.read()
    seen = [frame.hex() for frame in hand.received]
    assert {"01000a141e28", "02323c46505a", "036400000000", "046e78828c96"} <= set(seen)
    assert seen.index("07" + "01" * 5) > seen.index("046e78828c96")  # clears when it is commanded
    assert hand.speeds[:5].tolist() == [120] * 5
    hand.raise_fault("index_root", 3)
    device.read()
    time.sleep(0.02)
    assert device.read().errors == ("index: fault 0x03",)
    monkeypatch.setattr("smooth_operator_devices.hands.drivers.linker._TIMEOUT", 0.1)
    right = LinkerDevice(table("linker_l20_right"), device._port, "l20")
    with pytest.raises(SinkError, match="not a left hand, which has the identifier 0x28"):
        right.open()


@pytest.mark.parametrize("model", ["O6", "L10"])
def test_linker_touch_matrices(model, closing):
    device, hand, _ = linker(closing, model, touch=1)
    for k, matrix in enumerate(hand.touch.values()):
        matrix[:] = np.arange(matrix.size).reshape(matrix.shape) + k
    assert device.read().pads == {}
    reading = until(lambda: (r := device.read()).pads and r)
    assert list(reading.pads) == ["thumb", "index", "middle", "ring", "little"]
    for found, matrix in zip(reading.pads.values(), hand.touch.values(), strict=True):
        np.testing.assert_array_equal(found, matrix)
    assert reading.touch.tolist() == [matrix.sum() for matrix in hand.touch.values()]
    plain, _, spy = linker(closing, model)
    assert plain.read().touch is None
    while (frame := spy.recv(timeout=0.05)) is not None:
        assert frame.data[0] < 0xB1  # it is not asked


@pytest.mark.parametrize(("side", "identifier"), [("left", 0x28), ("right", 0x27)])
@pytest.mark.parametrize("model", ["O6", "L10", "L20", "L21"])
def test_linker_identifiers_are_those_of_the_makers_sdk(model, side, identifier, closing):
    """The maker's enumeration of sides: LEFT = 0x28, RIGHT = 0x27."""
    _, _, spy = linker(closing, model, side)
    frame = spy.recv(timeout=PATIENCE_S)
    assert frame is not None
    assert frame.arbitration_id == identifier


def test_linker_answers_from_before_a_command_are_not_taken_for_answers_to_it(monkeypatch, closing):
    import can

    device, hand, spy = linker(closing, "L20")
    device.read()
    hand.faults.silent = True
    time.sleep(0.05)  # until it has answered what was asked
    monkeypatch.setattr("smooth_operator_devices.hands.drivers.linker._TIMEOUT", 0.1)
    for kind in (1, 2, 3, 4):
        data = [kind, *[7] * 5]
        spy.send(can.Message(arbitration_id=0x27, data=data, is_extended_id=False))
    device.write(np.full(16, 200.0))
    with pytest.raises(WrongAnswerError, match="did not answer frame 0x01"):
        device.read()


def test_linker_questions_of_another_program_are_not_taken_for_answers(closing):
    """A question has the same identifier as the answer, and no values."""
    import can

    device, hand, spy = linker(closing, "L21")
    hand.motors.place(np.arange(17) * 10.0)
    for kind in (0x41, 0x45, 0x61) * 20:
        spy.send(can.Message(arbitration_id=0x27, data=[kind], is_extended_id=False))
        if kind == 0x45:
            assert device.read().positions.tolist() == (np.arange(17) * 10.0).tolist()


def test_linker_answers_with_the_identifier_of_the_other_side_are_none(monkeypatch, closing):
    device, hand, _ = linker(closing, "O6")
    monkeypatch.setattr("smooth_operator_devices.hands.drivers.linker._TIMEOUT", 0.1)
    hand.faults.answer_wrongly("identifier", 6)  # also to requests that are still on their way
    with pytest.raises(WrongAnswerError, match="did not answer frame 0x01"):
        device.read()

    def positions():
        with contextlib.suppress(WrongAnswerError):
            return device.read().positions.tolist()

    assert until(positions) == [255.0] * 6


@pytest.mark.parametrize(
    ("model", "kinds", "joint", "bits", "said"),
    [
        ("O6", [2], "middle", 0b101000, "middle_base: overcurrent, overload"),
        ("L6", [2], "pinky", 0b1100000, "little_base: motor too hot, controller too hot"),
        ("L7", [2], "thumb_roll", 8, "thumb_turn: fault 0x08"),
        ("L10", [2, 3], "thumb_yaw", 4, "thumb_turn: fault 0x04"),
        ("L20 lite", [2, 3], "index_abd", 4, "index_side: too hot"),
        (
            "L21",
            [*range(0x51, 0x56)],
            "ring_tip",
            0b10000010,
            "ring_tip: overcurrent, motor does not answer",
        ),
        ("L25", [*range(0x51, 0x56)], "pinky_middle", 1, "little_middle: rotor locked"),
    ],
)
def test_linker_models_report_heat_and_faults_and_take_limits(
    model, kinds, joint, bits, said, closing
):
    device, hand, _ = linker(closing, model, limit=150.0)
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


def test_linker_o6_reports_currents(closing):
    device, hand, _ = linker(closing, "O6")
    hand.motors.stuck.add(2)
    hand.motors.stall_current = 700.0

    def pressing() -> bool:
        device.write(np.zeros(6))
        currents = device.read().currents
        return currents is not None and currents[2] == 127  # of 255 for 1400 mA

    until(pressing)


@pytest.mark.parametrize("model", [*MODELS])
def test_linker_models_are_those_of_the_simulator(model):
    """Motors and frames, as another author read them from the maker's texts."""
    simulated = pytest.importorskip("simulators.linkerhand_can").MODELS
    other = {"l20lite": "L20 lite", "l25_16": "L25 linkerbot"}.get(model, model.upper())
    theirs, mine = simulated[other], MODELS[model]
    assert mine.motors == len(theirs.joints)
    for name, frames in (
        ("positions", mine.positions),
        ("speeds", mine.speeds),
        ("temperatures", mine.temperatures),
        ("faults", mine.faults),
        ("currents" if model == "l20" else "torques", mine.limits),
    ):
        layout = getattr(theirs, name)
        assert {kind: len(row) for kind, row in frames.items()} == {
            kind: len(layout[kind]) for kind in frames
        }
        for kind, row in frames.items():
            assert [m is None for m in row] == [m is None for m in layout[kind]]


def answer(device: AllegroDevice) -> Reading:
    """A reading, repeated while a loaded machine makes the newest angles old."""

    def read() -> Reading | None:
        with contextlib.suppress(WrongAnswerError):
            return device.read()
        return None

    return until(read)


@pytest.mark.parametrize("version", ["v4", "v5"])
def test_allegro_torques_have_the_sign_and_the_limit(version, closing):
    device, hand = allegro(closing, version)
    device.open()
    assert hand.switched == [False]
    start = answer(device).positions
    device.write(start)
    hand.stuck.update(range(16))
    goal = start + np.where(np.arange(16) % 2, 0.5, -0.5)
    device.write(goal)
    until(lambda: hand.torque.all())
    assert hand.servo_on
    assert (np.sign(hand.torque) == np.sign(goal - start)).all()
    assert hand.largest_torque <= np.nanmax(device._table.limits)
    assert (np.abs(answer(device).currents) > 0).all()
    device.relax()
    until(lambda: not hand.servo_on)
    assert hand.switched == [False, True, False]
    hand.error = (5, 0b100101)
    until(lambda: answer(device).errors)
    said = {"v4": "hand: too hot", "v5": "middle_1: input voltage, too hot, overload"}
    assert answer(device).errors == (said[version],)


def test_allegro_angles_that_are_old_are_no_answer(monkeypatch, closing):
    monkeypatch.setattr("smooth_operator_devices.hands.drivers.allegro._STALE_S", 60.0)
    device, hand = allegro(closing, "v5")
    device.open()
    hand.faults.mute = True
    time.sleep(0.04)  # over the 30 ms, well under three times as long
    with pytest.raises(WrongAnswerError, match=r"the newest angles are \d+ ms old"):
        device.read()


def test_a_runs_limit_lowers_every_actuators_own():
    own = AllegroSink().actuators("right").limits
    assert own.min() < 280.0 < own.max()
    weaker = AllegroSink(limit=280.0).actuators("right").limits
    np.testing.assert_array_equal(weaker, np.minimum(own, 280.0))


@pytest.mark.parametrize("version", ["v4", "v5"])
def test_allegro_of_the_other_side_is_refused(version, closing):
    device, _ = allegro(closing, version, left=True)
    with pytest.raises(SinkError, match="is a left hand"):
        device.open()


def test_ability_frames():
    # address, command, six positions of 0, and what makes the sum 0: 0x50 + 0x10 + 0xA0 = 0x100
    assert framed(bytes.fromhex("5010" + "00" * 12 + "a0")).hex() == "7e5010" + "00" * 12 + "a07e"
    assert framed(b"\x7e\x7d\x01") == b"\x7e\x7d\x5e\x7d\x5d\x01\x7e"
    for body in (os.urandom(40), b"\x7e" * 5, b""):
        assert unstuffed(framed(body)[1:-1]) == body


def test_ability_reads_touch_and_heat_and_keeps_the_hand_awake(closing):
    needs("ability")
    hand = AbilityHand()
    device = AbilityDevice(table("ability_right"), hand.port, 115200, 0x50)
    closing(device, hand)
    device.open()
    hand.hot = 0b100010
    hand.servos.stuck.add(2)
    device.write(np.array([15, 15, 60, 15, 15, -15.0]))
    reading = device.read()
    assert reading.touch.tolist() == hand.touch
    assert reading.currents[2] == pytest.approx(1125.0, abs=2.0)
    assert reading.errors == ("middle: too hot", "thumb_rotator: too hot")
    device.relax()
    device.read()
    assert not hand.servos.powered
    assert not hand.gaps
    assert not hand.bad_frames


@pytest.mark.skipif(not importlib.util.find_spec("ah_wrapper"), reason="needs ability-hand")
def test_ability_speaks_as_the_makers_package(tmp_path, monkeypatch, closing):
    monkeypatch.chdir(tmp_path)  # the package writes files into the current folder
    from ah_wrapper.ah_api import create_misc_msg, create_pos_msg
    from ah_wrapper.ah_parser import parse_packet

    degrees = [0.0, 12.5, 99.0, 33.3, 57.0, -81.0]
    body = struct.pack("<BB6h", 0x50, 0x10, *[int(d * 32767 / 150) for d in degrees])
    mine = framed(body + bytes([-sum(body) & 0xFF]))
    assert mine == bytes(create_pos_msg(reply_mode=0, positions=degrees))
    asked = bytes([0x50, 0xA0])
    assert framed(asked + bytes([-sum(asked) & 0xFF])) == bytes(create_misc_msg(0xA0))
    hand = AbilityHand()
    closing(hand)
    # and the simulator answers what the package understands
    descriptor = os.open(hand.port, os.O_RDWR | os.O_NOCTTY)
    os.write(descriptor, mine)
    answer = b""
    while answer.count(b"~") < 2:
        answer += os.read(descriptor, 256)
    packet = parse_packet(bytearray(unstuffed(answer.strip(b"~"))))
    assert packet.valid
    assert packet.pos == pytest.approx([15] * 5 + [-15], abs=2.0)


def test_wuji_limits_efforts_and_knows_its_side(monkeypatch):
    world = WujiWorld()
    monkeypatch.setitem(sys.modules, "wujihandpy", world.module)
    device = WujiDevice(table("wuji_right"), "", 10.0)
    device.open()
    assert (world.effort_limit == 1.0).all()  # ampere, of the table's 1000 mA
    assert world.switched == []
    world.codes[1, 2] = 0x20
    device.write(device.read().positions)
    for _ in range(60):
        reading = device.read()
    assert reading.errors == ("index_3: error 0x20",)
    assert (reading.temperatures == 41.0).all()
    assert np.abs(reading.currents).max() <= 1500.0
    device.relax()
    device.close()
    assert world.switched == [True, False]
    world.handedness = 1
    with pytest.raises(SinkError, match="is a left hand"):
        device.open()


def test_revo2_says_who_stalls_and_knows_its_side(monkeypatch):
    world = StarkWorld()
    monkeypatch.setitem(sys.modules, "bc_stark_sdk", world.package)
    monkeypatch.setitem(sys.modules, "bc_stark_sdk.main_mod", world.main_mod)
    device = Revo2Device(table("revo2_right"), "/dev/ttyUSB0", 460800)
    device.open()
    world.servos.stuck.add(2)
    device.write(np.array([0, 0, 500, 0, 0, 0.0]))
    reading = device.read()
    assert reading.errors == ("index: stalled",)
    assert reading.currents.tolist() == [0, 0, 1000, 0, 0, 0]
    device.close()
    left = StarkWorld(left=True)
    left.number = 0x7F
    monkeypatch.setitem(sys.modules, "bc_stark_sdk", left.package)
    monkeypatch.setitem(sys.modules, "bc_stark_sdk.main_mod", left.main_mod)
    with pytest.raises(SinkError, match="is a left hand"):
        device.open()


@pytest.mark.parametrize(
    ("build", "other"),
    [
        (lambda t: InspireDevice(t, "x"), "wuji_right"),
        (lambda t: LinkerDevice(t, "x", "l20"), "wuji_right"),
        (lambda t: AllegroDevice(t, "x"), "wuji_right"),
        (lambda t: AbilityDevice(t, "x", 460800, 0x50), "wuji_right"),
        (lambda t: WujiDevice(t, "", 10.0), "ability_right"),
        (lambda t: Revo2Device(t, "x", 460800), "wuji_right"),
    ],
)
def test_a_table_of_another_hand_is_refused(build, other):
    with pytest.raises(ConfigError, match="actuators, not"):
        build(table(other))


def calls(kind: type) -> dict[str, list[str]]:
    """Name of a method -> names of its parameters, without ``self``."""
    found = {}
    for name, method in inspect.getmembers(kind, inspect.isfunction):
        if not name.startswith("_"):
            found[name] = list(inspect.signature(method).parameters)[1:]
    return found


@pytest.mark.skipif(not importlib.util.find_spec("wujihandpy"), reason="needs wujihandpy")
def test_the_stand_in_of_wujihandpy_is_like_the_real_one():
    import wujihandpy

    for mine, real in ((WujiHand, wujihandpy.Hand), (WujiController, wujihandpy.IController)):
        for name, parameters in calls(mine).items():
            text = getattr(real, name).__doc__ or ""  # pybind11 writes the signature there
            for parameter in parameters:
                assert f"{parameter}:" in text, f"{name} of the real one takes no {parameter}"
    assert "serial_number" in (wujihandpy.Hand.__init__.__doc__ or "serial_number")
    wujihandpy.logging.set_log_to_console(False)
    wujihandpy.filter.LowPass(cutoff_freq=10.0)
    with pytest.raises(OSError):  # noqa: PT011 - what the driver turns into a sentence
        wujihandpy.Hand(serial_number="none-of-this-number")


@pytest.mark.skipif(not importlib.util.find_spec("bc_stark_sdk"), reason="needs bc-stark-sdk")
def test_the_stand_in_of_bc_stark_sdk_is_like_the_real_one():
    from bc_stark_sdk import main_mod

    for name, parameters in calls(StarkContext).items():
        real = list(inspect.signature(getattr(main_mod.DeviceContext, name)).parameters)
        assert real[-len(parameters) :] == parameters or not parameters, name
    world = StarkWorld()
    assert list(inspect.signature(main_mod.modbus_open).parameters) == ["port_name", "baudrate"]
    for kind in ("Baudrate", "FingerUnitMode", "HandType", "MotorState"):
        for member in getattr(world.main_mod, kind):
            assert hasattr(getattr(main_mod, kind), member.name), f"{kind}.{member.name}"


@pytest.fixture(scope="module")
def hand() -> Hand:
    return load_hand("orca_v2")


@pytest.mark.parametrize("side", ["right", "left"])
def test_the_table_fits_our_model(side):
    table = read_table(built_in_tables() / f"orca_{side}.toml")
    fingers = load_hand("orca_v2", side)
    hand = with_wrist_joints(fingers)
    bound = BoundMap(table, hand)
    assert bound.determined.all()
    low, high = hand.limits.T
    for q in (low, high):  # our model's ends are the maker's
        commands = bound.commands(bound.angles(hand.full_configuration(q)))
        assert commands == pytest.approx(bound.clip(commands), abs=0.1)
    q = fingers.full_configuration(fingers.limits[:, 0])
    without = BoundMap(table, fingers)  # the wrist's motor holds it straight
    held = without.commands(without.angles(q))
    assert held[table.names.index("wrist")] == 0.0
    assert without.joints(held) == pytest.approx(q)
    assert without.determined.shape == q.shape


def test_without_orca_core_the_extra_is_named(hand, monkeypatch):
    monkeypatch.setitem(sys.modules, "orca_core", None)
    with pytest.raises(MissingExtraError, match="orca"):
        OrcaSink().open({"right": hand}, {})


def test_the_makers_mock_boots_approaches_and_is_read_back(hand, capsys, closing):
    pytest.importorskip("orca_core", reason="the extra orca (orca-core) is not installed")
    sink = build_sink("orca:mock=true,approach=5")
    sink.open({"right": hand}, {})
    closing(sink)
    state = sink.state("right")
    assert state is not None
    q = hand.full_configuration(hand.neutral)
    tick = replace(make_tick(hand), command=JointCommand(q, hand.joint_names))
    until(lambda: sink.send(tick) or "approaches" not in sink.note)

    def error() -> float:
        now = sink.state("right")
        return 9.0 if now is None else float(np.abs(now.positions - q).max())

    until(lambda: sink.send(tick) or error() < 0.01)
    assert sink.figures["wrong_answers"] == 0
    until(lambda: "it rests" in sink.note)
    assert capsys.readouterr().out == ""  # what the makers' library says is no result


class _Hand:
    """The part of a hand of orca-core that the driver uses, with the current of its motors [mA]."""

    last_read_ok, calibrated, absent_joints = True, True, ()

    def __init__(self, names: tuple[str, ...]) -> None:
        wired = {name: k + 1 for k, name in enumerate(names)}
        self.config = types.SimpleNamespace(
            joint_ids=list(names),
            motor_ids=list(wired.values()),
            joint_to_motor_map=wired,
            max_current=400.0,
        )
        self.current = 1750.0
        self.at_power: list[float] = []

    def connect(self, interactive: bool) -> tuple[bool, str]:
        return True, "connected"

    def init_joints(self, move_to_neutral: bool) -> None:
        self.current = self.config.max_current

    def set_max_current(self, current: float) -> None:
        self.current = current

    def enable_torque(self) -> list[int]:
        self.at_power.append(self.current)
        return []

    def disable_torque(self) -> None:
        pass

    def set_joint_positions(self, pose: dict[str, float]) -> None:
        pass

    def disconnect(self) -> None:
        pass


@pytest.fixture
def orca(monkeypatch) -> _Hand:
    """The hand of a stand-in for orca-core."""
    hand = _Hand(table("orca_right").names)
    core = types.ModuleType("orca_core")
    core.load_hand = lambda **_: hand
    monkeypatch.setitem(sys.modules, "orca_core", core)
    return hand


def test_a_hand_that_is_not_calibrated_is_refused(orca):
    orca.calibrated = False
    with pytest.raises(SinkError, match="is not calibrated"):
        OrcaSink().device(table("orca_right")).open()


@pytest.mark.parametrize(("limit", "current"), [(150.0, 150.0), (None, 400.0)])
def test_the_limit_is_back_before_torque_that_was_off(orca, limit, current):
    actuators = table("orca_right")
    first = replace(actuators.actuators[0], limit=limit)
    limited = replace(actuators, limit=None, actuators=(first, *actuators.actuators[1:]))
    device = OrcaSink().device(limited)
    device.open()
    commands = np.zeros(len(limited.names))
    device.write(commands)
    device.relax()
    orca.current = 1750.0  # as a motor that restarted has it
    device.write(commands)
    assert orca.at_power == [current, current]
    device.close()
