"""Layout of a page: offsets side by side, and a camera that frames both hands."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np
import viser
from jaxtyping import Float

from smooth_operator.teleop.pages.hand_view import HandView

GAP = 0.03
"""Free space between the two hands when they stand side by side [m]."""
FOV = float(np.deg2rad(32.0))
"""Vertical field of view [rad]; narrow, so that the two hands are seen from the same side."""

FOREARM = 0.03
"""Length below the wrist that is drawn and framed [m]."""

_MARGIN = 1.1
_LABEL = 0.012  # label above the highest fingertip [m]
_SNAP = np.cos(np.deg2rad(30.0))  # an axis within this of a model axis is that axis
_TILT = np.deg2rad(8.0)  # camera a little off the palm normal: depth can be read


@dataclass(frozen=True, eq=False)
class Layout:
    """Where each hand goes when they stand side by side, in the palm frame.

    Attributes:
        human_shift: offset of the human hand, side by side [m].
        robot_shifts: offset of each robot hand, side by side [m].
        centre: middle of the whole picture, side by side [m].
        tops: points above the human and each robot hand, for labels, before the shifts [m].
        half: half width and half height of the whole picture [m].
    """

    human_shift: Float[np.ndarray, "3"]
    robot_shifts: tuple[Float[np.ndarray, "3"], ...]
    centre: Float[np.ndarray, "3"]
    tops: tuple[Float[np.ndarray, "3"], ...]
    half: tuple[float, float]


def camera_for(
    axes: Float[np.ndarray, "3 3"],
    centre: Float[np.ndarray, "3"],
    half: tuple[float, float],
    aspect: float,
    covered: float = 0.0,
    above: float = 0.0,
) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
    """Position and look-at point of a camera that shows a whole picture.

    Args:
        axes: (3, 3) rows: the picture's right, up and toward the viewer.
        centre: its middle [m].
        half: its half width and half height [m].
        aspect: width / height of the canvas.
        covered: share of the canvas height, from below, that controls cover.
        above: the same from above.
    """
    right, up, toward = axes
    tangent = np.tan(FOV / 2)
    free = 1.0 - covered - above
    width, height = half
    distance = _MARGIN * max(height / (free * tangent), width / (aspect * tangent))
    # the free part's middle is half of this share of a canvas height above the canvas's middle
    target = centre - up * (covered - above) * distance * tangent
    direction = toward + np.tan(_TILT) * (0.6 * right + up)
    return target + distance * direction / np.linalg.norm(direction), target


def plan(
    axes: Float[np.ndarray, "3 3"],
    human: Float[np.ndarray, "T 21 3"],
    wrist: Float[np.ndarray, "3"],
    *robots: Float[np.ndarray, "_ 3"],
) -> Layout:
    """Lay out the scene for a recording: the human hand, and each robot hand to its right.

    Args:
        axes: (3, 3) rows: the picture's right, up and toward the viewer.
        human: (T, 21, 3) landmarks [m]; NaN where there is none.
        wrist: (3,) wrist of one of the robots [m].
        robots: (N, 3) points that bound a robot hand over the recording [m].

    Returns:
        The layout; without any valid human frame it stands on the robot's fingertips.
    """
    points = human[np.isfinite(human).all(axis=-1)]
    points = points if len(points) else robots[0]
    low_h, high_h = _bounds(points @ axes.T, pad=0.01)
    floor = min(low_h[1], float(axes[1] @ wrist)) - FOREARM
    boxes = [(low_h, high_h), *(_above(points @ axes.T, floor) for points in robots)]
    low = np.min([box[0] for box in boxes], axis=0)
    high = np.max([box[1] for box in boxes], axis=0)
    high[1] += _LABEL
    middle = (low + high) / 2
    widths = [(box[1] - box[0])[0] for box in boxes]
    width = sum(widths) + GAP * len(robots)
    left = middle[0] - width / 2
    shifts = []
    for box, own in zip(boxes, widths, strict=True):
        shifts.append((left - box[0][0]) * axes[0])
        left += own + GAP
    return Layout(
        human_shift=shifts[0],
        robot_shifts=tuple(shifts[1:]),
        centre=middle @ axes,
        tops=tuple(_top(*box, high[1]) @ axes for box in boxes),
        half=(width / 2, float(high[1] - low[1]) / 2),
    )


def _above(
    points: Float[np.ndarray, "N 3"], floor: float
) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
    """Bounds of a robot hand in the view's axes, without what is below the floor.

    A forearm may run out of the picture below; framed whole, it would leave the hand small.
    """
    low, high = _bounds(points[points[:, 1] > floor])
    low[1] = max(points[:, 1].min(), floor)
    return low, high


def view_axes(view: HandView) -> Float[np.ndarray, "3 3"]:
    """Right, up and toward the viewer in the palm frame; along its axes where those are near.

    Models are built along their axes: a forearm that leans 10 degrees looks like a mistake.
    """
    up, toward = _snap(view.axes[1]), _snap(view.axes[2])
    toward = _unit(toward - (toward @ up) * up, np.eye(3)[np.abs(up).argmin()])
    return np.stack([np.cross(up, toward), up, toward])


def _unit(
    vector: Float[np.ndarray, "3"], fallback: Float[np.ndarray, "3"]
) -> Float[np.ndarray, "3"]:
    length = float(np.linalg.norm(vector))
    return vector / length if length > 1e-9 else fallback


def _snap(vector: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
    axis = int(np.abs(vector).argmax())
    return np.sign(vector) * np.eye(3)[axis] if abs(vector[axis]) > _SNAP else vector


def _bounds(
    points: Float[np.ndarray, "N 3"], pad: float = 0.0
) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
    return points.min(axis=0) - pad, points.max(axis=0) + pad


def _top(
    low: Float[np.ndarray, "3"], high: Float[np.ndarray, "3"], top: float
) -> Float[np.ndarray, "3"]:
    return np.array([(low[0] + high[0]) / 2, top, (low[2] + high[2]) / 2])


_PHONE = 0.75  # below this width / height, the panel is a sheet over the canvas's lower part
_SHEET = 0.44  # share of a phone's screen that the sheet covers at first
_MOST = 0.6  # share of a canvas that a panel may take from the picture
_LEAST = 0.2  # and what lies above it

_Aim = tuple[tuple[int, int], np.ndarray]  # canvas size [px], camera position [m]


class Aiming:
    """Points cameras at a picture.

    Args:
        server: whose browsers they are.
        axes: (3, 3) rows: the picture's right, up and toward the viewer.
        centre: its middle [m].
        half: its half width and half height [m].
        below: height of a panel that covers the lower edge of a desktop's canvas [px].

    Attributes:
        above: height of what covers the upper edge of the canvas [px].
    """

    above = 0.0

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
        height = max(camera.image_height, 1)
        panel = min(self._below / height, _MOST)
        covered = _SHEET if camera.aspect < _PHONE else panel
        above = min(self.above / height, _LEAST)
        position, target = self._camera(camera.aspect, covered, above)
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
        self, aspect: float, covered: float, above: float = 0.0
    ) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
        return camera_for(self._axes, self.centre, self.half, aspect, covered, above)
