"""Tables of real hands: monotonic maps, their inverse, what is refused and in which words."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from fake_hand import write_fake_table
from hypothesis import given, settings
from hypothesis import strategies as st

from smooth_operator.errors import ConfigError, UnknownNameError
from smooth_operator.hands.registry import load_hand
from smooth_operator_devices.hands.actuator_map import (
    Actuator,
    ActuatorMap,
    BoundMap,
    built_in_tables,
    find_table,
    read_table,
    write_table,
)
from smooth_operator_devices.hands.device import Reading
from smooth_operator_devices.hands.guard import CommandGuard, GuardSettings


def table_of(*actuators: Actuator, **more: object) -> ActuatorMap:
    return ActuatorMap("fake", "mimic_p050", "right", "deg", actuators, **more)


@settings(deadline=None, max_examples=50)
@given(
    st.lists(st.floats(0.01, 1.0), min_size=1, max_size=5),
    st.lists(st.floats(1.0, 500.0), min_size=5, max_size=5),
    st.sampled_from((-1, 1)),
    st.floats(-3.0, 3.0),
)
def test_a_map_and_its_inverse_agree(steps, rises, sign, angle):
    angles = np.cumsum([-1.0, *steps])
    commands = sign * np.cumsum([10.0, *rises[: len(steps)]])
    points = tuple(zip(angles.tolist(), commands.tolist(), strict=True))
    actuator = Actuator("m", {"j": 1.0}, points, (-1e6, 1e6))
    assert actuator.angle(actuator.command(angle)) == pytest.approx(angle, abs=1e-6)
    assert sign * actuator.command(angle + 0.1) > sign * actuator.command(angle)


@pytest.mark.parametrize(
    ("points", "said"),
    [
        (((0.0, 0.0), (1.0, 10.0), (2.0, 5.0)), "its commands go from 10 to 5"),
        (((0.0, 9.0), (1.0, 1.0), (2.0, 5.0)), "its commands go from 1 to 5"),
        (((0.0, 0.0), (0.0, 10.0)), "its drive angles go from 0 to 0"),
        (((0.0, 7.0), (1.0, 7.0)), "its commands go from 7 to 7"),
        (((1.0, 0.0),), "two or more points"),
    ],
)
def test_a_map_that_is_not_monotonic_is_refused(points, said):
    with pytest.raises(ConfigError, match=said):
        Actuator("thumb", {"j": 1.0}, points, (0.0, 10.0))


def test_joints_that_share_an_actuator_and_a_differential(hand):
    a, b, c, d = hand.actuated_names[:4]
    line = ((-1.0, 0.0), (1.0, 1000.0))
    table = table_of(
        Actuator("sum", {a: 1.0, b: 1.0}, line, (0, 1000)),
        Actuator("difference", {a: 1.0, b: -1.0}, line, (0, 1000)),
        Actuator("both", {c: 0.5, d: 0.5}, line, (0, 1000)),
    )
    bound = BoundMap(table, hand)
    q = np.zeros(len(hand.joint_names))
    at = {name: hand.joint_names.index(name) for name in (a, b, c, d)}
    q[at[a]], q[at[b]], q[at[c]], q[at[d]] = 0.3, 0.1, 0.5, 0.1
    angles = bound.angles(q)
    assert angles == pytest.approx([0.4, 0.2, 0.3])
    back = bound.joints(bound.commands(angles))
    assert back[[at[a], at[b]]] == pytest.approx([0.3, 0.1])
    assert back[[at[c], at[d]]] == pytest.approx([0.3, 0.3])  # the two can't be told apart
    assert np.isnan(back).sum() == (~bound.determined).sum() > 0  # joints without an actuator


def test_two_motors_with_cranks_move_two_joints(hand, tmp_path):
    a, b, c = hand.actuated_names[:3]
    line = ((-np.pi / 2, 0.0), (np.pi / 2, 1000.0))
    rows = ((0.02, 1.2, 0.2), (1.5, 0.1), (-0.2,))
    other = ((-0.01, -1.3, 0.1), (1.6, 0.0), (0.1,))
    table = table_of(
        Actuator("left", {a: 1.0, b: 1.0}, line, (0, 1000), crank=rows),
        Actuator("right", {a: 1.0, b: 1.0}, line, (0, 1000), crank=other),
        Actuator("plain", {c: 2.0}, line, (0, 1000)),
    )
    write_table(table, tmp_path / "cranks.toml")
    bound = BoundMap(read_table(tmp_path / "cranks.toml"), hand)
    q = np.zeros(len(hand.joint_names))
    at = [hand.joint_names.index(name) for name in (a, b, c)]
    q[at] = 0.2, 0.3, 0.4
    sine = 0.02 + 1.2 * 0.3 + 0.2 * 0.09 + 0.2 * (1.5 + 0.1 * 0.3) - 0.2 * 0.04
    assert bound.angles(q)[[0, 2]] == pytest.approx([np.arcsin(sine), 0.8])
    commands = bound.commands(bound.angles(q))
    assert bound.joints(commands)[at] == pytest.approx(q[at])
    rates = np.array([20.0, -10.0, 5.0])
    ahead = bound.joints(commands + 1e-4 * rates)
    speeds = (ahead - bound.joints(commands)) / 1e-4
    assert bound.joint_velocities(commands, rates)[at] == pytest.approx(speeds[at], rel=1e-2)
    q[at[0]] = 3.0  # out of reach: the crank is at its dead centre
    assert bound.angles(q)[0] == pytest.approx(np.pi / 2)
    with pytest.raises(ConfigError, match="a crank needs two joints without weights"):
        Actuator("left", {a: 1.0}, line, (0, 1000), crank=rows)


def test_coupled_joints_and_missing_answers_in_read_back(hand):
    line = ((-2.0, 0.0), (2.0, 1000.0))
    names = hand.actuated_names
    table = table_of(*(Actuator(name, {name: 1.0}, line, (0, 1000)) for name in names))
    bound = BoundMap(table, hand)
    q = hand.full_configuration(hand.neutral + 0.05)
    commands = bound.commands(bound.angles(q))
    assert bound.joints(commands) == pytest.approx(q)
    rates = np.ones(len(names))
    speed = 4.0 / 1000.0
    assert bound.joint_velocities(commands, rates) == pytest.approx(
        hand.transmission.matrix @ np.full(len(names), speed), abs=1e-9
    )
    coupling = hand.couplings[0]
    commands[names.index(coupling.follows)] = np.nan
    lost = np.isnan(bound.joints(commands))
    assert {hand.joint_names[k] for k in np.flatnonzero(lost)} == {
        coupling.follows,
        *(c.joint for c in hand.couplings if c.follows == coupling.follows),
    }


def test_a_table_for_another_hand_is_refused(hand):
    table = table_of(Actuator("m", {"elbow": 1.0}, ((0, 0), (1, 1)), (0, 1)))
    with pytest.raises(UnknownNameError, match=r"elbow.*--hand"):
        BoundMap(table, hand)
    with pytest.raises(ConfigError, match="the table of the hand 'mimic_p050', but the run"):
        BoundMap(table, load_hand("leap_hand"))


def test_a_table_is_written_and_read_back(tmp_path):
    table = table_of(
        Actuator("a", {"j": 1.0}, ((0.0, 10.0), (0.5, 20.0), (1.0, 90.0)), (5.0, 95.0), 3, 200.0),
        Actuator('say "b" ö', {"x": 0.5, "a.b": 0.5}, ((-1.0, 9.0), (1.0, -9.0)), (-9, 9), None),
        limit=300.0,
        on_silence="relax",
        settings={"gains": {"p": 600}, "baud": 57600},
        source="measured",
    )
    write_table(table, tmp_path / "new" / "fake_right.toml", "written by a test")
    found = read_table(tmp_path / "new" / "fake_right.toml")
    assert found.actuators == table.actuators
    assert (found.limit, found.on_silence, found.settings) == (300.0, "relax", table.settings)
    assert found.limits.tolist() == [200.0, 300.0]


def test_a_table_has_the_entries_of_its_base_where_it_has_none(tmp_path):
    path = tmp_path / "weak_left.toml"
    path.write_text(
        "format = 1\nbase = 'ability_right.toml'\nside = 'left'\nlimit = 200\n"
        "[[actuators]]\nname = 'middle'\nlimit = 100\n"
    )
    table, base = read_table(path), read_table(built_in_tables() / "ability_right.toml")
    assert (table.side, table.limit, table.file) == ("left", 200.0, str(path))
    assert (table.driver, table.unit, table.source) == (base.driver, base.unit, base.source)
    for own, other in zip(table.actuators, base.actuators, strict=True):
        assert own == replace(other, limit=100.0 if other.name == "middle" else other.limit)
    (tmp_path / "ability_right.toml").write_text("format = 1\n")  # a neighbour goes first
    with pytest.raises(ConfigError, match=r"ability_right\.toml: actuators: is missing"):
        read_table(path)
    path.write_text("format = 1\nbase = 'ability_left.toml'\n")
    with pytest.raises(ConfigError, match=r"weak_left\.toml: base: .* has a base itself"):
        read_table(path)
    path.write_text("format = 1\nbase = 'nothing.toml'\n")
    with pytest.raises(ConfigError, match=r"no table at .*nothing\.toml"):
        read_table(path)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("format = 1", "unit: is missing"),
        ("format = 2\n", "expected 1, not 2"),
        ("[[actuators]]\nname='a'\njoint='j'\nzero=1\nsign=2\nends=[0,1]", "expected 1 or -1"),
        ("[[actuators]]\nname='a'\njoint='j'\nzero=1\n", "ends: is missing"),
        ("[[actuators]]\nname='a'\njoint='j'\nends=[0,1]", "set either points, or zero"),
        ("[[actuators]]\nname='a'\njoint='j'\npoints=[[0,1],[1,0]]\nends=[1,0]", "minimum command"),
        ("[[actuators]]\nname='a'\njoint='j'\npoints=[[0,1],[1,2],[2,0]]", "is not monotonic"),
        ("[[actuators]]\nname='a'\njoint='j'\npoints=[[0,1],[1,'x']]", "a list of pairs"),
        ("[[actuators]]\nname='a'\npoints=[[0,1],[1,2]]", "set either joint, or joints"),
        ("[[actuators]]\nname='a'\njiont='j'\npoints=[[0,1],[1,2]]", "Did you mean 'joint'"),
        ("actuators = []", "has no actuator"),
        (
            "[[actuators]]\nname='a'\nid=1\njoint='j'\npoints=[[0,1],[1,2]]\n"
            "[[actuators]]\nname='b'\nid=1\njoint='k'\npoints=[[0,1],[1,2]]",
            "two actuators have the id 1",
        ),
    ],
)
def test_bad_tables_are_refused_in_one_sentence(tmp_path, text, said):
    head = "format = 1\ndriver='fake'\nhand='h'\nside='right'\nunit='deg'\n"
    path = tmp_path / "x.toml"
    path.write_text(text if text.startswith("format") else head + text)
    with pytest.raises(ConfigError, match=said) as caught:
        read_table(path)
    assert str(path) in str(caught.value)


def test_a_users_table_goes_before_the_built_in_one(tmp_path, monkeypatch):
    monkeypatch.setenv("SMOOTH_OPERATOR_HANDS", str(tmp_path))
    with pytest.raises(ConfigError, match="there is no table fake_right"):
        find_table("", "fake", "right")
    folder = tmp_path / "hardware"
    folder.mkdir()
    (folder / "fake_right.toml").write_text("")
    assert find_table("", "fake", "right") == folder / "fake_right.toml"
    assert find_table("~/x.toml", "fake", "right") == Path("~/x.toml").expanduser()


PERIOD = 0.01
MARGIN = np.rad2deg(0.1)
"""Distance of a command beyond the place of a contact [degrees]."""


class Play:
    """A guard of one actuator, in degrees: 180 at zero, ends 120 and 240, at most 500 mA."""

    def __init__(self, folder: Path, start: float = 180.0, **settings: float) -> None:
        self._hand = load_hand("mimic_p050")
        table = write_fake_table(folder / "fake_right.toml", self._hand.actuated_names[:1])
        bound = BoundMap(read_table(table), self._hand)
        self.guard = CommandGuard(
            bound, GuardSettings(**{"approach": 50.0, "speed": 50.0, **settings})
        )
        self.guard.start(Reading(np.array([start])))

    def step(self, wanted: float, at: float, current: float = 0.0) -> float:
        """The command where this is asked for, and the actuator is there and pulls so."""
        joints = np.zeros(len(self._hand.actuated))
        joints[0] = np.deg2rad(wanted - 180.0)
        reading = Reading(np.array([at]), None, np.array([current]))
        return float(self.guard.step(self._hand.full_configuration(joints), reading, PERIOD)[0])

    @property
    def squeezes(self) -> bool:
        return bool(self.guard.squeezing[0])


def test_no_step_is_faster_than_the_speed_nor_on_the_way_there_than_the_approach(tmp_path):
    play, commands = Play(tmp_path, approach=1.0, speed=3.0), [180.0]
    for wanted in [200.0] * 100 + [160.0] * 100:
        commands.append(play.step(wanted, commands[-1]))
    steps = np.abs(np.diff(commands))
    assert steps[:30].max() == pytest.approx(np.rad2deg(1.0) * PERIOD)
    assert steps[100:].max() == pytest.approx(np.rad2deg(3.0) * PERIOD)
    assert commands[-1] == pytest.approx(160.0)


@pytest.mark.parametrize(("start", "back"), [(110.0, 120.0), (250.0, 240.0)])
def test_a_way_beyond_an_end_is_closed_behind_a_hand_that_comes_in(tmp_path, start, back):
    play = Play(tmp_path, start, approach=1.0)
    first = [play.step(180.0, start) for _ in range(5)]
    assert abs(first[-1] - back) < abs(first[0] - back) < abs(start - back)
    while first[-1] != pytest.approx(180.0):
        first.append(play.step(180.0, first[-1]))
    pushed = back + 0.8 * (start - back)  # something holds it beyond the end
    for _ in range(60):
        command = play.step(180.0, pushed, 450.0)
    assert play.squeezes
    assert command == back  # and not near to where it is held


def test_contact_is_a_high_current_for_contact_s_without_motion(tmp_path):
    play = Play(tmp_path, contact=0.8, contact_s=0.2)
    play.step(230.0, 195.0, 450.0)
    for _ in range(19):
        play.step(230.0, 195.0, 450.0)
        assert not play.squeezes
    for _ in range(2):  # 0.2 s, and what sums lose
        command = play.step(230.0, 195.0, 450.0)
    assert play.squeezes
    assert command == pytest.approx(195.0 + MARGIN)


@pytest.mark.parametrize(("speed", "contact"), [(0.2, True), (0.4, False)])
def test_an_actuator_that_moves_as_it_pulls_has_no_contact(tmp_path, speed, contact):
    play = Play(tmp_path, 180.0, contact=0.8)
    for k in range(60):
        play.step(239.0, 180.0 + np.rad2deg(speed) * PERIOD * k, 450.0)
    assert play.squeezes == contact


def test_a_current_below_the_share_of_the_limit_is_no_contact(tmp_path):
    play = Play(tmp_path, contact=0.8)
    for _ in range(60):
        play.step(230.0, 195.0, 390.0)
    assert not play.squeezes


@pytest.mark.parametrize(("yields", "gone"), [(1.3, False), (1.7, True)])
def test_an_object_is_gone_once_the_finger_is_well_beyond_it(tmp_path, yields, gone):
    play = Play(tmp_path, 195.0, approach=1.0)
    for _ in range(30):
        play.step(230.0, 195.0, 450.0)
    assert play.squeezes
    at = 195.0 + yields * MARGIN
    path = [play.step(230.0, at) for _ in range(5)]
    assert play.squeezes == (not gone)
    assert np.diff(path) == pytest.approx(np.rad2deg(1.0) * PERIOD if gone else 0.0)  # slowly
