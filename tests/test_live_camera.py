"""The camera's picture on the live page: what is sent, how often, and what is drawn on it."""

from __future__ import annotations

import base64
import json
import re
from typing import Any

import numpy as np
import pytest
from pictures import opencv_or_skip

from smooth_operator.landmarks import BONES
from smooth_operator.teleop.pages.live.camera import CameraFeed, camera
from smooth_operator.teleop.pages.palette import FINGER_COLORS, css
from smooth_operator.teleop.sources.webcam import picture_tracker
from smooth_operator.teleop.sources.webcam.hand_labels import SeenHand
from smooth_operator.teleop.sources.webcam.picture_tracker import PictureConfig, PictureTracker
from smooth_operator.teleop.sources.webcam.seen_picture import SeenPicture

cv2 = opencv_or_skip()


class Landmarker:
    """Stands in for MediaPipe: one right hand, at known places, where a picture is not black."""

    def __init__(self, *_: object, **__: object) -> None: ...

    def find(self, pixels: np.ndarray, time: float) -> list[SeenHand]:
        if pixels.max() < 30:
            return []
        at = np.linspace((0.2, 0.1, 0.0), (0.4, 0.3, 0.0), 21)
        world = np.random.default_rng(0).normal(scale=0.04, size=(21, 3))
        return [SeenHand("right", 0.9, world, at, np.ones(21, bool))]

    def close(self) -> None: ...


@pytest.fixture
def tracker(monkeypatch: pytest.MonkeyPatch) -> PictureTracker:
    monkeypatch.setattr(picture_tracker, "HandLandmarker", Landmarker)
    monkeypatch.setattr(picture_tracker, "hand_model", lambda given: given)
    return PictureTracker(PictureConfig(mirrored=True))


class Source:
    """A camera whose pictures a test chooses."""

    def __init__(self, tracker: PictureTracker) -> None:
        self.tracker = tracker

    def picture(self) -> SeenPicture | None:
        return self.tracker.seen


def decoded(seen: dict[str, Any]) -> np.ndarray:
    """(h, w, 3) red, green, blue."""
    data = np.frombuffer(base64.b64decode(seen["jpeg"]), np.uint8)
    return cv2.cvtColor(cv2.imdecode(data, cv2.IMREAD_COLOR), cv2.COLOR_BGR2RGB)


def picture(color: tuple[int, int, int], width: int = 640, height: int = 360) -> np.ndarray:
    return np.full((height, width, 3), color, np.uint8)


def test_a_picture_is_small_and_as_the_tracker_saw_it(tracker: PictureTracker) -> None:
    pixels = picture((40, 120, 200))  # blue, green, red
    pixels[:, :64] = 255  # at the left edge of a mirrored picture
    tracker.frames(pixels, 0.0)
    seen = CameraFeed(Source(tracker)).look(0, 5.0)  # type: ignore[arg-type]
    assert seen is not None
    seen = json.loads(json.dumps(seen))
    shown = decoded(seen)
    assert shown.shape == (180, 320, 3)
    np.testing.assert_allclose(shown[90, 20], (200, 120, 40), atol=8)
    assert (shown[90, -16] > 240).all()  # turned back
    assert seen["aspect"] == 0.5625
    np.testing.assert_allclose(seen["hands"]["right"][0], (0.2, 0.1))
    tracker.frames(picture((0, 0, 0), 160, 120), 0.1)
    small = CameraFeed(Source(tracker)).look(0, 5.0)  # type: ignore[arg-type]
    assert small is not None
    assert decoded(small).shape == (120, 160, 3)  # never made larger
    assert small["hands"] == {}


def test_pictures_come_at_most_ten_times_a_second_and_each_once(tracker: PictureTracker) -> None:
    feed = CameraFeed(Source(tracker))  # type: ignore[arg-type]
    assert feed.look(0, 0.0) is None  # before there is one
    known, sent = 0, []
    for k in range(90):  # a camera of 45 Hz and a page that asks at 30 Hz, for three seconds
        tracker.frames(picture((9, 99, 99)), k / 45)
        if k % 3 != 2:
            seen = feed.look(known, k / 45 + 1.0)
            assert seen is not None
            known = seen["number"]
            if "jpeg" in seen:
                sent.append(k / 45)
    assert 15 <= len(sent) <= 20
    assert np.diff(sent).min() >= 0.099
    for age in (0.5, 3.0):  # the same picture: not sent again, but older
        seen = feed.look(tracker.seen.number, 90 / 45 + 10 + age)  # type: ignore[union-attr]
        assert seen is not None
        assert "jpeg" not in seen
    assert seen["age_s"] == pytest.approx(2.5)


def test_a_source_without_a_camera_has_no_picture() -> None:
    assert CameraFeed(object()).look(0, 1.0) is None  # type: ignore[arg-type]


def test_the_skeleton_lies_on_the_hand_and_a_missing_hand_is_said(
    tracker: PictureTracker,
) -> None:
    feed = CameraFeed(Source(tracker))  # type: ignore[arg-type]
    tracker.frames(picture((9, 99, 99)), 0.0)
    seen = feed.look(0, 0.0)
    assert seen is not None
    drawn = camera(seen)
    assert 'data-hands="right"' in drawn
    assert "✓ right hand" in drawn
    lines = re.findall(r'<line x1="(\S+)" y1="(\S+)" x2="(\S+)" y2="(\S+)" stroke="(\S+)"', drawn)
    at = np.linspace((0.2, 0.1), (0.4, 0.3), 21)
    assert len(lines) == len(BONES)
    for (a, b), (*ends, _) in zip(BONES, lines, strict=True):
        np.testing.assert_allclose([float(end) for end in ends], [*at[a], *at[b]], atol=1e-4)
    assert lines[7][4] == css(FINGER_COLORS[1])  # the last bone of the index finger
    assert drawn.count("<circle") == 21
    tracker.frames(picture((0, 0, 0)), 0.5)
    seen = feed.look(1, 0.5)
    assert seen is not None
    drawn = camera(seen)
    assert "⚠ no hand in the picture" in drawn
    assert "<line" not in drawn
    assert "no new picture for 7 s" in camera({**seen, "age_s": 7.2})
