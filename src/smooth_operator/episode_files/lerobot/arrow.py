"""NumPy arrays to columns of Arrow tables and back."""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import Any

import numpy as np

from smooth_operator.errors import MissingExtraError, RecordingError, listed
from smooth_operator.formats.arrays import damaged
from smooth_operator.formats.bounds import NUMBER_BYTES, Allowance
from smooth_operator.io.documents import check_plain_file


def arrow() -> Any:
    """The module ``pyarrow``.

    Raises:
        MissingExtraError: it is not installed.
    """
    return _module("pyarrow")


def parquet() -> Any:
    """The module ``pyarrow.parquet``.

    Raises:
        MissingExtraError: it is not installed.
    """
    return _module("pyarrow.parquet")


def column(values: np.ndarray) -> Any:
    """An Arrow array of scalars from (T,) or (T, 1), of lists of k from (T, k).

    LeRobot holds a feature of one number as a scalar, whatever it is. NaN stays NaN and is no null.
    """
    pa = arrow()
    if values.ndim == 1 or values.shape[1] == 1:
        return pa.array(np.ascontiguousarray(values.reshape(-1)))
    flat = pa.array(np.ascontiguousarray(values).reshape(-1))
    return pa.FixedSizeListArray.from_arrays(flat, values.shape[1])


def numbers(table: Any, name: str, width: int, where: Path) -> np.ndarray:
    """(T, width) of a column that ``column`` made, or that other programs wrote again.

    Raises:
        RecordingError: there is no such column, or it holds something else.
    """
    pa = arrow()
    if name not in table.column_names:
        raise RecordingError(
            f"{where}: it lacks the column {name!r}; it has {listed(table.column_names)}"
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
            f"{where}: the column {name!r} must hold {width} numbers a row, not "
            f"{str(table.schema.field(name).type)[:80]}"
            + (f" with {nulls} nulls" if nulls else "")
            + "; copy the dataset again"
        )
    values: np.ndarray = flat.to_numpy(zero_copy_only=False).reshape(table.num_rows, width)
    return values


def read_table(path: Path, filters: Any = None) -> Any:
    """A Parquet file as an Arrow table.

    Raises:
        RecordingError: no such file, or damaged.
    """
    pa, pq = arrow(), parquet()
    try:
        size = check_plain_file(path)
        _check_size(pq.ParquetFile(path), path, size)
        return pq.read_table(path, filters=filters, partitioning=None)
    except RecordingError:
        raise
    except FileNotFoundError:
        raise RecordingError(
            f"{path}: no such file; the dataset is incomplete, copy it again"
        ) from None
    except (pa.ArrowException, OSError, ValueError, KeyError, TypeError, MemoryError) as error:
        raise damaged(path, f"Parquet: {error}") from error


def _check_size(file: Any, path: Path, size: int) -> None:
    """Refuses a file whose columns take far more than it does: a run of equal values is stored as
    one, and a list of a fixed length takes it even where it is null."""
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
