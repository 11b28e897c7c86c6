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
print(os.name == "nt" or signal.getsignal(signal.SIGHUP) is signal.SIG_DFL)
"""


def probe(folder: Path, ignore_interrupt: bool) -> list[str]:
    """What a run that is started by a user with hands of their own sees at its collection."""
    hands = folder / "smooth-operator" / "hands"
    hands.mkdir(parents=True)
    (hands / "mine.right.toml").write_text("")
    outside = {k: v for k, v in os.environ.items() if not k.startswith("SMOOTH_OPERATOR_")}
    homes = dict.fromkeys(("HOME", "USERPROFILE", "XDG_CONFIG_HOME", "APPDATA"), str(folder))
    switch = {"SMOOTH_OPERATOR_HANDS": str(hands)}
    numbers = [signal.SIGINT, *([] if os.name == "nt" else [signal.SIGHUP])]
    before = [signal.getsignal(number) for number in numbers]
    if ignore_interrupt:
        for number in numbers:
            signal.signal(number, signal.SIG_IGN)  # a child inherits it, as under nohup
    try:
        done = python("-c", PROBE, str(TESTS.parent), env=outside | homes | switch, check=True)
    finally:
        for number, handler in zip(numbers, before, strict=True):
            signal.signal(number, handler)
    return done.stdout.splitlines()


def test_the_users_hands_are_not_among_the_tests_hands(tmp_path):
    assert probe(tmp_path, ignore_interrupt=False)[0] == str(sorted(hand_names()))
    assert "mine" not in hand_names()


@pytest.mark.skipif(os.name == "nt", reason="Windows has no SIGINT that is inherited as ignored")
def test_ctrl_c_is_heard_where_the_run_was_started_with_it_ignored(tmp_path):
    assert probe(tmp_path, ignore_interrupt=True)[1:] == ["True", "True"]


def test_long_files_are_there():
    folders = (TESTS, *TESTS.parent.glob("packages/*/tests"))
    names = {path.name for folder in folders for path in folder.glob("test_*.py")}
    assert set(LONG_FILES) - names == set()
