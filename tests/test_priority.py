"""The loop's process goes first where it may, and says so; children don't."""

import subprocess
import sys

import pytest
from live_time import PATIENCE_S

ASKING = """
import os, threading
from smooth_operator.teleop.runtime.priority import going_first
done = threading.Event()
other = threading.Thread(target=done.wait)
other.start()
first = going_first()
got = first.__enter__()
late = threading.Thread(target=done.wait)
late.start()
child = int(os.popen(f"{os.sys.executable} -c 'import os; print(os.sched_getscheduler(0))'").read())
of = lambda thread: os.sched_getscheduler(thread.native_id) & ~os.SCHED_RESET_ON_FORK
loop = os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK
before = os.sched_getparam(0).sched_priority > os.sched_getparam(other.native_id).sched_priority
print(got, loop == os.SCHED_RR, of(other) == os.SCHED_RR, of(late) == os.SCHED_RR, child, before)
first.__exit__(None, None, None)
print(os.sched_getscheduler(0) == os.sched_getscheduler(other.native_id) == os.SCHED_OTHER)
done.set()
"""


@pytest.mark.skipif(sys.platform != "linux", reason="other systems have no such scheduling")
@pytest.mark.parametrize("allowed", [True, False])
def test_what_was_granted_is_what_is_said(allowed):
    # a limit of 0 takes the right from whoever has no capability, and root gives that up
    drop = [] if allowed else ["prlimit", "--rtprio=0:0", "setpriv", "--bounding-set=-sys_nice"]
    command = [*drop, sys.executable, "-c", ASKING]
    try:
        found = subprocess.run(
            command, capture_output=True, text=True, check=False, timeout=PATIENCE_S
        )
    except FileNotFoundError:
        pytest.skip("setpriv, which takes the right away, is not installed")
    if found.returncode != 0 and drop and "setpriv" in found.stderr:
        pytest.skip(f"setpriv can't take the right away here: {found.stderr.strip()}")
    assert found.returncode == 0, found.stderr
    got, *facts = found.stdout.split()
    if not allowed:
        assert got == "normal"
    if got == "real-time":
        assert facts == ["True", "True", "False", "0", "True", "True"]
    else:
        assert got == "normal"
        assert facts == ["False", "False", "False", "0", "False", "True"]


def test_elsewhere_nothing_is_tried(monkeypatch):
    from smooth_operator.teleop.runtime import priority

    monkeypatch.setattr(priority.sys, "platform", "darwin")
    with priority.going_first() as got:
        assert got == "normal"
