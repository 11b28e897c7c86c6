"""Derives the actions of another robot hand for a LeRobot data set that contains human hands.

The data set must have the columns of ``episode_files.lerobot.human``, which
``smooth-operator-lerobot-record``, ``convert`` and ``dataset`` write. The new data set has the same
episodes, frames, tasks, videos and other columns. In ``action`` and ``observation.state``, the
joints are those of the new hand, and the wrists (``tcp.…``, ``ee.…``) and arms (``arm_…``) stay.

The action of a frame is the command for its landmarks, and the state is the action of the frame
before, since nobody measured the new hand. In a data set of ``dataset`` (which has the columns
``SIDE_valid``), the state is the command, and the action is the state of the next frame, as before.
"""

from __future__ import annotations

import json
import os
import re
import shutil
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np

from smooth_hand_datasets.pipeline.clip import RobotClip
from smooth_hand_datasets.pipeline.retargeting import Recipe, retarget_clips
from smooth_hand_datasets.pipeline.writers.lerobot import place
from smooth_hand_datasets.pipeline.writers.lerobot_columns import sided
from smooth_operator.atomic_files import write_json
from smooth_operator.episode_files.lerobot.columns import ROBOT_TYPE
from smooth_operator.episode_files.lerobot.human import human_sides
from smooth_operator.episode_files.lerobot.reader import (
    Dataset,
    data_file,
    open_dataset,
    read_dataset_clip,
)
from smooth_operator.episode_files.lerobot.schema import dataset_features, joint_keys
from smooth_operator.episode_files.lerobot.tables import (
    OWN_COLUMN,
    Statistics,
    arrow,
    column,
    columns_statistics,
    dataset_readme,
    joint_statistics,
    numbers,
    parquet,
    read_table,
    write_description,
)
from smooth_operator.episode_files.lerobot.writer import MARK, PROGRAM, TITLE
from smooth_operator.episode_files.staging import staged_folder
from smooth_operator.errors import OutputError, RecordingError, SmoothOperatorError, listed
from smooth_operator.formats.foreign import foreign_dataset, is_dataset
from smooth_operator.io.documents import parse_json, read_json
from smooth_operator.planning import RetargetRequest
from smooth_operator.reporter import Reporter
from smooth_operator.result_cache import content_digest
from smooth_operator.types import Side, Status

_BATCH: Final = 64
"""Number of episodes that are retargeted together."""
_OTHERS: Final = re.compile(r"((right|left)_)?(tcp\.|ee\.|arm_)")
"""Beginning of a component of ``action`` or ``observation.state`` that is not a joint of a hand."""
_OF_THE_HAND: Final = frozenset(
    (
        *("joint_positions", "command_stamp", "status", "latency_ms", "stages_ms"),
        *("measured_positions", "measured_stamp"),
    )
)
"""Columns of the former hand, which the new data set lacks."""
_OF_THE_RUN: Final = frozenset(("key", "hands", "joints", "figures", "stages"))
"""Entries of an episode's document that describe the former hand."""
_ADVICE: Final = (
    "the human hands are stored by smooth-operator-lerobot-record, smooth-operator convert and "
    "smooth-operator dataset"
)


def find_dataset(name: str) -> Path:
    """Returns the folder of a data set: ``name`` itself, or else the folder in which LeRobot stores
    the data set of that name (``HF_LEROBOT_HOME``, by default ``~/.cache/huggingface/lerobot``).
    Raises RecordingError if neither exists."""
    home = Path(os.environ.get("HF_HOME", Path.home() / ".cache" / "huggingface")) / "lerobot"
    home = Path(os.environ.get("HF_LEROBOT_HOME", home))
    for folder in (Path(name), home / name):
        if is_dataset(folder):
            return folder
    raise RecordingError(
        f"{name}: there is no LeRobot data set of this name (a folder with meta/info.json), "
        f"neither here nor in {home}; download it first: hf download {name} --repo-type dataset "
        "--local-dir FOLDER"
    )


