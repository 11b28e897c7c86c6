"""MediaPipe's hand landmarker: a picture in, hands out.

Its handedness label and its landmarks are those of the hand in the picture: right for a picture as
the camera takes it, and both those of the *other* hand for a mirrored one, as selfie views are.
Swapping the labels alone would leave the landmarks a mirror image, so a mirrored picture must be
turned back before it gets here. (Older descriptions say that the label assumes a mirrored picture.
That was so in another interface; 0.10.21 and 1.2.2 were tried on photographs of a right hand.)
"""

from __future__ import annotations

import contextlib
import os
import sys
import tempfile
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import numpy as np
from jaxtyping import UInt8

from smooth_operator.errors import MissingExtraError, SourceError
from smooth_operator.teleop.sources.webcam.hand_labels import SeenHand
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
            time: of the picture [s]; where it goes back, or stands, a millisecond is taken.

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
