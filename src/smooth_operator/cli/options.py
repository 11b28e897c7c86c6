"""Lists the commands and their options, as typed dataclasses from which tyro makes the parsers and
the help."""

from __future__ import annotations

import ast
import contextlib
import dataclasses
import functools
import inspect
import io
import re
import shutil
import sys
import textwrap
from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import Annotated, Any, Final, TypeAlias, get_args, get_type_hints

import tyro
from tyro.conf import Suppress, arg

from smooth_operator.cli.calibrate import Calibrate
from smooth_operator.cli.common_options import INSTALL_RESEARCH, Common, Group, described
from smooth_operator.cli.convert import Convert
from smooth_operator.cli.demo import Demo
from smooth_operator.cli.doctor import Doctor
from smooth_operator.cli.edit import Edit
from smooth_operator.cli.hands import Hands
from smooth_operator.cli.latency import Latency
from smooth_operator.cli.retarget import Retarget
from smooth_operator.cli.sample import Sample
from smooth_operator.cli.teleop import Teleop
from smooth_operator.cli.train import Train
from smooth_operator.cli.view import View
from smooth_operator.errors import ConfigError, UnknownNameError, did_you_mean
from smooth_operator.extras import DEVICES, PART_OF_DATA_SETS
from smooth_operator.plugins import Entry, Registry
from smooth_operator.teleop.components import devices_command

_NARROWEST = 40
_BOXED = re.compile(r"\s*(\x1b\[[0-9;]*m)*[╭│╰|+]")


def document(kind: type) -> None:
    """Passes the help of each option of a dataclass, including its parts and subcommands, to tyro.

    tyro also finds the docstrings below the fields by itself, but it keeps the line breaks of the
    source, because continued lines are indented there.
    """
    for each in reversed(kind.__mro__):
        if dataclasses.is_dataclass(each):
            _document(each)
    for hint in get_type_hints(kind, include_extras=True).values():
        for part in _dataclasses_in(hint):
            document(part)


def without_rare(kind: type) -> type:
    """Returns a copy of a command's class whose help omits the rare options."""
    rare: frozenset[str] = getattr(kind, "rare", frozenset())
    if not rare:
        return kind
    hints = get_type_hints(kind, include_extras=True)
    namespace: dict[str, Any] = {
        field.name: dataclasses.field(default=field.default, default_factory=field.default_factory)
        for field in dataclasses.fields(kind)
        if field.name in rare
    }
    suppress: Any = Suppress
    namespace["__annotations__"] = {name: suppress[hints[name]] for name in namespace}
    namespace["__doc__"] = kind.__doc__
    copy = type(kind.__name__, (kind,), namespace)
    return dataclasses.dataclass(frozen=True, kw_only=True)(copy)


@functools.cache
def _document(kind: type) -> None:
    docs, hints = _field_docs(kind), get_type_hints(kind, include_extras=True)
    own = {field.name for field in dataclasses.fields(kind)} & kind.__annotations__.keys()
    for name in own:
        # tyro itself says that an option may be repeated
        repeated = tyro.conf.UseAppendAction in getattr(hints[name], "__metadata__", ())
        hint = None if repeated else _default_hint
        settings: Any = arg(help_behavior_hint=hint)
        if name in docs:
            settings = arg(help_behavior_hint=hint, help=docs[name])
        kind.__annotations__[name] = Annotated[hints[name], settings]


def _default_hint(label: str) -> str:
    """Returns the default to print after an option's help. Without a default value, the help text
    itself states the default."""
    return "" if label in ("None", "False", "") else f"(default: {label})"


def _field_docs(kind: type) -> dict[str, str]:
    try:
        (body,) = ast.parse(textwrap.dedent(inspect.getsource(kind))).body
    except (OSError, SyntaxError, ValueError):
        return {}
    assert isinstance(body, ast.ClassDef)
    return {
        field.target.id: " ".join(doc.value.value.split())
        for field, doc in pairwise(body.body)
        if isinstance(field, ast.AnnAssign) and isinstance(field.target, ast.Name)
        if isinstance(doc, ast.Expr) and isinstance(doc.value, ast.Constant)
        if isinstance(doc.value.value, str)
    }


def option_names(kind: type, prefix: str = "--") -> Iterator[str]:
    """Names of a command's options, such as ``--limits.velocity``, without positional arguments."""
    hints = get_type_hints(kind, include_extras=True)
    for field in dataclasses.fields(kind):
        name = prefix + field.name.rstrip("_").replace("_", "-")  # from_ is --from
        parts = list(_dataclasses_in(hints[field.name]))
        for part in parts:
            yield from option_names(part, f"{name}.")
        if not parts and tyro.conf.Positional not in getattr(hints[field.name], "__metadata__", ()):
            yield name


