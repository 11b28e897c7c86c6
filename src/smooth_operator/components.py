"""Parts that a user names in one word with settings: ``replay:glove.npz,speed=2``.

Sources and sinks are frozen dataclasses of settings in modules of their own; a table says which
word means which. Nothing is imported before it is asked for, so an absent extra costs nothing.
"""

from __future__ import annotations

import dataclasses
import importlib
import types
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

from smooth_operator.errors import ConfigError, UnknownNameError

_TRUE, _FALSE = ("true", "yes", "on", "1"), ("false", "no", "off", "0")


@dataclass(frozen=True)
class Component:
    """One word of a table.

    Attributes:
        module: where its class is.
        name: the class, a dataclass whose first field is the argument after the colon.
        summary: one line for ``--help``.
    """

    module: str
    name: str
    summary: str

    def load(self) -> type:
        """The class; imports its module."""
        found: type = getattr(importlib.import_module(self.module), self.name)
        return found


def build_component(kind: str, text: str, table: Mapping[str, Component]) -> Any:
    """Make what a text asks for.

    Args:
        kind: what the table holds, for messages: ``source`` or ``sink``.
        text: ``NAME``, ``NAME:ARGUMENT`` or ``NAME:ARGUMENT,setting=value,...``; the argument is
            the value of the class's first field, and may be left out where that has a default.
        table: word -> class.

    Raises:
        UnknownNameError: the table has no such word, or the class no such setting.
        ConfigError: a value can't be read as its field's type, or one that is needed is missing.
    """
    word, _, rest = text.partition(":")
    if word not in table:
        raise UnknownNameError(kind, word, table)
    made = table[word].load()
    hints = get_type_hints(made)
    fields = {f.name: f for f in dataclasses.fields(made) if f.init}
    values: dict[str, Any] = {}
    for position, part in enumerate(rest.split(",") if rest else ()):
        name, sign, value = part.partition("=")
        if position == 0 and not (sign and name.isidentifier()):  # an address may hold a '='
            name, value = next(iter(fields), ""), part
        if name not in fields:
            raise UnknownNameError(f"setting of {kind} {word!r}:", name, fields)
        if name in values:
            raise ConfigError(f"{text!r} gives {name!r} twice")
        values[name] = _read(value, hints[name], f"{kind} {word!r}: {name}")
    needed = [
        name
        for name, field in fields.items()
        if name not in values
        and field.default is dataclasses.MISSING
        and field.default_factory is dataclasses.MISSING
    ]
    if needed:
        raise ConfigError(
            f"{kind} {word!r} needs {', '.join(needed)}: write {word}:{needed[0].upper()}"
            + "".join(f",{name}=..." for name in needed[1:])
        )
    return made(**values)


def describe_components(table: Mapping[str, Component]) -> str:
    """The words of a table with their summaries, a line each."""
    width = max(map(len, table), default=0)
    return "\n".join(f"  {word:{width}}  {part.summary}" for word, part in table.items())


def _read(text: str, hint: Any, what: str) -> Any:
    """A setting's value as its field's type."""
    options = get_args(hint) if get_origin(hint) in (Union, types.UnionType) else (hint,)
    if type(None) in options and text.lower() == "none":
        return None
    for option in options:
        if option is type(None):
            continue
        try:
            return _as(text, option)
        except ValueError:
            continue
    wanted = " or ".join(_named(option) for option in options if option is not type(None))
    raise ConfigError(f"{what} must be {wanted}, not {text!r}")


def _as(text: str, hint: Any) -> Any:
    if get_origin(hint) is Literal:
        for choice in get_args(hint):
            if text == str(choice):
                return choice
        raise ValueError(text)
    if hint is bool:
        if text.lower() not in (*_TRUE, *_FALSE):
            raise ValueError(text)
        return text.lower() in _TRUE
    if hint in (int, float, str, Path):
        return hint(text)
    raise ValueError(text)


def _named(hint: Any) -> str:
    if get_origin(hint) is Literal:
        return " or ".join(map(str, get_args(hint)))
    names = {int: "a whole number", float: "a number", bool: "true or false", Path: "a path"}
    return names.get(hint, "a text")
