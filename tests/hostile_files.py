"""Good files of every format that is read, how each is damaged, and what reads it."""

import io
import json
import shutil
from collections import Counter
from pathlib import Path
from typing import Any

import fuzzing
import numpy as np
from hypothesis import strategies as st
from hypothesis.strategies import DrawFn
from made_hands import hand_points

from smooth_operator.formats.episode import Episode
from smooth_operator.landmarks import FROM_MANUS_25, METACARPALS_MANUS_25
from smooth_operator.types import CommandTrajectory, HandRecording, Status

FRAMES = 12

# --- what reads: called in the process that has the limits -----------------------------------


def _believable(recording: Any) -> None:
    assert recording.landmarks.shape == (len(recording), 21, 3)
    assert np.isfinite(recording.stamps).all()
    assert np.isfinite(recording.landmarks[recording.valid]).all()


def recording(path: Path) -> None:
    from smooth_operator.formats.readers import read_recording

    _believable(read_recording(path, rate=None))


def episode(path: Path) -> None:
    from smooth_operator.io.jsonable import to_json
    from smooth_operator.teleop.recording.convert import read_episode

    found = read_episode(path)
    if found.commands is not None:
        assert np.isfinite(found.commands.stamps).all()
    to_json(found.meta)
    to_json(found.config)


def commands(path: Path) -> None:
    from smooth_operator.formats.commands import read_commands

    found = read_commands(path)
    assert np.isfinite(found.stamps).all()
    assert found.joint_positions.shape == (len(found), len(found.joint_names))


def overwrite(path: Path) -> None:
    """What is looked at before a file is replaced."""
    from smooth_operator.planning import foreign_result
    from smooth_operator.teleop.recording.convert import check_target

    foreign_result(path.with_suffix(".npz"))
    check_target(path, {".h5": "hdf5", ".mcap": "mcap"}.get(path.suffix, "npz"), [], True)


def latency(path: Path) -> None:
    from smooth_operator.io.jsonable import to_json
    from smooth_operator.teleop.recording import read_log
    from smooth_operator.teleop.runtime.statistics import log_timing

    to_json(log_timing(read_log(path)))


def operator(path: Path) -> None:
    from smooth_operator.calibration.operator_file import read_operator

    read_operator(path)


def preset(path: Path) -> None:
    from smooth_operator.retargeting.preset_files import method_config

    method_config("sbr", str(path))


def geort(path: Path) -> None:
    from smooth_operator.baselines.geort.method import read_geort_model

    read_geort_model(path)


def discovery(path: Path) -> None:
    from smooth_operator.hand_discovery.discover import discover
    from smooth_operator.hands.hand import load_hand_spec

    load_hand_spec(discover(path, name="mutant").spec)


def trial(path: Path) -> None:
    from smooth_operator.simulation.tasks.trial import read_trial

    read_trial(path)


# --- good files --------------------------------------------------------------------------------


def good_episode() -> Episode:
    rng = np.random.default_rng(0)
    points = hand_points(FRAMES)
    stamps = 100.0 + 0.01 * np.arange(FRAMES)
    hand = HandRecording(
        points, stamps, "right", metacarpals=rng.normal(size=(FRAMES, 4, 3)), meta={"a": [1]}
    )
    answers = CommandTrajectory(
        rng.normal(size=(FRAMES, 2)),
        ("j1", "j2"),
        stamps,
        np.ones(FRAMES),
        np.full(FRAMES, Status.OK, np.int8),
    )
    times = {"solve": np.ones(FRAMES)}
    return Episode(hand, answers, {"program": "smooth-operator", "x": [1, None]}, times, "t", "a")


def _npz(**arrays: Any) -> bytes:
    stream = io.BytesIO()
    np.savez(stream, allow_pickle=False, **arrays)
    return stream.getvalue()


def _manus() -> bytes:
    data = np.zeros((FRAMES, 25, 7), np.float32)
    data[..., 3] = 1.0
    data[:, METACARPALS_MANUS_25, :3] = 0.01
    data[:, FROM_MANUS_25, :3] = hand_points(FRAMES, seed=1)
    return _npz(
        data=data,
        timestamps=0.01 * np.arange(FRAMES),
        keypoint_ids=np.arange(25),
        chirality="right",
        quaternion_order="wxyz",
        glove_ids=np.array([7]),
    )


