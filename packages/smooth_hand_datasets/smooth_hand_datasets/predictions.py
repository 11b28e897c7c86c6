"""Reader of hands that HaMeR, WiLoR, WiLoR-mini and related tools detect in a video.

The models do not define a file format. These forms are in use, as JSON, JSON lines, pickle or
``.npz``:

- a list of frames, each a list of hands, each a table: ``is_right``, and in ``wilor_preds``, or in
  the table itself, ``pred_keypoints_3d`` (21, 3) from the wrist and ``pred_cam_t_full`` (3,), as
  ``predict`` of WiLoR-mini returns it. Also a table from the frame's number, or the name of its
  picture, to a list of hands;
- lines with ``left_pos`` and ``right_pos``, (21, 3) in the camera's frame or null, and perhaps
  ``frame_index``: ``hamer_hands.json`` and ``wilor_hands.json`` of EgoTouch;
- a table of ``left`` and ``right``, each with ``frame_ids`` and ``joints_cam`` (n, 21, 3): the
  operator of HaWoR in Data-Juicer;
- a table of ``j3d.right`` and ``j3d.left`` (T, 21, 3) in the camera's frame: forks of HaMeR;
- an ``.npz`` of ``pred_keypoints_3d`` (n, 21, 3), ``is_right`` (n,), ``frame`` (n,) and perhaps
  ``pred_cam_t_full`` (n, 3).

Points are in OpenPose's order, which is the project's. The models assume a focal length, so the
wrist's path in the camera's frame is correct up to a scale along the view.

Source: ``wilor_hand_pose3d_estimation_pipeline.py`` of warmshao/WiLoR-mini;
``video_hand_reconstruction_hawor_mapper.py`` of Data-Juicer; scripts of TouchAnything (EgoTouch).
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np
from jaxtyping import Float

from smooth_hand_datasets.scene import wrist_of_points
from smooth_hand_datasets.unpickle import array, load_restricted, numbers
from smooth_operator.errors import DocumentError, RecordingError, brief
from smooth_operator.formats.arrays import Allowance, npz_arrays
from smooth_operator.formats.both_hands import checked_hands, first_video
from smooth_operator.formats.checks import stamps_from_rate
from smooth_operator.formats.clip import CAMERA, SIDES, Clip, ClipRef, ReadingOptions
from smooth_operator.formats.hand_arrays import shares
from smooth_operator.io import documents
from smooth_operator.io.plain_files import read_text
from smooth_operator.landmarks import NUM_LANDMARKS
from smooth_operator.types import HandRecording, Side, as_side

_WORDS: Final = (
    *("wilor_preds", "pred_keypoints_3d", "joints_cam"),
    *("j3d.right", "j3d.left", "right_pos", "left_pos"),
)
"""Words of which each file has at least one near its start."""
_HEAD_BYTES: Final = 1 << 18
_MOST_JSON: Final = 64_000_000
_MOST_FRAMES: Final = 1_000_000
_PICKLES: Final = (".pkl", ".pickle", ".npy")
_TEXTS: Final = (".json", ".jsonl")
_NUMBER: Final = re.compile(r"(\d{1,9})(?=\D*$)")
_FRAME: Final = ("frame", "frame_idx", "frame_index", "frame_id")
_POINTS: Final = ("pred_keypoints_3d", "keypoints_3d", "joints_3d")
_PLACE: Final = ("pred_cam_t_full", "cam_t_full")
_CONFIDENCE: Final = ("confidence", "score", "conf")
_FRAME_BYTES: Final = 4 * 8 * 3 * NUM_LANDMARKS
"""Memory that a frame of the clip takes [bytes]: landmarks of both hands, as detected and
placed."""


@dataclass
class _Hand:
    """Detections of the hand of one side: frame -> values."""

    points: dict[int, Float[np.ndarray, "21 3"]] = field(default_factory=dict)
    place: dict[int, Float[np.ndarray, "3"]] = field(default_factory=dict)
    confidence: dict[int, float] = field(default_factory=dict)


class _Detections:
    def __init__(self, path: Path) -> None:
        self.path = path
        self.hands: dict[Side, _Hand] = {side: _Hand() for side in SIDES}
        self.frames = 0
        self.spare = 0

    def frame(self, number: Any, default: int) -> int:
        """Counts a frame and returns its number."""
        index = default
        if isinstance(number, str):
            match = _NUMBER.search(number)
            index = default if match is None else int(match[1])
        elif isinstance(number, int | float) and not isinstance(number, bool):
            index = int(number) if abs(number) < 1e12 and number == int(number) else -1
        if not 0 <= index < _MOST_FRAMES:
            raise RecordingError(
                f"{self.path}: a frame's number must be 0 to {_MOST_FRAMES - 1}, not "
                f"{brief(number)}"
            )
        self.frames = max(self.frames, index + 1)
        return index

    def add(
        self,
        frame: int,
        side: Side,
        points: np.ndarray,
        place: np.ndarray | None = None,
        confidence: float = np.nan,
    ) -> None:
        """Adds a detected hand. If a frame has two hands of one side, keeps the more confident
        one."""
        hand = self.hands[side]
        if frame in hand.points:
            self.spare += 1
            if not confidence > hand.confidence[frame]:
                return
        hand.points[frame] = points
        hand.place[frame] = np.full(3, np.nan) if place is None else place
        hand.confidence[frame] = confidence

    def numbers(self, value: Any, shape: tuple[int | None, ...], what: str) -> np.ndarray:
        """Reads numbers of a given shape; drops additional leading axes of length one."""
        return array(value, f"{self.path}, {what}", shape, batch=True)


class Predictions:
    """Reader of detections; each file is one clip."""

    what = "landmarks that HaMeR, WiLoR or HaWoR detect in a video"
    expects = (
        "frames with lists of hands, each with is_right and pred_keypoints_3d (21 x 3) [m]; or "
        "lines of left_pos and right_pos; or left and right with frame_ids and joints_cam; or "
        "j3d.right and j3d.left"
    )

    def matches(self, path: Path) -> bool:
        """True if the start of a file has a name that only these files have."""
        suffix = path.suffix.lower()
        if suffix == ".npz":
            return {"pred_keypoints_3d", "is_right"} <= npz_arrays(path).keys()
        if suffix not in (*_PICKLES, *_TEXTS) or not path.is_file():
            return False
        with path.open("rb") as stream:
            head = stream.read(_HEAD_BYTES)
        return any(word.encode() in head for word in _WORDS)

    def clips(self, path: Path) -> Iterator[ClipRef]:
        """Yields the file as one clip."""
        yield ClipRef(path.stem, path, layout="predictions", size=path.stat().st_size)

    def read(self, ref: ClipRef, options: ReadingOptions) -> Clip:
        """Read the hands in the camera's frame; frames without a hand are NaN.

        Raises:
            RecordingError: the file has another form or is damaged, there is no rate, or the shape
                of a hand is that of the other side.
        """
        path, detected = ref.path, _Detections(ref.path)
        _collect(detected, _load(path), self.expects)
        allowance = Allowance.of(path, path.stat().st_size)
        allowance.take("frames", detected.frames * _FRAME_BYTES)  # numbers may be far apart
        stamps = stamps_from_rate(detected.frames, options.rate, str(path))
        hands, confidence = {}, {}
        for side, hand in detected.hands.items():
            hands[side] = _recording(hand, side, stamps, path)
            shared = _rows(hand.confidence, detected.frames, ())
            confidence[side] = shares(shared, f"{path}, {side} hand")
        checked = checked_hands(hands, str(path), self.expects, each_frame=True)
        video = first_video(path.with_suffix(".mp4"), path.with_name("chest.mp4"))
        return Clip(
            ref.name,
            checked,
            "predictions",
            (path,) if video is None else (path, video),
            confidence={s: confidence[s] for s in checked if np.isfinite(confidence[s]).any()},
            video=video,
            meta={"more_hands": detected.spare} if detected.spare else {},
        )


def _recording(hand: _Hand, side: Side, stamps: np.ndarray, path: Path) -> HandRecording:
    points = _rows(hand.points, len(stamps), (NUM_LANDMARKS, 3))
    placed = points + _rows(hand.place, len(stamps), (3,))[:, None]
    known = bool(np.isfinite(placed).any())
    points = placed if known else points
    return HandRecording(
        points,
        stamps,
        side,
        valid=np.isfinite(points).all(axis=-1),
        name=path.stem,
        meta={"format": "predictions"},
        T_world_wrist=wrist_of_points(points, side) if known else None,
        world=CAMERA if known else None,
    )


def _rows(values: Mapping[int, Any], count: int, shape: tuple[int, ...]) -> np.ndarray:
    rows = np.full((count, *shape), np.nan)
    for frame, value in values.items():
        rows[frame] = value
    return rows


def _load(path: Path) -> Any:
    if path.suffix.lower() not in _TEXTS:
        return load_restricted(path, names=(_POINTS[0], _PLACE[0], "is_right", *_FRAME))
    try:
        text = read_text(path, most_bytes=_MOST_JSON)
        lines = [line for line in text.splitlines() if line.strip()]
        if len(lines) > 1 and lines[0].lstrip().startswith("{") and _is_json(lines[0]):
            return [documents.parse_json(line) for line in lines]
        return documents.parse_json(text, most_bytes=_MOST_JSON)
    except (OSError, DocumentError) as error:
        raise RecordingError(f"{path}: can't be read as JSON: {error}") from error


def _is_json(line: str) -> bool:
    try:
        documents.parse_json(line)
    except DocumentError:
        return False
    return True


def _collect(detected: _Detections, value: Any, expects: str) -> None:
    """Adds the hands of a file's content to those detected, whatever its form."""
    if isinstance(value, dict):
        if _POINTS[0] in value and isinstance(value.get("is_right"), np.ndarray | list):
            return _of_columns(detected, value)
        if any(key in value for key in ("j3d.right", "j3d.left")):
            return _of_arrays(detected, {side: value.get(f"j3d.{side}") for side in SIDES})
        tables = {side: value.get(side) for side in SIDES}
        if any(isinstance(one, dict) and "joints_cam" in one for one in tables.values()):
            return _of_sides(detected, tables)
        frames = value.get("frames", value)
        if isinstance(frames, dict):
            return _of_frames(detected, frames.items())
        value = frames
    if isinstance(value, list | tuple):
        return _of_frames(detected, ((None, frame) for frame in value))
    raise RecordingError(
        f"{detected.path}: it contains a {type(value).__name__}; expected {expects}"
    )


