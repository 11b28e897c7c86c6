"""Camera and video: what reaches the mailbox, what happens when the camera goes, real pictures."""

import dataclasses
import re
import sys
import time
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from live_time import Kept
from live_time import until as wait_for
from pictures import landmarker_or_skip, opencv_or_skip
from processes import python

from smooth_operator.cli import main
from smooth_operator.errors import ConfigError, MissingExtraError, RecordingError, SourceError
from smooth_operator.extras import install_command
from smooth_operator.formats.checks import PALM_RANGE_M
from smooth_operator.formats.readers import read_recording
from smooth_operator.geometry import umeyama
from smooth_operator.landmarks import TIPS
from smooth_operator.poses import (
    from_rotation_vectors,
    is_valid,
    rotate,
    separation,
    wrist_from_landmarks,
)
from smooth_operator.synthetic import SyntheticOperator
from smooth_operator.teleop.components import build_source
from smooth_operator.teleop.sources.live import Mailbox
from smooth_operator.teleop.sources.webcam import camera as camera_module
from smooth_operator.teleop.sources.webcam import picture_tracker
from smooth_operator.teleop.sources.webcam.camera import Camera
from smooth_operator.teleop.sources.webcam.picture_tracker import (
    AXES,
    MEMORY_S,
    PATIENCE,
    SWITCH,
    HandLandmarker,
    PictureConfig,
    PictureTracker,
    SeenHand,
    assign_sides,
    landmarks_of,
)
from smooth_operator.teleop.sources.webcam.webcam_source import Video, Webcam, track_video
from smooth_operator.types import Side

cv2 = opencv_or_skip()
PINCHES = {"index": 8, "middle": 12, "ring": 16, "little": 20}


class Fake:
    """Stands in for the landmarker: a right hand wherever a picture is not black."""

    pictures: list[np.ndarray]

    def __init__(self, *_: object, **__: object) -> None:
        Fake.pictures = []

    def find(self, picture: np.ndarray, time: float) -> list[SeenHand]:
        Fake.pictures.append(picture)
        if picture.max() < 30:
            return []
        points = np.random.default_rng(0).normal(scale=0.04, size=(21, 3))
        inside = np.ones(21, bool)
        inside[8] = False
        return [SeenHand("right", 0.9, points, points + 0.5, inside)]

    def close(self) -> None:
        pass


@pytest.fixture
def fake(monkeypatch) -> type[Fake]:
    monkeypatch.setattr(picture_tracker, "HandLandmarker", Fake)
    monkeypatch.setattr(picture_tracker, "hand_model", lambda given: given)
    return Fake


def write_video(path: Path, pictures: list[np.ndarray], rate: float = 30.0) -> Path:
    height, width = pictures[0].shape[:2]
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"mp4v"), rate, (width, height))
    assert writer.isOpened()
    for picture in pictures:
        writer.write(picture)
    writer.release()
    return path


def plain(level: int) -> np.ndarray:
    return np.full((64, 96, 3), level, np.uint8)


def test_a_landmark_outside_the_picture_is_not_valid(fake):
    (frame,) = PictureTracker(PictureConfig()).frames(plain(200), 1.5)
    assert np.flatnonzero(~frame.valid).tolist() == [8]
    assert (frame.stamp, frame.side) == (1.5, "right")


@pytest.mark.parametrize("mirrored", [False, True])
def test_a_mirrored_picture_is_turned_back_before_it_is_looked_at(fake, mirrored):
    picture = plain(0)
    picture[:, :10] = (200, 100, 50)  # blue, green, red at the left edge
    PictureTracker(PictureConfig(mirrored=mirrored)).frames(picture, 0.0)
    (looked_at,) = fake.pictures
    np.testing.assert_array_equal(looked_at[0, -1 if mirrored else 0], (50, 100, 200))
    np.testing.assert_array_equal(looked_at[0, 0 if mirrored else -1], (0, 0, 0))


def played(source: Any) -> Mailbox:
    """The mailbox of a source after its end."""
    mailbox = Mailbox()
    source.start(mailbox)
    wait_for(lambda: source.health().state == "ended")
    return mailbox


def test_a_video_is_played_at_its_own_pace(fake, tmp_path):
    path = write_video(tmp_path / "clip.mp4", [plain(200)] * 20, rate=20.0)
    source = build_source(f"video:{path},speed=2,every=true")
    began = time.perf_counter()
    arrival = played(source).take("right")
    assert time.perf_counter() - began > 0.95 * 19 / 40
    assert arrival.frame.stamp > 0.9
    assert arrival.session == 0
    assert "a hand in" in source.health().detail
    assert source.label not in source.health().detail  # the loop adds the name
    again, mailbox = Video(path, speed=8.0, loop=True), Kept()
    again.start(mailbox)  # that loops begins a new session each time
    wait_for(lambda: 2 in {arrival.session for arrival in mailbox.all})
    again.stop()
    assert again.health().state == "ended"


