"""Reads arrays that accompany the landmarks in a file: validity flags, poses, confidences,
timestamps."""

from __future__ import annotations

from collections.abc import Container, Sequence
from typing import Final

import numpy as np
from jaxtyping import Bool, Float

from smooth_operator.errors import RecordingError, brief
from smooth_operator.formats.arrays import StoredArray, StoredArrays
from smooth_operator.formats.checks import stamps_from_rate
from smooth_operator.landmarks import NUM_LANDMARKS
from smooth_operator.poses import from_matrices, is_rigid
from smooth_operator.types import unit_poses

_FLAG_NAMES: Final = ("valid", "mask", "visib", "tracked", "presen", "confid")
_ROUNDING: Final = 1e-3
"""Excess over 1 up to which a confidence counts as 1."""
_LENGTH: Final = 0.05
"""Tolerance of the length of a unit quaternion; quaternions of gloves are up to 1 % off."""
_ZERO: Final = 1e-6
"""Length of a quaternion up to which it marks an unknown pose."""


def validity(
    stored: StoredArray, count: int, picked: Sequence[int], nodes: int
) -> Bool[np.ndarray, "T 21"]:
    """Reads validity flags: one per frame, one per landmark, or one per tracker point.

    Args:
        stored: the array; true and false, or 1 and 0 of any type of number.
        count: number of frames.
        picked: index of each landmark among the tracker's points.
        nodes: number of the tracker's points.

    Raises:
        RecordingError: the array has another shape or other values.
    """
    shapes = [(count,), (count, 1), (count, NUM_LANDMARKS), (count, nodes)]
    if stored.shape not in shapes:
        raise RecordingError(
            f"{stored.path}: the flags {brief(stored.name)} must have shape ({count},), one "
            f"per frame, or ({count}, {nodes}), one per landmark, not {stored.shape}"
        )
    values = stored.load()
    if values.dtype.kind not in "bfiu" or not np.isin(values, (0, 1)).all():
        raise RecordingError(
            f"{stored.path}: the flags {brief(stored.name)} must be true or false, or 1 or "
            f"0, not {_content(values)}; if they are confidences, apply a threshold: valid = "
            "confidence > 0.3"
        )
    flags = values.astype(bool)
    if flags.shape == (count, nodes) and flags.ndim == 2 and nodes > 1:
        return flags[:, list(picked)]
    return np.broadcast_to(flags.reshape(count, -1), (count, NUM_LANDMARKS)).copy()


def _content(values: np.ndarray) -> str:
    if values.dtype.kind not in "bfiu":
        return str(values.dtype)
    other = values[~np.isin(values, (0, 1))]
    return f"{values.dtype} with values such as {other[0]:g}"


def pose_rows(stored: StoredArray, count: int, order: str = "wxyz") -> Float[np.ndarray, "T 7"]:
    """Reads the poses of a file, one per frame; unknown poses are NaN.

    Args:
        stored: (T, 7) x y z [m] and a unit quaternion, or (T, 4, 4) or (T, 1, 4, 4) matrices. A row
            with NaN or only zeros is unknown.
        count: number of frames.
        order: order of the quaternion, ``wxyz`` or ``xyzw``.

    Raises:
        RecordingError: another shape, a quaternion that is not of length 1 within 5 %, or a matrix
            that is not a rotation.
    """
    name = f"{stored.path}: {brief(stored.name)}"
    if stored.shape in ((count, 4, 4), (count, 1, 4, 4)):
        matrices = stored.numbers().reshape(count, 4, 4)
        known = np.isfinite(matrices).all(axis=(1, 2)) & (matrices != 0).any(axis=(1, 2))
        wrong = known & ~is_rigid(matrices)
        if wrong.any():
            first = int(np.argmax(wrong))
            turned = is_rigid(np.swapaxes(matrices[first], -1, -2))
            raise RecordingError(
                f"{name} of frame {first} is not a rotation and position ({int(wrong.sum())} "
                f"of {count} frames); expected 4 x 4 matrices with the last row 0 0 0 1 and "
                "without scaling"
                + ("; these are transposed: array.swapaxes(-1, -2)" if turned else "")
            )
        rows = np.full((count, 7), np.nan)
        rows[known] = from_matrices(matrices[known])
        return rows
    if stored.shape != (count, 7):
        raise RecordingError(
            f"{name} must have shape ({count}, 7), x y z [m] and a unit quaternion "
            f"{' '.join(order)}, or be 4 x 4 matrices ({count}, 4, 4), not {stored.shape}"
        )
    rows = stored.numbers()
    if order == "xyzw":
        rows = rows[:, [0, 1, 2, 6, 3, 4, 5]]
    with np.errstate(over="ignore"):  # of numbers beyond any pose
        lengths = np.linalg.norm(rows[:, 3:], axis=1)
    wrong = np.isfinite(rows).all(axis=1) & (np.abs(lengths - 1.0) > _LENGTH) & (lengths > _ZERO)
    if wrong.any():
        first = int(np.argmax(wrong))
        raise RecordingError(
            f"{name} of frame {first} has a quaternion of length {lengths[first]:.3g}, so it "
            f"is not a rotation ({int(wrong.sum())} of {count} frames); expected x y z [m] "
            f"and a unit quaternion {' '.join(order)}, or 4 x 4 matrices"
        )
    return unit_poses(rows)


