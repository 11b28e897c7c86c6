"""Message types of Protocol Buffers, made at run time from their definitions as text.

The text is a part of the ``.proto`` language: messages with nested messages and enumerations, one
declaration a line, a comment before or after it. No compiler is needed, and no generated code
whose version would have to fit that of the library.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from typing import Any, Final

from smooth_operator.teleop.recording.mcap_library import (
    DescriptorPool,
    FieldDescriptorProto,
    FileDescriptorProto,
    FileDescriptorSet,
    GetMessageClass,
    duration_pb2,
    timestamp_pb2,
)

_LINE: Final = re.compile(
    r"(?:(?P<open>message|enum) (?P<type>\w+) \{"
    r"|(?:(?P<label>repeated|optional) )?(?P<kind>[\w.]+) (?P<name>\w+) = (?P<number>\d+);"
    r"|(?P<value>\w+) = (?P<code>\d+);"
    r"|(?P<close>\}))(?: *// (?P<comment>.*))?"
)
_SCALARS: Final = {
    name: getattr(FieldDescriptorProto, f"TYPE_{name.upper()}")
    for name in ("double", "bool", "string", "bytes", "int64", "uint64", "fixed32")
}
_PACKED: Final = (_SCALARS["double"], _SCALARS["bool"])
_GOOGLE: Final = {
    f"google.protobuf.{name}": module.DESCRIPTOR
    for name, module in (("Timestamp", timestamp_pb2), ("Duration", duration_pb2))
}

Files = Mapping[str, Any]
"""Full name of a message -> its ``FileDescriptorProto``."""


def parse_types(package: str, text: str) -> dict[str, Any]:
    """The messages of a text, each as a file of its own.

    Args:
        package: of all of them; a type without dots is one of the same package.
        text: their definitions; a nested type stands before the fields that have it.

    Returns:
        Full name -> ``FileDescriptorProto``, its dependencies by name.

    Raises:
        ValueError: a line that is none of these.
    """
    files: dict[str, Any] = {}
    # Of each message that is open: it, its full name, its place in the file.
    stack: list[tuple[Any, str, tuple[int, ...]]] = []
    nested: dict[str, tuple[str, int]] = {}
    enum: Any = None
    file: Any = None
    before = ""  # a comment that has a line of its own
    for line in filter(None, map(str.strip, text.splitlines())):
        if line.startswith("//"):
            before = line.removeprefix("//").strip()
            continue
        found = _LINE.fullmatch(line)
        if found is None:
            raise ValueError(f"no declaration: {line!r}")
        place: tuple[int, ...] = ()
        if found["open"] == "enum":
            outer, name, _ = stack[-1]
            enum = outer.enum_type.add(name=found["type"])
            nested[found["type"]] = f".{name}.{found['type']}", FieldDescriptorProto.TYPE_ENUM
        elif found["open"] and not stack:
            full = f"{package}.{found['type']}"
            file = files[full] = FileDescriptorProto(
                name=_file_name(full), package=package, syntax="proto3"
            )
            place, nested = (4, 0), {}
            stack.append((file.message_type.add(name=found["type"]), full, place))
        elif found["open"]:
            outer, name, at = stack[-1]
            place = (*at, 3, len(outer.nested_type))
            full = f"{name}.{found['type']}"
            nested[found["type"]] = f".{full}", FieldDescriptorProto.TYPE_MESSAGE
            stack.append((outer.nested_type.add(name=found["type"]), full, place))
        elif found["value"]:
            enum.value.add(name=found["value"], number=int(found["code"]))
        elif found["close"]:
            if enum is None:
                stack.pop()
            enum = None
        else:
            message, _, at = stack[-1]
            place = (*at, 2, len(message.field))
            _add_field(file, message, found, nested)
        comment, before = found["comment"] or before, ""
        if place and comment:
            note = f" {comment}\n"
            file.source_code_info.location.add(path=place, span=(0, 0, 0), leading_comments=note)
    return files


def _add_field(
    file: Any, message: Any, found: re.Match[str], nested: Mapping[str, tuple[str, int]]
) -> None:
    field = message.field.add(
        name=found["name"],
        number=int(found["number"]),
        label=FieldDescriptorProto.LABEL_OPTIONAL,
        json_name=re.sub(r"_(\w)", lambda part: part[1].upper(), found["name"]),
    )
    kind = found["kind"]
    if kind in _SCALARS:
        field.type = _SCALARS[kind]
    elif kind in nested:
        field.type_name, field.type = nested[kind]
    else:
        full = kind if "." in kind else f"{file.package}.{kind}"
        field.type, field.type_name = FieldDescriptorProto.TYPE_MESSAGE, f".{full}"
        if _file_name(full) not in file.dependency:
            file.dependency.append(_file_name(full))
    if found["label"] == "repeated":
        field.label = FieldDescriptorProto.LABEL_REPEATED
    elif found["label"] == "optional":  # absent is another thing than zero
        field.proto3_optional = True
        field.oneof_index = len(message.oneof_decl)
        message.oneof_decl.add(name=f"_{found['name']}")


def _file_name(full: str) -> str:
    if full in _GOOGLE:
        return str(_GOOGLE[full].name)
    return full.replace(".", "/") + ".proto"


def type_set(files: Files, full: str) -> bytes:
    """A message and all that it is made of, as MCAP has schemas: a ``FileDescriptorSet``."""
    by_name = {file.name: file for file in files.values()}
    taken: dict[str, Any] = {}

    def take(name: str) -> None:
        if name in taken:
            return
        file = by_name.get(name)
        if file is None:
            file = FileDescriptorProto()
            (one,) = (found for found in _GOOGLE.values() if found.name == name)
            one.CopyToProto(file)
        for needed in file.dependency:
            take(needed)
        taken[name] = file

    take(_file_name(full))
    return bytes(FileDescriptorSet(file=taken.values()).SerializeToString(deterministic=True))


def readers(files: Files) -> dict[str, Any]:
    """Message classes in which packed numbers are the bytes that they are made of.

    A packed field has the same encoding as bytes, and NumPy takes these as they are. The messages
    may have no others as parts.

    Args:
        files: of the messages.

    Returns:
        Full name -> class of the library.
    """
    pool = DescriptorPool()
    for file in files.values():
        viewed = FileDescriptorProto()
        viewed.CopyFrom(file)
        for field in _fields(viewed.message_type):
            if field.label == FieldDescriptorProto.LABEL_REPEATED and field.type in _PACKED:
                field.label = FieldDescriptorProto.LABEL_OPTIONAL
                field.type = _SCALARS["bytes"]
        pool.AddSerializedFile(viewed.SerializeToString())
    return {full: GetMessageClass(pool.FindMessageTypeByName(full)) for full in files}


def _fields(messages: Iterable[Any]) -> Iterable[Any]:
    for message in messages:
        yield from message.field
        yield from _fields(message.nested_type)
