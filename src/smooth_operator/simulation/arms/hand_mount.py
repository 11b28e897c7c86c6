"""The constant transform from an arm's flange to the hand that it carries."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import mujoco
import numpy as np
from jaxtyping import Float

from smooth_operator.hands.collision import shape_capsules
from smooth_operator.hands.hand import Hand
from smooth_operator.simulation.arms.rigid import Matrix, inverse, rigid
from smooth_operator.simulation.hand_directions import hand_directions


@dataclass(frozen=True, eq=False)
class HandMount:
    """A hand on a flange: its fingers point along the flange's z, away from the arm.

    Frames: the flange has z out of it. The hand's wrist frame has x toward the base of the middle
    finger, z out of the back of the hand, y = z x x; that is the frame of ``WristCommand``.

    Attributes:
        hand: the robot hand.
        adapter: thickness of the plate between flange and hand [m].
        roll: turn of the hand about the flange's z [rad]; at 0 its back points along x.
    """

    hand: Hand
    adapter: float = 0.02
    roll: float = 0.0

    @cached_property
    def palm_to_wrist(self) -> Matrix:
        """The wrist frame in the palm frame."""
        distal, _, palmar = hand_directions(self.hand)
        back = -palmar
        return rigid(np.stack([distal, np.cross(back, distal), back], axis=1), self.hand.wrist)

    @cached_property
    def model_to_palm(self) -> Matrix:
        """The palm frame in the world of the hand's own model, a forearm's joints at rest."""
        hand = self.hand
        data = mujoco.MjData(hand.model)
        data.qpos[:] = hand.qpos(hand.full_configuration(hand.neutral))
        mujoco.mj_kinematics(hand.model, data)
        body = hand.model.body(hand.spec.palm).id
        return rigid(data.xmat[body].reshape(3, 3), data.xpos[body])

    @cached_property
    def length(self) -> float:
        """Distance from the hand's rear end to its wrist, along the fingers [m]."""
        model, data = self.hand.model, mujoco.MjData(self.hand.model)
        data.qpos[:] = self.hand.qpos(self.hand.full_configuration(self.hand.neutral))
        mujoco.mj_kinematics(model, data)
        to_wrist = inverse(self.model_to_palm @ self.palm_to_wrist)
        rear = 0.0
        for geom in range(model.ngeom):
            for capsule in shape_capsules(model, geom):
                turn = data.xmat[capsule.body].reshape(3, 3)
                ends = capsule.ends @ turn.T + data.xpos[capsule.body]
                along = ends @ to_wrist[0, :3] + to_wrist[0, 3]
                rear = min(rear, float(along.min()) - capsule.radius)
        return -rear

    @cached_property
    def flange_to_wrist(self) -> Matrix:
        """The wrist frame in the flange's."""
        c, s = np.cos(self.roll), np.sin(self.roll)
        back = np.array([c, s, 0.0])
        out = np.array([0.0, 0.0, 1.0])
        turn = np.stack([out, np.cross(back, out), back], axis=1)
        return rigid(turn, (self.adapter + self.length) * out)

    @cached_property
    def flange_to_model(self) -> Matrix:
        """The world of the hand's own model in the flange's frame."""
        return np.asarray(self.flange_to_wrist @ inverse(self.model_to_palm @ self.palm_to_wrist))


class HandCapsules:
    """Capsules around a hand's parts, posed in the flange's frame as the fingers move.

    Args:
        mount: the hand on its flange.

    Attributes:
        radii: (c,) radii [m].
        halves: (c,) half lengths of the segments [m].
        fingers: (c,) whether a joint of the hand moves it.
    """

    def __init__(self, mount: HandMount) -> None:
        hand = mount.hand
        self._hand, self._model = hand, hand.model
        self._data = mujoco.MjData(hand.model)
        self._flange = mount.flange_to_model
        model = hand.model
        sites = [
            capsule
            for geom in range(model.ngeom)
            if model.geom_contype[geom] or model.geom_conaffinity[geom]
            for capsule in shape_capsules(model, geom)
        ]
        self._body = np.array([capsule.body for capsule in sites], int)
        ends = np.array([capsule.ends for capsule in sites]).reshape(-1, 2, 3)
        self._middle, axis = ends.mean(axis=1), ends[:, 1] - ends[:, 0]
        self.radii: Float[np.ndarray, " c"] = np.array([capsule.radius for capsule in sites])
        length = np.linalg.norm(axis, axis=1)
        self.halves: Float[np.ndarray, " c"] = length / 2
        upward = np.where(length[:, None] > 1e-9, axis, (0.0, 0.0, 1.0))
        self._axis = upward / np.linalg.norm(upward, axis=1)[:, None]
        palm = model.body_weldid[model.body(hand.spec.palm).id]
        moving = {int(palm)}
        body = int(palm)
        while body:
            body = int(model.body_weldid[model.body_parentid[body]])
            moving.add(body)
        self.fingers = ~np.isin(model.body_weldid[self._body], list(moving))

    def __len__(self) -> int:
        return len(self.radii)

    def at(
        self, positions: Float[np.ndarray, " n"]
    ) -> tuple[Float[np.ndarray, "c 3"], Float[np.ndarray, "c 3"]]:
        """Middles [m] and axes (unit vectors) of the capsules in the flange's frame.

        Args:
            positions: (n,) positions of all joints of the hand [rad].
        """
        self._data.qpos[:] = self._hand.qpos(positions)
        mujoco.mj_kinematics(self._model, self._data)
        turn = self._data.xmat.reshape(-1, 3, 3)[self._body]
        middle = np.einsum("cij,cj->ci", turn, self._middle) + self._data.xpos[self._body]
        axis = np.einsum("cij,cj->ci", turn, self._axis)
        rotation, origin = self._flange[:3, :3], self._flange[:3, 3]
        return middle @ rotation.T + origin, axis @ rotation.T
