"""The base of real-hand sinks on a hand in memory: start, limits, silence, stop, loss, contact."""

import contextlib
import os
import subprocess
import sys
import textwrap
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
import pytest
from fake_hand import FakeHand, FakeHandSink, write_fake_table
from live_time import PATIENCE_S, until
from ticks import make_tick

from smooth_operator import Hand, load_hand
from smooth_operator.errors import ConfigError, SinkError
from smooth_operator.teleop.components import build_sink
from smooth_operator.teleop.hardware import bus_lock
from smooth_operator.teleop.hardware.bus_lock import BusLock
from smooth_operator.teleop.hardware.guard import GuardSettings
from smooth_operator.teleop.hardware.hardware_sink import HandWorker, HardwareSink
from smooth_operator.teleop.hardware.table_check import ActuatorMover
from smooth_operator.teleop.sinks.sink import SinkRunner
from smooth_operator.teleop.sinks.tick import Mode, Tick
from smooth_operator.types import JointCommand

PERIOD = 0.01


def calm(sink: HardwareSink) -> bool:
    """Whether the hand follows; its note may still count what went wrong before."""
    words = (
        "approaches",
        "waiting",
        "rests",
        "emergency",
        "retrying",
        "no answer",
        "contact limit",
    )
    return not any(word in sink.note for word in words)


def tick_at(hand: Hand, degrees: float, mode: Mode = Mode.TRACKING) -> Tick:
    """A command of the same angle for all actuated joints."""
    q = hand.full_configuration(np.full(len(hand.actuated), np.deg2rad(degrees)))
    return replace(make_tick(hand, mode=mode), command=JointCommand(q, hand.joint_names), mode=mode)


class Driven:
    """A sink that gets a command every few milliseconds, as from a loop."""

    def __init__(self, sink: FakeHandSink, hand: Hand) -> None:
        self.sink, self.hand = sink, hand
        self.tick: Tick | None = None
        self.errors: list[Exception] = []
        self._done = threading.Event()
        self._thread = threading.Thread(target=self._run)

    def __enter__(self) -> "Driven":
        self.sink.open({"right": self.hand}, {})
        self._thread.start()
        return self

    def _run(self) -> None:
        while not self._done.wait(0.004):
            if self.tick is not None:
                try:
                    self.sink.send(self.tick)
                except SinkError as error:
                    self.errors.append(error)

    def __exit__(self, *_: object) -> None:
        self._done.set()
        self._thread.join()
        self.sink.close()

    @property
    def fake(self) -> FakeHand:
        return self.sink.made[-1]


def cycles(driven: Driven, count: int) -> None:
    """Wait until the hand was read so many more times."""
    reads = driven.fake.count("read")
    until(lambda: driven.fake.count("read") >= reads + count)


@pytest.fixture
def make(tmp_path, hand) -> Iterator[Callable[..., FakeHandSink]]:
    table = write_fake_table(tmp_path / "fake_right.toml", hand.actuated_names)
    made: list[FakeHandSink] = []

    def build(**settings: object) -> FakeHandSink:
        settings = {"table": str(table), "port": str(tmp_path / "port"), "speed": 50.0, **settings}
        made.append(FakeHandSink(**settings))
        return made[-1]

    yield build
    for sink in made:
        for fake in sink.made:
            fake.hang.clear()
        sink.close()


def test_it_starts_where_the_hand_is_and_approaches_slowly(make, hand):
    start = 200.0
    sink = make(approach=2.0, prepare=lambda fake: fake.positions.fill(start))
    with Driven(sink, hand) as driven:
        until(lambda: sink.state("right"))
        assert driven.fake.count("write") == 0  # nothing moves before there is a command
        assert "waiting" in sink.note
        driven.tick = tick_at(hand, 30.0)
        until(lambda: driven.fake.count("write") and calm(sink))
        until(lambda: driven.fake.commands()[-1, 1] == pytest.approx(150.0))
        written = driven.fake.commands()
    signs = np.where(np.arange(written.shape[1]) % 2, -1.0, 1.0)
    assert np.abs(written[0] - start).max() <= np.rad2deg(2.0) * 2 * PERIOD + 1e-6
    steps = np.abs(np.diff(written, axis=0))
    near = np.abs(written[1:] - (180 + 30 * signs)) < np.rad2deg(0.06)
    assert steps[~near].max() <= np.rad2deg(2.0) * 2 * PERIOD + 1e-6
    assert written[-1] == pytest.approx(180 + 30 * signs)
    # with the last command the run's end: the table's relax
    assert driven.fake.calls[-2][0] == "relax"
    assert driven.fake.calls[-1][0] == "close"


