"""The files of a LeRobot dataset: their paths, tables, statistics and README."""

from __future__ import annotations

import importlib
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from jaxtyping import Float

from smooth_operator.atomic_files import atomic_write, write_json
from smooth_operator.episode_files.lerobot.schema import column_of
from smooth_operator.errors import MissingExtraError, RecordingError, listed
from smooth_operator.formats.arrays import NUMBER_BYTES, Allowance, damaged
from smooth_operator.io.plain_files import check_plain_file

CODEBASE_VERSION: Final = "v3.0"
CHUNK_PATH: Final = "chunk-{chunk_index:03d}/file-{file_index:03d}"
DATA_PATH: Final = f"data/{CHUNK_PATH}.parquet"
EPISODES_PATH: Final = f"meta/episodes/{CHUNK_PATH}.parquet"
VIDEO_PATH: Final = f"videos/{{video_key}}/{CHUNK_PATH}.mp4"
FILES_A_CHUNK: Final = 1000  # as LeRobot
VIDEO_MB: Final = 200
FILE_MB: Final = 100  # at most in a file, as LeRobot

PAUSE: Final = 3.0
"""A time step of this many times the median step counts as a pause of the tracker."""

OWN_COLUMN: Final = "smooth_operator"
"""Column of ``meta/episodes`` with the data that LeRobot has no place for, as JSON."""

UNNAMED_TASK: Final = "unnamed"
"""Task of frames whose task is unknown, because LeRobot requires a task for every frame."""

QUANTILES: Final = {"q01": 0.01, "q10": 0.10, "q50": 0.50, "q90": 0.90, "q99": 0.99}


def arrow() -> Any:
    """Imports and returns the module ``pyarrow``; MissingExtraError if it is not installed."""
    return _module("pyarrow")


def parquet() -> Any:
    """Imports and returns the module ``pyarrow.parquet``; MissingExtraError if it is not
    installed."""
    return _module("pyarrow.parquet")


def column(values: np.ndarray) -> Any:
    """Makes an Arrow array: of scalars from a (T,) or (T, 1) array, or of lists of k numbers from a
    (T, k) array.

    LeRobot stores every feature of one number as a scalar. NaN stays NaN and does not become null.
    """
    pa = arrow()
    if values.ndim == 1 or values.shape[1] == 1:
        return pa.array(np.ascontiguousarray(values.reshape(-1)))
    flat = pa.array(np.ascontiguousarray(values).reshape(-1))
    return pa.FixedSizeListArray.from_arrays(flat, values.shape[1])


def numbers(table: Any, name: str, width: int, where: Path) -> np.ndarray:
    """Reads a (T, width) array from a column that ``column`` made or that another program rewrote.
    Raises RecordingError if the column is missing, or does not hold ``width`` numbers per row."""
    pa = arrow()
    if name not in table.column_names:
        raise RecordingError(
            f"{where}: it lacks the column {name!r}; its columns: {listed(table.column_names)}"
        )
    chunks = table.column(name).chunks
    kind = table.schema.field(name).type
    flat = pa.concat_arrays(chunks) if chunks else pa.array([], kind)
    if pa.types.is_fixed_size_list(kind) or pa.types.is_list(kind) or pa.types.is_large_list(kind):
        kind, flat = kind.value_type, flat.flatten()
    # NaN became null on its way through pandas.
    nulls = 0 if pa.types.is_floating(kind) else flat.null_count
    numeric = pa.types.is_floating(kind) or pa.types.is_integer(kind) or pa.types.is_boolean(kind)
    if not numeric or nulls or len(flat) != table.num_rows * width:
        raise RecordingError(
            f"{where}: the column {name!r} must hold {width} numbers per row, not "
            f"{str(table.schema.field(name).type)[:80]}"
            + (f" with {nulls} nulls" if nulls else "")
            + "; copy the dataset again"
        )
    values: np.ndarray = flat.to_numpy(zero_copy_only=False).reshape(table.num_rows, width)
    return values


