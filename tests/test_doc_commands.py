"""Every command line of the documentation is understood, and those for users are run.

A page's lines run in order, in one folder with small inputs under the names that the page gives,
and pages are served without waiting for Ctrl-C.
"""

import itertools
import re
import shlex
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Final, NamedTuple

import dataset_files
import numpy as np
import pytest
from discovery_hands import make_hand, urdf
from test_cli_help import commands
from test_docs import PAGES, PROJECT, README, relative_name

from smooth_operator import SyntheticOperator
from smooth_operator.cli import main
from smooth_operator.cli.common_options import described
from smooth_operator.cli.options import EXAMPLES, parse
from smooth_operator.hands.registry import hand_names
from smooth_operator.teleop.components import SINKS, SOURCES, build_sink, build_source

_BLOCK: Final = re.compile(r"^(?P<fence> *`{3,})bash\n(?P<code>.*?)^(?P=fence) *$", re.M | re.S)
_COMMAND: Final = re.compile(r"^.*?(?<![\w-])smooth-operator ((?:.*\\\n)*.*)$", re.M)
_SHELL: Final = {"$((SLURM_ARRAY_TASK_ID + 1))/64": "1/1", "$SLURM_CPUS_PER_TASK": "2"}
"""What the shell of a job puts in place of an expression."""


class CommandLine(NamedTuple):
    """Number of the first line of a command in a page, and the arguments of it."""

    line: int
    words: list[str]


def command_lines(text: str) -> Iterator[CommandLine]:
    """The command lines in the shell blocks of a page, in order."""
    for block in _BLOCK.finditer(text):
        for match in _COMMAND.finditer(block["code"]):
            at = block.start("code") + match.start()
            yield CommandLine(text.count("\n", 0, at) + 1, _words(match[1].replace("\\\n", " ")))


def _words(command: str) -> list[str]:
    for expression, value in _SHELL.items():
        command = command.replace(expression, value)
    if command.count('"') % 2:  # the command is all that is between two quotes
        command = command[: command.rindex('"')]
    words = shlex.split(command, comments=True)
    end = min((words.index(mark) for mark in ("&&", "|", ">") if mark in words), default=None)
    return words[:end]


_MODULES: Final = {
    "tracker": """
from dataclasses import dataclass
from smooth_operator.teleop import ThreadedSource

@dataclass(eq=False)
class Tracker(ThreadedSource):
    port: int = 0
    label = "my tracker"

    def run(self, running):
        running.stopping.wait()
""",
    "driver": """
from dataclasses import dataclass
from smooth_operator.teleop import Sink

@dataclass(eq=False)
class MySink(Sink):
    address: str = ""
    rate: float = 0.0
    label = "my robot"

    def open(self, hands, config):
        pass

    def send(self, tick):
        pass

    def close(self):
        pass
""",
    "hands": """
from smooth_operator.hands.registry import MODELS
SPEC = MODELS / "leap_hand.right.toml"
""",
    "methods": """
from smooth_operator.retargeting.presets import PRESETS as BUILT_IN
MyConfig = BUILT_IN["joint_angle"]["default"]
PRESETS = {"quick": MyConfig}
""",
}
"""Modules of the package ``mylab``, which pages name as the reader's own."""