def test_late_pictures_are_skipped_unless_every_one_is_wanted(fake, tmp_path, monkeypatch):
    path = write_video(tmp_path / "clip.mp4", [plain(200)] * 20)
    find = Fake.find

    def slow(self: Fake, *args: Any) -> list[SeenHand]:
        time.sleep(0.04)
        return find(self, *args)

    monkeypatch.setattr(Fake, "find", slow)
    assert played(Video(path, speed=4.0, every=True)).received == 20
    source = Video(path, speed=4.0)
    assert 1 <= played(source).received <= 12
    assert "skipped because they were late" in source.health().detail


def test_what_is_no_video_is_refused_with_its_name(tmp_path):
    (tmp_path / "text.mp4").write_text("no video")
    with pytest.raises(SourceError, match=r"text\.mp4: the file can't be read as a video"):
        Video(tmp_path / "text.mp4").start(Mailbox())


def test_settings_are_read_and_checked_before_anything_starts():
    assert build_source("webcam") == Webcam(0)
    assert build_source("webcam:2") == Webcam(2)
    address = build_source("webcam:rtsp://10.0.0.2/live?a=1,mirrored=true")
    assert address == Webcam("rtsp://10.0.0.2/live?a=1", mirrored=True)
    for text in (
        "webcam:0,max_hands=3",
        "webcam:0,confidence=1.5",
        "webcam:-1",
        "webcam:0,rate=0",
        "webcam:0,fov=5",
        "video:a.mp4,speed=0",
        "video:a.mp4,points=depth",
        "video",
    ):
        with pytest.raises(ConfigError):
            build_source(text)


def test_without_the_extra_one_line_says_so(tmp_path, monkeypatch):
    clip = write_video(tmp_path / "clip.mp4", [plain(0)])
    monkeypatch.setattr(picture_tracker, "hand_model", lambda given: clip)
    monkeypatch.setitem(sys.modules, "mediapipe", None)
    with pytest.raises(MissingExtraError, match=re.escape(install_command("webcam"))):
        Video(clip).start(Mailbox())


class Capture:
    """A camera that gives so many pictures, and then none."""

    left: list[int]
    """Pictures of each opening; no more openings, no camera."""
    released: int

    def __init__(self, name: object) -> None:
        self.there = bool(Capture.left)
        self.pictures = Capture.left.pop(0) if self.there else 0

    def isOpened(self) -> bool:
        return self.there

    def set(self, *_: object) -> None:
        pass

    def read(self) -> tuple[bool, np.ndarray | None]:
        self.pictures -= 1
        time.sleep(0.005)
        return self.pictures >= 0, plain(200)

    def release(self) -> None:
        Capture.released += 1


@pytest.fixture
def captures(monkeypatch) -> type[Capture]:
    monkeypatch.setattr(cv2, "VideoCapture", Capture)
    monkeypatch.setattr(camera_module, "RETRY_S", 0.05)
    Capture.released = 0
    return Capture


def test_a_camera_that_vanishes_is_opened_again(captures, fake):
    captures.left = [4]
    source, mailbox = Webcam(), Mailbox()
    source.start(mailbox)
    wait_for(lambda: source.health().state == "waiting")
    wait_for(lambda: "was disconnected" in source.health().detail)
    first = mailbox.take("right")
    assert first.session == 0
    assert first.received >= first.frame.stamp
    captures.left = [10**6]
    wait_for(lambda: source.health().state == "running")
    second = None
    while second is None:
        second = mailbox.take("right")
    assert second.session == 1
    assert second.frame.stamp > first.frame.stamp
    source.stop()
    source.stop()
    assert source.health().state == "ended"
    assert captures.released >= 2


def test_the_newest_picture_is_taken_and_the_others_are_dropped(captures, monkeypatch):
    numbers = [0]

    def numbered(self: Capture) -> tuple[bool, np.ndarray]:
        time.sleep(0.005)
        numbers.append(len(numbers))
        return True, np.full((2, 2, 3), numbers[-1])

    monkeypatch.setattr(Capture, "read", numbered)
    captures.left = [10**6]
    camera = Camera(Webcam().capture, 0)
    wait_for(lambda: len(numbers) > 10)
    last = numbers[-2]  # the last one may not have reached the camera yet
    picture = camera.newest(10.0)
    assert picture.pixels[0, 0, 0] >= last
    assert picture.time <= time.perf_counter()
    camera.close()
    assert camera.newest(0.05) is None or camera.newest(0.05) is None


