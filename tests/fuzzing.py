"""Hostile files: Hypothesis strategies that damage good ones, and a process that reads them.

``damaged_bytes``, ``damaged_text``, ``damaged_json``, ``damaged_table`` (TOML, CSV and XML, by
lines), ``damaged_xml``, ``damaged_npy`` and ``damaged_npz`` take the bytes of a good file and give
a strategy of damaged ones. ``each`` calls a function with some of them, always the same, and
shrinks one that fails; ``outcomes`` tells what a reader makes of them. ``ReaderProcess`` calls a
reader, named as ``module:function``, on a file in another process with limits and says what came of
it::

    with ReaderProcess() as reader:
        verdict = reader.read("smooth_operator.hands.spec_file:read_hand_spec", path)
    assert verdict.sound, verdict

As a script it is that other process.
"""

import contextlib
import importlib
import io
import json
import os
import re
import select
import struct
import subprocess
import sys
import time
import traceback
import warnings
import zipfile
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st
from hypothesis.strategies import DrawFn, SearchStrategy

from smooth_operator.errors import SmoothOperatorError

Damaged = Callable[[bytes], SearchStrategy[bytes]]
"""A good file to a strategy of damaged ones."""

CPU_S = 5.0
"""What a reader may take [s of the processor], so that other work on the machine does not count."""
MEMORY_MB = 450.0
"""What a reader may take beyond what the process had before."""
LONGEST_MESSAGE = 1500
"""Characters of an error: a person reads it."""

_WALL_S = 60.0  # for one that waits for ever and computes nothing
_ADDRESS_SPACE = 3 << 30  # beyond what the process has; protects the machine

EXTREMES: tuple[str, ...] = (
    *("0", "-0.0", "-1", "1", "0.5", "1e308", "-1e308", "1e-320", "1e400", "1e-9", "1e11", "1_0"),
    *("nan", "inf", "-inf", "NaN", "Infinity", "true", "false", "null", "[]", "{}", "[[]]"),
    *("0x7fffffffffffffff", "18446744073709551615", "-9223372036854775809", "2147483648"),
    *('""', '"x"', '"[/x]"', '"../../x"', '"a\\u0000b"', '"\\ud800"', '"\u202e"'),
    *("100000000000", "9" * 400, "9" * 5000, "1" + "0" * 25, '"' + "y" * 5000 + '"'),
    "1979-05-27T07:32:00Z",
)
"""Words that stand where a number or a text did, in JSON, TOML, CSV, XML."""

_NUMBER = re.compile(rb"-?\d+(?:\.\d+)?(?:[eE][+-]?\d+)?")
_INTEGERS = [
    (value % (1 << 8 * size)).to_bytes(size, order)
    for size in (1, 2, 4, 8)
    for order in ("little", "big")
    for value in (0, 1, 2, -1, 1 << (8 * size - 1), (1 << (8 * size - 1)) - 1, 1 << 20)
]
_NAMES = ("x", "", "format", "__class__", "é", "z" * 3000)
DEEP = st.builds(
    lambda depth, start, end: start * depth + end * depth,
    st.sampled_from((20, 100, 900, 5_000, 100_000)),
    st.sampled_from(("[", '{"a":')),
    st.sampled_from(("]", "}", "")),
)
"""Brackets within brackets, a few or too many."""
STRANGE = st.sampled_from(EXTREMES) | st.sampled_from(EXTREMES) | DEEP


def each(mutants: SearchStrategy[Any], count: int, use: Callable[[Any], None]) -> None:
    """Calls a function with ``count`` mutants; shrinks one that fails.

    There is no seed of the clock, but Hypothesis also draws constants of the modules that are
    loaded, so a test alone gets other mutants than in a run of all.
    """

    @settings(
        max_examples=count,
        derandomize=True,
        database=None,
        deadline=None,
        suppress_health_check=[*HealthCheck],
        phases=[Phase.generate, Phase.shrink],
    )
    @given(mutants)
    def test(mutant: Any) -> None:
        use(mutant)

    test()


