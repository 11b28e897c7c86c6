"""All drivers of real hands on simulators of their wire protocols: one set of tests for each."""

import struct
import time
from dataclasses import replace

import numpy as np
import pytest
from driven_hands import Driven, quiet, within
from hand_rigs import RIGS, Rig
from live_time import until

from smooth_operator import Hand, load_hand
from smooth_operator.cli import main
from smooth_operator.errors import ConfigError, SinkError
from smooth_operator.hands.registry import hand_names
from smooth_operator.hands.wrist_joints import with_wrist_joints
from smooth_operator.teleop.sinks.tick import Mode
from smooth_operator_devices.hands.actuator_map import (
    ActuatorMap,
    BoundMap,
    built_in_tables,
    read_table,
)
from smooth_operator_devices.hands.device import HandDevice, SettingsWatch, WrongAnswerError
from smooth_operator_devices.hands.drivers.linker import LinkerSink

pytest_plugins = ["hand_rig_fixtures"]

BUSES = [
    name for name in RIGS if name not in ("inspire-touch", "linker-l10", "linker-o6", "rohand-gen1")
]
"""Rigs without further models of a hand that speak on the bus as another one does."""
ON_EACH_BUS = pytest.mark.parametrize("rig", BUSES, indirect=True)
WITH_EACH = pytest.mark.parametrize("rig", list(RIGS), indirect=True)
TABLES = sorted(path.stem for path in built_in_tables().glob("*.toml"))


@pytest.mark.parametrize("hand", ["linker_l10", "linker_l20"])
def test_a_driver_of_several_models_takes_the_table_of_the_runs_hand(hand):
    assert LinkerSink().actuators("right", hand).hand == hand
    assert LinkerSink(model="l20").actuators("right", hand).hand == "linker_l20"
    with pytest.raises(ConfigError, match=r"is the table of the hand 'linker_l20'"):
        BoundMap(LinkerSink(model="l20").actuators("right"), load_hand("leap_hand"))


@pytest.mark.parametrize("name", TABLES)
def test_a_table_fits_its_hand(name):
    table = read_table(built_in_tables() / f"{name}.toml")
    assert name == f"{name.rsplit('_', 1)[0]}_{table.side}"
    assert table.source
    joints = [joint for actuator in table.actuators for joint in actuator.joints]
    assert len(joints) >= len(table.actuators)
    if table.hand in hand_names():  # the others are added by the user, from the maker's model
        fits(table, load_hand(table.hand, side=table.side))


@pytest.mark.shared
@pytest.mark.parametrize(
    ("name", "model"),
    [
        ("linker_o6_right", "linkerhand_o6/linker_hand_l6_right/linkerhand_o6_right.urdf"),
        ("linker_l21_right", "linkerhand_l21/right/linkerhand_l21_right.urdf"),
        ("hx5_d20_right", "hx5_d20/urdf/hx5_d20_right.urdf"),
        ("inspire_ftp_right", "inspire_rh56_ftp/inspire_hand/FTP_right_hand.urdf"),
    ],
)
def test_a_table_fits_the_model_of_the_maker(name, model, shared, tmp_path, monkeypatch):
    monkeypatch.setenv("SMOOTH_OPERATOR_HANDS", str(tmp_path))
    table = read_table(built_in_tables() / f"{name}.toml")
    path = str(shared / "hands_new" / model)
    assert main(["hands", "add", path, "--name", "maker", "--side", "right", "--json"]) == 0
    fits(table, load_hand("maker", side="right"))


def fits(table: ActuatorMap, hand: Hand) -> None:
    """Check that the table's actuators move all joints of the hand."""
    hand = with_wrist_joints(hand)
    bound = BoundMap(table, hand)
    # every joint that the hand's motors move is moved by an actuator of the table
    assert bound.determined.all(), [
        n for n, k in zip(hand.joint_names, bound.determined, strict=True) if not k
    ]
    # and the way to the actuators and back is the same place
    for share in (0.0, 0.3, 1.0):
        commands = within(table, share)
        back = bound.commands(bound.angles(bound.joints(commands)))
        assert back == pytest.approx(commands, abs=1e-4)


