"""Joints between forearm and palm: their angles, limits and reference, and their names in files."""

import re
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
import viser

from smooth_operator import (
    Hand,
    HandFrame,
    HandSpec,
    Retargeter,
    load_hand,
    poses,
    read_commands,
    read_recording,
)
from smooth_operator.errors import ConfigError, HandModelError, UnknownNameError
from smooth_operator.formats.episode import Episode
from smooth_operator.hand_discovery.discover import discover
from smooth_operator.hand_discovery.joints import check_wrist_joints
from smooth_operator.hand_discovery.landmarks import Discovery
from smooth_operator.hand_files.spec_writer import write_hand_spec
from smooth_operator.hands.hand import load_hand_spec
from smooth_operator.hands.spec_file import read_hand_spec
from smooth_operator.hands.wrist_joints import with_wrist_joints
from smooth_operator.metrics.assemble import assemble_trace
from smooth_operator.retargeting.flat_hand import FLAT_HAND
from smooth_operator.simulation.arms.arm import hand_directions
from smooth_operator.simulation.physics import HandPhysics
from smooth_operator.synthetic import SyntheticOperator
from smooth_operator.teleop import TeleopRequest, teleoperate
from smooth_operator.teleop.pages.live.live_scene import LiveScene
from smooth_operator.teleop.recording import write_episode
from smooth_operator.teleop.runtime.pipeline import HandPipeline
from smooth_operator.teleop.runtime.settings import LimitsConfig, LoopConfig
from smooth_operator.teleop.sinks.tick import Mode, Tick
from smooth_operator.teleop.sources.live import Arrival
from smooth_operator.types import HandRecording
from smooth_operator.wrist_following import PalmMotion, WristFollower

PERIOD = 0.01
AXES = ("1 0 0", "0 1 0", "0 0 1")
"""Axes in the palm frame of ORCA that flex the wrist, deviate it, and turn it about the forearm."""
LIMITS = LimitsConfig(velocity=3.0, acceleration=40.0)
REFERENCE = poses.from_rotation_vectors(np.array([0.4, -0.7, 1.1]))  # any orientation in the room


def pose(turn: np.ndarray) -> np.ndarray:
    return np.concatenate([[0.1, 0.2, 0.3], turn])


def human_turn(hand: Hand, q: np.ndarray) -> np.ndarray:
    """(4,) rotation of a human wrist, from its own frame at the reference, that bends it as the
    joints bend the robot's."""
    distal, _, palmar = hand_directions(hand)
    axes = np.stack([distal, np.cross(-palmar, distal), -palmar])
    turned = poses.rotation_matrices(PalmMotion(hand).at(q)[3:])
    return poses.quaternions(axes @ turned @ axes.T)


def follow(hand: Hand, *turns: np.ndarray) -> np.ndarray:
    follower = WristFollower(hand)
    for turn in (np.array([1.0, 0, 0, 0]), *turns):
        follower.follow(pose(poses.multiply(REFERENCE, turn)))
    return follower.target


@pytest.mark.parametrize(
    ("name", "side"), [("shadow_hand", "right"), ("shadow_hand", "left"), ("orca_v1", "left")]
)
def test_the_joints_bend_as_the_human_wrist_does_however_the_forearm_turns(name, side):
    hand = load_hand(name, side)
    limits = with_wrist_joints(hand).limits[-len(hand.spec.wrist_joints) :]
    for q in np.random.default_rng(0).uniform(*limits.T, (8, len(limits))):
        turn = human_turn(hand, q)
        np.testing.assert_allclose(follow(hand, turn), q, atol=1e-9)
        pronated = poses.multiply(poses.from_rotation_vectors(np.array([1.3, 0, 0])), turn)
        np.testing.assert_allclose(follow(hand, pronated), q, atol=1e-9)
    beyond = follow(hand, human_turn(hand, limits[:, 0] - 0.3))
    np.testing.assert_array_equal(beyond, limits[:, 0])  # a wrist that bends further