def _operator(folder: Path) -> bytes:
    from smooth_operator.calibration.operator_file import OperatorProfile, write_operator

    gaps, mount = {"index": 0.3, "middle": 0.2}, (0.1, -0.02, 0.03, 0.6, 0.0, 0.8, 0.0)
    profile = OperatorProfile("right", gaps, "x", {"right": mount})
    write_operator(folder / "o.json", profile)
    return (folder / "o.json").read_bytes()


def _geort() -> bytes:
    rng = np.random.default_rng(0)
    weights = {"w1": (2, 3, 4), "b1": (2, 4), "w2": (2, 4, 4), "b2": (2, 4), "w3": (2, 4, 2)}
    shapes = weights | {"b3": (2, 2), "centre": (2, 3), "scale": (2,)}
    shapes |= {"poses": (8, 3), "tips": (8, 2, 3)}
    about = {"format": "smooth-operator geort", "version": 1, "hand": "h", "side": "right"}
    about |= {"fingers": ["thumb", "index"], "joints": [["a", "b"], ["c"]]}
    about |= {"limits": [[[0, 1], [0, 1]], [[0, 1]]], "training": {"steps": 3}}
    arrays = {name: rng.normal(size=shape) for name, shape in shapes.items()}
    return _npz(about=np.array(json.dumps(about)), **arrays)


def _trial(folder: Path) -> bytes:
    from smooth_operator.simulation.scenes.scene import SceneState
    from smooth_operator.simulation.tasks.trial import Outcome, TrialRecord, write_trial

    record = TrialRecord("card", "h", "right", ("a", "b"), events=[(0.0, "go")])
    for i in range(5):
        vector, turn = np.full(3, 0.1 * i), np.array([1.0, 0, 0, 0])
        forces, tips = np.zeros(2), np.zeros((2, 3))
        state = SceneState(0.01 * i, vector, turn, vector, vector, forces, tips)
        record.add(state, np.zeros(2))
    record.outcome, record.about = Outcome(1.0, "done", 3.0, "success", "held", 0), {"x": 1}
    write_trial(folder / "t.npz", record)
    return (folder / "t.npz").read_bytes()


_PRESET = b"""format = 1
method = "sbr"
base = "realtime"

[settings]
"objective.pose_weight" = 0.031
"sampling.samples" = 64
"sampling.sigma" = 0.2

[made]
by = "a search"
on = ["a.npz", "b.npz"]
"""


@st.composite
def damaged_log(draw: DrawFn, data: bytes) -> bytes:
    """Messages of a log are damaged, as JSON where they are that, and framed as before."""
    from mcap.reader import make_reader
    from mcap.writer import CompressionType, Writer

    if draw(st.integers(0, 9)) > 5:
        return draw(fuzzing.damaged_bytes(data))
    messages = list(make_reader(io.BytesIO(data)).iter_messages(log_time_order=False))
    notes = list(make_reader(io.BytesIO(data)).iter_metadata())
    stream = io.BytesIO()
    kinds = (CompressionType.NONE, CompressionType.ZSTD, CompressionType.LZ4)
    writer = Writer(stream, compression=draw(st.sampled_from(kinds)))
    writer.start()
    hit = draw(st.sets(st.integers(0, len(messages) - 1), max_size=3))
    renamed = draw(st.sampled_from((None, None, None, "/hand", "/x", "")))
    numbers: dict[int, int] = {}
    for i, (schema, channel, message) in enumerate(messages):
        if channel.id not in numbers:
            about = writer.register_schema(schema.name, schema.encoding, schema.data)
            topic = channel.topic if renamed is None or i not in hit else renamed
            numbers[channel.id] = writer.register_channel(
                topic, channel.message_encoding, about, channel.metadata
            )
        json_text = channel.message_encoding == "json"
        damaged = fuzzing.damaged_json if json_text else fuzzing.damaged_bytes
        content = draw(damaged(message.data)) if i in hit else message.data
        sequence = draw(st.sampled_from((0, 2**32 - 1))) if i in hit else message.sequence
        for _ in range(draw(st.sampled_from((1, 1, 1, 0, 2))) if i in hit else 1):
            writer.add_message(
                numbers[channel.id], message.log_time, content, message.publish_time, sequence
            )
    for note in notes:
        texts = dict(note.metadata)
        for key in draw(st.sets(st.sampled_from(sorted(texts)), max_size=1)) if texts else ():
            texts[key] = draw(fuzzing.damaged_json(texts[key].encode())).decode("utf-8", "replace")
        writer.add_metadata(note.name, texts)
    writer.finish()
    return stream.getvalue()