def _is_present(value: Any) -> bool:
    """False for None and an empty list, which stand for no hand."""
    return value is not None and not (isinstance(value, list | tuple) and not value)


def _of_frames(detected: _Detections, frames: Iterable[tuple[Any, Any]]) -> None:
    for position, (name, frame) in enumerate(frames):
        if frame is None or isinstance(frame, list | tuple):
            number = detected.frame(name, position)
            hands = frame or ()
        elif isinstance(frame, dict):
            frame_name = next((frame[key] for key in _FRAME if key in frame), name)
            number = detected.frame(frame_name, position)
            if "left_pos" in frame or "right_pos" in frame:
                for side in SIDES:
                    if _is_present(frame.get(f"{side}_pos")):
                        points = detected.numbers(frame[f"{side}_pos"], (21, 3), f"{side}_pos")
                        detected.add(number, side, points, np.zeros(3))
                continue
            hands = next((frame[k] for k in ("hands", "detections") if k in frame), [frame])
            sides = [side for side in SIDES if isinstance(frame.get(side), dict)]
            if sides:
                hands = [{**frame[side], "side": side} for side in sides]
        else:
            raise RecordingError(
                f"{detected.path}: frame {position} must be a list of hands, not {brief(frame)}"
            )
        for hand in hands if isinstance(hands, list | tuple) else ():
            _of_hand(detected, number, hand)


