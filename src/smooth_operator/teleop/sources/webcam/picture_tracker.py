"""Tracks hands in the pictures of cameras and videos, with MediaPipe."""

from __future__ import annotations

import contextlib
import hashlib
import http.client
import math
import os
import sys
import tempfile
import threading
import urllib.error
import urllib.request
import zipfile
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Literal, TypeAlias

import numpy as np
from jaxtyping import Bool, Float, UInt8

from smooth_operator.atomic_files import atomic_write, output_error
from smooth_operator.errors import ConfigError, MissingExtraError, SourceError
from smooth_operator.landmarks import BASES, WRIST
from smooth_operator.own_files import make_private
from smooth_operator.poses import axes, points_to_ours, wrist_from_landmarks
from smooth_operator.settings import check_range
from smooth_operator.teleop.sources.webcam.camera import SYSTEM_LIBRARIES, opencv
from smooth_operator.types import HandFrame, Side, as_side
from smooth_operator.user_folders import user_cache

Points: TypeAlias = Literal["world", "picture"]

WORLD: Final = "camera"
"""Name of the world frame: the camera's place, x in the direction of view, z up in the picture."""
AXES: Final = axes("z", "-x", "-y")
"""Our axes in those of the camera: x right in the picture, y down, z in the direction of view."""


@dataclass(frozen=True, kw_only=True)
class PictureConfig:
    """Settings for tracking hands in pictures.

    Attributes:
        mirrored: True for mirrored pictures, such as selfie views; the tracker mirrors them back.
        max_hands: largest number of hands, 1 or 2.
        confidence: smallest confidence at which the tracker reports a hand, 0 to 1.
        points: ``world`` for the tracker's own positions in metres; ``picture`` for its positions
            in the picture, scaled to the same size.
        model: the hand-landmarker file; None for the published one, which is downloaded once.
        fov: horizontal field of view of the camera [degrees], with which the size of the palm in
            the picture gives the place of the wrist; None for no wrist.
    """

    mirrored: bool = False
    max_hands: int = 2
    confidence: float = 0.5
    points: Points = "world"
    model: Path | None = None
    fov: float | None = None

    def __post_init__(self) -> None:
        if self.max_hands not in (1, 2):
            raise ConfigError(f"max_hands must be 1 or 2, not {self.max_hands}")
        if not 0.0 < self.confidence < 1.0:
            raise ConfigError(f"confidence must be between 0 and 1, not {self.confidence}")
        if self.points not in ("world", "picture"):
            raise ConfigError(f"points must be world or picture, not {self.points!r}")
        if self.fov is not None:
            check_range("fov", self.fov, 20.0, 150.0, "degrees")


