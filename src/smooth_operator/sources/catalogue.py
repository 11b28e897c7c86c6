"""The live sources, by the word that a user writes."""

from __future__ import annotations

from typing import Final, cast

from smooth_operator.components import Component, build_component
from smooth_operator.sources.live import LiveSource

_HERE: Final = "smooth_operator.sources"

SOURCES: Final[dict[str, Component]] = {
    "replay": Component(f"{_HERE}.replay", "Replay", "a recording at its own rate: replay:FILE"),
    "synthetic": Component(
        f"{_HERE}.synthetic_live", "SyntheticSource", "the built-in operator; needs no tracker"
    ),
    "webcam": Component(f"{_HERE}.webcam", "Webcam", "a camera, by MediaPipe (extra webcam)"),
    "video": Component(f"{_HERE}.webcam", "Video", "a video file, by MediaPipe: video:FILE"),
    "webxr": Component(
        f"{_HERE}.webxr", "WebXr", "a headset's browser: Quest, Vision Pro, PICO (extra webxr)"
    ),
    "manus": Component(
        f"{_HERE}.manus_stream", "ManusStream", "the ZeroMQ stream of glove bridges (extra zmq)"
    ),
    "zmq": Component(f"{_HERE}.zmq_stream", "ZmqSource", "landmarks over ZeroMQ (extra zmq)"),
    "udp": Component(f"{_HERE}.udp", "UdpSource", "landmarks over UDP: udp:PORT"),
}
"""Word -> source."""


def build_source(text: str) -> LiveSource:
    """A source from its text, such as ``replay:glove.npz,speed=2``.

    Raises:
        UnknownNameError: there is no such source or setting.
        ConfigError: a setting can't be read.
    """
    return cast(LiveSource, build_component("source", text, SOURCES))