def outcomes(
    mutants: SearchStrategy[Any], count: int, read: Callable[[Any], Any]
) -> tuple[list[str], list[Any]]:
    """What a function makes of mutants: messages of this program's errors, and what it returns.

    Any other error is raised.
    """
    refused: list[str] = []
    found: list[Any] = []

    def use(mutant: Any) -> None:
        try:
            found.append(read(mutant))
        except SmoothOperatorError as error:
            assert 0 < len(str(error)) < LONGEST_MESSAGE  # noqa: PT017
            refused.append(str(error))

    with np.errstate(all="ignore"):
        each(mutants, count, use)
    return refused, found


def recording_at(path: Path) -> Callable[[bytes], Any]:
    """Reads what it is given as the file of a recording."""
    from smooth_operator import read_recording

    def read(mutant: bytes) -> Any:
        path.write_bytes(mutant)
        return read_recording(path, side=None if path.suffix in (".jsonl", ".hts") else "right")

    return read


def _places(size: int) -> SearchStrategy[int]:
    """Anywhere; often near the start or the end, where headers and indices are."""
    near = st.integers(0, min(size, 400))
    return st.integers(0, size) | near | near.map(lambda n: size - n)


@st.composite
def damaged_bytes(draw: DrawFn, data: bytes) -> bytes:
    """One to four damages that know nothing of the format."""
    for _ in range(draw(st.sampled_from((1, 1, 2, 4)))):
        at, other = draw(_places(len(data))), draw(_places(len(data)))
        size = draw(st.sampled_from((1, 2, 8, 64, 4096)))
        piece = data[at : at + size]
        flipped = bytes(byte ^ 1 << draw(st.integers(0, 7)) for byte in piece[:1]) + piece[1:]
        same_size = (flipped, bytes(len(piece)), b"\xff" * len(piece), data[other : other + size])
        others = (b"", 2 * piece, b"\r\n", b"\xef\xbb\xbf", 50 * b"\n", *_INTEGERS)
        new = draw(st.sampled_from(same_size) | st.sampled_from(others) | st.binary(max_size=300))
        gone = draw(st.sampled_from((len(piece), len(new), len(new), 0, len(data))))
        data = data[:at] + new + data[at + gone :]
    return data


@st.composite
def damaged_text(draw: DrawFn, data: bytes) -> bytes:
    """Numbers of a text become extreme ones; or bytes are damaged."""
    numbers = [match.span() for match in _NUMBER.finditer(data)]
    if not numbers or draw(st.integers(0, 9)) > 6:
        return draw(damaged_bytes(data))
    spans = draw(st.lists(st.sampled_from(numbers), min_size=1, max_size=3, unique=True))
    for start, end in sorted(spans)[::-1]:
        data = data[:start] + draw(st.sampled_from(EXTREMES)).encode() + data[end:]
    return data


@st.composite
def damaged_table(draw: DrawFn, data: bytes) -> bytes:
    """Lines of TOML, CSV or XML: one is dropped, doubled, moved, or a value in it replaced."""
    lines = data.decode("utf-8", "replace").split("\n")
    for _ in range(draw(st.sampled_from((1, 1, 2)))):
        at, other = (draw(st.integers(0, len(lines) - 1)) for _ in range(2))
        line = lines[at]
        dots = "a." * draw(st.sampled_from((3, 300, 100_000)))
        cell = draw(st.sampled_from(line.split(",")))
        word = draw(st.sampled_from(re.findall(r"[A-Za-z_]{2,}", line) or [" "]))
        value = draw(st.sampled_from((*EXTREMES, "", '"', "=1+1", "\0")))
        new = draw(
            st.sampled_from(
                (
                    [],
                    [line, line],
                    [lines[other]],
                    [f"{line.split('=')[0]}= {draw(STRANGE)}"],
                    [f"{dots}a = 1", line],
                    [f"[{dots}a]", line],
                    [line.replace(cell, value, 1)],
                    [line.replace('"', draw(st.sampled_from(("", "'"))), 1)],
                    [line.replace(word, draw(st.sampled_from(_NAMES)), 1)],
                )
            )
        )
        lines[at : at + 1] = new if new or len(lines) > 1 else [""]
    return "\n".join(lines).encode("utf-8", "replace")