def retarget_dataset(
    source: Path,
    output: Path,
    request: RetargetRequest,
    *,
    videos: Literal["link", "copy"] = "link",
    reporter: Reporter | None = None,
) -> dict[str, Any]:
    """Writes a LeRobot data set with the actions of another robot hand; see the module's docstring.

    ``output`` appears when it is complete; a run that was stopped leaves nothing.

    Args:
        source: folder of a LeRobot data set (v3.0) with human hands.
        output: folder to write; it must not exist.
        request: the robot hand and the method; with ``side``, only that hand is retargeted.
        videos: link the videos of ``source`` with hard links, or copy them.
        reporter: shows the progress.

    Returns:
        the provenance, as in ``meta/smooth_operator.json``.

    Raises:
        SmoothOperatorError: the data set has no human hand, or not that of the requested side; an
            episode can't be retargeted; or the folder can't be written.
    """
    if output.exists():
        raise OutputError(
            f"can't write {str(output)!r}: it already exists; choose another name, or remove it"
        )
    reporter = Reporter() if reporter is None else reporter
    dataset, sides = _checked(source, request)
    layout = _Layout.of(dataset, sides, request)
    recipe = Recipe(request, one_by_one=not layout.follows)
    files: dict[Path, list[int]] = {}
    for number in dataset.numbers:
        files.setdefault(data_file(dataset, number), []).append(number)
    statistics: dict[int, dict[str, Statistics]] = {}
    configuration: Mapping[str, Any] = {}
    frames = sum(int(row["length"]) for row in dataset.episodes)
    with (
        staged_folder(output) as stage,
        reporter.counting("retargeting", frames, "frames") as advance,
    ):
        for file, episodes in files.items():
            target = stage / file.relative_to(dataset.path.resolve())
            target.parent.mkdir(parents=True, exist_ok=True)
            with ExitStack() as opened:
                writer: Any = None
                for number, clip, rows in _retargeted(dataset, file, episodes, recipe):
                    columns = layout.columns(clip, rows, file)
                    statistics[number] = columns_statistics(columns)
                    kept = [n for n in rows.column_names if n in layout.features]
                    arrays = {name: rows.column(name) for name in kept}
                    arrays |= {name: column(values) for name, values in columns.items()}
                    table = arrow().table(arrays)
                    if writer is None:
                        writer = opened.enter_context(parquet().ParquetWriter(target, table.schema))
                    writer.write_table(table, row_group_size=table.num_rows)
                    configuration = configuration or clip.config
                    advance(len(clip.clip), label=clip.clip.name)
        provenance = _provenance(dataset, configuration)
        _write_meta(dataset, stage, layout, statistics, provenance)
        for video in (source / "videos").rglob("*"):
            if video.is_file():
                place(video, stage / video.relative_to(source), videos)
    return provenance


def _retargeted(
    dataset: Dataset, file: Path, episodes: Sequence[int], recipe: Recipe
) -> Iterator[tuple[int, RobotClip, Any]]:
    """Yields each episode of a data file with its commands and its rows."""
    table = read_table(file)
    size = 1 if recipe.one_by_one else _BATCH
    for begin in range(0, len(episodes), size):
        block = episodes[begin : begin + size]
        read = [read_dataset_clip(dataset, number, table) for number in block]
        results = retarget_clips([clip for clip, _ in read], recipe)
        for number, (_, rows), result in zip(block, read, results, strict=True):
            if isinstance(result, SmoothOperatorError):
                raise RecordingError(
                    f"{dataset.path}, episode {number}: {result}; to leave this episode out, "
                    "delete it with lerobot-edit-dataset and run again"
                ) from result
            yield number, result, rows


