"""A real hand whose bus falls silent, or that answers a wrong position: what is sent, on a clock of
the test's own, so that no machine's load decides."""

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from fake_hand import write_fake_table
from live_time import PATIENCE_S
from ticks import make_tick

from smooth_operator.errors import SinkError
from smooth_operator.hands.hand import Hand
from smooth_operator.teleop.hardware.actuator_map import BoundMap, read_table
from smooth_operator.teleop.hardware.device import Reading, Setting, WrongAnswerError
from smooth_operator.teleop.hardware.guard import CommandGuard, GuardSettings
from smooth_operator.teleop.hardware.hardware_sink import HandWorker, WorkerSettings
from smooth_operator.teleop.sinks.tick import Mode
from smooth_operator.types import JointCommand

PERIOD, SPEED, APPROACH, SILENCE = 0.01, 15.0, 0.5, 0.2
MOTOR = 8.0
"""Speed of the simulated motors [rad/s]."""


class Clock:
    """Time that passes only when somebody waits."""

    def __init__(self) -> None:
        self.now = 100.0

    def perf_counter(self) -> float:
        return self.now

    def sleep(self, seconds: float) -> None:
        self.now += seconds


class Bus:
    """Motors on a bus whose writes are not answered, as Dynamixel servos' are not.

    Angles are [rad] from the middle. ``deaf`` and ``mute`` are times (from, to) in which nothing
    reaches the hand, or the computer. ``wrong`` changes the positions of a reading, by its number.
    ``written`` has a row for each command that reached the hand: time, commands, where it was.
    """

    def __init__(self, clock: Clock, count: int) -> None:
        self.clock = clock
        self.angles = self.goal = np.zeros(count)
        self.stop = math.inf  # an object, beyond which no motor gets
        self.currents: np.ndarray | None = None
        self.deaf = self.mute = (math.inf, math.inf)
        self.wrong: Callable[[int, np.ndarray], np.ndarray] = lambda number, positions: positions
        self.reads = 0
        self.settings_s = 0.001  # how long it takes to read the settings back
        self.written: list[tuple[float, np.ndarray, np.ndarray]] = []
        self.relaxed: list[float] = []
        self._moved = clock.now
        self._powered = False

    def _wait(self, seconds: float) -> None:
        self.clock.now += seconds
        step = MOTOR * (self.clock.now - self._moved) * self._powered
        self._moved = self.clock.now
        self.angles = self.angles + np.clip(self.goal - self.angles, -step, step)
        self.angles = np.minimum(self.angles, self.stop)

    def _lost(self, *directions: tuple[float, float]) -> bool:
        return any(begin <= self.clock.now < end for begin, end in directions)

    def open(self) -> None:
        self._wait(0.01)

    def read(self) -> Reading:
        self._wait(0.003)
        if self._lost(self.deaf, self.mute):
            self._wait(0.012)
            raise WrongAnswerError("no answer")
        self.reads += 1
        return Reading(degrees(self.wrong(self.reads, self.angles.copy())), None, self.currents)

    def write(self, commands: np.ndarray) -> None:
        self._wait(0.001)
        if not self._lost(self.deaf):
            self.goal, self._powered = radians(commands), True
            self.written.append((self.clock.now, self.goal, self.angles.copy()))

    def settings(self) -> tuple[Setting, ...]:
        self._wait(self.settings_s)
        limit = np.full(len(self.angles), 300.0)
        return (Setting("limit", limit, limit),)

    def relax(self) -> None:
        self._wait(0.001)
        self._powered = False
        self.relaxed.append(self.clock.now)

    def close(self) -> None:
        """Nothing to give back."""


SIGNS = np.where(np.arange(16) % 2, -1.0, 1.0)


def degrees(angles: np.ndarray) -> np.ndarray:
    """The fake table's commands."""
    return 180.0 + SIGNS * np.rad2deg(angles)


def radians(commands: np.ndarray) -> np.ndarray:
    return SIGNS * np.deg2rad(commands - 180.0)