def read_table(path: Path, filters: Any = None) -> Any:
    """Reads a Parquet file as an Arrow table; RecordingError if the file does not exist or is
    damaged."""
    pa, pq = arrow(), parquet()
    try:
        size = check_plain_file(path)
        _check_size(pq.ParquetFile(path), path, size)
        return pq.read_table(path, filters=filters, partitioning=None)
    except RecordingError:
        raise
    except FileNotFoundError:
        raise RecordingError(
            f"{path}: no such file, so the dataset is incomplete; copy it again"
        ) from None
    except (pa.ArrowException, OSError, ValueError, KeyError, TypeError, MemoryError) as error:
        raise damaged(path, f"Parquet: {error}") from error


def _check_size(file: Any, path: Path, size: int) -> None:
    """Refuses a file whose columns would take far more memory than the file's size.

    This is possible because a run of equal values is stored as one value, and because a list of
    fixed length takes its full memory even if it is null.
    """
    pa, held = arrow(), file.metadata
    allowance = Allowance.of(path, size)
    for row_group in range(held.num_row_groups):
        columns = held.row_group(row_group)
        for column in range(columns.num_columns):
            part = columns.column(column)
            count = max(part.num_values, columns.num_rows) * NUMBER_BYTES
            allowance.take(
                f"{part.path_in_schema} {row_group}", max(count, part.total_uncompressed_size)
            )
    for field in file.schema_arrow:
        if pa.types.is_fixed_size_list(field.type):
            allowance.take(field.name, held.num_rows * field.type.list_size * NUMBER_BYTES)


def _module(name: str) -> Any:
    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise MissingExtraError("a LeRobot dataset", "lerobot") from error


# --- statistics ----------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Statistics:
    """Statistics of one feature, which LeRobot uses for normalisation.

    Only finite values count, because one NaN would make every mean of the dataset NaN. A component
    without finite values gets zeros.

    Attributes:
        frames: number of frames.
        finite: (k,) number of finite values.
        values: (k,) numbers of ``min``, ``max``, ``mean``, ``std`` and the quantiles.
    """

    frames: int
    finite: Float[np.ndarray, " k"]
    values: dict[str, Float[np.ndarray, " k"]]

    def to_lists(self) -> dict[str, list[float] | list[int]]:
        """Returns the statistics in the form that LeRobot writes."""
        lists: dict[str, list[float] | list[int]] = {k: v.tolist() for k, v in self.values.items()}
        return {**lists, "count": [self.frames]}

    def to_json(self) -> dict[str, Any]:
        """Returns the statistics as JSON values, exact to the last bit."""
        values = {name: each.tolist() for name, each in self.values.items()}
        return {"frames": self.frames, "finite": self.finite.tolist(), "values": values}

    @classmethod
    def from_json(cls, value: Mapping[str, Any]) -> Statistics:
        """Restores the statistics that ``to_json`` returned."""
        values = {name: np.asarray(each, np.float64) for name, each in value["values"].items()}
        return cls(value["frames"], np.asarray(value["finite"], np.float64), values)


def column_statistics(values: np.ndarray) -> Statistics:
    """Computes statistics of (T,) or (T, k) values; booleans count as 0 and 1."""
    array = values.reshape(len(values), -1).astype(np.float64)
    finite = np.isfinite(array)
    counts = finite.sum(axis=0).astype(np.float64)
    if finite.all():
        quantiles = np.quantile(array, list(QUANTILES.values()), axis=0)
    else:
        # Column by column: NumPy's NaN-aware quantiles are far slower than that.
        quantiles = np.zeros((len(QUANTILES), array.shape[1]))
        for i in np.flatnonzero(counts):
            quantiles[:, i] = np.quantile(array[finite[:, i], i], list(QUANTILES.values()))
    safe = np.maximum(counts, 1.0)
    mean = np.where(finite, array, 0.0).sum(axis=0) / safe
    deviation = np.where(finite, array - mean, 0.0) if finite.any() else np.zeros_like(array)
    some = counts > 0
    return Statistics(
        len(array),
        counts,
        {
            "min": np.where(some, np.where(finite, array, np.inf).min(axis=0), 0.0),
            "max": np.where(some, np.where(finite, array, -np.inf).max(axis=0), 0.0),
            "mean": mean,
            "std": np.sqrt((deviation**2).sum(axis=0) / safe),
            **dict(zip(QUANTILES, quantiles, strict=True)),
        },
    )


