"""Reads BVH files of full-body motion capture: a skeleton of joints and its joint angles over time.

A BVH file has a ``HIERARCHY`` of joints, each with an ``OFFSET`` from its parent and ``CHANNELS``
(position and rotation, in the order in which the rotations are applied, in degrees), and a
``MOTION`` of one line of numbers for each frame. An ``End Site`` is the end of the last bone.
Source: the header of a file, as Xsens' MVN User Manual (document MV0319P, section 12.2) describes
it, and the files of Noitom's Axis Studio, whose joints may also have positions. A position replaces
the offset. The y axis is up.

The hand is found by the names that the makers give to its joints (``_MAKERS``). The landmarks are
the positions of the joints, computed by forward kinematics, and the ends of the last bones. The
forearm is the bone from the joint above the wrist, if its name is that of a forearm or an elbow.

BVH files have no unit. It is found by the length of the hand along its middle finger: only one of
the units m, cm, mm and inch gives a hand of 12 to 25 cm.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Final

import numpy as np
from jaxtyping import Float, Int

from smooth_operator.errors import RecordingError, brief, listed
from smooth_operator.formats.arrays import LOG_RATIO, Allowance
from smooth_operator.formats.checks import stamps_from_rate
from smooth_operator.landmarks import FINGERS
from smooth_operator.poses import (
    axes,
    forearm_in_world,
    multiply,
    rotation_matrices,
    wrist_from_landmarks,
)
from smooth_operator.types import HandRecording, Side

WORLD: Final = "bvh"
"""Name of the world frame of wrists from BVH: the origin of the capture, z up."""

EXPECTS: Final = (
    "joints RightHand, RightHandThumb1 to 3, RightHandIndex1 to 3 ... RightHandPinky3 (Axis "
    "Studio, MotionBuilder), or the names of hc_mocap, Xsens or Rokoko, with an End Site at each "
    "fingertip"
)

_UNITS: Final = {"m": 1.0, "cm": 0.01, "mm": 0.001, "inch": 0.0254}
_HAND_M: Final = (0.12, 0.25)
_MOST_JOINTS: Final = 1000
_NUMBER_BYTES: Final = 100
"""Memory for one number of the motion and the values that are computed from it [bytes]."""
_AT_ONCE: Final = 1000  # frames whose rotations are in memory


@dataclass(frozen=True)
class _Maker:
    """Names of a hand's joints: templates with the side, as word or letter, and the finger."""

    wrist: str
    joints: tuple[str, str, str]
    thumb: tuple[str, str, str]
    metacarpal: str = ""
    tip: str = ""
    fingers: tuple[str, ...] = ("Thumb", "Index", "Middle", "Ring", "Pinky")


_NUMBERED = ("{side}Hand{finger}1", "{side}Hand{finger}2", "{side}Hand{finger}3")
_HC = ("hc_{finger}1_{letter}", "hc_{finger}2_{letter}", "hc_{finger}3_{letter}")
_PHALANX = "{side}Finger{finger}"
_MAKERS: Final = (
    # Noitom's NeuronDataReader and MocapApi; also MotionBuilder and Mixamo, which name the tips
    _Maker("{side}Hand", _NUMBERED, _NUMBERED, "{side}InHand{finger}", "{side}Hand{finger}4"),
    # BotRunner64/somehand, hc_mocap_input.py
    _Maker("hc_Hand_{letter}", _HC, _HC),
    # the segments of Xsens' MVN, by its network protocol; a segment begins at its proximal joint
    _Maker(
        "{side}Hand",
        ("{side}{finger}PP", "{side}{finger}MP", "{side}{finger}DP"),
        ("{side}{finger}MC", "{side}{finger}PP", "{side}{finger}DP"),
        "{side}{finger}MC",
        fingers=("First", "Second", "Third", "Fourth", "Fifth"),
    ),
    # Rokoko/rokoko-studio-live-blender, auto_detect_lists/bones.py
    _Maker(
        "{side}Hand",
        (_PHALANX + "Proximal", _PHALANX + "Medial", _PHALANX + "Distal"),
        (_PHALANX + "Metacarpal", _PHALANX + "Proximal", _PHALANX + "Distal"),
        _PHALANX + "Metacarpal",
        _PHALANX + "Tip",
        ("1", "2", "3", "4", "5"),
    ),
)

