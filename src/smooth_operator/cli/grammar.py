"""Checks that commands and options exist, and names the closest one if not."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, get_args, get_type_hints

from tyro.conf import Positional

from smooth_operator.cli.subcommands import Group
from smooth_operator.errors import ConfigError, UnknownNameError

_OPTION = re.compile(r"--?[A-Za-z]")
_HELP = frozenset({"-h", "--help", "--help-all"})
_POSITIONAL: Any = get_args(Positional[int])[1]


def check_words(commands: Mapping[str, type], arguments: Sequence[str]) -> None:
    """Refuses unknown commands and options.

    Args:
        commands: name -> options.
        arguments: of the program, without its name.

    Raises:
        UnknownNameError: with the one that was probably meant, of the command that was named.
        ConfigError: an option stands before the command.
    """
    if not arguments or _HELP & set(arguments):
        return
    program, kind, rest = "smooth-operator", None, list(arguments)
    while rest and (kind is None or issubclass(kind, Group)):
        known = commands if kind is None else subcommands(kind)
        word = rest.pop(0)
        if word.startswith("--tyro-"):
            return
        if word.startswith("-"):
            raise ConfigError(
                f"{word!r} stands before the command; expected {program} COMMAND [OPTIONS], and "
                f"{program} --help lists the commands"
            )
        if word not in known:
            more = f"{program} --help says what each does."
            raise UnknownNameError("command", word, known, more)
        kind, program = known[word], f"{program} {word}"
    if kind is None or issubclass(kind, Group):
        return
    known_options = set(option_names(kind))
    for word in rest:
        if word == "--" or word.startswith("--tyro-"):
            return
        name = word.split("=", 1)[0].replace("_", "-")
        single = name.startswith("-") and not name.startswith("--") and len(name) > 2
        if _OPTION.match(name) and not single and name not in known_options:
            overview = "--help-all" if getattr(kind, "rare", ()) else "--help"
            more = f"{program} {overview} says what each does."
            raise UnknownNameError("option", name, known_options, more)


def subcommands(kind: type) -> dict[str, type]:
    """Name -> options of the subcommands of a group."""
    union = get_args(get_type_hints(kind, include_extras=True)["what"])[0]
    return {
        next(one.name for one in member.__metadata__ if hasattr(one, "name")): get_args(member)[0]
        for member in get_args(union)
    }


def option_names(kind: type, prefix: str = "") -> Iterator[str]:
    """The options of a command as they are typed, those of its parts included."""
    hints = get_type_hints(kind, include_extras=True)
    for field in dataclasses.fields(kind):
        metadata = getattr(hints[field.name], "__metadata__", ())
        if _POSITIONAL in metadata:
            continue
        named = [one.name for one in metadata if getattr(one, "name", None) is not None]
        name = prefix + (named or [field.name.rstrip("_").replace("_", "-")])[0]
        inner: Any = get_args(hints[field.name])[0] if metadata else hints[field.name]
        if isinstance(inner, type) and dataclasses.is_dataclass(inner):
            yield from option_names(inner, f"{name}.")
        else:
            yield f"--{name}"
