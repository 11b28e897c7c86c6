"""Simulated LeRobot camera that shows the hand in the sink ``mujoco``."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from lerobot.cameras.camera import Camera
from lerobot.utils.errors import DeviceAlreadyConnectedError, DeviceNotConnectedError

from lerobot_camera_smooth_hand.config_smooth_hand_camera import SmoothHandCameraConfig
from smooth_operator.errors import SmoothOperatorError
from smooth_operator.simulation.camera import SimulatedCamera, View
from smooth_operator.teleop.sinks.simulation import Simulation
from smooth_operator.teleop.sinks.sink import Sink
from smooth_operator.types import Side, as_side

_PATIENCE_S: Final = 20.0
"""Longest time that ``connect`` waits for the first picture [s], since OpenGL starts slowly."""

_FRESH_S: Final = 5.0
"""Longest time that an observation waits for a picture that is recent enough [s]. On a busy machine
a picture may take seconds, especially while LeRobot starts."""


class SmoothHandCamera(Camera):
    """Camera that shows the hand that the robot ``smooth_hand`` moves in the sink ``mujoco``.

    A separate thread draws the pictures off screen. On Linux without a display, this needs EGL or
    OSMesa (``draw_off_screen``). Without a graphics card a picture takes tens of milliseconds, so
    keep it small.

    Args:
        config: settings.
    """

    def __init__(self, config: SmoothHandCameraConfig) -> None:
        super().__init__(config)
        if not config.fps or not config.width or not config.height:
            raise ValueError("the camera smooth_hand needs fps, width and height above 0")
        self.config = config
        self._simulation: Simulation | None = None
        self._side: Side | None = None
        self._thread: threading.Thread | None = None
        self._ending = threading.Event()
        self._new = threading.Condition()
        self._picture: np.ndarray | None = None
        self._time = 0.0
        self._number = self._given = 0
        self._error: Exception | None = None

    def attach(self, sinks: Sequence[Sink], sides: Sequence[Side]) -> None:
        """Choose the hand to show; the robot calls this before it connects its cameras.

        Args:
            sinks: open sinks of the robot.
            sides: sides of its hands, right first.

        Raises:
            ValueError: there is no such hand, or no simulation.
        """
        side = sides[0] if self.config.side is None else as_side(self.config.side)
        simulations = [sink for sink in sinks if isinstance(sink, Simulation)]
        if side not in sides or not simulations:
            raise ValueError(
                f"the camera smooth_hand shows a hand in simulation: expected mujoco in "
                f"--robot.sinks and its side among {', '.join(sides)}, not {side}"
            )
        self._simulation, self._side = simulations[0], side

    @property
    def is_connected(self) -> bool:
        """True while pictures are drawn."""
        return self._thread is not None

    @staticmethod
    def find_cameras() -> list[dict[str, Any]]:
        """Returns an empty list, since a simulated camera exists only once it is configured."""
        return []

    def connect(self, warmup: bool = True) -> None:
        """Start drawing, and wait for the first picture.

        Raises:
            DeviceAlreadyConnectedError: it is already connected.
            DeviceNotConnectedError: it has no hand to show, or can't draw.
        """
        del warmup
        if self._thread is not None:
            raise DeviceAlreadyConnectedError("the camera smooth_hand is already connected")
        if self._simulation is None:
            raise DeviceNotConnectedError(
                "the camera smooth_hand belongs to the robot smooth_hand, which connects it: name "
                "it in --robot.cameras"
            )
        self._ending.clear()
        self._error, self._picture = None, None
        self._thread = threading.Thread(target=self._draw, name="smooth_hand camera", daemon=True)
        self._thread.start()
        try:
            self._wait(_PATIENCE_S)
        except BaseException:
            self.disconnect()
            raise

    def read(self) -> np.ndarray:
        """Return the next picture, (height, width, 3) red, green, blue; raises as
        ``async_read``."""
        with self._new:
            self._given = self._number
        return self.async_read(2000.0)

    def async_read(self, timeout_ms: float = 500.0) -> np.ndarray:
        """Return the newest picture that has not been returned before.

        Args:
            timeout_ms: longest time to wait for a picture [ms].

        Raises:
            TimeoutError: no new picture came in time.
            DeviceNotConnectedError: the camera is not connected, or can't draw.
        """
        self._check()
        return self._wait(timeout_ms / 1e3)

    def read_latest(self, max_age_ms: int | None = None) -> np.ndarray:
        """Return the newest picture.

        Args:
            max_age_ms: age above which the picture is an error [ms]. With None, the limit is
                ``stale_s`` of the settings, and the call waits a few seconds for a picture within
                it.

        Raises:
            TimeoutError: the picture is too old.
            DeviceNotConnectedError: the camera is not connected, or can't draw.
        """
        self._check()
        limit = self.config.stale_s if max_age_ms is None else max_age_ms / 1e3
        with self._new:
            self._new.wait_for(
                lambda: self._age() <= limit or self._error is not None,
                _FRESH_S if max_age_ms is None else 0.0,
            )
            self._fail()
            age = self._age()
            if self._picture is None or age > limit:
                raise TimeoutError(
                    f"the newest picture of the simulated camera is {age:.1f} s old, more than "
                    f"{limit:g} s: this machine draws too slowly. Set a smaller width and height, "
                    "or a larger stale_s [s], in the camera's settings: "
                    f"{{type: smooth_hand, width: {self.config.width}, height: "
                    f"{self.config.height}, stale_s: {max(5.0, 2 * age):.0f}}}. A folder that "
                    "lerobot-record has begun must be deleted before the next try"
                )
            self._given = self._number
            return self._picture

    def disconnect(self) -> None:
        """Stop drawing.

        Raises:
            DeviceNotConnectedError: it is not connected.
        """
        self._check()
        thread, self._thread = self._thread, None
        self._ending.set()
        assert thread is not None
        thread.join(_PATIENCE_S)

    def _check(self) -> None:
        if self._thread is None:
            raise DeviceNotConnectedError("the camera smooth_hand is not connected")

    def _age(self) -> float:
        """Age of the newest picture [s]."""
        return time.perf_counter() - self._time

    def _fail(self) -> None:
        if self._error is not None:
            raise DeviceNotConnectedError(f"the camera can't draw: {self._error}") from self._error

    def _wait(self, seconds: float) -> np.ndarray:
        with self._new:
            self._new.wait_for(
                lambda: self._number > self._given or self._error is not None, seconds
            )
            self._fail()
            if self._picture is None or self._number <= self._given:
                raise TimeoutError(f"the camera gave no new picture in {seconds:g} s")
            self._given = self._number
            return self._picture

    def _draw(self) -> None:
        """Draw pictures on the camera's thread; when the task changes, use a new MuJoCo
        renderer."""
        simulation, side, config = self._simulation, self._side, self.config
        assert simulation is not None and side is not None  # noqa: PT018
        assert config.fps and config.width and config.height  # noqa: PT018
        view = View(config.azimuth, config.elevation, config.distance)
        physics, camera = None, None
        try:
            while not self._ending.is_set():
                begun = time.perf_counter()
                snapshot = simulation.snapshot(side)
                if snapshot is None:
                    raise DeviceNotConnectedError("the simulation is closed")
                if snapshot[0] is not physics:
                    if camera is not None:
                        camera.close()
                    physics = snapshot[0]
                    camera = SimulatedCamera(physics, config.width, config.height, view)
                assert camera is not None
                picture = camera.draw(snapshot[1])
                with self._new:
                    self._picture, self._time = picture, begun
                    self._number += 1
                    self._new.notify_all()
                self._ending.wait(max(0.0, begun + 1.0 / config.fps - time.perf_counter()))
        except (SmoothOperatorError, DeviceNotConnectedError, RuntimeError) as error:
            with self._new:
                self._error = error
                self._new.notify_all()
        finally:
            if camera is not None:
                with contextlib.suppress(Exception):  # the context may be gone with the display
                    camera.close()
