"""Many tasks at once: order, failures, deaths, Ctrl-C, and nothing left behind."""

import multiprocessing
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from live_time import PATIENCE_S, until
from processes import python

from smooth_operator.errors import ConfigError, MissingExtraError, WorkerError
from smooth_operator.extras import install_command
from smooth_operator.parallel import (
    PersistentPool,
    TaskResult,
    run_tasks,
    usable_cores,
)

needs_signals = pytest.mark.skipif(sys.platform == "win32", reason="Windows has no SIGKILL")


# What the workers do; they import this module.


def square(x: float) -> float:
    return x * x


def misbehave(how: str) -> Any:
    if how == "raise":
        raise ValueError("the first line\nand the second")
    if how == "exit":
        sys.exit(3)
    if how == "die":
        os.kill(os.getpid(), signal.SIGKILL)
    if how == "unsendable":
        return lambda: None
    if how == "own error":
        raise MissingExtraError("this", "that")
    return how


def die_at_first(marker: Path) -> str:
    if not marker.exists():
        marker.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return "alive"


def die_between_two_parts(size: int) -> bytes:
    """A result whose worker is killed when the first part of a message of two is sent."""
    from multiprocessing.connection import Connection

    whole = Connection._send_bytes

    def die(connection: Connection, message: bytes) -> None:
        if len(message) <= 4096:  # a pipe takes it as one
            whole(connection, message)
        else:
            os.write(connection.fileno(), len(message).to_bytes(4, "big"))
            os.kill(os.getpid(), signal.SIGKILL)

    Connection._send_bytes = die
    return bytes(size)


def wait_and_clean_up(marker: Path | None) -> None:
    if marker is None:
        return
    try:  # the signal may come as soon as the marker is there
        marker.touch()
        time.sleep(PATIENCE_S)
    finally:
        marker.unlink()


class Unreadable:
    """Can be sent, and then not read."""

    def __reduce__(self) -> tuple[Any, ...]:
        return (int, ("not a number",))


def by_index(results: Iterator[TaskResult[Any]]) -> list[TaskResult[Any]]:
    return sorted(results, key=lambda result: result.index)


@pytest.fixture(autouse=True)
def _nothing_left_behind() -> Iterator[None]:
    yield
    assert multiprocessing.active_children() == []


@pytest.mark.parametrize("workers", [0, 1, 3])
def test_every_task_has_its_result(workers):
    tasks = [0.1 * i for i in range(7)]
    results = by_index(run_tasks(square, tasks, workers=workers))
    assert [result.index for result in results] == list(range(7))
    assert [result.value for result in results] == [x * x for x in tasks]
    assert all(result.error is None and result.attempts == 1 for result in results)
    assert list(run_tasks(square, [], workers=workers)) == []
    large = np.random.default_rng(0).normal(size=(200, 1000))  # more than a pipe holds
    (result,) = run_tasks(np.asarray, [large], workers=workers)
    np.testing.assert_array_equal(result.value, large)


@needs_signals
@pytest.mark.parametrize("workers", [0, 2])
def test_what_goes_wrong_with_one_touches_no_other(workers):
    tasks: list[Any] = ["a", "raise", "b", "exit", "own error", "c"]
    expected = [
        None,
        "ValueError: the first line and the second",
        None,
        "SystemExit: 3",
        f"MissingExtraError: this needs the extra 'that': {install_command('that')}",
        None,
    ]
    if workers:
        tasks += ["die", "unsendable", lambda: None, Unreadable(), "d"]
        died = "WorkerDied: its worker process died 2 times (signal SIGKILL)"
        unread = "ValueError: invalid literal for int"
        unsent = ("the result can't be sent back", "the task can't be sent")
        expected += [died, *unsent, unread, None]
    results = by_index(run_tasks(misbehave, tasks, workers=workers, retries=1))
    for result, reason, task in zip(results, expected, tasks, strict=True):
        if reason is None:
            assert (result.value, result.error) == (task, None)
        else:
            assert result.value is None
            assert (result.error or "").startswith(reason)
            assert "\n" not in (result.error or "")
        assert result.attempts == (2 if task == "die" else 1)