@WITH_EACH
def test_opening_moves_nothing_and_reads_where_the_hand_is(rig):
    before = rig.positions()
    device = rig.open()
    reading = device.read()
    assert reading.positions == pytest.approx(before, abs=rig.unit)
    assert reading.errors == ()
    assert not rig.sent
    device.close()
    device.close()  # a second call does nothing
    assert rig.positions() == pytest.approx(before, abs=rig.unit)


@WITH_EACH
def test_it_goes_where_it_is_told_and_reads_it_back(rig):
    with Driven(rig) as driven:
        wanted = driven.ask(0.4)
        until(lambda: rig.near(wanted))
        wished = driven.bound.joints(wanted)

        def read_back() -> bool:
            state = driven.sink.state("right")
            if state is None:
                return False
            joints = np.nan_to_num(state.positions)  # a joint without an actuator is NaN
            measured = driven.bound.commands(driven.bound.angles(joints))
            return bool(np.abs(measured - wanted).max() <= 2 * rig.unit)

        until(read_back)
        state = driven.sink.state("right")
        assert state is not None
        assert np.isfinite(wished[driven.bound.determined]).all()
        # a wish far beyond every joint never leaves the ends
        driven.ask_joints(np.full(len(driven.hand.joint_names), 9.0))
        until(lambda: np.abs(rig.positions() - wanted).max() > 5 * rig.unit)
        driven.ask_joints(np.full(len(driven.hand.joint_names), -9.0))
        time.sleep(0.02)
    assert rig.outside() == 0


@ON_EACH_BUS
def test_a_stop_holds_the_hand_on_its_way(rig):
    with Driven(rig) as driven:
        start = rig.positions()
        rig.slow()
        goal = driven.ask(0.6)
        until(lambda: np.abs(rig.positions() - start).max() > 3 * rig.unit)
        driven.tick = replace(driven.tick, mode=Mode.STOPPED)
        until(lambda: "emergency stop" in driven.sink.note)
        last = rig.positions()

        def stands() -> bool:
            nonlocal last
            cycles = driven.statistics()["cycles"]
            until(lambda: driven.statistics()["cycles"] > cycles + 1)
            before, last = last, rig.positions()
            return bool(np.abs(last - before).max() < 0.1 * rig.unit)

        until(stands)
        assert np.abs(last - goal).max() > 3 * rig.unit
    assert rig.outside() == 0


@ON_EACH_BUS
def test_relaxing_is_taken_by_every_hand(rig):
    device = rig.open()
    device.write(device.read().positions)
    if rig.powered() is None:  # it can't: then nothing is sent
        device.read()  # the hand answers when it has its command
        sent = len(rig.sent)
        device.relax()
        device.read()
        assert len(rig.sent) == sent
    else:
        until(rig.powered)
        device.relax()
        until(lambda: not rig.powered())


@ON_EACH_BUS
def test_a_hand_lost_in_motion_comes_back(rig):
    rig.patience(0.5)
    with Driven(rig, lost_s=1.0) as driven:
        driven.ask(0.2)
        until(lambda: driven.statistics()["cycles"] > 3)
        before = driven.statistics()["device_lost"]  # on a starved machine it was late before
        rig.lose()
        until(lambda: driven.statistics()["device_lost"] > before)
        assert driven.sink.state("right") is None
        assert "retrying" in driven.sink.note
        rig.back()
        wanted = driven.ask(0.5)
        until(lambda: driven.sink.state("right") is not None and rig.near(wanted))
    assert rig.outside() == 0


