"""Hands of a body capture, as BVH over UDP: Axis Studio (Perception Neuron), hc_mocap and others.

A datagram has the numbers of one frame, in the order of the channels of a BVH file from the same
program. The file has the names, the lengths and the order of rotations, which the stream lacks.

==========  =======================================================================================
form        datagram
==========  =======================================================================================
binary      64 bytes, little-endian: uint16 0xDDFF; version, 4 bytes, the major one last; uint16
            number of values n; uint8 with positions of all joints; uint8 with a reference joint
            first; uint32 index of the person; its name, 32 bytes; uint32 number of the frame;
            3 x uint32 reserved; uint16 0xEEFF. Then n float32.
text        ``INDEX NAME number number ... ||`` for each person, or the numbers alone (hc_mocap)
==========  =======================================================================================

Positions are in the unit of the file, and rotations in degrees. A datagram has no time.

Source: ``NeuronDataReaderManaged.cs`` of https://github.com/pnmocap/Neuron_Mocap_Live_Unity
(Noitom; the header of version 1.1.0.0); the text of hc_mocap from ``hc_mocap_input.py`` of
https://github.com/BotRunner64/somehand.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Final

import numpy as np

from smooth_operator.errors import ConfigError, RecordingError, SmoothOperatorError, brief, listed
from smooth_operator.formats.bvh import Skeleton, read_skeleton
from smooth_operator.formats.checks import check_palm
from smooth_operator.headsets.repeats import Repeats
from smooth_operator.io.plain_files import check_plain_file
from smooth_operator.teleop.sources.inboxes import Inbox, Message, UdpInbox
from smooth_operator.teleop.sources.payload import Reading, check_size
from smooth_operator.teleop.sources.stream import Hands, OneSender, Reader, StreamSource, sides_of
from smooth_operator.types import Side

PORT: Final = 7001
"""UDP port of Noitom's plug-ins; hc_mocap sends to 1118."""

_HEADER: Final = struct.Struct("<H4BHBBI32sIIIIH")
_START: Final = 0xDDFF
_END: Final = 0xEEFF
_VERSION: Final = 1
_REFERENCE: Final = 6
"""Number of values of a reference joint, which come before those of the skeleton."""


@dataclass(frozen=True)
class BvhStream(StreamSource):
    """Source of hands from a body capture whose program broadcasts BVH over UDP.

    UDP has no passwords, so anyone who can send to the port moves the hand. By default the source
    listens on this computer only. There is no flag for a lost hand: a frame that repeats the last
    one exactly does not count as a new one.

    Attributes:
        skeleton: a BVH file that the same program has exported with the same settings.
        port: UDP port to listen on; 0 for any free one, see ``endpoint``.
        host: address to listen on; ``0.0.0.0`` for the whole network.
        person: index of the person, if the program sends several.
        side: hands to use.

    Raises:
        ConfigError: a setting is outside its range, or the skeleton lacks the hand ``side``.
        RecordingError: the skeleton can't be read, or it has no hand with fingers.
    """

    skeleton: Path
    port: int = PORT
    host: str = "127.0.0.1"
    person: int = 0
    side: Hands = "both"

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.sides:
            raise ConfigError(
                f"side is {self.side!r}, but {self.skeleton} has only a "
                f"{listed(self._skeleton.hands)} hand"
            )

    @property
    def label(self) -> str:
        """Short human-readable name of the source."""
        return f"BVH on UDP port {self.port}"

    @property
    def sides(self) -> tuple[Side, ...]:
        """Sides of the hands in use that the skeleton has."""
        return tuple(side for side in sides_of(self.side) if side in self._skeleton.hands)

    @property
    def hint(self) -> str:
        """Advice before the first message."""
        return "; in the capture program, switch on BVH broadcasting by UDP to this address"

    def connect(self) -> Inbox:
        """Opens the port."""
        return UdpInbox(self.host, self.port, "bvh:FILE,port=PORT")

    @cached_property
    def _skeleton(self) -> Skeleton:
        return _read_skeleton_file(self.skeleton)

    def reader(self) -> Reader:
        """Reads the datagrams."""
        sender, repeats = OneSender(), Repeats()
        forms: dict[int, tuple[Skeleton, int]] = {}
        for skip in (0, _REFERENCE):
            own = self._skeleton
            for form in (own, _with_positions(own, True), _with_positions(own, False)):
                forms.setdefault(form.width + skip, (form, skip))

        def read(message: Message, received: float) -> Sequence[Reading]:
            data, host = message
            people = list(read_people(data))
            sender.check(host, received)
            readings = []
            for person, values in people:
                if person not in (None, self.person):
                    continue
                if len(values) not in forms:
                    raise RecordingError(
                        f"a frame has {len(values)} numbers, but {self.skeleton.name} needs "
                        f"{listed(sorted(forms))}; export the skeleton again with the program "
                        "that sends the frames"
                    )
                form, skip = forms[len(values)]
                hands = form.recordings(values[None, skip:], np.zeros(1), "bvh")
                for side in self.sides:
                    frame = replace(hands[side][0], stamp=None)
                    assert frame.valid is not None  # filled in by HandFrame
                    check_palm(frame.landmarks, frame.valid, "the frame")
                    if repeats.new(frame) is not None:
                        readings.append(Reading(frame))
            return readings

        return read