_CHANNEL: Final = re.compile(r"([XYZ])(position|rotation)", re.IGNORECASE)
_TURNS: Final = "rotation"
_AXES: Final = {True: axes("z", "x", "y"), False: axes("-z", "-x", "y")}
"""World axes of a skeleton that faces along z, with x to its left, and of one that faces along -z.
"""


@dataclass(frozen=True, eq=False)
class HandJoints:
    """Indices of the joints of one hand in a skeleton.

    Attributes:
        landmarks: (21,) indices of the joints.
        elbow: index of the joint of the forearm, or None.
        metacarpals: (4,) indices of the metacarpal bases, or None.
        scale: length of the skeleton's unit [m].
        unit: the unit: ``m``, ``cm``, ``mm`` or ``inch``.
    """

    landmarks: Int[np.ndarray, "21"]
    elbow: int | None
    metacarpals: Int[np.ndarray, "4"] | None
    scale: float
    unit: str


@dataclass(frozen=True, eq=False)
class Skeleton:
    """Skeleton of a BVH file: its joints and the ends of its bones, each listed after its parent.

    Attributes:
        names: name of each joint; an end has none.
        parents: index of the parent; -1 for a root.
        offsets: (J, 3) positions in the parent's frame at rest.
        channels: axis and kind of each number of a frame, by joint: ``("Xposition", ...)``.
    """

    names: tuple[str, ...]
    parents: tuple[int, ...]
    offsets: Float[np.ndarray, "J 3"]
    channels: tuple[tuple[str, ...], ...]

    @property
    def width(self) -> int:
        """Number of values in each frame."""
        return sum(map(len, self.channels))

    @cached_property
    def _columns(self) -> tuple[Int[np.ndarray, "J 3"], Int[np.ndarray, "J 3"], np.ndarray]:
        """Columns of a frame for each joint: the position's x, y, z (-1 if it has none), and the
        rotations in their order (the column after the last if none), with their axes."""
        places = np.full((len(self.names), 3), -1)
        turns = np.full((len(self.names), 3), self.width)
        about = np.zeros((len(self.names), 3), int)
        column = 0
        for joint, channels in enumerate(self.channels):
            done = 0
            for name in channels:
                axis = "XYZ".index(name[0])
                if name[1:] == _TURNS:
                    turns[joint, done], about[joint, done] = column, axis
                    done += 1
                else:
                    places[joint, axis] = column
                column += 1
        return places, turns, about

    def places(self, frames: Float[np.ndarray, "T C"]) -> Float[np.ndarray, "T J 3"]:
        """Positions of all joints and bone ends, in the file's unit and axes."""
        places, turns, about = self._columns
        padded = np.concatenate([frames, np.zeros((len(frames), 1))], axis=1)
        half = np.deg2rad(padded[:, turns]) / 2.0
        factors = np.zeros((*half.shape, 4))
        factors[..., 0] = np.cos(half)
        np.put_along_axis(factors, 1 + about[None, ..., None], np.sin(half)[..., None], axis=-1)
        turned = multiply(multiply(factors[:, :, 0], factors[:, :, 1]), factors[:, :, 2])
        rotations = rotation_matrices(turned)
        local = np.where(places >= 0, padded[:, places], self.offsets)
        out = np.empty_like(local)
        for joint, parent in enumerate(self.parents):
            if parent < 0:
                out[:, joint] = local[:, joint]
            else:
                out[:, joint] = out[:, parent] + np.squeeze(
                    rotations[:, parent] @ local[:, joint, :, None], -1
                )
                rotations[:, joint] = rotations[:, parent] @ rotations[:, joint]
        return out

    @cached_property
    def hands(self) -> dict[Side, HandJoints]:
        """Finds the hands with fingers, by side. Raises RecordingError if there is no hand with
        fingers, or if a fingertip or the unit is unknown."""
        found = {side: self._hand(side) for side in ("right", "left")}
        hands: dict[Any, HandJoints] = {s: hand for s, hand in found.items() if hand is not None}
        if not hands:
            names = [name for name in self.names if name]
            raise RecordingError(
                f"no hand with fingers, only joints such as {listed(names[-6:])}; expected "
                f"{EXPECTS}; enable the fingers in the program that exports the file"
            )
        return hands

    @cached_property
    def _index(self) -> dict[str, int]:
        """Index of each joint by its name in lower case, without the name space before a colon."""
        named = enumerate(self.names)
        return {name.rpartition(":")[2].lower(): at for at, name in named if name}

    def _hand(self, side: Side) -> HandJoints | None:
        letter = side[0].upper()
        for maker in _MAKERS:
            points, bases = [], []
            for number, finger in enumerate(maker.fingers):
                words = {"side": side, "letter": letter, "finger": finger}
                of_finger = maker.joints if number else maker.thumb
                chain = [self._index.get(name.format(**words).lower()) for name in of_finger]
                points += [*chain, self._tip(chain[-1], maker.tip.format(**words).lower())]
                bases.append(self._index.get(maker.metacarpal.format(**words).lower()))
            wrist = self._index.get(maker.wrist.format(side=side, letter=letter).lower())
            if wrist is None or any(point is None for point in points):
                continue
            landmarks = np.array([wrist, *points], int)
            metacarpals = None if None in bases[1:] else np.array(bases[1:], int)
            unit = self._unit(landmarks, side)
            return HandJoints(landmarks, self._elbow(wrist), metacarpals, *unit)
        return None

    def _elbow(self, wrist: int) -> int | None:
        """The joint above the wrist, if its name is that of a forearm (ForeArm, LowerArm) or an
        elbow."""
        above = self.parents[wrist]
        name = self.names[above].lower() if above >= 0 else ""
        return above if "arm" in name or "elbow" in name else None

    def _tip(self, last: int | None, name: str) -> int | None:
        """The named tip of a finger, or the end of its last bone."""
        if last is None:
            return None
        named = self._index.get(name)
        ends = (at for at, parent in enumerate(self.parents) if parent == last)
        return next(ends, None) if named is None else named

    def _unit(self, landmarks: Int[np.ndarray, "21"], side: Side) -> tuple[float, str]:
        """Length of the skeleton's unit [m], and its name."""
        rest = self._rest[landmarks]
        bones = np.linalg.norm(np.diff(rest, axis=0), axis=1)
        last_bones = bones[[3, 7, 11, 15, 19]]
        if not last_bones.all():
            finger = FINGERS[int(np.argmin(last_bones))]
            raise RecordingError(
                f"the End Site of the {side} {finger} is at its last joint, so the fingertip is "
                "unknown; export the skeleton with the lengths of the last bones"
            )
        length = float(np.linalg.norm(rest[9] - rest[0]) + bones[9:12].sum())
        for unit, scale in _UNITS.items():
            if _HAND_M[0] <= scale * length <= _HAND_M[1]:
                return scale, unit
        raise RecordingError(
            f"the {side} hand is {length:.4g} long from the wrist to the middle fingertip; human "
            f"hands have {100 * _HAND_M[0]:g} to {100 * _HAND_M[1]:g} cm, so the file's "
            f"unit is none of {', '.join(_UNITS)}; export the skeleton in centimetres"
        )

    @cached_property
    def _rest(self) -> Float[np.ndarray, "J 3"]:
        """Positions of the joints without any rotation."""
        rest = self.offsets.copy()
        for joint, parent in enumerate(self.parents):
            if parent >= 0:
                rest[joint] += rest[parent]
        return rest

    @cached_property
    def _axes(self) -> Float[np.ndarray, "3 3"]:
        """World axes, which depend on whether the person faces along z or -z; found from the hands'
        positions.
        """
        to_left = sum(
            (self._rest[hand.landmarks[0], 0] - self._rest[0, 0]) * (1 if side == "left" else -1)
            for side, hand in self.hands.items()
        )
        return _AXES[to_left >= 0]

    def recordings(
        self, frames: Float[np.ndarray, "T C"], stamps: Float[np.ndarray, " T"], name: str
    ) -> dict[Side, HandRecording]:
        """Makes recordings of the hands and their wrists from some frames.

        Args:
            frames: numbers of each frame, in the order of the channels.
            stamps: their timestamps [s].
            name: name of the recordings.

        Raises:
            RecordingError: as ``hands``.
        """
        made: dict[Side, HandRecording] = {}
        parts = [self.places(frames[k : k + _AT_ONCE]) for k in range(0, len(frames), _AT_ONCE)]
        for side, hand in self.hands.items():
            ours = hand.scale * np.concatenate(parts) @ self._axes.T
            landmarks = ours[:, hand.landmarks]
            wrist = wrist_from_landmarks(landmarks, side)
            elbow = None if hand.elbow is None else ours[:, hand.elbow]
            made[side] = HandRecording(
                landmarks,
                stamps,
                side,
                metacarpals=None if hand.metacarpals is None else ours[:, hand.metacarpals],
                T_world_wrist=wrist,
                world=WORLD,
                forearm=None if elbow is None else forearm_in_world(wrist, elbow),
                name=name,
                meta={"format": "bvh", "unit": hand.unit},
            )
        return made