def _check_options(kind: type, name: str, words: Sequence[str]) -> None:
    """ConfigError for an unknown option, for which tyro would complain about a missing argument."""
    known = {*option_names(kind), "--help"}
    for word in words:
        option = word.partition("=")[0].replace("_", "-")
        if re.fullmatch(r"-[A-Za-z]", word) and word != "-h":
            close = [one for one in sorted(known) if one[2] == word[1]]
            hint = f" Did you mean {' or '.join(map(repr, close[:3]))}?" if close else ""
        elif option.startswith("--") and option not in known and option[2:]:
            hint = did_you_mean(option, known)
        else:
            continue
        raise ConfigError(
            f"unknown option {word!r}.{hint} All options: smooth-operator {name} --help-all"
        )


def _dataclasses_in(hint: Any) -> Iterator[type]:
    if isinstance(hint, type) and dataclasses.is_dataclass(hint):
        yield hint
    for part in get_args(hint):
        yield from _dataclasses_in(part)


@contextlib.contextmanager
def wrapped_output() -> Iterator[None]:
    """Inside the block, wraps printed text at the width of the terminal, except for boxes.

    tyro fits its boxes to that width, but does not wrap the text above them.
    """
    before, held = sys.stdout, _Held(sys.stdout)
    sys.stdout = held
    try:
        yield
    finally:
        sys.stdout = before
        width = max(shutil.get_terminal_size().columns, _NARROWEST)
        for line in held.getvalue().splitlines():
            print(_fitted(line, width), file=before)


def _fitted(line: str, width: int) -> str:
    if _BOXED.match(line) or len(line) <= width:
        return line
    if "usage:" in line:  # the list of subcommands, which the box repeats
        line = re.sub(r"\{\S+,\S+\}", "COMMAND", line)
    indent = " " * (len(line) - len(line.lstrip()))
    table = re.match(r"\s+\S+(, \S+)*\s{2,}|\s+", line)  # a name and its description, in columns
    after = " " * len(table[0]) if table else indent
    return textwrap.fill(
        line, width, subsequent_indent=after, break_on_hyphens=False, break_long_words=False
    )


class _Held(io.StringIO):
    """Stream that collects text, with the encoding and width of another stream."""

    def __init__(self, stream: Any) -> None:
        super().__init__()
        self._stream = stream

    def isatty(self) -> bool:
        return bool(self._stream.isatty())

    def fileno(self) -> int:
        return int(self._stream.fileno())

    @property
    def encoding(self) -> str:  # type: ignore[override]
        return str(self._stream.encoding)


EXAMPLES: Final = """Examples:
  smooth-operator demo
      retarget a synthetic human hand, print five metrics and play the result in the browser
  smooth-operator sample hand.npz
      write a recording of the synthetic hand, as input for the other commands
  smooth-operator retarget glove.npz --output out.npz
      convert a recording to joint commands, and print quality checks
  smooth-operator dataset egodex/ --hand leap_hand --output out
      convert recordings to a data set of robot episodes (packages/smooth_hand_datasets)
  smooth-operator teleop --source webcam --sink mujoco record:take.mcap
      drive a hand live from a tracker, with motion limits and a live page
  smooth-operator edit take.mcap --keep 1.5:8 --output short.mcap
      cut a recording made with teleop or add named marks to it, and write a new file
  smooth-operator view out.npz glove.npz
      show the commands and the recorded hand side by side in the browser
  smooth-operator convert glove.npz --commands out.npz --output demo.mcap
      write recording and commands to one file in another format: MCAP, HDF5, npz or LeRobot
  smooth-operator bench glove.npz --methods all --output out
      compare methods: a table, results.json, an HTML report (packages/smooth_operator_benchmark)
  smooth-operator calibrate glove.npz --output operator.json
      measure the gaps that a tracker reports when thumb and finger touch, and write them to a file
  smooth-operator train geort glove.npz --output my-geort
      train a learning-based method for a hand and an operator
  smooth-operator hands list
      list the robot hands; hands show NAME prints joints and limits, and opens a page
  smooth-operator hardware list
      list drivers, actuator tables and ports of real hands (packages/smooth_operator_devices)
  smooth-operator study analyze trials.csv tlx.csv --output out
      analyse a user study: models, corrected p-values, a report (packages/smooth_operator_study)
  smooth-operator doctor
      check this machine, its extras and settings, and suggest fixes

Each command has its own help: smooth-operator retarget --help
"""


Command: TypeAlias = Common | Group
"""Options of a command, which run it."""

_COMMANDS: Final[dict[str, type[Command]]] = {
    "demo": Demo,
    "sample": Sample,
    "retarget": Retarget,
    "teleop": Teleop,
    "latency": Latency,
    "edit": Edit,
    "view": View,
    "convert": Convert,
    "train": Train,
    "hands": Hands,
    "calibrate": Calibrate,
    "doctor": Doctor,
}


_BENCHMARK: Final = (
    "the distribution smooth-operator-benchmark",
    'python -m pip install ".[teleop]" ./packages/smooth_operator_benchmark',
)
_STUDY: Final = (
    "the distribution smooth-operator-study",
    'python -m pip install ".[teleop]" ./packages/smooth_operator_study',
)
_DEVICES: Final = (f"the distribution {DEVICES}", devices_command())
_RESEARCH: Final = ("the research distribution", INSTALL_RESEARCH)
_DISTRIBUTIONS: Final = {
    "bench": _BENCHMARK,
    "study": _STUDY,
    "hardware": _DEVICES,
    **dict.fromkeys(("paper", "ablate", "physics", "cross-hand", "study.simulate"), _RESEARCH),
}
"""Maps a command to the distribution of this repository that adds it, and to the line that installs
it."""

