"""The tests' own environment: nothing of the machine's user reaches a run, from collection on."""

import os
import signal
from pathlib import Path

import pytest
from processes import python

from conftest import LONG_FILES
from smooth_operator.hands.registry import hand_names

TESTS = Path(__file__).parent
PROBE = """
import os, signal, sys
sys.path.insert(0, sys.argv[1])
import conftest
from smooth_operator.hands.registry import hand_names
print(sorted(hand_names()))
print(signal.getsignal(signal.SIGINT) is signal.default_int_handler)
print(signal.getsignal(signal.SIGHUP) is signal.SIG_DFL)
"""


@pytest.mark.skipif(os.name == "nt", reason="Windows has no SIGINT that is inherited as ignored")
def test_the_users_hands_and_ignored_signals_do_not_reach_the_tests(tmp_path):
    hands = tmp_path / "smooth-operator" / "hands"
    hands.mkdir(parents=True)
    (hands / "mine.right.toml").write_text("")
    outside = {k: v for k, v in os.environ.items() if not k.startswith("SMOOTH_OPERATOR_")}
    homes = dict.fromkeys(("HOME", "USERPROFILE", "XDG_CONFIG_HOME", "APPDATA"), str(tmp_path))
    switch = {"SMOOTH_OPERATOR_HANDS": str(hands)}
    # a child inherits them, as under nohup
    before = {n: signal.signal(n, signal.SIG_IGN) for n in (signal.SIGINT, signal.SIGHUP)}
    try:
        done = python("-c", PROBE, str(TESTS.parent), env=outside | homes | switch, check=True)
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    assert done.stdout.splitlines() == [str(sorted(hand_names())), "True", "True"]
    assert "mine" not in hand_names()


def test_long_files_are_there():
    folders = (TESTS, *TESTS.parent.glob("packages/*/tests"))
    names = {path.name for folder in folders for path in folder.glob("test_*.py")}
    assert set(LONG_FILES) - names == set()
