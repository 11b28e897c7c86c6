"""How a damaged data set in MANO's parameters is made, and what a sound reading of it is: numbers
where a landmark is valid, stamps that increase, poses of objects and camera that are poses or NaN,
and hands that are of their side.
"""

import json
import random
import re
import struct
from pathlib import Path

import fuzzing
import numpy as np
from hostile_datasets import mutate_lines

_DOUBLES = (0.0, -1.0, 1.0, 3.2, 1000.0, 1e30, -1e308, float("nan"), float("inf"), 5e-324)
_WORD = re.compile(rb"[a-z][a-zA-Z_0-9]{2,20}")


def read_soundly(layout: str, path: Path) -> None:
    """Reads a data set as the command does; MANO's model stands in ``mano`` three folders up.

    Raises:
        SmoothOperatorError: it is refused.
        AssertionError: it is not read soundly.
    """
    from smooth_operator.datasets.registry import DATASETS, ReadingOptions

    models = next(p / "mano_models" for p in path.parents if (p / "mano_models").is_dir())
    reader = DATASETS.load(layout)
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


def mutate_numbers(rng: random.Random, data: bytes) -> bytes:
    """Numbers of arrays become extreme, runs of them are exchanged, names are exchanged."""
    if rng.random() < 0.35:
        return fuzzing.mutate_bytes(rng, data)
    found = bytearray(data)
    for _ in range(rng.choice((1, 1, 3, 20))):
        kind = rng.randrange(4)
        at = rng.randrange(max(len(found) - 64, 1))
        if kind == 0:
            found[at : at + 8] = struct.pack("<d", rng.choice(_DOUBLES))
        elif kind == 1:
            other = rng.randrange(max(len(found) - 64, 1))
            size = rng.choice((8, 24, 64))
            found[at : at + size], found[other : other + size] = (
                found[other : other + size],
                found[at : at + size],
            )
        else:
            words = {match[0] for match in _WORD.finditer(bytes(found))}
            one = rng.choice(sorted(words)) if words else b""
            same = sorted(word for word in words if len(word) == len(one) and word != one)
            if same:
                other_word = rng.choice(same)
                mixed = bytes(found).replace(one, b"\0" * len(one)).replace(other_word, one)
                found = bytearray(mixed.replace(b"\0" * len(one), other_word, 1))
    return bytes(found)


def mutate_zip(rng: random.Random, data: bytes) -> bytes:
    """A member of a zip, which gets a right checksum again."""
    import io
    import zipfile

    if rng.random() < 0.4:
        return fuzzing.mutate_npz(rng, data)
    stream = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(data)) as archive, zipfile.ZipFile(stream, "w") as new:
        names = archive.namelist()
        chosen = rng.choice(names)
        for name in names:
            content = archive.read(name)
            new.writestr(name, mutate_numbers(rng, content) if name == chosen else content)
    return stream.getvalue()


MUTATE: dict[str, fuzzing.Mutate] = {
    ".npz": mutate_zip, ".npy": mutate_numbers, ".pkl": mutate_numbers, ".ply": fuzzing.mutate_text,
    ".yml": fuzzing.mutate_table, ".csv": fuzzing.mutate_table, ".json": fuzzing.mutate_json,
    ".jsonl": mutate_lines,
}  # fmt: skip
