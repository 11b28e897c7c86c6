"""Good files of every format that is read, how each is damaged, and what reads it; run as a script.

``python tests/hostile_files.py TRIES [SEED] [READER ...]`` has so many mutants of each reader's
files read and prints what came of them, and the most time and memory that one took.
``test_hostile_files.py`` does the same with few.
"""

import io
import json
import random
import shutil
import tempfile
from collections import Counter, defaultdict
from collections.abc import Callable
from pathlib import Path
from typing import Any

import fuzzing
import numpy as np
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


def scan(path: Path) -> None:
    """A folder that holds the file beside a good one: both are found."""
    from smooth_operator.datasets.sources import find_items

    good = Path(__file__).with_name("test_architecture.py")
    folder = path.parent / "scanned"
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    shutil.copy(path, folder / path.name)
    shutil.copy(good, folder / "other.npy")
    found = find_items([str(folder)], layout="files")
    assert len(found.items) + sum(found.passed_over.values()) == 2, found


def overwrite(path: Path) -> None:
    """What is looked at before a file is replaced."""
    from smooth_operator.datasets.writers.npz import taken
    from smooth_operator.teleop.recording.convert import check_target

    taken(path.with_suffix(".npz"), path.parent)
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
    from smooth_operator.retargeting.presets import method_config

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
        rng.normal(size=(FRAMES, 2)), ("j1", "j2"), stamps, np.ones(FRAMES),
        np.full(FRAMES, Status.OK, np.int8),
    )  # fmt: skip
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
        data=data, timestamps=0.01 * np.arange(FRAMES), keypoint_ids=np.arange(25),
        chirality="right", quaternion_order="wxyz", glove_ids=np.array([7]),
    )  # fmt: skip


def _operator(folder: Path) -> bytes:
    from smooth_operator.calibration.operator_file import OperatorProfile, write_operator

    profile = OperatorProfile("right", {"index": 0.3, "middle": 0.2, "pinky": 0.1}, "x")
    write_operator(folder / "o.json", profile)
    return (folder / "o.json").read_bytes()


def _geort() -> bytes:
    rng = np.random.default_rng(0)
    shapes = {"w1": (2, 3, 4), "b1": (2, 4), "w2": (2, 4, 4), "b2": (2, 4), "w3": (2, 4, 2),
              "b3": (2, 2), "centre": (2, 3), "scale": (2,), "poses": (8, 3),
              "tips": (8, 2, 3)}  # fmt: skip
    about = {
        "format": "smooth-operator geort", "version": 1, "hand": "h", "side": "right",
        "fingers": ["thumb", "index"], "joints": [["a", "b"], ["c"]],
        "limits": [[[0, 1], [0, 1]], [[0, 1]]], "training": {"steps": 3},
    }  # fmt: skip
    arrays = {name: rng.normal(size=shape) for name, shape in shapes.items()}
    return _npz(about=np.array(json.dumps(about)), **arrays)


def _trial(folder: Path) -> bytes:
    from smooth_operator.simulation.scenes.scene import SceneState
    from smooth_operator.simulation.tasks.trial import Outcome, TrialRecord, write_trial

    record = TrialRecord("card", "h", "right", ("a", "b"), events=[(0.0, "go")])
    for i in range(5):
        vector = np.full(3, 0.1 * i)
        state = SceneState(
            0.01 * i,
            vector,
            np.array([1.0, 0, 0, 0]),
            vector,
            vector,
            np.zeros(2),
            np.zeros((2, 3)),
        )
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