def test_ends_are_never_passed_and_a_start_beyond_them_comes_in(make, hand):
    sink = make(approach=10.0, prepare=lambda fake: fake.positions.fill(260.0))
    with Driven(sink, hand) as driven:
        driven.tick = tick_at(hand, 80.0)  # beyond the table's 60
        # The approach ends within a tolerance of the command: its last steps come after it.
        until(lambda: calm(sink) and driven.fake.count("write"))
        until(lambda: driven.fake.commands()[-1, :2] == pytest.approx([240.0, 120.0]))
        until(lambda: sink.state("right").positions[0] == pytest.approx(np.deg2rad(60.0)))
        written = driven.fake.commands()
        state = sink.state("right")
    assert (written >= 120.0).all()
    assert (written <= 260.0).all()
    assert (np.diff(written[:, 0]) <= 1e-9).all()  # from 260 to the end, 240, and not back
    assert written[-1, :2] == pytest.approx([240.0, 120.0])
    at = dict(zip(state.names, state.positions, strict=True))
    assert at[hand.actuated_names[0]] == pytest.approx(np.deg2rad(60.0))


@pytest.mark.parametrize("rest", ["hold", "relax"])
def test_silence_rests_as_the_table_says_and_the_return_is_slow(tmp_path, make, hand, rest):
    table = tmp_path / "resting.toml"
    write_fake_table(table, hand.actuated_names, f'on_silence = "{rest}"\n')
    sink = make(table=str(table), approach=5.0, silence_s=0.05)
    with Driven(sink, hand) as driven:
        driven.tick = tick_at(hand, 10.0)
        until(lambda: calm(sink))
        driven.tick = None
        until(lambda: "no commands arrive" in sink.note)
        cycles(driven, 5)
        assert driven.fake.count("relax") > 2 if rest == "relax" else not driven.fake.count("relax")
        assert sink.state("right") is not None  # still read
        assert "no commands arrive" in sink.note
        held, moved = driven.fake.commands()[-1], driven.fake.positions + 7.0
        driven.fake.pushed.update(enumerate(moved))  # the hand was moved by somebody
        driven.fake.positions = moved
        cycles(driven, 3)
        written = driven.fake.count("write")
        assert (driven.fake.commands()[-1] == held).all()
        driven.tick = tick_at(hand, 10.0)

        def returned() -> np.ndarray:
            commands = driven.fake.commands()[written:]
            return commands[(commands != held).any(axis=1)]

        until(lambda: len(returned()))
        first = returned()[0]
        until(lambda: calm(sink))
    assert first == pytest.approx(moved)
    assert sink.made[0].count("open") == 1


def test_a_device_lost_in_motion_is_opened_again_and_approached_slowly(make, hand, monkeypatch):
    monkeypatch.setattr("smooth_operator.teleop.hardware.hardware_sink._RETRY_S", 0.05)
    sink = make(approach=5.0)
    with Driven(sink, hand) as driven:
        driven.tick = tick_at(hand, 30.0)
        until(lambda: driven.fake.count("write") > 3)
        driven.fake.gone.set()
        until(lambda: sink.note)
        until(lambda: "the cable was pulled; retrying every second" in sink.note)
        assert sink.state("right") is None
        driven.fake.positions[:] = 180.0  # it fell back
        written = driven.fake.count("write")
        driven.fake.gone.clear()
        until(lambda: driven.fake.count("write") > written)
        first = driven.fake.commands()[written]
        assert np.abs(first - 180.0).max() <= np.rad2deg(5.0) * 2 * PERIOD + 1e-6
        until(lambda: "retrying" not in sink.note and "approaches" not in sink.note)
        assert not driven.errors
        assert sink.figures["device_lost"] >= 1


def test_after_a_stall_of_the_thread_it_begins_where_the_hand_is_by_then(make, hand, monkeypatch):
    """A machine that stands still for a moment: the hand has gone on, or has fallen back."""
    stall, pace = threading.Event(), HandWorker._pace

    def pacing(worker: HandWorker, cycle: float) -> None:
        pace(worker, cycle)
        if stall.is_set():
            time.sleep(0.3)
            driven.fake.positions[:] = 180.0
            stall.clear()

    monkeypatch.setattr(HandWorker, "_pace", pacing)
    with Driven(make(approach=5.0), hand) as driven:
        driven.tick = tick_at(hand, 30.0)
        until(lambda: driven.fake.count("write") and calm(driven.sink))
        stall.set()
        until(lambda: not stall.is_set())
        written = driven.fake.count("write")
        until(lambda: driven.fake.count("write") > written)
        first = driven.fake.commands()[written]
        assert np.abs(first - 180.0).max() <= np.rad2deg(5.0) * 2 * PERIOD + 1e-6