def read_people(data: bytes) -> Iterator[tuple[int | None, np.ndarray]]:
    """Index of each person of a datagram (None if it has none) and the numbers of its frame.

    Raises:
        RecordingError: the datagram has neither form, or an unknown version.
    """
    check_size(data)
    if data[:2] == struct.pack("<H", _START):
        yield _binary(data)
        return
    for part in data.decode("latin-1").split("||"):
        words = part.split()
        person = None
        if len(words) > 2 and words[0].isdecimal() and not _is_number(words[1]):
            person, words = int(words[0]), words[2:]
        try:
            values = np.array([float(word) for word in words])
        except ValueError:
            raise RecordingError(
                f"a frame must be numbers, or begin with 0xDDFF, not {brief(data[:40])}"
            ) from None
        if len(values):
            yield person, values


def _binary(data: bytes) -> tuple[int, np.ndarray]:
    if len(data) < _HEADER.size:
        raise RecordingError(f"a binary frame has a header of 64 bytes, not {len(data)} bytes")
    _, build, revision, minor, major, count, _, _, person, *_, end = _HEADER.unpack_from(data)
    if end != _END:
        raise RecordingError(f"the header of a binary frame must end with 0xEEFF, not {end:#06x}")
    if major != _VERSION:
        raise RecordingError(
            f"version {major}.{minor}.{revision}.{build} of the BVH stream is not known, only "
            f"version {_VERSION}; choose another format in the capture program"
        )
    if len(data) != _HEADER.size + 4 * count:
        raise RecordingError(
            f"a binary frame of {count} numbers must have {_HEADER.size + 4 * count} bytes, not "
            f"{len(data)}"
        )
    return person, np.frombuffer(data, "<f4", offset=_HEADER.size).astype(np.float64)


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


def _read_skeleton_file(path: Path) -> Skeleton:
    """Reads the skeleton of a BVH file and ignores its motion; RecordingError if the file can't be
    opened, or it has no skeleton with a hand and fingers."""
    try:
        check_plain_file(path)
        with path.open(encoding="utf-8-sig", errors="replace") as stream:
            skeleton = read_skeleton(iter(stream))
        assert skeleton.hands  # or it raises an error
        return skeleton
    except OSError as error:
        raise RecordingError(f"{path}: can't be opened: {error.strerror or error}") from error
    except SmoothOperatorError as error:
        raise RecordingError(f"{path}: {error}") from error


def _with_positions(skeleton: Skeleton, everywhere: bool) -> Skeleton:
    """The skeleton with positions of all joints, or of the roots only, before the rotations."""
    place = ("Xposition", "Yposition", "Zposition")
    channels = tuple(
        (place if everywhere or parent < 0 else ())
        + tuple(c for c in own if c.endswith("rotation"))
        if own
        else ()
        for parent, own in zip(skeleton.parents, skeleton.channels, strict=True)
    )
    return replace(skeleton, channels=channels)
