"""Sinks of real hands on a hand in memory: opening, the lock of the bus, a bus that hangs."""

import contextlib
import math
import os
import subprocess
import sys
import textwrap
from collections.abc import Callable, Iterator

import pytest
from fake_hand import FakeHand, FakeHandSink, write_fake_table
from live_time import PATIENCE_S, until
from processes import python
from ticks import make_tick

from smooth_operator import load_hand
from smooth_operator.errors import ConfigError, SinkError
from smooth_operator.teleop.components import build_sink
from smooth_operator.teleop.sinks.sink import SinkRunner
from smooth_operator_devices.hands import bus_lock
from smooth_operator_devices.hands.bus_lock import BusLock
from smooth_operator_devices.hands.guard import GuardSettings


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


def test_a_slow_bus_is_counted_and_a_hanging_one_delays_nobody(make, tmp_path, hand):
    hanging, fine = make(), make(port=str(tmp_path / "other"))
    runner = SinkRunner([hanging, fine])
    runner.open({"right": hand}, {})
    tick = make_tick(hand)
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


def test_two_programs_on_one_bus(make, tmp_path, hand):
    first = make()
    first.open({"right": hand}, {})
    with pytest.raises(SinkError, match="is in use by another run of smooth-operator"):
        make().open({"right": hand}, {})
    first.close()
    code = f"""
        from smooth_operator_devices.hands.bus_lock import BusLock
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


def test_a_bus_is_free_while_its_device_is_lost(make, tmp_path, hand, monkeypatch):
    """The port of a hand that is unplugged may be the next one that is plugged in."""
    monkeypatch.setattr("smooth_operator_devices.hands.hardware_sink._RETRY_S", 0.05)
    sink = make()
    sink.open({"right": hand}, {})
    sink.made[-1].gone.set()
    until(lambda: "the cable was pulled" in sink.note)
    taken: list[BusLock] = []

    def take() -> bool:
        with contextlib.suppress(SinkError):  # it was just retrying
            taken.append(BusLock(str(tmp_path / "port")))
        return bool(taken)

    until(take)
    sink.made[-1].gone.clear()
    until(lambda: "in use by another run" in sink.note)
    taken[0].release()
    until(lambda: sink.state("right"))


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
        *("wuji:1", "wuji:2", "can:virtual:a", "can:virtual:b", "COM3", "COM4"),
        *("tcp:127.0.0.1:6000", "tcp:127.0.0.1:6001", "tcp:127.0.0.2:6000"),
        *(str(tmp_path / name) for name in "ab"),
    )
    locks = [BusLock(bus) for bus in buses]
    for lock in locks:
        lock.release()
        lock.release()


def test_the_lock_is_the_same_with_another_folder_of_temporary_files(tmp_path, monkeypatch):
    bus = f"any:{tmp_path.name}-{os.getpid()}"
    lock = BusLock(bus)
    (tmp_path / "other").mkdir()
    code = f"from smooth_operator_devices.hands.bus_lock import BusLock; BusLock({bus!r})"
    other = python(
        "-c",
        code,
        env=os.environ | dict.fromkeys(("TMPDIR", "TEMP", "TMP"), str(tmp_path / "other")),
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
        short.setattr("smooth_operator_devices.hands.hardware_sink._OPENING_S", 0.2)
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
        *({"approach": 0.0}, {"speed": 99.0}, {"contact": 2.0}, {"rate": 0}),
        *({"limit": limit} for limit in (0, -1, math.inf, math.nan)),
    ],
    ids=str,
)
def test_settings_out_of_range(settings):
    with pytest.raises(ConfigError, match="fake:"):
        FakeHandSink(**settings)


@pytest.mark.parametrize("value", [math.inf, -math.inf, math.nan, 1e300, -1.0])
@pytest.mark.parametrize("name", ["approach", "speed", "contact", "contact_s"])
def test_settings_of_the_guard_are_finite_and_in_range(name, value):
    with pytest.raises(ConfigError, match=name):
        GuardSettings(**{name: value})
