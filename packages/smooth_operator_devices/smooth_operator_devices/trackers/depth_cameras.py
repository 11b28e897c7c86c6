"""Hands in the pictures of a depth camera: MediaPipe's fingers, with the place and size by depth.

MediaPipe gives a hand of average size without its place. The depth at the wrist gives the place of
the wrist, and how large the hand is in the picture gives its size. The depth is that of the skin,
about 2 cm before the joint.

Sources: ``wrappers/python/examples`` of https://github.com/IntelRealSense/librealsense (Apache-2.0)
and pyrealsense2 2.59; ``examples/python/Depth`` of https://github.com/luxonis/depthai-core (MIT),
and depthai 3.12, whose depth is in millimetres.
"""

from __future__ import annotations

import contextlib
from collections import defaultdict, deque
from collections.abc import Callable
from dataclasses import dataclass
from datetime import timedelta
from typing import Any, ClassVar, Final

import numpy as np
from jaxtyping import Float

from smooth_operator.errors import ConfigError, MissingExtraError, SourceError, reason
from smooth_operator.landmarks import WRIST
from smooth_operator.poses import points_to_ours, wrist_from_landmarks
from smooth_operator.teleop.sources.webcam.camera import Picture
from smooth_operator.teleop.sources.webcam.picture_tracker import (
    AXES,
    WORLD,
    PictureTracker,
    SeenHand,
)
from smooth_operator.teleop.sources.webcam.webcam_source import Webcam
from smooth_operator.types import HandFrame, Side

_WINDOW: Final = 4  # pixels around the wrist whose depth counts
_SIZES: Final = (0.6, 1.6)  # smallest and largest hand, as multiples of MediaPipe's
_MONO: Final = (640, 400)  # pixels of the cameras of an OAK-D that measure depth
_NEWEST: Final = 31  # pictures over which the size is the median
_TIMEOUT_S: Final = 1.0  # longest time between two pictures


@dataclass(frozen=True, eq=False)
class Depth:
    """Depth of a picture.

    Attributes:
        metres: distance of each pixel along the direction of view [m], 0 if unknown.
        lens: focal lengths in x and y and the place of the axis in x and y [pixels].
    """

    metres: Float[np.ndarray, "h w"]
    lens: tuple[float, float, float, float]


class Capture:
    """An open camera, as ``Camera`` reads it.

    Args:
        shoot: function that waits for a picture and its depth; None if there is no pair.
        stop: function that closes the camera.
    """

    def __init__(self, shoot: Callable[[], tuple[Any, Depth] | None], stop: Callable[[], None]):
        self._shoot, self._stop = shoot, stop

    def read(self) -> tuple[Any, ...]:
        """True, a picture (blue, green, red) and its depth; or False if the camera is gone."""
        try:
            shot = self._shoot()
        except RuntimeError:
            shot = None
        return (False, None) if shot is None else (True, *shot)

    def release(self) -> None:
        """Closes the camera."""
        with contextlib.suppress(RuntimeError):
            self._stop()


def place(hand: SeenHand, depth: Depth) -> tuple[Float[np.ndarray, "3"], float] | None:
    """Place of the wrist, and size of a hand by the depth at its wrist.

    The size s puts each landmark p = wrist + s offset on the ray of its pixel, by least squares.

    Returns:
        the wrist [m], and the size as a multiple of MediaPipe's hand, in the camera's axes; None if
        there is no depth at the wrist, or it is not that of a hand.
    """
    fx, fy, cx, cy = depth.lens
    pixels = hand.picture[:, :2] * depth.metres.shape[1]  # both are fractions of the width
    column, row = np.rint(pixels[WRIST]).astype(int)
    rows, columns = (slice(max(k - _WINDOW, 0), max(k + _WINDOW + 1, 0)) for k in (row, column))
    window = depth.metres[rows, columns]
    measured = window[window > 0]
    if not (hand.inside[WRIST] and measured.size):
        return None
    distance = float(np.median(measured))
    rays = (pixels - (cx, cy)) / (fx, fy)
    offsets = hand.world - hand.world[WRIST]
    across = (offsets[:, :2] - rays * offsets[:, 2:]).ravel()
    size = float(across @ ((rays - rays[WRIST]) * distance).ravel() / max(across @ across, 1e-12))
    if not _SIZES[0] <= size <= _SIZES[1]:
        return None
    return distance * np.array([*rays[WRIST], 1.0]), size


