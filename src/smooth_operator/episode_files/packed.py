"""Reads clips that the Parquet writer packed: many clips per file, one clip per row."""

from __future__ import annotations

import functools
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import numpy as np

from smooth_operator.episode_files.lerobot.tables import arrow, parquet
from smooth_operator.errors import RecordingError, SmoothOperatorError, brief
from smooth_operator.formats.arrays import damaged
from smooth_operator.formats.both_hands import checked_hands
from smooth_operator.formats.clip import SIDES, Clip, ClipRef, ObjectTrack, ReadingOptions
from smooth_operator.io.documents import json_object
from smooth_operator.io.plain_files import check_plain_file
from smooth_operator.types import HandRecording

_MOST_GROUP_BYTES: Final = 1 << 30
_TEXTS: Final = ("name", "layout", "task", "world", "video", "meta")


class Packed:
    """Reader of files in the format ``parquet``.

    It reads the human hands, so that a data set for one robot hand can be converted to a data set
    for another. Workers read one row group at a time.
    """

    what = "a Parquet file of packed clips"
    expects = (
        "the columns that 'dataset --format parquet' writes: 'name', 'stamps', and "
        "'right_landmarks' or 'left_landmarks'"
    )

    def matches(self, path: Path) -> bool:
        """True if a Parquet file has the columns of clips, whichever program wrote it."""
        if path.suffix.lower() != ".parquet" or not path.is_file():
            return False
        try:
            names = set(parquet().read_schema(path).names)
        except Exception:  # no library, or a damaged file
            return False
        hands = {"right_landmarks", "left_landmarks"}
        return {"name", "stamps"} <= names and bool(hands & names)

    def clips(self, path: Path) -> Iterator[ClipRef]:
        """Yields a reference for each row; reads only the column of names. Raises RecordingError if
        the file is damaged."""
        try:
            check_plain_file(path)
            with parquet().ParquetFile(path, page_checksum_verification=True) as file:
                for group in range(file.metadata.num_row_groups):
                    for row, name in enumerate(_group(file, path, group, ["name"])["name"]):
                        yield ClipRef(str(name), path, f"{group}/{row}", "parquet")
        except SmoothOperatorError as error:
            raise RecordingError(f"{path}: {error}") from error
        except _errors() as error:
            raise damaged(path, f"Parquet: {error}") from error

    def read(self, ref: ClipRef, options: ReadingOptions) -> Clip:
        """Reads the human hands of a row, with the timestamps that the file contains. Raises
        RecordingError if the file is damaged, or is not in the writer's format."""
        try:
            group, row = map(int, ref.key.split("/"))
            status = ref.path.stat()
            table = _cached(ref.path, status.st_mtime_ns, status.st_size, group)
            return clip_of_row(table, row, ref.path)
        except SmoothOperatorError as error:
            text = str(error)
            at = "" if text.startswith(str(ref.path)) else f"{ref.path}, clip {ref.name!r}: "
            raise RecordingError(f"{at}{text}") from error
        except _errors() as error:
            raise damaged(ref.path, f"Parquet: {error}") from error


def clip_of_row(table: Any, row: int, path: Path) -> Clip:
    """Makes a clip from a row of an Arrow table with the columns of the Parquet writer.

    ``stamps`` and one of ``right_landmarks`` and ``left_landmarks`` are required; the other columns
    may be absent or null.

    Args:
        table: table whose lists have one item per frame; points are lists of 63 numbers, or of
            21 times 3.
        path: the file, for the clip's source and for messages.

    Raises:
        RecordingError: a column is missing, or does not have the same number of frames as
            ``stamps``.
    """
    where = str(path)
    text = {name: _text(table, name, row) for name in _TEXTS}
    name = str(text["name"] or row)
    stamps = _numbers(table, "stamps", row, None)
    if stamps is None:
        raise RecordingError(f"{where}: clip {name!r} lacks the column 'stamps'")
    count = len(stamps)

    def rows(column: str, *shape: int) -> np.ndarray | None:
        values = _numbers(table, column, row, count)
        if values is None:
            return None
        if values.size != count * int(np.prod(shape, dtype=int)):
            raise RecordingError(
                f"{where}: clip {name!r}: {column} must hold {shape or 1} numbers for each of "
                f"{count} frames, not {values.size} in all"
            )
        return values.reshape(count, *shape)

    hands, confidence, shape = {}, {}, {}
    for side in SIDES:
        landmarks = rows(f"{side}_landmarks", 21, 3)
        if landmarks is None:
            continue
        wrist = rows(f"{side}_human_wrist", 7)
        world = None if wrist is None else text["world"] or "unknown"
        hands[side] = HandRecording(
            landmarks, stamps, side, name=name, T_world_wrist=wrist, world=world
        )
        sure = rows(f"{side}_confidence")
        if sure is not None:
            confidence[side] = sure
        parameters = _numbers(table, f"{side}_shape", row, None)
        if parameters is not None:
            shape[side] = parameters
    hands = checked_hands(hands, f"{where}, clip {name!r}", Packed.expects)
    return Clip(
        name,
        hands,
        str(text["layout"] or "parquet"),
        (path,),
        text["task"],
        {side: sure for side, sure in confidence.items() if side in hands},
        rows("camera", 7),
        tuple(_objects(table, row, count, rows)),
        {side: numbers for side, numbers in shape.items() if side in hands},
        None if text["video"] is None else Path(text["video"]),
        _number(table, "video_start_s", row),
        json_object(text["meta"] or "") or {},
    )


