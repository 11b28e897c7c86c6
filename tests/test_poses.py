"""Poses of the wrist: algebra against SciPy, conversions against points, fields of frames."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from smooth_operator import HandFrame, HandRecording, poses
from smooth_operator.errors import ConfigError, RecordingError
from smooth_operator.poses import WORLD_AXES, WRIST_AXES
from smooth_operator.retargeting.flat_hand import FLAT_HAND

RNG = np.random.default_rng(7)
TURNS = Rotation.random(200, random_state=3)
POSES = np.concatenate([RNG.normal(size=(200, 3)), TURNS.as_quat(scalar_first=True)], axis=1)


def same_rotation(a: np.ndarray, b: np.ndarray) -> bool:
    return bool(np.allclose(np.abs((a * b).sum(axis=-1)), 1.0, atol=1e-12))


def test_rotations_agree_with_scipy():
    q = POSES[:, 3:]
    assert np.allclose(poses.rotation_matrices(q), TURNS.as_matrix(), atol=1e-14)
    assert same_rotation(poses.quaternions(TURNS.as_matrix()), q)
    assert np.allclose(poses.rotation_vectors(q), TURNS.as_rotvec(), atol=1e-13)
    assert np.allclose(poses.rotation_vectors(-q), TURNS.as_rotvec(), atol=1e-13)
    assert same_rotation(poses.from_rotation_vectors(TURNS.as_rotvec()), q)
    other = TURNS[::-1]
    product = poses.multiply(q, other.as_quat(scalar_first=True))
    assert same_rotation(product, (TURNS * other).as_quat(scalar_first=True))


@pytest.mark.parametrize("signs", [(1, 1, 1), (1, -1, -1), (-1, 1, -1), (-1, -1, 1)])
def test_half_turns_keep_their_digits(signs):
    q = poses.quaternions(np.diag(np.array(signs, float)))
    assert np.abs(q).max() == 1.0
    assert np.allclose(poses.rotation_matrices(q), np.diag(signs), atol=0)


def test_poses_compose_as_their_matrices():
    a, b = POSES, POSES[::-1]
    assert np.allclose(
        poses.matrices(poses.compose(a, b)), poses.matrices(a) @ poses.matrices(b), atol=1e-12
    )
    assert np.allclose(poses.separation(poses.compose(a, poses.relative(a, b)), b), 0, atol=1e-7)
    assert np.allclose(poses.compose(poses.invert(a), a)[:, :3], 0, atol=1e-12)
    assert np.allclose(poses.separation(poses.from_matrices(poses.matrices(a)), a), 0, atol=1e-7)


@pytest.mark.parametrize("world", ["openxr", "unity", "z_up_y_forward"])
def test_a_converted_pose_moves_the_same_points(world):
    # A point that the tracker knows in its wrist frame, taken to our world on both ways.
    wrist = "unity" if world == "unity" else "openxr"
    m, b = WORLD_AXES[world], WRIST_AXES[wrist]
    theirs = RNG.normal(size=(200, 3))
    in_their_world = POSES[:, :3] + poses.rotate(POSES[:, 3:], theirs)
    converted = poses.to_ours(POSES, m, b)
    ours = converted[:, :3] + poses.rotate(converted[:, 3:], theirs @ b.T)
    assert np.allclose(ours, poses.points_to_ours(in_their_world, m), atol=1e-12)


def test_the_world_is_forward_left_up():
    ahead_and_up = {"openxr": (0, 2, -1), "unity": (0, 2, 1), "z_up_y_forward": (0, 1, 2)}
    right = dict.fromkeys(ahead_and_up, (1, 0, 0))
    for name in ahead_and_up:
        assert poses.points_to_ours(ahead_and_up[name], WORLD_AXES[name]).tolist() == [1, 0, 2]
        assert poses.points_to_ours(right[name], WORLD_AXES[name]).tolist() == [0, -1, 0]


def test_axes_that_do_not_fit_are_refused():
    with pytest.raises(ConfigError, match="same handedness"):
        poses.to_ours(POSES, WORLD_AXES["unity"], WRIST_AXES["openxr"])
    with pytest.raises(ConfigError, match="three different axes"):
        poses.axes("x", "-x", "z")
    with pytest.raises(ConfigError, match="an axis must be"):
        poses.axes("x", "up", "z")


@pytest.mark.parametrize("side", ["right", "left"])
def test_the_wrist_of_landmarks(side):
    # FLAT_HAND lies in the palmar, radial, distal axes of a right hand.
    sign = 1 if side == "right" else -1
    palm_down = FLAT_HAND[:, [2, 1, 0]] * (1, sign, -1)
    found = poses.wrist_from_landmarks(palm_down, side)
    assert poses.separation(found, poses.IDENTITY)[1] < 0.05
    moved = palm_down @ TURNS[0].as_matrix().T + (1, 2, 3)
    expected = poses.compose(np.r_[1.0, 2, 3, TURNS[0].as_quat(scalar_first=True)], found)
    assert np.allclose(
        poses.separation(poses.wrist_from_landmarks(moved, side), expected), 0, atol=1e-7
    )
    for broken in (palm_down * (1, 0, 0), np.where(np.eye(21, 1) > 0, np.nan, palm_down)):
        assert not poses.is_valid(poses.wrist_from_landmarks(broken, side))


def test_frames_carry_a_wrist():
    frame = HandFrame(FLAT_HAND, 0.0, T_world_wrist=[1, 2, 3, 0, 0, 0, 2], world="room")
    assert frame.T_world_wrist.tolist() == [1, 2, 3, 0, 0, 0, 1]
    assert poses.is_valid(frame.T_world_wrist)
    assert not poses.is_valid(HandFrame(FLAT_HAND).T_world_wrist)
    with pytest.raises(RecordingError, match=r"T_world_wrist must have shape \(7,\)"):
        HandFrame(FLAT_HAND, T_world_wrist=np.zeros((4, 4)))
    for bad in ([0, 0, 0, 0, 0, 0, 0], [np.nan, 0, 0, 1, 0, 0, 0], [0, 0, 0, np.inf, 0, 0, 0]):
        lost = HandFrame(FLAT_HAND, T_world_wrist=bad).T_world_wrist
        assert np.isnan(lost).all()


def test_recordings_carry_a_wrist():
    hands = np.repeat(FLAT_HAND[None], 200, axis=0)
    stamps = np.arange(200.0)
    recording = HandRecording(hands, stamps, T_world_wrist=POSES, world="room")
    assert np.allclose(recording.T_world_wrist, POSES, atol=1e-15)
    again = HandRecording(hands, stamps, T_world_wrist=recording.T_world_wrist)
    assert np.array_equal(again.T_world_wrist, recording.T_world_wrist)  # to the last bit
    part = recording[10:12]
    assert np.array_equal(part.T_world_wrist, recording.T_world_wrist[10:12])
    frame = part[1]
    assert (part.world, frame.world) == ("room", "room")
    assert np.array_equal(frame.T_world_wrist, recording.T_world_wrist[11])
    with pytest.raises(RecordingError, match=r"T_world_wrist must have shape \(200, 7\)"):
        HandRecording(hands, stamps, T_world_wrist=POSES[:-1])


def test_the_example_of_the_conventions():
    # 1 m up and 0.5 m ahead, from a left-handed tracker; then 0.1 m to its right
    unity = np.array([[0.0, 1.0, 0.5, 1, 0, 0, 0], [0.1, 1.0, 0.5, 1, 0, 0, 0]])
    wrist = poses.to_ours(unity, WORLD_AXES["unity"], WRIST_AXES["unity"])
    assert np.allclose(wrist[0], [0.5, 0.0, 1.0, 1, 0, 0, 0])
    assert np.allclose(poses.relative(wrist[0], wrist[1])[:3], [0.0, -0.1, 0.0])
    assert np.allclose(poses.separation(wrist[0], wrist[1]), [0.1, 0.0])


def test_one_pair_is_turned_as_rows_are():
    rng = np.random.default_rng(0)
    q = rng.normal(size=(200, 4))
    q /= np.linalg.norm(q, axis=1, keepdims=True)
    q[:6] = [
        [1, 0, 0, 0],
        [-1, 0, 0, 0],
        [np.nan] * 4,
        [-1, 1e-13, 0, 0],
        [0, 1, 0, 0],
        [-0.0, 0, 1, 0],
    ]
    r = np.roll(q, 1, axis=0)
    vectors = rng.normal(size=(200, 3))
    vectors[:4] = [[0, 0, 0], [np.nan, 0, 0], [1e-14, 0, 0], [np.pi, 0, 0]]
    one = np.array([poses.multiply(a, b) for a, b in zip(q, r, strict=True)])
    np.testing.assert_array_equal(one, poses.multiply(q, r))
    one = np.array([poses.rotation_vectors(a) for a in q])
    np.testing.assert_allclose(one, poses.rotation_vectors(q), atol=1e-15, rtol=1e-12)
    one = np.array([poses.from_rotation_vectors(v) for v in vectors])
    np.testing.assert_allclose(one, poses.from_rotation_vectors(vectors), atol=1e-15)
    assert np.isnan(poses.from_rotation_vectors(np.array([np.inf, 0, 0]))).all()
