"""The worker of a real hand: what it sends, on a clock of the test, so that no load decides."""

import math
import re
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from fake_hand import FakeHandSink, write_fake_table
from live_time import PATIENCE_S
from ticks import make_tick

from smooth_operator.errors import SinkError
from smooth_operator.hands.hand import Hand
from smooth_operator.teleop.sinks.tick import HandState, Mode
from smooth_operator.types import JointCommand
from smooth_operator_devices.hands.actuator_map import BoundMap, read_table
from smooth_operator_devices.hands.device import DeviceLostError, Reading, Setting, WrongAnswerError
from smooth_operator_devices.hands.guard import CommandGuard, GuardSettings
from smooth_operator_devices.hands.hardware_sink import HandWorker

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
    reaches the hand, or the computer; in ``gone`` there is no bus. ``wrong`` changes the positions
    of a reading, by its number. ``limits`` are answers in place of the hand's limit, by the number
    of the question; None is a wrong answer. ``events`` are actions at a time. ``written`` has a row
    for each command that reached the hand: time, commands, where it was.
    """

    def __init__(self, clock: Clock, count: int) -> None:
        self.clock = clock
        self.angles = self.goal = np.zeros(count)
        self.stop = math.inf  # an object, beyond which no motor gets
        self.currents: np.ndarray | None = None
        self.temperatures, self.errors = np.full(count, 30.0), ()
        self.deaf = self.mute = self.gone = (math.inf, math.inf)
        self.wrong: Callable[[int, np.ndarray], np.ndarray] = lambda number, positions: positions
        self.reads = 0
        self.settings_s = 0.001  # how long it takes to read the settings back
        self.limit, self.limits = 0.0, dict[int, float | None]()
        self.questions = 0  # readings of the settings
        self.events: list[tuple[float, Callable[[], object]]] = []
        self.written: list[tuple[float, np.ndarray, np.ndarray]] = []
        self.relaxed: list[float] = []
        self._moved = clock.now
        self._powered = False

    def fall(self, angle: float) -> None:
        """Something moves the hand."""
        self.angles = self.goal = np.full(len(self.angles), angle)

    def _wait(self, seconds: float) -> None:
        self.clock.now += seconds
        step = MOTOR * (self.clock.now - self._moved) * self._powered
        self._moved = self.clock.now
        self.angles = self.angles + np.clip(self.goal - self.angles, -step, step)
        self.angles = np.minimum(self.angles, self.stop)
        while self.events and self.clock.now >= self.events[0][0]:
            self.events.pop(0)[1]()
        if self._lost(self.gone):
            raise DeviceLostError("the cable was pulled")

    def _lost(self, *directions: tuple[float, float]) -> bool:
        return any(begin <= self.clock.now < end for begin, end in directions)

    def open(self) -> None:
        self._wait(0.01)
        self.limit = 300.0

    def read(self) -> Reading:
        self._wait(0.003)
        if self._lost(self.deaf, self.mute):
            self._wait(0.012)
            raise WrongAnswerError("no answer")
        self.reads += 1
        positions = degrees(self.wrong(self.reads, self.angles.copy()))
        return Reading(positions, None, self.currents, self.temperatures, self.errors)

    def write(self, commands: np.ndarray) -> None:
        self._wait(0.001)
        if not self._lost(self.deaf):
            self.goal, self._powered = radians(commands), True
            self.written.append((self.clock.now, self.goal, self.angles.copy()))

    def settings(self) -> tuple[Setting, ...]:
        self._wait(self.settings_s)
        self.questions += 1
        answer = self.limits.get(self.questions, self.limit)
        if answer is None:
            raise WrongAnswerError("an unknown register")
        return (Setting("limit", np.full(1, 300.0), np.full(1, answer)),)

    def relax(self) -> None:
        self._wait(0.001)
        self._powered = False
        self.relaxed.append(self.clock.now)

    def close(self) -> None:
        self._powered = False


SIGNS = np.where(np.arange(16) % 2, -1.0, 1.0)


def degrees(angles: np.ndarray) -> np.ndarray:
    """The fake table's commands."""
    return 180.0 + SIGNS * np.rad2deg(angles)


def radians(commands: np.ndarray) -> np.ndarray:
    return SIGNS * np.deg2rad(commands - 180.0)