@needs_signals
def test_a_death_costs_an_attempt_and_nothing_else(tmp_path):
    tasks = [tmp_path / name for name in "abc"]
    results = by_index(run_tasks(die_at_first, tasks, workers=2))
    assert [(r.value, r.error, r.attempts) for r in results] == [("alive", None, 2)] * 3
    sizes = [10, 4096, 100_000]  # killed while the result is sent
    results = by_index(run_tasks(die_between_two_parts, sizes, workers=2, retries=0))
    assert [len(r.value or b"") if r.error is None else r.error[:10] for r in results] == sizes


@needs_signals
def test_a_kill_from_outside_costs_an_attempt():
    running = run_tasks(time.sleep, [0.3] * 6, workers=2)
    results = [next(running)]
    os.kill(multiprocessing.active_children()[0].pid or 0, signal.SIGKILL)
    results = by_index(iter([*results, *running]))
    assert [(result.index, result.error) for result in results] == [(k, None) for k in range(6)]
    assert sum(result.attempts for result in results) == 7


def test_closing_stops_workers_that_can_still_clean_up(tmp_path):
    running = run_tasks(wait_and_clean_up, [None, tmp_path / "a", tmp_path / "b"], workers=3)
    next(running)
    until(lambda: len(list(tmp_path.iterdir())) == 2)
    running.close()
    assert list(tmp_path.iterdir()) == []


SCRIPT = """
import sys
from pathlib import Path
from smooth_operator.parallel import run_tasks
from smooth_operator.signals import ended_by_signals
from test_parallel import wait_and_clean_up

if __name__ == "__main__":
    folder = Path(sys.argv[1])
    try:
        with ended_by_signals():
            list(run_tasks(wait_and_clean_up, [folder / "a", folder / "b"], workers=2))
    except KeyboardInterrupt:
        print("interrupted")
"""


