"""Hands of the wrong side and landmarks in the wrong order are noticed; right ones never."""

from pathlib import Path

import numpy as np
import pytest

from smooth_operator import read_recording
from smooth_operator.errors import ConfigError, RecordingError, UnknownNameError
from smooth_operator.formats.checks import check_palm, check_units
from smooth_operator.io.anatomy import (
    FEWEST_FRAMES,
    MIRRORED,
    HandCheck,
    implausible,
    keeps_lengths,
    sides,
)
from smooth_operator.io.landmark_order import check_hand, chirality, doubt, remedy
from smooth_operator.landmarks import BONES, LAYOUTS
from smooth_operator.synthetic import SyntheticOperator
from smooth_operator.synthetic.gestures import FIST, FLAT, SPREAD, pinch_postures
from smooth_operator.synthetic.hand_anatomy import couple, draw_anatomy, pose_hand
from smooth_operator.teleop.components import build_source
from smooth_operator.teleop.recording import read_episode
from smooth_operator.teleop.sources.payload import Forms, read_payload
from smooth_operator.types import HandRecording, Side

MIRROR = np.array([-1.0, 1.0, 1.0])
RECORDINGS = [
    "manus_right_subject-000_run-010.npz",
    "human_alex_21x3.npy",
    "wilor_test_long_21x3.npz",
    "wilor_workspace_21x3.npz",
]
FOREIGN = [name for name in LAYOUTS if name not in ("mediapipe", "openpose")]


@pytest.fixture(scope="module")
def operator() -> HandRecording:
    return SyntheticOperator(seed=1).record(2.0)


def in_layout(landmarks: np.ndarray, name: str) -> np.ndarray:
    """Landmarks of ours as another tracker has them."""
    points = np.empty_like(landmarks)
    points[..., LAYOUTS[name], :] = landmarks
    return points


def real(shared: Path, name: str) -> np.ndarray:
    path = shared / "recordings" / name
    return read_recording(path, rate=None if name.startswith("manus") else 30.0).landmarks


def saved(path: Path, landmarks: np.ndarray, **more: object) -> Path:
    np.savez(path, landmarks=landmarks, timestamps=np.arange(len(landmarks)) / 100, **more)
    return path


def test_a_layout_is_an_order_of_all_points():
    for order in LAYOUTS.values():
        assert sorted(order) == list(range(21))
    # as the programs that give these orders name their points
    mano = ["W", *(f"{f}{k}" for f in "IMPRT" for k in (1, 2, 3)), *(f"{f}4" for f in "TIMRP")]
    ours = [mano[i] for i in LAYOUTS["mano"]]
    assert ours == ["W", *(f"{finger}{k}" for finger in "TIMRP" for k in range(1, 5))]
    ends = [f"{finger}{k}" for finger in "TIMRP" for k in (4, 3, 2, 1)] + ["W"]
    assert [ends[i] for i in LAYOUTS["interhand"]] == ours
    bases = ["W", "T1", "I1", "M1", "R1", "P1", *(f"{f}{k}" for f in "TIMRP" for k in (2, 3, 4))]
    assert [bases[i] for i in LAYOUTS["fpha"]] == ours


@pytest.mark.parametrize("name", FOREIGN)
def test_another_order_is_recognised(operator, name):
    rng = np.random.default_rng(0)
    seen = operator.landmarks[:50] + rng.normal(0, 0.003, (50, 21, 3))
    found = doubt(in_layout(seen, name), "right")
    assert (found.layout, found.order, found.side) == (name, LAYOUTS[name], None)
    assert f"--layout {name}" in remedy(found)
    assert doubt(in_layout(seen, name), "right", layout=name) is None
    back = doubt(seen, "right", layout=name)  # said, but not so
    assert back.layout == "mediapipe"


def test_an_order_without_a_name_is_put_right(operator):
    order = [0, *range(5, 9), *range(1, 5), *range(9, 21)]  # index and thumb changed places
    points = operator.landmarks[:30][:, order]
    found = doubt(points, "right")
    assert found.layout is None
    np.testing.assert_array_equal(points[:, list(found.order)], operator.landmarks[:30])
    assert str(list(found.order)) in remedy(found)
    assert "wrist, index, thumb, middle, ring, pinky" in found.what