def test_a_palm_that_bends_down_and_to_the_thumb_flexes_and_deviates():
    # The wrist frame of docs/reference/conventions.md: y to the left, z out of the back of the hand
    down, left = (poses.from_rotation_vectors(0.1 * axis) for axis in np.eye(3)[1:])
    right, other = load_hand("shadow_hand", "right"), load_hand("shadow_hand", "left")
    np.testing.assert_allclose(follow(right, down), [0.0, 0.1], atol=0.01)
    np.testing.assert_allclose(follow(right, left), [0.1, 0.0], atol=0.01)
    np.testing.assert_allclose(follow(other, down), [0.0, 0.1], atol=0.01)
    np.testing.assert_allclose(follow(other, left), [-0.1, 0.0], atol=0.01)
    # ORCA's hinge lies across the palm, so deviation alone does not move it.
    (flexed,) = follow(load_hand("orca_v2", "left"), down)
    (deviated,) = follow(load_hand("orca_v2", "left"), left)
    assert flexed == pytest.approx(0.1, abs=0.01)
    assert abs(deviated) < 0.01


def test_a_tracker_that_sees_the_forearm_needs_no_reference():
    hand = load_hand("shadow_hand")
    q = np.array([-0.3, 0.2])
    seen = poses.rotate(poses.conjugate(human_turn(hand, q)), np.array([1.0, 0.0, 0.0]))
    follower = WristFollower(hand)
    follower.follow(None, 2.0 * seen)
    np.testing.assert_allclose(follower.target, q, atol=1e-9)
    follower.release(q)
    follower.follow(pose(REFERENCE), np.full(3, np.nan))  # the forearm is lost
    np.testing.assert_array_equal(follower.target, q)
    follower.follow(pose(REFERENCE), np.array([1.0, 0.0, 0.0]))
    np.testing.assert_allclose(follower.target, [0.0, 0.0], atol=1e-9)


@pytest.mark.parametrize("suffix", [".mcap", ".npz", ".hdf5"])
def test_files_keep_the_direction_of_the_forearm(tmp_path, suffix):
    if suffix == ".hdf5":
        pytest.importorskip("h5py")
    made = SyntheticOperator(seed=1).record(0.1)
    forearm = np.tile([1.0, 0.0, 0.0], (len(made), 1))
    forearm[2] = np.nan
    path = tmp_path / f"hand{suffix}"
    write_episode(path, Episode(replace(made, forearm=forearm)))
    np.testing.assert_array_equal(read_recording(path).forearm, forearm)


def test_the_wrist_joints_are_those_between_forearm_and_palm(tmp_path):
    hand = load_hand("shadow_hand")
    whole = with_wrist_joints(hand)
    assert whole.joint_names == (*hand.joint_names, "rh_WRJ2", "rh_WRJ1")
    assert whole.actuated_names == (*hand.actuated_names, "rh_WRJ2", "rh_WRJ1")
    np.testing.assert_allclose(whole.limits[-2:], [[-0.5236, 0.1745], [-0.6981, 0.4887]], atol=1e-4)
    q = whole.neutral
    np.testing.assert_array_equal(whole.landmark_positions(q), hand.landmark_positions(q[:-2]))
    mimic = load_hand("mimic_p050")
    assert with_wrist_joints(mimic) is mimic
    write_hand_spec(hand.spec, tmp_path / "hand.toml")
    assert read_hand_spec(tmp_path / "hand.toml").wrist_joints == ("rh_WRJ2", "rh_WRJ1")

    def described(*names: str) -> HandSpec:
        return replace(hand.spec, wrist_joints=names)

    for wrong in (("rh_WRJ1", "rh_WRJ2"), ("rh_FFJ4",), ("rh_WRJ2", "rh_WRJ1", "rh_FFJ4")):
        with pytest.raises(HandModelError, match=r"the model has \['rh_WRJ2', 'rh_WRJ1'\] above"):
            with_wrist_joints(load_hand_spec(described(*wrong)))
    with pytest.raises(UnknownNameError, match="rh_WRJ3"):
        load_hand_spec(described("rh_WRJ3"))


def discovered(folder: Path, joints: str) -> Discovery:
    """What is found in the model of ORCA with other joints between base and palm."""
    model = load_hand("orca_v1").spec.model.read_text(encoding="utf-8")
    own = re.search(r'<joint name="right_wrist"[^>]*/>', model)
    assert own is not None
    path = folder / "orca.xml"
    path.write_text(model.replace(own[0], joints), encoding="utf-8")
    return discover(path)


def hinge(name: str, axis: str, ends: str = "-0.6 0.6") -> str:
    return f'<joint name="{name}" axis="{axis}" range="{ends}"/>'


