"""EgoHandKit: both hands of a video in the camera's frame, from ``hand_tracking.parquet``.

Source: ``hmr_backends/utils/hand_tracking_parquet.py`` of RoboCoin-BAAI/EgoHandKit.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import numpy as np
from jaxtyping import Float

from smooth_hand_datasets.scene import wrist_of_points
from smooth_operator.episode_files.lerobot.tables import arrow, parquet, read_table
from smooth_operator.errors import MissingExtraError, RecordingError, brief, listed
from smooth_operator.formats.both_hands import checked_hands
from smooth_operator.formats.checks import check_stamps, stamps_from_rate
from smooth_operator.formats.clip import CAMERA, SIDES, Clip, ClipRef, ReadingOptions
from smooth_operator.formats.hand_arrays import shares
from smooth_operator.landmarks import NUM_LANDMARKS
from smooth_operator.types import HandRecording, Side

_COLUMNS: Final = (
    "frame_idx",
    "left_present",
    "right_present",
    "left_joints_3d",
    "right_joints_3d",
)
_SAID: Final = {
    b"coordinate_system": b"opencv_x_right_y_down_z_forward",
    b"joint_order": b"openpose21",
}
_NUMBERS: Final = 3 * NUM_LANDMARKS


class EgoHandKit:
    """Reader of EgoHandKit's files; each file is one clip."""

    what = "hand_tracking.parquet of EgoHandKit"
    expects = (
        "a .parquet file with the columns frame_idx, timestamp_ns, and for left and right "
        "left_present, left_joints_3d (21 x 3) [m] and left_confidence"
    )

    def matches(self, path: Path) -> bool:
        """True if a path is a Parquet file with the columns of both hands."""
        if path.suffix.lower() != ".parquet" or not path.is_file():
            return False
        try:
            names = parquet().read_schema(path).names
        except MissingExtraError:
            return path.name == "hand_tracking.parquet"
        except (arrow().ArrowException, OSError, ValueError, MemoryError):
            return False
        return set(_COLUMNS) <= set(names)

    def clips(self, path: Path) -> Iterator[ClipRef]:
        """List the file."""
        yield ClipRef(_name(path), path, layout="egohandkit", size=path.stat().st_size)

    def read(self, ref: ClipRef, options: ReadingOptions) -> Clip:
        """Read the hands in the frame of the camera, with the wrists from the palm's landmarks.

        Raises:
            RecordingError: the file is damaged, lacks a column, or has another frame or order of
                landmarks; or it has no times and no rate was given.
            MissingExtraError: pyarrow is not installed.
        """
        path = ref.path
        try:
            table = read_table(path)
        except MissingExtraError as error:
            raise MissingExtraError("a Parquet file", "lerobot") from error
        self._check(table, path)
        stamps = _stamps(table, path, options.rate)
        hands = {}
        for side in SIDES:
            points = _points(table, side, path)
            hands[side] = HandRecording(
                points,
                stamps,
                side,
                name=ref.name,
                meta={"format": "egohandkit"},
                T_world_wrist=wrist_of_points(points, side),
                world=CAMERA,
            )
        checked = checked_hands(hands, str(path), self.expects, each_frame=True)
        return Clip(
            ref.name,
            checked,
            "egohandkit",
            (path,),
            confidence={
                side: shares(
                    _column(table, f"{side}_confidence", path, nulls=True),
                    f"{path}, {side}_confidence",
                )
                for side in checked
                if f"{side}_confidence" in table.column_names
            },
            meta=_sources(table),
        )

    def _check(self, table: Any, path: Path) -> None:
        missing = [name for name in _COLUMNS if name not in table.column_names]
        if missing:
            raise RecordingError(
                f"{path}: it lacks {listed(missing)}; it has {listed(table.column_names)}; "
                f"expected {self.expects}"
            )
        metadata = table.schema.metadata or {}
        for key, value in _SAID.items():
            if metadata.get(key, value) != value:
                raise RecordingError(
                    f"{path}: {key.decode()} of its metadata must be {value.decode()!r}, not "
                    f"{brief(metadata[key].decode(errors='replace'))}"
                )


def _name(path: Path) -> str:
    """Name of the sequence's folder; the file may be in its subfolder ``final``."""
    folder = path.parent
    if path.stem != "hand_tracking":
        return path.stem
    return (folder.parent.name if folder.name == "final" else folder.name) or path.stem


def _points(table: Any, side: Side, path: Path) -> Float[np.ndarray, "T 21 3"]:
    """Landmarks; NaN in the rows without the hand."""
    pa, name = arrow(), f"{side}_joints_3d"
    points = np.full((table.num_rows, _NUMBERS), np.nan)
    flat = _combined(table, name)
    there = flat.is_valid().to_numpy(zero_copy_only=False)
    while isinstance(flat, pa.ListArray | pa.LargeListArray | pa.FixedSizeListArray):
        flat = flat.flatten()  # drops rows of null
    if not pa.types.is_floating(flat.type) or len(flat) != there.sum() * _NUMBERS:
        raise RecordingError(
            f"{path}: the column {name!r} must have 21 x 3 numbers per row, not "
            f"{str(table.schema.field(name).type)[:80]}"
        )
    points[there] = flat.to_numpy(zero_copy_only=False).reshape(-1, _NUMBERS)
    present = _column(table, f"{side}_present", path)
    points[present == 0] = np.nan
    return points.reshape(-1, NUM_LANDMARKS, 3)


def _stamps(table: Any, path: Path, rate: float | None) -> Float[np.ndarray, " T"]:
    """Stamps of the file; if a frame has none, frame numbers divided by the rate."""
    times = table.column_names.count("timestamp_ns") and table.column("timestamp_ns")
    if times and table.num_rows and not times.null_count:
        stamps = _column(table, "timestamp_ns", path) * 1e-9
    else:
        number = _column(table, "frame_idx", path)
        even = stamps_from_rate(table.num_rows, rate, str(path))
        stamps = even if rate is None else (number - number[:1]) / rate
    check_stamps(stamps, str(path))
    return stamps


def _column(table: Any, name: str, path: Path, *, nulls: bool = False) -> Float[np.ndarray, " T"]:
    """Reads a column with one number per row; NaN for null."""
    pa, values = arrow(), _combined(table, name)
    kind = values.type
    numeric = (pa.types.is_floating(kind), pa.types.is_integer(kind), pa.types.is_boolean(kind))
    if not any(numeric) and not (nulls and pa.types.is_null(kind)):
        raise RecordingError(
            f"{path}: the column {name!r} must have one number per row, not {str(kind)[:80]}"
        )
    if values.null_count and not nulls:
        raise RecordingError(f"{path}: the column {name!r} has {values.null_count} null values")
    return np.asarray(values.to_numpy(zero_copy_only=False), np.float64)


def _combined(table: Any, name: str) -> Any:
    pa, column = arrow(), table.column(name)
    return pa.concat_arrays(column.chunks) if column.num_chunks else pa.array([], column.type)


def _sources(table: Any) -> dict[str, Any]:
    """Models that detected the hands: ``hawor``, ``mint``, ``mixed``."""
    pa = arrow()
    if "source" not in table.column_names or not pa.types.is_string(table.column("source").type):
        return {}
    names = table.column("source").unique().to_pylist()[:16]
    return {"source": sorted(name[:64] for name in names if name is not None)}


EGOHANDKIT: Final = EgoHandKit()
