"""The three-dimensional part of the page: two hands, their keyvectors, their places."""

from __future__ import annotations

from collections import deque

import numpy as np
import viser

from smooth_operator.ui.human import HumanView, keyvector_colors
from smooth_operator.ui.layout import FOV, plan
from smooth_operator.ui.playback import Playback
from smooth_operator.ui.robot import RobotView

_LINE = 0.0022  # thickness of a keyvector [m]
_PHONE = 0.75  # below this width / height, the panel is a sheet over the canvas's lower part
_SHEET = 0.44  # share of a phone's screen that the sheet covers at first

_Aim = tuple[tuple[int, int], np.ndarray]  # canvas size [px], camera position [m]


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
        self._human = HumanView(scene, playback, "/human")
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
        self._aims: dict[int, deque[_Aim]] = {}
        self._setup(server)
        self.set_overlay(False)

    def draw(self, frame: int) -> None:
        """Show one frame of both hands."""
        pinched = self._pinches[frame]
        self._human.draw(frame, pinched)
        self._robot.draw(frame, pinched)
        tips = {
            "human": self._playback.human[frame, list(self._playback.human_tips)],
            "robot": self._playback.robot_tips[frame],
        }
        colors = keyvector_colors(len(self._playback.fingers), pinched)
        for name, points in tips.items():
            lines = np.stack([np.broadcast_to(points[0], points[1:].shape), points[1:]], axis=1)
            # a line to a missing tip has no length
            lines = np.where(np.isfinite(lines).all(axis=(1, 2), keepdims=True), lines, 0.0)
            self._lines[name].points = lines
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
        camera = client.camera
        covered = _SHEET if camera.aspect < _PHONE else 0.0
        position, target = self._layout.camera(camera.aspect, covered)
        with client.atomic():
            camera.up_direction = self._layout.up
            camera.fov = FOV
            camera.position = position
            camera.look_at = target
        aims = self._aims.setdefault(client.client_id, deque(maxlen=8))
        aims.append(((camera.image_width, camera.image_height), position))

    def greet(self, client: viser.ClientHandle) -> None:
        """Aim a new browser's camera, and again when its canvas changes shape.

        The canvas changes at the start, when the panel docks, and when a window is resized or a
        phone turned. A view that its user has moved is left alone.
        """
        self.aim(client)

        async def check(camera: viser.CameraHandle) -> None:
            aims = self._aims.get(client.client_id)
            if not aims:
                return
            # A report may be older than our last command, and a page that is still loading may
            # drop it for its initial camera: any place that we chose is untouched.
            ours = [position for _, position in aims]
            at = [np.allclose(camera.position, p, atol=1e-3) for p in (self._initial, *ours)]
            reshaped = aims[-1][0] != (camera.image_width, camera.image_height)
            if any(at) and (reshaped or not at[-1]):
                self.aim(client)

        client.camera.on_update(check)

    def forget(self, client: viser.ClientHandle) -> None:
        """Drop what was kept for a browser that has left."""
        self._aims.pop(client.client_id, None)

    def _setup(self, server: viser.ViserServer) -> None:
        server.scene.set_up_direction(self._layout.up)
        server.scene.configure_default_lights(cast_shadow=False)
        camera, (position, target) = server.initial_camera, self._layout.camera(1.4)
        self._initial = position
        camera.position, camera.look_at, camera.up = position, target, self._layout.up
        camera.fov, camera.near, camera.far = FOV, 0.005, 50.0


_HANDS = ("human", "robot")