class Run:
    """A worker on a ``Bus``, from its first command to the end of the test's time.

    ``wish`` is what the operator asks for at a time [rad]; ``mode`` the loop's; ``silent`` True
    when no command comes. ``stall`` is a time at which the worker's thread stands still for 0.3 s.
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
        self.stall = math.inf
        self.seen: dict[float, tuple[str, HandState | None]] = {}
        self.port = str(folder / "port")
        for module in ("hardware_sink", "device"):
            monkeypatch.setattr(f"smooth_operator_devices.hands.{module}.time", self.clock)
        monkeypatch.setattr("smooth_operator_devices.hands.hardware_sink._RETRY_S", 0.0)
        self.patch = monkeypatch

    def at(self, time: float, action: Callable[[], object]) -> None:
        self.bus.events.append((time, action))

    def look(self, *times: float) -> None:
        """Keep the worker's note and state of these times in ``seen``."""
        for time in times:
            self.at(time, partial(self._look, time))

    def _look(self, time: float) -> None:
        self.seen[time] = self.worker.note, self.worker.state

    def __call__(self, seconds: float, lost_s: float = 0.5) -> HandWorker:
        end = self.clock.now + seconds
        self.bus.events.sort(key=lambda event: event[0])
        sink = FakeHandSink(
            self.port, approach=APPROACH, speed=SPEED, silence_s=SILENCE, lost_s=lost_s
        )
        self.worker = worker = HandWorker(sink, self.bus, self.bound, "right", self.hand.name)
        tick = make_tick(self.hand)

        def pace(worker: HandWorker, cycle: float) -> None:
            self.clock.now = max(cycle + PERIOD, self.clock.now)
            if self.clock.now > self.stall:
                self.clock.now, self.stall = self.clock.now + 0.3, math.inf
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


def slow(rows: list[tuple[float, np.ndarray, np.ndarray]]) -> bool:
    """True if every step between commands is as short as in an approach."""
    return bool((np.abs(np.diff([row for _, row, _ in rows], axis=0)) <= SLOW_STEP).all())


SLOW_STEP = 2 * PERIOD * APPROACH + 1e-9
OUTAGES = [(way, seconds) for way in ("deaf", "mute") for seconds in (0.1, 0.3, 0.45)]


@pytest.mark.parametrize(("way", "seconds"), [*OUTAGES, ("deaf", 3.0), ("mute", 3.0)])
def test_the_first_command_after_an_outage_is_where_the_hand_is(run, way, seconds):
    begin = 103.0 - seconds / 2
    run.wish = sine
    setattr(run.bus, way, (begin, begin + seconds))
    worker = run(6.0, lost_s=5.0 if seconds > 0.5 else 0.5)
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
    assert slow([first, *rest[:20]])
    assert abs(run.bus.angles[0] - sine(run.clock.now)) < 0.15  # and it follows again


@pytest.mark.parametrize("way", ["deaf", "mute"])
@pytest.mark.parametrize("seconds", [0.012, 0.03])
def test_one_or_two_answers_that_are_missing_cost_no_approach_and_no_jump(run, way, seconds):
    run.wish = sine
    setattr(run.bus, way, (103.0, 103.0 + seconds))
    worker = run(4.0)
    assert worker.statistics.wrong >= 1
    assert worker.statistics.lost == 0
    before = [row for row in run.bus.written if row[0] < 103.0][-1]
    for at, commands, _ in run.since(103.0):
        assert np.abs(commands - before[1]).max() <= SPEED * (at - before[0]) + 1e-9
    assert all(abs(sine(at) - row[0]) < 0.1 for at, row, _ in run.since(103.2))


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


BEYOND = "beyond its ends 120 and 240.*the servo may be one turn off, or the table's zero may be"


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (
            lambda count: 0.4 * (count % 3),
            "m1: 3 consecutive readings of its position differ.*check its cable",
        ),
        (lambda count: math.nan, "m1 did not report a position"),
        (lambda count: 2 * math.pi, f"m1 is at -180 deg.*{BEYOND}"),
        (lambda count: -2 * math.pi, f"m1 is at 540 deg.*{BEYOND}"),
        (lambda count: -1_000_000 * math.pi / 2048, BEYOND),
        (lambda count: 1.45, BEYOND),
    ],
    ids=["never agree", "none", "a turn", "a turn back", "many turns", "a little too far"],
)
def test_a_hand_whose_position_is_not_known_is_not_moved(run, change, words):
    run.bus.wrong = lambda count, angles: far(1, change(count))(angles)
    worker = run(0.5)
    assert not run.bus.written
    assert re.search(words, worker.statistics.latest)


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
    run.at(102.2, lambda: run.bus.fall(-0.5))
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


@pytest.mark.parametrize("rest", ["hold", "relax"])
def test_a_command_counts_for_silence_s_and_the_return_is_slow(tmp_path, hand, monkeypatch, rest):
    run = Run(tmp_path, hand, monkeypatch, f'on_silence = "{rest}"\n')
    run.wish = lambda now: 0.2 if now < 101.0 else -0.3
    run.silent = lambda now: 101.0 < now < 102.0
    run.look(101.1, 101.9)
    here = 0.2 if rest == "hold" else 0.5
    run.at(101.8, lambda: run.bus.fall(here))
    run(4.0)
    assert "no commands arrive" not in run.seen[101.1][0]
    note, state = run.seen[101.9]
    assert note == "no commands arrive: the hand rests"
    assert state.positions == pytest.approx(run.bound.joints(degrees(np.full(16, here))))
    during = [row for at, row, _ in run.since(101.0 + SILENCE + 3 * PERIOD) if at < 102.0]
    if rest == "hold":
        assert len(during) > 20
        assert all(row == pytest.approx(0.2) for row in during)
    else:
        assert not during
        assert 101.0 + SILENCE - PERIOD < run.bus.relaxed[0] < 101.0 + SILENCE + 3 * PERIOD
    back = run.since(102.0 + PERIOD)
    assert back[0][1] == pytest.approx(here, abs=0.01)
    assert slow(back[:20])
    assert run.worker.statistics.silences == 1


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
            assert slow(rows[k : k + 20])
    assert returns >= 3