def test_a_mirror_image_is_the_other_hand(operator):
    mirrored = operator.landmarks * MIRROR
    np.testing.assert_allclose(chirality(mirrored), -chirality(operator.landmarks))
    for points, side, other in ((mirrored, "right", "left"), (operator.landmarks, "left", "right")):
        found = doubt(points, side)
        assert (found.side, found.layout) == (other, None)
        assert f"--side {other}" in remedy(found)
    assert doubt(mirrored, "left") is None
    with pytest.raises(
        RecordingError, match=r"takes: judging by its shape, this is a left hand.*--side"
    ):
        check_hand(mirrored, "right", where="takes")


def test_too_little_is_not_judged(operator):
    assert doubt(np.zeros((50, 21, 3)), "right") is None  # no hand in view is no other order
    mirrored = operator.landmarks[: FEWEST_FRAMES + 3] * MIRROR
    assert doubt(mirrored, "right") is not None
    mirrored[:4, 7] = np.nan  # whole frames are too few now
    assert doubt(mirrored, "right") is None
    with pytest.raises(UnknownNameError, match=r"layout 'manno'.*mano"):
        doubt(mirrored, "right", layout="manno")


@pytest.mark.parametrize("side", ["right", "left"])
def test_right_ones_are_never_refused(side):
    """Short windows of operators of either side, with the noise of a bad tracker."""
    rng = np.random.default_rng(2)
    for seed in range(3):
        made = SyntheticOperator(seed=seed, side=side).record(4.0)
        for first in range(0, 380, 19):
            for noise in (0.0, 0.003, 0.005):
                seen = made.landmarks[first : first + 8]
                assert doubt(seen + rng.normal(0, noise, seen.shape), made.side) is None


@pytest.mark.shared
@pytest.mark.parametrize("name", RECORDINGS)
def test_faults_of_real_recordings_are_noticed(shared, name):
    """Half-second windows all over the recordings, of both sides."""
    landmarks = real(shared, name)
    mirrored, noticed, windows = landmarks * MIRROR, 0, 0
    for first in range(0, len(landmarks) - 15, 97):
        cut = slice(first, first + 15)
        foreign = doubt(in_layout(landmarks[cut], "mano"), "right")
        assert foreign.layout == "mano"
        noticed += doubt(mirrored[cut], "right") is not None
        windows += 1
    # straight fingers tell no side unless the thumb stands out
    assert noticed >= 0.4 * windows
    assert doubt(mirrored, "right") is not None


def turned(landmarks: np.ndarray, kind: str, size: float) -> tuple[np.ndarray, Side]:
    if kind == "left":
        return landmarks * MIRROR * size, "left"
    return landmarks * size, "right"


def test_random_orders_are_refused_in_a_few_frames(operator):
    rng = np.random.default_rng(3)
    for _ in range(120):
        first = int(rng.integers(0, 190))
        order = rng.permutation(21)
        found = doubt(operator.landmarks[first : first + FEWEST_FRAMES][:, order], "right")
        assert found.side is None
        assert "do not form a hand" in found.what or found.order is not None


@pytest.mark.shared
@pytest.mark.parametrize(
    ("side", "size"), [("right", 0.6), ("right", 1.0), ("right", 1.25), ("left", 1.0)]
)
@pytest.mark.parametrize("name", RECORDINGS)
def test_no_real_hand_of_any_size_is_refused(shared, name, side, size):
    points, its = turned(real(shared, name), side, size)
    for frames, step in ((len(points), len(points)), (1, 23), (10, 97), (100, 197)):
        for first in range(0, len(points) - frames + 1, step):
            window = points[first : first + frames]
            known = np.ones(window.shape[:2], bool)
            assert doubt(window, its) is None
            check_units(window, known, name)
            assert not implausible(window, known).any()


@pytest.mark.parametrize("posture", [FLAT, FIST, SPREAD, *pinch_postures(0)])
def test_still_poses_are_hands(posture):
    for seed in range(3):
        pose = pose_hand(draw_anatomy(0.19, seed), couple(posture[None])).landmarks
        points = np.repeat(pose, 12, axis=0)
        for side in ("right", "left"):
            for size in (0.6, 1.0, 1.25):
                window, its = turned(points, side, size)
                assert doubt(window, its) is None
                assert not implausible(window, np.ones(window.shape[:2], bool)).any()