def quaternion_order(arrays: StoredArrays) -> str:
    """Returns the order of the quaternions in a file, which its array ``quaternion_order`` states.
    Default: ``wxyz``. Raises RecordingError if the array names an unknown order."""
    labels = {"wxyz"}
    if "quaternion_order" in arrays:
        labels = {text.strip().lower() for text in arrays["quaternion_order"].texts()}
    if len(labels) != 1 or not labels <= {"wxyz", "xyzw"}:
        raise RecordingError(
            f"{arrays.path}: 'quaternion_order' must be 'wxyz' or 'xyzw', not "
            f"{brief(sorted(labels))}"
        )
    return labels.pop()


def shares(values: np.ndarray, where: str) -> Float[np.ndarray, " T"]:
    """Checks confidences, which must be at most 1. Negative values (no hand) become 0, and values
    that are not finite become NaN.

    Args:
        values: (T,) confidences of a file.
        where: the file, and the name of the confidence, for the message.

    Raises:
        RecordingError: a confidence is over 1; the message names the likely scale.
    """
    result = np.asarray(values, np.float64)
    finite = result[np.isfinite(result)]
    most = float(finite.max(initial=0.0))
    if most > 1.0 + _ROUNDING:
        scales = [
            text
            for text, limit, fits in (
                ("levels (1 low, 2 high: assign a fraction to each)", 3.0, (finite % 1 == 0).all()),
                ("percent (divide by 100)", 100.0, most > 3.0),
                ("bytes (divide by 255)", 255.0, most > 3.0 and (finite % 1 == 0).all()),
            )
            if fits and most <= limit
        ]
        likely = f"they may be {' or '.join(scales)}" if scales else "no common scale fits"
        raise RecordingError(
            f"{where}: confidences must be fractions from 0 to 1, but the highest is {most:g}; "
            f"{likely}"
        )
    return np.where(np.isfinite(result), np.clip(result, 0.0, 1.0), np.nan)


def own_stamps(
    stamps: Float[np.ndarray, " T"], rate: float | None, where: str
) -> Float[np.ndarray, " T"]:
    """Returns the timestamps of a file, or those of a given rate if all timestamps are equal;
    ConfigError if the rate is outside the range of trackers."""
    if rate is not None and len(stamps) > 2 and (stamps == stamps[0]).all():
        return stamps_from_rate(len(stamps), rate, where)
    return stamps


def unread_flags(arrays: StoredArrays, read: Container[str]) -> list[str]:
    """Names of arrays that look like flags or confidences of the hand, but are not used."""
    return [
        name
        for name in arrays
        if name not in read
        and any(word in name.lower() for word in _FLAG_NAMES)
        and arrays[name].dtype.kind in "bfiu"
    ]
