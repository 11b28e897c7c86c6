"""The three-dimensional part of the page: two hands, their keyvectors, their places."""

from __future__ import annotations

import numpy as np
import viser

from smooth_operator.ui.aiming import Aiming
from smooth_operator.ui.human import HumanView, keyvector_colors, thumb_lines
from smooth_operator.ui.layout import plan
from smooth_operator.ui.playback import Playback
from smooth_operator.ui.robot import RobotView

_LINE = 0.0022  # thickness of a keyvector [m]


class Scene:
    """Builds the nodes once, then shows any frame.

    Args:
        server: the viser server to draw on.
        playback: what to draw.
    """

    def __init__(self, server: viser.ViserServer, playback: Playback) -> None:
        self._playback = playback
        self._pinches = playback.pinches()
        scene = server.scene
        self._roots = {name: scene.add_frame(f"/{name}", show_axes=False) for name in _HANDS}
        self._human = HumanView(scene, playback.human_tips, "/human")
        self._robot = RobotView(scene, playback, "/robot")
        self._layout = plan(playback, self._robot.bounds())
        count = len(playback.fingers)
        none = np.zeros(count - 1, bool)
        self._lines = {
            name: scene.add_line_segments(
                f"/{name}/keyvectors",
                np.zeros((count - 1, 2, 3)),
                keyvector_colors(count, none),
                thickness=_LINE,
            )
            for name in _HANDS
        }
        self._labels = [
            scene.add_label(f"/{name}/label", name, position=top, anchor="bottom-center")
            for name, top in zip(_HANDS, self._layout.tops, strict=True)
        ]
        layout = self._layout
        axes = np.stack([layout.right, layout.up, layout.toward])
        self._aiming = Aiming(server, axes, layout.centre, layout.half)
        self.set_overlay(False)

    def draw(self, frame: int) -> None:
        """Show one frame of both hands."""
        pinched = self._pinches[frame]
        self._human.draw(self._playback.human[frame], pinched)
        self._robot.draw(frame, pinched)
        tips = {
            "human": self._playback.human[frame, list(self._playback.human_tips)],
            "robot": self._playback.robot_tips[frame],
        }
        colors = keyvector_colors(len(self._playback.fingers), pinched)
        for name, points in tips.items():
            self._lines[name].points = thumb_lines(points)
            self._lines[name].colors = colors

    def set_overlay(self, overlay: bool) -> None:
        """Put both hands in one place, or side by side."""
        shifts = (self._layout.human_shift, self._layout.robot_shift)
        for root, shift in zip(self._roots.values(), shifts, strict=True):
            root.position = np.zeros(3) if overlay else shift
        for label in self._labels:
            label.visible = not overlay
        self._robot.set_ghost(overlay)

    def set_keyvectors(self, visible: bool) -> None:
        """Show or hide the thumb-to-tip lines."""
        for lines in self._lines.values():
            lines.visible = visible

    def aim(self, client: viser.ClientHandle) -> None:
        """Point one browser's camera at both hands, whatever the shape of its window."""
        self._aiming.aim(client)

    def greet(self, client: viser.ClientHandle) -> None:
        """Aim a new browser's camera, and again when its canvas changes shape."""
        self._aiming.greet(client)

    def forget(self, client: viser.ClientHandle) -> None:
        """Drop what was kept for a browser that has left."""
        self._aiming.forget(client)


_HANDS = ("human", "robot")