def test_hands_add_finds_the_wrist_joints_and_hands_check_names_them(tmp_path):
    flexes, deviates, rolls = (hinge(*each) for each in zip("fdr", AXES, strict=True))
    found = discovered(tmp_path, rolls + deviates + flexes)
    assert found.spec.wrist_joints == ("d", "f")
    check = check_wrist_joints(load_hand_spec(found.spec))
    assert (check.verdict, check.measured) == ("ok", "d -34° to 34°, f -34° to 34°")
    rolling = load_hand_spec(replace(found.spec, wrist_joints=("r", "d")))
    assert "'r' turns about the forearm" in check_wrist_joints(rolling).measured
    named = discovered(tmp_path, hinge("wrist", AXES[0]))
    (finding,) = (f for f in named.findings if f.subject == "wrist joints")
    assert (finding.value, finding.confidence) == ("wrist", 0.95)
    arm = discovered(tmp_path, "".join(hinge(f"j{i}", AXES[i % 3]) for i in range(6)))
    assert arm.spec.wrist_joints == ()


def test_hands_show_lists_the_wrist_joints(run):
    status, out, _ = run("hands", "show", "orca_v1", "--no-view")
    assert status == 0
    assert "wrist joints: right_wrist\n" in out
    assert "right_wrist  -0.6736" in re.sub(" +", "  ", out)


@pytest.fixture(scope="module")
def shadow() -> Retargeter:
    built = Retargeter("shadow_hand", method="joint_angle")  # the quickest to compile
    built.warm_up()
    return built


class Run:
    """A pipeline, its time, and all that it commanded."""

    def __init__(self, retargeter: Retargeter, wrist_joints: bool = True) -> None:
        config = LoopConfig(rate=1 / PERIOD, limits=LIMITS)
        self.pipeline = HandPipeline(
            retargeter, config, clock=lambda: self.time, wrist_joints=wrist_joints
        )
        self.time, self.ticks = 0.0, list[Tick]()

    def frames(self, count: int, turn: np.ndarray | None) -> np.ndarray:
        """(2,) the last command of the wrist, after frames with a rotation of the wrist."""
        place = None if turn is None else pose(poses.multiply(REFERENCE, turn))
        for _ in range(count):
            self.time += PERIOD
            frame = HandFrame(FLAT_HAND, self.time, T_world_wrist=place, world="room")
            self.ticks.append(self.pipeline.step(self.time, Arrival(frame, self.time, 0)))
        return self.ticks[-1].command.joint_positions[-2:]

    @property
    def commands(self) -> np.ndarray:
        return np.array([tick.command.joint_positions for tick in self.ticks])


STRAIGHT = np.array([1.0, 0, 0, 0])


def test_a_live_hand_follows_holds_and_takes_a_new_reference(shadow):
    hand, run = shadow.hand, Run(shadow)
    bent, other = np.array([-0.3, 0.2]), np.array([0.1, -0.1])
    run.frames(20, STRAIGHT)
    np.testing.assert_allclose(run.frames(150, human_turn(hand, bent)), bent, atol=1e-6)
    np.testing.assert_allclose(run.frames(20, None), bent, atol=1e-6)  # the wrist is lost
    np.testing.assert_allclose(run.frames(20, np.full(4, np.nan)), bent, atol=1e-6)
    # Found again, it has the same reference: the tracker knows its room.
    np.testing.assert_allclose(run.frames(150, human_turn(hand, other)), other, atol=1e-6)
    run.pipeline.supervisor.pause()
    np.testing.assert_allclose(run.frames(20, human_turn(hand, bent)), other, atol=1e-6)
    run.pipeline.supervisor.resume()
    np.testing.assert_allclose(run.frames(60, human_turn(hand, bent)), other, atol=1e-6)
    back = run.frames(150, STRAIGHT)  # from its new reference
    assert np.abs(back - other).max() > 0.1
    run.pipeline.clutch.follow(False)
    run.frames(30, STRAIGHT)
    np.testing.assert_allclose(run.frames(60, human_turn(hand, bent)), back, atol=0.02)
    q = run.commands
    assert run.ticks[-1].command.joint_names == with_wrist_joints(hand).joint_names
    speed = np.abs(np.diff(q, axis=0)).max(axis=0) / PERIOD
    assert speed[:-2].max() <= LIMITS.velocity * (1 + 1e-9)
    assert 1.0 < speed[-2:].max() <= LIMITS.wrist_velocity * (1 + 1e-9)
    assert np.abs(np.diff(q, n=2, axis=0)).max() <= LIMITS.acceleration * PERIOD**2 * (1 + 1e-9)


