"""Reading episodes of a dataset back, whole."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from smooth_operator.errors import ConfigError, RecordingError
from smooth_operator.recording.checks import check_rate, check_side, check_stamps
from smooth_operator.recording.episode import Episode
from smooth_operator.recording.lerobot.arrow import numbers, read_table
from smooth_operator.recording.lerobot.columns import NO_COMMAND
from smooth_operator.recording.lerobot.writer import OWN_COLUMN
from smooth_operator.recording.sniff import is_dataset
from smooth_operator.types import CommandTrajectory, HandRecording, Side, Status

_OWN_STATUS = {int(status) for status in Status}


@dataclass(frozen=True, eq=False)
class Dataset:
    """A dataset whose metadata was read.

    Attributes:
        path: its folder.
        info: ``meta/info.json``.
        episodes: a row of ``meta/episodes`` each, without the statistics, in order.
    """

    path: Path
    info: dict[str, Any]
    episodes: tuple[dict[str, Any], ...]

    def __len__(self) -> int:
        return len(self.episodes)

    @property
    def numbers(self) -> list[int]:
        """``episode_index`` of each episode, in order."""
        return [int(row["episode_index"]) for row in self.episodes]

    def row(self, number: int) -> dict[str, Any]:
        """The row of one episode.

        Raises:
            ConfigError: there is no episode of that number.
        """
        for row in self.episodes:
            if row["episode_index"] == number:
                return row
        raise ConfigError(
            f"{self.path}: it has no episode {number}; it has {len(self)}, {self.numbers[0]} to "
            f"{self.numbers[-1]}"
        )

    def name_of(self, number: int) -> str:
        """Name of one episode.

        Raises:
            ConfigError: there is no episode of that number.
        """
        own = _own(self.row(number), self.path)
        return str(own.get("name") or f"episode_{number:06d}")


def open_dataset(path: Path) -> Dataset:
    """Reads the metadata of a dataset.

    Raises:
        MissingExtraError: pyarrow is not installed.
        RecordingError: it is no dataset, damaged, of another version, or holds neither hands nor
            commands that this program wrote.
    """
    if not is_dataset(path):
        raise RecordingError(f"{path}: not a LeRobot dataset: it has no meta/info.json")
    where = path / "meta" / "info.json"
    try:
        info = json.loads(where.read_text(encoding="utf-8"))
        version, features = str(info["codebase_version"]), info["features"]
        template, fps = str(info["data_path"]), info["fps"]
        shapes = {name: tuple(feature["shape"]) for name, feature in features.items()}
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise RecordingError(
            f"{where}: can't be read as the description of a LeRobot dataset "
            f"({type(error).__name__}: {error}); copy the dataset again"
        ) from error
    if not version.startswith("v3."):
        raise RecordingError(
            f"{path}: a LeRobot dataset of version {version}, v3.0 is read here; bring it up to "
            "date with LeRobot's own converter: python -m "
            "lerobot.datasets.v30.convert_dataset_v21_to_v30"
        )
    if not {"landmarks", "joint_positions"} & shapes.keys() or "stamp" not in shapes:
        raise RecordingError(
            f"{path}: a LeRobot dataset of another program, with {', '.join(shapes) or 'nothing'}: "
            "it has no columns 'stamp' and 'landmarks' or 'joint_positions', so it holds no hand "
            "that could be converted"
        )
    if not isinstance(fps, int | float):
        raise RecordingError(f"{where}: fps must be a number, not {fps!r}")
    info["data_path"] = template
    rows: list[dict[str, Any]] = []
    for file in sorted((path / "meta" / "episodes").glob("*/*.parquet")):
        table = read_table(file)
        kept = [name for name in table.column_names if not name.startswith("stats/")]
        rows += table.select(kept).to_pylist()
    if not rows or any("episode_index" not in row for row in rows):
        raise RecordingError(
            f"{path}: meta/episodes holds no episodes; the dataset is incomplete, copy it again"
        )
    return Dataset(path, info, tuple(sorted(rows, key=lambda row: int(row["episode_index"]))))


def read_dataset_episode(
    dataset: Dataset, number: int, *, rate: float | None = None, side: Side | None = None
) -> Episode:
    """Reads one episode.

    Raises:
        ConfigError: there is no episode of that number.
        RecordingError: its file is missing or damaged, or lacks columns; a side or rate that
            contradicts it.
    """
    row = dataset.row(number)
    file = _data_file(dataset, row)
    table = read_table(file, [("episode_index", "=", number)])
    if table.num_rows != row.get("length", table.num_rows) or not table.num_rows:
        raise RecordingError(
            f"{file}: it holds {table.num_rows} frames of episode {number}, and the metadata say "
            f"{row.get('length')}; the dataset is incomplete, copy it again"
        )
    table = table.sort_by("frame_index") if "frame_index" in table.column_names else table
    own = _own(row, dataset.path)
    name = dataset.name_of(number)
    stamps = numbers(table, "stamp", 1, file)[:, 0].astype(np.float64)
    recording: HandRecording | None = None
    notes: tuple[str, ...] = ()
    if "landmarks" in dataset.info["features"]:
        recording = _recording(table, own, stamps, name, side, file)
        check_rate(stamps, rate, str(file))
        if recording.meta["side_assumed"]:
            notes = (
                f"{dataset.path} does not say of episode {number} which hand it is: taken for a "
                "right one; else say --side left",
            )
    commands: CommandTrajectory | None = None
    stages: dict[str, np.ndarray] = {}
    if "joint_positions" in dataset.info["features"]:
        commands, stages = _commands(table, dataset.info["features"], own, file)
    config = own.get("configuration")
    task = own["task"] if "task" in own else (row.get("tasks") or [None])[0]
    return Episode(recording, commands, config, stages, task, name, notes)


def _data_file(dataset: Dataset, row: Mapping[str, Any]) -> Path:
    try:
        relative = dataset.info["data_path"].format(
            chunk_index=int(row["data/chunk_index"]), file_index=int(row["data/file_index"])
        )
    except (KeyError, ValueError, IndexError, TypeError) as error:
        raise RecordingError(
            f"{dataset.path}: the metadata do not say where episode {row['episode_index']} is "
            f"({error!r}); copy the dataset again"
        ) from error
    file: Path = (dataset.path / relative).resolve()
    if not file.is_relative_to(dataset.path.resolve()):
        raise RecordingError(f"{dataset.path}: its metadata point out of the dataset, to {file}")
    return file


def _own(row: Mapping[str, Any], where: Path) -> dict[str, Any]:
    """What only this program writes; empty if other tools dropped it."""
    text = row.get(OWN_COLUMN)
    if not isinstance(text, str):
        return {}
    try:
        value = json.loads(text)
    except ValueError as error:
        raise RecordingError(
            f"{where}: {OWN_COLUMN} of episode {row['episode_index']} is not JSON ({error})"
        ) from error
    return value if isinstance(value, dict) else {}


def _recording(
    table: Any, own: dict[str, Any], stamps: np.ndarray, name: str, side: Side | None, file: Path
) -> HandRecording:
    count = len(stamps)
    labels = {str(own["side"])} if own.get("side") else set()
    if not labels and "left_hand" in table.column_names:
        flags = numbers(table, "left_hand", 1, file)[:, 0].astype(bool)
        labels = {"left" if left else "right" for left in flags.tolist()}
    found, assumed = check_side(labels, side, str(file))
    check_stamps(stamps, f"{file}, {name}")
    optional: dict[str, Any] = {}
    for key, shape in (("metacarpals", (4, 3)), ("orientations", (21, 4))):
        # Where other tools dropped what says so, the column itself tells.
        if own.get(key, key in table.column_names):
            values = numbers(table, key, shape[0] * shape[1], file)
            optional[key] = values.reshape(count, *shape).astype(np.float64)
    meta = own.get("meta")
    return HandRecording(
        numbers(table, "landmarks", 63, file).reshape(count, 21, 3).astype(np.float64),
        stamps,
        found,
        valid=numbers(table, "landmarks_valid", 21, file).astype(bool),
        name=name,
        meta={
            **(meta if isinstance(meta, dict) else {}),
            "format": "lerobot",
            "side_assumed": assumed,
        },
        **optional,
    )


def _commands(
    table: Any, features: dict[str, Any], own: dict[str, Any], file: Path
) -> tuple[CommandTrajectory, dict[str, np.ndarray]]:
    names = tuple(str(name) for name in features["joint_positions"].get("names") or ())
    codes = numbers(table, "status", 1, file)[:, 0].astype(np.int64)
    unknown = sorted(set(codes.tolist()) - _OWN_STATUS - {NO_COMMAND})
    if unknown:
        raise RecordingError(
            f"{file}: status {unknown} is not one of {sorted(_OWN_STATUS)}; if a newer version "
            "wrote it, upgrade: python -m pip install --upgrade smooth-operator"
        )
    there = codes != NO_COMMAND
    stages: dict[str, np.ndarray] = {}
    if "stages_ms" in features:
        labels = [str(label) for label in features["stages_ms"].get("names") or ()]
        times = numbers(table, "stages_ms", len(labels), file)[there]
        wanted = own.get("stages", labels)
        stages = {n: times[:, i].copy() for i, n in enumerate(labels) if n in wanted}
    commands = CommandTrajectory(
        joint_positions=numbers(table, "joint_positions", len(names), file)[there],
        joint_names=names,
        stamps=numbers(table, "command_stamp", 1, file)[there, 0],
        latency_ms=numbers(table, "latency_ms", 1, file)[there, 0],
        status=codes[there].astype(np.int8),
    )
    return commands, stages
