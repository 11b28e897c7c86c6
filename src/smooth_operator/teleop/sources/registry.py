"""The live sources, by the name that a user writes."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING, Final, cast, get_type_hints

from smooth_operator.errors import ConfigError
from smooth_operator.plugins import Entry, Registry
from smooth_operator.teleop.components import build_component

if TYPE_CHECKING:  # --help names the sources, and needs no NumPy
    from smooth_operator.teleop.sources.live import LiveSource
    from smooth_operator.teleop.sources.stream import Hands

_HERE: Final = "smooth_operator.teleop.sources"

SOURCES: Final = Registry(
    "source",
    {
        "replay": Entry(f"{_HERE}.replay:Replay", "a recording at its own rate: replay:FILE"),
        "synthetic": Entry(
            f"{_HERE}.synthetic_live:SyntheticSource", "the built-in operator; needs no tracker"
        ),
        "webcam": Entry(
            f"{_HERE}.webcam.webcam_source:Webcam", "a camera, by MediaPipe (extra webcam)"
        ),
        "video": Entry(
            f"{_HERE}.webcam.webcam_source:Video", "a video file, by MediaPipe: video:FILE"
        ),
        "webxr": Entry(
            f"{_HERE}.webxr:WebXr", "a headset's browser: Quest, Vision Pro, PICO (extra webxr)"
        ),
        "hts": Entry(f"{_HERE}.hts:HtsSource", "the Quest app Hand Tracking Streamer: hts:0.0.0.0"),
        "avp": Entry(
            f"{_HERE}.avp:AvpSource",
            "the Vision Pro app Tracking Streamer: avp:ADDRESS (extra avp)",
        ),
        "pico": Entry(f"{_HERE}.pico:PicoSource", "the PICO app XRoboToolkit: pico:0.0.0.0"),
        "manus": Entry(
            f"{_HERE}.manus_gloves:ManusStream",
            "the ZeroMQ stream of glove bridges (extra zmq)",
        ),
        "zmq": Entry(f"{_HERE}.zmq_stream:ZmqSource", "landmarks over ZeroMQ (extra zmq)"),
        "ros2": Entry(
            "smooth_operator.teleop.ros2.source:Ros2Source",
            "hand poses from ROS 2 topics, without a ROS 2 installation too (extra ros2)",
        ),
        "udp": Entry(f"{_HERE}.udp:UdpSource", "landmarks over UDP: udp:PORT"),
    },
    needs=("label", "start", "stop", "health"),
)
"""Name -> source, a dataclass of its settings (``LiveSource``)."""


def build_source(text: str, hands: Hands | None = None) -> LiveSource:
    """A source from its text, such as ``replay:glove.npz,speed=2``.

    Args:
        text: name and settings.
        hands: which hands are wanted, for a source that has a setting for it which the text
            leaves out.

    Raises:
        UnknownNameError: there is no such source or setting.
        ConfigError: a setting can't be read, the text is the name of a file, or the class can't
            be imported or is no source.
    """
    if text.partition(":")[0] not in SOURCES:
        word = _word_for(Path(text.partition(",")[0]))
        if word is not None:
            raise ConfigError(
                f"{text!r} is a file, and a source is a word and what it takes: write {word}:{text}"
            )
    source = build_component(SOURCES, text)
    if hands is not None and _takes_hands(source):
        settings = SOURCES.split(text)[1].split(",")
        if not any(part.startswith("side=") for part in settings):
            source = dataclasses.replace(source, side=hands)
    return cast("LiveSource", source)


def _takes_hands(source: object) -> bool:
    from smooth_operator.teleop.sources.stream import Hands

    return bool(get_type_hints(type(source)).get("side") == Hands)


def _word_for(path: Path) -> str | None:
    """The source that a file is for, by its name."""
    from smooth_operator.formats.registry import recording_suffixes
    from smooth_operator.teleop.sources.webcam.camera import is_video

    if is_video(path):
        return "video"
    return "replay" if path.suffix.lower() in recording_suffixes() else None