class PictureTracker:
    """Finds the hands in successive pictures.

    Raises:
        MissingExtraError: MediaPipe is not installed.
        SourceError: the model can't be downloaded or loaded.
    """

    def __init__(self, config: PictureConfig) -> None:
        self._config = config
        self._cv2 = opencv()
        self._landmarker = HandLandmarker(
            hand_model(config.model), max_hands=config.max_hands, confidence=config.confidence
        )
        self._tracks: Mapping[Side, Track] = {}

    def frames(self, pixels: UInt8[np.ndarray, "h w 3"], time: float) -> list[HandFrame]:
        """Finds the hands in a picture, at most one of each side; ``time`` [s] becomes their
        timestamp. SourceError if MediaPipe failed."""
        height, width = pixels.shape[:2]
        return [
            self._frame(side, hand, time, height / width)
            for side, hand in self.hands(pixels, time).items()
        ]

    def hands(self, pixels: UInt8[np.ndarray, "h w 3"], time: float) -> dict[Side, SeenHand]:
        """Finds the hands as ``frames`` does, with their positions in the picture."""
        colours = self._cv2.cvtColor(pixels, self._cv2.COLOR_BGR2RGB)
        turned = self._cv2.flip(colours, 1) if self._config.mirrored else colours
        detections = self._landmarker.find(turned, time)
        hands, self._tracks = assign_sides(detections, self._tracks, time)
        return hands

    def close(self) -> None:
        """Closes the model; a second call does nothing."""
        self._landmarker.close()

    def _frame(self, side: Side, hand: SeenHand, time: float, aspect: float) -> HandFrame:
        points = landmarks_of(hand, self._config.points)
        if self._config.fov is None:
            return HandFrame(points, time, side, valid=hand.inside)
        place, turn = self._seen_from(hand, self._config.fov, aspect)
        points = points_to_ours((points - points[WRIST]) @ turn.T, AXES)
        pose = wrist_from_landmarks(points, side)
        pose[:3] = points_to_ours(place, AXES)
        return HandFrame(points, time, side, valid=hand.inside, T_world_wrist=pose, world=WORLD)

    def _seen_from(
        self, hand: SeenHand, fov: float, aspect: float
    ) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3 3"]]:
        """Place of the wrist [m] (NaN if the palm is not all in the picture) and rotation of
        ``hand.world``, in the camera's axes.

        The palm, which is rigid, gets the size of an average hand, so the place is exact up to one
        factor. The tracker's own size of it varies by a tenth.
        """
        palm = hand.world[[*_PALM]] - hand.world[WRIST]
        size = float(np.linalg.norm(palm[2]) + np.linalg.norm(palm[1] - palm[4]))
        if size < _TINY or not hand.inside[[*_PALM]].all():
            return np.full(3, np.nan), np.eye(3)
        focal = 0.5 / math.tan(math.radians(fov) / 2)  # over the width of the picture
        lens = np.array([[focal, 0.0, 0.5], [0.0, focal, 0.5 * aspect], [0.0, 0.0, 1.0]])
        pixels = np.ascontiguousarray(hand.picture[[*_PALM], :2])
        away = focal * size / max(float(np.ptp(pixels, axis=0).max()), _TINY)
        begin = np.array([[0.0], [0.0], [away]])
        found, turn, place = self._cv2.solvePnP(
            palm * (_PALM_M / size), pixels, lens, None, np.zeros((3, 1)), begin, True
        )
        if not found or place[2, 0] <= 0.0:
            return np.full(3, np.nan), np.eye(3)
        return place[:, 0], self._cv2.Rodrigues(turn)[0]


def landmarks_of(hand: SeenHand, points: Points) -> Float[np.ndarray, "21 3"]:
    """Landmarks relative to the hand's centre [m]: x right in the picture, y down, z away from the
    camera.

    Args:
        points: see ``PictureConfig``. With ``picture``, fingertips are more precise, but depth is
            compressed, so the lengths of bones vary more.
    """
    if points == "world":
        return hand.world
    centred = hand.picture - hand.picture.mean(axis=0)
    size = np.linalg.norm(hand.world - hand.world.mean(axis=0))
    scaled: np.ndarray = centred * (size / max(float(np.linalg.norm(centred)), 1e-9))
    return scaled


MEMORY_S: Final = 0.3
"""Time for which the tracker remembers the place of a hand [s]."""
REACH: Final = 1.5
"""Distance that a hand may move within ``MEMORY_S``, in lengths of its palm."""
PATIENCE: Final = 8
"""Number of successive pictures with a contradicting side label after which it is accepted."""
SAME: Final = 0.5
"""Distance below which two detections count as the same hand, in lengths of the palm."""

_PALM: Final = (WRIST, *BASES[1:])
_PALM_M: Final = 0.157
"""Distance from wrist to middle MCP, and from index MCP to pinky MCP, of MediaPipe's hand [m]."""
_TINY: Final = 1e-6


@dataclass(frozen=True, eq=False)
class SeenHand:
    """A hand that was detected in a picture.

    Attributes:
        label: side according to the tracker.
        score: confidence in the side, 0 to 1.
        world: (21, 3) positions relative to the hand's centre [m]: x right in the picture, y down,
            z away from the camera.
        picture: (21, 3) positions in the picture, all as fractions of its width; z is relative to
            the wrist.
        inside: (21,) True for a landmark within the picture.
    """

    label: Side
    score: float
    world: Float[np.ndarray, "21 3"]
    picture: Float[np.ndarray, "21 3"]
    inside: Bool[np.ndarray, "21"]

    @property
    def centre(self) -> Float[np.ndarray, "2"]:
        """Centre of the palm in the picture."""
        middle: np.ndarray = self.picture[list(_PALM), :2].mean(axis=0)
        return middle

    @property
    def size(self) -> float:
        """Length of the palm in the picture; depth counts too, in case the palm is seen edge-on."""
        return float(np.linalg.norm(self.picture[BASES[2]] - self.picture[WRIST]))


