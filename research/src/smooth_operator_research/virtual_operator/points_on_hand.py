"""Where named points of a robot hand are, and how they move, by MuJoCo: fast enough for each step.

``Hand.landmark_positions`` gives the same points from a table of the kinematics; that is made for
batches, and takes milliseconds for one pose.
"""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np
from jaxtyping import Float

from smooth_operator.hands.hand import Hand, landmark_points
from smooth_operator.simulation.physics_model import FURNISHED
from smooth_operator.simulation.scenes.physics import ScenePhysics


class SeenTips:
    """The fingertips of a hand in a scene.

    Args:
        physics: the scene.
    """

    def __init__(self, physics: ScenePhysics) -> None:
        hand, model = physics.hand, physics.model
        places = landmark_points(hand.model, hand.spec)
        self._physics, self._palm = physics, model.body(FURNISHED + hand.spec.palm).id
        named = [places[name] for name in hand.tip_names]
        self._bodies = [model.body(FURNISHED + hand.model.body(b).name).id for b, _ in named]
        self._offsets = np.array([offset for _, offset in named])

    def read(self) -> Float[np.ndarray, "f 3"]:
        """(f, 3) in the palm frame now [m], thumb first."""
        data = self._physics.data
        turns = data.xmat[self._bodies].reshape(-1, 3, 3)
        world = data.xpos[self._bodies] + np.einsum("fij,fj->fi", turns, self._offsets)
        return np.asarray((world - data.xpos[self._palm]) @ data.xmat[self._palm].reshape(3, 3))


class HandPoints:
    """Landmarks of a robot hand in a pose, and their derivatives.

    Args:
        hand: the robot hand.
        names: of the landmarks.
    """

    def __init__(self, hand: Hand, names: Sequence[str]) -> None:
        places = landmark_points(hand.model, hand.spec)
        self._hand, self._model, self._data = hand, hand.model, mujoco.MjData(hand.model)
        self._named = [places[name] for name in names]
        self._palm = hand.model.body(hand.spec.palm).id
        self._dofs = [int(hand.model.joint(name).dofadr[0]) for name in hand.joint_names]

    def at(
        self, q: Float[np.ndarray, " m"]
    ) -> tuple[Float[np.ndarray, "k 3"], Float[np.ndarray, "k 3 m"]]:
        """Positions (k, 3) in the palm frame [m] and derivatives (k, 3, m) [m/rad].

        Args:
            q: (m,) actuated joint positions [rad].
        """
        model, data, hand = self._model, self._data, self._hand
        data.qpos[:] = hand.qpos(hand.full_configuration(q))
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        palm, turn = data.xpos[self._palm], data.xmat[self._palm].reshape(3, 3)
        points = np.empty((len(self._named), 3))
        jacobian = np.empty((len(self._named), 3, len(q)))
        rows = np.zeros((3, model.nv))
        for k, (body, offset) in enumerate(self._named):
            world = data.xpos[body] + data.xmat[body].reshape(3, 3) @ offset
            mujoco.mj_jac(model, data, rows, None, world, body)
            points[k] = (world - palm) @ turn
            jacobian[k] = turn.T @ rows[:, self._dofs] @ hand.coupling_matrix
        return points, jacobian
