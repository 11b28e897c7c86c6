"""Help of the commands, and words that are no command or option."""

import inspect
import io
import re
import sys
from collections.abc import Iterator
from typing import Any

import pytest

from smooth_operator.cli import main
from smooth_operator.cli.common_options import Group, unwrapped
from smooth_operator.cli.options import COMMANDS
from smooth_operator.landmarks import LAYOUTS
from smooth_operator.plugins import Entry


def commands() -> Iterator[tuple[tuple[str, ...], Any]]:
    """Words and options of each command, those of the repository's other distributions too."""
    for name in [*COMMANDS.built_in, *COMMANDS.elsewhere]:
        kind = COMMANDS.load(name)
        yield tuple(name.split(".")), kind
        if issubclass(kind, Group):
            yield from (((name, inner), options) for inner, options in kind.members().items())


def printed(monkeypatch: pytest.MonkeyPatch, *words: str) -> str:
    """What a command prints where UTF-8 is understood, as boxes are then drawn."""
    stream = io.TextIOWrapper(io.BytesIO(), "utf-8")
    with monkeypatch.context() as patch:
        patch.setattr(sys, "stdout", stream)
        assert main(words) == 0
    stream.seek(0)
    return stream.read()


def test_every_command_names_the_function_that_takes_its_options():
    for words, kind in commands():
        if issubclass(kind, Group):
            continue
        work = Entry(kind.work).load()
        (options,) = inspect.signature(work).parameters.values()
        assert issubclass(kind, inspect.get_annotations(work, eval_str=True)[options.name]), words


@pytest.mark.parametrize("width", [80, 120])
def test_help_fits_the_terminal_and_a_page_or_two(width, monkeypatch):
    monkeypatch.setenv("COLUMNS", str(width))
    for words, _ in [((), None), *commands(), (("teleop", "--help-all"), None)]:
        text = printed(monkeypatch, *words, "--help")
        longest = max(text.splitlines(), key=len)
        assert len(longest) <= width, longest
        short = words in {(name,) for name in ("dataset", "retarget", "demo", "bench", "study")}
        assert not short or len(text.split()) <= 700, words


def test_rare_options_are_in_the_long_help_alone(monkeypatch):
    short, whole = (printed(monkeypatch, "teleop", word) for word in ("--help", "--help-all"))
    assert len(short.split()) <= 850  # 39 sources and sinks are a third of it
    assert "--help-all" in short
    listed = set(re.findall(r"^│ (--[a-z][\w.-]*)", short, re.MULTILINE))
    assert {"--source", "--sink", "--hand", "--method", "--estop"} <= listed
    rest = set(re.findall(r"^│ (--[a-z][\w.-]*)", whole, re.MULTILINE)) - listed
    assert {"--priority", "--limits.velocity", "--safety.stale-s"} <= rest


def test_the_help_of_a_group_names_the_commands_of_other_distributions(monkeypatch):
    """Whether they are installed or not: both work from the same words."""
    text = " ".join(printed(monkeypatch, "study", "--help").split())
    assert "In another distribution: smooth-operator study simulate:" in text
    assert "In another distribution" not in printed(monkeypatch, "hands", "--help")


def test_no_option_has_none_for_a_default(monkeypatch):
    """The text says what happens without a value: the word None is no answer."""
    for words, kind in commands():
        if not issubclass(kind, Group):
            text = printed(monkeypatch, *words, "--help-all")
            assert not re.search(r"\(default: (None|False|)\)", text)
            orders = LAYOUTS.keys() - {"mediapipe", "openpose"}
            if words[0] in ("retarget", "view", "convert", "calibrate"):
                assert orders <= set(re.findall(r"[a-z_]+", text)), words
    for words in (("hands", "add"), ("study", "new")):
        assert "(repeatable)" in printed(monkeypatch, *words, "--help-all")
    assert "(default: mimic_p050)" in " ".join(printed(monkeypatch, "demo", "--help-all").split())


def test_what_is_indented_keeps_its_lines(capsys):
    text = "One\ntwo.\n\nFormats:\n  .a  first\n  b   second\nAfter\nthem."
    assert unwrapped(text) == "One two.\n\nFormats:\n  .a  first\n  b   second\n\nAfter them."
    assert main(["convert", "--help"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert "  a folder     a LeRobot dataset, v3.0 (extra lerobot)" in lines
    assert any(line.startswith("A video (.mp4") for line in lines)


def test_a_completion_is_for_the_shell(capsys):
    assert main(["convert", "--tyro-print-completion", "bash"]) == 0
    assert "\n  complete -F _tyro_smooth_operator_convert" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ("retaget glove.npz", "unknown command 'retaget'. Did you mean 'retarget'?"),
        ("retarget x.npz --outpt y.npz", "unknown option '--outpt'. Did you mean '--output'?"),
        ("retarget --hlep", "unknown option '--hlep'. Did you mean '--help'?"),
        ("dataset --otput=x", "unknown option '--otput=x'. Did you mean '--output'?"),
        ("retarget x.npz --output y.npz --qiet", "Did you mean '--quiet'?"),
        ("study nwe folder", "Available subcommands: new"),
        ("study erase me P01 --yse", "Did you mean '--yes'?"),
        ("teleop --limits.velocty 3", "Did you mean '--limits.velocity'?"),
        ("retarget -o y.npz", "'--output'"),
        ("--hand leap_hand retarget x.npz", "unknown option '--hand'; expected a command first"),
        ("retarget none.npz --frames -3: --output y.npz", "none.npz: no such file"),
    ],
)
def test_an_unknown_word_is_named_with_the_closest_one(arguments, says, capsys):
    assert main(arguments.split()) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert says in " ".join(printed.err.split())
    assert "smooth-operator" in printed.err