@dataclass(frozen=True, eq=False)
class Track:
    """Last known position of a hand in a sequence of pictures.

    Attributes:
        centre: (2,) centre of the palm in the picture.
        time: time of the picture [s].
        doubts: number of successive pictures with a contradicting side label.
    """

    centre: Float[np.ndarray, "2"]
    time: float
    doubts: int = 0


def assign_sides(
    detections: Iterable[SeenHand], tracks: Mapping[Side, Track], time: float
) -> tuple[dict[Side, SeenHand], dict[Side, Track]]:
    """Decides the side of each hand in a picture.

    Args:
        tracks: last known position of each hand; empty at the start.
        time: time of the picture [s]; if it goes back, the tracks are discarded.

    Returns:
        side -> hand, at most one per side; and the new tracks.
    """
    recent = {s: t for s, t in tracks.items() if 0.0 <= time - t.time <= MEMORY_S}
    distinct: list[SeenHand] = []
    for hand in sorted(detections, key=lambda h: -h.score):
        if all(_distance(hand, other.centre) > SAME for other in distinct):
            distinct.append(hand)
    chosen: dict[Side, tuple[SeenHand, Track]] = {}
    for hand in distinct:
        side, doubts = _side_of(hand, recent)
        track = Track(hand.centre, time, doubts)
        rival = chosen.get(side)
        if rival is None or _rank(hand, side, recent) > _rank(rival[0], side, recent):
            chosen[side] = hand, track
    hands = {side: hand for side, (hand, _) in chosen.items()}
    return hands, recent | {side: track for side, (_, track) in chosen.items()}


def _side_of(hand: SeenHand, recent: Mapping[Side, Track]) -> tuple[Side, int]:
    """Side of a hand, and number of successive pictures with a contradicting side label."""
    other: Side = "left" if hand.label == "right" else "right"
    was = recent.get(other)
    own = recent.get(hand.label)
    if was is None or _distance(hand, was.centre) > REACH:
        return hand.label, 0
    if own is not None and _distance(hand, own.centre) <= REACH:  # both were near: hands cross
        return hand.label, 0
    # The other hand was here, so the label is wrong, unless it repeats.
    if was.doubts + 1 >= PATIENCE:
        return hand.label, 0
    return other, was.doubts + 1


def _rank(hand: SeenHand, side: Side, recent: Mapping[Side, Track]) -> tuple[bool, float]:
    """Sort key of a hand for a side: known hands first, then by confidence."""
    was = recent.get(side)
    return was is not None and _distance(hand, was.centre) <= REACH, hand.score


def _distance(hand: SeenHand, centre: Float[np.ndarray, "2"]) -> float:
    """Distance of a hand from a point, in lengths of its palm."""
    return float(np.linalg.norm(hand.centre - centre)) / max(hand.size, 1e-6)


_NOISE: Final = (b"W0000 ", b"I0000 ", b"INFO: ", b"WARNING: ")
_stderr = threading.Lock()