def mutate_log(rng: random.Random, data: bytes) -> bytes:
    """Messages of a log are mutated, as JSON where they are that, and framed as before."""
    from mcap.reader import make_reader
    from mcap.writer import CompressionType, Writer

    if rng.random() < 0.4:
        return fuzzing.mutate_bytes(rng, data)
    try:
        found = list(make_reader(io.BytesIO(data)).iter_messages(log_time_order=False))
        notes = list(make_reader(io.BytesIO(data)).iter_metadata())
    except Exception:  # it was a mutant already
        return fuzzing.mutate_bytes(rng, data)
    stream = io.BytesIO()
    kind = rng.choice((CompressionType.NONE, CompressionType.ZSTD, CompressionType.LZ4))
    writer = Writer(stream, compression=kind)
    writer.start()
    hit = set(rng.sample(range(len(found)), rng.choice((0, 1, 1, 3))))
    numbers: dict[int, int] = {}
    for i, (schema, channel, message) in enumerate(found):
        if channel.id not in numbers:
            about = writer.register_schema(schema.name, schema.encoding, schema.data)
            topic = channel.topic if rng.random() > 0.01 else rng.choice(("/hand", "/x", ""))
            numbers[channel.id] = writer.register_channel(
                topic, channel.message_encoding, about, channel.metadata
            )
        mutate = fuzzing.mutate_json if channel.message_encoding == "json" else fuzzing.mutate_bytes
        content = mutate(rng, message.data) if i in hit else message.data
        for _ in range(rng.choice((0, 2)) if i in hit and rng.random() < 0.2 else 1):
            writer.add_message(
                numbers[channel.id], message.log_time, content, message.publish_time,
                message.sequence if rng.random() > 0.01 else rng.choice((0, 2**32 - 1)),
            )  # fmt: skip
    for note in notes:
        texts = dict(note.metadata)
        for key in texts:
            if rng.random() < 0.2:
                new = fuzzing.mutate_json(rng, texts[key].encode())
                texts[key] = new.decode("utf-8", "replace")
        writer.add_metadata(note.name, texts)
    writer.finish()
    return stream.getvalue()


def mutate_hdf5(rng: random.Random, data: bytes) -> bytes:
    """Arrays and attributes are replaced, removed or linked elsewhere; or bytes are damaged."""
    import h5py

    if rng.random() < 0.6:
        return fuzzing.mutate_bytes(rng, data)
    stream = io.BytesIO(data)
    with h5py.File(stream, "r+") as file:
        names: list[str] = []
        file.visit(names.append)
        name = rng.choice(names)
        kind = rng.randrange(7)
        if kind == 0:
            del file[name]
        elif kind == 1:
            del file[name]
            file[name] = rng.choice((
                h5py.ExternalLink("other.h5", "/x"), h5py.SoftLink("/hand"), np.zeros(3), "text",
                np.zeros((2, 21, 3), complex), np.array(b"x"), h5py.Empty("f8"), [b"a", b"b"],
                np.zeros(3, [("a", "f8")]), 7,
            ))  # fmt: skip
        elif kind == 2:
            del file[name]
            shape = rng.choice(((10**9,), (10**6, 21, 3), (10**12, 2), (0, 21, 3), (5, 21, 3)))
            file.create_dataset(name, shape, "f8", chunks=True)
        else:
            item = rng.choice((file, file[name]))
            keys = ["format", "version", "name", "task", "side", "meta", "status_names", "stage"]
            item.attrs[rng.choice(keys)] = rng.choice((
                "{", "[" * 5000, "é" * 9000, 1, 1e300, b"\xff", [1, 2], ["a", "b"], np.nan,
                "smooth-operator", '{"a": ' * 90 + "1" + "}" * 90, h5py.Empty("S4"),
            ))  # fmt: skip
    return stream.getvalue()


