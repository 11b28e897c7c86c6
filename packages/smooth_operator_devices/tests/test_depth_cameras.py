"""Depth cameras, with modules in place of the makers' that have the functions used here."""

import sys
import time
from collections import defaultdict
from datetime import timedelta
from types import SimpleNamespace
from typing import Any

import headset_apps as app
import numpy as np
import pytest
from live_time import until
from pictures import opencv_or_skip
from tracker_session import started

from smooth_operator.errors import ConfigError, MissingExtraError, SourceError
from smooth_operator.teleop.components import build_source
from smooth_operator.teleop.sources.webcam import camera, picture_tracker
from smooth_operator.teleop.sources.webcam.picture_tracker import SeenHand
from smooth_operator_devices.trackers.depth_cameras import AXES, Depth, place

opencv_or_skip()

LENS = (600.0, 610.0, 310.0, 250.0)
SIZE = (480, 640)
WRIST = np.array([0.05, 0.1, 0.6])
"""Place of the wrist, x right, y down, z away from the camera [m]."""
LARGER = 1.2
"""Size of the hand over that which MediaPipe assumes."""
OFFSETS = app.landmarks(app.hand("right")) @ AXES


def seen() -> SeenHand:
    """The hand as MediaPipe sees it."""
    world = OFFSETS - OFFSETS[0]
    x, y, z = (WRIST + LARGER * world).T
    pixels = np.stack([LENS[0] * x / z + LENS[2], LENS[1] * y / z + LENS[3], 0 * z], axis=1)
    return SeenHand("right", 0.9, OFFSETS, pixels / SIZE[1], np.ones(21, bool))


def depth(metres: float = WRIST[2], background: float = 2.0) -> np.ndarray:
    """The hand's depth around its wrist, with holes, before a wall."""
    values = np.full(SIZE, background)
    column, row = np.rint(seen().picture[0, :2] * SIZE[1]).astype(int)
    values[row - 8 : row + 9, column - 8 : column + 9] = metres
    values[row, column - 1 : column + 2] = 0.0
    return values


def test_the_depth_at_the_wrist_gives_place_and_size():
    wrist, size = place(seen(), Depth(depth(), LENS))
    np.testing.assert_allclose(wrist, WRIST, atol=1e-9)
    assert size == pytest.approx(LARGER)
    for wrong in (depth(background=0.0, metres=0.0), depth(2.0)):  # none, and that of the wall
        assert place(seen(), Depth(wrong, LENS)) is None


PICTURE = np.full((*SIZE, 3), 200, np.uint8)


def holder(**values: Any) -> Any:
    """An object with attributes; a function ``get_x`` for each attribute ``x``."""
    gets = {f"get_{name}": (lambda value=value: value) for name, value in values.items()}
    return SimpleNamespace(**values, **gets)


class RealSense:
    """Functions of pyrealsense2; depth in units of 0.1 mm."""

    stream = SimpleNamespace(depth="depth", color="color")
    format = SimpleNamespace(z16="z16", bgr8="bgr8")

    def __init__(self) -> None:
        self.plugged, self.asked, self.stopped = True, {}, 0

    def config(self) -> Any:
        return SimpleNamespace(
            enable_device=lambda serial: self.asked.update(serial=serial),
            enable_stream=lambda kind, *how: self.asked.update({kind: how}),
        )

    def pipeline(self) -> Any:
        return SimpleNamespace(start=self.start, wait_for_frames=self.wait, stop=self.stop)

    def start(self, config: object) -> Any:
        if not self.plugged:
            raise RuntimeError("No device connected")
        view = holder(**dict(zip(("fx", "fy", "ppx", "ppy"), LENS, strict=True)))
        stream = SimpleNamespace(as_video_stream_profile=lambda: holder(intrinsics=view))
        device = SimpleNamespace(first_depth_sensor=lambda: holder(depth_scale=1e-4))
        return SimpleNamespace(get_device=lambda: device, get_stream=lambda kind: stream)

    def wait(self, timeout_ms: int) -> str:
        if not self.plugged:
            raise RuntimeError(f"Frame didn't arrive within {timeout_ms}")
        time.sleep(0.01)
        return "frames"

    def align(self, to: str) -> Any:
        data = np.rint(depth() * 1e4).astype(np.uint16)
        aligned = holder(color_frame=holder(data=PICTURE), depth_frame=holder(data=data))
        return SimpleNamespace(process=lambda frames: aligned if to == "color" else None)

    def stop(self) -> None:
        self.stopped += 1


class Node:
    """A node of depthai: its inputs and outputs by name, and the settings that it got."""

    def __init__(self, owner: "DepthAi", kind: str) -> None:
        self.owner, self.kind, self.inputs = owner, kind, defaultdict(lambda: Port(self, "in"))

    def __getattr__(self, name: str) -> Any:
        if name.startswith("set"):
            return lambda value: self.owner.settings.update({name: value})
        return self.__dict__.setdefault(name, Port(self, name))

    def build(self, socket: str) -> "Node":
        self.kind = socket
        return self

    def requestOutput(self, size: tuple[int, int], **how: Any) -> "Port":
        return Port(self, f"{size[0]}x{size[1]}")


