"""Arms: their kinematics against the makers' figures, and a controller that keeps every limit."""

import runpy
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from arm_files import so101_urdf
from live_time import until
from scipy.spatial.transform import Rotation
from ticks import KeptTicks

from smooth_operator.errors import ConfigError, UnknownNameError
from smooth_operator.hands.registry import load_hand
from smooth_operator.poses import from_rotation_vectors
from smooth_operator.simulation.arms.arm import (
    FLANGE,
    ArmSpec,
    HandCapsules,
    HandMount,
    arm_spec,
    matrix_of,
    pose_of,
    rigid,
)
from smooth_operator.simulation.arms.catalogue import ARMS
from smooth_operator.simulation.scenes import ScenePhysics, scene_for
from smooth_operator.simulation.scenes.physics import ArmPhysics
from smooth_operator.teleop import TeleopRequest, teleoperate
from smooth_operator.teleop.arm.controller import ArmController
from smooth_operator.teleop.arm.settings import ArmSettings, place_arms, read_arm
from smooth_operator.teleop.sinks.simulation import Simulation
from smooth_operator.teleop.sinks.tick import ArmCommand, Mode, Tick
from smooth_operator.types import JointCommand

pytest.importorskip("mink", reason="the extra arm is not installed")
pytest.importorskip("daqp", reason="the extra arm is not installed")


STEP = 0.01
NAMES = tuple(ARMS)


@cache
def _mount(hand: str, arm: str, side: str = "right") -> HandMount:
    spec = ARMS[arm]
    return HandMount(load_hand(hand, side), roll=spec.roll, built_on=spec.mount_of(hand))


def _hand(arm: str, hand: str) -> str:
    """The gripper that is built onto an arm, or else a hand."""
    gripper = ARMS[arm].gripper
    return hand if gripper is None else gripper[0]


def _controller(arm: str, hand: str = "mimic_p050", **settings: float) -> ArmController:
    return ArmController(ARMS[arm], _mount(_hand(arm, hand), arm), **settings)


def _flange(arm: str | ArmSpec, q: Sequence[float]) -> tuple[np.ndarray, np.ndarray]:
    model = arm_spec(ARMS[arm] if isinstance(arm, str) else arm).compile()
    data = mujoco.MjData(model)
    data.qpos[:] = q
    mujoco.mj_kinematics(model, data)
    body = model.body(FLANGE).id
    return data.xpos[body], data.xmat[body].reshape(3, 3)


def test_a_ur5e_turns_as_its_makers_own_table_says():
    """The maker's own form: standard Denavit-Hartenberg."""
    rows = [
        (0, 0.1625, np.pi / 2),
        (-0.425, 0, 0),
        (-0.3922, 0, 0),
        (0, 0.1333, np.pi / 2),
        (0, 0.0997, -np.pi / 2),
        (0, 0.0996, 0),
    ]
    q, expected = [0.3, -1.1, 1.7, -0.4, 0.9, 2.0], np.eye(4)
    for (a, d, alpha), theta in zip(rows, q, strict=True):
        about_z = Rotation.from_euler("z", theta).as_matrix()
        about_x = Rotation.from_euler("x", alpha).as_matrix()
        expected = expected @ rigid(about_z, (0, 0, d)) @ rigid(about_x, (a, 0, 0))
    place, turn = _flange("ur5e", q)
    np.testing.assert_allclose(place, expected[:3, 3], atol=1e-9)
    np.testing.assert_allclose(turn, expected[:3, :3], atol=1e-9)


@pytest.mark.parametrize(
    ("arm", "q", "place"),
    [  # drawings: what the lengths of the links come to in poses at right angles
        ("panda", [0, 0, 0, 0, 0, 0, 0], (0.088, 0, 0.333 + 0.316 + 0.384 - 0.107)),
        ("xarm7", [0, 0, 0, 0, 0, 0, 0], (0.206, 0, 0.1205)),
        ("iiwa14", [0, 0, 0, 0, 0, 0, 0], (0, 0, 0.36 + 0.42 + 0.4 + 0.126)),
        ("iiwa14", [0, np.pi / 2, 0, 0, 0, 0, 0], (0.42 + 0.4 + 0.126, 0, 0.36)),
        ("iiwa14", [0, 0, 0, -np.pi / 2, 0, 0, 0], (0.4 + 0.126, 0, 0.36 + 0.42)),
    ],
)
def test_the_flange_is_where_the_makers_lengths_put_it(arm, q, place):
    np.testing.assert_allclose(_flange(arm, q)[0], place, atol=1e-9)


