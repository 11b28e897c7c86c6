"""Cameras whose pictures the pages show. They are encoded as JPEG outside the loop's thread."""

from __future__ import annotations

import base64
import contextlib
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from smooth_operator.errors import ConfigError, counted
from smooth_operator.settings import check_range
from smooth_operator.simulation.camera import SimulatedCamera
from smooth_operator.simulation.physics import HandPhysics
from smooth_operator.teleop.components import settings_from_text
from smooth_operator.teleop.sinks.simulation import Simulation
from smooth_operator.teleop.sinks.sink import Sink
from smooth_operator.teleop.sources.webcam.camera import Camera, open_camera, opencv
from smooth_operator.terminal import print_note
from smooth_operator.types import Side

LATE_S: Final = 0.5
"""Age from which a picture is late, so that pages dim it [s]."""
MOST: Final = 4
_WAIT_S: Final = 0.2


@dataclass(frozen=True)
class CameraSettings:
    """Settings of a camera that the pages show.

    Attributes:
        source: number of a camera, counted from 0; its device; the address of a stream, such as
            ``http://192.168.1.30:8080/video`` (MJPEG); or ``mujoco``, a simulated camera that looks
            at the hand and task of the sink ``mujoco``.
        name: name on the page; None for the source.
        side: hand at which the simulated camera looks.
        width: requested width of the picture [pixels].
        height: requested height of the picture [pixels].
        rate: highest rate of pictures [Hz].
        quality: quality of the JPEG, 1 to 100.

    Raises:
        ConfigError: a setting is outside its range.
    """

    source: int | str
    name: str | None = None
    side: Side = "right"
    width: int = 640
    height: int = 480
    rate: float = 15.0
    quality: int = 75

    def __post_init__(self) -> None:
        if isinstance(self.source, int):
            check_range("camera", self.source, 0, 99)
        check_range("camera: width", self.width, 16, 4096, "pixels")
        check_range("camera: height", self.height, 16, 4096, "pixels")
        check_range("camera: rate", self.rate, 0.1, 120.0, "Hz")
        check_range("camera: quality", self.quality, 1, 100)


@dataclass(frozen=True, eq=False)
class Shot:
    """A picture of a camera.

    Attributes:
        number: number of the picture, from 1.
        time: time at which it was read, by the loop's clock [s].
        jpeg: the picture.
    """

    number: int
    time: float
    jpeg: bytes


class _SimulatedCapture:
    """Draws a simulated hand, with the interface of OpenCV's ``VideoCapture``."""

    def __init__(self, simulation: Simulation, settings: CameraSettings) -> None:
        self._simulation, self._settings = simulation, settings
        self._physics: HandPhysics | None = None
        self._camera: SimulatedCamera | None = None
        self._trouble = ""

    def read(self) -> tuple[bool, Any]:
        """Draws the next picture: blue, green and red; False while there is no simulation."""
        settings = self._settings
        time.sleep(1.0 / settings.rate)
        now = self._simulation.snapshot(settings.side)
        if now is None:
            return False, None
        physics, qpos = now
        if physics is not self._physics:
            self.release()
            try:
                self._camera = SimulatedCamera(physics, settings.width, settings.height)
            except ConfigError as error:  # the loop goes on without pictures
                if self._trouble != (trouble := f"camera mujoco: {error}"):
                    print_note(trouble)
                self._trouble = trouble
                return False, None
            self._physics = physics
        assert self._camera is not None
        return True, np.ascontiguousarray(self._camera.draw(qpos)[..., ::-1])

    def release(self) -> None:
        """Releases the OpenGL context."""
        if self._camera is not None:
            self._camera.close()
        self._camera = self._physics = None


