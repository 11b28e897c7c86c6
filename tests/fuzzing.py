"""Hostile files: mutants of good ones, and a process of their own that reads them under limits.

``mutate_bytes``, ``mutate_text``, ``mutate_json``, ``mutate_table`` (TOML, CSV and XML, by lines),
``mutate_xml`` and ``mutate_npz`` each take a random generator and the bytes of a good file and give
those of a damaged one; the same seed gives the same mutant. ``ReaderProcess`` calls a reader, named
as ``module:function``, on a file in another process and says what came of it::

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
import random
import re
import select
import struct
import subprocess
import sys
import time
import traceback
import zipfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

Mutate = Callable[[random.Random, bytes], bytes]

CPU_S = 5.0
"""What a reader may take [s of the processor], so that other work on the machine does not count."""
MEMORY_MB = 450.0
"""What a reader may take beyond what the process had before."""
LONGEST_MESSAGE = 1500
"""Characters of an error: a person reads it."""

_WALL_S = 60.0  # for one that waits for ever and computes nothing
_ADDRESS_SPACE = 3 << 30  # beyond what the process has; protects the machine

EXTREMES: tuple[str, ...] = (
    "0", "-0.0", "-1", "1", "1e308", "-1e308", "1e-320", "1e400", "nan", "inf", "-inf", "NaN",
    "Infinity", "-Infinity", "true", "false", "null", '""', '"x"', "[]", "{}", "[[]]",
    "9" * 19, "1" + "0" * 25, "9" * 400, "9" * 5000, "0x7fffffffffffffff", "18446744073709551616",
    "1e11", "100000000000", "2147483648", "-9223372036854775809", "1_0", "0.5", "1e-9",
    '"' + "y" * 5000 + '"', '"[/x]"', '"../../x"', '"a\\u0000b"', '"\\ud800"', '"\u202e"',
    "1979-05-27T07:32:00Z",
)  # fmt: skip
"""Words that stand where a number or a text did, in JSON, TOML, CSV, XML."""

_ATTRIBUTE = re.compile(rb'(\w+)="([^"]*)"')
_NUMBER = re.compile(rb"-?\d+(?:\.\d+)?(?:[eE][+-]?\d+)?")


def deep(rng: random.Random) -> str:
    """Brackets within brackets, a few or too many."""
    depth = rng.choice((20, 100, 900, 5_000, 100_000))
    return rng.choice(("[" * depth + "]" * depth, "[" * depth, '{"a":' * depth + "1" + "}" * depth))


def mutate_bytes(rng: random.Random, data: bytes) -> bytes:
    """One to four damages that know nothing of the format."""
    for _ in range(rng.choice((1, 1, 1, 2, 4))):
        data = rng.choice(_DAMAGES)(rng, data)
    return data


def _flip(rng: random.Random, data: bytes) -> bytes:
    found = bytearray(data)
    for _ in range(rng.choice((1, 1, 2, 8, 64)) if found else 0):
        found[_place(rng, len(found))] ^= 1 << rng.randrange(8)
    return bytes(found)


def _overwrite(rng: random.Random, data: bytes) -> bytes:
    at = _place(rng, len(data) + 1)
    new = rng.randbytes(rng.choice((1, 2, 4, 16, 300)))
    return data[:at] + new + data[at + len(new) :]


def _integer(rng: random.Random, data: bytes) -> bytes:
    form = rng.choice(("<H", "<I", "<Q", ">I", ">Q", "B"))
    bits = 8 * struct.calcsize(form)
    value = rng.choice((0, 1, 2, (1 << bits) - 1, 1 << (bits - 1), (1 << (bits - 1)) - 1, 1 << 20))
    at = _place(rng, len(data) + 1)
    new = struct.pack(form, value % (1 << bits))
    return data[:at] + new + data[at + len(new) :]


def _cut(rng: random.Random, data: bytes) -> bytes:
    return data[: _place(rng, len(data) + 1)]


def _drop(rng: random.Random, data: bytes) -> bytes:
    at = _place(rng, len(data) + 1)
    return data[:at] + data[at + rng.choice((1, 2, 8, 100, 5000)) :]


def _double(rng: random.Random, data: bytes) -> bytes:
    at = _place(rng, len(data) + 1)
    return data[:at] + data[at : at + rng.choice((1, 8, 100, 5000))] + data[at:]


def _insert(rng: random.Random, data: bytes) -> bytes:
    at = _place(rng, len(data) + 1)
    junk = rng.choice((b"\0", b"\xff", b"\n", b"\r\n", b"\xef\xbb\xbf", rng.randbytes(7)))
    return data[:at] + junk * rng.choice((1, 1, 50)) + data[at:]


def _blank(rng: random.Random, data: bytes) -> bytes:
    at, size = _place(rng, len(data) + 1), rng.choice((1, 8, 64, 4096))
    return data[:at] + rng.choice((b"\0", b"\xff")) * len(data[at : at + size]) + data[at + size :]


def _swap(rng: random.Random, data: bytes) -> bytes:
    size = rng.choice((1, 4, 64, 512))
    a, b = sorted((_place(rng, len(data) + 1), _place(rng, len(data) + 1)))
    if b < a + size:
        return data
    return (
        data[:a] + data[b : b + size] + data[a + size : b] + data[a : a + size] + data[b + size :]
    )


_DAMAGES: tuple[Mutate, ...] = (
    _flip, _flip, _flip, _overwrite, _integer, _integer, _cut, _drop, _double, _insert, _blank,
    _swap,
)  # fmt: skip


def _place(rng: random.Random, size: int) -> int:
    """Anywhere; often near the start or the end, where headers and indices are."""
    near = min(size, rng.choice((size, size, 64, 400, 2000))) or 1
    at = rng.randrange(near)
    return at if rng.random() < 0.7 else max(size - 1 - at, 0)


def mutate_text(rng: random.Random, data: bytes) -> bytes:
    """A number of a text becomes an extreme one; or bytes are damaged."""
    numbers = list(_NUMBER.finditer(data))
    if not numbers or rng.random() < 0.3:
        return mutate_bytes(rng, data)
    for match in sorted(rng.sample(numbers, min(len(numbers), rng.choice((1, 1, 3)))), key=_start)[
        ::-1
    ]:
        new = rng.choice(EXTREMES).encode()
        data = data[: match.start()] + new + data[match.end() :]
    return data


def _start(match: re.Match[bytes]) -> int:
    return match.start()


def mutate_table(rng: random.Random, data: bytes) -> bytes:
    """Lines of TOML, CSV or XML: one is dropped, doubled, moved, or a value in it replaced."""
    if rng.random() < 0.25:
        return mutate_text(rng, data)
    lines = data.decode("utf-8", "replace").split("\n")
    for _ in range(rng.choice((1, 1, 2))):
        at = rng.randrange(len(lines))
        kind = rng.randrange(8)
        if kind == 0:
            del lines[at]
            lines = lines or [""]
        elif kind == 1:
            lines.insert(rng.randrange(len(lines)), lines[at])
        elif kind == 2:
            other = rng.randrange(len(lines))
            lines[at], lines[other] = lines[other], lines[at]
        elif kind == 3 and "=" in lines[at]:
            key = lines[at].split("=", 1)[0]
            lines[at] = f"{key}= {rng.choice((*EXTREMES, deep(rng)))}"
        elif kind == 4:
            dots = rng.choice((3, 40, 300, 20_000, 100_000))
            lines.insert(at, rng.choice((f"{'a.' * dots}a = 1", f"[{'a.' * dots}a]")))
        elif kind == 5 and "," in lines[at]:
            cells = lines[at].split(",")
            cells[rng.randrange(len(cells))] = rng.choice((*EXTREMES, "", '"', "=1+1", "\0"))
            lines[at] = ",".join(cells)
        elif kind == 6:
            lines[at] = lines[at].replace('"', rng.choice(("", "'", '""')), 1)
        else:
            words = re.findall(r"[A-Za-z_]{2,}", lines[at]) or [" "]
            new = rng.choice(("", "x", "format", "__class__", "é", "z" * 3000))
            lines[at] = lines[at].replace(rng.choice(words), new, 1)
    return "\n".join(lines).encode("utf-8", "replace")


def swap_attributes(rng: random.Random, data: bytes) -> bytes:
    """Values of attributes become those of others, or extreme ones."""
    for _ in range(rng.choice((1, 1, 2, 5))):
        found = list(_ATTRIBUTE.finditer(data))
        if not found:
            break
        at = rng.choice(found)
        words = [match[2] for match in found]
        words += [word.encode(errors="replace").replace(b'"', b"") for word in EXTREMES]
        data = data[: at.start(2)] + rng.choice(words) + data[at.end(2) :]
    return data


def mutate_xml(rng: random.Random, data: bytes) -> bytes:
    """A model of a robot hand: its attributes, numbers, lines or bytes are damaged."""
    damage = rng.choice((mutate_bytes, mutate_table, mutate_text, swap_attributes))
    return damage(rng, data)


def mutate_json(rng: random.Random, data: bytes) -> bytes:
    """A value of the tree is replaced, dropped, doubled or renamed; or the text is damaged."""
    if rng.random() < 0.25:
        return mutate_text(rng, data)
    try:
        tree = json.loads(data)
    except (ValueError, RecursionError):  # it was a mutant already
        return mutate_text(rng, data)
    raw: list[str] = []
    for _ in range(rng.choice((1, 1, 2, 4))):
        tree = _mutated(rng, tree, raw)
    text = json.dumps(tree)
    for number, word in enumerate(raw):
        text = text.replace(f'"@raw{number}@"', word)
    return text.encode("utf-8", "surrogatepass")


def _mutated(rng: random.Random, tree: Any, raw: list[str]) -> Any:
    holders = [node for node in _nodes(tree) if node and isinstance(node, dict | list)]

    def strange() -> str:
        raw.append(deep(rng) if rng.random() < 0.1 else rng.choice(EXTREMES))
        return f"@raw{len(raw) - 1}@"

    if not holders or rng.random() < 0.03:
        return strange()
    holder = rng.choice(holders)
    if isinstance(holder, list):
        at = rng.randrange(len(holder))
        kind = rng.randrange(5)
        if kind == 0:
            del holder[at]
        elif kind == 1:
            holder.insert(at, holder[at])
        elif kind == 2:
            holder[:] = holder * rng.choice((2, 50))
        else:
            holder[at] = strange()
        return tree
    key = rng.choice(list(holder))
    kind = rng.randrange(6)
    if kind == 0:
        del holder[key]
    elif kind == 1:
        holder[rng.choice(("x", "", "format", "__init__", key + "\0"))] = holder.pop(key)
    elif kind == 2:
        holder[key] = [holder[key]]
    else:
        holder[key] = strange()
    return tree


def _nodes(tree: Any) -> Iterator[Any]:
    yield tree
    for child in (
        tree.values() if isinstance(tree, dict) else tree if isinstance(tree, list) else ()
    ):
        yield from _nodes(child)


_SHAPES = ("()", "(0,)", "(1,)", "(1000000000,)", "(99999999999999999999,)", "(-1,)", "(0, 21, 3)",
           "(5, 21, 3)", "(2, 25, 7)", "(True,)", "(1.5,)", "('a',)", "[3]", "None",
           "(" * 200 + ")" * 200, "(3, 0, 4611686018427387904)")  # fmt: skip
_TYPES = ("'<f8'", "'>f8'", "'<f4'", "'<f2'", "'|b1'", "'|i1'", "'<u8'", "'|O'", "'<U0'", "'<U9'",
          "'|S0'", "'|S5'", "'<c16'", "'<M8[ns]'", "'<m8'", "'|V8'", "'|V0'", "'<U999999999'", "7",
          "[('a', '<f8')]", "'f8,' * 9", "'<g16'", "'nonsense'", "None")  # fmt: skip


def mutate_npz(rng: random.Random, data: bytes) -> bytes:
    """Members of a zip of arrays: header, data, name, order, compression; or the zip itself."""
    if rng.random() < 0.3:
        return mutate_bytes(rng, data)
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            members = [(item.filename, archive.read(item)) for item in archive.infolist()]
    except Exception:  # it was a mutant already
        return mutate_bytes(rng, data)
    for _ in range(rng.choice((1, 1, 2, 3))):
        if not members:
            break
        at = rng.randrange(len(members))
        name, content = members[at]
        kind = rng.randrange(10)
        if kind <= 2:
            members[at] = (name, mutate_npy(rng, content))
        elif kind == 3:
            members[at] = (name, mutate_bytes(rng, content))
        elif kind == 4:
            members[at] = (name, members[rng.randrange(len(members))][1])
        elif kind == 5:
            new = rng.choice(("landmarks.npy", "x.npy", "a\0b.npy", "../x.npy", "x.pkl", "é.npy"))
            members[at] = (new, content)
        elif kind == 6:
            del members[at]
        elif kind == 7:
            members.append((name, content))
        elif kind == 8:
            members[at] = (name, _values(rng, content))
        else:
            members[at] = (name, _json_inside(rng, content))
    stream = io.BytesIO()
    method = rng.choice((zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED, zipfile.ZIP_BZIP2))
    import warnings

    with warnings.catch_warnings(), zipfile.ZipFile(stream, "w", method) as archive:
        warnings.simplefilter("ignore")  # of names that come twice
        for name, content in members:
            archive.writestr(zipfile.ZipInfo(name), content, method)
    return stream.getvalue()


def mutate_npy(rng: random.Random, content: bytes) -> bytes:
    """The header of an array: its shape, its type, or its text."""
    if content[:6] != b"\x93NUMPY" or len(content) < 12:
        return mutate_bytes(rng, content)
    size = struct.unpack_from("<H", content, 8)[0]
    header, body = content[10 : 10 + size].decode("latin-1"), content[10 + size :]
    kind = rng.randrange(5)
    if kind <= 1:
        header = re.sub(r"'shape': \([^)]*\)", f"'shape': {rng.choice(_SHAPES)}", header)
    elif kind == 2:
        header = re.sub(r"'descr': '[^']*'", f"'descr': {rng.choice(_TYPES)}", header)
    elif kind == 3:
        header = header.replace("False", rng.choice(("True", "None", "7", "'")))
    else:
        header = mutate_text(rng, header.encode("latin-1")).decode("latin-1")
    text = header.rstrip("\n").encode("latin-1")
    version = rng.choice((1, 1, 1, 2, 3, 9))
    text += b" " * (-(len(text) + 11) % 64) + b"\n"
    length = struct.pack(
        "<H" if version == 1 else "<I", len(text) % (65536 if version == 1 else 1 << 32)
    )
    return content[:6] + bytes((version, 0)) + length + text + body


def _values(rng: random.Random, content: bytes) -> bytes:
    """Numbers of an array become extreme ones."""
    size = struct.unpack_from("<H", content, 8)[0] if len(content) > 10 else 0
    body = bytearray(content[10 + size :])
    for _ in range(rng.choice((1, 5, 1000))):
        if len(body) < 8:
            break
        value = rng.choice((0.0, -1.0, float("nan"), float("inf"), 1e308, 1e30, 1e-320, 1000.0))
        struct.pack_into("<d", body, 8 * rng.randrange(len(body) // 8), value)
    return content[: 10 + size] + bytes(body)


def _json_inside(rng: random.Random, content: bytes) -> bytes:
    """JSON that stands in an array of text is mutated as JSON."""
    size = struct.unpack_from("<H", content, 8)[0] if len(content) > 10 else 0
    header, body = content[10 : 10 + size], content[10 + size :]
    if b"<U" not in header:
        return _values(rng, content)
    with contextlib.suppress(UnicodeDecodeError):
        text = body.decode("utf-32-le").encode()
        new = mutate_json(rng, text).decode("utf-8", "replace").encode("utf-32-le", "replace")
        title = re.sub(rb"<U\d+", b"<U%d" % (len(new) // 4), header.rstrip())
        title += b" " * (-(len(title) + 11) % 64) + b"\n"
        return content[:8] + struct.pack("<H", len(title)) + title + new
    return content


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
                [sys.executable, __file__], stdin=subprocess.PIPE, stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL, env=environment,
            )  # fmt: skip
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
    used = os.times()
    return used.user + used.system + used.children_user + used.children_system


def _megabytes(name: str) -> float:
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith(name + ":"):
            return float(line.split()[1]) / 1e3
    return 0.0


if __name__ == "__main__":
    serve()