def mutate_dataset(rng: random.Random, folder: Path) -> None:
    """A file of a LeRobot dataset is damaged, or a column is of another type."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    files = sorted(path for path in folder.rglob("*") if path.is_file())
    path = rng.choice([f for f in files if f.suffix in (".json", ".parquet")])
    if path.suffix == ".json":
        path = folder / "meta" / "info.json"
        if rng.random() < 0.2:
            info = json.loads(path.read_bytes())
            info["data_path"] = rng.choice((
                "{chunk_index.foo}", "{chunk_index:2000000000}", "a\0b", "../{file_index}", "{",
                "{chunk_index.__class__}", "{0}", "x" * 5000, "{chunk_index!r:>{file_index}}",
            ))  # fmt: skip
            path.write_text(json.dumps(info))
            return
        path.write_bytes(fuzzing.mutate_json(rng, path.read_bytes()))
    elif rng.random() < 0.5:
        path.write_bytes(fuzzing.mutate_bytes(rng, path.read_bytes()))
    else:
        table = pq.read_table(path, partitioning=None)
        at = rng.randrange(table.num_columns)
        rows = table.num_rows
        new = rng.choice((
            pa.nulls(rows), pa.array([[1]] * rows), pa.array(["[" * 3000] * rows),
            pa.array([-1] * rows), pa.array([2**62] * rows), pa.array([float("nan")] * rows),
            pa.array([{"a": 1}] * rows),
        ))  # fmt: skip
        name = table.column_names[at]
        pq.write_table(table.set_column(at, name, new), path)


Mutate = Callable[[random.Random, bytes], bytes]
Seeds = dict[str, list[tuple[str, bytes, Mutate]]]
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
    arrays = [("a.npz", marks, fuzzing.mutate_npz), ("m.npz", _manus(), fuzzing.mutate_npz),
              ("a.npy", stream.getvalue(), fuzzing.mutate_npy),
              ("b.npy", stream.getvalue(), fuzzing.mutate_bytes)]  # fmt: skip
    own = [("e.npz", npz, fuzzing.mutate_npz), ("e.mcap", log, mutate_log),
           ("e.h5", h5, mutate_hdf5)]  # fmt: skip
    return {
        "recording": [*arrays, *own],
        "episode": own,
        "commands": own[:1],
        "scan": [*arrays, *own],
        "overwrite": own,
        "latency": own[1::2],
        "operator": [("o.json", _operator(folder), fuzzing.mutate_json)],
        "preset": [("p.toml", _PRESET, fuzzing.mutate_table)],
        "geort": [("model.npz", _geort(), fuzzing.mutate_npz)],
        "trial": [("t.npz", _trial(folder), fuzzing.mutate_npz)],
    }  # fmt: skip


class Campaign:
    """Has mutants read in a process with limits, and counts what comes of them.

    Attributes:
        tally: reader -> how often each outcome came.
        faults: a line for each fault.
    """

    def __init__(self, process: fuzzing.ReaderProcess, seed: int) -> None:
        self.tally: defaultdict[str, Counter[str]] = defaultdict(Counter)
        self.faults: list[str] = []
        self._process, self._seed = process, seed

    def read(self, reader: str, function: str, path: Path, number: int) -> None:
        """Has a file read by ``module:function``; a negative number stands for a good file."""
        verdict = self._process.read(function, path)
        if number < 0:  # an import may be slow
            assert verdict.outcome in ("read", "slow"), (reader, path, verdict)
            return
        self.tally[reader][verdict.outcome] += 1
        if not verdict.sound:
            self.faults.append(f"{reader} {path.name} seed {self._seed} try {number}: {verdict}")

    def damage(self, module: str, seeds: Seeds, folder: Path, tries: int) -> None:
        """Has the good files read, and ``tries`` mutants, by the functions of a module."""
        for reader, files in seeds.items():
            for i in range(-len(files), tries):
                file, content, mutate = files[i % len(files)]
                path = folder / "mutant" / file
                path.parent.mkdir(exist_ok=True)
                rng = random.Random(f"{reader} {self._seed} {i}")
                path.write_bytes(mutate(rng, content) if i >= 0 else content)
                self.read(reader, f"{module}:{reader}", path, i)


def campaign(tries: int, seed: int) -> tuple[dict[str, Counter[str]], list[str]]:
    """Has mutants read.

    Args:
        tries: mutants for each reader.
        seed: the same one gives the same mutants.

    Returns:
        Reader -> how often each outcome came; and a line for each fault.
    """
    with (
        tempfile.TemporaryDirectory() as name,
        fuzzing.ReaderProcess([str(Path(__file__).parent)]) as process,
    ):
        folder = Path(name)
        run = Campaign(process, seed)
        run.damage("hostile_files", seeds(folder), folder, tries)
        from smooth_operator.episode_files.lerobot import write_dataset

        write_dataset(folder / "set", [good_episode])
        path = folder / "mutant-set"
        for i in range(-1, tries):
            shutil.rmtree(path, ignore_errors=True)
            shutil.copytree(folder / "set", path)
            if i >= 0:
                mutate_dataset(random.Random(f"lerobot {seed} {i}"), path)
            run.read("lerobot", "hostile_files:episode", path, i)
    return run.tally, run.faults
