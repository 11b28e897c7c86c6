"""Points of a hand in the forms that trackers send: rows, objects, rows of 7, 4 x 4 matrices."""

from __future__ import annotations

from typing import Any, Final, Literal, TypeAlias

import numpy as np
from jaxtyping import Float

from smooth_operator.errors import RecordingError
from smooth_operator.poses import is_rigid, quaternions

QuaternionOrder: TypeAlias = Literal["wxyz", "xyzw"]
"""Order of the quaternion in a row of 7, after x y z."""
MatrixOrder: TypeAlias = Literal["auto", "rows", "columns"]
"""How a 4 x 4 matrix is written: row by row (the row 0 0 0 1 last) or column by column."""

_AXES: Final = ("x", "y", "z")
_LAST: Final = np.array([0.0, 0.0, 0.0, 1.0])
_CLOSE: Final = 1e-3  # of the last row; trackers send float32 and rounded text


def read_points(
    value: Any,
    what: str,
    *,
    quaternion: QuaternionOrder = "wxyz",
    matrix: MatrixOrder = "auto",
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 4"] | None]:
    """Points and, where the form has them, their orientations.

    Args:
        value: of JSON: n rows of x y z; objects ``{"x": , "y": , "z": }`` (MediaPipe; other keys
            are left alone); rows of x y z and a quaternion; 4 x 4 matrices, as rows of rows or 16
            numbers each; or all numbers of x y z in one row. A row that is null is missing.
        what: its name, for messages.
        quaternion: order in rows of 7.
        matrix: how matrices are written.

    Returns:
        (n, 3) positions [m], NaN where missing, and (n, 4) quaternions wxyz or None.

    Raises:
        RecordingError: none of these forms, or matrices that are no rigid transforms.
    """
    if isinstance(value, list) and any(isinstance(row, dict) for row in value):
        return _of_objects(value, what), None
    rows = read_numbers(_with_missing(value), what)
    if rows.ndim == 1 and rows.size % 3 == 0:
        return rows.reshape(-1, 3), None
    if rows.ndim == 2 and rows.shape[1] == 3:
        return rows, None
    if rows.ndim == 2 and rows.shape[1] == 7:
        order = (3, 4, 5, 6) if quaternion == "wxyz" else (6, 3, 4, 5)
        return rows[:, :3], rows[:, order]
    if rows.ndim == 2 and rows.shape[1] == 16:
        rows = rows.reshape(-1, 4, 4)
    if rows.ndim == 3 and rows.shape[1:] == (4, 4):
        return points_of_matrices(rows, what, matrix)
    raise RecordingError(
        f"{what} must be 21 rows of x, y, z (or of x, y, z and a quaternion, objects with x, y, z, "
        f"or 4 x 4 matrices), not shape {rows.shape}"
    )


def points_of_matrices(
    matrices: Float[np.ndarray, "n 4 4"], what: str, order: MatrixOrder = "auto"
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 4"]]:
    """Positions and quaternions wxyz of transforms; NaN where a matrix has NaN.

    Raises:
        RecordingError: 0 0 0 1 does not stand where ``order`` has it (with ``auto``, in neither
            place), or an upper left part is no rotation.
    """
    whole = np.isfinite(matrices).all(axis=(1, 2))
    found = matrices[whole]
    by_rows, by_columns = (
        bool((np.abs(last - _LAST) < _CLOSE).all()) for last in (found[:, 3], found[:, :, 3])
    )
    if order == "columns" or (order == "auto" and by_columns and not by_rows):
        matrices, placed = np.swapaxes(matrices, 1, 2), by_columns
    else:
        placed = by_rows
    if not placed:
        where = {
            "auto": "neither the last row nor the last column",
            "rows": "not the last row (matrix=rows)",
            "columns": "not the last column (matrix=columns)",
        }[order]
        raise RecordingError(
            f"{what} must be rigid transforms with 0 0 0 1 in the last row (row by row) or in the "
            f"last column (column by column), but {where} is; say matrix=rows or matrix=columns, "
            "or leave it out"
        )
    rotation = matrices[:, :3, :3]
    if not is_rigid(matrices[whole]).all():
        mirrored = is_rigid(matrices[whole] * np.array([-1.0, 1.0, 1.0, 1.0])).all()
        raise RecordingError(
            f"{what} must be rotations and positions, but a matrix is scaled or skewed"
            if not mirrored
            else f"{what} must be in a right-handed frame, but a matrix is a mirror image"
        )
    turned = np.full((len(matrices), 4), np.nan)
    turned[whole] = quaternions(rotation[whole])
    return np.where(whole[:, None], matrices[:, :3, 3], np.nan), turned


def read_numbers(value: Any, what: str) -> Float[np.ndarray, "..."]:
    """Numbers of a JSON value as an array; null is NaN.

    Raises:
        RecordingError: there is something else in it, or its rows differ in length.
    """
    try:
        return np.array(value, np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise RecordingError(f"{what} must be numbers in rows of one length: {error}") from error


def short(value: Any) -> str:
    """A value for a message, 60 characters at most."""
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."


def _of_objects(value: list[Any], what: str) -> Float[np.ndarray, "n 3"]:
    rows = []
    for item in value:
        if item is None:
            rows.append([None] * 3)
        elif isinstance(item, dict) and all(axis in item for axis in _AXES):
            rows.append([item[axis] for axis in _AXES])
        else:
            raise RecordingError(
                f"{what} must be numbers: objects with x, y and z, not {short(item)}"
            )
    return read_numbers(rows, what)


def _with_missing(value: Any) -> Any:
    """The same with rows that are null as rows of null, as long as the others."""
    if not (isinstance(value, list) and None in value):
        return value
    model = next((row for row in value if isinstance(row, list)), None)
    if model is None:
        return value
    return [_blank(model) if row is None else row for row in value]


def _blank(row: list[Any]) -> list[Any]:
    return [_blank(item) if isinstance(item, list) else None for item in row]
