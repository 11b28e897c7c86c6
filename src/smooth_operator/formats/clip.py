"""Clips: recordings of one or two human hands with the scene around them; also cuts clips into
parts."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final, Literal, TypeAlias

import numpy as np
from jaxtyping import Float

from smooth_operator import poses
from smooth_operator.errors import RecordingError
from smooth_operator.types import HandRecording, Side, unit_poses

CAMERA: Final = "camera"
"""Name of the world of clips whose hands are known only in the frame of the camera: x right, y
down, z into the picture [m].
"""

NOTES: Final = "notes"
"""Entry of ``Clip.meta`` with a reader's human-readable notes: a list of strings without the file
name.
"""

RATE: Final = "rate_hz"
"""Entry of ``Clip.meta`` of a file without stamps: the requested frame rate [Hz]."""

ORDER: Final = "order"
"""Entry of ``Clip.meta`` of a plain array: the requested order of the landmarks."""

SIDES: Final[tuple[Side, Side]] = ("right", "left")


@dataclass(frozen=True, eq=False)
class ObjectTrack:
    """Poses of a rigid object over a clip.

    Attributes:
        name: name of the object.
        T_world_object: (T, 7) poses in the clip's world, NaN where unknown.
        mesh: file of its shape, in the object's frame; None if unknown.
        scale: factor from the units of the mesh's file to metres.
    """

    name: str
    T_world_object: Float[np.ndarray, "T 7"]
    mesh: Path | None = None
    scale: float = 1.0

    def __post_init__(self) -> None:
        places = np.asarray(self.T_world_object, np.float64)
        if places.ndim != 2 or places.shape[1] != 7:
            raise RecordingError(
                f"object {self.name!r}: poses must have shape (frames, 7), not {places.shape}"
            )
        object.__setattr__(self, "T_world_object", unit_poses(places))


@dataclass(frozen=True, eq=False)
class Clip:
    """One or two hands with the same timestamps, and what is known of the scene.

    Attributes:
        name: name of the clip among those of its source, with slashes: ``part1/pick_place/12``.
        hands: side -> recording, with ``T_world_wrist`` and ``world`` if the layout has the wrist.
        layout: name of the reader, as in ``READERS``.
        source: files that the clip was read from; the first one is its own.
        task: description of the task; None if unknown.
        confidence: side -> (T,) confidence of the tracker in the hand, 0 to 1; NaN if unknown.
        T_world_camera: (T, 7) poses of the camera (x right, y down, z into the picture); None if
            unknown.
        objects: tracked objects, with the same number of frames.
        shape: side -> (10,) shape parameters of MANO, if the layout has them.
        video: file of the video that shows the clip; None without one.
        video_start_s: time in the video of the first frame [s].
        meta: other facts from the layout, in JSON types.

    Raises:
        RecordingError: there is no hand, or the parts have different numbers of frames.
    """

    name: str
    hands: Mapping[Side, HandRecording]
    layout: str
    source: tuple[Path, ...] = ()
    task: str | None = None
    confidence: Mapping[Side, Float[np.ndarray, " T"]] = field(default_factory=dict)
    T_world_camera: Float[np.ndarray, "T 7"] | None = None
    objects: tuple[ObjectTrack, ...] = ()
    shape: Mapping[Side, Float[np.ndarray, "10"]] = field(default_factory=dict)
    video: Path | None = None
    video_start_s: float = 0.0
    meta: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not self.hands:
            raise RecordingError(f"{self.name}: a clip needs at least one hand")
        stamps = self.stamps
        for side, hand in self.hands.items():
            if hand.side != side:
                raise RecordingError(
                    f"{self.name}: the {side} hand has a recording of a {hand.side} hand"
                )
            if not np.array_equal(hand.stamps, stamps):
                raise RecordingError(f"{self.name}: its hands have different stamps")
        rows: dict[str, Any] = {f"object {o.name!r}": o.T_world_object for o in self.objects}
        rows |= {f"confidence of the {side} hand": c for side, c in self.confidence.items()}
        if self.T_world_camera is not None:
            rows["T_world_camera"] = self.T_world_camera
        for what, values in rows.items():
            if len(values) != len(stamps):
                raise RecordingError(
                    f"{self.name}: {what} has {len(values)} frames, but the hands have "
                    f"{len(stamps)}"
                )

    def __len__(self) -> int:
        """Number of frames."""
        return len(self.stamps)

    @property
    def stamps(self) -> Float[np.ndarray, " T"]:
        """(T,) timestamps of the frames [s]."""
        return next(iter(self.hands.values())).stamps

    @property
    def world(self) -> str | None:
        """Name of the frame in which wrists, objects and camera are given; None if no wrist is
        known."""
        return next((hand.world for hand in self.hands.values() if hand.world is not None), None)


Frame: TypeAlias = Literal["world", "camera"]
"""Frame of wrists and objects: fixed to the scene, or the camera's."""