def columns_statistics(columns: Mapping[str, np.ndarray]) -> dict[str, Statistics]:
    """Computes statistics of columns of the same length, three times as fast as one column at a
    time."""
    parts = [values.reshape(len(values), -1).astype(np.float64) for values in columns.values()]
    ends = np.cumsum([part.shape[1] for part in parts])
    together = column_statistics(np.concatenate(parts, axis=1))
    return {
        name: Statistics(
            together.frames,
            together.finite[end - part.shape[1] : end],
            {key: each[..., end - part.shape[1] : end] for key, each in together.values.items()},
        )
        for name, part, end in zip(columns, parts, ends, strict=True)
    }


def joint_statistics(parts: Sequence[Statistics]) -> Statistics:
    """Combines the statistics of several episodes.

    They are exact except for the quantiles, which, as in LeRobot, are the weighted mean of the
    episodes' quantiles.
    """
    weights = np.stack([part.finite for part in parts])
    total = weights.sum(axis=0)
    share = weights / np.maximum(total, 1.0)

    def each(name: str) -> np.ndarray:
        return np.stack([part.values[name] for part in parts])

    some = total > 0
    mean = (share * each("mean")).sum(axis=0)
    variance = (share * (each("std") ** 2 + (each("mean") - mean) ** 2)).sum(axis=0)
    low = np.where(weights > 0, each("min"), np.inf).min(axis=0)
    high = np.where(weights > 0, each("max"), -np.inf).max(axis=0)
    return Statistics(
        sum(part.frames for part in parts),
        total,
        {
            "min": np.where(some, low, 0.0),
            "max": np.where(some, high, 0.0),
            "mean": mean,
            "std": np.sqrt(variance),
            **{name: (share * each(name)).sum(axis=0) for name in QUANTILES},
        },
    )


# --- tables and README ---------------------------------------------------------------------------


def episodes_table(
    rows: Sequence[dict[str, Any]],
    statistics: Sequence[dict[str, Statistics]],
    *,
    chunk: int = 0,
    file: int = 0,
) -> Any:
    """Makes the table of one file in ``meta/episodes``.

    Args:
        rows: rows of the episodes in the file, each with the same columns.
        statistics: statistics of each, by feature.
        chunk: number of the file's chunk.
        file: number of the file in it.
    """
    columns: dict[str, list[Any]] = {name: [row[name] for row in rows] for name in rows[0]}
    lists = [{name: part.to_lists() for name, part in each.items()} for each in statistics]
    for name, parts in lists[0].items():
        for statistic in parts:
            columns[f"stats/{name}/{statistic}"] = [each[name][statistic] for each in lists]
    columns["meta/episodes/chunk_index"] = [chunk] * len(rows)
    columns["meta/episodes/file_index"] = [file] * len(rows)
    return arrow().table(columns)


def episode_row(
    number: int, first: int, count: int, task: str, place: tuple[int, int]
) -> dict[str, Any]:
    """Makes a row of ``meta/episodes``, without statistics.

    Args:
        number: ``episode_index``.
        first: ``index`` of its first frame.
        count: number of its frames.
        place: numbers of the chunk, and of the file in it, that contain its frames.
    """
    return {
        "episode_index": number,
        "tasks": [task],
        "length": count,
        "data/chunk_index": place[0],
        "data/file_index": place[1],
        "dataset_from_index": first,
        "dataset_to_index": first + count,
    }


def dataset_info(
    features: Mapping[str, Any],
    *,
    robot: str | None,
    episodes: int,
    frames: int,
    tasks: int,
    fps: float,
    video_path: str | None = None,
) -> dict[str, Any]:
    """The content of ``meta/info.json``."""
    return {
        "codebase_version": CODEBASE_VERSION,
        "robot_type": robot,
        "total_episodes": episodes,
        "total_frames": frames,
        "total_tasks": tasks,
        "chunks_size": FILES_A_CHUNK,
        "data_files_size_in_mb": FILE_MB,
        "video_files_size_in_mb": VIDEO_MB,
        "fps": int(fps) if float(fps).is_integer() else fps,
        "splits": {"train": f"0:{episodes}"},
        "data_path": DATA_PATH,
        "video_path": video_path,
        "features": features,
    }