COMMANDS: Final = Registry(
    "command",
    {name: Entry(f"{kind.__module__}:{kind.__name__}") for name, kind in _COMMANDS.items()},
    elsewhere={"dataset": PART_OF_DATA_SETS}
    | {
        name: f"part of {owner}, which is not installed; in a clone of the repository, run: {line}"
        for name, (owner, line) in _DISTRIBUTIONS.items()
    },
)
"""Maps the name of a command to its options, a dataclass that derives from ``Common``.

A plugin's ``GROUP.NAME`` is the command ``smooth-operator GROUP NAME``.
"""


def _command(name: str) -> type[Command]:
    kind = COMMANDS.load(name)
    if not (isinstance(kind, type) and issubclass(kind, Common | Group)):
        raise ConfigError(
            f"{COMMANDS[name].target} can't be a command: it must be a dataclass of options that "
            "derives from smooth_operator.cli.common_options.Common"
        )
    return kind


def _commands(name: str) -> dict[str, Any]:
    """Commands to load for arguments that begin with a name."""
    if name in COMMANDS.built_in:
        return dict(_COMMANDS)
    if name in COMMANDS:
        return {**_COMMANDS, name: _command(name)}
    return {**_COMMANDS, **COMMANDS.loadable(_command)}  # the overview needs all commands


def _joined(arguments: Sequence[str]) -> list[str]:
    """Joins ``bench --physics`` and a plugin's ``GROUP COMMAND`` into one argument each;
    ConfigError if the command is in a distribution that is not installed."""
    words = list(arguments)
    if words[:1] == ["bench"] and "--physics" in words:
        words = ["physics", *("--measures" if w == "--physics" else w for w in words[1:])]
    joined = ".".join(words[:2])
    if joined in COMMANDS or joined in COMMANDS.elsewhere:
        words = [joined, *words[2:]]
    if words[:1] and words[0] in COMMANDS.elsewhere and words[0] not in COMMANDS:
        raise ConfigError(f"{words[0].replace('.', ' ')} is {COMMANDS.elsewhere[words[0]]}")
    return words


def _from_plugins(group: str) -> str:
    """Help on the commands that other distributions add to a group, or would add if they were
    installed."""
    texts = {name: f"with {owner} ({line})" for name, (owner, line) in _DISTRIBUTIONS.items()}
    for name, kind in COMMANDS.loadable(_command).items():
        texts[name] = (kind.__doc__ or "").strip().partition("\n")[0]
    lines = [
        f"  smooth-operator {name.replace('.', ' ')}: {text}"
        for name, text in texts.items()
        if name.startswith(f"{group}.")
    ]
    return "\n\nIn another distribution:\n" + "\n".join(lines) if lines else ""


def parse(arguments: Sequence[str]) -> Command:
    """Parses the arguments and returns the options of their command.

    Raises:
        SystemExit: 0 after printing help, 2 after printing an error about the arguments.
        SmoothOperatorError: there is no such command.
    """
    whole = "--help-all" in arguments
    arguments = _joined(["--help" if w == "--help-all" else w for w in arguments])
    name = arguments[0] if arguments else ""
    commands = _commands(name)
    flags = (tyro.conf.FlagCreatePairsOff,)
    for_a_shell = any(word.startswith("--tyro-") for word in arguments)  # shell completions
    overview = not arguments or name in ("-h", "--help") or name.startswith("--tyro-")
    if not overview and name.startswith("-"):
        raise ConfigError(
            f"unknown option {name!r}; expected a command first: smooth-operator COMMAND "
            "[OPTIONS]. smooth-operator --help lists the commands"
        )
    if not overview and name not in commands:
        hint = "smooth-operator --help describes each command."
        raise UnknownNameError("command", name, commands, hint)
    with contextlib.nullcontext() if for_a_shell else wrapped_output():
        if overview:
            tyro.extras.subcommand_cli_from_dict(
                {name: kind for name, kind in commands.items() if "." not in name},
                prog="smooth-operator",
                description=f"Retarget a tracked human hand onto a robot hand.\n\n{EXAMPLES}",
                args=list(arguments) or ["--help"],
                config=flags,
            )
        kind: Any = commands[name]
        rest = list(arguments[1:])
        if issubclass(kind, Group) and rest and rest[0] in (members := kind.members()):
            kind, name = members[rest[0]], f"{name} {rest.pop(0)}"
        if not for_a_shell and not issubclass(kind, Group):
            _check_options(kind, name.replace(".", " "), rest)
        document(kind)
        more = _from_plugins(name) if issubclass(kind, Group) else ""
        if not whole and {"-h", "--help"} & set(arguments):
            kind = without_rare(kind)
        chosen: Command = tyro.cli(
            kind,
            prog=f"smooth-operator {name.replace('.', ' ')}",
            description=described(kind, whole) + more,
            args=rest,
            config=flags,
        )
        return chosen
