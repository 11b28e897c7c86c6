"""Damaged data sets in MANO's parameters: each is read soundly or refused; run as a script.

``hostile_mano.py TRIES [SEED] [LAYOUT ...]``, with the folder ``tests`` of the repository on
``PYTHONPATH``, damages one file of each data set so many times, has it read in a process with
limits, and prints what came of it. Read soundly means: numbers where a landmark is valid, stamps
that increase, poses of objects and camera that are poses or NaN, and hands that are of their side.
``test_mano_readers.py`` does a few in its own process.
"""

from __future__ import annotations

import json
import random
import re
import shutil
import struct
import sys
import tempfile
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import fuzzing
import mano_files
import mano_layouts as layouts
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
    from smooth_operator.lab.datasets.registry import DATASETS, ReadingOptions

    models = next(p / "mano_models" for p in path.parents if (p / "mano_models").is_dir())
    reader = DATASETS.load(layout)
    reader.matches(path)
    for ref in reader.clips(path):
        clip = reader.read(ref, ReadingOptions(mano=models))
        assert clip.hands
        assert np.isfinite(clip.stamps).all()
        assert (np.diff(clip.stamps) > 0).all()
        for side, hand in clip.hands.items():
            assert hand.valid is not None
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


def _reader(layout: str) -> Callable[[Path], None]:
    return lambda path: read_soundly(layout, path)


dexycb, ho3d, arctic, oakink2 = map(_reader, ("dexycb", "ho3d", "arctic", "oakink2"))
taco, grab, hot3d, mano = map(_reader, ("taco", "grab", "hot3d", "mano"))


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


_STRANGE = (
    None, 0, 1, -1, 1e308, float("nan"), 2**70, "", "right", [], {}, [[]], b"x", (), True,
    np.zeros(0), np.zeros((8, 48)), np.zeros(48), np.full((8, 3), 1e30), np.eye(4), np.eye(3),
    np.float64(3.0), mano_files.Tensor(np.zeros((2, 0))), mano_files.Ch(np.zeros(10)), [1] * 10,
)  # fmt: skip


def mutate_tree(rng: random.Random, value: object) -> object:
    """A value of nested tables, lists and arrays is replaced, dropped, exchanged or changed."""
    if isinstance(value, mano_files.Tensor):
        return mano_files.Tensor(_changed_array(rng, value.array))
    if isinstance(value, np.ndarray):
        return _changed_array(rng, value)
    if not isinstance(value, dict | list) or not value:
        return rng.choice(_STRANGE)
    copy = dict(value) if isinstance(value, dict) else list(value)
    keys = list(copy) if isinstance(copy, dict) else list(range(len(copy)))
    key, other = rng.choice(keys), rng.choice(keys)
    kind = rng.random()
    if kind < 0.6:
        copy[key] = mutate_tree(rng, copy[key])
    elif kind < 0.7:
        del copy[key]
    elif kind < 0.85:
        copy[key], copy[other] = copy[other], copy[key]
    else:
        copy[key] = rng.choice(_STRANGE)
    return copy


def _changed_array(rng: random.Random, array: np.ndarray) -> np.ndarray:
    found = np.array(array, np.float64)
    kind = rng.randrange(7)
    with np.errstate(all="ignore"):
        if kind == 0 and found.size:
            found.flat[rng.randrange(found.size)] = rng.choice(_DOUBLES)
        elif kind == 1:
            found = found * rng.choice((-1.0, 0.0, 1000.0, 0.01, 1e300))
        elif kind == 2 and found.ndim:
            found = found[: rng.randrange(len(found) + 1)]
        elif kind == 3:
            found = found.T
        elif kind == 4:
            found = found[None]
        elif kind == 5 and found.ndim:
            found = found[::-1].copy()
        else:
            found[...] = rng.choice(_DOUBLES)
    return found


MUTATE: dict[str, fuzzing.Mutate] = {
    ".npz": mutate_zip, ".npy": mutate_numbers, ".pkl": mutate_numbers, ".ply": fuzzing.mutate_text,
    ".yml": fuzzing.mutate_table, ".csv": fuzzing.mutate_table, ".json": fuzzing.mutate_json,
    ".jsonl": mutate_lines,
}  # fmt: skip


TREES = ("ho3d", "ho3d two hands", "arctic", "oakink2", "taco", "mano pickle")
"""Data sets whose pickles are written from tables of Python."""


def _of_a_tree(
    rng: random.Random,
    folder: Path,
    layout: str,
    write: Callable[[Path], layouts.Made],
    process: fuzzing.ReaderProcess,
) -> tuple[Path, fuzzing.Verdict]:
    """A data set whose pickles hold other values, but are sound themselves."""
    mano_files.CHANGE.append(lambda value: mutate_tree(rng, value))
    try:
        made = write(folder)
    finally:
        mano_files.CHANGE.clear()
    verdict = process.read(f"hostile_mano:{layout}", made.path)
    shutil.rmtree(folder)
    return made.path, verdict


def campaign(tries: int, seed: int, only: tuple[str, ...] = ()) -> list[str]:
    """Reads mutants, prints what came of them, and gives a line for each fault."""
    faults: list[str] = []
    with (
        tempfile.TemporaryDirectory() as name,
        fuzzing.ReaderProcess([str(Path(__file__).parent)]) as process,
    ):
        folder = Path(name)
        mano_files.write_models(folder / "mano_models")
        for case, (layout, write) in layouts.CASES.items():
            if only and layout not in only:
                continue
            made = write(folder / case.replace(" ", "_"))
            counts: Counter[str] = Counter()
            seconds = megabytes = 0.0
            for i in range(-1, tries):
                rng = random.Random(f"{case} {seed} {i}")
                if i >= 0 and i % 3 == 0 and case in TREES:
                    file, verdict = _of_a_tree(rng, folder / "tree", layout, write, process)
                else:
                    file = made.files[i % len(made.files)]
                    content = file.read_bytes()
                    if i >= 0:
                        file.write_bytes(MUTATE[file.suffix](rng, content))
                    verdict = process.read(f"hostile_mano:{layout}", made.path)
                    file.write_bytes(content)
                if i < 0:
                    assert verdict.outcome in ("read", "slow"), (case, verdict)  # imports
                    continue
                counts[verdict.outcome] += 1
                seconds = max(seconds, verdict.seconds)
                megabytes = max(megabytes, verdict.megabytes)
                if not verdict.sound:
                    faults.append(f"{case} {file.name} seed {seed} try {i}: {verdict}")
            print(
                f"{case:15} {counts.total():6} {dict(counts)}; at most {seconds:.1f} s of the "
                f"processor and {megabytes:.0f} MB",
                flush=True,
            )
            shutil.rmtree(folder / case.replace(" ", "_"))
    return faults


if __name__ == "__main__":
    found = campaign(int(sys.argv[1]), int((sys.argv[2:] or ["0"])[0]), tuple(sys.argv[3:]))
    print("\n".join(found))
