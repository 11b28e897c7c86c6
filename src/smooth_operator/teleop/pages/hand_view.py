"""What a page and a picture of a robot hand have in common: its axes, parts and joints."""

from __future__ import annotations

from itertools import pairwise

import mujoco
import numpy as np
import trimesh
from jaxtyping import Float, Int

from smooth_operator.hands.hand import Hand
from smooth_operator.human.palm_axes import human_palm_axes
from smooth_operator.landmarks import BASES, FINGERS, LANDMARKS
from smooth_operator.teleop.pages.meshes import body_meshes, finger_of_body, without_forearm
from smooth_operator.teleop.pages.simple_shapes import simple_meshes

_POSES = 24  # in which the motion of its tip identifies the bodies of a finger


class HandView:
    """A hand that can be posed and looked at; everything is in the palm frame [m].

    Args:
        hand: the robot hand.
        simple: draw simple shapes, though the model may have meshes. A model without any shape is
            drawn by estimated ones.
    """

    def __init__(self, hand: Hand, *, simple: bool = False) -> None:
        self.hand = hand
        self._data = mujoco.MjData(hand.model)
        self._palm = hand.model.body(hand.spec.palm).id
        self.meshes: dict[int, trimesh.Trimesh] = (
            {} if simple else body_meshes(hand.model, hand.bodies)
        )
        self.meshes = self.meshes or simple_meshes(hand)
        self.finger_of_body = self._owners()

    @property
    def axes(self) -> Float[np.ndarray, "3 3"]:
        """Rows: right, up and toward the viewer, of a viewer who looks at the palm.

        Up is distal, as the human palm lies when it is aligned to the robot's.
        """
        distal, radial, palmar = human_palm_axes(self.hand)
        # The thumb of a right hand points to the right of who looks into its palm.
        right = radial if self.hand.spec.side == "right" else -radial
        return np.stack([right, distal, palmar])

    def bodies(
        self, q: Float[np.ndarray, " m"]
    ) -> dict[int, tuple[Float[np.ndarray, "3 3"], Float[np.ndarray, "3"]]]:
        """Rotation and position of every body that has a mesh.

        Args:
            q: (m,) actuated joint positions [rad].
        """
        self._pose(self.hand.full_configuration(q))
        rotation = self._data.xmat.reshape(-1, 3, 3)
        palm, origin = rotation[self._palm], self._data.xpos[self._palm]
        return {
            body: (palm.T @ rotation[body], palm.T @ (self._data.xpos[body] - origin))
            for body in self.meshes
        }

    def without_forearm(
        self, below: float, distal: Float[np.ndarray, "3"]
    ) -> dict[int, trimesh.Trimesh]:
        """The surfaces, cut off across the forearm; a body that is all forearm has none.

        Args:
            below: how much is kept below the wrist of what is no finger [m].
            distal: unit vector along the forearm, toward the fingers.
        """
        return without_forearm(
            self.meshes,
            self.bodies(self.hand.neutral),
            self.finger_of_body,
            self.hand.wrist - below * distal,
            distal,
        )

    def landmarks(self, q: Float[np.ndarray, " m"]) -> Float[np.ndarray, "k 3"]:
        """(k, 3) landmarks, in the order of ``hand.tree.names``."""
        return self.hand.landmark_positions(q)

    def bones(self) -> list[tuple[int, int, int]]:
        """(finger, from, to) of the lines between landmarks, as indices into them."""
        names = self.hand.tree.names
        lines = []
        for number, finger in enumerate(self.hand.fingers):
            base = BASES[FINGERS.index(finger)]
            chain = [LANDMARKS[0], *LANDMARKS[base : base + 4]]
            at = [names.index(name) for name in chain if name in names]
            lines += [(number, a, b) for a, b in pairwise(at)]
        return lines

    def _owners(self) -> Int[np.ndarray, " nbody"]:
        hand = self.hand
        low, high = hand.limits.T
        poses = hand.full_configuration(
            np.random.default_rng(0).uniform(low, high, (_POSES, len(low)))
        )
        qpos = hand.qpos(poses)
        self._pose(poses[0])
        palm = self._data.xmat.reshape(-1, 3, 3)[self._palm].copy()
        tips = hand.tips(poses) @ palm.T + self._data.xpos[self._palm]
        return finger_of_body(hand.model, qpos, tips, _POSES)

    def _pose(self, every: Float[np.ndarray, " n"]) -> None:
        self._data.qpos[:] = self.hand.qpos(every)
        mujoco.mj_kinematics(self.hand.model, self._data)
