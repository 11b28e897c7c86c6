"""Reads episodes of a LeRobot dataset."""

from __future__ import annotations

import functools
import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from smooth_operator.episode_files.lerobot.columns import NO_COMMAND
from smooth_operator.episode_files.lerobot.human import OPTIONAL_PARTS, human_sides, read_human
from smooth_operator.episode_files.lerobot.tables import OWN_COLUMN, arrow, numbers, read_table
from smooth_operator.errors import ConfigError, DocumentError, RecordingError, brief, listed, reason
from smooth_operator.formats.checks import (
    check_anatomy,
    check_rate,
    check_recording,
    check_side,
    check_stamps,
    without_outliers,
)
from smooth_operator.formats.clip import Clip
from smooth_operator.formats.episode import (
    BASE,
    ArmTrack,
    Episode,
    StateTrajectory,
    WristTrack,
    check_commands,
)
from smooth_operator.formats.foreign import foreign_dataset
from smooth_operator.formats.registry import is_dataset
from smooth_operator.io.documents import parse_json, read_json
from smooth_operator.io.landmark_order import in_our_order, layout_order
from smooth_operator.types import CommandTrajectory, HandRecording, Side

_FIELD = re.compile(r"\{(chunk_index|file_index)(?::0?(\d{1,2})d?)?\}", re.ASCII)
_LONGEST_PATH = 500


