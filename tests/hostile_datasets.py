"""Damaged files of data sets of hands: each is read soundly or refused.

Read soundly means: numbers where a landmark is valid, stamps that increase, and no hand that shows
the other one in most of its frames.
"""

import io
import json
import random
from collections.abc import Callable
from pathlib import Path
from typing import Any

import dataset_files as files
import fuzzing
import numpy as np
from hostile_files import Mutate, mutate_hdf5

FEWEST = 5
"""Whole frames without which a side is not judged."""


def read_soundly(layout: str, path: Path) -> None:
    """Reads a file as the command does.

    Raises:
        SmoothOperatorError: it is refused.
        AssertionError: it is not read soundly.
    """
    from smooth_operator.datasets.registry import DATASETS, ReadingOptions

    reader = DATASETS.load(layout)
    reader.matches(path)
    for ref in reader.clips(path):
        options = ReadingOptions(rate=files.RATE, mano=path.parent.parent / "mano")
        clip = reader.read(ref, options)
        assert clip.hands
        assert (np.diff(clip.stamps) > 0).all()
        for side, hand in clip.hands.items():
            assert np.isfinite(hand.landmarks[hand.valid]).all()
            wrong, whole = files.wrong_frames(hand.landmarks, hand.valid, side)
            assert whole < FEWEST or wrong < whole / 2, f"{wrong} of {whole} frames of {side}"
        json.dumps(clip.meta, allow_nan=False)


def mutate_values(rng: random.Random, data: bytes) -> bytes:
    """An HDF5 file's arrays get extreme numbers or exchange their places; or as others are."""
    import h5py

    if rng.random() < 0.5:
        return mutate_hdf5(rng, data)
    stream = io.BytesIO(data)
    with h5py.File(stream, "r+") as file, np.errstate(all="ignore"):
        names: list[str] = []
        file["transforms"].visit(names.append)
        for _ in range(rng.choice((1, 3, 20))):
            one, other = (f"transforms/{rng.choice(names)}" for _ in range(2))
            kind = rng.randrange(4)
            if not len(file[one]):
                continue
            if kind == 0:
                value = rng.choice((0.0, -1.0, np.nan, np.inf, 1e308, 1e30, 1000.0))
                file[one][rng.randrange(len(file[one]))] = value
            elif kind == 1:
                content = file[one][()]
                del file[one]
                file[one] = content[: rng.randrange(len(content))]
            elif kind == 2 and one != other:
                file.move(one, "transforms/x")
                file.move(other, one)
                file.move("transforms/x", other)
            else:
                file[one][...] = file[one][...] * rng.choice((-1.0, 0.0, 1000.0))
    return stream.getvalue()


def mutate_parquet(rng: random.Random, data: bytes) -> bytes:
    """A column of another type, of extreme numbers or dropped; metadata; or bytes."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    if rng.random() < 0.5:
        return fuzzing.mutate_bytes(rng, data)
    table = pq.read_table(io.BytesIO(data))
    rows = table.num_rows
    for _ in range(rng.choice((1, 1, 3))):
        at = rng.randrange(table.num_columns)
        name = table.column_names[at]
        kind = rng.randrange(5)
        if kind == 0:
            table = table.drop_columns([name]) if table.num_columns > 1 else table
        elif kind == 1:
            new = rng.choice((
                pa.nulls(rows), pa.array([[1]] * rows), pa.array(["x" * 3000] * rows),
                pa.array([-1] * rows), pa.array([2**62] * rows), pa.array([1e308] * rows),
                pa.array([float("nan")] * rows), pa.array([{"a": 1}] * rows),
                pa.array([[[1e308] * 3] * 21] * rows), pa.array([[[0.0] * 3] * 20] * rows),
            ))  # fmt: skip
            table = table.set_column(at, name, new)
        elif kind == 2:
            other = rng.randrange(table.num_columns)
            table = table.set_column(at, name, table.column(other))
        elif kind == 3:
            table = table.take(pa.array([rng.randrange(rows) for _ in range(rows)]))
        else:
            key = rng.choice((b"coordinate_system", b"joint_order"))
            table = table.replace_schema_metadata({key: rng.choice((b"\xff", b"opengl", b""))})
    stream = io.BytesIO()
    pq.write_table(table, stream)
    return stream.getvalue()


def mutate_lines(rng: random.Random, data: bytes) -> bytes:
    """Lines of JSON: values of one, or whole lines."""
    lines = data.split(b"\n")
    if rng.random() < 0.3:
        return fuzzing.mutate_bytes(rng, data)
    for _ in range(rng.choice((1, 1, 4))):
        at = rng.randrange(len(lines))
        kind = rng.randrange(6)
        if kind == 0:
            del lines[at]
            lines = lines or [b""]
        elif kind == 1:
            lines.insert(rng.randrange(len(lines)), lines[at])
        else:
            lines[at] = fuzzing.mutate_json(rng, lines[at])
    return b"\n".join(lines)


def mutate_pickle(rng: random.Random, data: bytes) -> bytes:
    """Values of a pickle's lists and tables are replaced, dropped or doubled; or bytes."""
    import pickle

    if rng.random() < 0.4:
        return fuzzing.mutate_bytes(rng, data)
    value = pickle.loads(data)
    strange = (None, 0, 1, -1, 1e308, float("nan"), 10**30, "", "right", [], {}, [[]], b"x", (),
               np.zeros(0), np.zeros((21, 3)), np.full((1, 21, 3), 1e30), np.array("x"),
               np.zeros((21, 3), np.float16), True, 10**6, 999_999)  # fmt: skip
    for _ in range(rng.choice((1, 1, 3, 20))):
        holder, key = value, None
        while isinstance(holder, list | dict) and holder:
            key = rng.choice(list(holder) if isinstance(holder, dict) else range(len(holder)))
            if not isinstance(holder[key], list | dict) or rng.random() < 0.15:
                break
            holder = holder[key]
        if key is None or not isinstance(holder, list | dict) or not holder:
            break
        kind = rng.randrange(4)
        if kind == 0:
            del holder[key]
        elif kind == 1 and isinstance(holder, list):
            holder.insert(rng.randrange(len(holder)), holder[key])
        elif kind == 1 and isinstance(holder, dict):
            holder[rng.choice(("x", "is_right", "joints_cam", 7))] = holder.pop(key)
        else:
            holder[key] = rng.choice(strange)
    return pickle.dumps(value)


