"""Damaged files of data sets of hands: each is read soundly or refused.

Read soundly means: numbers where a landmark is valid, stamps that increase, and no hand that shows
the other one in most of its frames.
"""

import io
import json
import pickle
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import dataset_files as files
import fuzzing
import numpy as np
from hostile_files import damaged_hdf5, odd_columns
from hypothesis import strategies as st
from hypothesis.strategies import DrawFn

from smooth_operator.errors import SmoothOperatorError
from smooth_operator.formats.clip import ReadingOptions

FEWEST = 5
"""Whole frames without which a side is not judged."""


def read_soundly(layout: str, path: Path, options: ReadingOptions) -> None:
    """Reads a file as the command does.

    Raises:
        SmoothOperatorError: it is refused.
        AssertionError: it is not read soundly.
    """
    from smooth_operator.formats.registry import READERS

    reader = READERS.load(layout)
    reader.matches(path)
    for ref in reader.clips(path):
        clip = reader.read(ref, options)
        assert clip.hands
        assert (np.diff(clip.stamps) > 0).all()
        for side, hand in clip.hands.items():
            assert np.isfinite(hand.landmarks[hand.valid]).all()
            wrong, whole = files.wrong_frames(hand.landmarks, hand.valid, side)
            assert whole < FEWEST or wrong < whole / 2, f"{wrong} of {whole} frames of {side}"
        placed = [one.T_world_object for one in clip.objects]
        placed += [] if clip.T_world_camera is None else [clip.T_world_camera]
        for poses in placed:
            known = poses[np.isfinite(poses).all(axis=1)]
            np.testing.assert_allclose(np.linalg.norm(known[:, 3:], axis=1), 1.0, atol=1e-6)
        json.dumps(clip.meta, allow_nan=False)
        assert clip.task is None or len(clip.task) <= 2000


@st.composite
def damaged_parquet(draw: DrawFn, data: bytes) -> bytes:
    """A column of another type, of extreme numbers or dropped; metadata; or bytes."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    if draw(st.booleans()):
        return draw(fuzzing.damaged_bytes(data))
    table = pq.read_table(io.BytesIO(data))
    rows = table.num_rows
    for _ in range(draw(st.sampled_from((1, 1, 3)))):
        at, other = (draw(st.integers(0, table.num_columns - 1)) for _ in range(2))
        name = table.column_names[at]
        kind = draw(st.integers(0, 4))
        if kind == 0 and table.num_columns > 1:
            table = table.drop_columns([name])
        elif kind == 1:
            table = table.set_column(at, name, draw(st.sampled_from(odd_columns(rows))))
        elif kind == 2:
            table = table.set_column(at, name, table.column(other))
        elif kind == 3:
            order = draw(st.lists(st.integers(0, rows - 1), min_size=rows, max_size=rows))
            table = table.take(pa.array(order))
        else:
            key = draw(st.sampled_from((b"coordinate_system", b"joint_order")))
            value = draw(st.sampled_from((b"\xff", b"opengl", b"")))
            table = table.replace_schema_metadata({key: value})
    stream = io.BytesIO()
    pq.write_table(table, stream)
    return stream.getvalue()


@st.composite
def damaged_lines(draw: DrawFn, data: bytes) -> bytes:
    """Lines of JSON: values of one, or whole lines."""
    lines = data.split(b"\n")
    if draw(st.integers(0, 9)) > 6:
        return draw(fuzzing.damaged_bytes(data))
    for _ in range(draw(st.sampled_from((1, 1, 4)))):
        at = draw(st.integers(0, len(lines) - 1))
        changed = [draw(fuzzing.damaged_json(lines[at]))]
        gone = [] if len(lines) > 1 else [b""]
        lines[at : at + 1] = draw(st.sampled_from((changed, changed, 2 * lines[at : at + 1], gone)))
    return b"\n".join(lines)


@st.composite
def damaged_pickle(draw: DrawFn, data: bytes) -> bytes:
    """Values of a pickle's lists and tables are replaced, dropped or doubled; or bytes."""
    if draw(st.integers(0, 9)) > 5:
        return draw(fuzzing.damaged_bytes(data))
    value = pickle.loads(data)
    strange = (
        *(None, True, 0, 1, -1, 1e308, float("nan"), 10**6, 999_999, 10**30),
        *("", "right", b"x", [], {}, [[]], (), np.array("x"), np.zeros(0)),
        *(np.zeros((21, 3)), np.full((1, 21, 3), 1e30), np.zeros((21, 3), np.float16)),
    )
    fuzzing.damage_tree(draw, value, lambda: draw(st.sampled_from(strange)))
    return pickle.dumps(value)


