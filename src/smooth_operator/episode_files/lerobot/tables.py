"""The tables of a dataset besides its frames: its episodes and its tasks; where its files are."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from typing import Any, Final

from smooth_operator.episode_files.lerobot.arrow import arrow
from smooth_operator.episode_files.lerobot.stats import Statistics

CODEBASE_VERSION: Final = "v3.0"
CHUNK_PATH: Final = "chunk-{chunk_index:03d}/file-{file_index:03d}"
DATA_PATH: Final = f"data/{CHUNK_PATH}.parquet"
EPISODES_PATH: Final = f"meta/episodes/{CHUNK_PATH}.parquet"
VIDEO_PATH: Final = f"videos/{{video_key}}/{CHUNK_PATH}.mp4"
FILES_A_CHUNK: Final = 1000  # as LeRobot
VIDEO_MB: Final = 200

OWN_COLUMN: Final = "smooth_operator"
"""Column of ``meta/episodes`` with what LeRobot has no place for, as JSON."""

UNNAMED_TASK: Final = "unnamed"
"""LeRobot wants a task of every frame; this stands in for one that is not known."""


def episodes_table(
    rows: Sequence[dict[str, Any]],
    statistics: Sequence[dict[str, Statistics]],
    *,
    chunk: int = 0,
    file: int = 0,
) -> Any:
    """The table of a file of ``meta/episodes``.

    Args:
        rows: of the episodes in the file, each with the same columns.
        statistics: of each, by feature.
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


def tasks_table(tasks: Iterable[str]) -> Any:
    """The table of ``meta/tasks.parquet``; a task's row is its ``task_index``."""
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