def _checked(source: Path, request: RetargetRequest) -> tuple[Dataset, tuple[Side, ...]]:
    """Opens a data set; returns it with the sides to retarget."""
    foreign = foreign_dataset(source)
    if foreign is not None:
        raise RecordingError(f"{source}: this is {foreign}; {_ADVICE}")
    dataset = open_dataset(source)
    there = human_sides(dataset.info["features"])
    sides = tuple(side for side in there if request.side in (None, side))
    if not there:
        raise RecordingError(
            f"{source}: expected the columns right_landmarks or left_landmarks of a human hand, "
            f"found {listed(dataset.info['features'])}; {_ADVICE}"
        )
    if not sides:
        raise RecordingError(
            f"{source}: it contains only the {there[0]} human hand, but side {request.side!r} was "
            f"requested; use --side {there[0]}"
        )
    return dataset, sides


@dataclass(frozen=True)
class _Layout:
    """Columns of the new data set.

    Attributes:
        joints: side -> joints of the new hand in state and action.
        names: ``action`` and ``observation.state`` -> names of the new components.
        former: the same -> names of the former components.
        follows: True if the action is the state of the next frame.
        features: ``features`` of the new ``meta/info.json``.
        robot: type of the robot.
    """

    joints: Mapping[Side, tuple[str, ...]]
    names: Mapping[str, tuple[str, ...]]
    former: Mapping[str, tuple[str, ...]]
    follows: bool
    features: Mapping[str, Any]
    robot: str

    @classmethod
    def of(cls, dataset: Dataset, sides: Sequence[Side], request: RetargetRequest) -> _Layout:
        """Makes the columns for a data set and the new hand."""
        old: dict[str, Any] = dataset.info["features"]
        former = {
            name: tuple(map(str, old.get(name, {}).get("names") or ()))
            for name in ("action", "observation.state")
        }
        follows = any(f"{side}_valid" in old for side in sides)
        ours = dataset.info.get("robot_type") == ROBOT_TYPE
        hands = {side: request.commanded(request.load_hand(side)) for side in sides}
        joints = {s: h.actuated_names if ours else h.joint_names for s, h in hands.items()}
        prefixed = follows or len(human_sides(old)) > 1
        names = {}
        for name, components in former.items():
            kept = [each for each in components if _OTHERS.match(each)]
            new: list[str] = []
            for side in sides:
                own = [sided(each, side) for each in joints[side]] if prefixed else joints[side]
                new += joint_keys(own)
                new += [each for each in kept if each.startswith(f"{side}_")]
            names[name] = (*new, *(each for each in kept if each not in new))
        made = {**names, **{f"{side}_status": None for side in sides}}
        new_features = dataset_features(made)
        features = {
            name: new_features.get(name, feature)
            for name, feature in old.items()
            if name not in _OF_THE_HAND and not _of_all_joints(feature)
        }
        features |= {name: new_features[name] for name in made}
        robot = "+".join(dict.fromkeys(hand.name for hand in hands.values()))
        return cls(joints, names, former, follows, features, ROBOT_TYPE if ours else robot)

    def columns(self, clip: RobotClip, table: Any, file: Path) -> dict[str, np.ndarray]:
        """(T,) or (T, k) values of the columns that differ from those of the former data set."""
        count = table.num_rows
        made: dict[str, np.ndarray] = {}
        now: dict[str, np.ndarray] = {}
        for side, joints in self.joints.items():
            commands = clip.commands.get(side)
            made[f"{side}_status"] = np.full(count, -1)
            angles = np.zeros((count, len(joints)))
            if commands is not None:
                made[f"{side}_status"] = np.asarray(commands.status, np.int64)
                picked = [commands.joint_names.index(joint) for joint in joints]
                angles = np.asarray(commands.joint_positions, np.float64)[:, picked]
            if f"{side}_valid" in self.features:
                made[f"{side}_valid"] = made[f"{side}_status"] == Status.OK
            for joint, values in zip(joints, angles.T, strict=True):
                now |= dict.fromkeys(joint_keys([joint, sided(joint, side)]), values)
        for name, names in self.names.items():
            old = self.former[name]
            rows = numbers(table, name, len(old), file) if old else np.zeros((count, 0))
            former = dict(zip(old, rows.T, strict=True))
            late = (name == "action") if self.follows else (name != "action")
            values = {
                key: _moved(each, self.follows) if late else each for key, each in now.items()
            }
            values |= {key: former[key] for key in names if key not in now}
            made[name] = np.stack([values[key] for key in names], axis=1).astype(np.float32)
        return made