@pytest.mark.parametrize(
    ("openings", "words"),
    [
        ([], r"camera 0: it can't be opened\. Interfaces that were tried: .*video:"),
        ([0], "no other program"),
    ],
)
def test_a_missing_camera_is_reported(captures, fake, openings, words):
    captures.left = openings
    with pytest.raises(SourceError, match=words):
        Webcam().start(Mailbox())


@pytest.fixture(scope="module")
def media(shared) -> Path:
    folder: Path = shared / "media"
    if not folder.is_dir():
        pytest.skip("the folder of real pictures is not beside this checkout")
    landmarker_or_skip(folder / "hand_landmarker.task")
    return folder


@pytest.fixture(scope="module")
def clip(media, tmp_path_factory) -> Path:
    """Forty pictures of the hand, at half their size."""
    capture = cv2.VideoCapture(str(media / "human_hand_video.mp4"))
    pictures = [cv2.resize(capture.read()[1], (640, 360)) for _ in range(40)]
    capture.release()
    return write_video(tmp_path_factory.mktemp("clip") / "hand.mp4", pictures)


@pytest.fixture
def tracker(media) -> Iterator[Callable[..., PictureTracker]]:
    made = []

    def make(**settings: Any) -> PictureTracker:
        made.append(PictureTracker(PictureConfig(model=media / "hand_landmarker.task", **settings)))
        return made[-1]

    yield make
    for each in made:
        each.close()


def photograph(media: Path, finger: str) -> np.ndarray:
    picture: np.ndarray = cv2.imread(str(media / f"thumb_to_{finger}_tip.jpg"))
    return cv2.resize(picture, None, fx=0.5, fy=0.5)


@pytest.mark.shared
@pytest.mark.parametrize("finger", PINCHES)
def test_a_photographed_right_hand_is_a_right_hand_at_the_finger_that_it_touches(
    media, tracker, finger
):
    """By its shape, and not by its label: against the same hand as another tracker saw it."""
    with np.load(media.parent / "recordings" / "pinch_poses_wilor_21x3.npz") as hands:
        reference = np.asarray(hands[f"thumb_to_{finger}_tip"], float)
    (frame,) = tracker().frames(photograph(media, finger), 0.0)
    assert frame.side == "right"
    low, high = PALM_RANGE_M
    assert low < np.linalg.norm(frame.landmarks[9] - frame.landmarks[0]) < high
    residual = [
        np.sqrt(np.mean(np.sum((umeyama(p, reference).apply(p) - reference) ** 2, axis=-1)))
        for p in (frame.landmarks, frame.landmarks * (-1, 1, 1))
    ]
    assert residual[0] < 0.013
    assert residual[0] < 0.5 * residual[1]  # as a mirror image it does not fit
    following = tracker(points="picture")
    for k in range(3):  # it settles as in a video
        (frame,) = following.frames(photograph(media, finger), k / 30)
    gaps = np.linalg.norm(frame.landmarks[list(TIPS[1:])] - frame.landmarks[TIPS[0]], axis=1)
    assert TIPS[1 + int(np.argmin(gaps))] == PINCHES[finger]
    assert gaps.min() < 0.03


@pytest.mark.shared
def test_a_mirrored_photograph_needs_the_setting(media, tracker):
    mirrored = photograph(media, "ring")[:, ::-1]
    (wrong,) = tracker().frames(mirrored, 0.0)
    assert wrong.side == "left"
    (right,) = tracker(mirrored=True).frames(mirrored, 0.0)
    assert right.side == "right"
    (straight,) = tracker().frames(photograph(media, "ring"), 0.0)
    np.testing.assert_allclose(right.landmarks, straight.landmarks, atol=1e-6)


@pytest.mark.shared
def test_the_command_line_converts_a_video(media, clip, tmp_path, monkeypatch):
    monkeypatch.setenv(SWITCH, str(media / "hand_landmarker.task"))
    out = tmp_path / "hand.npz"
    assert main(["convert", str(clip), "--output", str(out)]) == 0
    recording = read_recording(out)
    assert (len(recording), recording.side) == (40, "right")
    assert recording.valid.all(axis=1).mean() >= 0.95
    assert recording.rate_hz == pytest.approx(30.0, rel=0.01)


@pytest.mark.shared
def test_a_missing_hand_is_an_error(media, clip):
    config, told = PictureConfig(model=media / "hand_landmarker.task"), []
    with pytest.raises(RecordingError, match="no left hand is seen in any of its 40 pictures"):
        track_video(clip, side="left", config=config, progress=lambda *at: told.append(at))
    assert told[-1] == (40, 40)