def test_wrong_answers_are_counted_and_many_are_a_lost_device(make, hand, monkeypatch):
    monkeypatch.setattr("smooth_operator.teleop.hardware.hardware_sink._RETRY_S", 0.02)
    sink = make(lost_s=0.5, approach=10.0)
    with Driven(sink, hand) as driven:
        driven.tick = tick_at(hand, 5.0)
        until(lambda: calm(sink))
        driven.fake.wrong = 3
        until(lambda: sink.figures["wrong_answers"] == 3)
        assert "3 wrong answers" in sink.note
        assert sink.figures["device_lost"] == 0
        driven.fake.wrong = 10**9
        until(lambda: sink.figures["device_lost"] == 1)
        assert "a wrong checksum" in sink.note
        driven.fake.wrong = 0
        until(lambda: "retrying" not in sink.note)


def test_a_wrong_answer_while_it_opens_is_asked_for_again(make, hand):
    def damage(openings: int) -> Callable[[FakeHand], None]:
        return lambda fake: setattr(fake, "wrong_openings", openings)

    sink = make(prepare=damage(2), lost_s=0.05)
    sink.open({"right": hand}, {})
    assert sink.figures["wrong_answers"] == 2
    assert [what for what, _ in sink.made[-1].calls][:5] == ["open", "close"] * 2 + ["open"]
    sink.close()
    with pytest.raises(SinkError, match="a wrong checksum"):
        make(prepare=damage(10**9), lost_s=0.05).open({"right": hand}, {})


def test_a_limit_that_is_gone_is_a_lost_device_and_one_wrong_reading_is_not(
    make, hand, monkeypatch
):
    monkeypatch.setattr("smooth_operator.teleop.hardware.device._EVERY_S", 0.02)
    monkeypatch.setattr("smooth_operator.teleop.hardware.hardware_sink._RETRY_S", 0.02)
    sink = make(approach=10.0)
    with Driven(sink, hand) as driven:
        driven.tick = tick_at(hand, 10.0)
        until(lambda: calm(sink) and driven.fake.count("settings") > 2)
        driven.fake.limits_once = [900.0]
        until(lambda: not driven.fake.limits_once)
        count = driven.fake.count("settings")
        until(lambda: driven.fake.count("settings") > count + 2)
        assert sink.figures["device_lost"] == 0
        driven.fake.limit = 900.0
        until(lambda: sink.figures["device_lost"] == 1)
        assert "the hand restarted: limit of no. 1 is 900, not 500; retrying" in sink.note
        until(lambda: calm(sink))
        assert driven.fake.limit == 500.0


@pytest.mark.parametrize("answer", [900.0, None], ids=["another value", "a wrong answer"])
def test_a_limit_that_the_hand_never_read_back_is_a_warning_and_no_loss(
    make, hand, monkeypatch, answer
):
    monkeypatch.setattr("smooth_operator.teleop.hardware.device._EVERY_S", 0.02)
    sink = make(approach=10.0, prepare=lambda fake: setattr(fake, "limits_once", [answer] * 3))
    with Driven(sink, hand) as driven:
        driven.tick = tick_at(hand, 10.0)
        warning = (
            "its limits can't be read back" if answer is None else "limit of no. 1 is 900, not"
        )
        until(lambda: warning in sink.note)
        until(lambda: not driven.fake.limits_once)
        cycles, readings = sink.figures["cycles"], driven.fake.count("settings")
        until(lambda: sink.figures["cycles"] > cycles + 10)
        # it can't tell, and is not asked again
        assert driven.fake.count("settings") == readings == 3
        assert warning in sink.note
        assert sink.figures["device_lost"] == 0