def _of_all_joints(feature: Mapping[str, Any]) -> bool:
    """True for an environment state that holds the joints of the former hand."""
    names = feature.get("names")
    return isinstance(names, list) and bool(names) and str(names[0]).startswith("environment.")


def _moved(values: np.ndarray, follows: bool) -> np.ndarray:
    """Values of the next frame, or of the frame before."""
    if follows:
        return np.concatenate([values[1:], values[-1:]])
    return np.concatenate([values[:1], values[:-1]])


def _provenance(dataset: Dataset, configuration: Mapping[str, Any]) -> dict[str, Any]:
    """Content of ``meta/smooth_operator.json``: the former data set and the settings."""
    info, mark = dataset.path / "meta" / "info.json", dataset.path / MARK
    source = {
        "path": dataset.path.resolve().as_posix(),
        "info_sha256": content_digest(info),
        "robot_type": dataset.info.get("robot_type"),
        "provenance": read_json(mark) if mark.is_file() else None,
    }
    more = {"command": "retarget --dataset", "source": source}
    return {"program": PROGRAM, "version": 1, **more, "configuration": configuration}


def _write_meta(
    dataset: Dataset,
    stage: Path,
    layout: _Layout,
    parts: Mapping[int, dict[str, Statistics]],
    provenance: Mapping[str, Any],
) -> None:
    old, new = dataset.path / "meta", stage / "meta"
    changed = [*next(iter(parts.values()))]
    gone = {*changed, *(dataset.info["features"].keys() - layout.features.keys())}
    for file in sorted(old.glob("episodes/*/*.parquet")):
        table = read_table(file)
        begins = tuple(f"stats/{name}/" for name in gone)
        table = table.select([n for n in table.column_names if not n.startswith(begins)])
        block = [int(number) for number in table.column("episode_index").to_pylist()]
        if OWN_COLUMN in table.column_names:
            texts = [_own(text, provenance) for text in table.column(OWN_COLUMN).to_pylist()]
            at = table.column_names.index(OWN_COLUMN)
            table = table.set_column(at, OWN_COLUMN, [texts])
        for name in changed:
            lists = [parts[number][name].to_lists() for number in block]
            for statistic in lists[0]:
                values = [each[statistic] for each in lists]
                table = table.append_column(f"stats/{name}/{statistic}", [values])
        target = new / file.relative_to(old)
        target.parent.mkdir(parents=True, exist_ok=True)
        parquet().write_table(table.replace_schema_metadata(None), target)
    shutil.copyfile(old / "tasks.parquet", new / "tasks.parquet")
    stats = read_json(old / "stats.json") if (old / "stats.json").is_file() else {}
    stats = {name: each for name, each in stats.items() if name not in gone}
    for name in changed:
        stats[name] = joint_statistics([each[name] for each in parts.values()]).to_lists()
    info = {**dataset.info, "features": layout.features, "robot_type": layout.robot}
    write_description(stage, info, stats, dataset_readme(info, TITLE))
    write_json(stage / MARK, provenance, indent=4)


def _own(text: str | None, provenance: Mapping[str, Any]) -> str | None:
    """Document of an episode, with the new configuration and without the former hand."""
    if text is None:
        return None
    own = {name: each for name, each in parse_json(text).items() if name not in _OF_THE_RUN}
    return json.dumps({**own, "configuration": provenance["configuration"]})