@pytest.mark.parametrize("seconds", [0.1, pytest.param(0.4, marks=pytest.mark.weekly)])
@pytest.mark.parametrize(
    "rig", [name for name in BUSES if not name.startswith("allegro")], indirect=True
)
def test_after_an_outage_the_first_command_is_where_the_hand_is(rig, seconds):
    """The operator goes on meanwhile, over half of the range."""
    rig.patience(0.2)
    sent: list[tuple[np.ndarray, np.ndarray]] = []
    rig.watch_targets(lambda target, at: sent.append((target, at)))
    with Driven(rig, lost_s=60.0, approach=2.0, speed=15.0) as driven:
        wanted = driven.ask(0.2)
        until(lambda: rig.near(wanted))
        wrong = driven.statistics()["wrong_answers"]
        rig.faults.silent = True
        until(lambda: driven.statistics()["wrong_answers"] > wrong)
        wanted = driven.ask(0.7)
        time.sleep(seconds)
        before = len(sent)
        rig.faults.silent = False
        until(lambda: len(sent) > before)
        angles = [driven.bound.drive_angles(row) for row in sent[before]]
    assert np.nanmax(np.abs(angles[0] - angles[1])) < 0.05  # a frame of a LinkerHand has not all


@pytest.mark.parametrize("rig", ["inspire", "inspire-rtu"], indirect=True)
@pytest.mark.parametrize("words", [[0xFFFF] * 6, [1000, 0xFFFF, 1000, 1000, 1000, 1000]])
def test_a_stop_while_an_inspire_hand_has_no_angles(rig, monkeypatch, words):
    """0xFFFF, -1, is no angle: taken for one, the stop would close an open hand."""
    with Driven(rig, lost_s=60.0) as driven:
        wanted = driven.ask(0.8)
        until(lambda: rig.near(wanted))
        with monkeypatch.context() as patch:
            answer, angles = rig.hand.answer, (1546).to_bytes(2)
            patch.setattr(
                rig.hand,
                "answer",
                lambda function, body: (
                    struct.pack(">BB6H", 3, 12, *words)
                    if (function, body[:2]) == (3, angles)
                    else answer(function, body)
                ),
            )
            wrong = driven.statistics()["wrong_answers"]
            driven.tick = replace(driven.tick, mode=Mode.STOPPED)
            until(lambda: driven.statistics()["wrong_answers"] > wrong + 3)
            assert rig.near(wanted)
        cycles = driven.statistics()["cycles"]
        until(lambda: driven.statistics()["cycles"] > cycles + 5)
    assert rig.near(wanted)


WITHOUT_LIMITS = (
    *("ability", "aero", "allegro-v4", "allegro-v5", "dex3", "dexhand021"),
    *("feetech-scs", "revo3", "xhand"),
)
"""Hands in which the driver sets nothing that a restart loses and that it can read back."""
WITH_LIMITS = [name for name in RIGS if name not in WITHOUT_LIMITS]


@pytest.mark.parametrize("rig", [*WITH_LIMITS, "allegro-v5", "allegro-v4", "aero"], indirect=True)
def test_a_hand_that_restarts_in_motion_is_lost_and_limited_again(rig, monkeypatch):
    readings: list[float] = []
    look = SettingsWatch.look

    def counted(watch: SettingsWatch) -> None:
        look(watch)
        readings.append(time.perf_counter())

    monkeypatch.setattr("smooth_operator_devices.hands.device._EVERY_S", 0.0)
    monkeypatch.setattr(SettingsWatch, "look", counted)
    if rig.reports:
        rig.patience(0.2)
    with Driven(rig, **LIMITED.get(rig.driver, {})) as driven:
        goal = driven.ask(0.3)
        until(lambda: rig.near(goal))
        limits, some = rig.limits(), len(readings) + 3
        until(lambda: len(readings) > some)
        before = driven.statistics()["device_lost"]
        rig.restart()
        assert rig.limits() != limits or not limits
        until(lambda: driven.statistics()["device_lost"] > before)
        goal = driven.ask(0.6)
        until(lambda: rig.near(goal))
        assert rig.limits() == limits
    assert rig.outside() == 0


LIMITED: dict[str, dict[str, object]] = {
    "linker": {"limit": 60.0},
    "wuji": {"limit": 300.0},
    "wuji2": {"limit": 300.0},
}