def read_skeleton(lines: Iterator[str]) -> Skeleton:
    """Reads the hierarchy from the lines of a file, up to the line ``MOTION``. Raises
    RecordingError if the hierarchy is damaged."""
    names: list[str] = []
    parents: list[int] = []
    offsets: list[list[float]] = []
    channels: list[tuple[str, ...]] = []
    open_joints: list[int] = []
    for line in lines:
        words = line.split()
        match [words[0].upper() if words else "", *words[1:]]:
            case ["" | "HIERARCHY" | "{"]:
                continue
            case ["ROOT" | "JOINT" | "END" as kind, name, *_] if len(names) < _MOST_JOINTS:
                parents.append(open_joints[-1] if open_joints else -1)
                open_joints.append(len(names))
                names.append("" if kind == "END" else name)
                offsets.append([0.0, 0.0, 0.0])
                channels.append(())
            case ["OFFSET", *numbers] if open_joints and len(numbers) == 3:
                offsets[open_joints[-1]] = _numbers(numbers, "OFFSET")
            case ["CHANNELS", count, *kinds] if open_joints and count == str(len(kinds)):
                channels[open_joints[-1]] = tuple(_channel(kind) for kind in kinds)
            case ["}"] if open_joints:
                open_joints.pop()
            case ["MOTION"] if names and not open_joints:
                return Skeleton(tuple(names), tuple(parents), np.array(offsets), tuple(channels))
            case _:
                break
    else:
        line = "the end of the file"
    raise RecordingError(
        f"the HIERARCHY of a BVH file has joints with OFFSET, CHANNELS and brackets, and ends with "
        f"MOTION; {brief(line.strip())} is out of place"
    )