@st.composite
def _exchanged_attributes(draw: DrawFn, data: bytes) -> bytes:
    """Values of attributes become those of others, or extreme ones."""
    for _ in range(draw(st.sampled_from((1, 1, 2, 5)))):
        spans = [match.span(1) for match in re.finditer(rb'\w="([^"]*)"', data)]
        if not spans:
            break
        start, end = draw(st.sampled_from(spans))
        first, last = draw(st.sampled_from(spans))
        word = draw(st.sampled_from(EXTREMES)).encode(errors="replace").replace(b'"', b"")
        data = data[:start] + draw(st.sampled_from((data[first:last], word))) + data[end:]
    return data


def damaged_xml(data: bytes) -> SearchStrategy[bytes]:
    """A model of a robot hand: its attributes, numbers, lines or bytes are damaged."""
    damages = (_exchanged_attributes, damaged_table, damaged_text, damaged_bytes)
    return st.one_of(*(damage(data) for damage in damages))


@st.composite
def damaged_json(draw: DrawFn, data: bytes) -> bytes:
    """A value of the tree is replaced, dropped, doubled or renamed; or the text is damaged."""
    tree: Any = None
    with contextlib.suppress(ValueError, RecursionError):  # it is a mutant already
        tree = json.loads(data)
    if not isinstance(tree, dict | list) or draw(st.integers(0, 9)) > 7:
        return draw(damaged_text(data))
    tokens: list[str] = []

    def strange() -> str:
        tokens.append(draw(STRANGE))
        return f"@{len(tokens) - 1}@"

    damage_tree(draw, tree, strange)
    text = json.dumps(tree)
    for number, token in enumerate(tokens):
        text = text.replace(f'"@{number}@"', token)
    return text.encode("utf-8", "surrogatepass")


def damage_tree(draw: DrawFn, tree: Any, strange: Callable[[], Any]) -> None:
    """Drops, renames, doubles, wraps or replaces a few values in tables and lists, in place.

    Args:
        strange: makes a value that stands where another did.
    """
    for _ in range(draw(st.sampled_from((1, 1, 2, 4)))):
        found = holders(tree)
        if not found:
            return
        holder = draw(st.sampled_from(found))
        keys = list(holder) if isinstance(holder, dict) else range(len(holder))
        key = draw(st.sampled_from(keys))
        kind = draw(st.integers(0, 5))
        if kind == 0:
            del holder[key]
        elif kind == 1 and isinstance(holder, dict):
            holder[draw(st.sampled_from((*_NAMES, f"{key}\0")))] = holder.pop(key)
        elif kind == 1:
            holder *= draw(st.sampled_from((2, 50)))
        elif kind == 2:
            holder[key] = [holder[key]]
        else:
            holder[key] = strange()


def holders(tree: Any) -> list[Any]:
    """Tables and lists of a tree that hold something."""
    children = tree.values() if isinstance(tree, dict) else tree
    if not isinstance(tree, dict | list) or not tree:
        return []
    return [tree, *(holder for child in children for holder in holders(child))]


_SHAPES = (
    *("()", "(0,)", "(1,)", "(1000000000,)", "(99999999999999999999,)", "(-1,)", "(0, 21, 3)"),
    *("(5, 21, 3)", "(2, 25, 7)", "(True,)", "(1.5,)", "('a',)", "[3]", "None"),
    *("(" * 200 + ")" * 200, "(3, 0, 4611686018427387904)"),
)
_TYPES = (
    *("'<f8'", "'>f8'", "'<f4'", "'<f2'", "'|b1'", "'|i1'", "'<u8'", "'|O'", "'<U0'", "'<U9'"),
    *("'|S0'", "'|S5'", "'<c16'", "'<M8[ns]'", "'<m8'", "'|V8'", "'|V0'", "'<U999999999'"),
    *("'<g16'", "'nonsense'", "7", "None", "[('a', '<f8')]", "'f8,' * 9"),
)
_TITLES = ("landmarks.npy", "x.npy", "a\0b.npy", "../x.npy", "x.pkl", "é.npy")
_DOUBLES = (0.0, -1.0, float("nan"), float("inf"), 1e308, 1e30, 1e-320, 1000.0)