@pytest.mark.parametrize("rig", WITH_LIMITS, indirect=True)
def test_limits_are_back_before_a_hand_moves_again(rig):
    at_targets: list[list[float]] = []
    rig.watch_targets(lambda target, at: at_targets.append(rig.limits()))
    device = rig.open(**LIMITED.get(rig.driver, {}))
    start = device.read().positions
    device.write(start)
    device.read()
    limits = at_targets[-1]
    device.relax()
    device.read()  # it has received that, too
    rig.restart()
    assert rig.limits() != limits
    count = len(at_targets)
    device.write(start)
    device.read()
    assert len(at_targets) > count
    assert all(there == limits for there in at_targets[count:])


@WITH_EACH
def test_a_hand_in_which_the_driver_sets_nothing_has_nothing_to_lose(rig):
    device = rig.open()
    assert bool(device.settings()) == bool(rig.limits())


def right(rig: Rig, device: HandDevice) -> bool:
    """True for an answer with the positions of the hand, False for a wrong answer."""
    reading = quiet(device)
    assert reading is None or np.abs(reading.positions - rig.positions()).max() <= rig.unit
    return reading is not None


@pytest.mark.parametrize(
    ("rig", "kind"), [(name, kind) for name in BUSES for kind in RIGS[name].wrong], indirect=["rig"]
)
def test_wrong_answers_move_nothing_and_pass(rig, kind):
    rig.patience(0.2)
    device = rig.open()
    rig.faults.garbled = kind
    if rig.reports:  # what it reports by itself is dropped where it is damaged
        device.read()
    else:
        with pytest.raises(WrongAnswerError, match=f"^{rig.driver}" if rig.prefix else None):
            device.read()
    rig.faults.garbled = ""
    until(lambda: right(rig, device))
    assert not rig.sent


@pytest.mark.parametrize("rig", ["rohand", "aero", "feetech-scs", "feetech-sts"], indirect=True)
def test_another_program_on_the_line_changes_no_position(rig):
    device = rig.open()
    for _ in range(5):
        rig.line.second_program(rig.question)
        until(lambda: right(rig, device))


@ON_EACH_BUS
def test_a_table_with_another_number_of_actuators_is_refused(rig):
    sink = rig.build()
    table = sink.actuators("right")
    if sink.driver in ("leap", "feetech"):
        pytest.skip("a bank has as many servos as its table")
    with pytest.raises(ConfigError, match="actuators, not 1"):
        sink.device(replace(table, actuators=table.actuators[:1]))


@pytest.mark.parametrize("rig", [name for name in RIGS if RIGS[name].other], indirect=True)
def test_a_hand_of_the_other_side_is_refused(rig, rigs, request):
    rig.close()
    name = request.node.callspec.params["rig"]
    left = rigs(name, "left", patience=0.3)
    with pytest.raises(SinkError, match=rig.other):
        left.open(side="right")


@ON_EACH_BUS
def test_a_slow_bus_costs_the_loop_nothing(rig):
    with Driven(rig, lost_s=2.0) as driven:
        rig.faults.delay_s = 0.01
        driven.ask(0.3)
        cycles = driven.statistics()["cycles"]
        until(lambda: driven.statistics()["cycles"] > cycles + 2)
        assert driven.longest < 0.005  # of the processor; the bus takes tens of milliseconds
        rig.faults.delay_s = 0.0
    assert rig.outside() == 0


@ON_EACH_BUS
def test_nothing_on_the_wire_is_one_sentence(rig):
    rig.patience(0.1)
    rig.lose()
    with pytest.raises(SinkError) as caught:
        rig.open()
    text = str(caught.value)
    assert text.startswith(rig.driver) or not rig.prefix
    assert "check" in text
    assert "\n" not in text


@pytest.mark.parametrize(
    "rig",
    ["inspire", "inspire-touch", "allegro-v5", "ability", "leap", "feetech-sts", "feetech-scs"],
    indirect=True,
)
def test_a_blocked_motor_squeezes_no_further(rig):
    with Driven(rig) as driven:
        before = driven.ask(0.5)
        until(lambda: rig.near(before))
        rig.stick(1)
        driven.ask(0.9)
        name = driven.table.names[1]
        until(lambda: f"contact limit reached: {name}" in driven.sink.note)
    assert rig.outside() == 0
