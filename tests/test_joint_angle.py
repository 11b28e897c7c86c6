"""Joint angles: their definitions, the map measured from them, and the method around it."""

from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np
import pytest
from trees import limited_poses, pincer, random_rotations, unit

from smooth_operator.baselines.joint_angle import (
    JOINT_ANGLES,
    JointAngleConfig,
    JointAngleMap,
    joint_angles,
    joint_map,
)
from smooth_operator.errors import HandModelError, UnknownNameError
from smooth_operator.formats.readers import read_recording
from smooth_operator.hands.hand import Hand
from smooth_operator.hands.registry import load_hand
from smooth_operator.hands.spec import FingerSpec, HandSpec, JointMap, Point
from smooth_operator.landmarks import FINGERS, LANDMARKS, WRIST
from smooth_operator.metrics import evaluate
from smooth_operator.metrics.assemble import assemble_trace
from smooth_operator.retargeting.alignment import palm_alignment
from smooth_operator.retargeting.palm import PalmAxes, human_palm_axes, palm_axes
from smooth_operator.retargeting.retargeter import Retargeter
from smooth_operator.synthetic.hand_anatomy import (
    LOWER,
    UPPER,
    couple,
    draw_anatomy,
    mirror,
    pose_hand,
)

SIDES: tuple[Literal["right", "left"], ...] = ("right", "left")
# distal, radial, palmar are x, y, z: right-handed, as of a left hand seen from its palm
AXES = PalmAxes(*np.eye(3))
BONES = np.array([0.045, 0.027, 0.02])


def long_finger(abduction: float, *slopes: float) -> np.ndarray:
    """(4, 3) a finger in one plane, each bone with its slope out of distal."""
    slope = np.array(slopes)
    bones = np.stack(
        [np.cos(slope) * np.cos(abduction), np.cos(slope) * np.sin(abduction), np.sin(slope)], -1
    )
    return np.concatenate([np.zeros((1, 3)), np.cumsum(BONES[:, None] * bones, axis=0)])


def chain(*bones: np.ndarray) -> np.ndarray:
    return np.concatenate([np.zeros((1, 3)), np.cumsum(BONES[:, None] * np.stack(bones), axis=0)])


def hand_of(thumb: np.ndarray, *fingers: np.ndarray) -> np.ndarray:
    """(21, 3) landmarks; fingers that are not given are straight."""
    straight = [long_finger(0, 0, 0, 0)] * (4 - len(fingers))
    return np.concatenate([np.zeros((1, 3)), thumb, *fingers, *straight])


def named(angles: np.ndarray) -> dict[str, float]:
    return dict(zip(JOINT_ANGLES, angles.tolist(), strict=True))


def turned(vector: np.ndarray, axis: np.ndarray, angle: float) -> np.ndarray:
    """Rodrigues."""
    axis = unit(axis)
    return (
        vector * np.cos(angle)
        + np.cross(axis, vector) * np.sin(angle)
        + axis * (axis @ vector) * (1 - np.cos(angle))
    )


def operator(angles: np.ndarray, side: str = "right") -> np.ndarray:
    """(T, 21, 3) landmarks of the synthetic operator."""
    poses = pose_hand(draw_anatomy(0.19, 1), angles)
    return (poses if side == "right" else mirror(poses)).landmarks


def operator_poses(count: int, seed: int = 0) -> np.ndarray:
    """(T, 20) joint angles of the synthetic operator, anywhere in their ranges."""
    free = np.random.default_rng(seed).uniform(LOWER, UPPER, (count, 20))
    return couple(np.delete(free, (7, 11, 15, 19), axis=1))


@pytest.fixture(scope="module")
def right() -> Retargeter:
    return Retargeter(config=JointAngleConfig(), rate=100.0)


@pytest.mark.parametrize("abduction", [-0.4, 0.0, 0.3])
@pytest.mark.parametrize(
    ("mcp", "pip", "dip"),
    [(0.3, 0.4, 0.2), (-0.3, 0.0, 0.1), (1.4, 1.8, 1.2), (0.0, 1.7, 1.1), (0.5, -0.1, -0.3)],
)
def test_known_angles_of_a_finger(abduction, mcp, pip, dip):
    finger = long_finger(abduction, mcp, mcp + pip, mcp + pip + dip)
    angles = named(joint_angles(hand_of(chain(*np.eye(3)), finger), AXES))
    seen = (np.cos([mcp, mcp + pip, mcp + pip + dip]) ** 2).sum()
    if seen > 1.5:
        assert angles["index_mcp_abduction"] == pytest.approx(abduction, abs=1e-9)
        assert angles["index_mcp"] == pytest.approx(mcp, abs=1e-9)
        assert angles["index_pip"] == pytest.approx(pip, abs=1e-9)
        assert angles["index_dip"] == pytest.approx(dip, abs=1e-9)
    else:  # less of the plane is seen, so the abduction is drawn to zero, never past it
        assert abs(angles["index_mcp_abduction"]) <= abs(abduction) + 1e-9
        assert angles["index_mcp_abduction"] * abduction >= 0
        total = angles["index_mcp"] + angles["index_pip"] + angles["index_dip"]
        assert total == pytest.approx(mcp + pip + dip, abs=0.1)