def test_a_lost_limit_ends_hardware_check(make, hand, monkeypatch):
    monkeypatch.setattr("smooth_operator.teleop.hardware.device._EVERY_S", 0.02)
    sink = make()
    table = sink.actuators("right")
    device = sink.device(table)
    with ActuatorMover(device, table) as mover:
        until(lambda: device.count("settings") > 2)
        device.limit = 900.0
        with pytest.raises(SinkError, match="the hand restarted: limit"):
            until(lambda: mover.reading is None)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_a_command_that_is_not_finite_holds_the_last_one(make, hand, value):
    sink = make(approach=20.0)
    with Driven(sink, hand) as driven:
        broken = tick_at(hand, 10.0)
        positions = broken.command.joint_positions.copy()
        positions[0] = value
        broken = replace(broken, command=JointCommand(positions, hand.joint_names))
        driven.tick = broken
        until(lambda: sink.figures["commands_not_finite"] > 3)
        assert driven.fake.count("write") == 0  # there is no last one
        driven.tick = tick_at(hand, 10.0)
        until(lambda: driven.fake.count("write") and calm(sink))
        until(lambda: driven.fake.commands()[-1, 0] == pytest.approx(190.0))
        before, count = sink.figures["commands_not_finite"], driven.fake.count("write")
        driven.tick = broken
        until(lambda: sink.figures["commands_not_finite"] > before + 80)  # longer than a silence
        assert driven.fake.commands()[count:] == pytest.approx(
            np.broadcast_to(driven.fake.commands()[count - 1], driven.fake.commands()[count:].shape)
        )
        assert "commands not finite" in sink.note
        driven.tick = replace(broken, mode=Mode.STOPPED)
        until(lambda: "emergency stop" in sink.note)
        driven.tick = tick_at(hand, -10.0)
        until(lambda: driven.fake.commands()[-1, 0] == pytest.approx(170.0))
        assert not driven.errors
        assert sink.figures["device_lost"] == sink.figures["wrong_answers"] == 0


def test_a_slow_bus_is_counted_and_a_hanging_one_delays_nobody(make, tmp_path, hand):
    hanging, fine = make(), make(port=str(tmp_path / "other"))
    runner = SinkRunner([hanging, fine])
    runner.open({"right": hand}, {})
    tick = tick_at(hand, 5.0)
    runner.send(tick)
    hanging.made[-1].slow_s = 0.03
    until(lambda: runner.send(tick) or hanging.figures["slow_cycles"] > 1)
    hanging.made[-1].slow_s = 0.0
    hanging.made[-1].hang.set()
    assert hanging.made[-1].hung.wait(PATIENCE_S)
    before = fine.made[-1].count("write")
    until(lambda: runner.send(tick) or fine.made[-1].count("write") >= before + 20)
    until(lambda: "no answer from the bus for" in hanging.note)
    assert all(entry.state == "open" for entry in runner.health())
    assert runner.health()[0].figures["cycles"] > 0
    hanging.made[-1].hang.clear()
    runner.close()


def test_a_joint_that_squeezes_goes_no_further_and_opens_again(make, hand):
    sink = make(approach=20.0)
    with Driven(sink, hand) as driven:
        driven.tick = tick_at(hand, 0.0)
        until(lambda: calm(sink))
        driven.fake.blocked[0] = 195.0  # an object, 15 degrees in
        driven.tick = tick_at(hand, 55.0)
        until(lambda: "contact limit reached: m0" in sink.note)
        until(lambda: driven.fake.commands()[-1, 0] < 195.0 + np.rad2deg(0.11))
        until(lambda: driven.fake.commands()[-1, 2] == pytest.approx(235.0))  # the others go on
        driven.tick = tick_at(hand, 5.0)  # the operator opens
        until(lambda: driven.fake.commands()[-1, 0] == pytest.approx(185.0))
        until(lambda: "contact limit" not in sink.note)
        # and an object that is gone: it closes again
        driven.tick = tick_at(hand, 55.0)
        until(lambda: "contact limit reached: m0" in sink.note)
        driven.fake.blocked.clear()
        driven.fake.pushed[0] = 206.0
        driven.fake.currents[:] = 0.0
        until(lambda: driven.fake.commands()[-1, 0] > 206.0)
    off = make(contact=0.0, approach=20.0)
    with Driven(off, hand) as driven:
        driven.fake.blocked[0] = 195.0
        driven.tick = tick_at(hand, 55.0)
        until(lambda: driven.fake.commands().size and driven.fake.commands()[-1, 0] > 234.0)


def test_errors_and_temperatures_are_shown(make, hand):
    sink = make()
    with Driven(sink, hand) as driven:
        driven.fake.temperatures[2] = 71.0
        driven.fake.errors = ("m3: overload",)
        until(lambda: "m3: overload" in sink.note)
        assert "hot: m2 71 °C" in sink.note