class HandLandmarker:
    """MediaPipe's hand landmarker for a stream of pictures. One thread at a time may use it.

    Args:
        model: the ``.task`` file.
        max_hands: largest number of hands, 1 or 2.
        confidence: smallest confidence in a hand, 0 to 1.

    Raises:
        MissingExtraError: MediaPipe is not installed.
        SourceError: the model can't be loaded.
    """

    def __init__(self, model: Path, *, max_hands: int = 2, confidence: float = 0.5) -> None:
        with _without_noise():
            self._mediapipe, vision, base_options = _mediapipe()
            options = vision.HandLandmarkerOptions(
                # As bytes, since on Windows its own loader fails for paths that are not ASCII.
                base_options=base_options(model_asset_buffer=model.read_bytes()),
                running_mode=vision.RunningMode.VIDEO,
                num_hands=max_hands,
                min_hand_detection_confidence=confidence,
                min_hand_presence_confidence=confidence,
                min_tracking_confidence=confidence,
            )
            try:
                self._landmarker = vision.HandLandmarker.create_from_options(options)
            except (RuntimeError, ValueError, OSError) as error:
                if "shared object" in str(error):
                    raise SourceError(
                        f"MediaPipe can't be loaded: {error}. {SYSTEM_LIBRARIES}"
                    ) from error
                raise SourceError(
                    f"MediaPipe can't load {model}: {error}. Remove model= to download the "
                    "correct file"
                ) from error
            self._last_ms = -1
            self.find(np.zeros((64, 64, 3), np.uint8), 0.0)  # the first call is slow and prints

    def find(self, picture: UInt8[np.ndarray, "h w 3"], time: float) -> list[SeenHand]:
        """Finds the hands in a picture.

        Args:
            picture: red, green, blue; not mirrored.
            time: time of the picture [s]; if it does not increase, a millisecond is added.

        Raises:
            SourceError: MediaPipe failed.
        """
        height, width = picture.shape[:2]
        image = self._mediapipe.Image(
            image_format=self._mediapipe.ImageFormat.SRGB, data=np.ascontiguousarray(picture)
        )
        self._last_ms = max(self._last_ms + 1, round(time * 1e3))
        try:
            result = self._landmarker.detect_for_video(image, self._last_ms)
        except (RuntimeError, ValueError) as error:
            raise SourceError(f"MediaPipe failed on a picture: {error}") from error
        return [
            _seen_hand(label[0], world, flat, height / width)
            for label, world, flat in zip(
                result.handedness, result.hand_world_landmarks, result.hand_landmarks, strict=True
            )
        ]

    def close(self) -> None:
        """Closes the model; a second call does nothing."""
        try:
            self._landmarker.close()
        except RuntimeError:  # MediaPipe's own thread has ended with the interpreter
            self._landmarker._handle = None  # or it would try again, and print an error


def _seen_hand(label: Any, world: Any, flat: Any, aspect: float) -> SeenHand:
    at = np.array([(p.x, p.y, p.z) for p in flat])  # shares of the width, height and width
    inside = np.asarray(((at[:, :2] >= 0.0) & (at[:, :2] <= 1.0)).all(axis=1))
    return SeenHand(
        label=as_side(label.category_name),
        score=float(label.score),
        world=np.array([(p.x, p.y, p.z) for p in world]),
        picture=at * (1.0, aspect, 1.0),
        inside=inside,
    )


def _mediapipe() -> tuple[Any, Any, Any]:
    try:
        import mediapipe
        from mediapipe.tasks.python import BaseOptions, vision
    except ImportError as error:
        raise MissingExtraError("tracking a hand in pictures", "webcam") from error
    return mediapipe, vision, BaseOptions


@contextlib.contextmanager
def _without_noise() -> Iterator[None]:
    """Suppresses the messages of MediaPipe's native code on standard error inside the block.

    Other output on standard error is written after the block.
    """
    with _stderr:
        with contextlib.suppress(Exception):  # it may be closed, or None
            sys.stderr.flush()
        try:
            real = os.dup(2)
        except OSError:  # there is no standard error
            yield
            return
        with tempfile.TemporaryFile() as aside:
            os.dup2(aside.fileno(), 2)
            try:
                yield
            finally:
                with contextlib.suppress(Exception):
                    sys.stderr.flush()
                os.dup2(real, 2)
                aside.seek(0)
                for line in aside:
                    if not line.startswith(_NOISE):
                        os.write(2, line)
                os.close(real)


SWITCH: Final = "SMOOTH_OPERATOR_HAND_MODEL"
"""Environment variable with the path of the model file."""

MODEL_URL: Final = (
    "https://storage.googleapis.com/mediapipe-models/hand_landmarker/hand_landmarker/float16/1/"
    "hand_landmarker.task"
)
MODEL_SHA256: Final = "fbc2a30080c3c557093b5ddfc334698132eb341044ccee322ccf8bcf3607cde1"
"""SHA-256 of the published version 1, 7,819,105 bytes."""

_LARGEST: Final = 64 * 2**20
_CHUNK: Final = 2**16
_NETWORK: Final = "hand_landmarks_detector.tflite"