def mean_rate(stamps: Float[np.ndarray, " T"]) -> float | None:
    """Mean frame rate [Hz] over all time steps except pauses; None for fewer than two frames."""
    steps = np.diff(stamps)
    usual = steps[steps <= PAUSE * np.median(steps)] if len(steps) else steps
    return float(1.0 / usual.mean()) if len(usual) and usual.mean() > 0.0 else None


STANDARD_FPS: Final = (
    *(10, 15, 20, 24, 25, 30, 50, 60, 72, 90),
    *(100, 120, 144, 200, 240, 250, 500, 1000),
)
"""Common frame rates of cameras, headsets, gloves and control loops [Hz]."""


def standard_fps(rate: float) -> int:
    """Returns the common frame rate within 5 % of a rate, or else the nearest whole number [Hz].

    A loop of 100 Hz, for example, runs at 95 to 99 Hz on a busy machine."""
    near = min(STANDARD_FPS, key=lambda fps: abs(fps / rate - 1.0))
    return near if abs(near / rate - 1.0) <= 0.05 else max(1, round(rate))


def tasks_table(tasks: Iterable[str]) -> Any:
    """Makes the table of ``meta/tasks.parquet``; the number of a row is the task's
    ``task_index``."""
    pa = arrow()
    texts = list(tasks)
    index = pa.array(range(len(texts)), pa.int64())
    table = pa.table({"task_index": index, "task": pa.array(texts, pa.string())})
    # LeRobot looks tasks up in the index of a pandas table; this is what makes one of the column.
    pandas = {
        "index_columns": ["task"],
        "column_indexes": [],
        "columns": [
            {
                "name": name,
                "field_name": name,
                "pandas_type": kind,
                "numpy_type": numpy,
                "metadata": None,
            }
            for name, kind, numpy in (
                ("task_index", "int64", "int64"),
                ("task", "unicode", "object"),
            )
        ],
        "creator": {"library": "pyarrow", "version": pa.__version__},
    }
    return table.replace_schema_metadata({"pandas": json.dumps(pandas)})


def write_description(
    folder: Path, info: Mapping[str, Any], statistics: Mapping[str, Any], readme: str
) -> None:
    """Writes ``info.json``, ``stats.json`` and the README of a data set, each atomically.

    Args:
        folder: folder of the data set, with its folder ``meta``.
        statistics: statistics of every feature, as from ``Statistics.to_lists``.
        readme: text from ``dataset_readme``.

    Raises:
        OutputError: a file can't be written.
    """
    write_json(folder / "meta" / "stats.json", statistics, indent=4)
    write_json(folder / "meta" / "info.json", info, indent=4)
    with atomic_write(folder / "README.md") as file:
        file.write(readme.encode())


def dataset_readme(
    info: Mapping[str, Any], title: str, more: str = "", units: Mapping[str, str] | None = None
) -> str:
    """Makes the README of a data set. The Hugging Face hub reads its header to show the frames as a
    table.

    Args:
        info: content of ``meta/info.json``.
        more: further text below the title.
        units: unit or meaning of columns for which it is not that of ``schema.COLUMNS``.
    """
    units = {name: column_of(name)[1] for name in info["features"]} | dict(units or {})
    rows = []
    for name, feature in info["features"].items():
        size = "" if feature["shape"] == [1] else f" × {' × '.join(map(str, feature['shape']))}"
        rows.append(f"| `{name}` | {feature['dtype']}{size} | {units[name]} |\n")
    return (
        f"{_CARD_HEAD}\n# {title}\n\nA LeRobot data set ({info['codebase_version']}), written by "
        f"smooth-operator: {info['total_episodes']} episodes, {info['total_frames']} frames, "
        f"{info['fps']:g} frames per second. {more}\n\n"
        f"| column | type | unit, meaning |\n|---|---|---|\n{''.join(rows)}"
    )


_CARD_HEAD: Final = """---
tags:
- LeRobot
task_categories:
- robotics
configs:
- config_name: default
  data_files: data/*/*.parquet
---
"""
