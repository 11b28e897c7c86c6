"""A reader of pickles that executes nothing: each instruction builds plain data, or is refused.

Python's ``pickle`` is not used: a class that restricts its globals still lets a file of 20 bytes
ask for gigabytes (an index of the memo, the length of a text). Here every length is compared with
the bytes that are there, instructions are counted, and what they build is counted in bytes. A
global is a name, which ``pickle_values`` knows or which is refused; nothing is imported and no
attribute is looked up.

The format: https://docs.python.org/3/library/pickle.html and the table in ``pickletools``.
"""

from __future__ import annotations

import codecs
import struct
from collections.abc import Callable
from typing import Any, Final

from smooth_operator.lab.datasets.mano.pickle_parts import (
    MOST_STEPS,
    Budget,
    Instance,
    Maker,
    NotDataError,
    is_plain_key,
)

_MOST_DIGITS: Final = 400  # bytes or digits of a whole number
_LONGEST_NAME: Final = 200
_CONTAINER, _SET, _MEMO = 80, 240, 110  # bytes that CPython takes


class Machine:
    """Follows the instructions of one pickle.

    Args:
        data: the bytes.
        start: where the pickle begins.
        budget: what may be built.
        find: gives what stands for a global, by its module and name; raises ``NotDataError``.
        persistent: gives what stands for a persistent identifier, or None if there are none.
    """

    def __init__(
        self,
        data: bytes,
        start: int,
        budget: Budget,
        find: Callable[[str, str], Any],
        persistent: Callable[[Any], Any] | None = None,
    ) -> None:
        self.data, self.at = data, start
        self.budget, self.find, self.persistent = budget, find, persistent
        self.stack: list[Any] = []
        self.marks: list[int] = []
        self.memo: dict[int, Any] = {}

    def run(self) -> Any:
        """The value; ``at`` is then behind the pickle.

        Raises:
            NotDataError: it asks for what is no data, is damaged or too large.
        """
        data, steps, end = self.data, _STEPS, len(self.data)
        left = self.budget.steps
        try:
            while True:
                if self.at >= end:
                    raise NotDataError("it is cut off")
                code = data[self.at]
                self.at += 1
                left -= 1
                if left < 0:
                    raise NotDataError(f"it has more than {MOST_STEPS:,} instructions")
                if code == 0x2E:  # STOP
                    return self.pop()
                step = steps.get(code)
                if step is None:
                    raise NotDataError(f"it is damaged: {code:#04x} is no instruction that is read")
                step(self)
        except NotDataError:
            raise
        except (LookupError, ValueError, TypeError, struct.error, OverflowError) as error:
            raise NotDataError("it is damaged") from error
        finally:
            self.budget.steps = left

    # What instructions are made of.

    def take(self, count: int) -> bytes:
        """The next bytes."""
        found = self.data[self.at : self.at + count] if count >= 0 else b""
        if len(found) != count:
            raise NotDataError("it is cut off")
        self.at += count
        return found

    def number(self, form: str, size: int) -> Any:
        """The next number, as ``struct`` has it."""
        return struct.unpack(form, self.take(size))[0]

    def line(self, most: int = _LONGEST_NAME) -> bytes:
        """What there is to the end of the line."""
        end = self.data.find(b"\n", self.at, self.at + most + 1)
        if end < 0:
            raise NotDataError("it is damaged: a line does not end")
        found = self.data[self.at : end]
        self.at = end + 1
        return found

    def pop(self) -> Any:
        """The value on top, which stands above the last mark."""
        if len(self.stack) <= (self.marks[-1] if self.marks else 0):
            raise NotDataError("it is damaged: a value is missing")
        return self.stack.pop()

    def popped(self) -> list[Any]:
        """The values above the last mark, and the mark is gone."""
        if not self.marks:
            raise NotDataError("it is damaged: a mark is missing")
        mark = self.marks.pop()
        found = self.stack[mark:]
        del self.stack[mark:]
        return found

    def top(self, kind: type) -> Any:
        """The value on top, of a kind; it stays."""
        if not self.stack or not isinstance(self.stack[-1], kind):
            raise NotDataError(f"it is damaged: a {kind.__name__} is missing")
        return self.stack[-1]

    def push(self, value: Any, count: int = 0) -> None:
        """Puts a value on top, which takes so many bytes."""
        if count:
            self.budget.take(count)
        self.stack.append(value)

    def remember(self, index: int) -> None:
        """The value on top under a number."""
        if not self.stack or index < 0:
            raise NotDataError("it is damaged: a value is missing")
        self.budget.take(_MEMO)
        self.memo[index] = self.stack[-1]

    def recall(self, index: int) -> None:
        """The value under a number on top."""
        self.stack.append(self.memo[index])

    def pairs(self, items: list[Any]) -> list[tuple[Any, Any]]:
        """Keys and values, the keys being plain: others may take for ever to compare."""
        if len(items) % 2:
            raise NotDataError("it is damaged: a value is missing")
        keys = items[::2]
        if not all(map(is_plain_key, keys)):
            raise NotDataError("it has a table whose keys are neither texts nor numbers")
        return list(zip(keys, items[1::2], strict=True))

    def call(self, what: Any, arguments: Any) -> None:
        """What a global makes of arguments, on top."""
        if not isinstance(what, Maker) or not isinstance(arguments, tuple):
            raise NotDataError("it is damaged: it calls what is no function")
        self.push(what.make(self.budget, *arguments))

    def find_global(self, module: Any, name: Any) -> None:
        """What stands for a global, on top."""
        if not isinstance(module, str) or not isinstance(name, str):
            raise NotDataError("it is damaged: a name is missing")
        self.stack.append(self.find(module[:_LONGEST_NAME], name[:_LONGEST_NAME]))