class _Feed:
    """Reads a camera, and encodes its newest picture."""

    def __init__(self, settings: CameraSettings, open: Callable[[], Any]) -> None:
        self.name = settings.name or str(settings.source)
        self.shot: Shot | None = None
        self._settings, self._cv2 = settings, opencv()
        self._camera = Camera(open, self.name)
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._run, name=f"jpeg {self.name}", daemon=True)
        self._thread.start()

    @property
    def lost(self) -> bool:
        return self._camera.lost

    def close(self) -> None:
        self._ending.set()
        self._thread.join()
        self._camera.close()

    def _run(self) -> None:
        quality = [self._cv2.IMWRITE_JPEG_QUALITY, self._settings.quality]
        number, due = 0, 0.0
        while not self._ending.wait(max(0.0, due - time.perf_counter())):
            if (picture := self._camera.newest(_WAIT_S)) is None:
                continue
            number, due = number + 1, time.perf_counter() + 1.0 / self._settings.rate
            _, encoded = self._cv2.imencode(".jpg", picture.pixels, quality)
            self.shot = Shot(number, picture.time, encoded.tobytes())


class Cameras:
    """Keeps the newest picture of each camera. Use it as a context manager, or call ``close``.

    A camera that is lost is opened again, once a second; meanwhile its last picture gets older.

    Args:
        texts: settings of each camera: ``SOURCE`` or ``SOURCE,setting=value,...``; see
            ``CameraSettings``.
        sinks: sinks of the run, among them the simulation for ``mujoco``.

    Raises:
        ConfigError: a setting is wrong, or there are more than four cameras.
        MissingExtraError: OpenCV is not installed.
        SourceError: a camera can't be opened.
    """

    def __init__(self, texts: Sequence[str], sinks: Sequence[Sink] = ()) -> None:
        if len(texts) > MOST:
            raise ConfigError(f"the pages show at most {counted(MOST, 'camera')}, not {len(texts)}")
        self._feeds: list[_Feed] = []
        with contextlib.ExitStack() as opened:
            opened.callback(self.close)
            for text in texts:
                settings = settings_from_text(
                    CameraSettings, text, "camera", text.partition(",")[0]
                )
                self._feeds.append(_Feed(settings, _opener(settings, sinks)))
            opened.pop_all()

    def states(self, now: float, known: Sequence[int] | None = None) -> list[dict[str, Any]]:
        """Returns the state of each camera as JSON values.

        Args:
            now: time by the loop's clock [s].
            known: numbers of the pictures that a page has; None for no pictures.

        Returns:
            ``name``; ``number`` of the newest picture (0 without one), its ``time`` and ``age_s``
            [s]; ``lost``: true while a lost camera is being opened again; ``jpeg``: the picture in
            base64, if the page does not have it yet.
        """
        states = []
        for camera, feed in enumerate(self._feeds):
            state: dict[str, Any] = {"name": feed.name, "number": 0, "lost": feed.lost}
            if (shot := feed.shot) is not None:
                state |= {"number": shot.number, "time": shot.time, "age_s": now - shot.time}
                if known is not None and shot.number not in known[camera : camera + 1]:
                    state["jpeg"] = base64.b64encode(shot.jpeg).decode()
            states.append(state)
        return states

    def shot(self, camera: int) -> Shot | None:
        """The newest picture of a camera; None if there is no picture or no such camera."""
        return self._feeds[camera].shot if 0 <= camera < len(self._feeds) else None

    def close(self) -> None:
        """Releases the cameras; a second call does nothing."""
        for feed in self._feeds:
            feed.close()
        self._feeds = []

    def __enter__(self) -> Cameras:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _opener(settings: CameraSettings, sinks: Sequence[Sink]) -> Callable[[], Any]:
    """Function that opens a camera; see ``Camera``."""
    source, size = settings.source, (settings.width, settings.height)
    if source != "mujoco":
        return lambda: open_camera(source, *size, settings.rate)
    simulation = next((sink for sink in sinks if isinstance(sink, Simulation)), None)
    if simulation is None:
        raise ConfigError("--camera mujoco shows the simulated hand: add --sink mujoco")
    capture = _SimulatedCapture(simulation, settings)
    return lambda: capture