@pytest.mark.parametrize(
    ("q", "expected"),
    [
        (
            [0.0, 0.0, 0.0, 0.0, 0.0],
            [0.3913615, -0.0000092, 0.2264697, 0.7069005, 0.0172065, 0.7068942, 0.0172136],
        ),
        (
            [0.3, -0.4, 0.5, -0.6, 0.7],
            [0.3141545, -0.0905455, 0.2938346, 0.7645941, -0.0891609, 0.5023287, -0.3938427],
        ),
    ],
)
def test_an_so101_and_its_gripper_are_those_of_its_makers_urdf(q, expected):
    """Poses of ``gripper_frame_link``, computed with MuJoCo 4.0 from the file that the catalogue
    names; that frame is fixed to ``gripper_link``, the palm of the gripper's model.
    """
    mount = _mount("so101", "so101")
    place, turn = _flange("so101", q)
    palm = rigid(turn, place) @ mount.flange_to_model @ mount.model_to_palm
    between_jaws = (-0.0079, -0.000218121, -0.0981274)  # turned by pi about y, in the file
    pose = pose_of(palm @ rigid(np.diag([-1.0, 1.0, -1.0]), between_jaws))
    np.testing.assert_allclose(pose, expected, atol=1e-5)


def test_an_arm_of_the_user_is_a_urdf_and_a_link(tmp_path):
    path = tmp_path / "my_arm.urdf"
    path.write_text(so101_urdf())
    arm = read_arm(f"{path}:tip=wrist_roll_link,posture=0/-34/40/57/0").spec
    catalogue = ARMS["so101"]
    assert (arm.name, arm.joint_names) == ("my_arm", catalogue.joint_names)
    np.testing.assert_allclose(arm.nominal, np.radians([0, -34, 40, 57, 0]))
    np.testing.assert_allclose(arm.limits, np.tile([-3.0, 3.0], (5, 1)))
    np.testing.assert_allclose(arm.velocity, 10.0)
    rng = np.random.default_rng(0)
    for q in rng.uniform(-1.5, 1.5, (5, 5)):
        there, turned = _flange(catalogue, q)
        place, turn = _flange(arm, q)
        np.testing.assert_allclose(place, there, atol=1e-6)
        np.testing.assert_allclose(turn @ np.diag([-1.0, 1.0, -1.0]), turned, atol=1e-5)
    controller = ArmController(arm, HandMount(load_hand("franka_hand")))
    home = controller.pose
    for _ in range(150):
        command = controller.step(home + np.array([0.03, 0, 0.02, 0, 0, 0, 0]), STEP)
    assert command.position_error < 1e-3


@pytest.mark.parametrize("side", ["right", "left"])
@pytest.mark.parametrize("hand", ["mimic_p050", "shadow_hand", "leap_hand"])
def test_a_hand_stands_on_the_flange_with_its_fingers_outward(hand, side):
    mount = _mount(hand, "panda", side)
    middles, _ = HandCapsules(mount).at(mount.hand.full_configuration(mount.hand.neutral))
    radii = HandCapsules(mount).radii
    assert (middles[:, 2] + radii).min() > 0.0, "all of it is in front of the flange"
    tips = mount.hand.tips(mount.hand.full_configuration(mount.hand.neutral))
    to_flange = mount.flange_to_wrist @ np.linalg.inv(mount.palm_to_wrist)
    along = tips @ to_flange[:3, :3].T + to_flange[:3, 3]
    assert along[1:, 2].min() > mount.flange_to_wrist[2, 3] + 0.03, "the fingers are beyond it"
    assert np.linalg.det(mount.flange_to_wrist[:3, :3]) == pytest.approx(1.0)


