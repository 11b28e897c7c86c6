"""A robot hand under MuJoCo physics: joint commands in, joint positions out."""

from __future__ import annotations

from collections.abc import Callable

import mujoco
import numpy as np
from jaxtyping import Float

from smooth_operator.errors import ConfigError
from smooth_operator.hands.hand import Hand
from smooth_operator.simulation.arms.carried import CarriedHand
from smooth_operator.simulation.physics_model import build_physics

_RUNAWAY = 500.0
"""Joint velocity above which the simulation counts as diverged [rad/s]."""


class HandPhysics:
    """A hand with position servos on a fixture. Not thread-safe.

    Args:
        hand: the robot hand.
        timestep: time step of the physics [s].
        bandwidth: bandwidth of the servos [Hz]. A higher one follows faster and pushes harder.
        gravity: pull along -z of the model's world.
        furnish: adds the surroundings of the hand, see ``build_physics``.
        carried: the arm on which ``furnish`` puts the hand; None for a fixture.

    Attributes:
        time: simulated time [s].
        carried: the arm that carries the hand; None on a fixture.
        resets: number of times that the simulation diverged and was reset to the command.
    """

    def __init__(
        self,
        hand: Hand,
        timestep: float = 0.002,
        bandwidth: float = 20.0,
        gravity: bool = False,
        furnish: Callable[[mujoco.MjSpec], mujoco.MjSpec] | None = None,
        carried: CarriedHand | None = None,
    ) -> None:
        if not (0.0 < timestep <= 0.005 and 0.0 < bandwidth <= 0.05 / timestep):
            raise ConfigError(
                "simulation: expected a time step up to 5 ms and a bandwidth up to 0.05 / time "
                f"step, not {timestep} s and {bandwidth} Hz"
            )
        self.hand = hand
        self.time = 0.0
        self.resets = 0
        self._built = build_physics(
            hand, timestep=timestep, bandwidth=bandwidth, gravity=gravity, furnish=furnish
        )
        self._data = mujoco.MjData(self._built.model)
        self.carried = carried
        self._arm = None if carried is None else carried.addresses(self._built.model)
        self._home = np.zeros(0) if carried is None else carried.home
        self._arm_target: Float[np.ndarray, " a"] = self._home
        self._due = 0.0
        self._actuated = list(hand.actuated)
        self._target: Float[np.ndarray, " m"] = hand.neutral.copy()
        self._place(self._target)

    @property
    def model(self) -> mujoco.MjModel:
        """The compiled model."""
        return self._built.model

    @property
    def data(self) -> mujoco.MjData:
        """Its state; to look at."""
        return self._data

    def restart(self) -> None:
        """Reset to time 0, at rest in the neutral pose."""
        self.time = self._due = 0.0
        self.resets = 0
        self._target = self.hand.neutral.copy()
        self._arm_target = self._home
        self._place(self._target)

    @property
    def positions(self) -> Float[np.ndarray, " n"]:
        """(n,) positions of the joints [rad], in the order of ``hand.joint_names``."""
        return np.array(self._data.qpos[self._built.qpos])

    @property
    def arm_positions(self) -> Float[np.ndarray, " a"] | None:
        """(a,) positions of the joints of the arm [rad]; None without an arm."""
        return None if self._arm is None else np.array(self._data.qpos[self._arm.qpos])

    @property
    def velocities(self) -> Float[np.ndarray, " n"]:
        """(n,) velocities of the joints [rad/s]."""
        return np.array(self._data.qvel[self._built.dofs])

    @property
    def timestep(self) -> float:
        """Time step of the physics [s]."""
        return float(self._built.model.opt.timestep)

    @property
    def contacts(self) -> int:
        """Number of contacts."""
        return int(self._data.ncon)

    def command(self, positions: Float[np.ndarray, " n"]) -> None:
        """Set the servos' targets.

        Args:
            positions: (n,) positions of all joints [rad]. Coupled joints follow their leaders. A
                value that is not finite leaves its target unchanged; others are clipped to the
                limits.
        """
        targets = np.asarray(positions, float)[self._actuated]
        targets = np.clip(targets, self.hand.limits[:, 0], self.hand.limits[:, 1])
        self._target = np.where(np.isfinite(targets), targets, self._target)
        self._data.ctrl[self._built.controls] = self._target

    def command_arm(self, positions: Float[np.ndarray, " a"]) -> None:
        """Set the targets of the arm's servos; does nothing without an arm.

        Args:
            positions: (a,) targets [rad]. A value that is not finite leaves its target unchanged.
        """
        if self._arm is not None:
            finite = np.isfinite(positions)
            self._arm_target = np.where(finite, positions, self._arm_target)
            self._data.ctrl[self._arm.controls] = self._arm_target

    def hold(self) -> None:
        """Make the current positions of hand and arm their targets."""
        self.command(self.positions)
        arm = self.arm_positions
        if arm is not None:
            self.command_arm(arm)

    def advance(self, seconds: float) -> bool:
        """Simulate whole time steps; the remainder is added to the next call.

        Args:
            seconds: simulated time to add [s].

        Returns:
            False if the simulation diverged and was reset, else True.
        """
        step = self.timestep
        self._due += seconds
        count = int(self._due / step + 1e-9)
        if count <= 0:
            return True
        self._due -= count * step
        self.time += count * step
        self._step(count)
        # A NaN fails the comparison, too.
        if np.abs(self._data.qvel).max() < _RUNAWAY and np.isfinite(self._data.qpos).all():
            return True
        self.resets += 1
        self._place(self._target)
        return False

    def _step(self, count: int) -> None:
        mujoco.mj_step(self._built.model, self._data, count)

    def _place(self, target: Float[np.ndarray, " m"]) -> None:
        """Set the hand to a pose, at rest."""
        mujoco.mj_resetData(self._built.model, self._data)
        self._data.qpos[self._built.qpos] = self.hand.full_configuration(target)
        self._data.ctrl[self._built.controls] = target
        if self._arm is not None:
            self._data.qpos[self._arm.qpos] = self._arm_target
            self._data.ctrl[self._arm.controls] = self._arm_target
        mujoco.mj_forward(self._built.model, self._data)