def clip_part(clip: Clip, frames: slice) -> Clip:
    """Returns a clip of some consecutive frames; its video starts at the first of them."""
    start = frames.start or 0
    camera = clip.T_world_camera
    return replace(
        clip,
        hands={side: hand[frames] for side, hand in clip.hands.items()},
        confidence={side: values[frames] for side, values in clip.confidence.items()},
        T_world_camera=None if camera is None else camera[frames],
        objects=tuple(
            replace(each, T_world_object=each.T_world_object[frames]) for each in clip.objects
        ),
        video_start_s=clip.video_start_s + float(clip.stamps[start] - clip.stamps[0]),
    )


def in_frame(clip: Clip, frame: Frame | None) -> Clip:
    """Returns the clip with the poses of wrists and objects converted to a frame.

    Args:
        frame: ``world`` is fixed to the scene, ``camera`` is the camera's frame; None keeps the
            clip's own frame, ``Clip.world``.

    Raises:
        RecordingError: the poses in that frame are unknown.
    """
    own = clip.world
    if frame is None or own is None or (frame == "camera") == (own == CAMERA):
        return clip
    if frame == "world":
        raise RecordingError(
            f"{clip.name}: its wrist poses are known only in the camera's frame; use --frame "
            "camera, or omit --frame to keep each clip's own frame"
        )
    camera = clip.T_world_camera
    if camera is None:
        raise RecordingError(
            f"{clip.name}: its camera poses are unknown, so the wrist poses in the camera's frame "
            "are unknown too; use --frame world, or omit --frame"
        )

    def measured(pose: np.ndarray) -> np.ndarray:
        return poses.relative(camera, pose)

    hands = {
        side: hand
        if hand.T_world_wrist is None
        else replace(hand, T_world_wrist=measured(hand.T_world_wrist), world=CAMERA)
        for side, hand in clip.hands.items()
    }
    return replace(
        clip,
        hands=hands,
        T_world_camera=np.where(poses.is_valid(camera)[:, None], poses.IDENTITY, np.nan),
        objects=tuple(
            replace(each, T_world_object=measured(each.T_world_object)) for each in clip.objects
        ),
    )


def with_side(clip: Clip, side: Side | None) -> Clip:
    """Returns the clip with only one of its hands; None keeps all hands. Raises RecordingError if
    the clip does not have that hand."""
    if side is None or set(clip.hands) == {side}:
        return clip
    if side not in clip.hands:
        raise RecordingError(f"{clip.name}: it has no {side} hand; leave out --side {side}")
    return replace(
        clip,
        hands={side: clip.hands[side]},
        confidence={name: c for name, c in clip.confidence.items() if name == side},
        shape={name: s for name, s in clip.shape.items() if name == side},
    )


@dataclass(frozen=True)
class ReadingOptions:
    """Settings of a reader for what the files do not state.

    Attributes:
        rate: frame rate [Hz] of layouts without timestamps; None for the layout's own rate.
        side: side of the hand, if a file has one hand and does not state its side.
        mano: folder with the MANO model files ``MANO_RIGHT.pkl`` and ``MANO_LEFT.pkl``.
        objects: folder with the meshes of objects; None for the layout's own folder.
        order: order of the landmarks in plain arrays; None for the project's order.
        assumed: side of the hand in a recording that does not state it.
    """

    rate: float | None = None
    side: Side | None = None
    mano: Path | None = None
    objects: Path | None = None
    order: str | None = None
    assumed: Side = "right"


@dataclass(frozen=True, order=True)
class ClipRef:
    """Reference to a clip that has not been read.

    Attributes:
        name: name of the clip, unique in its source.
        path: the file or folder that holds it.
        key: part of the file, if the file holds several clips.
        layout: name of its reader in ``READERS``; empty if the caller has the reader.
        size: number of bytes or frames, by which the work is ordered; 0 if unknown.
    """

    name: str
    path: Path
    key: str = ""
    layout: str = ""
    size: int = field(default=0, compare=False)
