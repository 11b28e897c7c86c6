"""Makes dataclasses from tables of a settings file, by the names and types of their fields."""

from __future__ import annotations

from dataclasses import MISSING, fields, is_dataclass
from typing import Any, Literal, TypeVar, get_args, get_origin, get_type_hints

from smooth_operator.io.entries import Entries

_Record = TypeVar("_Record")


def record(
    cls: type[_Record],
    entries: Entries,
    more: tuple[str, ...] = (),
    *,
    lines: bool = False,
    **values: Any,
) -> _Record:
    """Makes a dataclass from a table, by the names and types of its fields.

    Args:
        cls: class of the result. A text of several lines has the metadata ``lines``.
        entries: table of the file.
        more: further entries that the table may have.
        lines: accept several lines in every text.
        **values: values of other fields.
    """
    hints = get_type_hints(cls)
    columns = [f for f in fields(cls) if f.name not in values]  # type: ignore[arg-type]
    entries.only(*(f.name for f in columns), *more)
    for f in columns:
        required = f.default is MISSING and f.default_factory is MISSING
        if required or f.name in entries.names:
            several = lines or bool(f.metadata.get("lines"))
            values[f.name] = _value(entries, f.name, hints[f.name], lines=several)
    return cls(**values)


def _value(entries: Entries, name: str, hint: Any, *, lines: bool) -> Any:
    """Reads an entry of the type of a field; an empty text is None if the type allows it."""
    inner = get_args(hint)
    if type(None) in inner:
        if entries.values.get(name, "") is None:
            return None
        value = _value(entries, name, inner[0], lines=lines)
        return None if value == "" else value
    if get_origin(hint) is Literal:
        return entries.choice(name, inner)
    if get_origin(hint) is tuple and is_dataclass(inner[0]):
        cls: Any = inner[0]
        return tuple(record(cls, one) for one in entries.tables(name))
    if get_origin(hint) is tuple:
        texts, options = entries.texts(name), get_args(inner[0])
        if not set(texts) <= set(options or texts):
            raise entries.error(name, f"expected some of {', '.join(options)}")
        return tuple(option for option in options or texts if option in texts)
    if get_origin(hint) is not None:
        table = entries.table(name)
        return {key: table.number(key) for key in table.names}
    if hint is bool:
        return entries.flag(name, False)
    if hint is str:
        return entries.text(name, lines=lines)
    return entries.whole(name) if hint is int else entries.number(name)
