"""The landmarks of a robot hand at many poses, on the host and without compiling anything."""

from __future__ import annotations

import math

import mujoco
import numpy as np
from jaxtyping import Float

from smooth_operator.hands.hand import Hand, landmark_points
from smooth_operator.landmarks import LANDMARKS
from smooth_operator.teleop.recording.foxglove import Keypoints


def landmark_keypoints(hand: Hand) -> Keypoints:
    """Positions of a hand's landmarks, by MuJoCo: one pose takes some 10 us.

    ``hand.tree`` gives the same, and is made for thousands of poses in one call.

    Args:
        hand: the robot hand.
    """
    model, data = hand.model, mujoco.MjData(hand.model)
    points = {
        LANDMARKS.index(name): point
        for name, point in landmark_points(model, hand.spec).items()
        if name in LANDMARKS
    }
    columns = list(points)
    palm = model.body(hand.spec.palm).id
    bodies = np.array([palm, *(body for body, _ in points.values())])
    local = np.array([np.zeros(3), *(place for _, place in points.values())])

    position, xpos, xmat = data.qpos, data.xpos, data.xmat  # views, which stay

    def keypoints(q: Float[np.ndarray, "k n"]) -> Float[np.ndarray, "k 21 3"]:
        places = np.empty((len(q), len(bodies), 3))
        turns = np.empty((len(q), len(bodies), 9))
        for qpos, place, turn in zip(hand.qpos(q), places, turns, strict=True):
            position[:] = qpos
            mujoco.mj_kinematics(model, data)
            xpos.take(bodies, 0, place)
            xmat.take(bodies, 0, turn)
        matrices = turns.reshape(*turns.shape[:2], 3, 3)
        places += (matrices @ local[:, :, None])[..., 0]
        found = np.full((len(q), len(LANDMARKS), 3), math.nan)
        # in the palm's frame, whose body comes first
        found[:, columns] = (places[:, 1:] - places[:, :1]) @ matrices[:, 0]
        return found

    return keypoints
