"""How a hand stands in a scene: its own directions against the world's."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from smooth_operator.hands.hand import Hand
from smooth_operator.simulation.hand_directions import hand_directions


@dataclass(frozen=True, eq=False)
class Mount:
    """A hand on its fixture.

    Points of a scene are found in the hand's own directions, from the wrist: distal along the
    fingers, radial to the thumb's side, palmar out of the palm. The world's z points up.

    Attributes:
        directions: (3, 3) columns: distal, radial and palmar in the world.
        wrist: (3,) the hand's wrist in the world [m].
        frame: position (3,) [m] and quaternion (4,) of the model's own world in this one.
        palm: position (3,) [m] and rotation (3, 3) of the palm frame in the world.
    """

    directions: Float[np.ndarray, "3 3"]
    wrist: Float[np.ndarray, "3"]
    frame: tuple[Float[np.ndarray, "3"], Float[np.ndarray, "4"]]
    palm: tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3 3"]]

    def world(self, point: ArrayLike) -> Float[np.ndarray, "3"]:
        """(3,) distal, radial and palmar from the wrist [m], in the world."""
        return np.asarray(self.wrist + self.directions @ np.asarray(point, float))

    def in_palm(
        self, position: Float[np.ndarray, "3"], quaternion: Float[np.ndarray, "4"]
    ) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "4"]]:
        """A pose of the world in the palm frame, where the pages draw hands.

        Args:
            position: (3,) in the world [m].
            quaternion: (4,) w x y z, to the world.
        """
        at, turn = self.palm
        back, out = np.zeros(4), np.zeros(4)
        mujoco.mju_mat2Quat(back, np.ascontiguousarray(turn.T).ravel())
        mujoco.mju_mulQuat(out, back, quaternion)
        return turn.T @ (position - at), out


def mount(hand: Hand, *, up: ArrayLike, forward: ArrayLike, wrist: ArrayLike = (0, 0, 0)) -> Mount:
    """Fix a hand in the world.

    Args:
        hand: the robot hand.
        up: (3,) distal, radial, palmar: which of the hand's directions is the world's z.
        forward: (3,) the same for the world's x; what of it is along ``up`` is left out.
        wrist: (3,) where the wrist is in the world [m].
    """
    axes = hand_directions(hand)
    z = np.asarray(up, float) @ axes
    z /= np.linalg.norm(z)
    x = np.asarray(forward, float) @ axes
    x -= (x @ z) * z
    x /= np.linalg.norm(x)
    turn = np.stack([x, np.cross(z, x), z])  # palm frame to world
    at = np.asarray(wrist, float)
    palm = at - turn @ hand.wrist
    # The palm in the model's own world: a forearm, say, may stand between the two.
    data = mujoco.MjData(hand.model)
    data.qpos[:] = hand.qpos(hand.full_configuration(hand.neutral))
    mujoco.mj_kinematics(hand.model, data)
    body = hand.model.body(hand.spec.palm).id
    rotation = turn @ data.xmat[body].reshape(3, 3).T
    quaternion = np.zeros(4)
    mujoco.mju_mat2Quat(quaternion, rotation.ravel())
    frame = (palm - rotation @ data.xpos[body], quaternion)
    return Mount(turn @ axes.T, at, frame, (palm, turn))