def test_abduction_is_zero_where_no_plane_shows():
    """A straight finger at a right angle to the palm: no jump, however it trembles."""
    rng, reference = (
        np.random.default_rng(0),
        hand_of(chain(*np.eye(3)), long_finger(0, 1.57, 1.57, 1.57)),
    )
    shaken = reference + rng.normal(0, 1e-4, (200, 21, 3))
    angles = joint_angles(shaken, AXES)[:, 4:8]
    assert np.abs(angles[:, 0]).max() < 0.01
    assert np.abs(angles - joint_angles(reference, AXES)[4:8]).max() < 0.06


@pytest.mark.parametrize(("mcp", "ip"), [(0.0, 0.0), (0.5, 0.7), (-0.2, -0.4), (0.9, -0.3)])
def test_known_angles_of_a_thumb(mcp, ip):
    """It flexes about the axis square to the metacarpal and to the base of the little finger."""
    metacarpal = unit(np.array([0.7, 0.5, 0.4]))
    axis = np.cross(metacarpal, [0.5, -1.0, 0.0])
    bones = metacarpal, turned(metacarpal, axis, mcp), turned(metacarpal, axis, mcp + ip)
    angles = named(joint_angles(hand_of(chain(*bones)), AXES))
    assert angles["thumb_mcp"] == pytest.approx(mcp, abs=1e-9)
    assert angles["thumb_ip"] == pytest.approx(ip, abs=1e-9)


@pytest.mark.parametrize(
    ("flexion", "abduction"), [(0, 0), (0.8, 0), (-1.2, 0), (0, 1), (0.3, 0.9)]
)
def test_where_the_thumb_points(flexion, abduction):
    """The rotation vector out of distal, whatever way the bones go there."""
    size = np.hypot(flexion, abduction)
    ray = np.array([np.cos(size), *(np.array([-flexion, abduction]) * np.sinc(size / np.pi))])
    bent = chain(*np.eye(3)[[2, 0, 1]])
    bent[3] = 0.08 * ray
    angles = named(joint_angles(hand_of(bent), AXES))
    assert angles["thumb_flexion"] == pytest.approx(flexion, abs=1e-9)
    assert angles["thumb_abduction"] == pytest.approx(abduction, abs=1e-9)


def test_angles_are_those_of_the_hand_wherever_it_is():
    """They do not depend on place, turn and size, and a mirror image is the other hand's."""
    rng = np.random.default_rng(0)
    right = operator(operator_poses(20))
    expected = joint_angles(right, palm_axes(right, "right"))
    moved = 1.3 * right @ random_rotations(rng).T + rng.normal(0, 1, 3)
    np.testing.assert_allclose(joint_angles(moved, palm_axes(moved, "right")), expected, atol=1e-9)
    left = right * (1, -1, 1)
    np.testing.assert_allclose(joint_angles(left, palm_axes(left, "left")), expected, atol=1e-12)
    wrong = joint_angles(left, palm_axes(left, "right"))
    assert np.abs(wrong - expected).max() > 1


def test_a_missing_landmark_costs_its_finger_only():
    landmarks = operator(operator_poses(1))[0]
    axes = palm_axes(landmarks, "right")
    whole = joint_angles(landmarks, axes)
    landmarks[11] = np.nan  # middle DIP
    angles = joint_angles(landmarks, axes)
    assert np.isnan(angles[8:12]).any()
    others = np.delete(np.arange(20), np.s_[8:12])
    np.testing.assert_array_equal(angles[others], whole[others])


def own_landmarks(hand: Hand, q: np.ndarray) -> np.ndarray:
    """(..., 21, 3) the robot's own landmarks, NaN for those that it lacks."""
    landmarks = np.full((*q.shape[:-1], 21, 3), np.nan)
    landmarks[..., [LANDMARKS.index(n) for n in hand.tree.names], :] = hand.landmark_positions(q)
    return landmarks


def positions(hand: Hand, landmarks: np.ndarray) -> np.ndarray:
    return JointAngleMap(hand).positions(landmarks)


