"""``smooth-operator hardware``: list, monitor, and the dialogue that writes a table."""

import json
import os
import signal
import threading
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from fake_hand import FakeHand, FakeHandSink, write_fake_table
from live_time import until

from smooth_operator.cli import main
from smooth_operator.errors import SinkError
from smooth_operator_devices.hands.actuator_map import ActuatorMap, read_table
from smooth_operator_devices.hands.device import Reading
from smooth_operator_devices.hands.table_check import ActuatorMover, TableCheck


@pytest.fixture(autouse=True)
def quick_contact(monkeypatch) -> None:
    monkeypatch.setattr("smooth_operator_devices.hands.table_check._BLOCKED_S", 0.01)


@pytest.fixture
def table(tmp_path, hand) -> ActuatorMap:
    path = write_fake_table(tmp_path / "fake_right.toml", hand.actuated_names[:2], "rate = 500\n")
    return read_table(path)


def answers(*given: str) -> tuple[Callable[[str], str], list[str]]:
    """A person who answers in turn, and what was asked."""
    waiting, asked = list(given), []

    def ask(question: str) -> str:
        asked.append(question)
        return waiting.pop(0)

    return ask, asked


def test_the_dialogue_finds_joint_ends_and_sense(table, hand):
    fake = FakeHand(table)
    fake.blocked[0] = 215.0
    other = hand.actuated_names[5]
    ask, asked = answers(
        *("a", "elbow", other),  # see it again, a name that is none, the right one
        *("4", "e"),  # the least command: four steps of 6 degrees, and that is the end
        *("3", "", "", ""),  # the greatest: blocked at 215 in the sixth step
        *("40", "-30"),  # its angles there: it runs the other way
        *("", "k", "k", "", "", ""),
    )
    said: list[str] = []
    with ActuatorMover(fake, table, seconds=0.05) as mover:
        made = TableCheck(mover, hand, ask, said.append).run(table)
    first, second = made.actuators
    assert first.joints == {other: 1.0}
    assert first.ends[0] == pytest.approx(156.0)
    assert first.ends[1] == pytest.approx(212.0)  # half a step before the obstacle
    assert first.command(np.deg2rad(40.0)) == pytest.approx(156.0)
    assert first.command(np.deg2rad(-30.0)) == pytest.approx(212.0)
    assert second == table.actuators[1]
    assert any("it is blocked" in line for line in said)
    assert any(line.startswith("the joints of mimic_p050 are") for line in said)
    assert "2 of 2" in made.source
    assert fake.calls[-2][0] == "relax"
    moved = fake.commands()
    assert (np.abs(np.diff(moved, axis=0)).max(axis=1) <= 120.0 / 0.05 / 500 + 1e-9).all()
    assert ((np.abs(np.diff(moved, axis=0)) > 1e-9).sum(axis=1) <= 1).all()  # one at a time
    assert not any("Ctrl" in question for question in asked)


def test_the_last_command_ends_the_question(table, hand):
    ask, _ = answers("", "40", "40", "", "", "s")
    said: list[str] = []
    with ActuatorMover(FakeHand(table), table, seconds=0.02) as mover:
        made = TableCheck(mover, hand, ask, said.append).run(table)
    assert made.actuators[0].ends == table.actuators[0].ends
    assert sum("is reached and is used as the end" in line for line in said) == 2


@pytest.mark.parametrize("given", [("q",), ("s", "s"), ("", "q"), ("", "k", "q")])
def test_nothing_confirmed_is_no_table(table, hand, given):
    ask, _ = answers(*given)
    with ActuatorMover(FakeHand(table), table, seconds=0.05) as mover:
        assert TableCheck(mover, hand, ask, lambda _: None).run(table) is None


def test_one_wrong_reading_moves_no_actuator(table, monkeypatch):
    fake = FakeHand(table)
    read, wild = fake.read, [240.0]

    def once_wrong() -> Reading:
        reading = read()
        return replace(reading, positions=np.array([wild.pop(), 180.0])) if wild else reading

    monkeypatch.setattr(fake, "read", once_wrong)
    with ActuatorMover(fake, table, seconds=0.05):
        until(lambda: fake.count("write") > 5)
    assert (fake.commands() == 180.0).all()


def test_an_actuator_goes_on_from_where_it_is_after_answers_that_are_missing(table):
    fake = FakeHand(table)
    with ActuatorMover(fake, table, seconds=0.5) as mover:
        move = threading.Thread(target=mover.move, args=(0, 230.0))
        move.start()
        until(lambda: fake.positions[0] > 190.0)
        fake.wrong = missing = 10**6
        until(lambda: fake.wrong < missing - 5)
        fake.positions[0] = 170.0  # it fell meanwhile
        fake.wrong = 0
        move.join()
    written = fake.commands()
    steps = np.diff(written[:, 0])
    assert written[-1, 0] == 230.0
    assert steps.max() <= 120.0 / 0.5 / 500 + 1e-9
    assert (steps < -15.0).sum() == 1  # to where it fell, and on from there