class Run:
    """A worker on a ``Bus``, from its first command to the end of the test's time.

    ``wish`` is what the operator asks for at a time [rad]; ``mode`` the loop's; ``silent`` True
    when no command comes.
    """

    def __init__(
        self, folder: Path, hand: Hand, monkeypatch: pytest.MonkeyPatch, extra: str = ""
    ) -> None:
        self.clock, self.hand = Clock(), hand
        table = write_fake_table(folder / "fake_right.toml", hand.actuated_names, extra)
        self.bound = BoundMap(read_table(table), hand)
        assert len(self.bound.ends) == len(SIGNS)
        self.bus = Bus(self.clock, len(SIGNS))
        self.wish: Callable[[float], float] = lambda now: 0.0
        self.mode: Callable[[float], Mode] = lambda now: Mode.TRACKING
        self.silent: Callable[[float], bool] = lambda now: False
        self.lock = str(folder / "port")
        for module in ("hardware_sink", "device"):
            monkeypatch.setattr(f"smooth_operator.teleop.hardware.{module}.time", self.clock)
        monkeypatch.setattr("smooth_operator.teleop.hardware.hardware_sink._RETRY_S", 0.0)
        self.patch = monkeypatch

    def __call__(self, seconds: float, lost_s: float = 0.5) -> HandWorker:
        end = self.clock.now + seconds
        guard = GuardSettings(APPROACH, SPEED)
        settings = WorkerSettings(PERIOD, SILENCE, lost_s, guard)
        worker = HandWorker(
            "fake", self.bus, self.lock, self.bound, "right", self.hand.name, settings
        )
        tick = make_tick(self.hand)

        def pace(worker: HandWorker, cycle: float) -> None:
            self.bus._wait(max(cycle + PERIOD - self.clock.now, 0.0))
            now = self.clock.now
            joints = np.full(len(self.hand.actuated), self.wish(now))
            command = JointCommand(self.hand.full_configuration(joints), self.hand.joint_names)
            if not self.silent(now):
                worker.post(replace(tick, command=command, mode=self.mode(now)))
            worker._ending = now > end

        self.patch.setattr(HandWorker, "_pace", pace)
        worker.start()
        worker._thread.join(PATIENCE_S)
        assert not worker._thread.is_alive()
        return worker

    def since(self, begin: float) -> list[tuple[float, np.ndarray, np.ndarray]]:
        """The commands that reached the hand from a time on."""
        return [row for row in self.bus.written if row[0] >= begin]


@pytest.fixture
def run(tmp_path: Path, hand: Hand, monkeypatch: pytest.MonkeyPatch) -> Run:
    return Run(tmp_path, hand, monkeypatch)


def sine(now: float) -> float:
    """An operator at 0.5 Hz over 80 % of the table's range, fastest at whole seconds [rad]."""
    return 0.84 * math.sin(math.pi * now)


OUTAGES = [(way, seconds) for way in ("deaf", "mute") for seconds in (0.1, 0.3, 0.45)]


@pytest.mark.parametrize(("way", "seconds"), [*OUTAGES, ("deaf", 3.0), ("mute", 3.0)])
def test_the_first_command_after_an_outage_is_where_the_hand_is(run, way, seconds):
    begin = 105.0 - seconds / 2
    run.wish = sine
    setattr(run.bus, way, (begin, begin + seconds))
    worker = run(8.0, lost_s=5.0 if seconds > 0.5 else 0.5)
    assert worker.statistics.lost == 0
    before = [row for row in run.bus.written if row[0] < begin][-1]
    assert abs(before[1][0] - sine(before[0])) < 0.1  # it followed
    # While it did not answer the hand got one more command, and then none.
    for at, commands, _ in run.since(begin):
        if at < begin + seconds:
            assert np.abs(commands - before[1]).max() <= 2 * PERIOD * SPEED
            assert at < begin + 0.05 + 2 * PERIOD
    first, *rest = run.since(begin + seconds)
    assert np.abs(first[1] - first[2]).max() < 0.01
    for earlier, later in zip([first, *rest], rest[:20], strict=False):
        assert np.abs(later[1] - earlier[1]).max() <= 2 * PERIOD * APPROACH + 1e-9
    assert abs(run.bus.angles[0] - sine(run.clock.now)) < 0.15  # and it follows again