def test_bones_that_change_their_lengths_are_no_hand(operator):
    points, stretch = operator.landmarks.copy(), np.linspace(1.0, 3.0, 200)
    assert doubt(points * stretch[:, None, None], "right") is None  # a size is no proportion
    rng = np.random.default_rng(6)
    for parent, child in BONES:  # each bone has another length in each tenth of the recording
        bone = operator.landmarks[:, child] - operator.landmarks[:, parent]
        factors = np.exp(rng.normal(0.0, 0.6, 10)).repeat(20)
        points[:, child] = points[:, parent] + bone * factors[:, None]
    assert keeps_lengths(operator.landmarks)
    assert not keeps_lengths(points)
    found = doubt(points, "right")
    assert "do not form a hand" in found.what
    known = np.ones((200, 21), bool)
    with pytest.raises(RecordingError, match="bone lengths also change") as caught:
        check_units(points / 0.3048, known, "here")
    assert "multiply" not in str(caught.value)
    with pytest.raises(RecordingError, match=r"feet \(multiply by 0\.3048\)"):
        check_units(operator.landmarks / 0.3048, known, "here")


@pytest.mark.parametrize("distance", [0.3, 0.5, 1.1, 2.0])
@pytest.mark.parametrize("picture", [(640, 480), (1280, 720)])
@pytest.mark.parametrize("pixels", [False, True])
def test_image_landmarks_are_recognised(tmp_path, operator, distance, picture, pixels):
    width, height = picture
    points = operator.landmarks - operator.landmarks[:, :1]
    points = points @ np.linalg.qr(np.random.default_rng(5).normal(size=(3, 3)))[0]
    focal, depth = 0.94 * width, distance + points[..., 2]
    seen = np.stack(
        [
            focal * points[..., 0] / depth / width + 0.5,
            focal * points[..., 1] / depth / height + 0.6,
            focal * points[..., 2] / distance / width + 1e-9,
        ],
        axis=-1,
    )
    if pixels:
        seen *= (width, height, width)
    for landmarks in (seen, seen * 0.3048):
        with pytest.raises(RecordingError, match=r"image landmarks.*world landmarks") as caught:
            read_recording(saved(tmp_path / "a.npz", landmarks))
        assert "multiply" not in str(caught.value)
    if not 0.05 < np.linalg.norm(seen[0, 9] - seen[0, 0]) < 0.14:
        with pytest.raises(RecordingError, match="image landmarks"):  # live, from the first frame
            check_palm(seen[0], np.ones(21, bool), "the message")


def test_the_thumbs_base_of_aria_is_estimated(tmp_path, operator):
    points = in_layout(operator.landmarks, "aria")
    points[:, 20] = (operator.landmarks[:, 0] + operator.landmarks[:, 9]) / 2
    path = saved(tmp_path / "a.npz", points)
    with pytest.raises(RecordingError, match=r"the order 'aria'.*use --layout aria"):
        read_recording(path)
    read = read_recording(path, layout="aria").landmarks
    rest = [i for i in range(21) if i != 1]
    np.testing.assert_array_equal(read[:, rest], operator.landmarks[:, rest])
    off = np.linalg.norm(read[:, 1] - operator.landmarks[:, 1], axis=-1)
    assert off.max() < 0.012
    points[3, 6] = np.nan  # without the thumb's MCP there is no CMC either
    valid = read_recording(saved(tmp_path / "b.npz", points), layout="aria").valid
    assert np.argwhere(~valid).tolist() == [[3, 1], [3, 2]]


def test_a_file_in_another_layout_is_refused_and_converted(tmp_path, operator):
    points = in_layout(operator.landmarks[:40], "mano")
    valid = np.ones((40, 21), bool)
    valid[3, 16] = False  # in MANO's order: the thumb's tip
    turns = np.random.default_rng(0).normal(size=(40, 21, 4))
    turns /= np.linalg.norm(turns, axis=-1, keepdims=True)
    orientations = in_layout(turns, "mano")
    path = saved(tmp_path / "a.npz", points, valid=valid, orientations=orientations)
    with pytest.raises(RecordingError, match=r"a\.npz: .* the order 'mano' .*use --layout mano"):
        read_recording(path)
    read = read_recording(path, layout="mano")
    np.testing.assert_array_equal(read.landmarks, operator.landmarks[:40])
    assert np.argwhere(~read.valid).tolist() == [[3, 4]]
    np.testing.assert_array_equal(read.orientations, turns)
    episode = read_episode(path, layout="mano").recording
    np.testing.assert_array_equal(episode.landmarks, read.landmarks)
    with pytest.raises(RecordingError, match="order 'mediapipe'"):
        read_recording(saved(tmp_path / "b.npz", operator.landmarks), layout="mano")


def test_a_mirrored_file_is_refused_whether_it_says_its_side_or_not(tmp_path, operator):
    mirrored = operator.landmarks * MIRROR
    with pytest.raises(RecordingError, match=r"a left hand.*use --side left"):
        read_recording(saved(tmp_path / "a.npz", mirrored))
    assert read_recording(tmp_path / "a.npz", side="left").side == "left"
    labelled = saved(tmp_path / "b.npz", mirrored, side=np.array("right"))
    with pytest.raises(RecordingError, match=r"a left hand.*says right hand: correct the side"):
        read_recording(labelled)


