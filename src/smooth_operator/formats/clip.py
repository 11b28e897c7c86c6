"""Clips: one or two human hands over some seconds, the scene, and parts of clips."""

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
"""Name of the world of clips whose hands are known in the frame of the camera only: x right, y
down, z into the picture [m]."""

NOTES: Final = "notes"
"""Entry of ``Clip.meta`` with a reader's notes for a person: a list of texts without the file."""

RATE: Final = "rate_hz"
"""Entry of ``Clip.meta`` of a file without stamps: the frames a second that were asked for [Hz]."""

ORDER: Final = "order"
"""Entry of ``Clip.meta`` of a plain array: the order of the landmarks that was asked for."""

SIDES: Final[tuple[Side, Side]] = ("right", "left")


@dataclass(frozen=True, eq=False)
class ObjectTrack:
    """A rigid object over a clip.

    Attributes:
        name: name of the object.
        T_world_object: (T, 7) its poses in the clip's world, NaN where it is not known.
        mesh: file of its shape [m], in the object's frame; None if it is not known.
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
    """One or two hands with the same stamps, and what else is known of the scene.

    Attributes:
        name: name of the clip among those of its source, with slashes: ``part1/pick_place/12``.
        hands: side -> recording. All have the same stamps; ``T_world_wrist`` and ``world`` are
            filled in where the layout knows the wrist.
        layout: name of the reader, as in ``READERS``.
        source: the files that it was read from, the first one being the clip's own.
        task: the task in words; None if unknown.
        confidence: side -> (T,) how sure the tracker is of the hand, 0 to 1; NaN where unknown.
        T_world_camera: (T, 7) poses of the camera, its axes x right, y down, z into the picture;
            None if unknown.
        objects: objects that are moved, with the same number of frames.
        shape: side -> MANO's shape parameters (10,) of the sequence, where the layout has them.
        video: the file that shows the clip; None if there is none.
        video_start_s: time in the video of the first frame [s].
        meta: other facts of the layout, as JSON has them.

    Raises:
        RecordingError: there is no hand, or parts do not fit each other.
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
                raise RecordingError(f"{self.name}: the {side} hand is a {hand.side} one")
            if not np.array_equal(hand.stamps, stamps):
                raise RecordingError(f"{self.name}: its hands have different stamps")
        rows: dict[str, Any] = {f"object {o.name!r}": o.T_world_object for o in self.objects}
        rows |= {f"confidence of the {side} hand": c for side, c in self.confidence.items()}
        if self.T_world_camera is not None:
            rows["T_world_camera"] = self.T_world_camera
        for what, values in rows.items():
            if len(values) != len(stamps):
                raise RecordingError(
                    f"{self.name}: {what} has {len(values)} frames, the hands {len(stamps)}"
                )

    def __len__(self) -> int:
        """Frames."""
        return len(self.stamps)

    @property
    def stamps(self) -> Float[np.ndarray, " T"]:
        """(T,) of the frames [s]."""
        return next(iter(self.hands.values())).stamps

    @property
    def world(self) -> str | None:
        """Name of the frame of wrists, objects and camera; None if no wrist is known."""
        return next((hand.world for hand in self.hands.values() if hand.world is not None), None)

    def T_camera_wrist(self, side: Side) -> Float[np.ndarray, "T 7"] | None:
        """(T, 7) poses of a wrist in the camera's frame; None if they can't be known."""
        wrist = self.hands[side].T_world_wrist if side in self.hands else None
        if wrist is None or self.world == CAMERA:
            return wrist
        if self.T_world_camera is None:
            return None
        return poses.relative(self.T_world_camera, wrist)


Frame: TypeAlias = Literal["world", "camera"]
"""Where wrists and objects are given: fixed to the scene, or to the camera."""


def clip_part(clip: Clip, frames: slice) -> Clip:
    """Some consecutive frames of a clip; the video starts with them."""
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
    """A clip whose wrists and objects are given in a frame.

    Args:
        frame: ``world`` for one that is fixed to the scene, ``camera`` for the camera's; None for
            the clip's own, which ``Clip.world`` names.

    Raises:
        RecordingError: the clip does not know its hands in that frame.
    """
    own = clip.world
    if frame is None or own is None or (frame == "camera") == (own == CAMERA):
        return clip
    if frame == "world":
        raise RecordingError(
            f"{clip.name}: its wrists are known in the frame of the camera only; give --frame "
            "camera, or leave it out for the frame that each clip has"
        )
    camera = clip.T_world_camera
    if camera is None:
        raise RecordingError(
            f"{clip.name}: the poses of its camera are not known, so neither are its wrists in the "
            "camera's frame; give --frame world, or leave it out"
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
    """A clip with one of its hands; with all of them for None.

    Raises:
        RecordingError: it does not have that hand.
    """
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
    """Options of a reader that its files do not state.

    Attributes:
        rate: frames a second [Hz], for layouts without times; None for the layout's own.
        side: side of the hand, where the files hold one and do not say; None for the layout's own.
        mano: folder with the user's MANO model files, ``MANO_RIGHT.pkl`` and ``MANO_LEFT.pkl``.
        objects: folder with the meshes of objects; None for the layout's own place.
        order: order of the landmarks in plain arrays; None for the project's own.
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
    """A clip that has not been read: cheap to list, to send to a worker, and to sort.

    Attributes:
        name: name of the clip, unique in its source.
        path: the file or folder that holds it.
        key: part of the file, for a file that holds several.
        layout: name of its reader in ``READERS``; empty if the caller has it.
        size: bytes or frames, for the order of the work; 0 if unknown.
    """

    name: str
    path: Path
    key: str = ""
    layout: str = ""
    size: int = field(default=0, compare=False)