def _of_hand(detected: _Detections, frame: int, hand: Any) -> None:
    if not isinstance(hand, dict):
        raise RecordingError(
            f"{detected.path}: a hand of frame {frame} must be a table, not {brief(hand)}"
        )
    inner = hand.get("wilor_preds", hand)
    if not isinstance(inner, dict):
        return  # WiLoR-mini found a hand without landmarks
    key = next((key for key in (*_POINTS, "joints_cam") if _is_present(inner.get(key))), None)
    if key is None:
        return
    points = detected.numbers(inner[key], (21, 3), key)
    place = next((inner[key] for key in _PLACE if key in inner), None)
    if place is not None:
        place = detected.numbers(place, (3,), _PLACE[0])
    if key == "joints_cam":  # they are in the camera's frame
        place = np.zeros(3)
    detected.add(frame, _side(detected, hand, inner), points, place, _confidence(hand))


def _side(detected: _Detections, *tables: dict[Any, Any]) -> Side:
    for table in tables:
        for key in ("is_right", "right"):
            if key in table:
                value = detected.numbers(table[key], (), key)
                if value not in (0.0, 1.0):
                    raise RecordingError(f"{detected.path}: {key} must be 0 or 1, not {value}")
                return "right" if value else "left"
        for key in ("handedness", "side", "hand_side"):
            if isinstance(table.get(key), str):
                try:
                    return as_side(table[key])
                except ValueError as error:
                    raise RecordingError(f"{detected.path}: {error}") from error
    raise RecordingError(f"{detected.path}: a hand lacks its side; expected is_right, 0 or 1")