def test_frames_of_another_size_are_not_seen(tmp_path, operator):
    points = operator.landmarks.copy()
    points[10:14] *= 1000.0  # a stretch in millimetres
    points[20] *= 1e30
    points[30, 8] = 5.0  # one landmark in the next room
    read = read_recording(saved(tmp_path / "a.npz", points))
    assert read.meta["implausible_frames"] == 6
    wrong = ~read.valid
    assert np.flatnonzero(wrong.all(axis=1)).tolist() == [10, 11, 12, 13, 20]
    assert np.argwhere(wrong[21:]).tolist() == [[9, 8]]
    notes = read_episode(tmp_path / "a.npz").notes
    assert any("6 of 200 frames have a palm or a landmark" in note for note in notes)
    clean = read_recording(saved(tmp_path / "b.npz", operator.landmarks))
    assert "implausible_frames" not in clean.meta


@pytest.mark.parametrize("layout", FOREIGN)
def test_a_wrong_order_is_refused_as_long_as_it_comes(operator, layout):
    check, valid = HandCheck("right"), np.ones(21, bool)
    points = in_layout(operator.landmarks[:130], layout)
    verdicts = [check.see(frame, valid, 0.01 * i) for i, frame in enumerate(points)]
    layouts = {None if found is None else found.layout for found in verdicts[FEWEST_FRAMES - 1 :]}
    assert layouts == {layout}


def refusals(points: np.ndarray, stamps: np.ndarray, known: np.ndarray | None = None) -> np.ndarray:
    """(T,) True where a frame of a right hand is refused by its side."""
    check, known = HandCheck("right"), np.ones(points.shape[:2], bool) if known is None else known
    found = [check.see(*frame) for frame in zip(points, known, stamps, strict=True)]
    assert all(one is None or one.side == "left" for one in found)
    return np.array([one is not None for one in found])


@pytest.mark.parametrize("rate", [15.0, 30.0, 60.0, 120.0])
def test_another_hand_is_held_within_a_tenth_of_a_second_and_the_right_one_is_back_soon(rate):
    motion = SyntheticOperator(seed=1, rate_hz=rate).record(6.0)
    for seconds in (1 / rate, 0.2, 0.7, 2.0):
        stamps, points = motion.stamps - motion.stamps[0], motion.landmarks.copy()
        other = (stamps >= 2.0) & (stamps < 2.0 + seconds)
        points[other] *= MIRROR
        refused = refusals(points, stamps)
        assert refused[other & (stamps >= 2.1)].all()
        assert other[refused][0]
        assert not refused[~other & ((stamps < 2.0) | (stamps >= 2.3 + seconds))].any()


def test_a_hand_that_shows_no_side_is_held_for_a_moment_after_the_other_hand():
    flat = pose_hand(draw_anatomy(0.19, 0), couple(FLAT[None])).landmarks[0]
    flat[[1, 2, 3, 4]] -= 0.3 * (flat[[1, 2, 3, 4]] - flat[0])  # a thumb beside the palm
    flat[1:5, 2] = flat[0, 2]
    assert sides(flat[None])[0] == 0
    fist = pose_hand(draw_anatomy(0.19, 0), couple(FIST[None])).landmarks[0]
    points = np.stack([fist, *[fist * MIRROR] * 3, *[flat] * 40, fist, flat])
    refused = refusals(points, 0.01 * np.arange(len(points)))
    assert np.flatnonzero(refused).tolist() == list(range(1, 4 + 25))
    one = refusals(np.stack([fist, fist * MIRROR, flat, fist]), 0.01 * np.arange(4))
    assert one.tolist() == [False, True, False, False]  # a slip of one frame


@pytest.mark.parametrize("missing", [[8], [1, 2], [4], [12, 16, 20]])
def test_a_frame_with_landmarks_missing_is_judged_by_the_others(operator, missing):
    known = np.ones((len(operator), 21), bool)
    known[:, missing] = False
    points = np.where(known[..., None], operator.landmarks, np.nan)
    assert not refusals(points, operator.stamps, known).any()
    assert refusals(points * MIRROR, operator.stamps, known).mean() > 0.85