@pytest.mark.parametrize("way", ["deaf", "mute"])
@pytest.mark.parametrize("seconds", [0.012, 0.03])
def test_one_or_two_answers_that_are_missing_cost_no_approach_and_no_jump(run, way, seconds):
    run.wish = sine
    setattr(run.bus, way, (105.0, 105.0 + seconds))
    worker = run(6.0)
    assert worker.statistics.wrong >= 1
    before = [row for row in run.bus.written if row[0] < 105.0][-1]
    for at, commands, _ in run.since(105.0):
        assert np.abs(commands - before[1]).max() <= SPEED * (at - before[0]) + 1e-9
    assert all(abs(sine(at) - row[0]) < 0.1 for at, row, _ in run.since(105.2))


def test_settings_that_are_slow_to_read_back_cost_no_approach(run):
    """Two questions on a serial adapter that holds bytes back for 16 ms: once a second."""
    run.wish = sine
    run.bus.settings_s = 0.06
    run(8.0)
    assert all(abs(sine(at) - row[0]) < 0.25 for at, row, _ in run.since(104.0)[:-1])


def test_a_finger_that_an_object_blocks_keeps_its_grasp(run):
    """Without currents, as a Linker hand: its command stands 0.7 rad inside the object, 70 times
    the way that ``speed`` makes in a period; a bound on that distance would let go."""
    run.wish = lambda now: min(1.0, 0.4 * (now - 100.0))
    run.bus.stop = 0.3
    run.bus.deaf = (105.0, 105.012)  # an answer that is missing does not open it, either
    run(8.0)
    # The last one is the run's end.
    assert all(row[0] == pytest.approx(1.0) for _, row, _ in run.since(104.0)[:-1])
    assert run.bus.angles == pytest.approx(0.3)


def far(index: int, angle: float) -> Callable[[np.ndarray], np.ndarray]:
    """Another position of one motor [rad]."""

    def change(angles: np.ndarray) -> np.ndarray:
        angles[index] = angle
        return angles

    return change


@pytest.mark.parametrize("number", [1, 2, 3, 4, 5, 6])
def test_one_wrong_reading_moves_nothing(run, number):
    wild = far(1, 0.9)
    run.bus.wrong = lambda count, angles: wild(angles) if count == number else angles
    run.wish = lambda now: 0.0
    worker = run(0.5)
    assert worker.statistics.lost == 0
    assert len(run.bus.written) > 20
    assert np.abs([row[1] for row in run.bus.written]).max() < 1e-6


def test_readings_that_never_agree_move_nothing(run):
    run.bus.wrong = lambda count, angles: far(1, 0.4 * (count % 3))(angles)
    worker = run(0.5)
    assert not run.bus.written
    assert "m1: 3 consecutive readings of its position differ" in worker.statistics.latest
    assert "check its cable" in worker.statistics.latest


@pytest.mark.parametrize("offset", [2 * math.pi, -2 * math.pi, -1_000_000 * math.pi / 2048, 1.45])
def test_a_start_far_beyond_the_ends_is_refused(run, offset):
    run.bus.wrong = lambda count, angles: far(1, offset)(angles)
    worker = run(0.3)
    assert not run.bus.written
    assert (
        f"m1 is at {degrees(far(1, offset)(np.zeros(16)))[1]:.6g} deg" in worker.statistics.latest
    )
    assert "beyond its ends 120 and 240" in worker.statistics.latest
    assert (
        "the servo may be one turn off, or the table's zero may be wrong"
        in worker.statistics.latest
    )


def test_a_start_a_little_beyond_the_ends_comes_in(run):
    run.bus.angles = far(1, math.pi / 3 + 0.3)(np.zeros(16))
    run(4.0)
    assert run.bus.written[0][1][1] == pytest.approx(math.pi / 3 + 0.3)
    assert run.bus.written[-1][1][1] == pytest.approx(0.0)


@pytest.mark.parametrize("wrong", [(), (1,), (2,), (1, 2)])
def test_a_stop_holds_where_the_hand_is_whatever_one_reading_says(run, wrong):
    """The first readings from the stop on are wild, each in its own way."""
    run.wish = lambda now: 0.4 * (now - 100.0)
    run.mode = lambda now: Mode.STOPPED if now > 101.0 else Mode.TRACKING
    stopped = [0]

    def read(count: int, angles: np.ndarray) -> np.ndarray:
        stopped[0] += run.clock.now > 101.0
        return far(1, 1.0 - stopped[0])(angles) if stopped[0] in wrong else angles

    run.bus.wrong = read
    run(1.5)
    held = run.since(101.2)
    assert len(held) > 20  # in every cycle: a command that is lost is sent again
    here = run.bus.angles
    assert all((row == held[0][1]).all() for _, row, _ in held)
    assert np.abs(here - 0.4).max() < 0.03
    assert all(np.abs(row - 0.4).max() < 0.05 for _, row, _ in run.since(101.0))
    assert run.since(101.0)[0][0] < 101.05


