"""Gymnasium environment in which a simulated robot hand performs one of the simulated tasks."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Final

import gymnasium
import numpy as np
from gymnasium import spaces

from smooth_operator import poses
from smooth_operator.errors import ConfigError
from smooth_operator.hands.registry import load_hand
from smooth_operator.simulation.camera import SimulatedCamera
from smooth_operator.simulation.scenes import ScenePhysics, scene_for
from smooth_operator.simulation.scenes.physics import draw_variation, draw_wrist_variation
from smooth_operator.simulation.scenes.scene import OBJECT_POSE, object_pose
from smooth_operator.simulation.scenes.table_scene import TableScene
from smooth_operator.simulation.tasks import TASKS, Phase, SimulatedTask, TaskRun, task_named
from smooth_operator.types import as_side

LOOKS_HZ: Final = 100.0
"""Minimum rate at which the scorer observes the scene [Hz]."""

SETTLE_S: Final = 1.0
"""Time that the hand is given to reach its start pose before an episode [s]."""

OBJECT_NAMES: Final = tuple(f"environment.{name}" for name in OBJECT_POSE)
"""Names of the environment's state, as the robot ``smooth_hand`` records it: position [m] and
quaternion of the object in the world."""

WRIST_NAMES: Final = tuple(f"wrist.{name}" for name in ("x", "y", "z", "rx", "ry", "rz"))
"""Names of the numbers for the wrist in actions and in ``agent_pos``: position [m] and rotation
vector [rad], relative to the wrist frame at the start."""

GOAL_NAMES: Final = ("target.x", "target.y", "target.z", "mechanism.pos")
"""Further names of the environment's state in tasks with a moving wrist: target [m], and depth of
the nail [m] or angle of the tongs [rad]."""

_REACH_M: Final = 1.0  # limit of each coordinate of the wrist in an action [m]

Observation = dict[str, Any]


class HandTask(gymnasium.Env[Observation, np.ndarray]):
    """Environment for a task of the study (slide and pinch a card, turn a cube, pivot a
    screwdriver) or for a task with a moving wrist.

    The observation contains ``agent_pos``, the (m,) measured positions of the actuated joints
    [rad]; ``environment_state``, the (7,) position [m] and quaternion wxyz of the object in the
    world; and, if requested, ``tactile``, the (f,) normal force on each finger, thumb first [N],
    and the picture ``pixels``. An action consists of the (m,) targets of the same joints [rad];
    they are clipped to the joints' limits. Targets move linearly from one action to the next during
    a period, because steps at 25 Hz would shake an object out of the fingers. In a task with a
    moving wrist, ``agent_pos`` and actions go on with six numbers for the wrist: position [m] and
    rotation vector [rad], relative to the wrist frame at the start (x to the middle finger's base,
    z out of the back); it moves at most 0.5 m/s and 2 rad/s. ``environment_state`` then goes on
    with the (3,) target [m] and the position of the scene's moving part [m or rad]. The reward is
    the score of the trial, 0, 0.5 or 1, in the last step of an episode; ``info["is_success"]`` is
    true for a score of 1.

    The object's start, friction and mass differ in each episode, as in the benchmark's worlds;
    ``reset`` with a seed repeats an episode.

    Args:
        task: name of the task.
        hand: name of the robot hand, or the path of its spec file.
        side: ``right`` or ``left``.
        fps: steps per second [Hz].
        seconds: time after which an episode is truncated [s]; None for the task's own limit.
        start: (m,) initial positions of the actuated joints [rad]; None for the neutral pose.
        variation: factor by which the ranges of the object's variation are scaled; 0 for the
            nominal object.
        tactile: True if the observation contains ``tactile``.
        pictures: True if the observation contains ``pixels``.
        width: width of a picture [px].
        height: height of a picture [px].
        render_mode: ``rgb_array``, or None.

    Raises:
        ConfigError: a number is out of its range.
        UnknownNameError: there is no such task or hand.
        HandModelError: the hand can't do the task.
    """

    metadata: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": 25}  # noqa: RUF012

    def __init__(
        self,
        task: str = "card",
        hand: str = "mimic_p050",
        side: str = "right",
        fps: int = 25,
        seconds: float | None = None,
        start: Sequence[float] | None = None,
        variation: float = 1.0,
        tactile: bool = False,
        pictures: bool = False,
        width: int = 320,
        height: int = 240,
        render_mode: str | None = None,
    ) -> None:
        if not (1 <= fps <= 500 and (seconds is None or 0.0 < seconds <= 3600.0)):
            raise ConfigError(
                f"environment: expected 1 to 500 steps per second and a time limit above 0 and up "
                f"to 3600 s, not {fps} and {seconds}"
            )
        if not 0.0 <= variation <= 10.0:
            raise ConfigError(f"environment: variation must be 0 to 10, not {variation}")
        self.simulated_task = task_named(task)
        self.task, self.task_description = task, self.simulated_task.task.instruction
        self.hand = load_hand(hand, as_side(side))
        self.render_mode, self.metadata = render_mode, {**self.metadata, "render_fps": fps}
        self._scene = scene_for(self.simulated_task.name, self.hand)
        self._fps, self._variation = fps, variation
        limit = self.simulated_task.seconds if seconds is None else seconds
        self._max_episode_steps = max(1, math.ceil(limit * fps - 1e-6))
        self._tactile, self._pictures, self._size = tactile, pictures, (width, height)
        low, high = self.hand.limits.T
        wrist = np.repeat([_REACH_M, np.pi], 3) if self.simulated_task.moves_wrist else np.zeros(0)
        joints = len(self.hand.actuated)
        self._start = self.hand.neutral if start is None else np.asarray(start, float)
        if self._start.shape != (joints,) or not np.isfinite(self._start).all():
            raise ConfigError(
                f"environment: start must be {joints} finite numbers, one for each of "
                f"{', '.join(self.hand.actuated_names)}"
            )
        parts: dict[str, spaces.Space[Any]] = {
            "agent_pos": spaces.Box(-np.inf, np.inf, (joints + len(wrist),), np.float32),
            "environment_state": spaces.Box(
                -np.inf, np.inf, (len(state_names(self.simulated_task)),), np.float32
            ),
        }
        if tactile:
            forces = (len(self.hand.fingers),)
            parts["tactile"] = spaces.Box(0.0, np.inf, forces, np.float32)
        if pictures:
            parts["pixels"] = spaces.Box(0, 255, (height, width, 3), np.uint8)
        self.observation_space = spaces.Dict(parts)
        self.action_space = spaces.Box(
            np.concatenate([low, -wrist]).astype(np.float32),
            np.concatenate([high, wrist]).astype(np.float32),
        )
        self._wrist = self._scene.free_wrist(self.hand) if len(wrist) else None
        self._action, self._wrist_target = self._start, np.zeros(6)
        self._camera: SimulatedCamera | None = None
        self._physics: ScenePhysics | None = None
        self._run: TaskRun | None = None
        self._steps = 0

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begin an episode in a new world, with the hand in its start pose and the object at its
        start."""
        super().reset(seed=seed)
        del options
        moves = self.simulated_task.moves_wrist
        draw = draw_wrist_variation if moves else draw_variation
        world = draw(self.np_random, self._variation)
        self.close()  # the camera of the last world
        physics = ScenePhysics(self.hand, world.scene(self._scene), carried=self._wrist)
        self._action = np.concatenate([self._start, np.zeros(0 if self._wrist is None else 6)])
        self._wrist_target = np.zeros(6)
        world.prepare(physics)
        physics.command(self.hand.full_configuration(self._start))
        physics.put_away()
        physics.advance(SETTLE_S)
        physics.reset_object()
        self._physics, self._steps = physics, 0
        self._run = TaskRun(self.simulated_task, physics.scene).go(physics.time)
        return self._observation(physics), {"is_success": False}

    def step(self, action: np.ndarray) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Move the targets of the actuated joints to those of the action, and simulate one period.

        Args:
            action: (m,) targets [rad], and the (6,) pose of the wrist in tasks that move it. A
                value that is not finite leaves its previous target.

        Raises:
            gymnasium.error.ResetNeeded: the episode is over, or no episode has begun.
        """
        physics, run = self._physics, self._run
        if physics is None or run is None or run.phase is not Phase.RUNNING:
            raise gymnasium.error.ResetNeeded("call reset() before step()")
        action = np.asarray(action, float)
        before = self._action
        clipped = np.clip(action, self.action_space.low, self.action_space.high)
        self._action = np.where(np.isfinite(action), clipped, before)
        looks = math.ceil(LOOKS_HZ / self._fps)
        seconds, resets = 1.0 / (self._fps * looks), physics.resets
        for part in np.linspace(before, self._action, looks + 1)[1:]:
            self._command(physics, part, seconds)
            physics.advance(seconds)
            run = run.observe(physics.observe())
        self._steps += 1
        diverged = physics.resets > resets  # such an episode measures nothing
        if run.phase is Phase.RUNNING and (diverged or self._steps >= self._max_episode_steps):
            run = run.finish(physics.time)
        self._run, outcome = run, run.outcome
        truncated = outcome is not None and outcome.ended in ("timeout", "finished")
        score = 0.0 if outcome is None or diverged else outcome.score
        info: dict[str, Any] = {"is_success": score == 1.0}
        if outcome is not None:
            info |= {"score": score, "reason": outcome.reason, "diverged": diverged}
        done = outcome is not None and not truncated
        return self._observation(physics), score, done, truncated, info

    def render(self) -> np.ndarray | None:
        """Draw the scene as a (height, width, 3) picture; None without a render mode."""
        if self.render_mode is None or self._physics is None:
            return None
        return self._picture(self._physics)

    def close(self) -> None:
        """Free the OpenGL context."""
        camera, self._camera = self._camera, None
        if camera is not None:
            camera.close()

    def _command(self, physics: ScenePhysics, action: np.ndarray, seconds: float) -> None:
        """Set the targets of the joints, and move that of the wrist within its speed."""
        joints = len(self.hand.actuated)
        physics.command(self.hand.full_configuration(action[:joints]))
        if self._wrist is None:
            return
        turn = poses.from_rotation_vectors(action[joints + 3 :])
        pose = poses.compose(self._wrist.start, np.concatenate([action[joints : joints + 3], turn]))
        self._wrist_target = self._wrist.targets(pose, self._wrist_target, seconds)
        physics.command_arm(self._wrist_target)

    def _observation(self, physics: ScenePhysics) -> Observation:
        state = physics.observe()
        measured = physics.positions[list(self.hand.actuated)]
        around = object_pose(state.position, state.quaternion, self._scene.start[1])
        if self._wrist is not None:
            at, scene = physics.arm_positions, physics.scene
            assert at is not None  # the wrist carries the hand
            assert isinstance(scene, TableScene)
            moved = poses.relative(self._wrist.start, self._wrist.pose(at))
            measured = np.concatenate([measured, moved[:3], poses.rotation_vectors(moved[3:])])
            goal = [*scene.target, state.mechanism]
            around = np.concatenate([around, goal]).astype(np.float32)
        observation: Observation = {
            "agent_pos": measured.astype(np.float32),
            "environment_state": around,
        }
        if self._tactile:
            observation["tactile"] = physics.finger_forces.astype(np.float32)
        if self._pictures:
            observation["pixels"] = self._picture(physics)
        return observation

    def _picture(self, physics: ScenePhysics) -> np.ndarray:
        if self._camera is None:
            self._camera = SimulatedCamera(physics, *self._size)
        return self._camera.draw(physics.data.qpos)


def state_names(task: SimulatedTask) -> tuple[str, ...]:
    """Returns the names of the numbers in ``environment_state`` of a task."""
    return OBJECT_NAMES + (GOAL_NAMES if task.moves_wrist else ())


def register() -> None:
    """Register the tasks for ``gymnasium.make``; a second call changes nothing."""
    for name in TASKS:
        if f"smooth_hand/{name}" not in gymnasium.registry:
            gymnasium.register(
                f"smooth_hand/{name}",
                "lerobot_env_smooth_hand.environment:HandTask",
                kwargs={"task": name},
                disable_env_checker=True,
            )