@st.composite
def damaged_npz(draw: DrawFn, data: bytes) -> bytes:
    """Members of a zip of arrays: header, data, name, order, compression; or the zip itself."""
    if draw(st.integers(0, 9)) > 6:
        return draw(damaged_bytes(data))
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        members = [(item.filename, archive.read(item)) for item in archive.infolist()]
    for _ in range(draw(st.sampled_from((1, 1, 2, 3)))):
        at, other = (draw(st.integers(0, len(members) - 1)) for _ in range(2))
        name, content = members[at]
        damages = (damaged_npy, damaged_npy, _damaged_values, damaged_bytes)
        new = [(name, draw(st.one_of(*(damage(content) for damage in damages))))]
        renamed = [(draw(st.sampled_from(_TITLES)), content)]
        exchanged = [(name, members[other][1])]
        gone = [] if len(members) > 1 else [(name, b"")]
        members[at : at + 1] = draw(
            st.sampled_from((new, new, new, new, exchanged, renamed, 2 * [members[at]], gone))
        )
    stream = io.BytesIO()
    method = draw(st.sampled_from((zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED, zipfile.ZIP_BZIP2)))
    with warnings.catch_warnings(), zipfile.ZipFile(stream, "w", method) as archive:
        warnings.simplefilter("ignore")  # of names that come twice
        for name, content in members:
            archive.writestr(zipfile.ZipInfo(name), content, method)
    return stream.getvalue()


def _header(content: bytes) -> tuple[str, bytes]:
    """The text of the header of an array, and its data."""
    if content[:6] != b"\x93NUMPY" or len(content) < 12:
        return "", content
    size = struct.unpack_from("<H", content, 8)[0]
    return content[10 : 10 + size].decode("latin-1").rstrip("\n"), content[10 + size :]


def _npy(header: str, body: bytes, version: int = 1) -> bytes:
    text = header.encode("latin-1", "replace")
    text += b" " * (-(len(text) + 11) % 64) + b"\n"
    size = 2 if version == 1 else 4
    length = (len(text) % (1 << 8 * size)).to_bytes(size, "little")
    return b"\x93NUMPY" + bytes((version, 0)) + length + text + body


@st.composite
def damaged_npy(draw: DrawFn, content: bytes) -> bytes:
    """The header of an array: its shape, its type, or its text."""
    header, body = _header(content)
    if not header:
        return draw(damaged_bytes(content))
    kind = draw(st.integers(0, 3))
    if kind == 0:
        shape = f"'shape': {draw(st.sampled_from(_SHAPES))}"
        header = re.sub(r"'shape': \([^)]*\)", shape, header)
    elif kind == 1:
        header = re.sub(r"'descr': '[^']*'", f"'descr': {draw(st.sampled_from(_TYPES))}", header)
    elif kind == 2:
        header = header.replace("False", draw(st.sampled_from(("True", "None", "7", "'"))))
    else:
        header = draw(damaged_text(header.encode("latin-1"))).decode("latin-1")
    return _npy(header, body, draw(st.sampled_from((1, 1, 1, 2, 3, 9))))


