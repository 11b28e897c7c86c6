"""Rokoko Studio's custom streaming: both hands of an actor as JSON v3 over UDP.

A datagram is JSON in UTF-8, plain or as an LZ4 frame::

    {"version": "3.0", "fps": 60, "scene": {"timestamp": 12.5, "actors": [{"name": "...",
        "meta": {"hasGloves": true, "hasLeftGlove": true, "hasRightGlove": true, ...},
        "body": {"rightHand": {"position": {"x": 0.5, "y": 1.1, "z": 0.2},
                               "rotation": {"x": 0, "y": 0, "z": 0, "w": 1}},
                 "rightThumbProximal": {...}, "rightThumbMedial": {...}, ...}}]}}

A finger has ``Proximal``, ``Medial``, ``Distal`` and ``Tip``; the little one is called ``Little``.
Positions are in metres in the room, left-handed: y up, z forward. ``timestamp`` is in seconds from
the start of the scene; a clip that loops goes back. Studio sends a still hand while no glove is on.
A hand therefore counts as lost if ``meta`` says that it has no glove, or if its frame repeats the
last one exactly. The elbow is ``rightLowerArm``; it is measured if ``meta`` says that the actor
wears a suit (``hasBody``).

Source: "Custom Streaming" with its attachment of JSON v3,
https://support.rokoko.com/hc/en-us/articles/4410416376977; ``JsonLiveSerializerV3.cs`` and
``StudioReceiver.cs`` of https://github.com/Rokoko/rokoko-studio-live-unity, where the numbers are
Unity's own; ``live_data_manager.py`` of https://github.com/Rokoko/rokoko-studio-live-blender for
the versions.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from smooth_operator.errors import MissingExtraError, RecordingError, brief, listed
from smooth_operator.formats.checks import check_palm
from smooth_operator.headsets.repeats import Repeats
from smooth_operator.poses import WORLD_AXES, forearm_in_world, points_to_ours, wrist_from_landmarks
from smooth_operator.teleop.sources.inboxes import Inbox, Message, UdpInbox
from smooth_operator.teleop.sources.payload import (
    MAX_BYTES,
    Reading,
    check_size,
    parse_json,
    read_stamp,
)
from smooth_operator.teleop.sources.stream import Hands, OneSender, Reader, StreamSource
from smooth_operator.types import HandFrame, Side

PORT: Final = 14_043
WORLD: Final = "rokoko"
"""Name of the world frame: the room of the scene, z up."""

_LZ4: Final = b"\x04\x22\x4d\x18"
_LARGEST: Final = 16 * MAX_BYTES
"""Largest size of an unpacked datagram [bytes]; five actors with faces need a fifth of it."""
_FINGERS: Final = ("Thumb", "Index", "Middle", "Ring", "Little")
_PARTS: Final = ("Proximal", "Medial", "Distal", "Tip")
_JOINTS: Final[dict[Side, tuple[str, ...]]] = {
    side: (f"{side}Hand", *(f"{side}{finger}{part}" for finger in _FINGERS for part in _PARTS))
    for side in ("left", "right")
}
_GLOVES: Final[dict[Side, str]] = {"left": "hasLeftGlove", "right": "hasRightGlove"}


@dataclass(frozen=True)
class RokokoStream(StreamSource):
    """Both hands of an actor from Rokoko Studio's custom streaming, JSON v3.

    UDP has no passwords, so anyone who can send to the port moves the hand. By default the source
    listens on this computer only.

    Attributes:
        host: address to listen on; ``0.0.0.0`` for the whole network.
        port: UDP port to listen on; 0 for any free one, see ``endpoint``.
        actor: name of the actor in Studio; empty for the first one.
        side: hands to use.

    Raises:
        ConfigError: a setting is outside its range.
    """

    label = "Rokoko Studio"
    host: str = "127.0.0.1"
    port: int = PORT
    actor: str = ""
    side: Hands = "both"

    @property
    def hint(self) -> str:
        """Advice before the first message."""
        return "; in Studio, add this address and port under Custom Streaming, format JSON v3"

    def connect(self) -> Inbox:
        """Takes the port."""
        try:
            import lz4.frame  # noqa: F401  (before the thread starts, where its error has a reader)
        except ImportError as error:
            raise MissingExtraError("the source 'rokoko'", "rokoko") from error
        return UdpInbox(self.host, self.port, "rokoko:port=PORT")

    def reader(self) -> Reader:
        """Reads the datagrams."""
        sender, repeats = OneSender(), Repeats()

        def read(message: Message, received: float) -> Sequence[Reading]:
            data, host = message
            frames = read_scene(data, self.actor)
            sender.check(host, received)
            return [Reading(frame) for frame in frames if repeats.new(frame) is not None]

        return read


def read_scene(data: bytes, actor: str) -> list[HandFrame]:
    """Hands of an actor in a datagram, with the scene's timestamp if it has one.

    Args:
        data: the datagram.
        actor: name of the actor; empty for the first one.

    Raises:
        RecordingError: the datagram is damaged, of another version, or has no such actor.
    """
    message = parse_json(_unpacked(data))
    if not isinstance(message, dict) or "version" not in message:
        raise RecordingError("the message has no 'version'; choose JSON v3 in Rokoko Studio")
    version = str(message["version"])
    if version.partition(".")[0] != "3" or "scene" not in message:
        raise RecordingError(
            f"the message is of version {version[:20]}, without the 'scene' of JSON v3; choose "
            "JSON v3 in Rokoko Studio"
        )
    scene = _object(message["scene"], "'scene'")
    actors = scene.get("actors")
    if not isinstance(actors, list):
        raise RecordingError(f"'actors' must be a list, not {brief(actors)}")
    people = [_object(one, "an actor") for one in actors]
    chosen = [one for one in people if actor in ("", one.get("name"))]
    if not chosen:
        names = listed(one.get("name") for one in people)
        raise RecordingError(
            f"no actor {actor!r}, but {names}" if people else "the scene has no actor"
        )
    stamp = read_stamp(scene)
    meta = _object(chosen[0].get("meta", {}), "'meta'")
    body = _object(chosen[0].get("body") or {}, "'body'")
    frames = []
    for side, joints in _JOINTS.items():
        if meta.get(_GLOVES[side], True) and any(name in body for name in joints[1:]):
            elbow = _position(body.get(f"{side}LowerArm"), f"{side}LowerArm")
            if meta.get("hasBody") is not True:
                elbow[:] = np.nan
            frames.append(_hand(body, side, joints, elbow, stamp))
    return frames


def _hand(
    body: Mapping[str, Any],
    side: Side,
    joints: Sequence[str],
    elbow: np.ndarray,
    stamp: float | None,
) -> HandFrame:
    points = np.stack([_position(body.get(name), name) for name in joints])
    landmarks = points_to_ours(points, WORLD_AXES["unity"])
    valid = np.isfinite(landmarks).all(axis=1)
    check_palm(landmarks, valid, f"the {side} hand")
    wrist = wrist_from_landmarks(landmarks, side)
    return HandFrame(
        landmarks,
        stamp,
        side,
        valid=valid,
        T_world_wrist=wrist,
        world=WORLD,
        forearm=forearm_in_world(wrist, points_to_ours(elbow, WORLD_AXES["unity"])),
    )


def _position(joint: Any, name: str) -> np.ndarray:
    """Position of a joint; NaN if the frame does not have it."""
    if joint is None:
        return np.full(3, np.nan)
    try:
        place = joint["position"]
        return np.array([np.nan if place[axis] is None else place[axis] for axis in "xyz"], float)
    except (KeyError, TypeError, ValueError, OverflowError):
        raise RecordingError(f"{name!r} must have a 'position' with x, y and z") from None


def _object(value: Any, what: str) -> Mapping[str, Any]:
    if not isinstance(value, dict):
        raise RecordingError(f"{what} must be an object, not {brief(value)}")
    return value


def _unpacked(data: bytes) -> bytes:
    """A datagram without its compression."""
    check_size(data)
    if not data.startswith(_LZ4):
        return data
    import lz4.frame

    try:
        with lz4.frame.LZ4FrameDecompressor() as unpacker:
            text: bytes = unpacker.decompress(data, max_length=_LARGEST)
            whole = unpacker.eof
    except RuntimeError as error:
        raise RecordingError(f"the LZ4 frame is damaged: {error}") from error
    if not whole:
        raise RecordingError(f"the LZ4 frame is cut off, or longer than {_LARGEST} bytes")
    return text