@needs_signals
@pytest.mark.parametrize(
    "how", ["SIGINT", pytest.param("SIGHUP", marks=pytest.mark.weekly), "SIGKILL"]
)
def test_signals_and_a_killed_parent_leave_no_process(tmp_path, how):
    script, folder = tmp_path / "script.py", tmp_path / "folder"
    script.write_text(SCRIPT, encoding="utf-8")
    folder.mkdir()
    with subprocess.Popen(
        [sys.executable, str(script), str(folder)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        env={**os.environ, "PYTHONPATH": os.pathsep.join([str(Path(__file__).parent), *sys.path])},
    ) as process:
        until(lambda: len(list(folder.iterdir())) == 2)
        if how != "SIGKILL":
            # as a terminal does: the workers get it as well
            os.killpg(process.pid, getattr(signal, how))
            out, err = process.communicate(timeout=PATIENCE_S)
            assert (out, err, process.returncode) == ("interrupted\n", "", 0)
            assert list(folder.iterdir()) == []
        else:
            process.kill()
            process.communicate(timeout=PATIENCE_S)
    until(lambda: not group_alive(process.pid))


def group_alive(group: int) -> bool:
    try:
        os.killpg(group, 0)
    except ProcessLookupError:
        return False
    return True


PROBE = """
import os
import re
import jax

def cores_and_threads(_):
    jax.numpy.ones((300, 300)).sum().block_until_ready()
    threads = [open(f"/proc/self/task/{i}/comm").read() for i in os.listdir("/proc/self/task")]
    return len(os.sched_getaffinity(0)), threads.count("tf_XLAEigen\\n")
"""


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="needs Linux")
def test_a_worker_has_one_thread_and_all_cores(tmp_path, monkeypatch):
    if usable_cores() < 2:
        pytest.skip("needs two cores")
    (tmp_path / "probe_of_threads.py").write_text(PROBE, encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    import probe_of_threads

    (result,) = run_tasks(probe_of_threads.cores_and_threads, [0], workers=1)
    # Not tied to the core that it started on: somebody else may need that one.
    assert result.value == (usable_cores(), 1)


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        ({"workers": -1}, "workers must be 0 or more, not -1"),
        ({"retries": -1}, "retries must be 0 or more, not -1"),
        ({"workers": 0, "cluster": "local"}, "a cluster needs at least one worker"),
        ({"cluster": "auto"}, re.escape(install_command("cluster"))),
        ({"function": lambda x: x}, "function at the top level of an importable module"),
    ],
)
def test_impossible_requests(options, reason, monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises((ConfigError, MissingExtraError), match=reason):
        run_tasks(**{"function": square, "tasks": [1.0], "workers": 1} | options)


UNGUARDED = """
from smooth_operator.parallel import run_tasks
print([r.value for r in run_tasks(abs, [-1], workers=1)])
"""
GUARDED = """
import os, sys
from smooth_operator.parallel import run_tasks
if __name__ == "__main__":
    print([r.value for r in run_tasks(abs, [-1] * 9, workers=1)])
else:
    """
GUARD = "if __name__ =="


@pytest.mark.parametrize(
    ("code", "reason", "written"),
    [
        (UNGUARDED, "(exit status 1)", "bootstrapping phase"),
        (GUARDED + "sys.exit(7)", "(exit status 7)", ""),
    ],
)
def test_workers_that_do_not_start_say_why(tmp_path, code, reason, written):
    script = tmp_path / "script.py"
    script.write_text(code, encoding="utf-8")
    done = python(str(script))
    assert done.returncode != 0
    message = done.stderr.strip().splitlines()[-1]
    assert WorkerError.__name__ in message
    assert reason in message
    assert len(message) < 500
    assert GUARD in message
    assert done.stderr.count(written) >= 3  # of each that died


@pytest.mark.weekly
def test_ray_is_the_pool(tmp_path):
    pytest.importorskip("ray", reason="needs ray: in the clone, pip install '.[cluster]'")
    marker = tmp_path / "marker"
    tasks: list[Any] = ["a", "raise", marker, "own error", "die"]
    before = print, sys.excepthook, signal.getsignal(signal.SIGTERM)
    results = by_index(run_tasks(on_ray, tasks, workers=2, cluster="local"))
    assert before == (print, sys.excepthook, signal.getsignal(signal.SIGTERM))
    assert [r.value for r in results] == ["a", None, "alive", None, None]
    assert [r.attempts for r in results] == [1, 1, 2, 1, 3]
    assert (results[4].error or "").startswith("WorkerDied: its worker process died 3")
    assert results[1].error == "ValueError: the first line and the second"
    assert (results[3].error or "").startswith("MissingExtraError: this needs")


def on_ray(task: Any) -> Any:
    return die_at_first(task) if isinstance(task, Path) else misbehave(task)


def whoami(task: object) -> tuple[int, object]:
    if task == "die":
        os.kill(os.getpid(), signal.SIGKILL)
    if task == "raise":
        raise ValueError("no")
    return os.getpid(), task


@needs_signals
def test_workers_stay_and_those_that_die_are_replaced():
    with PersistentPool(whoami, 2, retries=0) as pool:
        first = sorted(pool.run([1, 2, 3]), key=lambda r: r.index)
        assert [r.value[1] for r in first if r.value] == [1, 2, 3]
        second = {r.index: r for r in pool.run(["a", "die", "raise", "b"])}
        assert sorted(second) == [0, 1, 2, 3]
        assert "died" in str(second[1].error)
        assert second[2].error == "ValueError: no"
        assert list(pool.run([])) == []
        # not the workers that have answered: one may have had the raising task alone, or none
        known = {process.pid for process in multiprocessing.active_children()}
        third = list(pool.run([7]))
        assert third[0].value[1] == 7
        assert third[0].value[0] in known  # nobody new was needed
    with pytest.raises(ProcessLookupError):
        os.kill(third[0].value[0], 0)
    with PersistentPool(whoami, 0) as pool:
        assert {r.value for r in pool.run([1, 2])} == {(os.getpid(), 1), (os.getpid(), 2)}