@st.composite
def _damaged_values(draw: DrawFn, content: bytes) -> bytes:
    """Numbers of an array become extreme ones; JSON in an array of text is damaged as JSON."""
    header, body = _header(content)
    if "<U" in header:
        with contextlib.suppress(UnicodeDecodeError):
            text = draw(damaged_json(body.decode("utf-32-le").encode())).decode("utf-8", "replace")
            new = text.encode("utf-32-le", "replace")
            return _npy(re.sub(r"<U\d+", f"<U{len(new) // 4}", header), new)
    values = bytearray(body)
    for _ in range(draw(st.sampled_from((1, 5, 50))) if len(body) >= 8 else 0):
        at = 8 * draw(st.integers(0, len(body) // 8 - 1))
        struct.pack_into("<d", values, at, draw(st.sampled_from(_DOUBLES)))
    return content[: len(content) - len(body)] + bytes(values)


@dataclass(frozen=True)
class Verdict:
    """What a reader made of a file.

    Attributes:
        outcome: ``read``; ``refused`` with an error of the package; or a fault: another
            ``exception``, ``slow``, ``memory``, or it ``died``.
        detail: the message, or where it failed.
        seconds: of the processor.
        megabytes: at most, beyond what the process had before.
    """

    outcome: Literal["read", "refused", "exception", "slow", "memory", "died"]
    detail: str = ""
    seconds: float = 0.0
    megabytes: float = 0.0

    @property
    def sound(self) -> bool:
        """Whether the file was read, or refused as it should be."""
        return self.outcome in ("read", "refused")


class ReaderProcess:
    """A process that reads files, with limits on processor and memory; started again if it dies.

    Args:
        paths: more folders to import from.
    """

    def __init__(self, paths: Sequence[str] = ()) -> None:
        self._paths = list(paths)
        self._process: subprocess.Popen[bytes] | None = None

    def __enter__(self) -> "ReaderProcess":
        return self

    def __exit__(self, *_: object) -> None:
        self._end()

    def read(self, target: str, path: Path) -> Verdict:
        """Has ``module:function`` read a file."""
        if self._process is None:
            environment = {**os.environ, "PYTHONPATH": os.pathsep.join([*self._paths, *sys.path])}
            self._process = subprocess.Popen(
                [sys.executable, __file__],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                env=environment,
            )
        process = self._process
        with contextlib.suppress(BrokenPipeError):
            process.stdin.write(json.dumps([target, str(path)]).encode() + b"\n")
            process.stdin.flush()
        line = b""
        if select.select([process.stdout], [], [], _WALL_S)[0]:
            line = process.stdout.readline()
        if line:
            return Verdict(**json.loads(line))
        if process.poll() is None and not select.select([process.stdout], [], [], 0)[0]:
            self._end()
            return Verdict("slow", f"no answer within {_WALL_S:g} s")
        code = process.wait()
        self._end()
        slow = code == -24  # SIGXCPU
        return Verdict("slow" if slow else "died", f"the process ended with {code}")

    def _end(self) -> None:
        if self._process is not None:
            self._process.kill()
            self._process.communicate()
            self._process = None


def serve() -> None:
    """Reads what is asked for on standard input, one line each, until it ends."""
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # whatever a reader prints is no answer
    for line in sys.stdin:
        target, path = json.loads(line)
        module, name = target.split(":")
        function = getattr(importlib.import_module(module), name)
        answers.write(json.dumps(asdict(_verdict(function, Path(path)))).encode() + b"\n")
        answers.flush()


def _verdict(function: Callable[[Path], Any], path: Path) -> Verdict:
    import resource

    from smooth_operator.errors import SmoothOperatorError

    with contextlib.suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5")  # the peak counts from here
    before, begun = _megabytes("VmRSS"), _processor()
    hard = resource.getrlimit(resource.RLIMIT_CPU)[1]
    resource.setrlimit(resource.RLIMIT_CPU, (int(time.process_time() + 2 * CPU_S) + 1, hard))
    room = int(_megabytes("VmSize") * 1e6) + _ADDRESS_SPACE
    resource.setrlimit(resource.RLIMIT_AS, (room, resource.getrlimit(resource.RLIMIT_AS)[1]))
    outcome, detail = "read", ""
    try:
        function(path)
    except SmoothOperatorError as error:
        outcome, detail = "refused", str(error)
        if not detail.strip() or len(detail) > LONGEST_MESSAGE:
            outcome, detail = "exception", f"a message of {len(detail)} characters: {detail[:300]}"
        elif re.search(r"\b[A-Z]\w*Error\b", detail.replace(path.name, "")):
            outcome, detail = "exception", f"names a class of Python: {detail[:300]}"
    except BaseException as error:
        last = traceback.extract_tb(error.__traceback__)
        own = [at for at in last if "smooth_operator" in at.filename] or list(last)
        where = f"{own[-1].filename.split('smooth_operator/')[-1]}:{own[-1].lineno}"
        outcome, detail = "exception", f"{type(error).__name__} {where}: {str(error)[:200]}"
    seconds, peak = _processor() - begun, _megabytes("VmHWM") - before
    if seconds > CPU_S:
        outcome, detail = "slow", f"{seconds:.1f} s; {detail[:200]}"
    elif peak > MEMORY_MB:
        outcome, detail = "memory", f"{peak:.0f} MB; {detail[:200]}"
    return Verdict(outcome, detail[:LONGEST_MESSAGE], seconds, peak)


def _processor() -> float:
    """Time of the processor that this process and those it waited for have used [s]."""
    return sum(os.times()[:4])


def _megabytes(name: str) -> float:
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith(name + ":"):
            return float(line.split()[1]) / 1e3
    return 0.0


if __name__ == "__main__":
    serve()
