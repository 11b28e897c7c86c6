"""The three-dimensional part of the page: the hands, their keyvectors, their places."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import viser

from smooth_operator.teleop.pages.aiming import Aiming
from smooth_operator.teleop.pages.human import HumanView, keyvector_colors, thumb_lines
from smooth_operator.teleop.pages.page_layout import plan
from smooth_operator.teleop.pages.playback import Playback
from smooth_operator.teleop.pages.robot import RobotView

_LINE = 0.0022  # thickness of a keyvector [m]


class Scene:
    """Builds the nodes once, then shows any frame.

    Args:
        server: the viser server to draw on.
        runs: what to draw: the human of the first, the robot of each.
        below: height of a panel that covers the lower edge of the canvas [px].
    """

    def __init__(
        self, server: viser.ViserServer, runs: Sequence[Playback], below: float = 0.0
    ) -> None:
        self._runs = tuple(runs)
        first = self._runs[0]
        self._pinches = first.pinches()
        scene = server.scene
        self._names = ("human", *(f"robot_{i}" for i in range(len(self._runs))))
        self._roots = {name: scene.add_frame(f"/{name}", show_axes=False) for name in self._names}
        self._human = HumanView(scene, first.human_tips, "/human")
        self._robots = [
            RobotView(scene, run, f"/{name}")
            for run, name in zip(self._runs, self._names[1:], strict=True)
        ]
        self._layout = plan(first, *(robot.bounds() for robot in self._robots))
        count = len(first.fingers)
        none = np.zeros(count - 1, bool)
        self._lines = {
            name: scene.add_line_segments(
                f"/{name}/keyvectors",
                np.zeros((count - 1, 2, 3)),
                keyvector_colors(count, none),
                thickness=_LINE,
            )
            for name in self._names
        }
        words = ("human", *(run.label for run in self._runs))
        self._labels = [
            scene.add_label(f"/{name}/label", word, position=top, anchor="bottom-center")
            for name, word, top in zip(self._names, words, self._layout.tops, strict=True)
        ]
        layout = self._layout
        axes = np.stack([layout.right, layout.up, layout.toward])
        self._aiming = Aiming(server, axes, layout.centre, layout.half, below)
        self.set_overlay(False)

    def draw(self, frame: int) -> None:
        """Show one frame of all hands."""
        pinched = self._pinches[frame]
        first = self._runs[0]
        self._human.draw(first.human[frame], pinched)
        tips = [first.human[frame, list(first.human_tips)]]
        for run, robot in zip(self._runs, self._robots, strict=True):
            robot.draw(frame, pinched)
            tips.append(run.robot_tips[frame])
        colors = keyvector_colors(len(first.fingers), pinched)
        for lines, points in zip(self._lines.values(), tips, strict=True):
            lines.points = thumb_lines(points)
            lines.colors = colors

    def set_overlay(self, overlay: bool) -> None:
        """Put all hands in one place, or side by side."""
        shifts = (self._layout.human_shift, *self._layout.robot_shifts)
        for root, shift in zip(self._roots.values(), shifts, strict=True):
            root.position = np.zeros(3) if overlay else shift
        for label in self._labels:
            label.visible = not overlay
        for robot in self._robots:
            robot.set_translucent(overlay)

    def set_meshes(self, visible: bool) -> None:
        """Draw the makers' meshes, or simple shapes, where a run has both."""
        for robot in self._robots:
            robot.set_meshes(visible)

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