@pytest.mark.parametrize("side", SIDES)
def test_the_robots_own_landmarks_give_its_pose_back(side):
    """A line through a median slope, so not exact: tolerances are what a bent line leaves.

    Finger flexions are nearly straight lines. Abduction can't be seen of a finger that stands out
    of the palm. The thumb's two base joints turn about skew axes, and are the least straight.
    """
    hand = load_hand("mimic_p050", side)
    q = limited_poses(np.random.default_rng(3), hand.limits, 500)
    error = np.abs(positions(hand, own_landmarks(hand, q)) - q)
    names = np.array(hand.actuated_names)
    thumb = np.char.startswith(names, "thumb")
    spread = np.char.endswith(names, "base2mcp")
    assert np.median(error) < 0.02
    assert np.median(error[:, thumb]) < 0.08
    assert np.percentile(error[:, thumb], 95) < 0.25
    assert np.percentile(error[:, spread], 95) < 0.22
    assert np.percentile(error[:, ~thumb & ~spread], 95) < 0.05


def test_a_joint_that_bends_two_phalanges_bends_each_as_the_human_does(right):
    """Not half as far: a human who bends PIP and DIP by 0.6 each gets 0.6 in both."""
    hand = load_hand()
    frames = np.zeros((3, 20))
    frames[1, [6, 7]] = 0.6
    frames[2, 6] = 0.6  # PIP alone: the robot can't, so the curl is shared
    landmarks = operator(frames)
    aligned = palm_alignment(landmarks, hand).apply(landmarks)
    joints = positions(hand, aligned)
    bend = joints[:, hand.actuated_names.index("index_pp2mp")]
    assert bend[1] - bend[0] == pytest.approx(0.6, abs=0.03)
    assert bend[2] - bend[0] == pytest.approx(0.3, abs=0.03)
    command = right(landmarks[1]).command
    at = dict(zip(command.joint_names, command.joint_positions, strict=True))
    assert at["index_mp2dp"] == at["index_pp2mp"] == pytest.approx(bend[1], abs=1e-5)


def pincer_with_all_points(folder: Path, **attributes: str) -> HandSpec:
    """Thumb of two hinges, index of three, the last of which follows the one before."""
    equality = '<joint joint1="i3" joint2="i2" polycoef="0 1 0 0 0"/>'
    spec = pincer(folder, equality=equality, **attributes)
    thumb = FingerSpec(
        "thumb", (Point("t1"), Point("t2"), Point("t2", (0, 0, 0.02)), Point("t2", (0, 0, 0.035)))
    )
    return replace(spec, fingers=(thumb, spec.fingers[1]))


def test_a_hand_of_three_fingers():
    """Joints of the fingers that are not in the description stay at neutral."""
    spec = load_hand().spec
    hand = load_hand(replace(spec, fingers=tuple(spec.fingers[i] for i in (0, 1, 4))))
    mapping = JointAngleMap(hand)
    assert mapping.needs == (1, 2, 3, 4, 5, 6, 7, 8, 17, 18, 19, 20)
    for row, whole in zip(mapping.rows, joint_map(load_hand()), strict=True):
        if row.joint.startswith(("middle", "ring")):
            assert not row.gains
            assert row.offset == pytest.approx(spec.neutral[row.joint], abs=1e-4)
        else:
            assert row == whole
    landmarks = own_landmarks(hand, hand.neutral)
    assert np.isnan(landmarks).any()  # two fingers are not there
    np.testing.assert_allclose(mapping.positions(landmarks), hand.neutral, atol=1e-3)


def test_a_finger_without_its_middle_is_refused(tmp_path):
    spec = pincer(tmp_path)  # its thumb has a base and a tip only
    with pytest.raises(HandModelError, match=r"thumb_mcp.*thumb_ip.*'t1', 't2'.*joint_map"):
        JointAngleConfig().build(load_hand(spec))


def test_rows_in_the_description_serve_such_a_finger(tmp_path):
    rows = (
        JointMap("t1", offset=0.1, gains={"thumb_flexion": -0.5}),
        JointMap("t2", gains={"thumb_abduction": 1.0, "pinky_pip": 0.2}),
    )
    hand = load_hand(replace(pincer(tmp_path), joint_map=rows))
    mapping = JointAngleMap(hand)
    assert mapping.rows[:2] == rows
    assert {row.joint for row in mapping.rows[2:]} == {"i1", "i2"}
    assert set(mapping.needs) == {1, 2, 3, 4, 5, 6, 7, 8, 17, 18, 19, 20}
    landmarks = operator(operator_poses(20))
    aligned = palm_alignment(landmarks, hand).apply(landmarks)
    angles = joint_angles(aligned, human_palm_axes(hand))
    expected = np.clip(0.1 - 0.5 * angles[:, 0], *hand.limits[0])
    np.testing.assert_allclose(positions(hand, aligned)[:, 0], expected, atol=1e-4)