@pytest.mark.shared
def test_the_live_video_posts_a_hand(media, clip, tmp_path):
    model = media / "hand_landmarker.task"
    mailbox = played(Video(clip, every=True, model=model))
    assert mailbox.received >= 38
    assert mailbox.take("right").frame.stamp == pytest.approx(39 / 30, abs=0.01)
    assert mailbox.take("left") is None
    noise = np.random.default_rng(0).integers(0, 255, (10, 120, 160, 3), np.uint8)
    source = build_source(f"video:{write_video(tmp_path / 'a.mp4', list(noise))},model={model}")
    assert played(source).received == 0
    assert "a hand in 0 of" in source.health().detail


@pytest.mark.shared
def test_a_wrong_model_is_one_sentence(media, tmp_path):
    path = tmp_path / "empty.task"
    with zipfile.ZipFile(path, "w") as file:
        file.writestr("hand_landmarks_detector.tflite", b"")
    with pytest.raises(SourceError, match="MediaPipe can't load"):
        HandLandmarker(path)


@pytest.mark.shared
def test_the_start_is_quiet_and_hides_no_word_of_others(media, capfd, monkeypatch):
    find = HandLandmarker.find

    def speaking(self: HandLandmarker, *args: Any) -> list[SeenHand]:
        print("a word of another thread", file=sys.__stderr__, flush=True)
        return find(self, *args)

    monkeypatch.setattr(HandLandmarker, "find", speaking)
    HandLandmarker(media / "hand_landmarker.task").close()
    said = capfd.readouterr().err
    assert "a word of another thread" in said
    assert "XNNPACK" not in said
    assert "inference_feedback_manager" not in said


@pytest.mark.shared
def test_a_program_that_ends_without_stopping_ends_in_peace(media, clip):
    program = f"""
import time
from pathlib import Path
from smooth_operator.teleop.sources.live import Mailbox
from smooth_operator.teleop.sources.webcam.webcam_source import Video
source = Video(Path({str(clip)!r}), loop=True, model=Path({str(media)!r}) / "hand_landmarker.task")
source.start(Mailbox())
time.sleep(0.5)
"""
    ended = python("-c", program)
    assert ended.returncode == 0, ended.stderr
    assert "Traceback" not in ended.stderr


@pytest.mark.parametrize("side", ["right", "left"])
def test_the_size_of_the_palm_gives_the_place_of_the_wrist(fake, monkeypatch, side):
    """A hand of MediaPipe's size moves and turns in front of a camera of 70 degrees."""
    focal, aspect, rng = 0.5 / np.tan(np.radians(35.0)), 0.75, np.random.default_rng(0)
    shape = SyntheticOperator(side=side, seed=0).record(0.02).landmarks[0]
    shape = (shape - shape[0]) @ AXES  # in the camera's axes
    size = np.linalg.norm(shape[9]) + np.linalg.norm(shape[5] - shape[17])
    shape *= 0.157 / size
    places, poses = [], []
    for place in ([0.0, 0.0, 0.5], [0.1, -0.05, 0.4], [-0.15, 0.1, 0.8]):
        turn = from_rotation_vectors(rng.normal(0.0, 0.3, 3))
        there = rotate(turn, shape) + place
        # The tracker's own hand has another size, and is turned as seen along its ray.
        flat = np.stack([there[:, 0], there[:, 1], 0 * there[:, 2]], axis=1) / there[:, 2:]
        picture = focal * flat + [0.5, 0.5 * aspect, 0.0]
        world = 1.07 * rotate(from_rotation_vectors(np.array([0.05, -0.04, 0.0])), there - there[0])
        hand = SeenHand(side, 0.9, world, picture, np.ones(21, bool))
        monkeypatch.setattr(Fake, "find", lambda self, pixels, time, hand=hand: [hand])
        tracker = PictureTracker(PictureConfig(fov=70.0))
        (frame,) = tracker.frames(np.zeros((480, 640, 3), np.uint8), 0.0)
        assert frame.T_world_wrist is not None
        assert frame.world == "camera"
        places.append(frame.T_world_wrist[:3])
        np.testing.assert_allclose(places[-1], AXES @ place, atol=2e-3)
        expected = wrist_from_landmarks((there - there[0]) @ AXES.T, side)
        poses.append(separation(frame.T_world_wrist, expected)[1])
    assert max(poses) < 0.03
    outside = np.ones(21, bool)
    outside[17] = False
    hand = SeenHand(side, 0.9, world, picture, outside)
    monkeypatch.setattr(Fake, "find", lambda self, pixels, time: [hand])
    (frame,) = PictureTracker(PictureConfig(fov=70.0)).frames(np.zeros((480, 640, 3), np.uint8), 0)
    assert not is_valid(frame.T_world_wrist)


