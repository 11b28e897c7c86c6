"""Small maps under the hands: the human wrist in its world, the robot's target in its base."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import numpy as np
import viser
from jaxtyping import Float

from smooth_operator.poses import from_rotation_vectors, multiply

HEIGHT: Final = 0.11
"""Of a map, with its label [m]."""
_SCALE: Final = 0.035  # size of the map over that of the room
_REACH: Final = 1.0  # from the origin to the edge of the map [m]
_AXIS: Final = 0.022  # length of the axes of a wrist [m]
_ORIGIN: Final = 0.014  # and of the world's
_FONT: Final = 0.9  # size of the labels
_TURN: Final = multiply(  # x away from the viewer, y to the left; seen from above by 40 degrees
    from_rotation_vectors(np.array([np.deg2rad(40), 0, 0])),
    from_rotation_vectors(np.array([0, 0, np.pi / 2])),
)


class WristMap:
    """Draws a wrist as axes (x red, y green, z blue) near those of its world.

    A wrist that is farther from the origin than the map reaches is drawn at its edge.

    Args:
        scene: where to draw.
        root: name of the parent node.
        word: whose wrist it is, for the label.
    """

    def __init__(self, scene: viser.SceneApi, root: str, word: str) -> None:
        self._word = word
        self._root = scene.add_frame(root, show_axes=False, visible=False)
        self._room = scene.add_frame(
            f"{root}/world", axes_length=_ORIGIN, axes_radius=0.0008, wxyz=_TURN
        )
        self._wrist = scene.add_frame(
            f"{root}/world/wrist", axes_length=_AXIS, axes_radius=0.0016, visible=False
        )
        self._label = scene.add_label(
            f"{root}/label",
            word,
            position=(0.0, 0.0, -0.35 * HEIGHT),
            anchor="center-center",
            font_screen_scale=_FONT,
        )
        self.shown = False

    def put(self, place: Float[np.ndarray, "3"]) -> None:
        """Where its middle is in the scene [m]."""
        self._root.position = place

    def draw(self, pose: list[float] | None, world: str | None) -> None:
        """Show a wrist.

        Args:
            pose: x y z [m], quaternion w x y z; None while there is none.
            world: the name of its frame; None hides the map, of a tracker without a wrist.
        """
        self._show(world is not None)
        if world is None:
            return
        text = f"{self._word} in {world}"
        if self._label.text != text:
            self._label.text = text
        if self._wrist.visible != (pose is not None):
            self._wrist.visible = pose is not None
        if pose is not None:
            self._wrist.position = _SCALE * np.clip(pose[:3], -_REACH, _REACH)
            self._wrist.wxyz = np.array(pose[3:])

    def _show(self, shown: bool) -> None:
        if shown != self.shown:
            self.shown = self._root.visible = shown


class WristMaps:
    """Both maps of one side.

    Args:
        scene: where to draw.
        side: name of the parent node.
    """

    def __init__(self, scene: viser.SceneApi, side: str) -> None:
        self._human = WristMap(scene, f"/{side}/human_wrist", "wrist")
        self._robot = WristMap(scene, f"/{side}/robot_wrist", "target")

    @property
    def height(self) -> float:
        """What they take of the picture under the hands [m]."""
        return HEIGHT if self._human.shown else 0.0

    def put(self, human: Float[np.ndarray, "3"], robot: Float[np.ndarray, "3"]) -> None:
        """Where their middles are [m]."""
        self._human.put(human)
        self._robot.put(robot)

    def draw(self, seen: Mapping[str, Any] | None) -> bool:
        """Show the wrists; see ``LiveSession.look``.

        Returns:
            whether the maps have come or gone, so that the hands need other places.
        """
        before = self.height
        if seen is None:
            self._human.draw(None, None)
            self._robot.draw(None, None)
        else:
            self._human.draw(seen["operator"], seen["world"])
            self._robot.draw(seen["target"], seen["base"])
        return self.height != before
