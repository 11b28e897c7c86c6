"""Workers that stay from one list of tasks to the next."""

import multiprocessing
import os
import signal
import sys

import pytest

from smooth_operator.errors import ConfigError
from smooth_operator.parallel import PersistentPool


def whoami(task: object) -> tuple[int, object]:
    if task == "die":
        os.kill(os.getpid(), signal.SIGKILL)
    if task == "raise":
        raise ValueError("no")
    return os.getpid(), task


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no SIGKILL")
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


def test_without_workers_it_runs_here():
    with PersistentPool(whoami, 0) as pool:
        assert [r.value for r in pool.run([1, 2])] == [(os.getpid(), 1), (os.getpid(), 2)]
    with pytest.raises(ConfigError):
        PersistentPool(whoami, -1)