def outcomes(
    layout: str, files: list[tuple[str, bytes, fuzzing.Damaged]], folder: Path, tries: int
) -> set[str]:
    """What came of mutants of the good files of a layout: ``read``, ``refused``."""
    found = set()
    folder.mkdir()
    options = ReadingOptions(rate=30.0, mano=folder.parent / "mano")

    def read(mutant: tuple[Path, bytes]) -> None:
        mutant[0].write_bytes(mutant[1])
        try:
            read_soundly(layout, mutant[0], options)
        except SmoothOperatorError as error:
            found.add("refused")
            assert 20 < len(str(error)) < 1500  # noqa: PT017
        else:
            found.add("read")

    with np.errstate(all="ignore"), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for name, content, damaged in files:
            mutants = st.tuples(st.just(folder / name), damaged(content))
            fuzzing.each(mutants, tries, read)
    return found


def seeds(folder: Path) -> dict[str, list[tuple[str, bytes, fuzzing.Damaged]]]:
    """Layout -> (name, content, how it is damaged) of its good files."""

    def made(name: str, write: Callable[[Path], Any]) -> tuple[str, bytes]:
        write(folder / name)
        return name, (folder / name).read_bytes()

    about = {"llm_description": "x", "llm_type": "reversible", "which_llm_description": "2"}
    return {
        "egodex": [(*made("0.hdf5", lambda p: files.egodex_file(p, about=about)), damaged_hdf5)],
        "avp": [(*made("t.jsonl", files.avp_file), damaged_lines)],
        "hts": [
            (*made("t.hts", files.hts_file), fuzzing.damaged_bytes),
            (*made("t.hts", lambda p: files.hts_file(p, stamped=False)), fuzzing.damaged_text),
        ],
        "landmarks": [(*made("a.npz", files.landmarks_file), fuzzing.damaged_npz)],
        "egohandkit": [(*made("a.parquet", files.egohandkit_file), damaged_parquet)],
        "parquet": [("p.parquet", _packed(folder), damaged_parquet)],
        "predictions": [
            ("a.pkl", pickle.dumps(files.wilor_frames()), damaged_pickle),
            (
                "a.json",
                json.dumps(files.plain(files.wilor_frames())).encode(),
                fuzzing.damaged_json,
            ),
            ("wilor_hands.json", files.egotouch_lines().encode(), damaged_lines),
            ("b.json", json.dumps(files.hawor_tags()).encode(), fuzzing.damaged_json),
            ("c.pkl", pickle.dumps(files.hamer_arrays()), damaged_pickle),
            ("a.npz", files.detections_npz(), fuzzing.damaged_npz),
        ],
    }


def _packed(folder: Path) -> bytes:
    """Three clips in the format of the Parquet writer."""
    from two_hands import PAIRS, save_pairs

    from smooth_hand_datasets.pipeline.clip import RobotClip
    from smooth_hand_datasets.pipeline.writers.parquet import PARQUET
    from smooth_hand_datasets.pipeline.writers.registry import WritingOptions

    with PARQUET.open(folder / "packed", WritingOptions()) as writer:
        for path in sorted(save_pairs(folder / "pairs", 3).iterdir()):
            (ref,) = PAIRS.clips(path)
            clip = PAIRS.read(ref, ReadingOptions())
            writer.write(RobotClip(clip, {}, {}, {}, {}, key=ref.name))
    (path,) = (folder / "packed" / "data").iterdir()
    return path.read_bytes()