@dataclass(frozen=True)
class DepthCamera(Webcam):
    """Base of the sources of depth cameras; further settings are those of ``Webcam``.

    Attributes:
        camera: number of the camera, as its maker gives it; empty for any.
    """

    camera: str = ""
    maker: ClassVar[str]

    @property
    def label(self) -> str:
        """Short human-readable name of the source."""
        return f"{self.maker} {self.camera}".rstrip()

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.mirrored:
            raise ConfigError(f"{self.label} does not mirror pictures; leave out mirrored=true")
        if self.fov is not None:
            raise ConfigError(f"{self.label} measures where the wrist is; leave out fov")
        sizes: dict[Side, deque[float]] = defaultdict(lambda: deque(maxlen=_NEWEST))
        object.__setattr__(self, "_sizes", sizes)

    def frames(self, picture: Picture, tracker: PictureTracker) -> list[HandFrame]:
        """Finds the hands, and places them by depth; a wrist without depth is not valid."""
        hands = tracker.hands(picture.pixels, picture.time)
        return [self._frame(side, hand, picture) for side, hand in hands.items()]

    def _frame(self, side: Side, hand: SeenHand, picture: Picture) -> HandFrame:
        sizes: deque[float] = self.__dict__["_sizes"][side]
        placed = place(hand, picture.depth)
        if placed is not None:
            sizes.append(placed[1])
        size = float(np.median(sizes)) if sizes else 1.0
        points = points_to_ours(size * (hand.world - hand.world[WRIST]), AXES)
        pose = wrist_from_landmarks(points, side)
        pose[:3] = np.nan if placed is None else points_to_ours(placed[0], AXES)
        return HandFrame(
            points, picture.time, side, valid=hand.inside, T_world_wrist=pose, world=WORLD
        )

    def _refused(self, error: Exception) -> SourceError:
        return SourceError(
            f"{self.label} can't be opened: {reason(error)}; connect it by USB 3, check that no "
            f"other program uses it, and that it has {self.width} x {self.height} pixels at "
            f"{self.rate:g} Hz"
        )


@dataclass(frozen=True)
class RealSense(DepthCamera):
    """Hands in front of an Intel RealSense camera; ``camera`` is its serial number."""

    maker = "RealSense"

    def capture(self) -> Capture:
        """Opens the camera; see ``Webcam``."""
        try:
            import pyrealsense2 as rs
        except ModuleNotFoundError as error:
            raise MissingExtraError("the source 'realsense'", "realsense") from error
        picture = (self.width, self.height)
        pipeline, config = rs.pipeline(), rs.config()
        if self.camera:
            config.enable_device(self.camera)
        config.enable_stream(rs.stream.depth, *picture, rs.format.z16, round(self.rate))
        config.enable_stream(rs.stream.color, *picture, rs.format.bgr8, round(self.rate))
        try:
            profile = pipeline.start(config)
        except RuntimeError as error:
            raise self._refused(error) from error
        unit = profile.get_device().first_depth_sensor().get_depth_scale()
        view = profile.get_stream(rs.stream.color).as_video_stream_profile().get_intrinsics()
        align = rs.align(rs.stream.color)

        def shoot() -> tuple[Any, Depth] | None:
            frames = align.process(pipeline.wait_for_frames(round(1e3 * _TIMEOUT_S)))
            colour, depth = frames.get_color_frame(), frames.get_depth_frame()
            if not (colour and depth):
                return None
            lens = (view.fx, view.fy, view.ppx, view.ppy)
            # A copy of the picture, since the library uses the memory again.
            return np.array(colour.get_data()), Depth(unit * np.asarray(depth.get_data()), lens)

        return Capture(shoot, pipeline.stop)


@dataclass(frozen=True)
class OakD(DepthCamera):
    """Hands in front of a Luxonis OAK-D camera; ``camera`` is its device ID or address."""

    maker = "OAK-D"

    def capture(self) -> Capture:
        """Opens the camera; see ``Webcam``."""
        try:
            import depthai as dai
        except ModuleNotFoundError as error:
            raise MissingExtraError("the source 'oak'", "oak") from error
        size, sockets = (self.width, self.height), dai.CameraBoardSocket
        try:
            device = dai.Device(self.camera) if self.camera else dai.Device()
            pipeline = dai.Pipeline(device)
            colour, left, right = (
                pipeline.create(dai.node.Camera).build(socket)
                for socket in (sockets.CAM_A, sockets.CAM_B, sockets.CAM_C)
            )
            pictures = colour.requestOutput(size, fps=self.rate, enableUndistortion=True)
            stereo, sync = pipeline.create(dai.node.StereoDepth), pipeline.create(dai.node.Sync)
            left.requestOutput(_MONO, fps=self.rate).link(stereo.left)
            right.requestOutput(_MONO, fps=self.rate).link(stereo.right)
            stereo.setExtendedDisparity(True)  # for hands nearer than 70 cm
            if device.getPlatform() == dai.Platform.RVC4:
                align = pipeline.create(dai.node.ImageAlign)
                stereo.depth.link(align.input)
                pictures.link(align.inputAlignTo)
                aligned = align.outputAligned
            else:
                pictures.link(stereo.inputAlignTo)
                aligned = stereo.depth
            pictures.link(sync.inputs["colour"])
            aligned.link(sync.inputs["depth"])
            sync.setSyncThreshold(timedelta(seconds=0.5 / self.rate))
            newest = sync.out.createOutputQueue(maxSize=1, blocking=False)
            view = device.readCalibration().getCameraIntrinsics(sockets.CAM_A, *size)
            pipeline.start()
        except RuntimeError as error:
            raise self._refused(error) from error
        lens = (view[0][0], view[1][1], view[0][2], view[1][2])

        def shoot() -> tuple[Any, Depth] | None:
            group = newest.get(timedelta(seconds=_TIMEOUT_S))
            if group is None:
                return None
            millimetres = np.asarray(group["depth"].getFrame())
            return group["colour"].getCvFrame(), Depth(1e-3 * millimetres, lens)

        def stop() -> None:
            pipeline.stop()
            device.close()

        return Capture(shoot, stop)
