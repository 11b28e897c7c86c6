"""A simulated robot hand that follows the commands: MuJoCo physics in real time."""

from __future__ import annotations

import threading
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from jaxtyping import Float

from smooth_operator.errors import ConfigError, SinkError
from smooth_operator.hands.hand import Hand
from smooth_operator.simulation.arms.carried import CarriedHand
from smooth_operator.simulation.arms.rigid import Matrix
from smooth_operator.simulation.live import Watcher
from smooth_operator.simulation.physics import HandPhysics
from smooth_operator.simulation.scenes import Scene, ScenePart, ScenePhysics, SceneState, scene_for
from smooth_operator.simulation.scenes.arm_physics import ArmPhysics
from smooth_operator.teleop.sinks.hand_state import HandState
from smooth_operator.teleop.sinks.simulation_thread import World
from smooth_operator.teleop.sinks.sink import Sink
from smooth_operator.teleop.sinks.tick import Tick
from smooth_operator.types import Side


@dataclass(frozen=True)
class Simulation(Sink):
    """Each hand on a fixture, or on its arm, in MuJoCo, on position servos, in real time.

    The physics runs on its own thread. When commands stop, the hands stay where they are. The
    page draws ``state`` with the command.

    Attributes:
        rate: steps of the physics per second [Hz].
        bandwidth: of the servos [Hz]; higher follows faster and pushes harder.
        gravity: pull along -z of the model's world, wherever that points in it.
        task: what the hands work on, each on its own; gravity is on then.

    Raises:
        ConfigError: a setting is out of its range.
    """

    rate: float = 500.0
    bandwidth: float = 20.0
    gravity: bool = False
    task: Literal["none", "card", "cube", "screwdriver"] = "none"
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
        if not 200.0 <= self.rate <= 2000.0:
            raise ConfigError(f"mujoco: rate must be 200 to 2000 Hz, not {self.rate}")
        if not 0.5 <= self.bandwidth <= 0.05 * self.rate:
            raise ConfigError(
                f"mujoco: bandwidth must be 0.5 Hz to a twentieth of the rate, "
                f"{0.05 * self.rate:g} Hz, not {self.bandwidth}"
            )

    @property
    def label(self) -> str:
        """``mujoco``."""
        return "mujoco"

    @property
    def note(self) -> str:
        """What went wrong in the physics, if anything did."""
        return "; ".join(self._events)

    @property
    def simulation(self) -> Simulation:
        """The sink itself."""
        return self

    @property
    def task_now(self) -> str:
        """What the hands work on now; ``none`` for nothing."""
        return self.task if self._task is None else self._task

    @property
    def world_number(self) -> int:
        """Changes with every scene that is built, and is 0 while there is none."""
        world = self._world
        return 0 if world is None else world.number

    def open(self, hands: Mapping[Side, Hand], config: Mapping[str, Any]) -> None:
        """Build the models and start; see ``Sink``."""
        if self._world is not None:
            raise SinkError("mujoco: it is open already")
        physics = {side: self._built(hand, self.task_now) for side, hand in hands.items()}
        self._set("_world", World(physics, self._events, self._arms))

    def change_task(self, task: str) -> None:
        """Go on with another scene, or with none, once it is built; commands go on meanwhile.

        Whoever watched the scene before sees no more of it.

        Args:
            task: as ``task``.

        Raises:
            UnknownNameError: there is no such task.
            HandModelError: a hand's size does not allow it; then nothing changes.
            SinkError: the simulation is closed, or was meanwhile.
        """
        before = self._world
        if before is None:
            raise SinkError("mujoco: it is not open")
        physics = {side: self._built(old.hand, task) for side, old in before.physics.items()}
        with self._swapping:
            if self._world is not before:
                raise SinkError("mujoco: it was closed, or another task was asked for meanwhile")
            self._set("_task", task)
            self._set("_world", World(physics, self._events, self._arms))
        before.end()

    def send(self, tick: Tick) -> None:
        """Set the targets of the servos.

        Raises:
            SinkError: the simulation has ended.
        """
        if self._world is None:
            raise SinkError("mujoco: it is not open")
        arm = None if tick.arm is None else tick.arm.positions
        self._world.command(tick.side, tick.command.positions, arm)

    def stalled(self, seconds: float) -> None:
        """Have the hands stay where they are."""
        if self._world is not None:
            self._world.hold()

    def state(self, side: Side) -> HandState | None:
        """Where a hand is now; safe from any thread.

        Returns:
            None while the simulation is closed, or if it has no such hand.
        """
        world = self._world
        return None if world is None else world.seen.get(side)

    def use_arms(self, arms: Mapping[Side, CarriedHand]) -> None:
        """The arms that carry the hands; see ``Sink``."""
        self._arms.update(arms)

    def measured_arm(self, side: Side) -> Float[np.ndarray, " n"] | None:
        """Where the joints of an arm are [rad]; see ``Sink``."""
        world = self._world
        return None if world is None else world.arms.get(side)

    def measured_wrist(self, side: Side) -> Float[np.ndarray, "7"] | None:
        """Where an arm has the wrist of a hand, in its base frame; see ``Sink``."""
        world = self._world
        if world is None or (arm := world.arms.get(side)) is None:
            return None
        return world.kinematics[side].wrist(arm)

    def arm_base(self, side: Side) -> Matrix | None:
        """Where an arm stands in the scene of a task; see ``LiveSimulation``."""
        physics = None if self._world is None else self._world.physics.get(side)
        if not isinstance(physics, ScenePhysics) or physics.carried is None:
            return None
        return physics.carried.base

    def scene_of(self, side: Side) -> Scene:
        """What is around a hand.

        Raises:
            SinkError: the simulation is closed, has no such hand, or no task.
        """
        return self._scene(side).scene

    def hand_of(self, side: Side) -> Hand:
        """The hand that works there; raises as ``scene_of``."""
        return self._scene(side).hand

    def parts_of(self, side: Side) -> list[ScenePart]:
        """Shapes of platform and object, to draw; raises as ``scene_of``."""
        return self._scene(side).parts()

    def scene_state(self, side: Side) -> SceneState | None:
        """Where the object is now; safe from any thread.

        Returns:
            None while the simulation is closed, or without a task or such a hand.
        """
        world = self._world
        return None if world is None else world.scenes.get(side)

    def watch(self, side: Side, watcher: Watcher | None) -> None:
        """Have every new state of a scene given to one watcher; None takes it away.

        Raises:
            SinkError: as ``scene_of``.
        """
        self._scene(side)
        assert self._world is not None  # it has a scene
        self._world.watch(side, watcher)

    def reset_object(self, side: Side) -> int:
        """Have the object put back to its start, with the next step; raises as ``scene_of``.

        Returns:
            ``SceneState.starts`` of the states that come after it.
        """
        physics = self._scene(side)
        assert self._world is not None  # it has a scene
        return self._world.reset_object(side, physics)

    def put_away(self, side: Side) -> None:
        """Have no object from the next step on, until it is put back; raises as ``scene_of``."""
        self._scene(side)
        assert self._world is not None  # it has a scene
        self._world.put_away(side)

    def freeze(self, side: Side, frozen: bool) -> None:
        """Have hand and scene stand still, their clock included, or go on; raises as ``scene_of``.

        Commands are heard meanwhile; the hand goes to the newest one when it goes on.
        """
        self._scene(side)
        assert self._world is not None  # it has a scene
        self._world.freeze(side, frozen)

    def _built(self, hand: Hand, task: str) -> HandPhysics:
        step, arm = 1.0 / self.rate, self._arms.get(hand.spec.side)
        if task != "none":
            return ScenePhysics(hand, scene_for(task, hand), step, self.bandwidth, arm)
        if arm is not None:
            return ArmPhysics(hand, arm, step, self.bandwidth)
        return HandPhysics(hand, step, self.bandwidth, self.gravity)

    def _set(self, name: str, value: object) -> None:
        object.__setattr__(self, name, value)

    def _scene(self, side: Side) -> ScenePhysics:
        world = self._world
        found = None if world is None else world.physics.get(side)
        if not isinstance(found, ScenePhysics):
            raise SinkError(
                f"mujoco: there is no scene around a {side} hand: "
                + ("it is not open" if world is None else "ask for one with mujoco:task=card")
            )
        return found

    def close(self) -> None:
        """Stop; a second call does nothing."""
        with self._swapping:
            world = self._world
            self._set("_world", None)
        if world is not None:
            world.end()
