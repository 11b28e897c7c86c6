"""MediaPipe's hand landmarker: a picture in, hands out.

Its handedness label and its landmarks are those of the hand in the picture: right for a picture as
the camera takes it, and both those of the *other* hand for a mirrored one, as selfie views are.
Swapping the labels alone would leave the landmarks a mirror image, so a mirrored picture must be
turned back before it gets here. (Older descriptions say that the label assumes a mirrored picture.
That was so in another interface; 0.10.21 and 1.2.2 were tried on photographs of a right hand.)
"""

from __future__ import annotations

import contextlib
import hashlib
import http.client
import os
import sys
import tempfile
import threading
import urllib.error
import urllib.request
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Final, TypeAlias

import numpy as np
from jaxtyping import UInt8

from smooth_operator.atomic_files import atomic_write, output_error
from smooth_operator.errors import MissingExtraError, SourceError
from smooth_operator.result_cache.own_files import make_private
from smooth_operator.result_cache.user_cache import user_cache
from smooth_operator.teleop.sources.webcam.picture_tracker import SeenHand
from smooth_operator.types import as_side

_NOISE: Final = (b"W0000 ", b"I0000 ", b"INFO: ", b"WARNING: ")
_stderr = threading.Lock()


class HandLandmarker:
    """The landmarker for a stream of pictures; it follows hands from one to the next.

    To be used by one thread at a time.

    Args:
        model: the ``.task`` file.
        max_hands: how many hands are looked for, 1 or 2.
        confidence: how sure it must be that there is a hand, 0 to 1.

    Raises:
        MissingExtraError: MediaPipe is not installed.
        SourceError: the model can't be loaded.
    """

    def __init__(self, model: Path, *, max_hands: int = 2, confidence: float = 0.5) -> None:
        with _without_noise():
            self._mediapipe, vision, base_options = _mediapipe()
            options = vision.HandLandmarkerOptions(
                # As bytes: on Windows its own loader fails on paths that are not plain ASCII.
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
                raise SourceError(
                    f"MediaPipe can't load {model}: {error}. Leave model= out to have the right "
                    "file fetched"
                ) from error
            self._last_ms = -1
            self.find(np.zeros((64, 64, 3), np.uint8), 0.0)  # the first is slow, and noisy

    def find(self, picture: UInt8[np.ndarray, "h w 3"], time: float) -> list[SeenHand]:
        """The hands of a picture.

        Args:
            picture: red, green, blue; not mirrored.
            time: time of the picture [s]; where it goes back, or stands, a millisecond is taken.

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
            _seen(label[0], world, flat, height / width)
            for label, world, flat in zip(
                result.handedness, result.hand_world_landmarks, result.hand_landmarks, strict=True
            )
        ]

    def close(self) -> None:
        """Give everything back; a second call does nothing."""
        try:
            self._landmarker.close()
        except RuntimeError:  # the interpreter ends, and MediaPipe's own thread has gone before
            self._landmarker._handle = None  # or it would try again, and complain


def _seen(label: Any, world: Any, flat: Any, aspect: float) -> SeenHand:
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
    """Around MediaPipe's start: what its native code always writes to standard error is left out.

    Everything else that is written meanwhile is passed on afterwards.
    """
    with _stderr:
        with contextlib.suppress(Exception):  # it may be closed, or None
            sys.stderr.flush()
        real = _duplicate(2)
        if real is None:  # there is no standard error
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


def _duplicate(descriptor: int) -> int | None:
    try:
        return os.dup(descriptor)
    except OSError:
        return None


SWITCH: Final = "SMOOTH_OPERATOR_HAND_MODEL"
"""Environment variable: path of the model file."""

MODEL_URL: Final = (
    "https://storage.googleapis.com/mediapipe-models/hand_landmarker/hand_landmarker/float16/1/"
    "hand_landmarker.task"
)
MODEL_SHA256: Final = "fbc2a30080c3c557093b5ddfc334698132eb341044ccee322ccf8bcf3607cde1"
"""Of version 1 as it is published there, 7,819,105 bytes."""

_LARGEST: Final = 64 * 2**20
_CHUNK: Final = 2**16
_NETWORK: Final = "hand_landmarks_detector.tflite"

Progress: TypeAlias = Callable[[int, int | None], None]
"""Called with the bytes that are here, and those that there are, if that is known."""


def model_cache() -> Path:
    """Where the fetched model is kept; it need not exist."""
    return user_cache() / "models" / "hand_landmarker.task"


def hand_model(
    file: Path | None = None,
    *,
    url: str = MODEL_URL,
    sha256: str = MODEL_SHA256,
    progress: Progress | None = None,
) -> Path:
    """The model file: the one that is given, the one of ``SWITCH``, or the published one.

    A file that is given need only be a hand landmarker; what is fetched must have the hash, and so
    must what lies in the cache, each time. A damaged one there is fetched again.

    Args:
        file: a path that the user named.
        url: where it is fetched from.
        sha256: of the published file.
        progress: called in a download; by default a line on standard error, if that is a terminal.

    Raises:
        SourceError: there is no such file, or it is no hand landmarker; it can't be fetched, or
            what came is not the published file.
        OutputError: it can't be kept.
    """
    named = file or Path(os.environ.get(SWITCH, "").strip())
    if str(named) not in ("", "."):
        return _checked(named.expanduser(), "model" if file else SWITCH)
    cached = model_cache()
    if _sha256_of(cached) != sha256:
        _fetch(url, sha256, cached, progress or _line)
    return cached


def _checked(path: Path, origin: str) -> Path:
    """A file that the user named."""
    if not path.is_file():
        raise SourceError(
            f"{origin}: there is no file {str(path)!r}; give the path of a hand_landmarker.task, "
            f"or leave it out to have it fetched from {MODEL_URL}"
        )
    try:
        with zipfile.ZipFile(path) as archive:
            present = _NETWORK in archive.namelist()
    except (zipfile.BadZipFile, OSError):
        present = False
    if not present:
        raise SourceError(
            f"{origin}: {path} is no MediaPipe hand landmarker, an archive that holds {_NETWORK}; "
            f"fetch it again from {MODEL_URL}"
        )
    return path


def _sha256_of(path: Path) -> str | None:
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError:
        return None


def _fetch(url: str, sha256: str, target: Path, progress: Progress) -> None:
    """Download a file whole, or leave nothing."""
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
                f"what came from {url} is not the published hand landmarker: SHA-256 "
                f"{digest.hexdigest()}, expected {sha256}. It was thrown away. A proxy may have "
                f"answered in its place; get the file another way and name it with model=PATH, or "
                f"in the environment variable {SWITCH}"
            )


def _unreachable(url: str, target: Path, cause: object) -> SourceError:
    reason = cause.reason if type(cause) is urllib.error.URLError else cause
    return SourceError(
        f"the hand-landmarker model can't be fetched ({reason}). Without a network, get {url} on "
        f"another machine and put it at {target}, or anywhere else and name it: model=PATH, or the "
        f"environment variable {SWITCH}"
    )


def _line(count: int, total: int | None) -> None:
    if not sys.stderr.isatty():
        return
    of = "" if total is None else f" of {total / 2**20:.1f}"
    end = "\n" if count == total else ""
    sys.stderr.write(f"\rfetching the hand-landmarker model: {count / 2**20:.1f}{of} MiB{end}")
    sys.stderr.flush()
