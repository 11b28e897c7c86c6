"""How a damaged data set in MANO's parameters is made."""

import re
import struct

import fuzzing
from hostile_datasets import damaged_lines
from hypothesis import strategies as st
from hypothesis.strategies import DrawFn

_DOUBLES = (0.0, -1.0, 1.0, 3.2, 1000.0, 1e30, -1e308, float("nan"), float("inf"), 5e-324)
_WORD = re.compile(rb"[a-z][a-zA-Z_0-9]{2,20}")


@st.composite
def damaged_numbers(draw: DrawFn, data: bytes) -> bytes:
    """Numbers of arrays become extreme, runs of them are exchanged, names are exchanged."""
    if draw(st.integers(0, 9)) > 6:
        return draw(fuzzing.damaged_bytes(data))
    content = bytearray(data)
    for _ in range(draw(st.sampled_from((1, 1, 3, 20)))):
        at, other = (draw(st.integers(0, max(len(content) - 65, 0))) for _ in range(2))
        kind = draw(st.integers(0, 3))
        if kind == 0:
            content[at : at + 8] = struct.pack("<d", draw(st.sampled_from(_DOUBLES)))
        elif kind == 1:
            one, two = (slice(i, i + draw(st.just(24))) for i in (at, other))
            content[one], content[two] = content[two], content[one]
        elif words := sorted({match[0] for match in _WORD.finditer(bytes(content))}):
            word = draw(st.sampled_from(words))
            same = draw(st.sampled_from([each for each in words if len(each) == len(word)]))
            hidden = bytes(content).replace(word, b"\0" * len(word)).replace(same, word)
            content = bytearray(hidden.replace(b"\0" * len(word), same, 1))
    return bytes(content)


DAMAGED: dict[str, fuzzing.Damaged] = {
    ".npz": fuzzing.damaged_npz,
    ".npy": damaged_numbers,
    ".pkl": damaged_numbers,
    ".ply": fuzzing.damaged_text,
    ".yml": fuzzing.damaged_table,
    ".csv": fuzzing.damaged_table,
    ".json": fuzzing.damaged_json,
    ".jsonl": damaged_lines,
}