def test_a_hand_without_a_position_is_not_moved(make, hand):
    sink = make(prepare=lambda fake: fake.positions.__setitem__(1, np.nan))
    with Driven(sink, hand) as driven:
        driven.tick = tick_at(hand, 5.0)
        until(lambda: "m1 gave no position" in sink.note)
        assert driven.fake.count("write") == 0


def test_two_programs_on_one_bus(make, tmp_path, hand):
    first = make()
    first.open({"right": hand}, {})
    with pytest.raises(SinkError, match="is in use by another run of smooth-operator"):
        make().open({"right": hand}, {})
    first.close()
    code = f"""
        from smooth_operator.teleop.hardware.bus_lock import BusLock
        kept = BusLock({str(tmp_path / "port")!r}); print("locked", flush=True); input()
    """
    other = subprocess.Popen(
        [sys.executable, "-c", textwrap.dedent(code)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    assert other.stdout.readline().strip() == "locked"
    with pytest.raises(SinkError, match=f"process {other.pid}"):
        make().open({"right": hand}, {})
    other.kill()
    other.wait()
    again = make()
    again.open({"right": hand}, {})  # a process that died has no lock
    again.close()


def test_a_bus_is_free_while_its_device_is_lost(make, tmp_path, hand):
    """The port of a hand that is unplugged may be the next one that is plugged in."""
    with Driven(make(), hand) as driven:
        driven.tick = tick_at(hand, 10.0)
        driven.fake.gone.set()
        until(lambda: "the cable was pulled" in driven.sink.note)
        taken: list[BusLock] = []

        def take() -> bool:
            with contextlib.suppress(SinkError):  # it was just retrying
                taken.append(BusLock(str(tmp_path / "port")))
            return bool(taken)

        until(take)
        driven.fake.gone.clear()
        until(lambda: "in use by another run" in driven.sink.note)
        taken[0].release()
        until(lambda: driven.sink.state("right"))


SAME_HANDS = [
    ("inspire:127.0.0.1:6001", "inspire:localhost:6001"),
    ("inspire:127.0.0.1", "inspire:127.0.0.1:6000"),
    ("linker:can0", "allegro:can0"),
    ("linker:can0", "allegro:socketcan:can0"),
    ("linker:virtual:x,model=l20", "linker:Virtual:x,model=l10"),
    ("linker:slcan:{port}", "ability:{port}"),
    ("ability:{port}", "revo2:{link}"),
    ("inspire:{port}", "leap:{folder}/../{name}/port"),
    ("ability:COM3", "revo2:com3"),
    ("wuji:12345", "wuji"),
    ("wuji", "wuji:12345"),
    ("orca", "ability:{port}"),
]
"""Two texts of sinks that may be one hand, or one bus."""


@pytest.mark.parametrize(("one", "other"), SAME_HANDS)
def test_one_hand_has_one_lock_whatever_it_is_called(one, other, tmp_path, monkeypatch):
    if sys.platform != "linux" and "can0" in one:
        pytest.skip("another interface is the default there")
    if sys.platform == "win32" and "{" in one:
        pytest.skip("links need a privilege there")
    (tmp_path / "locks").mkdir()
    monkeypatch.setattr(bus_lock, "lock_folder", lambda: tmp_path / "locks")
    (tmp_path / "port").touch()
    if "{link}" in other:
        (tmp_path / "by-id").symlink_to(tmp_path / "port")
    places = {
        "port": tmp_path / "port",
        "link": tmp_path / "by-id",
        "folder": tmp_path,
        "name": tmp_path.name,
    }
    first, second = (build_sink(text.format(**places)) for text in (one, other))
    lock = BusLock(first.bus)
    with pytest.raises(SinkError, match=f"is in use by .*process {os.getpid()}|hand that may be"):
        BusLock(second.bus)
    lock.release()
    BusLock(second.bus).release()


def test_other_hands_have_other_locks(tmp_path, monkeypatch):
    monkeypatch.setattr(bus_lock, "lock_folder", lambda: tmp_path)
    buses = (
        "wuji:1",
        "wuji:2",
        "tcp:127.0.0.1:6000",
        "tcp:127.0.0.1:6001",
        "tcp:127.0.0.2:6000",
        "can:virtual:a",
        "can:virtual:b",
        "COM3",
        "COM4",
        str(tmp_path / "a"),
        str(tmp_path / "b"),
    )
    locks = [BusLock(bus) for bus in buses]
    for lock in locks:
        lock.release()
        lock.release()


def test_the_lock_is_the_same_with_another_folder_of_temporary_files(tmp_path, monkeypatch):
    bus = f"any:{tmp_path.name}-{os.getpid()}"
    lock = BusLock(bus)
    (tmp_path / "other").mkdir()
    code = f"from smooth_operator.teleop.hardware.bus_lock import BusLock; BusLock({bus!r})"
    other = subprocess.run(
        [sys.executable, "-c", code],
        env=os.environ | dict.fromkeys(("TMPDIR", "TEMP", "TMP"), str(tmp_path / "other")),
        capture_output=True,
        text=True,
        check=False,
    )
    lock.release()
    assert f"in use by another run of smooth-operator (process {os.getpid()})" in other.stderr
    assert not list((tmp_path / "other").iterdir())


@pytest.mark.skipif(sys.platform == "win32", reason="links need a privilege there")
@pytest.mark.parametrize("kind", ["link", "hard link", "pipe"])
def test_what_stands_in_place_of_a_lock_is_not_touched(tmp_path, monkeypatch, kind):
    monkeypatch.setattr(bus_lock, "lock_folder", lambda: tmp_path)
    BusLock("some bus").release()
    (lock,) = tmp_path.iterdir()
    lock.unlink()
    mine = tmp_path / "mine.txt"
    mine.write_text("keep this")
    if kind == "pipe":
        os.mkfifo(lock)
    else:
        lock.symlink_to(mine) if kind == "link" else lock.hardlink_to(mine)
    with pytest.raises(SinkError, match="can't use the lock file"):
        BusLock("some bus")
    assert mine.read_text() == "keep this"


@pytest.mark.skipif(sys.platform == "win32", reason="of POSIX permissions")
def test_the_lock_of_another_user_holds(tmp_path, monkeypatch):
    """The file may be one that can only be read."""
    monkeypatch.setattr(bus_lock, "lock_folder", lambda: tmp_path)
    lock, real = BusLock("some bus"), os.open
    assert [path.stat().st_mode & 0o777 for path in tmp_path.iterdir()] == [0o666]

    def of_another(path: str, flags: int, mode: int = 0o777) -> int:
        if flags & os.O_RDWR and not flags & os.O_EXCL:
            raise PermissionError(13, "Permission denied")
        return real(path, flags, mode)

    monkeypatch.setattr(os, "open", of_another)
    with pytest.raises(SinkError, match=f"process {os.getpid()}"):
        BusLock("some bus")
    lock.release()
    BusLock("some bus").release()


def test_what_can_not_be_opened_is_said_when_it_is_opened(make, tmp_path, hand, monkeypatch):
    with pytest.raises(SinkError, match="the cable was pulled"):
        make(prepare=lambda fake: fake.gone.set()).open({"right": hand}, {})
    dead = make(prepare=lambda fake: fake.hang.set())
    with monkeypatch.context() as short:
        short.setattr("smooth_operator.teleop.hardware.hardware_sink._OPENING_S", 0.2)
        with pytest.raises(SinkError, match=r"no answer for 0\.2 s while it was opened"):
            dead.open({"right": hand}, {})
    left = load_hand("mimic_p050", "left")
    with pytest.raises(ConfigError, match="add side=right or side=left"):
        make().open({"right": hand, "left": left}, {})
    with pytest.raises(ConfigError, match="has no left hand"):
        make(side="left").open({"right": hand}, {})
    with pytest.raises(ConfigError, match="is for a right hand"):
        make().open({"left": left}, {})
    with pytest.raises(ConfigError, match="no table of a hand at"):
        make(table=str(tmp_path / "none.toml")).open({"right": hand}, {})
    good = make()
    good.open({"right": hand}, {})
    good.close()  # none of the failures kept the bus


@pytest.mark.parametrize(
    "settings",
    [
        {"approach": 0.0},
        {"speed": 99.0},
        {"contact": 2.0},
        {"rate": 0},
        {"limit": 0},
        {"limit": float("inf")},
        {"limit": float("nan")},
        {"limit": -1},
    ],
)
def test_settings_out_of_range(settings):
    with pytest.raises(ConfigError, match="fake:"):
        FakeHandSink(**settings)
    with pytest.raises(ConfigError, match="contact_s"):
        GuardSettings(contact_s=-1.0)