@dataclass(frozen=True, eq=False)
class Dataset:
    """A LeRobot dataset whose metadata has been read.

    Attributes:
        path: its folder.
        info: ``meta/info.json``.
        episodes: rows of ``meta/episodes``, without the statistics, in order.
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

    @functools.cached_property
    def _rows(self) -> dict[int, dict[str, Any]]:
        return {int(row["episode_index"]): row for row in self.episodes}

    def row(self, number: int) -> dict[str, Any]:
        """Returns the row of one episode; ConfigError if there is no episode with that number."""
        row = self._rows.get(number)
        if row is not None:
            return row
        raise ConfigError(
            f"{self.path}: there is no episode {number}; the data set has {len(self)}, with the "
            f"numbers {self.numbers[0]} to {self.numbers[-1]}"
        )

    def name_of(self, number: int) -> str:
        """Returns the name of one episode; ConfigError if there is no episode with that number."""
        own = _own(self.row(number), self.path)
        return str(own.get("name") or f"episode_{number:06d}")


def open_dataset(path: Path) -> Dataset:
    """Reads the metadata of a dataset.

    Raises:
        MissingExtraError: pyarrow is not installed.
        RecordingError: the folder is not a dataset, is damaged, has another version, or contains
            neither hands nor commands that this program wrote.
    """
    if not is_dataset(path):
        raise RecordingError(f"{path}: not a LeRobot dataset: it has no meta/info.json")
    foreign = foreign_dataset(path)
    if foreign is not None:
        raise RecordingError(f"{path}: this is {foreign}")
    where = path / "meta" / "info.json"
    try:
        info = _object(read_json(where), "it")
        version, features = str(info["codebase_version"]), _object(info["features"], "features")
        template, fps = str(info["data_path"]), info["fps"]
        for name, feature in features.items():
            _names(_object(feature, f"feature {brief(name)}"))
    except (OSError, ValueError, KeyError) as error:
        what = f"it has no {error}" if isinstance(error, KeyError) else reason(error)
        raise RecordingError(
            f"{where}: can't be read as the description of a LeRobot dataset ({what}); copy the "
            "dataset again"
        ) from error
    if not version.startswith("v3."):
        raise RecordingError(
            f"{path}: a LeRobot dataset of version {version[:20]}, but only v3.0 can be "
            "read; LeRobot's own converter converts v2.1: python -m "
            "lerobot.scripts.convert_dataset_v21_to_v30"
        )
    if "stamp" not in features:
        raise RecordingError(
            f"{path}: a LeRobot dataset from another program, with {listed(features)}: it lacks "
            "the column 'stamp', the time of each frame [s]"
        )
    if isinstance(fps, bool) or not isinstance(fps, int | float):
        raise RecordingError(f"{where}: fps must be a number, not {brief(fps)}")
    info["data_path"] = template
    rows: list[dict[str, Any]] = []
    for file in sorted((path / "meta" / "episodes").glob("*/*.parquet")):
        table = read_table(file)
        columns = [name for name in table.column_names if not name.startswith("stats/")]
        rows += table.select(columns).to_pylist()
    if not rows or any(type(row.get("episode_index")) is not int for row in rows):
        raise RecordingError(
            f"{path}: meta/episodes holds no episodes, so the dataset is incomplete; copy it again"
        )
    return Dataset(path, info, tuple(sorted(rows, key=lambda row: int(row["episode_index"]))))


def read_dataset_episode(
    dataset: Dataset,
    number: int,
    *,
    rate: float | None = None,
    side: Side | None = None,
    layout: str | None = None,
) -> Episode:
    """Reads one episode.

    An episode without the column that this program writes may come from another tool, so its units,
    side and order of landmarks are checked as in ``read_recording``.

    Args:
        number: number of the episode.
        rate: frame rate [Hz]; the stamps of the episode must agree with it.
        side: side of the hand; required for an episode with both hands.
        layout: order of the landmarks in an episode of another tool, one of ``LAYOUTS``; the order
            in this program's own episodes is known.

    Raises:
        ConfigError: there is no episode of that number.
        RecordingError: the file is missing or damaged, or lacks columns; the side or rate
            contradicts the episode; or, in an episode of another tool, the units, side or order are
            not those of a hand.
        UnknownNameError: there is no such ``layout``.
    """
    row, file = dataset.row(number), data_file(dataset, number)
    table = _frames(row, read_table(file, [("episode_index", "=", number)]), file)
    own = _own(row, dataset.path)
    name = dataset.name_of(number)
    stamps = numbers(table, "stamp", 1, file)[:, 0].astype(np.float64)
    recording: HandRecording | None = None
    if human_sides(dataset.info["features"]):
        recording = _recording(table, own, stamps, name, side, layout, file)
        check_rate(stamps, rate, str(file))
        if not own:
            where = f"{dataset.path}, {name}"
            check_anatomy(recording, where, side=side)
            check_recording(recording, where)
            recording = without_outliers(recording)
    commands: CommandTrajectory | None = None
    stages: dict[str, np.ndarray] = {}
    if "joint_positions" in dataset.info["features"]:
        commands, stages = _commands(table, dataset.info["features"], own, file)
    config = own.get("configuration")
    config = config if isinstance(config, dict) else None
    tasks = row.get("tasks")
    task = own["task"] if "task" in own else tasks[0] if isinstance(tasks, list) and tasks else None
    task = None if task is None else str(task)
    wrist = None
    if commands is not None and _has(own, "wrist_command", table):
        wrist = _wrist(table, own, file)
    states = None
    if "measured_positions" in dataset.info["features"]:
        states = _states(table, dataset.info["features"], file)
    arm = None
    if commands is not None and "arm_positions" in dataset.info["features"]:
        arm = _arm(table, dataset.info["features"], own, file)
    return Episode(recording, commands, config, stages, task, name, (), states, wrist, arm)


def read_dataset_clip(dataset: Dataset, number: int, table: Any) -> tuple[Clip, Any]:
    """Reads the human hands of one episode.

    Args:
        number: number of the episode.
        table: content of its ``data_file``.

    Returns:
        a clip of the hands that were seen; and the rows of the episode in ``table``.

    Raises:
        RecordingError: as ``read_dataset_episode``; or no hand was seen in the episode.
    """
    row, file = dataset.row(number), data_file(dataset, number)
    is_its = numbers(table, "episode_index", 1, file)[:, 0] == number
    rows = _frames(row, table.filter(arrow().array(is_its)), file)
    own, name, hands = _own(row, dataset.path), dataset.name_of(number), {}
    stamps = numbers(rows, "stamp", 1, file)[:, 0].astype(np.float64)
    for side in human_sides(dataset.info["features"]):
        if numbers(rows, f"{side}_landmarks_valid", 21, file).any():
            hands[side] = _recording(rows, own, stamps, name, side, None, file)
    if not hands:
        raise RecordingError(
            f"{dataset.path}, {name}: no human hand is seen in any frame; delete the episode with "
            "lerobot-edit-dataset"
        )
    tasks = row.get("tasks")
    return Clip(name, hands, "lerobot", (file,), tasks[0] if tasks else None), rows


def _frames(row: Mapping[str, Any], table: Any, file: Path) -> Any:
    """Checks the number of frames of an episode, and puts them in order."""
    if table.num_rows != row.get("length", table.num_rows) or not table.num_rows:
        raise RecordingError(
            f"{file}: it holds {table.num_rows} frames of episode {row['episode_index']}, but the "
            f"metadata say {row.get('length')}, so the dataset is incomplete; copy it again"
        )
    if "frame_index" not in table.column_names:
        return table
    order = numbers(table, "frame_index", 1, file)[:, 0].argsort(kind="stable")
    return table.take(order)


def data_file(dataset: Dataset, number: int) -> Path:
    """Returns the file with the frames of an episode. Raises RecordingError if the metadata do not
    name the file, or name one outside the dataset."""
    row = dataset.row(number)
    try:
        relative = _filled(
            dataset.info["data_path"],
            chunk_index=int(row["data/chunk_index"]),
            file_index=int(row["data/file_index"]),
        )
        file: Path = (dataset.path / relative).resolve()
    except (KeyError, ValueError, TypeError, OSError) as error:  # OSError: a name too long
        raise RecordingError(
            f"{dataset.path}: the metadata do not say where episode {row['episode_index']} is "
            f"({str(error)[:200]}); copy the dataset again"
        ) from error
    if not file.is_relative_to(dataset.path.resolve()):
        raise RecordingError(
            f"{dataset.path}: its metadata name a file outside the dataset: {file}"
        )
    return file


def _filled(template: str, **indices: int) -> str:
    """Fills the two numbers into a path template.

    ``str.format`` would do the same, but a hostile template could misuse its attributes and widths.

    Raises:
        ValueError: the template has other fields than the two numbers, or is not a path.
    """

    def number(match: re.Match[str]) -> str:
        return f"{indices[match[1]]:0{int(match[2] or 1)}d}"

    path = _FIELD.sub(number, template)
    if "{" in path or "}" in path or "\0" in path or len(path) > _LONGEST_PATH:
        raise ValueError(f"data_path can't be {brief(template)}")
    return path


def _object(value: Any, what: str) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise ValueError(f"{what} must be an object, not {brief(value)}")
    return value


def _names(feature: Mapping[str, Any]) -> list[str]:
    """Names of the components of a feature; ValueError if the names are not a list of strings."""
    names = feature.get("names")
    if isinstance(names, dict):  # of other programs' columns
        names = None
    if not isinstance(names, list | None) or not all(isinstance(n, str) for n in names or ()):
        raise ValueError(f"names must be a list of strings, not {brief(names)}")
    return names or []


def _own(row: Mapping[str, Any], where: Path) -> dict[str, Any]:
    """Metadata that only this program writes; empty if other tools dropped it."""
    text = row.get(OWN_COLUMN)
    if not isinstance(text, str):
        return {}
    try:
        value = parse_json(text)
    except DocumentError as error:
        raise RecordingError(
            f"{where}: {OWN_COLUMN} of episode {row['episode_index']} is not JSON ({error})"
        ) from error
    return value if isinstance(value, dict) else {}


def _recording(
    table: Any,
    own: dict[str, Any],
    stamps: np.ndarray,
    name: str,
    side: Side | None,
    layout: str | None,
    file: Path,
) -> HandRecording:
    side = _side(table, own, side, f"{file}, {name}")
    check_stamps(stamps, f"{file}, {name}")
    stored = own.get("meta")
    meta = {**(stored if isinstance(stored, dict) else {}), "format": "lerobot"}
    if own:
        layout = None
    if layout is not None:
        meta["layout"] = layout
    picked = layout_order(layout)
    parts = own.get("parts")
    absent = () if not isinstance(parts, list) else {*OPTIONAL_PARTS} - {*map(str, parts)}
    hand: dict[str, Any] = read_human(table, side, file, absent)
    hand["valid"] = hand["valid"][:, picked]
    hand["landmarks"] = in_our_order(hand["landmarks"], layout)
    if "orientations" in hand:
        hand["orientations"] = hand["orientations"][:, picked]
    if "T_world_wrist" in hand:
        hand["world"] = None if own.get("world") is None else str(own["world"])[:64]
    return HandRecording(stamps=stamps, side=side, name=name, meta=meta, **hand)


def _side(table: Any, own: dict[str, Any], side: Side | None, where: str) -> Side:
    """Side of the hand to read; RecordingError if the episode lacks it, or has both and none was
    requested."""
    sides = human_sides(table.column_names)
    if own.get("side") in sides:
        sides = (own["side"],)
    elif len(sides) > 1:
        seen = {s: numbers(table, f"{s}_landmarks_valid", 21, Path(where)).any() for s in sides}
        sides = tuple(each for each in sides if seen[each]) or sides
    if side is None and len(sides) > 1:
        raise RecordingError(
            f"{where}: it contains both hands; choose one with --side right or left"
        )
    return check_side(sides if side not in sides else (side,), side, where)[0]


def _has(own: dict[str, Any], name: str, table: Any) -> bool:
    """True if a column belongs to the episode; without metadata, its content decides."""
    return bool(own.get(name, True)) and name in table.column_names


def _wrist(table: Any, own: dict[str, Any], file: Path) -> WristTrack:
    """Reads the commanded wrist from the rows that have a command."""
    there = numbers(table, "status", 1, file)[:, 0] != NO_COMMAND
    engaged, valid = (
        numbers(table, name, 1, file)[there, 0] != 0 for name in ("wrist_engaged", "wrist_valid")
    )
    poses = numbers(table, "wrist_command", 7, file)[there].astype(np.float64)
    return WristTrack(poses, engaged, valid, str(own.get("wrist_world") or BASE)[:64])


def _arm(table: Any, features: dict[str, Any], own: dict[str, Any], file: Path) -> ArmTrack:
    """Reads the arm from the rows that have a command."""
    names = tuple(_names(features["arm_positions"]))
    there = numbers(table, "status", 1, file)[:, 0] != NO_COMMAND
    sizes = {"arm_positions": len(names), "arm_measured": len(names), "arm_wrist": 7}
    rows = [numbers(table, key, n, file)[there].astype(float) for key, n in sizes.items()]
    return ArmTrack(str(own.get("arm") or "arm")[:64], names, rows[0], rows[1], rows[2])


def _states(table: Any, features: dict[str, Any], file: Path) -> StateTrajectory:
    """Reads each measurement once: a frame contains the newest measurement."""
    names = tuple(_names(features["measured_positions"]))
    stamps = numbers(table, "measured_stamp", 1, file)[:, 0].astype(np.float64)
    positions = numbers(table, "measured_positions", len(names), file).astype(np.float64)
    new = np.isfinite(stamps) & np.diff(stamps, prepend=-np.inf).astype(bool)
    try:
        return StateTrajectory(stamps[new], positions[new], names)
    except RecordingError as error:
        raise RecordingError(f"{file}: {error}") from error


def _commands(
    table: Any, features: dict[str, Any], own: dict[str, Any], file: Path
) -> tuple[CommandTrajectory, dict[str, np.ndarray]]:
    names = tuple(_names(features["joint_positions"]))
    codes = numbers(table, "status", 1, file)[:, 0].astype(np.int64)
    there = codes != NO_COMMAND
    stages: dict[str, np.ndarray] = {}
    if "stages_ms" in features:
        labels = _names(features["stages_ms"])
        times = numbers(table, "stages_ms", len(labels), file)[there]
        stage_names = own.get("stages", labels)
        stage_names = stage_names if isinstance(stage_names, list) else labels
        stages = {n: times[:, i].copy() for i, n in enumerate(labels) if n in stage_names}
    commands = CommandTrajectory(
        joint_positions=numbers(table, "joint_positions", len(names), file)[there],
        joint_names=names,
        stamps=numbers(table, "command_stamp", 1, file)[there, 0],
        latency_ms=numbers(table, "latency_ms", 1, file)[there, 0],
        status=codes[there],
    )
    check_commands(commands, str(file))
    return replace(commands, status=codes[there].astype(np.int8)), stages
