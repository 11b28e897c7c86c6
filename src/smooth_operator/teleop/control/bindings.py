"""Table of the operator's inputs: which key, pedal, pinch or button triggers which action."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Final

from smooth_operator.errors import ConfigError, DocumentError, UnknownNameError

ACTIONS: Final[dict[str, tuple[str, tuple[str, ...]]]] = {
    "stop": ("EMERGENCY STOP", ("space", "escape", "x")),
    "release": ("release the stop", ("u",)),
    "pause": ("pause / resume", ("p",)),
    "wrist": ("release or engage the wrist clutch", ("c",)),
    "record": ("start / end a take", ("r",)),
    "keep": ("keep the take", ("k",)),
    "discard": ("delete the take", ()),
    "go": ("start a trial", ("g",)),
    "reset": ("put the object back", ("o",)),
    "done": ("end the trial", ("d",)),
    "success": ("mark the episode as a success", ("s",)),
    "end": ("end the episode without success", ("e",)),
    "again": ("end the episode and record it again", ("a",)),
    "quit": ("end the run", ("q",)),
}
"""Action -> its meaning and its default inputs."""

TRIAL_ACTIONS: Final = ("go", "reset", "done")
"""Actions of a run with a task."""

EPISODE_ACTIONS: Final = ("success", "end", "again")
"""Actions that tell a receiver, such as LeRobot, about the episode that it records."""

NAMED_KEYS: Final = ("space", "escape", "enter", "tab", "backspace")
BUTTONS: Final = ("a", "b", "x", "y", "left-stick", "right-stick")
"""Buttons of a headset's controllers that can be bound. Trigger and grip close the fingers."""

INPUTS: Final = (
    f"a key (b, 7, {', '.join(NAMED_KEYS)}), pedal:CODE, pinch:FINGER (index, middle, ring or "
    f"pinky; for one hand: pinch:left-FINGER), or button:NAME ({', '.join(BUTTONS)})"
)
_INPUT: Final = re.compile(
    rf"[a-z0-9]|{'|'.join(NAMED_KEYS)}|pedal:\d{{1,3}}|button:({'|'.join(BUTTONS)})"
    r"|pinch:((left|right)-)?(index|middle|ring|pinky)"
)
_MOST_BYTES: Final = 100_000


def read_bindings(words: Iterable[str] = (), more: Collection[str] = ()) -> dict[str, str]:
    """Reads the table of inputs and their actions.

    Args:
        words: changes of the default inputs. ``ACTION=INPUT`` adds an input to an action, and takes
            it from the action that had it. ``ACTION=`` removes the inputs of an action.
            ``FILE.toml`` has a table ``[bindings]`` with lines ``ACTION = ["INPUT", ...]``, which
            replace the inputs of these actions.
        more: names of actions besides ``ACTIONS``, such as those of sinks.

    Returns:
        Input -> action.

    Raises:
        UnknownNameError: there is no such action.
        ConfigError: a text has another form, there is no such input, a file can't be read, or
            ``stop`` would lose an input.
    """
    bindings = {each: name for name, (_, inputs) in ACTIONS.items() for each in inputs}
    names = dict.fromkeys((*ACTIONS, *more))

    def bind(where: str, name: str, *inputs: str, alone: bool = False) -> None:
        if name not in names:
            raise UnknownNameError("action", name, names)
        for each in inputs_of(bindings, name) if alone and name != "stop" else ():
            del bindings[each]
        for each in map(str.lower, inputs):
            if not _INPUT.fullmatch(each):
                raise ConfigError(f"{where}: there is no input {each!r}; expected {INPUTS}")
            if bindings.get(each) == "stop" != name:
                raise ConfigError(f"{where}: {each} always stops the robot; choose another input")
            bindings[each] = name

    for word in words:
        name, sign, given = word.partition("=")
        if sign and (given or name != "stop"):
            bind(f"--bind {word}", name, *filter(None, [given]), alone=not given)
        elif sign:
            raise ConfigError("--bind stop=: the inputs of stop can't be removed")
        elif Path(word).suffix == ".toml":
            for name, inputs in _table(Path(word)).items():
                bind(word, name, *inputs, alone=True)
        else:
            raise ConfigError(
                f"--bind {word}: expected ACTION=INPUT, such as record=b, or a file FILE.toml"
            )
    return bindings


def inputs_of(bindings: Mapping[str, str], action: str) -> list[str]:
    """Inputs that trigger an action."""
    return [each for each, name in bindings.items() if name == action]


def spoken(bindings: Mapping[str, str], action: str) -> str:
    """Inputs that trigger an action, as a phrase: ``space, escape or x``."""
    *others, last = inputs_of(bindings, action) or ["no input"]
    return f"{', '.join(others)} or {last}" if others else last


def keys_of(bindings: Mapping[str, str], offered: Collection[str]) -> dict[str, list[str]]:
    """Maps each action that a page offers to the keys that trigger it."""
    keys = {name: inputs_of(bindings, name) for name in offered}
    return {name: [each for each in inputs if ":" not in each] for name, inputs in keys.items()}


DEFAULT_KEYS: Final = keys_of(read_bindings(), ACTIONS)


def action_table() -> str:
    """Table of all actions with their meanings and default inputs, for the help of a command."""
    return "\n".join(
        f"  {name:<9}{words}{f': {spoken(read_bindings(), name)}' if inputs else ''}"
        for name, (words, inputs) in ACTIONS.items()
    )


def label_of(keys: Mapping[str, Sequence[str]], action: str) -> str:
    """The first key of an action in brackets, as in `` (P)``; empty if it has none."""
    return f" ({shown[0].capitalize()})" if (shown := keys.get(action)) else ""


def _table(path: Path) -> dict[str, list[str]]:
    """The table ``[bindings]`` of a file."""
    from smooth_operator.io.entries import read_toml

    try:
        table = read_toml(path, most_bytes=_MOST_BYTES).get("bindings")
    except (OSError, DocumentError) as error:
        raise ConfigError(f"{path}: can't be read: {error}") from error
    if not isinstance(table, dict) or not all(
        isinstance(inputs, list) and all(isinstance(each, str) for each in inputs)
        for inputs in table.values()
    ):
        raise ConfigError(
            f'{path}: expected a table [bindings] with lines such as record = ["b", "pedal:48"]'
        )
    return table