def test_ctrl_c_and_a_lost_hand_relax_and_close(table, hand, monkeypatch):
    fake = FakeHand(table)

    def interrupted(_: str) -> str:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt), ActuatorMover(fake, table, seconds=0.05) as mover:
        TableCheck(mover, hand, interrupted, lambda _: None).run(table)
    assert [what for what, _ in fake.calls[-2:]] == ["relax", "close"]
    fake.gone.set()
    with pytest.raises(SinkError, match="the cable was pulled"):
        ActuatorMover(fake, table)
    fake.gone.clear()
    with monkeypatch.context() as patch:
        patch.setattr(fake, "open", lambda: interrupted(""))
        with pytest.raises(KeyboardInterrupt):
            ActuatorMover(fake, table)
    assert fake.calls[-1][0] == "close"
    with ActuatorMover(fake, table, seconds=0.05) as mover:
        fake.gone.set()
        with pytest.raises(SinkError, match="the hand was lost: the cable was pulled"):
            mover.move(0, 200.0)


def test_a_lost_limit_ends_a_check(table, monkeypatch):
    monkeypatch.setattr("smooth_operator_devices.hands.device._EVERY_S", 0.02)
    fake = FakeHand(table)
    with ActuatorMover(fake, table) as mover:
        until(lambda: fake.count("settings") > 2)
        fake.limit = 900.0
        with pytest.raises(SinkError, match="the hand restarted: limit"):
            until(lambda: mover.reading is None)


@pytest.mark.skipif(os.name == "nt", reason="Windows has no SIGINT to send to one process")
def test_a_second_ctrl_c_does_not_leave_the_hand_powered(table):
    fake = FakeHand(table)
    mover = ActuatorMover(fake, table, seconds=0.05).__enter__()
    fake.slow_s = 0.3  # so that the hand is not relaxed yet when the second one comes
    threading.Timer(0.1, os.kill, (os.getpid(), signal.SIGINT)).start()
    mover.__exit__(KeyboardInterrupt, KeyboardInterrupt(), None)
    assert [what for what, _ in fake.calls[-2:]] == ["relax", "close"]


@pytest.mark.parametrize(("current", "free"), [(380.0, True), (420.0, False)])
def test_a_check_stops_at_four_fifths_of_the_limit(table, current, free):
    fake = FakeHand(table)
    fake.blocked[0], fake.stall = 200.0, current  # of 500 mA
    with ActuatorMover(fake, table, seconds=0.05) as mover:
        assert mover.move(0, 230.0) == free


@pytest.fixture
def device(tmp_path, hand, monkeypatch) -> tuple[str, list[FakeHand]]:
    """A sink as a user names it, and the hands that it made."""
    monkeypatch.setenv("SMOOTH_OPERATOR_HANDS", str(tmp_path / "hands"))
    path = write_fake_table(tmp_path / "t.toml", hand.actuated_names, "rate = 500\n")
    made: list[FakeHand] = []
    real = FakeHandSink.device

    def kept(self: FakeHandSink, actuators: ActuatorMap) -> FakeHand:
        made.append(real(self, actuators))
        return made[-1]

    monkeypatch.setattr(FakeHandSink, "device", kept)
    return f"fake_hand:FakeHandSink,table={path},port={tmp_path}/p", made


def test_the_list_names_drivers_tables_and_folder(capsys, tmp_path, monkeypatch):
    monkeypatch.setenv("SMOOTH_OPERATOR_HANDS", str(tmp_path))
    (tmp_path / "hardware").mkdir()
    (tmp_path / "hardware" / "odd_right.toml").write_text("format = 1\n")
    assert main(["hardware", "list", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert {"leap", "orca", "dynamixel"} <= found["drivers"].keys()
    assert found["tables"]["leap_right"]["actuators"] == 16
    assert "odd_right.toml" in found["unreadable"][0]
    assert "no driver has moved a physical hand" in found["tried"]
    assert main(["hardware", "list"]) == 0
    printed = capsys.readouterr().out
    assert "orca_left" in printed
    assert found["tried"] in printed


def test_the_monitor_shows_the_hand_and_moves_nothing(capsys, device, hand):
    name, made = device
    common = ["hardware", "monitor", name, "--hand", "mimic_p050", "--seconds"]
    assert main([*common, "0.1", "--json"]) == 0
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert lines
    assert set(lines[0]["joints"]) == set(hand.joint_names)
    assert len({line["time"] for line in lines}) == len(lines)
    assert main([*common, "0.05"]) == 0
    assert "waiting for the first command" in capsys.readouterr().out
    assert not any(fake.count("write") for fake in made)
    assert main(["hardware", "monitor", "mujoco"]) == 2
    assert "is not a real hand" in capsys.readouterr().err


def test_the_check_writes_the_users_table(capsys, device, tmp_path, monkeypatch):
    name, _ = device
    replies = iter(["", "k", "k", "", "", "q"])
    monkeypatch.setattr("builtins.input", lambda _: next(replies))
    monkeypatch.setattr(ActuatorMover.__init__, "__defaults__", (0.05,))  # a quick check
    assert main(["hardware", "check", name, "--hand", "mimic_p050"]) == 0
    written = tmp_path / "hands" / "hardware" / "fake_right.toml"
    assert str(written) in capsys.readouterr().out.replace("\n", "")
    assert read_table(written).source.startswith("smooth-operator hardware check: 1 of 16")
    monkeypatch.setattr("builtins.input", lambda _: "q")
    output = tmp_path / "new.toml"
    assert main(["hardware", "check", name, "--hand", "mimic_p050", "--output", str(output)]) == 0
    assert not output.exists()
    assert main(["hardware", "check", "leap", "--ids", "x", "--hand", "leap_hand"]) == 2
    assert "--ids must be numbers" in capsys.readouterr().err