def test_without_its_wrist_joints_a_hand_gets_the_same_commands(shadow):
    on, off = Run(shadow), Run(shadow, wrist_joints=False)
    for run in (on, off):
        run.frames(40, STRAIGHT)
        run.frames(20, human_turn(shadow.hand, np.array([-0.2, 0.3])))
    assert off.ticks[-1].command.joint_names == shadow.hand.joint_names
    assert off.pipeline.hand is shadow.hand
    fingers = list(shadow.hand.actuated)
    np.testing.assert_array_equal(on.commands[:, fingers], off.commands[:, fingers])
    assert on.ticks[-1].mode is off.ticks[-1].mode is Mode.TRACKING


def test_a_simulated_hand_moves_its_palm():
    whole = with_wrist_joints(load_hand("orca_v1"))
    physics = HandPhysics(whole)
    q = whole.neutral.copy()
    q[-1] = 0.5
    physics.command(whole.full_configuration(q))
    physics.advance(1.0)
    assert physics.positions[-1] == pytest.approx(0.5, abs=0.01)
    turn = np.empty(3)
    mujoco.mju_quat2Vel(turn, physics.data.body("palm").xquat, 1.0)
    np.testing.assert_allclose(np.linalg.norm(turn), 0.5, atol=0.01)


def recording(hand: Hand, q: np.ndarray) -> HandRecording:
    """The synthetic operator, with a wrist that bends as the joints do at (T, k) positions."""
    fingers = SyntheticOperator(seed=1, side=hand.spec.side).record(len(q) / 100)
    turns = [poses.multiply(REFERENCE, human_turn(hand, row)) for row in q]
    wrists = np.array([pose(turn) for turn in turns])
    wrists[4:6] = np.nan
    return replace(fingers, T_world_wrist=wrists, world="room")


def test_retarget_writes_the_wrist_and_metrics_leave_it_out(run, tmp_path, shadow):
    q = np.outer(np.linspace(0.0, 1.0, 10), [-0.2, 0.3])
    made = recording(shadow.hand, q)
    np.savez(
        tmp_path / "in.npz",
        landmarks=made.landmarks,
        timestamps=made.stamps,
        side=made.side,
        T_world_wrist=made.T_world_wrist,
    )
    command = ("retarget", tmp_path / "in.npz", "--hand", "shadow_hand", "--method", "joint_angle")
    assert run(*command, "--output", tmp_path / "on.npz")[0] == 0
    assert run(*command, "--output", tmp_path / "off.npz", "--wrist-joints", "off")[0] == 0
    on, off = read_commands(tmp_path / "on.npz"), read_commands(tmp_path / "off.npz")
    assert on.joint_names == (*off.joint_names, "rh_WRJ2", "rh_WRJ1")
    np.testing.assert_array_equal(on.joint_positions[:, :-2], off.joint_positions)
    held = q.copy()
    held[4:6] = q[3]
    np.testing.assert_allclose(on.joint_positions[:, -2:], held, atol=1e-6)
    trace = assemble_trace(made, on, shadow.hand, reach_samples=0)
    np.testing.assert_array_equal(trace.joint_positions, off.joint_positions)


def test_the_live_page_turns_the_palm_with_the_wrist():
    hand = load_hand("orca_v1")
    positions = with_wrist_joints(hand).full_configuration(with_wrist_joints(hand).neutral)
    state = {"positions": positions, "human": None, "latched": None, "targets": None}
    server = viser.ViserServer("127.0.0.1", 0, verbose=False)
    try:
        scene = LiveScene(server, {"right": hand}, simulated=False)
        (view,) = scene._sides.values()
        scene.draw({"right": state})
        root, still = view.row.roots["robot"], view.row.roots["human"].wxyz
        np.testing.assert_allclose(root.wxyz, still, atol=1e-9)
        positions[-1] = 0.5
        scene.draw({"right": state})
        turned = poses.multiply(poses.conjugate(np.asarray(still)), np.asarray(root.wxyz))
        np.testing.assert_allclose(poses.rotation_vectors(turned), [0.5, 0.0, 0.0], atol=1e-9)
    finally:
        server.stop()


def test_wrist_joints_and_an_arm_do_not_both_follow_the_wrist():
    request = TeleopRequest(hand="shadow_hand", arm="panda", wrist_joints="on")
    with pytest.raises(ConfigError, match="--wrist-joints on can't be used with --arm"):
        teleoperate(request)
