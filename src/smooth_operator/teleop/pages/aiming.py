"""Cameras of browsers: each is pointed at the hands, and again when its window changes shape."""

from __future__ import annotations

from collections import deque

import numpy as np
import viser
from jaxtyping import Float

from smooth_operator.teleop.pages.page_layout import FOV, camera_for

_PHONE = 0.75  # below this width / height, the panel is a sheet over the canvas's lower part
_SHEET = 0.44  # share of a phone's screen that the sheet covers at first
_MOST = 0.6  # share of a canvas that a panel may take from the picture

_Aim = tuple[tuple[int, int], np.ndarray]  # canvas size [px], camera position [m]


class Aiming:
    """Points cameras at a picture.

    Args:
        server: whose browsers they are.
        axes: (3, 3) rows: the picture's right, up and toward the viewer.
        centre: its middle [m].
        half: its half width and half height [m].
        below: height of a panel that covers the lower edge of a desktop's canvas [px].
    """

    def __init__(
        self,
        server: viser.ViserServer,
        axes: Float[np.ndarray, "3 3"],
        centre: Float[np.ndarray, "3"],
        half: tuple[float, float],
        below: float = 0.0,
    ) -> None:
        self._axes, self.centre, self.half, self._below = axes, centre, half, below
        self._aims: dict[int, deque[_Aim]] = {}
        up = axes[1]
        server.scene.set_up_direction(up)
        server.scene.configure_default_lights(cast_shadow=False)
        camera, (position, target) = server.initial_camera, self._camera(1.4, 0.0)
        self._initial = position
        camera.position, camera.look_at, camera.up = position, target, up
        camera.fov, camera.near, camera.far = FOV, 0.005, 50.0

    def aim(self, client: viser.ClientHandle) -> None:
        """Point one browser's camera at both hands, whatever the shape of its window."""
        camera = client.camera
        panel = min(self._below / max(camera.image_height, 1), _MOST)
        covered = _SHEET if camera.aspect < _PHONE else panel
        position, target = self._camera(camera.aspect, covered)
        with client.atomic():
            camera.up_direction = self._axes[1]
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

    def _camera(
        self, aspect: float, covered: float
    ) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
        return camera_for(self._axes, self.centre, self.half, aspect, covered)
