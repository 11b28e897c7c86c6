"""A robot hand on the live page, on one of the models that it can be drawn on."""

from __future__ import annotations

from collections.abc import Iterator

import mujoco
import numpy as np
import viser
from jaxtyping import Float

from smooth_operator.hands.hand import Hand
from smooth_operator.teleop.pages.body_nodes import BodyNodes
from smooth_operator.teleop.pages.hand_view import HandView
from smooth_operator.teleop.pages.page_layout import FOREARM
from smooth_operator.teleop.pages.palette import SIMULATED

_TRANSLUCENT = 0.45  # opacity of a hand that overlaps another
_WITHIN = 0.985  # size of a simulated body, which is seen where it leaves the commanded one


class RobotBodies:
    """The hand at its command, and see-through the hand as it is simulated.

    Args:
        scene: where to draw.
        hand: the robot hand, in the order of whose joints poses come.
        view: the same hand on the model to draw, with the same joints by name, in any order.
        root: name of the parent node, in the palm frame.
        up: unit vector along the forearm, toward the fingers.
        simulated: whether there is a simulated hand.
    """

    def __init__(
        self,
        scene: viser.SceneApi,
        hand: Hand,
        view: HandView,
        root: str,
        up: Float[np.ndarray, "3"],
        simulated: bool,
    ) -> None:
        drawn = view.hand
        self._drawn = drawn
        self._rest = drawn.full_configuration(drawn.neutral)
        self._order = [drawn.joint_names.index(name) for name in hand.joint_names]
        self._meshes = view.without_forearm(FOREARM, up)
        owner = view.finger_of_body
        wxyz, position = _inverse_palm(drawn)
        scene.add_frame(root, show_axes=False, wxyz=wxyz, position=position)
        self.command = BodyNodes(scene, drawn.model, self._meshes, owner, f"{root}/command")
        fingers = {body: mesh for body, mesh in self._meshes.items() if owner[body] >= 0}
        self._simulated = (
            BodyNodes(
                scene,
                drawn.model,
                fingers,
                owner,
                f"{root}/simulated",
                color=SIMULATED,
                opacity=_TRANSLUCENT,
                scale=_WITHIN,
            )
            if simulated
            else None
        )

    def draw(self, every: Float[np.ndarray, " n"], other: Float[np.ndarray, " n"] | None) -> None:
        """Show a pose, and the one that is seen where it differs."""
        self.command.draw(self._qpos(every))
        if self._simulated is not None and other is not None:
            self._simulated.draw(self._qpos(other))

    def show(self, visible: bool, simulated: bool, overlay: bool) -> None:
        """Show or hide it; the simulated hand, too; see-through if hands overlap."""
        self.command.set_visible(visible)
        self.command.set_opacity(_TRANSLUCENT if overlay else None)
        if self._simulated is not None:
            self._simulated.set_visible(visible and simulated)

    def corners(self, every: Float[np.ndarray, " n"]) -> Iterator[Float[np.ndarray, "8 3"]]:
        """Corners of the bodies' boxes in a pose, in the palm frame [m]."""
        self.command.place(self._qpos(every))
        data, palm = self.command.data, self._drawn.model.body(self._drawn.spec.palm).id
        turn, origin = data.xmat[palm].reshape(3, 3), data.xpos[palm]
        for body, mesh in self._meshes.items():
            box = mesh.bounding_box.vertices @ data.xmat[body].reshape(3, 3).T
            yield (box + data.xpos[body] - origin) @ turn

    def _qpos(self, every: Float[np.ndarray, " n"]) -> Float[np.ndarray, " nq"]:
        """Joint positions of the drawn model; what it has besides the hand's joints rests."""
        positions = self._rest.copy()
        positions[self._order] = every
        return self._drawn.qpos(positions)


def _inverse_palm(hand: Hand) -> tuple[Float[np.ndarray, "4"], Float[np.ndarray, "3"]]:
    """Pose of the model's world in the palm frame; fingers hang from the palm, it does not move."""
    data = mujoco.MjData(hand.model)
    data.qpos[:] = hand.qpos(hand.full_configuration(hand.neutral))
    mujoco.mj_kinematics(hand.model, data)
    palm = data.body(hand.spec.palm)
    wxyz, position = np.empty(4), np.empty(3)
    mujoco.mju_negPose(position, wxyz, palm.xpos, palm.xquat)
    return wxyz, position