def test_a_stop_in_an_outage_holds_where_the_hand_is_by_then(run):
    run.wish = lambda now: 0.4 * (now - 100.0)
    run.mode = lambda now: Mode.STOPPED if now > 102.0 else Mode.TRACKING
    run.bus.deaf = (101.9, 102.2)
    falls: list[int] = []

    def fallen(count: int, angles: np.ndarray) -> np.ndarray:
        if not falls and run.clock.now > run.bus.deaf[1]:
            falls.append(count)
            run.bus.angles = run.bus.goal = np.full(16, -0.5)
        return run.bus.angles.copy()

    run.bus.wrong = fallen
    run(3.0)
    after = run.since(102.2)
    assert len(after) > 20
    assert all(row == pytest.approx(-0.5) for _, row, _ in after)


def test_a_stop_before_the_first_command_powers_nothing(run):
    run.mode = lambda now: Mode.STOPPED
    run(0.5)
    assert not run.bus.written


@pytest.mark.parametrize("mute", [False, True])
def test_relaxing_does_not_wait_for_a_reading(tmp_path, hand, monkeypatch, mute):
    run = Run(tmp_path, hand, monkeypatch, 'on_stop = "relax"\n')
    run.mode = lambda now: Mode.STOPPED if now > 101.0 else Mode.TRACKING
    if mute:
        run.bus.mute = (101.0, 101.3)
    run(1.5)
    assert run.bus.relaxed[0] < 101.0 + 0.05
    assert not run.since(run.bus.relaxed[0])  # nothing switches it on again


def test_a_command_counts_for_silence_s_and_no_longer(tmp_path, hand, monkeypatch):
    run = Run(tmp_path, hand, monkeypatch, 'on_silence = "relax"\n')
    run.silent = lambda now: now > 101.0
    run(1.5)
    assert 101.0 + SILENCE - PERIOD < run.bus.relaxed[0] < 101.0 + SILENCE + 3 * PERIOD


def test_an_actuator_without_a_position_stands_and_begins_where_it_is(run):
    run.wish = sine
    lost = (103.0, 103.4)
    run.bus.wrong = lambda count, angles: (
        far(1, math.nan)(angles) if lost[0] < run.clock.now < lost[1] else angles
    )
    run(5.0)
    during = [row for at, row, _ in run.since(103.0 + 2 * PERIOD) if at < 103.4]
    assert np.ptp([row[1] for row in during]) == 0.0
    assert np.ptp([row[0] for row in during]) > 0.2  # the others go on
    first = run.since(103.4 + 2 * PERIOD)[0]
    assert np.abs(first[1] - first[2]).max() < 0.01 + 2 * PERIOD * APPROACH
    assert np.isfinite([row for _, row, _ in run.bus.written]).all()


def test_the_guard_moves_no_command_without_a_new_reading(run, hand):
    guard = CommandGuard(run.bound, GuardSettings(approach=SPEED, speed=SPEED))
    wanted = hand.full_configuration(np.full(len(hand.actuated), 0.5))
    reading = Reading(degrees(np.zeros(16)))
    guard.start(reading)
    for _ in range(5):  # where the hand is, however often and late
        assert guard.step(wanted, reading, 1.0) == pytest.approx(degrees(np.zeros(16)))
    reading = replace(reading)
    moved = guard.step(wanted, reading, 0.01)
    assert radians(moved) == pytest.approx(SPEED * 0.01)
    assert guard.step(wanted, reading, 0.01) == pytest.approx(moved)
    with pytest.raises(SinkError, match="one turn off"):
        guard.start(Reading(degrees(np.full(16, 7.0))))