def _confidence(hand: dict[Any, Any]) -> float:
    """Confidence of a detection, which may follow the corners of its box; NaN if not given."""
    value = next((hand[key] for key in _CONFIDENCE if key in hand), hand.get("hand_bbox"))
    try:
        values = numbers(value).ravel()
    except RecordingError:
        return float("nan")
    return float(values[-1]) if len(values) in (1, 5) else float("nan")


def _of_columns(detected: _Detections, table: dict[str, Any]) -> None:
    right = detected.numbers(table["is_right"], (None,), "is_right")
    count = len(right)
    points = detected.numbers(table["pred_keypoints_3d"], (count, 21, 3), "pred_keypoints_3d")
    places = table.get(_PLACE[0])
    if places is not None:
        places = detected.numbers(places, (count, 3), _PLACE[0])
    key = next((key for key in _FRAME if key in table), None)
    if key is None:
        raise RecordingError(f"{detected.path}: it lacks 'frame', the number of each hand's frame")
    frames = detected.numbers(table[key], (count,), key)
    if not np.isin(right, (0.0, 1.0)).all():
        raise RecordingError(f"{detected.path}: is_right must be 0 or 1 for each hand")
    for i in range(count):
        number = detected.frame(float(frames[i]) if np.isfinite(frames[i]) else "?", -1)
        side: Side = "right" if right[i] else "left"
        detected.add(number, side, points[i], None if places is None else places[i])


def _of_arrays(detected: _Detections, arrays: Mapping[Side, Any]) -> None:
    for side, value in arrays.items():
        if value is None:
            continue
        points = detected.numbers(value, (None, 21, 3), f"j3d.{side}")
        detected.frame(max(len(points) - 1, 0), 0)
        for frame, hand in enumerate(points):
            if hand.any():  # zeros stand for no hand
                detected.add(frame, side, hand, np.zeros(3))


def _of_sides(detected: _Detections, tables: Mapping[Side, Any]) -> None:
    for side, table in tables.items():
        if not isinstance(table, dict) or not _is_present(table.get("joints_cam")):
            continue
        points = detected.numbers(table["joints_cam"], (None, 21, 3), f"{side}/joints_cam")
        ids = detected.numbers(table.get("frame_ids"), (len(points),), f"{side}/frame_ids")
        for number, hand in zip(ids.tolist(), points, strict=True):
            detected.add(detected.frame(number, -1), side, hand, np.zeros(3))


PREDICTIONS: Final = Predictions()