def test_it_waits_for_a_command_and_begins_slowly_where_the_hand_is(run):
    run.bus.fall(0.35)
    run.silent = lambda now: now < 101.0
    run.wish = lambda now: 0.5
    run.look(100.9, 101.1, 103.0)
    run(4.0)
    assert [run.seen[at][0] for at in (100.9, 101.1, 103.0)] == [
        "waiting for the first command",
        "approaches",
        "",
    ]
    first = run.bus.written[0]
    assert first[0] > 101.0
    assert np.abs(first[1] - 0.35).max() <= SLOW_STEP
    assert slow(run.bus.written[:20])
    assert run.bus.written[-2][1] == pytest.approx(0.5)
    assert len(run.bus.relaxed) == 1  # at the end of the run, as the table says
    assert not run.since(run.bus.relaxed[0])


@pytest.mark.parametrize(
    ("way", "words"), [("gone", "the cable was pulled"), ("mute", "no answer")]
)
def test_a_hand_that_was_lost_in_motion_is_opened_again_and_approached_slowly(run, way, words):
    run.wish = sine
    setattr(run.bus, way, (102.0, 103.5))
    run.at(103.4, lambda: run.bus.fall(-0.5))
    opened: list[tuple[str, HandState | None]] = []

    def reopen() -> None:
        opened.append((run.worker.note, run.worker.state))
        Bus.open(run.bus)

    run.patch.setattr(run.bus, "open", reopen)
    worker = run(6.0)
    assert worker.statistics.lost == len(opened) - 1 > 0
    for note, state in opened[1:]:
        assert f"{words}; retrying every second" in note
        assert state is None
    back = run.since(103.5)
    assert back[0][1] == pytest.approx(-0.5, abs=SLOW_STEP)
    assert slow(back[:20])
    assert abs(run.bus.angles[0] - sine(run.clock.now)) < 0.15  # and it follows again


def test_after_a_stall_of_the_thread_it_begins_where_the_hand_is_by_then(run):
    """A machine that stands still for a moment: the hand has gone on, or has fallen back."""
    run.stall = 102.0
    run.at(102.1, lambda: run.bus.fall(-0.5))
    run.wish = lambda now: 0.4
    run(4.0)
    back = run.since(102.1)
    assert np.abs(back[0][1] - back[0][2]).max() < 0.01
    assert back[0][1] == pytest.approx(-0.5, abs=0.01)
    assert slow(back[:20])


def test_a_limit_that_is_gone_is_a_lost_device_and_one_wrong_reading_is_not(run):
    run.bus.limits = {2: 900.0}
    run.at(103.5, lambda: setattr(run.bus, "limit", 900.0))
    worker = run(5.0)
    assert worker.statistics.lost == 1
    assert worker.statistics.latest == "the hand restarted: limit of no. 1 is 900, not 300"
    assert run.bus.limit == 300.0
    assert run.since(104.8)  # and it follows again


@pytest.mark.parametrize("answer", [900.0, None], ids=["another value", "a wrong answer"])
def test_a_limit_that_the_hand_never_read_back_is_a_warning_and_no_loss(run, answer):
    run.bus.limits = dict.fromkeys((1, 2, 3), answer)
    run.look(104.0)
    worker = run(4.5)
    warning = "its limits can't be read back" if answer is None else "limit of no. 1 is 900, not"
    assert warning in run.seen[104.0][0]
    assert run.bus.questions == 3  # it can't tell, and is not asked again
    assert worker.statistics.lost == 0


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_a_command_that_is_not_finite_holds_the_last_one(run, value):
    run.wish = lambda now: value if now < 101.0 or 103.0 < now < 105.0 else 0.2
    run.mode = lambda now: Mode.STOPPED if 104.5 < now < 106.0 else Mode.TRACKING
    run.look(100.9, 104.0, 104.9)
    worker = run(7.0)
    assert run.bus.written[0][0] > 101.0  # there is no last one
    assert all(row == pytest.approx(0.2) for at, row, _ in run.since(103.0) if at < 104.5)
    assert "commands not finite" in run.seen[104.0][0]  # and no silence, which is shorter
    assert "no commands arrive" not in run.seen[104.0][0]
    assert "emergency stop" in run.seen[104.9][0]
    assert worker.statistics.lost == worker.statistics.wrong == worker.statistics.silences == 0


def test_errors_and_temperatures_are_shown(run):
    run.bus.temperatures[2], run.bus.errors = 71.0, ("m3: overload",)
    run.look(102.0)
    run(3.0)
    assert run.seen[102.0][0] == "m3: overload; hot: m2 71 °C"