@st.composite
def damaged_hdf5(draw: DrawFn, data: bytes) -> bytes:
    """Arrays and attributes are replaced, removed or linked elsewhere; or bytes are damaged."""
    import h5py

    if draw(st.integers(0, 9)) > 4:
        return draw(fuzzing.damaged_bytes(data))
    values = (
        *(h5py.ExternalLink("other.h5", "/x"), h5py.SoftLink("/hand"), h5py.Empty("f8"), 7),
        *("text", np.zeros(3), np.zeros((2, 21, 3), complex), np.array(b"x"), [b"a", b"b"]),
        np.zeros(3, [("a", "f8")]),
    )
    shapes = ((10**9,), (10**6, 21, 3), (10**12, 2), (0, 21, 3), (5, 21, 3))
    keys = ("format", "version", "name", "task", "side", "meta", "status_names", "stage")
    texts = ("{", "[" * 5000, "é" * 9000, "smooth-operator", '{"a": ' * 90 + "1" + "}" * 90)
    others = (1, 1e300, b"\xff", [1, 2], ["a", "b"], np.nan, h5py.Empty("S4"))
    stream = io.BytesIO(data)
    with h5py.File(stream, "r+") as file, np.errstate(all="ignore"):
        names: list[str] = []
        file.visit(names.append)
        name, other = (draw(st.sampled_from(names)) for _ in range(2))
        kind = draw(st.integers(0, 7))
        if kind < 3:
            del file[name]
        if kind == 1:
            file[name] = draw(st.sampled_from(values))
        elif kind == 2:
            file.create_dataset(name, draw(st.sampled_from(shapes)), "f8", chunks=True)
        elif kind in (3, 4):
            attributes = draw(st.sampled_from((file, file[name]))).attrs
            value = draw(st.sampled_from(texts) | st.sampled_from(others))
            attributes[draw(st.sampled_from(keys))] = value
        elif kind > 4 and not any(
            one.startswith(f"{two}/") for one, two in ((name, other), (other, name))
        ):
            _damaged_numbers(draw, file, name, other)
    return stream.getvalue()


def _damaged_numbers(draw: DrawFn, file: Any, name: str, other: str) -> None:
    """An array of numbers gets an extreme one, a factor, or changes its place with another."""
    if name != other and draw(st.booleans()):
        file.move(name, "elsewhere")
        file.move(other, name)
        file.move("elsewhere", other)
    elif getattr(file[name], "dtype", np.dtype(int)).kind == "f" and file[name].size:
        array = file[name][()]
        if draw(st.booleans()):
            value = draw(st.sampled_from((0.0, -1.0, np.nan, np.inf, 1e308, 1e30, 1000.0)))
            array[draw(st.integers(0, len(array) - 1))] = value
        file[name][...] = array * draw(st.sampled_from((1.0, -1.0, 0.0, 1000.0)))


_DATA_PATHS = (
    *("{chunk_index.foo}", "{chunk_index:2000000000}", "a\0b", "../{file_index}", "{", "{0}"),
    *("{chunk_index.__class__}", "x" * 5000, "{chunk_index!r:>{file_index}}"),
)


def odd_columns(rows: int) -> list[Any]:
    """Columns of Parquet that hold something else than a reader expects."""
    import pyarrow as pa

    values = ([1], "[" * 3000, -1, 2**62, 1e308, float("nan"), {"a": 1})
    nested = ([[1e308] * 3] * 21, [[0.0] * 3] * 20)
    return [pa.nulls(rows), *(pa.array([value] * rows) for value in (*values, *nested))]


@st.composite
def damaged_dataset(draw: DrawFn, good: Path, folder: Path) -> Path:
    """A copy of a LeRobot data set in which a file is damaged, or a column is of another type."""
    import pyarrow.parquet as pq

    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(good, folder)
    info = folder / "meta" / "info.json"
    kind = draw(st.integers(0, 3))
    path = draw(st.sampled_from(sorted(folder.rglob("*.parquet"))))
    if kind == 0:
        content = json.loads(info.read_bytes())
        content["data_path"] = draw(st.sampled_from(_DATA_PATHS))
        info.write_text(json.dumps(content))
    elif kind == 1:
        info.write_bytes(draw(fuzzing.damaged_json(info.read_bytes())))
    elif kind == 2:
        path.write_bytes(draw(fuzzing.damaged_bytes(path.read_bytes())))
    else:
        table = pq.read_table(path, partitioning=None)
        at = draw(st.integers(0, table.num_columns - 1))
        new = draw(st.sampled_from(odd_columns(table.num_rows)))
        pq.write_table(table.set_column(at, table.column_names[at], new), path)
    return folder