def _whole(text: bytes) -> int | bool:
    if text in (b"00", b"01"):
        return text == b"01"
    if len(text) > _MOST_DIGITS:
        raise NotDataError(f"a whole number has {len(text)} digits")
    return int(text)


def _long(m: Machine, count: int) -> None:
    if not 0 <= count <= _MOST_DIGITS:
        raise NotDataError(f"a whole number has {count} bytes")
    m.push(int.from_bytes(m.take(count), "little", signed=True))


def _string(m: Machine) -> None:
    text = m.line(len(m.data)).strip()
    if len(text) < 2 or text[0] != text[-1] or text[:1] not in (b"'", b'"'):
        raise NotDataError("it is damaged: a text has no quotes")
    m.push(codecs.escape_decode(text[1:-1])[0].decode("latin-1"))


def _unicode(m: Machine) -> None:
    m.push(m.line(len(m.data)).decode("raw-unicode-escape"))


def _dictionary(m: Machine) -> None:
    found = dict(m.pairs(m.popped()))
    m.push(found, _CONTAINER)


def _set_items(m: Machine) -> None:
    pairs = m.pairs(m.popped())
    m.top(dict).update(pairs)


def _set_item(m: Machine) -> None:
    value, key = m.pop(), m.pop()
    m.top(dict).update(m.pairs([key, value]))


def _append(m: Machine) -> None:
    value = m.pop()
    m.top(list).append(value)


def _appends(m: Machine) -> None:
    values = m.popped()
    m.top(list).extend(values)


def _items_of_set(m: Machine) -> list[Any]:
    values = m.popped()
    if not all(map(is_plain_key, values)):
        raise NotDataError("it has a set of other things than texts and numbers")
    return values


def _add_items(m: Machine) -> None:
    values = _items_of_set(m)
    m.top(set).update(values)


def _frozen_set(m: Machine) -> None:
    m.push(frozenset(_items_of_set(m)), _SET)


def _tuple(m: Machine, count: int) -> None:
    values = [m.pop() for _ in range(count)]
    m.push(tuple(reversed(values)), _CONTAINER)


def _drop(m: Machine) -> None:
    if m.marks and len(m.stack) == m.marks[-1]:
        m.marks.pop()
    else:
        m.pop()


def _double(m: Machine) -> None:
    value = m.pop()
    m.stack += [value, value]


def _stack_global(m: Machine) -> None:
    name, module = m.pop(), m.pop()
    m.find_global(module, name)


def _global(m: Machine) -> None:
    m.find_global(m.line().decode(), m.line().decode())


def _call(m: Machine) -> None:
    arguments, what = m.pop(), m.pop()
    m.call(what, arguments)


def _instance(m: Machine) -> None:
    m.find_global(m.line().decode(), m.line().decode())
    what = m.stack.pop()
    m.call(what, tuple(m.popped()))


def _object(m: Machine) -> None:
    what, *arguments = m.popped()
    m.call(what, tuple(arguments))


