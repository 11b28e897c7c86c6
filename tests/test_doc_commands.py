"""Every command line of the documentation is understood, and those for users are run.

A page's lines run in order, in one folder with small inputs under the names that the page gives;
trackers and robots are their simulators, and pages are served without waiting for Ctrl-C.
"""

import itertools
import re
import shlex
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from doc_commands import CommandLine, command_lines
from doc_machine import (
    Devices,
    end_study_when_served,
    prepare,
    show_hand_to_camera,
    write_inputs,
    write_modules,
)
from test_cli_help import commands
from test_docs import PAGES, PROJECT, README, relative_name

from smooth_operator.cli.common_options import described
from smooth_operator.cli.options import EXAMPLES, parse
from smooth_operator.errors import ConfigError
from smooth_operator.teleop.components import SINKS, SOURCES, build_sink, build_source

LINES = {page: lines for page in PAGES if (lines := list(command_lines(page.read_text("utf-8"))))}
USERS = [
    page
    for page in LINES
    if page == README
    or page.relative_to(PROJECT).parts[:2]
    in {
        ("docs", "how-to"),
        ("docs", "tutorials"),
        ("docs", "robots"),
        ("docs", "reference"),
    }
]
QUICK = ("docs/how-to/lerobot.md", "docs/how-to/manus.md")
"""Pages that run in every run of the tests; the others once a week."""

ELSEWHERE = {
    r"retarget --dataset": "needs a recorded data set; tests/test_another_hand.py runs it",
    r"dataset dexycb/": "DexYCB and MANO have licences; packages/smooth_hand_datasets/tests does",
    r"teleop --source wave": "the plugin must be installed; tests/test_plugin.py runs it",
    r"calibrate --source webcam": "asks a person for a minute; tests/test_calibration.py runs it",
    r"study simulate my-study --operators 18": "takes minutes; research/tests runs it",
    r"study analyze my-study/simulated": "needs the trials of the line above",
    r"hardware check dynamixel": "asks about each motor; test_hardware_command.py answers",
    r"teleop .*dynamixel:": "needs the table of that check; test_dynamixel.py has one",
    r"teleop .*orca:": "the extra orca is not in the extra test",
    r"study metrics my-study": "needs takes of its trials; test_study_metrics.py has some",
}
"""Command lines that do not run here, and the reason."""


@pytest.mark.parametrize("page", LINES, ids=relative_name)
def test_command_lines_are_understood(page, tmp_path, monkeypatch):
    """By the command's own parser; and each source and sink by the loop's."""
    monkeypatch.chdir(tmp_path)
    write_modules(tmp_path, monkeypatch)
    for line in LINES[page]:
        command: Any = parse(line.words)
        for build, registry, texts in (
            (build_source, SOURCES, [getattr(command, "source", None)]),
            (build_sink, SINKS, getattr(command, "sink", ())),
        ):
            for text in filter(None, texts):
                if "." in text.partition(":")[0] or re.split("[:,]", text)[0] in registry.built_in:
                    build(text)


@pytest.mark.parametrize(
    "page",
    [
        pytest.param(page, marks=() if relative_name(page) in QUICK else pytest.mark.weekly)
        for page in USERS
    ],
    ids=relative_name,
)
def test_command_lines_run(page, machine, run):
    for line in LINES[page]:
        words = " ".join(line.words)
        if not any(re.match(pattern, words) for pattern in ELSEWHERE):
            status, out, err = run(*machine(line))
            fine = (0, 1) if words.startswith("hands check") else (0,)  # a hand of random sizes
            assert status in fine, f"{relative_name(page)}:{line.line}: {words}\n{out}\n{err}"


def test_examples_of_the_help_are_understood():
    texts = [EXAMPLES, *(described(kind) for _, kind in commands())]
    examples = [
        re.findall(r"^  smooth-operator (.*(?:\\?\n      --.*)*)", text, re.MULTILINE)
        for text in texts
    ]
    assert sum(map(len, examples)) > 60
    for example in itertools.chain(*examples):
        parse(shlex.split(example.replace("\\\n", " ")))


def test_what_does_not_run_is_in_a_page():
    texts = [" ".join(line.words) for page in USERS for line in LINES[page]]
    stale = [pattern for pattern in ELSEWHERE if not any(re.match(pattern, t) for t in texts)]
    assert stale == []


def test_an_unknown_option_is_found():
    (line,) = command_lines("```bash\nsmooth-operator retarget a.npz --nope 3   # text\n```\n")
    assert line.words == ["retarget", "a.npz", "--nope", "3"]
    with pytest.raises(ConfigError, match="unknown option '--nope'"):
        parse(line.words)


@pytest.fixture
def machine(
    page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Iterator[Callable[[CommandLine], list[str]]]:
    """A machine with recordings and devices; gives the arguments with which a command ends.

    The sections of a how-to page and of a reference have a folder each.
    """
    text = page.read_text("utf-8")
    monkeypatch.setenv("SMOOTH_OPERATOR_HANDS", str(tmp_path / "hands of the user"))
    monkeypatch.setattr("builtins.input", lambda question="": "q")
    monkeypatch.setattr("webbrowser.open", lambda *_, **__: True)
    monkeypatch.setattr("smooth_operator.teleop.pages.viser_server.PageServer.wait", lambda _: None)
    if "webcam" in text or "video:" in text:
        show_hand_to_camera(tmp_path, monkeypatch)
    end_study_when_served(monkeypatch)
    devices = Devices(tmp_path, monkeypatch)

    def enter(section: int) -> None:
        folder = tmp_path / str(section)
        if not folder.exists():
            folder.mkdir()
            monkeypatch.chdir(folder)
            write_modules(folder, monkeypatch)
            write_inputs(folder, text)

    def arguments(line: CommandLine) -> list[str]:
        as_one = page == README or page.parent.name == "tutorials"
        enter(0 if as_one else sum(t.startswith("## ") for t in text.splitlines()[: line.line]))
        prepare(line.words)
        words = [word.replace("REPOSITORY/FILE", "REPOSITORY/my_hand.urdf") for word in line.words]
        words = [re.sub("^/nfs/", "nfs/", w).replace("192.168.1.20", "127.0.0.1") for w in words]
        if words[0] == "teleop":
            if "--duration" in words:
                del words[(at := words.index("--duration")) : at + 2]
            added = ["--duration", "1", "--port", "0", "--no-browser"]
        elif words[0] in ("view", "demo") or words[:2] == ["hands", "show"]:
            added = ["--port", "0", "--no-browser"]
        elif words[:2] == ["hardware", "monitor"]:
            added = ["--seconds", "0.3"]
        elif words[:2] == ["study", "power"]:
            added = ["--studies", "2"]
        elif words[:2] == ["study", "run"]:
            added = ["--port", "0"]
        elif words[:2] in (["hands", "remove"], ["study", "erase"]):
            added = ["--yes"]
        else:
            added = []
        return [devices.put(word) for word in words] + added

    yield arguments
    devices.close()