Progress: TypeAlias = Callable[[int, int | None], None]
"""Function that is called with the number of bytes downloaded, and the total if known."""


def model_cache() -> Path:
    """Path of the downloaded model, which may not exist yet."""
    return user_cache() / "models" / "hand_landmarker.task"


def hand_model(
    file: Path | None = None,
    *,
    url: str = MODEL_URL,
    sha256: str = MODEL_SHA256,
    progress: Progress | None = None,
) -> Path:
    """Path of the model: the user's file, the file that ``SWITCH`` names, or the published file.

    A damaged file in the cache is downloaded again.

    Args:
        file: path of the user's file.
        url: address of the published file.
        sha256: hash of the published file.
        progress: called during a download; None writes a line to standard error if it is a
            terminal.

    Raises:
        SourceError: there is no such file, it is not a hand landmarker, it can't be downloaded, or
            the download is not the published file.
        OutputError: the download can't be stored.
    """
    named = file or Path(os.environ.get(SWITCH, "").strip())
    if str(named) not in ("", "."):
        return _checked(named.expanduser(), "model" if file else SWITCH)
    cached = model_cache()
    if _sha256_of(cached) != sha256:
        _fetch(url, sha256, cached, progress or _line)
    return cached


def _checked(path: Path, origin: str) -> Path:
    """Checks that the user's file is a hand landmarker, and returns its path."""
    if not path.is_file():
        raise SourceError(
            f"{origin}: there is no file {str(path)!r}; set the path of a hand_landmarker.task "
            f"file, or leave out the path to download the file from {MODEL_URL}"
        )
    try:
        with zipfile.ZipFile(path) as archive:
            present = _NETWORK in archive.namelist()
    except (zipfile.BadZipFile, OSError):
        present = False
    if not present:
        raise SourceError(
            f"{origin}: {path} is not a MediaPipe hand landmarker, an archive that contains "
            f"{_NETWORK}; download it again from {MODEL_URL}"
        )
    return path


def _sha256_of(path: Path) -> str | None:
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError:
        return None


def _fetch(url: str, sha256: str, target: Path, progress: Progress) -> None:
    """Downloads a file atomically."""
    try:
        make_private(target.parent)
    except OSError as error:
        raise output_error(target, error) from error
    try:
        response = urllib.request.urlopen(url, timeout=20)
    except (urllib.error.URLError, OSError, http.client.HTTPException) as error:
        raise _unreachable(url, target, error) from error
    with response, atomic_write(target) as file:
        length = response.headers.get("Content-Length", "")
        total = int(length) if length.isdigit() else None
        digest, count = hashlib.sha256(), 0
        while count <= _LARGEST:
            try:
                chunk = response.read(_CHUNK)
            except (OSError, http.client.HTTPException) as error:
                raise _unreachable(url, target, error) from error
            if not chunk:
                break
            file.write(chunk)
            digest.update(chunk)
            count += len(chunk)
            progress(count, total)
        if total is not None and count < total:
            cause = f"the connection ended after {count} of {total} bytes"
            raise _unreachable(url, target, cause)
        if digest.hexdigest() != sha256:
            raise SourceError(
                f"the download from {url} is not the published hand landmarker: SHA-256 "
                f"{digest.hexdigest()}, expected {sha256}. The download was deleted. A proxy may "
                "have answered instead of the server; get the file in another way and set its "
                f"path with model=PATH, or in the environment variable {SWITCH}"
            )


def _unreachable(url: str, target: Path, cause: object) -> SourceError:
    reason = cause.reason if type(cause) is urllib.error.URLError else cause
    return SourceError(
        f"the hand-landmarker model can't be downloaded ({reason}). Without a network connection, "
        f"download {url} on another machine and copy it to {target}, or set its path with "
        f"model=PATH or the environment variable {SWITCH}"
    )


def _line(count: int, total: int | None) -> None:
    if not sys.stderr.isatty():
        return
    of = "" if total is None else f" of {total / 2**20:.1f}"
    end = "\n" if count == total else ""
    sys.stderr.write(f"\rdownloading the hand-landmarker model: {count / 2**20:.1f}{of} MiB{end}")
    sys.stderr.flush()