def _new_with_names(m: Machine) -> None:
    names, arguments, what = m.pop(), m.pop(), m.pop()
    if names:
        raise NotDataError("it makes an object in a way that is not known")
    m.call(what, arguments)


def _build(m: Machine) -> None:
    state = m.pop()
    if not m.stack or not isinstance(m.stack[-1], Instance):
        raise NotDataError("it is damaged: it gives a state to what has none")
    m.stack[-1].build(m.budget, state)


def _persistent(m: Machine, identifier: Any) -> None:
    if m.persistent is None:
        raise NotDataError("it refers to data outside the file")
    m.push(m.persistent(identifier))


def _protocol(m: Machine) -> None:
    if m.take(1)[0] > 5:
        raise NotDataError("it is of a newer protocol than 5, or damaged")


def _text(m: Machine, count: int) -> None:
    m.push(m.take(count).decode("utf-8", "surrogatepass"))


_CODES: Final[dict[str | int, Callable[[Machine], object]]] = {
    "(": lambda m: m.marks.append(len(m.stack)),
    "0": _drop,
    "1": lambda m: m.popped(),
    "2": _double,
    "F": lambda m: m.push(float(m.line())),
    "I": lambda m: m.push(_whole(m.line(1000))),
    "L": lambda m: m.push(_whole(m.line(1000).rstrip(b"L"))),
    "J": lambda m: m.push(m.number("<i", 4)),
    "K": lambda m: m.push(m.take(1)[0]),
    "M": lambda m: m.push(m.number("<H", 2)),
    "G": lambda m: m.push(m.number(">d", 8)),
    "N": lambda m: m.push(None),
    "P": lambda m: _persistent(m, m.line().decode()),
    "Q": lambda m: _persistent(m, m.pop()),
    "R": _call,
    "S": _string,
    "T": lambda m: m.push(m.take(m.number("<i", 4)).decode("latin-1")),
    "U": lambda m: m.push(m.take(m.take(1)[0]).decode("latin-1")),
    "V": _unicode,
    "X": lambda m: _text(m, m.number("<I", 4)),
    "B": lambda m: m.push(m.take(m.number("<I", 4))),
    "C": lambda m: m.push(m.take(m.take(1)[0])),
    "a": _append,
    "b": _build,
    "c": _global,
    "d": _dictionary,
    "e": _appends,
    "g": lambda m: m.recall(int(m.line())),
    "h": lambda m: m.recall(m.take(1)[0]),
    "j": lambda m: m.recall(m.number("<I", 4)),
    "i": _instance,
    "l": lambda m: m.push(m.popped(), _CONTAINER),
    "o": _object,
    "p": lambda m: m.remember(int(m.line())),
    "q": lambda m: m.remember(m.take(1)[0]),
    "r": lambda m: m.remember(m.number("<I", 4)),
    "s": _set_item,
    "t": lambda m: m.push(tuple(m.popped()), _CONTAINER),
    "u": _set_items,
    "]": lambda m: m.push([], _CONTAINER),
    "}": lambda m: m.push({}, _CONTAINER),
    ")": lambda m: m.push(()),
    0x80: _protocol,
    0x81: _call,
    0x85: lambda m: _tuple(m, 1),
    0x86: lambda m: _tuple(m, 2),
    0x87: lambda m: _tuple(m, 3),
    0x88: lambda m: m.push(True),
    0x89: lambda m: m.push(False),
    0x8A: lambda m: _long(m, m.take(1)[0]),
    0x8B: lambda m: _long(m, m.number("<i", 4)),
    0x8C: lambda m: _text(m, m.take(1)[0]),
    0x8D: lambda m: _text(m, m.number("<Q", 8)),
    0x8E: lambda m: m.push(m.take(m.number("<Q", 8))),
    0x8F: lambda m: m.push(set(), _SET),
    0x90: _add_items,
    0x91: _frozen_set,
    0x92: _new_with_names,
    0x93: _stack_global,
    0x94: lambda m: m.remember(len(m.memo)),
    0x95: lambda m: m.take(8),
    0x96: lambda m: m.push(m.take(m.number("<Q", 8))),
}
_STEPS: Final = {ord(c) if isinstance(c, str) else c: step for c, step in _CODES.items()}
"""Instruction -> what it does. Those of the extension registry and of buffers are not read."""