@pytest.mark.parametrize("arm", NAMES)
def test_no_limit_is_passed_whatever_the_target_does(arm):
    """Random poses, teleports, flipped quaternions, NaN, uneven steps, fingers in motion."""
    controller = _controller(arm)
    spec, hand = controller.arm, controller.mount.hand
    rng = np.random.default_rng(sum(map(ord, arm)))
    target = controller.wrist_at(controller.home)
    q, velocity, before = controller.home, np.zeros(len(spec.links)), np.inf
    fingers, nearest, states = hand.neutral.copy(), np.inf, set()
    for number in range(260):
        if number % 25 == 0:
            turn = rng.normal(size=4)
            target = np.concatenate([rng.uniform((-0.9, -0.9, -0.3), (0.9, 0.9, 1.2)), turn])
            goal = rng.uniform(*hand.limits.T)
        if number % 7 == 0:
            target = np.concatenate([target[:3], -target[3:]])
        given = np.full(7, np.nan) if number % 50 in (3, 4) else target
        fingers = fingers + np.clip(goal - fingers, -0.02, 0.02)
        dt = float(rng.choice([0.004, 0.01, 0.01, 0.02, 0.06]))
        command = controller.step(given, dt, hand.full_configuration(fingers))
        states.add(command.state)
        assert (
            (command.positions >= spec.limits[:, 0]) & (command.positions <= spec.limits[:, 1])
        ).all()
        moved = (command.positions - q) / dt
        np.testing.assert_allclose(moved, command.velocity, atol=1e-9)
        assert (np.abs(moved) <= spec.velocity * 0.9 + 1e-9).all()
        change = spec.acceleration * min(dt, (before + dt) / 2)
        assert (np.abs(moved - velocity) <= change + 1e-6).all()
        q, velocity, before = command.positions, moved, dt
        nearest = min(nearest, command.clearance)
    assert nearest > -0.004, f"parts were {1e3 * nearest:.1f} mm apart"
    assert {"following", "holding"} <= states


@pytest.mark.parametrize("arm", ["ur5e", "panda"])
def test_the_wrist_follows_and_comes_to_rest_without_overshoot(arm):
    controller = _controller(arm)
    home = controller.wrist_at(controller.home)
    errors = []
    for number in range(260):
        t = number * STEP
        target = home.copy()
        target[:3] += 0.06 * np.sin(np.pi * t) * np.array([0.4, 1.0, -0.5])
        command = controller.step(target, STEP)
        errors.append(command.position_error)
    assert max(errors[30:]) < 0.006
    beyond = home + np.array([0, 0.08, 0, 0, 0, 0, 0])
    controller.restart(controller.home)
    places = [controller.step(beyond, STEP).pose[1] - home[1] for _ in range(100)]
    assert max(places) < 0.082, "it passes a standing target by no more than 2 mm"
    assert places[-1] == pytest.approx(0.08, abs=1e-3)


@pytest.mark.parametrize("arm", ["xarm7", "iiwa14", "so101"])
def test_a_target_out_of_reach_is_approached_and_the_arm_stands(arm):
    controller = _controller(arm)
    target = controller.wrist_at(controller.home)
    target[:3] = 3.0, 0.3, 0.6
    commands = [controller.step(target, STEP) for _ in range(400)]
    assert commands[-1].position_error < commands[0].position_error - 0.1
    still = np.array([command.velocity for command in commands[-50:]])
    assert np.abs(still).max() < 0.02, "no oscillation at full reach"


@pytest.mark.parametrize(
    ("move", "turn", "rest"),
    [  # five joints reach every pose in the plane of the arm, and other ones as far as they can
        ((0.08, 0.0, 0.0), (0.0, 0.0, 0.0), 0.01),
        ((0.0, 0.0, -0.06), (0.0, 0.0, 0.0), 0.01),
        ((0.0, 0.0, 0.0), (0.0, 0.5, 0.0), 0.03),
        ((0.0, 0.1, 0.0), (0.0, 0.0, 0.0), 0.25),
        ((0.0, -0.1, 0.05), (0.3, 0.3, 0.0), 0.5),
    ],
)
def test_five_joints_bring_the_jaws_to_their_place(move, turn, rest):
    controller = _controller("so101")
    jaws = controller.mount.wrist_to_pinch
    home = matrix_of(controller.wrist_at(controller.home))
    turned = matrix_of([0, 0, 0, *from_rotation_vectors(np.array(turn))])
    goal = rigid(turned[:3, :3] @ home[:3, :3], home[:3, 3] + move)
    for _ in range(300):
        command = controller.step(pose_of(goal), STEP)
    reached = matrix_of(command.pose) @ jaws
    np.testing.assert_allclose(reached[:3, 3], (goal @ jaws)[:3, 3], atol=1e-3)
    assert command.rotation_error < rest
    assert np.abs(command.velocity).max() < 0.02


