"""Writes Parquet files with one row per clip, in which per-frame values are stored as lists.

A row is a clip, not a frame, because clips differ in hands, objects and frames, because task and
origin would otherwise be repeated in every frame, and because training on clips would have to group
the rows again. The ``unnest`` function of query engines gives one row per frame.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import numpy as np

from smooth_hand_datasets.pipeline.clip import RobotClip
from smooth_hand_datasets.pipeline.writers.arrays import clip_arrays, clip_document, resampled
from smooth_hand_datasets.pipeline.writers.registry import DatasetFormat, WritingOptions
from smooth_hand_datasets.pipeline.writers.shards import MB, ShardedWriter, drop_parquet
from smooth_operator.episode_files.lerobot.tables import arrow, parquet
from smooth_operator.formats.clip import SIDES
from smooth_operator.io.jsonable import to_json
from smooth_operator.types import Side

_GROUP_BYTES: Final = 8 * MB  # of arrays in a row group: what a reader takes at a time
_FIXED: Final = {"wrist": 7, "human_wrist": 7, "camera": 7, "landmarks": 63}
_SCALARS: Final = {"stamps": "float64", "valid": "bool_", "status": "int8", "confidence": "float32"}
_UNITS: Final = {
    "stamps": "s",
    "joints": "rad, in the order of SIDE_joint_names",
    "wrist": "robot wrist in the world: x y z in m, quaternion w x y z",
    "valid": "whether the command was computed from a hand that was seen",
    "status": "status of the command",
    "confidence": "confidence of the tracker, 0 to 1",
    "human_wrist": "human wrist in the world: x y z in m, quaternion w x y z",
    "landmarks": "21 points x 3, m, in the tracker's frame",
    "camera": "camera in the world: x y z in m, quaternion w x y z",
    "objects": "poses of 7 numbers each, one after another, in the order of object_names",
}
_TEXTS: Final = ("key", "name", "layout", "task", "world", "video", "configuration", "meta")


class _Writer(ShardedWriter):
    def __init__(self, output: Path, options: WritingOptions) -> None:
        self._columns = _columns()
        super().__init__(output, options, "parquet", 128.0, {"rate": options.rate})

    def _path(self, number: int) -> Path:
        return self.output / "data" / f"{self.shard_name(number)}.parquet"

    def _start(self) -> None:
        pa = arrow()
        fields = [
            pa.field(name, kind, metadata=_about(name)) for name, (kind, _) in self._columns.items()
        ]
        metadata = {"smooth_operator": to_json({"format": "clips", "version": 1})}
        self._rows: list[tuple[dict[str, Any], dict[str, np.ndarray]]] = []
        self._bytes = 0
        # Numbers of a movement hardly repeat, and pack better byte by byte than in a dictionary.
        self._parquet = parquet().ParquetWriter(
            self._file,
            pa.schema(fields, metadata=metadata),
            compression="zstd",
            write_page_checksum=True,
            use_dictionary=[*_TEXTS, *(f"{side}_hand" for side in SIDES)],
            use_byte_stream_split=_leaves(pa, self._columns),
        )

    def _add(self, clip: RobotClip, entry: dict[str, Any]) -> None:
        if self.options.rate is not None:
            clip = resampled(clip, self.options.rate)
        arrays = clip_arrays(clip)
        document = clip_document(clip, entry["key"], self.configuration(clip))
        entry["frames"] = len(clip.clip)
        self._rows.append((document, arrays))
        self._bytes += sum(array.nbytes for array in arrays.values())
        if self._bytes >= min(_GROUP_BYTES, self._limit):
            self._flush()

    def _flush(self) -> None:
        if self._rows:
            columns = [make(self._rows) for _, make in self._columns.values()]
            table = arrow().Table.from_arrays(columns, schema=self._parquet.schema)
            self._parquet.write_table(table, row_group_size=len(self._rows))
        self._rows, self._bytes = [], 0

    def _complete(self) -> dict[str, Any]:
        self._flush()
        self._parquet.close()
        return {}

    def _discard(self) -> None:
        drop_parquet(self._parquet)


_Rows = list[tuple[dict[str, Any], dict[str, np.ndarray]]]
_Make = Callable[[_Rows], Any]


def _columns() -> dict[str, tuple[Any, _Make]]:
    """Name of a column -> its Arrow type, and the function that computes it from clips."""
    pa = arrow()
    columns: dict[str, tuple[Any, _Make]] = {}

    def said(name: str, kind: Any, of: Callable[[dict[str, Any]], Any]) -> None:
        columns[name] = (kind, lambda rows: pa.array([of(each) for each, _ in rows], kind))

    def item(name: str) -> Callable[[dict[str, Any]], Any]:
        return lambda document: document[name]

    for name in ("key", "name", "task", "layout", "world", "video", "configuration"):
        said(name, pa.string(), item(name))
    said("source", pa.list_(pa.string()), item("source"))
    said("meta", pa.string(), lambda document: to_json(document["meta"]))
    said("frames", pa.int32(), item("frames"))
    said("rate_hz", pa.float64(), item("rate_hz"))
    said("video_start_s", pa.float64(), item("video_start_s"))
    figures = pa.map_(pa.string(), pa.float64())
    said("figures", figures, lambda document: list(document["figures"].items()))
    for part, kind in (("name", pa.string()), ("mesh", pa.string()), ("scale", pa.float64())):
        said(f"object_{part}s", pa.list_(kind), _objects(part))
    for side in SIDES:
        said(f"{side}_hand", pa.string(), _sided("hands", side))
        said(f"{side}_joint_names", pa.list_(pa.string()), _sided("joints", side))
        said(f"{side}_shape", pa.list_(pa.float64()), _sided("shape", side))
    columns["stamps"] = _list("stamps")
    for side in SIDES:
        for what in ("joints", "wrist", "valid", "status", "confidence", "human_wrist"):
            columns[f"{side}_{what}"] = _list(f"{side}_{what}")
        columns[f"{side}_landmarks"] = _list(f"{side}_landmarks")
    columns["camera"], columns["objects"] = _list("camera"), _list("objects")
    return columns


def _objects(part: str) -> Callable[[dict[str, Any]], Any]:
    return lambda document: [each[part] for each in document["objects"]]


def _sided(part: str, side: Side) -> Callable[[dict[str, Any]], Any]:
    return lambda document: document[part].get(side)


def _list(name: str) -> tuple[Any, _Make]:
    """A column with one item per frame: a number, or a list of numbers."""
    pa = arrow()
    what = _what(name)
    if what in _SCALARS:
        item = getattr(pa, _SCALARS[what])()
    elif what in _FIXED:
        item = pa.list_(pa.float32(), _FIXED[what])
    else:
        item = pa.list_(pa.float32())
    kind = pa.list_(item)

    def make(rows: _Rows) -> Any:
        values = [arrays.get(name) for _, arrays in rows]
        there = [array for array in values if array is not None]
        sizes = [0 if array is None else len(array) for array in values]
        offsets = np.concatenate([[0], np.cumsum(sizes)]).astype(np.int32)
        absent = np.array([array is None for array in values] + [False])
        if not there:
            return pa.nulls(len(rows), kind)
        flat = pa.array(np.concatenate([array.reshape(-1) for array in there]))
        if what in _FIXED:
            flat = pa.FixedSizeListArray.from_arrays(flat, _FIXED[what])
        elif what not in _SCALARS:
            widths = np.concatenate(
                [np.full(len(array), array[0].size, np.int32) for array in there]
            )
            starts = np.concatenate([[0], np.cumsum(widths)]).astype(np.int32)
            flat = pa.ListArray.from_arrays(pa.array(starts), flat)
        return pa.ListArray.from_arrays(pa.array(offsets, mask=absent), flat).cast(kind)

    return kind, make


def _what(name: str) -> str:
    side, _, what = name.partition("_")
    return what if side in SIDES else name


def _about(name: str) -> dict[str, str] | None:
    unit = _UNITS.get(_what(name))
    return None if unit is None else {"unit": unit}


def _leaves(pa: Any, columns: dict[str, tuple[Any, _Make]]) -> list[str]:
    """Paths of the float32 columns in the file."""
    paths = []
    for name, (kind, _) in columns.items():
        path = name
        while pa.types.is_list(kind) or pa.types.is_fixed_size_list(kind):
            path, kind = f"{path}.list.element", kind.value_type
        if pa.types.is_float32(kind):
            paths.append(path)
    return paths


PARQUET: Final = DatasetFormat("Parquet files of clips", _Writer, parallel=True)