def _channel(kind: str) -> str:
    match = _CHANNEL.fullmatch(kind)
    if match is None:
        raise RecordingError(f"a channel must be a position or a rotation, not {brief(kind)}")
    return match[1].upper() + match[2].lower()


def _numbers(words: Sequence[str], what: str) -> list[float]:
    try:
        return [float(word) for word in words]
    except ValueError:
        raise RecordingError(f"{what} must hold numbers, not {brief(' '.join(words))}") from None


def read_bvh_hands(
    path: Path, rate: float | None, side: Side | None = None
) -> dict[Side, HandRecording]:
    """Reads both hands of a BVH file, or the only one that has fingers.

    Args:
        rate: frame rate [Hz], for a file without ``Frame Time``.
        side: not used, since the names of the joints state it.

    Raises:
        RecordingError: the file is damaged, or it has no hand with fingers.
    """
    allowance = Allowance.of(path, path.stat().st_size, LOG_RATIO)
    try:
        with path.open(encoding="utf-8-sig", errors="replace") as stream:
            skeleton = read_skeleton(iter(stream))
            stated, period = (
                _numbers([next(stream, "").rpartition(":")[2]], f"the line {word!r}")[0]
                for word in ("Frames:", "Frame Time:")
            )
            most = int(np.clip(np.nan_to_num(stated), 0, 1e12))
            allowance.take("the motion", most * skeleton.width * _NUMBER_BYTES)
            rows = [_numbers(line.split(), "a frame") for line in stream if line.strip()]
        wrong = next((row for row in rows if len(row) != skeleton.width), None)
        if wrong is not None or len(rows) != stated:
            raise RecordingError(
                f"the file states {stated:g} frames of {skeleton.width} numbers, but it has "
                f"{len(rows)} frames"
                + (f", one of {len(wrong)} numbers" if wrong is not None else "")
                + "; the file is incomplete or damaged: export it again"
            )
        stamps = (
            period * np.arange(len(rows))
            if period > 0
            else stamps_from_rate(len(rows), rate, str(path))
        )
        return skeleton.recordings(np.array(rows), stamps, path.stem)
    except RecordingError as error:
        raise RecordingError(f"{path}: {error}") from error
