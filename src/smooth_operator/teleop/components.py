"""Parts that a user names in one word with settings: ``replay:glove.npz,speed=2``.

Sources and sinks are frozen dataclasses of settings in separate modules; a registry says which
word means which.
"""

from __future__ import annotations

import dataclasses
import types
from pathlib import Path
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

from smooth_operator.errors import ConfigError, UnknownNameError
from smooth_operator.plugins import Registry

_TRUE, _FALSE = ("true", "yes", "on", "1"), ("false", "no", "off", "0")


def build_component(registry: Registry, text: str) -> Any:
    """Make what a text asks for.

    Args:
        registry: the parts by name, dataclasses whose first field is the argument.
        text: ``NAME``, ``NAME:ARGUMENT`` or ``NAME:ARGUMENT,setting=value,...``; the argument is
            the value of the class's first field, and may be left out where that has a default.
            In place of a name, ``package.module:Class``; settings alone may follow it after a
            comma.

    Raises:
        UnknownNameError: there is no such name, or the class has no such setting.
        ConfigError: the class can't be imported or is no such part, a value can't be read as its
            field's type, or one that is needed is missing.
    """
    kind = registry.kind
    word, rest = registry.split(text)
    part = registry.load(word)
    if not (isinstance(part, type) and dataclasses.is_dataclass(part)):
        raise ConfigError(
            f"{registry.find(word).target} can't be a {kind}: it must be a dataclass, whose fields "
            "are the settings"
        )
    component = settings_from_text(part, rest, kind, word)
    registry.check(word, component)
    return component


def settings_from_text(settings_class: type[Any], text: str, kind: str, word: str) -> Any:
    """An object of a settings class.

    Args:
        settings_class: a dataclass.
        text: ``ARGUMENT,setting=value,...``; see ``build_component``.
        kind: what it is, for messages.
        word: what the user calls it.

    Raises:
        UnknownNameError: the class has no such setting.
        ConfigError: a value can't be read as its field's type, or one that is needed is missing.
    """
    hints = get_type_hints(settings_class)
    fields = {f.name: f for f in dataclasses.fields(settings_class) if f.init}
    values: dict[str, Any] = {}
    for position, part in enumerate(text.split(",") if text else ()):
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
    return settings_class(**values)


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
    expected = " or ".join(_named(option) for option in options if option is not type(None))
    raise ConfigError(f"{what} must be {expected}, not {text!r}")


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