class Port:
    def __init__(self, node: Node, name: str) -> None:
        self.node, self.name = node, name

    def link(self, other: "Port") -> None:
        self.node.owner.links.add((self.node.kind, self.name, other.node.kind, other.name))

    def createOutputQueue(self, maxSize: int, blocking: bool) -> Any:
        return SimpleNamespace(get=self.node.owner.get)


class DepthAi:
    """Functions of depthai; depth in millimetres."""

    CameraBoardSocket = SimpleNamespace(CAM_A="colour", CAM_B="left", CAM_C="right")
    Platform = SimpleNamespace(RVC2=2, RVC4=4)
    node = SimpleNamespace(Camera="Camera", StereoDepth="Stereo", Sync="Sync", ImageAlign="Align")

    def __init__(self, platform: int) -> None:
        self.platform, self.links, self.settings = platform, set(), {}
        self.plugged, self.closed = True, 0

    def Device(self, *name: str) -> Any:
        if not self.plugged:
            raise RuntimeError("No available devices")
        matrix = [[LENS[0], 0, LENS[2]], [0, LENS[1], LENS[3]], [0, 0, 1]]
        calibration = SimpleNamespace(getCameraIntrinsics=lambda socket, w, h: matrix)
        return SimpleNamespace(
            getPlatform=lambda: self.platform, readCalibration=lambda: calibration, close=self.close
        )

    def Pipeline(self, device: object) -> Any:
        return SimpleNamespace(
            create=lambda kind: Node(self, kind), start=lambda: None, stop=lambda: None
        )

    def get(self, timeout: timedelta) -> Any:
        if not self.plugged:
            return None
        time.sleep(0.01)
        millimetres = np.rint(1e3 * depth()).astype(np.uint16)
        colour = SimpleNamespace(getCvFrame=lambda: PICTURE)
        return {"colour": colour, "depth": SimpleNamespace(getFrame=lambda: millimetres)}

    def close(self) -> None:
        self.closed += 1


@pytest.fixture(autouse=True)
def landmarker(monkeypatch) -> None:
    """MediaPipe sees the hand in every picture."""
    fake = SimpleNamespace(find=lambda picture, time: [seen()], close=lambda: None)
    monkeypatch.setattr(picture_tracker, "HandLandmarker", lambda *_, **__: fake)
    monkeypatch.setattr(picture_tracker, "hand_model", lambda given: given)
    monkeypatch.setattr(camera, "RETRY_S", 0.05)


def check(text: str, maker: Any, gone: str) -> None:
    """A hand in metres in our axes, also after the camera was away."""
    with started(text) as (source, mailbox):
        until(lambda: mailbox.received)
        maker.plugged = False
        until(lambda: "was disconnected" in source.health().detail)
        maker.plugged = True
        until(lambda: mailbox.all[-1].session == 1)
    frame = mailbox.all[0].frame
    assert (frame.side, frame.world) == ("right", "camera")
    x, y, z = WRIST
    np.testing.assert_allclose(frame.T_world_wrist[:3], [z, -x, -y], atol=1e-3)
    np.testing.assert_allclose(frame.T_world_wrist[3:], [1, 0, 0, 0], atol=0.05)
    hand = app.landmarks(app.hand("right"))
    np.testing.assert_allclose(frame.landmarks, LARGER * (hand - hand[0]), atol=1e-3)
    maker.plugged = False
    with pytest.raises(SourceError, match=f"{gone}; connect it by USB 3"):
        build_source(text).start(mailbox)


def test_a_realsense_gives_a_hand_in_metres(monkeypatch):
    maker = RealSense()
    monkeypatch.setitem(sys.modules, "pyrealsense2", maker)
    check("realsense:0123,rate=15", maker, "RealSense 0123 can't be opened: No device connected")
    assert maker.asked == {
        "serial": "0123",
        "depth": (640, 480, "z16", 15),
        "color": (640, 480, "bgr8", 15),
    }
    assert maker.stopped >= 2


@pytest.mark.parametrize("platform", [2, 4])
def test_an_oak_d_gives_a_hand_in_metres(monkeypatch, platform):
    maker = DepthAi(platform)
    monkeypatch.setitem(sys.modules, "depthai", maker)
    check("oak", maker, "OAK-D can't be opened: No available devices")
    aligned = ("Align", "outputAligned") if platform == 4 else ("Stereo", "depth")
    assert maker.links == {
        ("left", "640x400", "Stereo", "left"),
        ("right", "640x400", "Stereo", "right"),
        ("colour", "640x480", "Align" if platform == 4 else "Stereo", "inputAlignTo"),
        ("colour", "640x480", "Sync", "in"),
        (*aligned, "Sync", "in"),
        *([("Stereo", "depth", "Align", "input")] if platform == 4 else []),
    }
    assert maker.closed >= 2


@pytest.mark.parametrize(("name", "library"), [("realsense", "pyrealsense2"), ("oak", "depthai")])
def test_a_missing_library_and_a_mirror_are_refused(monkeypatch, name, library):
    monkeypatch.setitem(sys.modules, library, None)
    with pytest.raises(MissingExtraError, match=f"the source '{name}' needs the extra '{name}'"):
        build_source(name).capture()
    with pytest.raises(ConfigError, match="does not mirror pictures"):
        build_source(f"{name},mirrored=true")