def test_rows_are_checked():
    spec = load_hand().spec
    with pytest.raises(UnknownNameError, match="index_base2mcp"):
        joint_map(load_hand(replace(spec, joint_map=(JointMap("index_base"),))))
    with pytest.raises(UnknownNameError, match="actuated"):  # a follower is not commanded
        joint_map(load_hand(replace(spec, joint_map=(JointMap("index_mp2dp"),))))
    row = JointMap("index_base2mcp", gains={"index_abduction": 1.0})
    with pytest.raises(UnknownNameError, match="index_mcp_abduction"):
        joint_map(load_hand(replace(spec, joint_map=(row,))))
    with pytest.raises(HandModelError, match=r"more than one row.*index_base2mcp"):
        replace(spec, joint_map=(JointMap("index_base2mcp"), JointMap("index_base2mcp")))
    with pytest.raises(HandModelError, match="finite"):
        JointMap("index_base2mcp", offset=float("nan"))


def test_a_joint_that_moves_no_angle_stays_at_neutral(tmp_path):
    spec = pincer_with_all_points(tmp_path)
    text = spec.model.read_text().replace(
        '<joint name="t2" axis="1 0 0"', '<joint name="t2" axis="0 0 1"'
    )  # the thumb's points now lie on the axis of its second joint
    spec.model.write_text(text)
    hand = load_hand(replace(spec, neutral={"t2": 0.4}))
    assert dict(zip(hand.actuated_names, joint_map(hand), strict=True))["t2"] == JointMap("t2", 0.4)


def test_fingers_follow_the_humans_fingers(right):
    """Closing any human finger closes that robot finger, and no other."""
    frames = np.zeros((5, 20))
    for f in range(1, 5):
        frames[f, 4 * f + 1 : 4 * f + 4] = (0.5, 0.7, 0.45)
    q = np.stack([right(landmarks).command.joint_positions for landmarks in operator(frames)])
    moved = q[1:] - q[0]
    for f, finger in enumerate(FINGERS[1:]):
        for joint, change in zip(right.hand.joint_names, moved[f], strict=True):
            if joint.startswith(finger) and not joint.endswith("base2mcp"):
                assert change > 0.4, joint
            elif not joint.startswith(finger):
                assert abs(change) < 1e-5, joint


def test_fingers_spread_as_far_as_the_humans():
    """Poses in which a robot finger shows no plane to bend in do not make the map steeper."""
    hand = load_hand()
    frames = np.zeros((3, 20))
    frames[:, [5, 9, 13, 17]] = 0.3
    frames[1, [4, 8, 12, 16]], frames[2, [4, 8, 12, 16]] = 0.05, -0.05
    landmarks = operator(frames)
    aligned = palm_alignment(landmarks, hand).apply(landmarks)
    q = positions(hand, aligned)
    human = joint_angles(aligned, human_palm_axes(hand))
    for f, finger in enumerate(FINGERS[1:], start=1):
        robot = np.diff(q[1:, hand.actuated_names.index(f"{finger}_base2mcp")])
        assert robot == pytest.approx(np.diff(human[1:, 4 * f]), rel=0.05)


def test_tracking_loss_is_of_the_keyvectors(right):
    hand, landmarks = right.hand, operator(operator_poses(1, seed=4))[0]
    result = right(landmarks)
    aligned = palm_alignment(landmarks, hand).apply(landmarks)
    human = np.stack([aligned[WRIST], *aligned[[4, 8, 12, 16, 20]]])
    robot = np.stack([hand.wrist, *hand.tips(result.command.joint_positions)])
    i, j = np.triu_indices(6, 1)
    size = np.abs((robot[j] - robot[i]) - (human[j] - human[i]))
    loss = np.where(size < 0.02, size**2 / 0.04, size - 0.01).sum()
    assert result.tracking_loss == pytest.approx(loss, rel=1e-3)


@pytest.mark.shared
def test_on_a_real_recording_it_beats_the_authors(shared, right):
    """Their joint angles: thumb cosine 0.51, motion 0.37, out of the limits on 92 % of frames."""
    recording = read_recording(shared / "recordings/manus_right_subject-000_run-010.npz")[:500]
    commands, loss = right.run(recording)
    values = evaluate(assemble_trace(recording, commands, right.hand, reach_samples=0))
    assert values["cosine_similarity"] > 0.96
    assert values["cosine_similarity_all"] > 0.92
    assert values["motion_preservation"] > 0.84
    assert values["velocity_correlation"] > 0.9
    assert values["flatness"] < 1.1e-5
    assert values["limit_violation_share"] == 0
    assert values["frozen_share"] == 0
    assert np.isfinite(loss).all()
