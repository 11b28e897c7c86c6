"""Shapes of robot hands for pictures: the vendor's meshes if they are on this machine, otherwise
simple shapes."""

from __future__ import annotations

from typing import Final

import numpy as np
from jaxtyping import Float

from smooth_operator.cli.common_options import Meshes
from smooth_operator.cli.page import hand_to_draw
from smooth_operator.hands.hand import Hand
from smooth_operator.teleop.pages.hand_view import HandView, coarser, finger_colors, view_basis
from smooth_operator_benchmark.hand_surface import PALM_COLOR, Surface

_FACES: Final = 4000  # maximum number of triangles of a body in a picture of a hand
_FOREARM: Final = 0.03  # length that is drawn below the wrist [m]


class ModelShape:
    """Meshes of a robot hand, from its model.

    Args:
        hand: the robot hand.
    """

    def __init__(self, hand: Hand) -> None:
        drawn = hand_to_draw(hand, Meshes()) or hand
        self._view = HandView(drawn, simple=drawn is hand)
        self.view = view_basis(drawn)
        self.wrist: Float[np.ndarray, "3"] = np.asarray(drawn.wrist, float)
        order = [hand.joint_names.index(name) for name in drawn.actuated_names]
        self._actuated = np.array(order, int)
        meshes = self._view.without_forearm(_FOREARM, self.view[1])
        self._meshes = {body: coarser(mesh, _FACES) for body, mesh in meshes.items()}

    def surface(self, joints: Float[np.ndarray, " n"]) -> Surface:
        """Returns the triangles in a pose."""
        poses = self._view.bodies(np.asarray(joints, float)[self._actuated])
        colors = finger_colors(len(self._view.hand.fingers))
        triangles, shades = [], []
        for body, mesh in self._meshes.items():
            rotation, position = poses[body]
            owner = self._view.finger_of_body[body]
            corners = (mesh.vertices @ rotation.T + position)[mesh.faces]
            triangles.append(corners)
            color = PALM_COLOR if owner < 0 else colors[owner]
            shades.append(np.tile(np.array(color, np.uint8), (len(corners), 1)))
        if not triangles:
            return Surface(np.empty((0, 3, 3)), np.empty((0, 3), np.uint8))
        return Surface(np.concatenate(triangles), np.concatenate(shades))
