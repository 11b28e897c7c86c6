"""The guard of a real hand's commands: speed, the ends of its table, and joints that squeeze."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from fake_hand import write_fake_table

from smooth_operator.hands.registry import load_hand
from smooth_operator.teleop.hardware.device import Reading
from smooth_operator.teleop.hardware.guard import CommandGuard, GuardSettings
from smooth_operator.teleop.hardware.table_file import read_table

PERIOD = 0.01
MARGIN = np.rad2deg(0.1)
"""How far a command stays beyond the place of a contact [degrees]."""


class Play:
    """A guard of one actuator, in degrees: 180 at zero, ends 120 and 240, at most 500 mA."""

    def __init__(self, folder: Path, start: float = 180.0, **settings: float) -> None:
        self._hand = load_hand("mimic_p050")
        table = write_fake_table(folder / "fake_right.toml", self._hand.actuated_names[:1])
        bound = read_table(table).bind(self._hand)
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


def test_no_step_is_faster_than_the_speed_nor_on_the_way_there_than_the_approach(
    tmp_path: Path,
) -> None:
    play, commands = Play(tmp_path, approach=1.0, speed=3.0), [180.0]
    for wanted in [200.0] * 100 + [160.0] * 100:
        commands.append(play.step(wanted, commands[-1]))
    steps = np.abs(np.diff(commands))
    assert steps[:30].max() == pytest.approx(np.rad2deg(1.0) * PERIOD)
    assert steps[100:].max() == pytest.approx(np.rad2deg(3.0) * PERIOD)
    assert commands[-1] == pytest.approx(160.0)


@pytest.mark.parametrize(("start", "back"), [(110.0, 120.0), (250.0, 240.0)])
def test_a_way_beyond_an_end_is_closed_behind_a_hand_that_comes_in(
    tmp_path: Path, start: float, back: float
) -> None:
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


def test_contact_is_a_high_current_for_contact_s_without_motion(tmp_path: Path) -> None:
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
def test_an_actuator_that_moves_as_it_pulls_has_no_contact(
    tmp_path: Path, speed: float, contact: bool
) -> None:
    play = Play(tmp_path, 180.0, contact=0.8)
    for k in range(60):
        play.step(239.0, 180.0 + np.rad2deg(speed) * PERIOD * k, 450.0)
    assert play.squeezes == contact


def test_a_current_below_the_share_of_the_limit_is_no_contact(tmp_path: Path) -> None:
    play = Play(tmp_path, contact=0.8)
    for _ in range(60):
        play.step(230.0, 195.0, 390.0)
    assert not play.squeezes


@pytest.mark.parametrize(("yields", "gone"), [(1.3, False), (1.7, True)])
def test_an_object_is_gone_once_the_finger_is_well_beyond_it(
    tmp_path: Path, yields: float, gone: bool
) -> None:
    play = Play(tmp_path)
    for _ in range(30):
        play.step(230.0, 195.0, 450.0)
    assert play.squeezes
    play.step(230.0, 195.0 + yields * MARGIN)
    assert play.squeezes == (not gone)
