"""Simulates robot hands that follow the commands: MuJoCo physics in real time."""

from __future__ import annotations

import itertools
import threading
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final, Literal

import numpy as np
from jaxtyping import Float

from smooth_operator.errors import ConfigError, SinkError
from smooth_operator.hands.hand import Hand
from smooth_operator.settings import check_range
from smooth_operator.simulation.arms.arm import CarriedHand, Matrix, WristKinematics
from smooth_operator.simulation.live import Watcher
from smooth_operator.simulation.physics import HandPhysics
from smooth_operator.simulation.scenes import Scene, ScenePart, ScenePhysics, SceneState, scene_for
from smooth_operator.simulation.scenes.physics import ArmPhysics
from smooth_operator.simulation.tasks.catalogue import task_named
from smooth_operator.teleop.sinks.sink import Sink
from smooth_operator.teleop.sinks.tick import Contact, HandState, Tick
from smooth_operator.types import Side


@dataclass(frozen=True)
class Simulation(Sink):
    """Sink that simulates each hand in MuJoCo in real time, driven by position servos.

    A hand is mounted on a fixture or on its arm. The physics runs on its own thread. Without
    commands, the hands hold their positions. The page draws ``state`` and the command.

    Attributes:
        rate: steps of the physics per second [Hz].
        bandwidth: bandwidth of the servos [Hz]. A higher one follows faster and pushes harder.
        gravity: True for gravity along -z of the model's world.
        task: task scene around each hand; a task switches gravity on.
        full_force: force on a finger at which its contact is 1 [N].

    Raises:
        ConfigError: a setting is out of its range.
    """

    rate: float = 500.0
    bandwidth: float = 20.0
    gravity: bool = False
    task: Literal["none", "card", "cube", "screwdriver", "relocate", "hammer", "tongs"] = "none"
    full_force: float = 5.0
    _world: World | None = field(default=None, init=False, repr=False, compare=False)
    _task: str | None = field(default=None, init=False, repr=False, compare=False)
    _swapping: threading.Lock = field(
        default_factory=threading.Lock, init=False, repr=False, compare=False
    )
    _arms: dict[Side, CarriedHand] = field(
        default_factory=dict, init=False, repr=False, compare=False
    )
    _events: list[str] = field(default_factory=list, init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        check_range("mujoco: rate", self.rate, 200.0, 2000.0, "Hz")
        check_range("mujoco: full_force", self.full_force, 0.1, 100.0, "N")
        if not 0.5 <= self.bandwidth <= 0.05 * self.rate:
            raise ConfigError(
                f"mujoco: bandwidth must be 0.5 Hz to a twentieth of the rate, "
                f"{0.05 * self.rate:g} Hz, not {self.bandwidth}"
            )

    @property
    def label(self) -> str:
        """The word ``mujoco``."""
        return "mujoco"

    @property
    def note(self) -> str:
        """Warning about errors of the physics; empty if there are none."""
        return "; ".join(self._events)

    @property
    def simulation(self) -> Simulation:
        """This sink itself, which is the simulation."""
        return self

    @property
    def task_now(self) -> str:
        """Name of the current task, or ``none``."""
        return self.task if self._task is None else self._task

    @property
    def world_number(self) -> int:
        """Number of the current scene, which no other scene has; 0 without a scene."""
        return 0 if self._world is None else self._world.number

    def open(self, hands: Mapping[Side, Hand], config: Mapping[str, Any]) -> None:
        """Builds the models and starts the simulation; see ``Sink``."""
        if self._world is not None:
            raise SinkError("mujoco: the sink is already open")
        physics = {side: self._built(hand, self.task_now) for side, hand in hands.items()}
        self._set(_world=World(physics, self._events, self._arms, self.full_force))

    def change_task(self, task: str) -> None:
        """Builds the scene of another task, or the hand alone, and switches to it. Commands
        continue.

        A watcher of the previous scene gets no more states.

        Args:
            task: a task as in the setting ``task``.

        Raises:
            UnknownNameError: there is no such task.
            HandModelError: the task does not fit the size of a hand; nothing changes.
            ConfigError: the task moves the wrist, and there is no arm; nothing changes.
            SinkError: the simulation is closed, or was closed in the meantime.
        """
        before = self._world
        if before is None:
            raise SinkError("mujoco: it is not open")
        physics = {side: self._built(old.hand, task) for side, old in before.physics.items()}
        with self._swapping:
            if self._world is not before:
                raise SinkError(
                    "mujoco: the sink was closed, or another task was requested in the meantime"
                )
            world = World(physics, self._events, self._arms, self.full_force)
            self._set(_task=task, _world=world)
        before.end()

    def send(self, tick: Tick) -> None:
        """Sets the targets of the servos; SinkError if the simulation has ended."""
        if self._world is None:
            raise SinkError("mujoco: it is not open")
        arm = None if tick.arm is None else tick.arm.positions
        self._world.command(tick.side, tick.command.joint_positions, arm)

    def stalled(self, seconds: float) -> None:
        """Makes the hands hold their positions."""
        if self._world is not None:
            self._world.hold()

    def state(self, side: Side) -> HandState | None:
        """The current state of a hand; safe from any thread.

        Returns:
            None while the simulation is closed, or if it has no such hand.
        """
        world = self._world
        return None if world is None else world.states.get(side)

    def snapshot(self, side: Side) -> tuple[HandPhysics, Float[np.ndarray, " q"]] | None:
        """Physics of a hand, and its newest (q,) joint positions; None if there is no such hand.

        Safe from any thread; the state inside the physics belongs to the simulation's thread."""
        world = self._world
        if world is None or side not in world.physics:
            return None
        return world.physics[side], world.qpos[side]

    def use_arms(self, arms: Mapping[Side, CarriedHand]) -> None:
        """Sets the arms that carry the hands; see ``Sink``."""
        self._arms.update(arms)

    def measured_arm(self, side: Side) -> Float[np.ndarray, " n"] | None:
        """Joint positions of an arm [rad]; see ``Sink``."""
        world = self._world
        return None if world is None else world.arms.get(side)

    def measured_wrist(self, side: Side) -> Float[np.ndarray, "7"] | None:
        """Pose of a hand's wrist in the base frame of its arm; see ``Sink``."""
        world = self._world
        if world is None or (arm := world.arms.get(side)) is None:
            return None
        return world.kinematics[side].wrist(arm)

    def arm_base(self, side: Side) -> Matrix | None:
        """Pose of an arm's base in the scene of a task; see ``LiveSimulation``."""
        physics = None if self._world is None else self._world.physics.get(side)
        if isinstance(physics, ScenePhysics) and isinstance(physics.carried, CarriedHand):
            return physics.carried.base
        return None

    def scene_of(self, side: Side) -> Scene:
        """The scene around a hand; SinkError if the simulation is closed, has no such hand, or no
        task."""
        return self._scene(side).scene

    def hand_of(self, side: Side) -> Hand:
        """The robot hand in a scene; raises the same errors as ``scene_of``."""
        return self._scene(side).hand

    def parts_of(self, side: Side) -> list[ScenePart]:
        """Shapes of platform and object, for drawing; raises the same errors as ``scene_of``."""
        return self._scene(side).parts()

    def scene_state(self, side: Side) -> SceneState | None:
        """The current state of the scene around a hand; safe from any thread.

        Returns:
            None while the simulation is closed, or without a task or such a hand.
        """
        world = self._world
        return None if world is None else world.scenes.get(side)

    def watch(self, side: Side, watcher: Watcher | None) -> None:
        """Passes every new state of a scene to one watcher; None removes the watcher.

        Raises:
            SinkError: as ``scene_of``.
        """
        world = self._open_world(side)
        with world.changed:
            if watcher is None:
                world.watchers.pop(side, None)
            else:
                world.watchers[side] = watcher

    def reset_object(self, side: Side) -> int:
        """Returns the object to its starting pose at the next step; raises the same errors as
        ``scene_of``.

        Returns:
            ``SceneState.starts`` of the states after the reset.
        """
        world = self._open_world(side)
        with world.changed:
            world.there[side] = True
            return self._scene(side).starts + 1

    def put_away(self, side: Side) -> None:
        """Removes the object at the next step; raises the same errors as ``scene_of``."""
        world = self._open_world(side)
        with world.changed:
            world.there[side] = False

    def freeze(self, side: Side, frozen: bool) -> None:
        """Freezes a hand, its scene and its clock, or lets them continue; raises the same errors as
        ``scene_of``.

        When it continues, the hand moves to the newest command.
        """
        world = self._open_world(side)
        with world.changed:
            (world.frozen.add if frozen else world.frozen.discard)(side)

    def _built(self, hand: Hand, task: str) -> HandPhysics:
        step, arm = 1.0 / self.rate, self._arms.get(hand.spec.side)
        if task != "none":
            if arm is None and task_named(task).moves_wrist:
                raise ConfigError(
                    f"task {task!r} moves the wrist, but the hand is on a fixture; add an arm "
                    "such as --arm panda, or choose card, cube or screwdriver"
                )
            return ScenePhysics(hand, scene_for(task, hand), step, self.bandwidth, arm)
        if arm is not None:
            return ArmPhysics(hand, arm, step, self.bandwidth)
        return HandPhysics(hand, step, self.bandwidth, self.gravity)

    def _open_world(self, side: Side) -> World:
        self._scene(side)  # raises without a scene
        assert self._world is not None
        return self._world

    def _scene(self, side: Side) -> ScenePhysics:
        world = self._world
        physics = None if world is None else world.physics.get(side)
        if not isinstance(physics, ScenePhysics):
            raise SinkError(
                f"mujoco: no task scene is loaded for the {side} hand: "
                + (
                    "the simulation is not running"
                    if world is None
                    else "request one with mujoco:task=card"
                )
            )
        return physics

    def close(self) -> None:
        """Ends the simulation; a second call does nothing."""
        with self._swapping:
            world = self._world
            self._set(_world=None)
        if world is not None:
            world.end()


_WAKE_S: Final = 0.004
"""Interval at which the thread wakes for several steps [s]; waking costs more than a step."""

_SLICE_S: Final = 0.01
"""Longest simulated time between two readings of the commands [s]."""

_BEHIND_S: Final = 0.1
"""Longest delay of the machine that the physics makes up for [s]."""

_Target = tuple[Float[np.ndarray, " n"], Float[np.ndarray, " a"] | None]
"""Joint positions of a hand and of its arm [rad]."""

_NUMBERS: Final = itertools.count(1)


class World:
    """Thread that simulates the physics of all hands in real time.

    Args:
        physics: physics of each hand.
        events: list to which faults of the physics are added.
        carried: arms that carry hands.
        full_force: force on a finger at which its contact is 1 [N].

    Attributes:
        watchers: side -> watcher of the scene's states.
        there: side -> True to put the object back at the next step, False to remove it.
        frozen: sides whose hand and scene are frozen.
        changed: lock for the attributes that other threads write.
    """

    def __init__(
        self,
        physics: Mapping[Side, HandPhysics],
        events: list[str],
        carried: Mapping[Side, CarriedHand],
        full_force: float,
    ) -> None:
        self._full_force = full_force
        now = time.perf_counter()
        self.kinematics = {
            side: WristKinematics(carried[side]) for side in physics if side in carried
        }
        self.arms = {
            side: arm for side, p in physics.items() if (arm := p.arm_positions) is not None
        }
        self.number = next(_NUMBERS)
        self.states = {side: self._measured(side, p, now) for side, p in physics.items()}
        self.qpos = {side: np.array(p.data.qpos) for side, p in physics.items()}
        self.physics, self._events = physics, events
        self.scenes: dict[Side, SceneState] = {
            side: p.observe() for side, p in physics.items() if isinstance(p, ScenePhysics)
        }
        self.watchers: dict[Side, Watcher] = {}
        self.there: dict[Side, bool] = {}
        self._targets: dict[Side, _Target | None] = {}
        self.frozen: set[Side] = set()
        self.changed = threading.Lock()
        self._error: Exception | None = None
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._run, name="mujoco", daemon=True)
        self._thread.start()

    def command(
        self,
        side: Side,
        positions: Float[np.ndarray, " n"],
        arm: Float[np.ndarray, " a"] | None,
    ) -> None:
        """Sets new servo targets for a hand and its arm; SinkError if the simulation has ended."""
        if self._error is not None:
            raise SinkError(f"mujoco: the simulation ended: {self._error}") from self._error
        with self.changed:
            self._targets[side] = positions, arm

    def hold(self) -> None:
        """Makes the hands hold their positions."""
        with self.changed:
            for side in self.physics:
                self._targets[side] = None  # the position of the hand at that time

    def end(self) -> None:
        """Stops the thread."""
        self._ending.set()
        self._thread.join(2.0)

    def _run(self) -> None:
        try:
            last = time.perf_counter()
            held: set[Side] = set()
            while not self._ending.wait(_WAKE_S):
                now = time.perf_counter()
                due, last = min(now - last, _BEHIND_S), now
                while due > 0.0:
                    self._take(held)
                    self._step(min(due, _SLICE_S), now)
                    due -= _SLICE_S
        except Exception as error:  # raised with the next command
            self._error = error

    def _take(self, held: set[Side]) -> None:
        """Apply the newest commands; ``held`` has the hands that hold their positions."""
        with self.changed:
            targets, self._targets = self._targets, {}
        for side, target in targets.items():
            if target is not None:
                positions, arm = target
                self.physics[side].command(positions)
                if arm is not None:
                    self.physics[side].command_arm(arm)
                held.discard(side)
            elif side not in held:  # once: a hand that is held again and again would creep
                self.physics[side].hold()
                held.add(side)

    def _step(self, seconds: float, now: float) -> None:
        for side, physics in self.physics.items():
            with self.changed:
                frozen, there = side in self.frozen, side in self.there
            if frozen:
                self.states[side] = self._measured(side, physics, now)
                if there and isinstance(physics, ScenePhysics):
                    self._show(side, physics)  # the object may be put back meanwhile
                continue
            if not physics.advance(seconds):
                text = f"the physics of the {side} hand became unstable and was reset"
                resets = f"{text} ({physics.resets} times)" if physics.resets > 1 else text
                self._events[:] = [e for e in self._events if not e.startswith(text)] + [resets]
            self.states[side] = self._measured(side, physics, now)
            self.qpos[side] = np.array(physics.data.qpos)
            if (arm := physics.arm_positions) is not None:
                self.arms[side] = arm
            if isinstance(physics, ScenePhysics):
                self._show(side, physics)

    def _show(self, side: Side, physics: ScenePhysics) -> None:
        """Carry out requested resets, and pass the new state of a scene to its watcher."""
        with self.changed:
            watcher = self.watchers.get(side)
            there = self.there.pop(side, None)
        if there is not None:
            (physics.reset_object if there else physics.put_away)()
        state = self.scenes[side] = physics.observe()
        if watcher is not None:
            watcher(state, physics.positions)

    def _measured(self, side: Side, physics: HandPhysics, now: float) -> HandState:
        """State of a hand, as joint encoders and force sensors in the fingers measure it."""
        hand, forces = physics.hand, physics.finger_forces
        contact = Contact(np.minimum(forces / self._full_force, 1.0), forces)
        return HandState(side, hand.name, now, hand.joint_names, physics.positions, contact=contact)