PERIOD = 1 / 30
PALM = 0.1  # in the picture


def seen(label: Side, x: float, score: float = 0.95) -> SeenHand:
    """A hand whose palm is a tenth of the picture long, ``x`` from its left edge."""
    picture = np.zeros((21, 3))
    picture[:, 0] = x
    picture[:, 1] = 0.5
    picture[[5, 9, 13, 17], 1] -= PALM
    return SeenHand(label, score, np.zeros((21, 3)), picture, np.ones(21, bool))


def feed(pictures: list[list[SeenHand]]) -> list[dict[Side, float]]:
    """Side -> x of the hand that it got, for each picture."""
    out, tracks = [], {}
    for i, hands in enumerate(pictures):
        found, tracks = assign_sides(hands, tracks, i * PERIOD)
        out.append({side: float(hand.picture[0, 0]) for side, hand in found.items()})
    return out


BOTH = [seen("right", 0.2), seen("left", 0.8)]


def test_a_label_is_believed_when_it_insists():
    """A flip is overruled, but a wrong first guess does not hold for ever."""
    out = feed([[seen("right", 0.2)]] + [[seen("left", 0.21, 0.99)]] * (PATIENCE + 3))
    sides = [next(iter(found)) for found in out]
    assert sides == ["right"] * PATIENCE + ["left"] * 4
    assert out[1] == {"right": 0.21}


def test_hands_that_cross_keep_their_labels():
    """Where both were near, the label decides."""
    steps = np.linspace(-0.2, 0.2, 15)
    out = feed([[seen("right", 0.5 + x), seen("left", 0.5 - x)] for x in steps])
    for x, found in zip(steps, out, strict=True):
        places = {"right": 0.5 + x, "left": 0.5 - x}
        assert found == pytest.approx({side: places[side] for side in found})
    assert set(out[-1]) == {"right", "left"}


PLACES = {"right": 0.2, "left": 0.8}
WAIT = int(MEMORY_S / PERIOD) + 2


@pytest.mark.parametrize(
    ("pictures", "last"),
    [
        ([BOTH, BOTH], PLACES),
        ([BOTH, BOTH[::-1]], PLACES),  # whatever the order in which they are found
        ([BOTH, *[[seen("left", 0.2), seen("right", 0.8)]] * 2], PLACES),  # labels swap
        # of two hands with one label the surer one counts, or the one that was there
        ([[seen("right", 0.2, 0.7), seen("right", 0.8, 0.9)]], {"right": 0.8}),
        (
            [[seen("right", 0.2)], [seen("right", 0.2, 0.7), seen("right", 0.8, 0.99)]],
            {"right": 0.2},
        ),
        ([BOTH, [seen("right", 0.2, 0.8), seen("right", 0.8, 0.9)]], PLACES),
        # one hand that is found twice
        ([[seen("left", 0.2 + 0.3 * PALM, 0.6), seen("right", 0.2, 0.9)]], {"right": 0.2}),
        ([[seen("right", 0.2)], *[[]] * WAIT, [seen("left", 0.2)]], {"left": 0.2}),  # forgotten
        # a hand may move fast, but not jump
        ([[seen("right", 0.2)], [seen("left", 0.2 + 1.4 * PALM)]], {"right": 0.34}),
        ([[seen("right", 0.2)], [seen("left", 0.2 + 1.6 * PALM)]], {"left": 0.36}),
    ],
)
def test_each_hand_keeps_its_side(pictures, last):
    assert feed(pictures)[-1] == pytest.approx(last)
    _, tracks = assign_sides([seen("right", 0.2)], {}, 20.0)
    hands, _ = assign_sides([seen("left", 0.2)], tracks, 0.0)
    assert list(hands) == ["left"]  # time that goes back forgets all


def test_points_of_the_picture_get_the_size_of_those_in_metres():
    rng = np.random.default_rng(1)
    world = rng.normal(scale=0.04, size=(21, 3))
    picture = (world - world.mean(axis=0)) * 2.7 + (0.3, 0.6, 0.0)
    hand = dataclasses.replace(seen("right", 0.5), world=world, picture=picture)
    np.testing.assert_allclose(
        landmarks_of(hand, "picture"), world - world.mean(axis=0), atol=1e-12
    )
    np.testing.assert_array_equal(landmarks_of(hand, "world"), world)