def flat_hand_of_a_depth_camera(seed: int) -> np.ndarray:
    """(62, 21, 3) a flat right hand, its thumb behind the plane of the palm, with 2 mm of noise."""
    rng = np.random.default_rng(seed)
    anatomy = draw_anatomy(0.19, seed)
    flat = pose_hand(anatomy, couple(np.zeros_like(FLAT)[None])).landmarks[0]
    wrist, index, pinky = flat[0], flat[5], flat[17]
    normal = np.cross(index - wrist, pinky - wrist)
    normal /= np.linalg.norm(normal)
    flat = flat - ((flat - wrist) @ normal)[:, None] * normal  # a planar palm, straight fingers
    palm = np.linalg.norm(flat[9] - wrist)
    flat[1:5] -= palm * np.array([0.12, 0.19, 0.2, 0.2])[:, None] * normal
    flat[[9, 13]] += 0.03 * palm * normal
    return flat + rng.normal(0.0, 0.002, (62, 21, 3))


@pytest.mark.parametrize("seed", range(3))
def test_a_flat_hand_of_a_depth_camera_is_not_judged(tmp_path, seed):
    """It measures the thumb behind the palm; its right hands were refused as left ones."""
    points = flat_hand_of_a_depth_camera(seed)
    assert chirality(points).mean() < MIRRORED
    for landmarks, side in ((points, "right"), (points * MIRROR, "left")):
        assert doubt(landmarks, side) is None
        assert read_recording(saved(tmp_path / f"{side}.npz", landmarks, side=side)).side == side
    assert refusals(points, 0.1 * np.arange(62)).mean() <= 0.05  # and no two of them in a row


@pytest.mark.shared
@pytest.mark.parametrize("mirrored", [False, True], ids=["its side", "the other hand"])
def test_live_hands_of_real_trackers(shared, mirrored):
    """No right hand is held; of a stretch of the other hand little is taken, and the right one is
    back in 0.3 s."""
    paths = [shared / "recordings" / name for name in RECORDINGS]
    for path in [*paths, *sorted((shared / "recordings_new").glob("*_*.npz"))]:
        rate = 30.0 if "recordings_new" not in str(path) and "manus" not in path.name else None
        left = path.stem.endswith("left")
        recording = read_recording(path, side="left" if left else "right", rate=rate)[:2500]
        known = recording.valid.all(axis=1)
        points = recording.landmarks[known] * (MIRROR if left else 1.0)
        stamps = recording.stamps[known]
        if not mirrored:
            assert not refusals(points, stamps).any(), path.name
            continue
        other = (stamps - stamps[0]) % 3.0 >= 2.0  # a second in three
        points[other] *= MIRROR
        refused, told = refusals(points, stamps), sides(points) < 0
        assert refused[other & told].all()
        ends = np.flatnonzero(other[:-1] & ~other[1:])
        for end in ends:
            after = ~other & (stamps > stamps[end] + 0.3) & (stamps < stamps[end] + 1.0)
            assert not refused[after].any(), path.name


@pytest.mark.parametrize("form", ["bytes", "json"])
def test_messages_in_another_layout_are_converted(operator, form):
    points = in_layout(operator.landmarks[5], "mano")
    data = points.astype("<f8").tobytes() if form == "bytes" else str(points.tolist()).encode()
    (reading,) = read_payload(data, "right", Forms(layout="mano"))
    np.testing.assert_array_equal(reading.frame.landmarks, operator.landmarks[5])
    (as_it_came,) = read_payload(data, "right")
    assert not np.array_equal(as_it_came.frame.landmarks, operator.landmarks[5])


@pytest.mark.parametrize(
    ("name", "head"),
    [
        ("clip.mp4", b"\x00\x00\x00\x20ftypisom"),
        ("clip.mkv", b"\x1aE\xdf\xa3\x01\x00\x00\x00"),
        ("clip.avi", b"RIFF\x00\x00\x00\x00AVI LIST"),
    ],
)
def test_a_video_is_told_where_it_goes(tmp_path, name, head):
    path = tmp_path / name
    path.write_bytes(head + bytes(64))
    with pytest.raises(RecordingError, match=r"a video; .*convert .*clip\.npz.*--source video:"):
        read_recording(path)


def test_a_file_is_no_source_but_names_one():
    for text, word in (("clip.mp4", "video"), ("a/glove.npz,speed=2", "replay")):
        with pytest.raises(ConfigError, match=f"write {word}:{text}"):
            build_source(text)
    with pytest.raises(UnknownNameError, match="source 'clip'"):
        build_source("clip")
    with pytest.raises(UnknownNameError, match="layout 'manno'"):
        build_source("udp:0,layout=manno")