def write_modules(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Writes the package ``mylab``."""
    (folder / "mylab").mkdir(exist_ok=True)
    for name, text in _MODULES.items():
        (folder / "mylab" / f"{name}.py").write_text(text)
    monkeypatch.syspath_prepend(folder)


def write_inputs(folder: Path, text: str) -> None:
    """Writes the recordings, data sets and models that a page names."""
    recording = SyntheticOperator(seed=3, rate_hz=30.0).record(20.0)
    stamped = {"landmarks": recording.landmarks, "timestamps": recording.stamps, "side": "right"}
    (folder / "recordings").mkdir()
    for name in ("glove", "train", "clip", "recordings/a"):
        np.savez(folder / f"{name}.npz", **stamped)
    if "sample hand.npz" not in text:
        np.savez(folder / "hand.npz", **stamped)
    judge = SyntheticOperator(seed=5, rate_hz=30.0).record(10.0)
    np.savez(folder / "judge.npz", landmarks=judge.landmarks, timestamps=judge.stamps, side="right")
    np.savez(folder / "video.npz", recording.landmarks[:300])
    np.save(folder / "video.npy", recording.landmarks[300:])
    np.save(folder / "landmarks.npy", recording.landmarks * (-1, 1, 1))
    dataset_files.avp_file(folder / "tracking.jsonl")
    dataset_files.hts_file(folder / "hands.hts", sides=["right"])
    (folder / "my_hand.urdf").write_text(urdf(make_hand(0, turned=False).parts))
    (folder / "REPOSITORY").mkdir()
    (folder / "REPOSITORY" / "my_hand.urdf").write_text(urdf(make_hand(0, turned=False).parts))
    if "egodex" in text:
        for place in (folder / "egodex", folder / "nfs" / "egodex"):
            place.mkdir(parents=True)
            dataset_files.egodex_file(place / "0.hdf5")
    for draft in re.findall(r"```toml\n(format = 1\nname = .*?)```", text, re.DOTALL):
        (folder / "draft.toml").write_text(draft)


def prepare(words: list[str]) -> None:
    """Makes what somebody has made before a command: a take, a profile, an added hand."""
    before: list[list[str]] = []
    for word in words:
        take = re.search(r"takes/(take-001[.\w]*)", word)
        if take and not (path := Path("takes") / take[1]).exists():
            path.parent.mkdir(exist_ok=True)
            sink = f"record:{path}"
            seconds = "3" if words[0] == "edit" else "1"
            before.append(["teleop", "--sink", sink, "--duration", seconds, "--no-view"])
        if word == "operator.json" and "--operator" in words and not Path(word).exists():
            before.append(["calibrate", "glove.npz", "--output", word])
    if "my_hand" in words and "add" not in words and "my_hand" not in hand_names():
        before.append(["hands", "add", "my_hand.urdf"])
    if words[:2] == ["study", "power"] and not Path("my-study").exists():
        before.append(["study", "new", "my-study", "--from", "draft.toml"])
    for command in before:
        assert main(command) == 0, command


LINES = {page: lines for page in PAGES if (lines := list(command_lines(page.read_text("utf-8"))))}
USERS = [
    page
    for page in LINES
    if page == README
    or page.relative_to(PROJECT).parts[:2]
    in {("docs", "how-to"), ("docs", "tutorials"), ("docs", "robots"), ("docs", "reference")}
]
QUICK = ("docs/how-to/lerobot.md", "docs/how-to/manus.md")
"""Pages that run in every run of the tests; the others once a week."""

DEVICES = "leap|dynamixel|feetech|ability|allegro|inspire|linker|revo2|wuji|orca"
ELSEWHERE = {
    r"retarget --dataset": "needs a recorded data set; test_another_hand.py runs it",
    r"dataset dexycb/": "DexYCB and MANO have licences; packages/smooth_hand_datasets/tests does",
    r"teleop --source wave": "the plugin must be installed; tests/test_plugin.py runs it",
    r"convert \S*\.mp4": "needs a video; tests/test_webcam.py has one",
    r"teleop --source (realsense|oak)": "needs a depth camera; test_depth_cameras.py has some",
    r"teleop --camera 0": "needs a camera; tests/test_cameras.py has some",
    r"study (?!new|power)": "needs trials; packages/smooth_operator_study/tests has some",
    r"hardware": "needs a real hand; packages/smooth_operator_devices/tests simulates them",
    rf"teleop .*--sink ({DEVICES})\b": "needs a real hand, in the same way",
    r"calibrate --(wrist-)?source": "asks a person for a minute; tests/test_calibration.py runs it",
    r"teleop --source (bvh|rokoko|openxr|isaac)": "needs a tracker of a maker, in the same way",
    r"bench manus_right": "needs the recordings of the project's benchmark",
    r".*tuned\.toml": "needs the preset that a program of the page writes",
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


@pytest.fixture
def machine(
    page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Callable[[CommandLine], list[str]]:
    """A machine with recordings; gives the arguments with which a command ends.

    The sections of a how-to page and of a reference have a folder each.
    """
    text = page.read_text("utf-8")
    monkeypatch.setenv("SMOOTH_OPERATOR_HANDS", str(tmp_path / "hands of the user"))
    monkeypatch.setattr("builtins.input", lambda question="": "q")
    monkeypatch.setattr("webbrowser.open", lambda *_, **__: True)
    monkeypatch.setattr("smooth_operator.teleop.pages.viser_server.PageServer.wait", lambda _: None)

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
        words = ["synthetic" if re.match("webcam|video:", word) else word for word in words]
        if words[0] == "teleop":
            if "--duration" in words:
                del words[(at := words.index("--duration")) : at + 2]
            added = ["--duration", "1", "--port", "0", "--no-browser"]
        elif words[0] in ("view", "demo") or words[:2] == ["hands", "show"]:
            added = ["--port", "0", "--no-browser"]
        elif words[:2] == ["study", "power"]:
            added = ["--studies", "2"]
        elif words[:2] == ["hands", "remove"]:
            added = ["--yes"]
        else:
            added = []
        return words + added

    return arguments
