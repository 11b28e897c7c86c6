"""From a recording and its commands to a trace: frames, order of fingers, self-collision."""

from dataclasses import replace
from typing import Any

import mujoco
import numpy as np
import pytest
from test_stand_ins import with_lost_meshes

from smooth_operator import LANDMARKS, Hand, load_hand
from smooth_operator.errors import HandModelError, RecordingError
from smooth_operator.hands.capsules import parts_apart
from smooth_operator.hands.penetration import penetration_depths
from smooth_operator.hands.surfaces import tip_surface_distances
from smooth_operator.metrics.assemble import assemble_trace, sample_reach
from smooth_operator.retargeting.aligned_recording import align_recording
from smooth_operator.synthetic import SyntheticOperator
from smooth_operator.types import CommandTrajectory, HandRecording, Side

SIDES: tuple[Side, ...] = ("right", "left")


def run(side: Side, frames: int = 30) -> tuple[HandRecording, CommandTrajectory, Hand]:
    hand = load_hand("mimic_p050", side)
    recording = SyntheticOperator(seed=3, side=side).record(frames / 100)
    low, high = hand.limits.T
    q = low + (high - low) * (0.5 + 0.3 * np.sin(np.linspace(0, 2, frames)))[:, None]
    commands = CommandTrajectory(
        hand.full_configuration(q),
        hand.joint_names,
        recording.stamps,
        np.full(frames, 0.5),
        np.zeros(frames, np.int8),
    )
    return recording, commands, hand


@pytest.mark.parametrize("side", SIDES)
def test_positions_are_mujocos_in_the_palm_frame(side):
    recording, commands, hand = run(side)
    trace = assemble_trace(recording, commands, hand, reach_samples=0)
    data = mujoco.MjData(hand.model)
    for i in (0, 17):
        data.qpos[:] = commands.joint_positions[i]
        mujoco.mj_kinematics(hand.model, data)
        palm = data.body(hand.spec.palm)
        rotation = palm.xmat.reshape(3, 3)
        for f, finger in enumerate(trace.fingers):
            site = data.site(f"{finger}_tip").xpos
            expected = rotation.T @ (site - palm.xpos)
            np.testing.assert_allclose(trace.robot_tips[i, f], expected, atol=1e-6)
            k = LANDMARKS.index(f"{finger}_tip")
            np.testing.assert_array_equal(trace.robot_landmarks[i, k], trace.robot_tips[i, f])
    np.testing.assert_array_equal(trace.robot_landmarks[:, 0], [trace.robot_wrist] * len(trace))
    np.testing.assert_array_equal(trace.human, align_recording(recording, hand))


def test_commands_of_other_frames_or_joints_are_refused():
    recording, commands, hand = run("right")
    with pytest.raises(RecordingError, match="29 frames are not those of the 30 commands"):
        assemble_trace(recording[1:], commands, hand)
    shifted = replace(commands, stamps=commands.stamps + 1e-3)
    with pytest.raises(RecordingError, match="timestamps differ"):
        assemble_trace(recording, shifted, hand)
    renamed = replace(commands, joint_names=commands.joint_names[::-1])
    with pytest.raises(RecordingError, match="not those of the hand 'mimic_p050'"):
        assemble_trace(recording, renamed, hand)


@pytest.mark.parametrize("side", SIDES)
def test_reach_is_seeded_and_holds_what_poses_reach(side):
    hand = load_hand("mimic_p050", side)
    reach = sample_reach(hand, 500, seed=1)
    np.testing.assert_array_equal(reach, sample_reach(hand, 500, seed=1))
    assert not np.array_equal(reach, sample_reach(hand, 500, seed=2))
    low, high = hand.limits.T
    q = np.random.default_rng(1).uniform(low, high, (500, len(low)))
    np.testing.assert_allclose(reach, hand.tips(hand.full_configuration(q)), atol=1e-12)


def test_shapes_that_touch_in_the_neutral_pose_do_not_count():
    hand = load_hand()
    data = mujoco.MjData(hand.model)
    data.qpos[:] = hand.qpos(hand.full_configuration(hand.neutral))
    mujoco.mj_forward(hand.model, data)
    geoms = np.array(data.contact.geom)[data.contact.dist < 0]
    assert len(geoms)
    counts = {frozenset(pair) for pair in parts_apart(hand).shapes.tolist()}
    assert counts
    assert not counts & {frozenset(pair) for pair in geoms.tolist()}


def test_surfaces_of_tips_are_as_far_apart_as_their_capsules(tmp_path):
    """Against the ends and radii of the capsules; a hand without shapes has estimated ones."""
    hand = load_hand()
    low, high = hand.limits.T
    poses = hand.full_configuration(np.random.default_rng(2).uniform(low, high, (40, len(low))))
    wanted = np.random.default_rng(3).random((40, 4)) < 0.5
    found = tip_surface_distances(hand, poses, wanted)
    np.testing.assert_array_equal(np.isfinite(found), wanted)
    data = mujoco.MjData(hand.model)
    for pose, row in zip(poses, found, strict=True):
        data.qpos[:] = pose
        mujoco.mj_kinematics(hand.model, data)
        thumb, *others = (data.geom(f"{finger}_dp") for finger in hand.fingers)
        for other, distance in zip(others, row, strict=True):
            if np.isfinite(distance):
                assert distance == pytest.approx(_capsules_apart(hand, thumb, other), abs=1e-4)
    bare = with_lost_meshes(hand, r".*", tmp_path)
    estimated = tip_surface_distances(bare, poses, wanted)
    np.testing.assert_allclose(estimated, found, atol=0.006)


def _capsules_apart(hand: Hand, *geoms: Any) -> float:
    """Least distance of points on the axes of two capsules, less their radii [m]."""
    axes = []
    for geom in geoms:
        along = geom.xmat.reshape(3, 3)[:, 2] * hand.model.geom_size[geom.id][1]
        axes.append(geom.xpos + np.linspace(-1, 1, 801)[:, None] * along)
    near = np.sqrt(((axes[0][:, None] - axes[1]) ** 2).sum(axis=-1).min())
    return float(near - sum(hand.model.geom_size[geom.id][0] for geom in geoms))


def test_a_pose_that_is_not_finite_has_no_depth_and_bad_shapes_are_refused():
    hand = load_hand()
    q = np.tile(hand.full_configuration(hand.neutral), (2, 1))
    q[0, 3] = np.nan
    depths = penetration_depths(hand, q)
    assert np.isnan(depths[0])
    assert depths[1] == 0.0
    with pytest.raises(HandModelError, match=r"shape \(T, 20\)"):
        penetration_depths(hand, q[:, :16])
    every = np.ones((2, 4), bool)
    assert np.isfinite(tip_surface_distances(hand, q, every)).tolist() == [[False] * 4, [True] * 4]
    with pytest.raises(HandModelError, match=r"shapes \(2, 20\) and \(2, 4\), not"):
        tip_surface_distances(hand, q, every[:, :3])