Seeds = dict[str, list[tuple[str, bytes, fuzzing.Damaged]]]
"""Reader -> (name, content, how it is damaged) of its good files."""


def seeds(folder: Path) -> Seeds:
    """Good files of the package's own readers."""
    from smooth_operator.teleop.recording.convert import write_episode

    one = good_episode()
    for name in ("e.npz", "e.mcap", "e.h5"):
        write_episode(folder / name, one)
    npz, log, h5 = ((folder / name).read_bytes() for name in ("e.npz", "e.mcap", "e.h5"))
    marks = _npz(landmarks=one.recording.landmarks, timestamps=one.recording.stamps, side="right")
    stream = io.BytesIO()
    np.save(stream, one.recording.landmarks[:1])
    arrays = [
        ("a.npz", marks, fuzzing.damaged_npz),
        ("m.npz", _manus(), fuzzing.damaged_npz),
        ("a.npy", stream.getvalue(), fuzzing.damaged_npy),
        ("b.npy", stream.getvalue(), fuzzing.damaged_bytes),
    ]
    own = [
        ("e.npz", npz, fuzzing.damaged_npz),
        ("e.mcap", log, damaged_log),
        ("e.h5", h5, damaged_hdf5),
    ]
    return {
        "recording": [*arrays, *own],
        "episode": own,
        "commands": own[:1],
        "overwrite": own,
        "latency": own[1::2],
        "operator": [("o.json", _operator(folder), fuzzing.damaged_json)],
        "preset": [("p.toml", _PRESET, fuzzing.damaged_table)],
        "geort": [("model.npz", _geort(), fuzzing.damaged_npz)],
        "trial": [("t.npz", _trial(folder), fuzzing.damaged_npz)],
    }


def read_mutants(
    process: fuzzing.ReaderProcess, module: str, seeds: Seeds, folder: Path, tries: int
) -> dict[str, Counter[str]]:
    """Has the good files read, and ``tries`` mutants of them, by the functions of a module.

    Returns:
        Reader -> how often each outcome came.

    Raises:
        AssertionError: a mutant is neither read soundly nor refused; it is shrunk first.
    """
    tally: dict[str, Counter[str]] = {}
    for reader, files in seeds.items():
        for name, content, _ in files:
            (folder / name).write_bytes(content)
            assert _read(process, f"{module}:{reader}", folder / name).outcome != "refused", name
        mutants = st.one_of(
            *(
                st.tuples(st.just(folder / name), damaged(content))
                for name, content, damaged in files
            )
        )
        counts = tally[reader] = Counter[str]()

        def read(
            mutant: tuple[Path, bytes],
            target: str = f"{module}:{reader}",
            counts: Counter[str] = counts,
        ) -> None:
            mutant[0].write_bytes(mutant[1])
            counts[_read(process, target, mutant[0]).outcome] += 1

        fuzzing.each(mutants, tries, read)
    return tally


def _read(process: fuzzing.ReaderProcess, target: str, path: Path) -> fuzzing.Verdict:
    verdict = process.read(target, path)
    assert verdict.sound, (target, verdict)
    return verdict


def campaign(folder: Path, tries: int) -> dict[str, Counter[str]]:
    """Has mutants of all formats read; see ``read_mutants``."""
    from smooth_operator.episode_files.lerobot import write_dataset

    with fuzzing.ReaderProcess([str(Path(__file__).parent)]) as process:
        tally = read_mutants(process, "hostile_files", seeds(folder), folder, tries)
        write_dataset(folder / "set", [good_episode])
        _read(process, "hostile_files:episode", folder / "set")
        counts = tally["lerobot"] = Counter[str]()

        def read(path: Path) -> None:
            counts[_read(process, "hostile_files:episode", path).outcome] += 1

        fuzzing.each(damaged_dataset(folder / "set", folder / "mutant-set"), tries, read)
    return tally