def test_an_exchange_as_long_as_a_silence_is_a_return(run):
    """It is answered in the end, but nobody knows what the hand did meanwhile."""
    run.wish = sine
    run.bus.settings_s = 0.26  # SILENCE is 0.2 s; the settings are read back once a second
    run(8.0)
    rows, returns = run.since(102.0), 0
    for k in range(1, len(rows) - 20):
        if rows[k][0] - rows[k - 1][0] > SILENCE:
            returns += 1
            assert np.abs(rows[k][1] - rows[k][2]).max() < 0.01  # where the hand is
            for earlier, later in zip(rows[k : k + 20], rows[k + 1 : k + 20], strict=False):
                assert np.abs(later[1] - earlier[1]).max() <= 2 * PERIOD * APPROACH + 1e-9
    assert returns >= 3


class Guarded:
    """A guard, asked once a period; angles are [rad] from the middle of the table's range."""

    END = math.radians(60.0)

    def __init__(self, folder: Path, hand: Hand) -> None:
        table = write_fake_table(folder / "fake_right.toml", hand.actuated_names)
        self.hand, bound = hand, BoundMap(read_table(table), hand)
        self.guard = CommandGuard(bound, GuardSettings(APPROACH, SPEED))

    def reading(self, at: float, current: float) -> Reading:
        count = len(SIGNS)
        return Reading(degrees(np.full(count, at)), None, np.full(count, current))

    def start(self, at: float) -> None:
        self.guard.start(self.reading(at, 0.0))

    def step(self, wish: float, at: float, current: float = 0.0) -> float:
        """The next command of all actuators, which are alike."""
        target = self.hand.full_configuration(np.full(len(SIGNS), wish))
        commands = radians(self.guard.step(target, self.reading(at, current), PERIOD))
        assert np.ptp(commands) < 1e-9
        return float(commands[0])

    def approach(self, wish: float) -> float:
        """Steps until the actuators have caught up with a wish; where they are."""
        at = self.step(wish, wish)
        for _ in range(1000):
            at = self.step(wish, at)
            if not self.guard.approaching.any() and abs(at - wish) < 1e-9:
                return at
        pytest.fail(f"it came to {at}, not to {wish}")

    def squeeze(self, at: float, wish: float) -> float:
        """Half a second against an object, with more current than the limit; the last command."""
        return [self.step(wish, at, current=500.0) for _ in range(50)][-1]


@pytest.fixture
def guarded(tmp_path: Path, hand: Hand) -> Guarded:
    return Guarded(tmp_path, hand)


def test_a_squeezing_command_stays_a_tenth_of_a_radian_inside_the_object(guarded):
    guarded.start(0.0)
    guarded.approach(0.2)
    assert guarded.squeeze(at=0.3, wish=1.0) == pytest.approx(0.4)
    assert guarded.guard.contacts == len(SIGNS)


def test_after_an_object_is_gone_the_hand_goes_on_slowly(guarded):
    guarded.start(0.0)
    guarded.approach(0.2)
    command, at = guarded.squeeze(at=0.3, wish=1.0), 0.3 + 0.16
    for _ in range(30):
        before, command = command, guarded.step(1.0, at)
        assert 0.0 < command - before <= APPROACH * PERIOD + 1e-9
        at = max(at, command)


def test_no_command_leaves_the_ends_of_the_table(guarded):
    """A hand that is pushed beyond an end, with current, is not followed there."""
    guarded.start(0.0)
    end = guarded.approach(Guarded.END)
    for _ in range(100):
        assert guarded.step(end, end + 0.3, current=500.0) <= end + 1e-9
    assert guarded.guard.contacts


def test_a_hand_that_has_come_back_from_beyond_an_end_does_not_go_there_again(guarded):
    guarded.start(Guarded.END + 0.3)
    command = guarded.step(0.0, Guarded.END + 0.3)
    assert command > Guarded.END  # it begins where the hand is
    guarded.approach(0.0)
    end = guarded.approach(Guarded.END)
    for _ in range(100):
        assert guarded.step(end, end + 0.3, current=500.0) <= end + 1e-9


def test_a_hand_far_beyond_an_end_is_not_moved(guarded):
    guarded.start(-Guarded.END - 0.34)
    with pytest.raises(SinkError, match=r"0\.36 rad beyond its ends"):
        guarded.start(-Guarded.END - 0.36)
