"""Pose of a hand on its fixture in a scene, and where its fingertips can reach."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from smooth_operator.errors import HandModelError
from smooth_operator.hands.hand import Hand
from smooth_operator.simulation.hand_directions import hand_directions


@dataclass(frozen=True, eq=False)
class Mount:
    """Pose of a hand on its fixture.

    A scene places its parts in directions of the hand, from the wrist: distal along the fingers,
    radial to the thumb's side, palmar out of the palm. The world's z points up.

    Attributes:
        directions: (3, 3) columns: distal, radial and palmar in the world.
        wrist: (3,) position of the hand's wrist in the world [m].
        frame: position (3,) [m] and quaternion (4,) of the world of the hand's model in this world.
        palm: position (3,) [m] and rotation (3, 3) of the palm frame in the world.
    """

    directions: Float[np.ndarray, "3 3"]
    wrist: Float[np.ndarray, "3"]
    frame: tuple[Float[np.ndarray, "3"], Float[np.ndarray, "4"]]
    palm: tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3 3"]]

    def world(self, point: ArrayLike) -> Float[np.ndarray, "3"]:
        """(3,) world position [m] of a point: distal, radial and palmar from the wrist [m]."""
        return np.asarray(self.wrist + self.directions @ np.asarray(point, float))

    def in_palm(
        self, position: Float[np.ndarray, "3"], quaternion: Float[np.ndarray, "4"]
    ) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "4"]]:
        """Pose in the palm frame, in which the pages draw hands, of a pose in the world.

        Args:
            position: (3,) position in the world [m].
            quaternion: (4,) rotation to the world, w x y z.
        """
        at, turn = self.palm
        back, out = np.zeros(4), np.zeros(4)
        mujoco.mju_mat2Quat(back, np.ascontiguousarray(turn.T).ravel())
        mujoco.mju_mulQuat(out, back, quaternion)
        return turn.T @ (position - at), out


def mount(hand: Hand, *, up: ArrayLike, forward: ArrayLike, wrist: ArrayLike = (0, 0, 0)) -> Mount:
    """Place a hand in the world.

    Args:
        up: (3,) direction of the hand (distal, radial, palmar) that is the world's z.
        forward: (3,) direction of the hand that is the world's x; its part along ``up`` is ignored.
        wrist: (3,) position of the wrist in the world [m].
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
    # A model may have a forearm between its world and the palm.
    data = mujoco.MjData(hand.model)
    data.qpos[:] = hand.qpos(hand.full_configuration(hand.neutral))
    mujoco.mj_kinematics(hand.model, data)
    body = hand.model.body(hand.spec.palm).id
    rotation = turn @ data.xmat[body].reshape(3, 3).T
    quaternion = np.zeros(4)
    mujoco.mju_mat2Quat(quaternion, rotation.ravel())
    frame = (palm - rotation @ data.xpos[body], quaternion)
    return Mount(turn @ axes.T, at, frame, (palm, turn))


_POSES = 20_000


def reachable(hand: Hand) -> Float[np.ndarray, "s f 3"]:
    """(s, f, 3) fingertips in random poses: distal, radial and palmar from the wrist [m].

    The random poses are the same in every call, so that a hand's scene is always the same.
    """
    low, high = hand.limits.T
    poses = np.random.default_rng(0).uniform(low, high, (_POSES, len(low)))
    tips = hand.tips(hand.full_configuration(poses)) - hand.wrist
    return np.asarray(tips @ hand_directions(hand).T)


def opposition(
    hand: Hand, finger: str, gap: float, *, tolerance: float = 0.006
) -> Float[np.ndarray, "k 3"]:
    """(k, 3) midpoints between the tips of thumb and finger in poses where they are ``gap`` apart.

    All lengths in metres.

    Raises:
        HandModelError: fewer than 20 of the random poses have that gap.
    """
    tips = reachable(hand)
    thumb, other = tips[:, 0], tips[:, hand.fingers.index(finger)]
    near = np.abs(np.linalg.norm(other - thumb, axis=1) - gap) < tolerance
    if near.sum() < 20:
        raise HandModelError(
            f"hand {hand.name!r}: thumb and {finger} can't take hold of something "
            f"{1e3 * gap:.0f} mm thick; choose another task or hand"
        )
    return np.asarray((thumb + other)[near] / 2)
