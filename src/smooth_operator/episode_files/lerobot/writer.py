"""Writes a LeRobot dataset: first surveys all episodes, then writes them one by one."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, Literal, TypeAlias

import numpy as np

from smooth_operator.atomic_files import write_json
from smooth_operator.episode_files.lerobot.columns import (
    ROBOT_FPS,
    ROBOT_TYPE,
    episode_columns,
    layout_of,
    robot_columns,
    robot_layout,
    widened,
)
from smooth_operator.episode_files.lerobot.human import human_parts
from smooth_operator.episode_files.lerobot.schema import Layout, dataset_features
from smooth_operator.episode_files.lerobot.tables import (
    DATA_PATH,
    EPISODES_PATH,
    FILE_MB,
    FILES_A_CHUNK,
    OWN_COLUMN,
    UNNAMED_TASK,
    Statistics,
    arrow,
    column,
    columns_statistics,
    dataset_info,
    dataset_readme,
    episode_row,
    episodes_table,
    joint_statistics,
    mean_rate,
    parquet,
    standard_fps,
    tasks_table,
    write_description,
)
from smooth_operator.episode_files.staging import staged_folder
from smooth_operator.errors import ConfigError, RecordingError
from smooth_operator.formats.episode import Episode
from smooth_operator.io.documents import read_json
from smooth_operator.io.jsonable import to_json

MARK: Final = "meta/smooth_operator.json"
PROGRAM: Final = "smooth-operator"
TITLE: Final = "Human hands and robot commands"
"""Title of the README."""
_KEPT_BYTES: Final = 256 << 20  # of episodes kept between the two passes, so not read again

Load: TypeAlias = Callable[[], Episode]
Columns: TypeAlias = Literal["all", "robot", "robot-wrist"]


@dataclass
class _Survey:
    """Result of the first pass."""

    layout: Layout
    tasks: list[str] = field(default_factory=list)
    lengths: list[int] = field(default_factory=list)
    rates: list[float] = field(default_factory=list)
    robots: set[str] = field(default_factory=set)
    kept: dict[int, Episode] = field(default_factory=dict)
    robot: Layout | None = None

    @property
    def robot_type(self) -> str | None:
        """Name of the robot, if the episodes name one."""
        if self.robot is not None:
            return ROBOT_TYPE
        return next(iter(self.robots)) or None if len(self.robots) == 1 else None


def write_dataset(
    path: Path,
    episodes: Sequence[Load],
    *,
    fps: int | None = None,
    columns: Columns = "all",
    environment_state: bool = False,
    done: Callable[[int], None] = lambda _: None,
) -> list[str]:
    """Writes a dataset; it appears at ``path`` only when it is complete.

    Args:
        path: the folder; an existing one is replaced.
        episodes: functions that each return an episode, the same at every call. Each is called
            twice, so that not all episodes need to be in memory.
        fps: frame rate [Hz]. None for the median of the episodes' mean rates without pauses,
            rounded by ``standard_fps``, or for 30 with the columns of a robot.
        columns: ``all``, or the columns that LeRobot records for the robot ``smooth_hand``:
            ``robot``, or ``robot-wrist`` with its wrist; see the module ``columns``.
        environment_state: True to add ``observation.environment_state`` to the columns of the
        robot.
        done: called with the number of frames of each written episode.

    Returns:
        Notes for the user: stamps that ``fps`` does not reproduce, values that are NaN.

    Raises:
        MissingExtraError: pyarrow is not installed.
        RecordingError: an episode can't be read, has no frames, has a command without a row, or
            has other columns than the episodes before it.
        ConfigError: ``fps`` is not positive, or is None although no episode has a frame rate.
        OutputError: it can't be written.
    """
    arrow()  # a missing extra costs a second, not the reading of everything
    if fps is not None and fps < 1:
        raise ConfigError(f"fps must be a whole number of frames per second, at least 1, not {fps}")
    if environment_state and columns == "all":
        raise ConfigError(
            "the environment state can only be written with the columns of a robot; set columns "
            "to robot"
        )
    survey = _look(episodes, columns, environment_state)
    if fps is None and survey.robot is not None:
        fps = ROBOT_FPS
    if fps is None:
        if not survey.rates:
            raise ConfigError(
                "no episode has two frames, so the frame rate is unknown; set it with --fps"
            )
        fps = standard_fps(float(np.median(survey.rates)))
    notes = _Notes(fps)
    rows: list[dict[str, Any]] = []
    statistics: list[dict[str, Statistics]] = []
    layout = survey.robot or survey.layout
    features = dataset_features(layout)
    columns_of = robot_columns if survey.robot else episode_columns
    with staged_folder(path) as stage:
        files = _DataFiles(stage)
        try:
            first = 0
            for number, episode in enumerate(_again(episodes, survey)):
                task = episode.task or UNNAMED_TASK
                index = survey.tasks.index(task)
                values = columns_of(
                    episode, layout, number=number, first=first, task=index, fps=fps
                )
                if survey.robot is None:
                    notes.look(episode)
                count = len(values["index"])
                place = files.append({name: column(v) for name, v in values.items()})
                statistics.append(columns_statistics(values))
                own = {} if survey.robot else {OWN_COLUMN: to_json(_own(episode))}
                rows.append(episode_row(number, first, count, task, place) | own)
                first += count
                done(count)
        finally:
            files.close()
        listed = stage / EPISODES_PATH.format(chunk_index=0, file_index=0)
        listed.parent.mkdir(parents=True, exist_ok=True)
        parquet().write_table(episodes_table(rows, statistics), listed)
        parquet().write_table(tasks_table(survey.tasks), stage / "meta" / "tasks.parquet")
        joint = {
            name: joint_statistics([part[name] for part in statistics]).to_lists()
            for name in features
        }
        info = dataset_info(
            features,
            robot=survey.robot_type,
            episodes=len(rows),
            frames=first,
            tasks=len(survey.tasks),
            fps=fps,
        )
        write_description(stage, info, joint, dataset_readme(info, TITLE))
        write_json(stage / MARK, {"program": PROGRAM, "version": 1}, indent=4)
    return notes.texts()


def is_own_dataset(path: Path) -> bool:
    """True if a folder is a dataset that this program wrote and contains nothing else."""
    try:
        mark = read_json(path / MARK)
        others = {item.name for item in path.iterdir()} - {"meta", "data", "videos", "README.md"}
    except (OSError, ValueError):
        return False
    return isinstance(mark, dict) and mark.get("program") == PROGRAM and not others


def _look(episodes: Sequence[Load], columns: Columns, environment_state: bool) -> _Survey:
    survey: _Survey | None = None
    name, budget = "", _KEPT_BYTES
    for number, load in enumerate(episodes):
        episode = load()
        layout = layout_of(episode)
        if layout.get("joint_positions") == ():
            raise RecordingError(f"{episode.name}: its commands contain no joints")
        if survey is None:
            survey, name = _Survey(layout), episode.name
        survey.layout = widened(survey.layout, layout, (name, episode.name))
        if columns != "all":
            own = robot_layout(episode, columns == "robot-wrist", environment_state)
            if survey.robot not in (None, own):
                raise RecordingError(
                    f"{name} and {episode.name} were recorded with different robot hands; write "
                    "each to a separate LeRobot dataset"
                )
            survey.robot = own
        task = episode.task or UNNAMED_TASK
        if task not in survey.tasks:
            survey.tasks.append(task)
        survey.lengths.append(len(episode))
        rate = mean_rate(episode.stamps)
        survey.rates += [] if rate is None else [rate]
        robot = (episode.config or {}).get("hand")
        survey.robots.add(robot if isinstance(robot, str) else "")
        size = len(episode) * 8 * 300  # about: of all the columns that a frame may have
        if size <= budget:
            budget -= size
            survey.kept[number] = episode
    if survey is None:
        raise RecordingError("there are no episodes to write")
    return survey


def _again(episodes: Sequence[Load], survey: _Survey) -> Iterator[Episode]:
    for number, load in enumerate(episodes):
        episode = survey.kept.pop(number, None) or load()
        if len(episode) != survey.lengths[number]:
            raise RecordingError(
                f"{episode.name}: the file changed while it was being converted; try again when no "
                "program is writing to it"
            )
        yield episode


def _own(episode: Episode) -> dict[str, Any]:
    """Makes the metadata that LeRobot has no place for."""
    layout = layout_of(episode)
    return {
        "name": episode.name,
        "side": None if episode.recording is None else episode.recording.side,
        "task": episode.task,
        "parts": [] if episode.recording is None else list(human_parts(episode.recording)),
        "world": None if episode.recording is None else episode.recording.world,
        "wrist_command": "wrist_command" in layout,
        "wrist_world": None if episode.wrist is None else episode.wrist.world,
        "arm": None if episode.arm is None else episode.arm.name,
        "stages": list(episode.stages_ms),
        "meta": episode.meta,
        "configuration": episode.config,
    }


class _DataFiles:
    """Writer of the Parquet files of frames: one row group per episode, and a new file when one is
    full.
    """

    def __init__(self, root: Path) -> None:
        self._root = root
        self._writer: Any = None
        self._number = -1
        self._bytes = 0

    def append(self, columns: dict[str, Any]) -> tuple[int, int]:
        """Adds an episode; returns the chunk and the file that contain it."""
        table = arrow().table(columns)
        if self._writer is None or self._bytes + table.nbytes > FILE_MB << 20:
            self.close()
            self._number += 1
            self._bytes = 0
            chunk, file = divmod(self._number, FILES_A_CHUNK)
            path = self._root / DATA_PATH.format(chunk_index=chunk, file_index=file)
            path.parent.mkdir(parents=True, exist_ok=True)
            self._writer = parquet().ParquetWriter(path, table.schema)
        self._writer.write_table(table, row_group_size=table.num_rows)
        self._bytes += table.nbytes
        return divmod(self._number, FILES_A_CHUNK)

    def close(self) -> None:
        writer, self._writer = self._writer, None
        if writer is not None:
            writer.close()


class _Notes:
    """Collects human-readable notes on a dataset."""

    def __init__(self, fps: int) -> None:
        self._fps = fps
        self._drift = 0.0
        self._frames = self._missing = self._unanswered = self._held = 0

    def look(self, episode: Episode) -> None:
        """Takes an episode into account."""
        stamps = episode.stamps
        nominal = np.arange(len(stamps)) / self._fps
        self._drift = max(self._drift, float(np.abs(stamps - stamps[0] - nominal).max()))
        self._frames += len(episode)
        if episode.recording is not None:
            finite = np.isfinite(episode.recording.landmarks).all(axis=(1, 2))
            self._missing += int((~finite).sum())
            if episode.commands is not None:
                answers = int((episode.answered() >= 0).sum())
                self._unanswered += len(episode) - answers
                self._held += len(episode.commands) - answers

    def texts(self) -> list[str]:
        texts = []
        if self._drift > 1e-3:
            texts.append(
                f"LeRobot needs regular timestamps (frame_index / {self._fps}): they differ "
                f"by up to {self._drift:.3g} s from the recorded times, which are in the "
                "column 'stamp'; use --fps to choose another rate"
            )
        for count, what, flag in (
            (self._missing, "missing landmarks (NaN in SIDE_landmarks)", "SIDE_landmarks_valid"),
            (self._unanswered, "no command (NaN in action)", "status"),
        ):
            if count:
                texts.append(
                    f"{count} of {self._frames} frames have {what}; exclude them from training "
                    f"with the column {flag!r}"
                )
        if self._held:
            texts.append(
                f"skipped {self._held} commands for which there is no hand frame: the live loop "
                "held the robot"
            )
        return texts