def seeds(folder: Path) -> dict[str, list[tuple[str, bytes, Mutate]]]:
    """Layout -> (name, content, how it is damaged) of its good files."""

    def made(name: str, write: Callable[[Path], Any]) -> tuple[str, bytes]:
        write(folder / name)
        return name, (folder / name).read_bytes()

    about = {"llm_description": "x", "llm_type": "reversible", "which_llm_description": "2"}
    return {
        "egodex": [(*made("0.hdf5", lambda p: files.egodex_file(p, about=about)), mutate_values)],
        "avp": [(*made("t.jsonl", files.avp_file), mutate_lines)],
        "hts": [
            (*made("t.hts", files.hts_file), fuzzing.mutate_bytes),
            (*made("t.hts", lambda p: files.hts_file(p, stamped=False)), fuzzing.mutate_text),
        ],
        "landmarks": [(*made("a.npz", files.landmarks_file), fuzzing.mutate_npz)],
        "egohandkit": [(*made("a.parquet", files.egohandkit_file), mutate_parquet)],
        "parquet": [("p.parquet", _packed(folder), mutate_parquet)],
        "predictions": [
            ("a.pkl", files.pickled(files.wilor_frames()), mutate_pickle),
            ("a.json", json.dumps(files.plain(files.wilor_frames())).encode(), fuzzing.mutate_json),
            ("wilor_hands.json", files.egotouch_lines().encode(), mutate_lines),
            ("b.json", json.dumps(files.hawor_tags()).encode(), fuzzing.mutate_json),
            ("c.pkl", files.pickled(files.hamer_arrays()), mutate_pickle),
            ("a.npz", files.detections_npz(), fuzzing.mutate_npz),
        ],
    }


def _packed(folder: Path) -> bytes:
    """Three clips in the format of the Parquet writer."""
    from made_clips import made_clip

    from smooth_operator.datasets.clip import RobotClip
    from smooth_operator.datasets.writers.parquet import PARQUET
    from smooth_operator.datasets.writers.registry import WritingOptions

    with PARQUET.open(folder / "packed", WritingOptions()) as writer:
        for number in range(3):
            writer.write(RobotClip(made_clip(number, (0.3, 0.6)), {}, {}, {}, {}, key=str(number)))
    (path,) = (folder / "packed" / "data").iterdir()
    return path.read_bytes()


def reconstruction_seeds(folder: Path) -> dict[str, list[tuple[str, bytes, Mutate]]]:
    """The same of the layouts in MANO's parameters; the model files are in ``folder/mano``."""
    import mano_files
    import test_dataset_reconstructions as made

    mano_files.write_models(folder / "mano")
    path = made.hawor_folder(folder / "kitchen")
    stream = io.BytesIO()
    np.savez(stream, **made.dyn_hamr_arrays())
    return {
        "hawor": [(path.name, path.read_bytes(), fuzzing.mutate_bytes)],
        "dynhamr": [("a.npz", stream.getvalue(), fuzzing.mutate_npz)],
    }