def test_without_a_target_it_brakes_and_holds_and_a_stop_is_obeyed():
    controller = _controller("panda")
    target = controller.wrist_at(controller.home)
    target[2] += 0.2
    for _ in range(20):
        moving = controller.step(target, STEP)
    assert np.abs(moving.velocity).max() > 0.1
    for _ in range(60):
        held = controller.step(None, STEP)
    assert held.state == "holding"
    assert np.abs(held.velocity).max() == 0.0
    for _ in range(30):
        controller.step(target, STEP)
    for _ in range(60):
        stopped = controller.step(target, STEP, stop=True)
    assert stopped.state == "stopped"
    assert np.abs(stopped.velocity).max() == 0.0
    first = controller.step(target, STEP)
    assert np.abs(first.positions - stopped.positions).max() < 0.02
    assert np.linalg.norm(first.pose[:3] - stopped.pose[:3]) < 0.002


def test_nothing_passes_the_wall_nor_the_table():
    controller = _controller("xarm7", wall=-0.3)
    target = controller.wrist_at(controller.home)
    capsules, body = controller._capsules, controller.model.body(FLANGE).id
    lowest, rightmost = np.inf, np.inf
    for number in range(300):
        target[:3] = (0.45, -0.7, 0.2) if number < 150 else (0.45, 0.0, -0.5)
        controller.step(target, STEP)
        data = controller._configuration.data
        middles, axes = capsules.at(controller._hand)
        along = axes * capsules.halves[:, None]
        ends = np.stack([middles - along, middles + along])
        points = ends @ data.xmat[body].reshape(3, 3).T + data.xpos[body]
        reach = (points - capsules.radii[:, None]).min(axis=(0, 1))
        rightmost, lowest = min(rightmost, reach[1]), min(lowest, reach[2])
    assert -0.3 < rightmost < -0.25, "it goes up to the wall"
    assert -0.002 < lowest < 0.03, "the fingers may touch the table, and go no deeper"


def test_a_home_pose_out_of_reach_is_refused(monkeypatch):
    monkeypatch.setattr("smooth_operator.teleop.arm.controller._HOME_STEPS", 50)
    with pytest.raises(ConfigError, match="can't reach the home pose"):
        ArmController(replace(ARMS["ur5e"], home=(2.0, 0.0, 0.5)), _mount("mimic_p050", "ur5e"))


def _carried(arm: str) -> Any:
    hand = load_hand(_hand(arm, "leap_hand"))
    return place_arms(ArmSettings(arm), {"right": hand})["right"]


@pytest.mark.parametrize("arm", ARMS)
def test_an_arm_holds_its_hand_and_goes_where_it_is_sent(arm):
    carried = _carried(arm)
    physics = ArmPhysics(carried.mount.hand, carried)
    assert physics.advance(0.3)
    np.testing.assert_allclose(physics.arm_positions, carried.home, atol=2e-3)
    target = carried.home + 0.1
    physics.command_arm(target)
    assert physics.advance(0.8)
    np.testing.assert_allclose(physics.arm_positions, target, atol=5e-3)
    physics.command_arm(np.full(len(target), np.nan))
    assert physics.advance(0.1)
    np.testing.assert_allclose(physics.arm_positions, target, atol=5e-3)


@pytest.mark.parametrize("task", ["card", "cube", "screwdriver", "relocate"])
def test_a_task_stands_in_front_of_the_arm(task):
    carried = _carried("xarm7")
    hand = carried.mount.hand
    physics = ScenePhysics(hand, scene_for(task, hand), carried=carried)
    assert physics.advance(0.3)
    np.testing.assert_allclose(physics.arm_positions, carried.home, atol=5e-3)
    state = physics.observe()
    np.testing.assert_allclose(state.position, physics.scene.start[0], atol=0.01)
    away = state.position[:2] - physics.carried.base[:2, 3]
    assert 0.2 < np.linalg.norm(away) < ARMS["xarm7"].reach, "the object is within reach"


