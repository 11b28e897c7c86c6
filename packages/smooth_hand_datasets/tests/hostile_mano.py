"""How a damaged data set in MANO's parameters is made, and what a sound reading of it is: numbers
where a landmark is valid, stamps that increase, poses of objects and camera that are poses or NaN,
and hands that are of their side.
"""

import io
import json
import re
import struct
import zipfile
from pathlib import Path

import fuzzing
import numpy as np
from hostile_datasets import damaged_lines
from hypothesis import strategies as st
from hypothesis.strategies import DrawFn

_DOUBLES = (0.0, -1.0, 1.0, 3.2, 1000.0, 1e30, -1e308, float("nan"), float("inf"), 5e-324)
_WORD = re.compile(rb"[a-z][a-zA-Z_0-9]{2,20}")


def read_soundly(layout: str, path: Path) -> None:
    """Reads a data set as the command does; MANO's model stands in ``mano`` three folders up.

    Raises:
        SmoothOperatorError: it is refused.
        AssertionError: it is not read soundly.
    """
    from smooth_operator.formats.clip import ReadingOptions
    from smooth_operator.formats.registry import READERS

    models = next(p / "mano_models" for p in path.parents if (p / "mano_models").is_dir())
    reader = READERS.load(layout)
    reader.matches(path)
    for ref in reader.clips(path):
        clip = reader.read(ref, ReadingOptions(mano=models))
        assert clip.hands
        assert np.isfinite(clip.stamps).all()
        assert (np.diff(clip.stamps) > 0).all()
        for side, hand in clip.hands.items():
            assert np.isfinite(hand.landmarks[hand.valid]).all()
            wrong, whole = wrong_frames(hand.landmarks, hand.valid, side)
            assert 2 * wrong <= whole, f"{wrong} of {whole} frames of {side}"
        placed = [one.T_world_object for one in clip.objects]
        placed += [] if clip.T_world_camera is None else [clip.T_world_camera]
        for poses in placed:
            known = poses[np.isfinite(poses).all(axis=1)]
            np.testing.assert_allclose(np.linalg.norm(known[:, 3:], axis=1), 1.0, atol=1e-6)
        json.dumps(clip.meta, allow_nan=False)
        assert clip.task is None or len(clip.task) <= 2000


def wrong_frames(points: np.ndarray, valid: np.ndarray, side: str) -> tuple[int, int]:
    """Frames that show the other hand: the thumb's base on the wrong side, or fingers far back."""
    whole = points[valid.all(axis=1)]
    forward = whole[:, 9] - whole[:, 0]
    length = np.maximum(np.linalg.norm(forward, axis=1, keepdims=True), 1e-12)
    forward = forward / length
    across = whole[:, 5] - whole[:, 17]
    back = np.cross(forward, across)
    back /= np.maximum(np.linalg.norm(back, axis=1, keepdims=True), 1e-12)
    if side == "left":
        back = -back
    tips = (whole[:, [8, 12, 16, 20]] - whole[:, [5, 9, 13, 17]]).mean(axis=1)
    out = (tips * back).sum(axis=1) / length[:, 0]
    return int((out > 0.31).sum()), len(whole)


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


@st.composite
def damaged_zip(draw: DrawFn, data: bytes) -> bytes:
    """A member of a zip, which gets a right checksum again."""
    if draw(st.integers(0, 9)) > 5:
        return draw(fuzzing.damaged_npz(data))
    stream = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(data)) as archive, zipfile.ZipFile(stream, "w") as new:
        chosen = draw(st.sampled_from(archive.namelist()))
        for name in archive.namelist():
            content = archive.read(name)
            new.writestr(name, draw(damaged_numbers(content)) if name == chosen else content)
    return stream.getvalue()


DAMAGED: dict[str, fuzzing.Damaged] = {
    ".npz": damaged_zip,
    ".npy": damaged_numbers,
    ".pkl": damaged_numbers,
    ".ply": fuzzing.damaged_text,
    ".yml": fuzzing.damaged_table,
    ".csv": fuzzing.damaged_table,
    ".json": fuzzing.damaged_json,
    ".jsonl": damaged_lines,
}
