"""From placed hands, objects and cameras in a data set's own world to a clip in ours."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np
from jaxtyping import Float

from smooth_hand_datasets.mano_model import PlacedHand
from smooth_operator import poses
from smooth_operator.errors import RecordingError
from smooth_operator.formats.both_hands import checked_hands, first_video
from smooth_operator.formats.clip import CAMERA, Clip, ClipRef, ObjectTrack
from smooth_operator.retargeting.palm import palm_axes
from smooth_operator.types import HandRecording, Side

MOST_FRAMES: Final = 1_000_000
_BENT_BACK: Final = 0.3  # palm lengths of the fingertips behind the plane: 20 degrees of all joints
_LONG_BASES: Final = [5, 9, 13, 17]
_LONG_TIPS: Final = [8, 12, 16, 20]


@dataclass(frozen=True, eq=False)
class Thing:
    """An object as the data set has it.

    Attributes:
        name: name of the object.
        poses: (T, 7) in the data set's world, NaN where unknown.
        mesh: its file; left out of the clip where it is not there.
        scale: from the mesh's units to metres.
    """

    name: str
    poses: Float[np.ndarray, "T 7"]
    mesh: Path | None = None
    scale: float = 1.0


@dataclass(frozen=True, eq=False)
class Scene:
    """What a file of a data set holds, in its own world.

    Attributes:
        hands: side -> hands.
        stamps: (T,) [s].
        world: name of our world: z up, or ``CAMERA``.
        to_world: (7,) or (T, 7) pose of the data set's world in ours.
        shape: side -> (10,) shape of the sequence.
        camera: (T, 7) or (7,) pose of the camera in the data set's world, x right, y down, z into
            the picture.
        things: the objects.
        source: the files, the clip's own first.
    """

    hands: Mapping[Side, PlacedHand]
    stamps: Float[np.ndarray, " T"]
    world: str
    source: tuple[Path, ...]
    to_world: Float[np.ndarray, "*n 7"] = field(default_factory=poses.IDENTITY.copy)
    shape: Mapping[Side, Float[np.ndarray, "10"]] = field(default_factory=dict)
    camera: Float[np.ndarray, "*n 7"] | None = None
    things: Sequence[Thing] = ()
    task: str | None = None
    confidence: Mapping[Side, Float[np.ndarray, " T"]] = field(default_factory=dict)
    video: Path | None = None
    meta: Mapping[str, Any] = field(default_factory=dict)

    @np.errstate(all="ignore")  # numbers beyond any hand become NaN or are refused
    def clip(self, ref: ClipRef, layout: str, expects: str) -> Clip:
        """The clip, its hands checked: units, stamps, and that each is of its side by its shape.

        Args:
            ref: its name.
            layout: of the data set.
            expects: what its files should hold, for messages.

        Raises:
            RecordingError: a check fails, or no frame has a hand.
        """
        where = str(self.source[0])
        count = len(self.stamps)
        hands: dict[Side, HandRecording] = {}
        for side, placed in self.hands.items():
            hands[side] = HandRecording(
                _moved(self.to_world, placed.landmarks),
                self.stamps,
                side,
                name=ref.name,
                meta={"format": layout},
                T_world_wrist=poses.compose(self.to_world, placed.T_world_wrist),
                world=self.world,
            )
        hands = checked_hands(hands, where, expects)
        for hand in hands.values():
            _check_bend(hand, where)
        camera = self.camera
        if camera is None and self.world == CAMERA:
            camera = poses.IDENTITY
        if camera is not None:
            moved = poses.compose(self.to_world, np.broadcast_to(camera, (count, 7)))
            camera = poses.IDENTITY if self.world == CAMERA else moved
        return Clip(
            ref.name,
            hands,
            layout,
            self.source,
            self.task,
            {side: self.confidence[side] for side in hands if side in self.confidence},
            T_world_camera=None if camera is None else np.broadcast_to(camera, (count, 7)).copy(),
            objects=tuple(
                ObjectTrack(
                    thing.name,
                    poses.compose(self.to_world, thing.poses),
                    thing.mesh if thing.mesh is not None and thing.mesh.is_file() else None,
                    thing.scale,
                )
                for thing in self.things
            ),
            shape={side: self.shape[side] for side in hands if side in self.shape},
            video=None if self.video is None else first_video(self.video),
            meta=dict(self.meta),
        )


def _check_bend(hand: HandRecording, where: str) -> None:
    """Refuses fingers that bend out of the back of the hand, as those with wrong parameters do.

    The palm of a model is of the side of its file, whatever the parameters are, so that the check
    of the side by the shape can't tell.
    """
    assert hand.valid is not None  # filled in by HandRecording
    whole = hand.landmarks[hand.valid.all(axis=1)]
    if not len(whole):
        return
    axes = palm_axes(whole, hand.side)
    length = np.linalg.norm(whole[:, 9] - whole[:, 0], axis=1)
    reach = whole[:, _LONG_TIPS] - whole[:, _LONG_BASES]
    back = -(reach * np.asarray(axes.palmar)[:, None]).sum(axis=-1).mean(axis=1)
    wrong = int((back > _BENT_BACK * length).sum())
    if 2 * wrong > len(whole):
        raise RecordingError(
            f"{where}, {hand.side} hand: the fingers bend out of the back of the hand in {wrong} "
            f"of {len(whole)} frames; its parameters are of the other side, of a mirrored picture, "
            "or relative to another mean pose than the layout has"
        )


def _moved(pose: Float[np.ndarray, "*n 7"], points: Float[np.ndarray, "T 21 3"]) -> np.ndarray:
    turn = poses.rotation_matrices(pose[..., 3:])
    moved: np.ndarray = points @ np.swapaxes(turn, -1, -2) + pose[..., None, :3]
    return moved


def world_pose(axes: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, "7"]:
    """The pose of a world in ours that differs by its axes, as ``poses.axes`` gives them."""
    return np.concatenate([np.zeros(3), poses.quaternions(axes)])


def checked_count(counts: Mapping[str, int], where: str) -> int:
    """The number of frames that all parts of a file have.

    Raises:
        RecordingError: they differ, or there are none or too many.
    """
    count = next(iter(counts.values()))
    if len(set(counts.values())) > 1:
        counted = ", ".join(f"{name} {n}" for name, n in counts.items())
        raise RecordingError(f"{where}: its parts have different numbers of frames: {counted}")
    if not 0 < count <= MOST_FRAMES:
        raise RecordingError(f"{where}: it has {count} frames; 1 to {MOST_FRAMES:,} are read")
    return count


def rigid(
    matrices: Float[np.ndarray, "*n 4 4"], where: str, *, inverse: bool = False
) -> Float[np.ndarray, "*n 7"]:
    """Poses of homogeneous matrices; of their inverses, for those from world to camera.

    Raises:
        RecordingError: one is no rotation and position.
    """
    if not poses.is_rigid(matrices).all():
        raise RecordingError(f"{where}: it has a matrix that is no rotation and position")
    quaternions = poses.from_matrices(matrices)
    return poses.invert(quaternions) if inverse else quaternions


def stamps_at(count: int, rate: float) -> Float[np.ndarray, " T"]:
    """(T,) evenly spaced stamps [s]."""
    return np.arange(count) / rate


def nearby(folder: Path, *names: str) -> Path | None:
    """The first of some places in a folder or the ones around it that is there.

    Args:
        folder: where to begin; it and its six next parents are looked at.
        names: relative paths.
    """
    for place in (folder, *list(folder.parents)[:6]):
        for name in names:
            if (place / name).exists():
                return place / name
    return None