def _objects(table: Any, row: int, count: int, rows: Any) -> Iterator[ObjectTrack]:
    names = _value(table, "object_names", row) or []
    if not names:
        return
    tracks = rows("objects", len(names), 7)
    if tracks is None:
        return
    meshes = _value(table, "object_meshs", row) or [None] * len(names)
    scales = _value(table, "object_scales", row) or [1.0] * len(names)
    for k, (name, mesh, scale) in enumerate(zip(names, meshes, scales, strict=True)):
        yield ObjectTrack(name, tracks[:, k], None if mesh is None else Path(mesh), scale or 1.0)


def _number(table: Any, name: str, row: int) -> float:
    value = _value(table, name, row)
    return float(value) if isinstance(value, int | float) and np.isfinite(value) else 0.0


def _text(table: Any, name: str, row: int) -> str | None:
    value = _value(table, name, row)
    if value is None or isinstance(value, str):
        return value
    raise RecordingError(f"column {name!r} must hold strings, not {brief(value)}")


def _value(table: Any, name: str, row: int) -> Any:
    """A cell as a Python value; None if there is no such column."""
    return table.column(name)[row].as_py() if name in table.column_names else None


def _numbers(table: Any, name: str, row: int, count: int | None) -> np.ndarray | None:
    """The numbers of a cell as a flat array; None if the cell is null or missing."""
    if name not in table.column_names:
        return None
    pa = arrow()
    kind = table.schema.field(name).type
    if pa.types.is_null(kind):
        return None
    if not _is_list(pa, kind):
        raise RecordingError(f"column {name!r} must hold lists of numbers, not {str(kind)[:80]}")
    values = table.column(name)[row].values
    while values is not None and _is_list(pa, values.type):
        values = values.flatten()
    if values is None or (count and not len(values)):
        return None
    kind = values.type
    if not (pa.types.is_floating(kind) or pa.types.is_integer(kind) or pa.types.is_boolean(kind)):
        raise RecordingError(f"column {name!r} must hold lists of numbers, not of {str(kind)[:80]}")
    numbers: np.ndarray = np.asarray(values.to_numpy(zero_copy_only=False), np.float64)
    return numbers


def _is_list(pa: Any, kind: Any) -> bool:
    checks = (pa.types.is_list, pa.types.is_large_list, pa.types.is_fixed_size_list)
    return any(check(kind) for check in checks)


def _group(file: Any, path: Path, group: int, columns: list[str] | None = None) -> Any:
    held = file.metadata.row_group(group)
    if held.total_byte_size > _MOST_GROUP_BYTES:
        raise RecordingError(
            f"{path}: it has a row group of {held.total_byte_size >> 20} MB, which is too large; "
            "write the file with smaller row groups"
        )
    return file.read_row_group(group, columns=columns)


@functools.lru_cache(maxsize=2)
def _cached(path: Path, _modified_ns: int, _size: int, group: int) -> Any:
    """Reads a row group, and keeps it because it also contains the neighbours of a clip."""
    check_plain_file(path)
    with parquet().ParquetFile(path, page_checksum_verification=True) as file:
        return _group(file, path, group)


def _errors() -> tuple[type[BaseException], ...]:
    return arrow().ArrowException, OSError, ValueError, KeyError, TypeError, MemoryError


PACKED: Final = Packed()