def test_the_sink_carries_the_hand_and_reads_the_arm_back():
    carried = _carried("panda")
    hand = carried.mount.hand
    sink = Simulation()
    assert sink.measured_wrist("right") is None
    sink.use_arms({"right": carried})
    sink.open({"right": hand}, {})
    try:
        before = sink.measured_wrist("right")
        q = hand.full_configuration(hand.neutral)
        wanted = carried.home + np.array([0.15, 0, 0, 0, 0, 0, 0])
        arm = ArmCommand("panda", carried.arm.joint_names, wanted, np.zeros(7), before)
        command = JointCommand(q, hand.joint_names, 0.0)
        sink.send(
            Tick("right", hand.name, command, np.zeros(len(q)), Mode.TRACKING, 0.0, 0, arm=arm)
        )
        until(lambda: np.abs(sink.measured_arm("right") - wanted).max() < 5e-3)
        after = sink.measured_wrist("right")
        assert after[1] - before[1] > 0.05, "a positive first joint turns it to the left"
        assert sink.arm_base("right") is None, "there is no task"
    finally:
        sink.close()


def test_a_task_that_moves_the_wrist_needs_an_arm():
    carried = _carried("panda")
    hand, sink = carried.mount.hand, Simulation(task="relocate")
    with pytest.raises(ConfigError, match="--arm panda"):
        sink.open({"right": hand}, {})
    sink.use_arms({"right": carried})
    sink.open({"right": hand}, {})
    try:
        until(lambda: sink.scene_state("right").support > 0.0)
        kinds = {part.name: part.kind for part in sink.parts_of("right")}
        assert kinds["ball"] == "capsule", "the page draws a ball as a capsule without length"
    finally:
        sink.close()


def test_one_command_moves_two_arms_with_their_hands():
    kept = KeptTicks()
    request = TeleopRequest(
        source="synthetic:wrist=0.1",
        sink=("mujoco",),
        hand="leap_hand",
        side="both",
        method="joint_angle",
        arm="ur5e:spacing=1.2",
        duration=2.0,
    )
    teleoperate(request, sinks=[kept])
    for side in ("right", "left"):
        arms = [tick.arm for tick in kept.ticks if tick.side == side]
        assert arms
        q = np.array([arm.positions for arm in arms])
        moved = np.abs(q - q[0]).max(axis=1) > 0.01
        assert moved.any(), f"the {side} arm moves"
        known = [k for k in np.flatnonzero(moved) if arms[k].measured is not None]
        apart = [np.abs(arms[k].measured - q[k]).max() for k in known]
        assert np.median(apart) < 0.3  # not the last: the machine may have stalled before it


def test_settings_of_an_arm_are_read_and_checked(tmp_path):
    assert read_arm("panda") == ArmSettings("panda")
    assert read_arm("ur5e:roll=90,adapter=0.03") == ArmSettings("ur5e", 0.03, 90.0)
    path = tmp_path / "my_arm.urdf"
    path.write_text(so101_urdf())
    for text, error, message in (
        ("pandora", UnknownNameError, "Did you mean 'panda'"),
        ("panda:rol=90", UnknownNameError, "setting"),
        ("panda:spacing=0.1", ConfigError, "spacing"),
        (f"{path}", ConfigError, "expected tip=LINK"),
        (f"{path}:tip=nowhere", ConfigError, "expected tip=LINK, .* the links are base, shoulder"),
        (f"{path}:tip=wrist_roll_link,posture=0/east", ConfigError, "degrees, such as 0/-45/60"),
        (f"{path}:tip=wrist_roll_link,posture=0/1", ConfigError, "expected 5 nominal positions"),
    ):
        with pytest.raises(error, match=message):
            read_arm(text).spec  # noqa: B018


@pytest.mark.weekly
@pytest.mark.parametrize(("arm", "task"), [("xarm7", "cube"), ("ur5e", "screwdriver")])
def test_a_task_of_the_study_is_done_with_an_arm(arm, task):
    path = Path(__file__).parents[1] / "research" / "benchmarks" / "arm_tasks.py"
    trial = runpy.run_path(str(path))["trial"](task, "mimic_p050", arm, 0, 1)
    assert trial["score"] == 1.0
    assert trial["off_mm"] < 3.0, "the arm holds against what the fingers press on"
