"""Converts hands, objects and cameras in a data set's world to a clip in this project's world."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np
from jaxtyping import Float

from smooth_hand_datasets.mano_model import PlacedHand
from smooth_hand_datasets.unpickle import table
from smooth_operator import poses
from smooth_operator.errors import DocumentError, RecordingError
from smooth_operator.formats.both_hands import checked_hands, first_video
from smooth_operator.formats.clip import CAMERA, Clip, ClipRef, ObjectTrack
from smooth_operator.io.documents import read_json
from smooth_operator.poses import wrist_from_landmarks
from smooth_operator.retargeting.palm import palm_axes
from smooth_operator.types import HandRecording, Side

MOST_FRAMES: Final = 1_000_000
_BENT_BACK: Final = 0.3  # palm lengths of the fingertips behind the plane: 20 degrees of all joints
_LONG_BASES: Final = [5, 9, 13, 17]
_LONG_TIPS: Final = [8, 12, 16, 20]


@dataclass(frozen=True, eq=False)
class Thing:
    """An object of a data set.

    Attributes:
        name: name of the object.
        poses: (T, 7) in the data set's world, NaN where unknown.
        mesh: its mesh file; the clip names it only if it exists.
        scale: factor from the mesh's units to metres.
    """

    name: str
    poses: Float[np.ndarray, "T 7"]
    mesh: Path | None = None
    scale: float = 1.0


@dataclass(frozen=True, eq=False)
class Scene:
    """Content of a file of a data set, in the data set's world.

    Attributes:
        hands: placed hands by side.
        stamps: (T,) timestamps [s].
        world: name of the clip's world, which has z up, or ``CAMERA``.
        to_world: (7,) or (T, 7) pose of the data set's world in the clip's.
        shape: (10,) shape parameters by side.
        camera: (T, 7) or (7,) pose of the camera in the data set's world, x right, y down, z
            forward.
        things: the objects.
        source: the files; the first is the clip's own file.
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

    @np.errstate(all="ignore")  # impossible numbers become NaN or are refused
    def clip(self, ref: ClipRef, layout: str, expects: str) -> Clip:
        """Checks units, stamps and sides of the hands, and returns the clip.

        Args:
            ref: reference to the clip, for its name.
            layout: name of the layout.
            expects: expected content of the files, for messages.

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
    """Raises RecordingError if fingers bend out of the back of the hand, a sign of wrong
    parameters.

    The palm of a model always has the side of the model's file, so checking the side by the palm's
    shape does not find wrong parameters.
    """
    assert hand.valid is not None  # set by HandRecording
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
            "or relative to a different mean pose"
        )


def _moved(pose: Float[np.ndarray, "*n 7"], points: Float[np.ndarray, "T 21 3"]) -> np.ndarray:
    turn = poses.rotation_matrices(pose[..., 3:])
    moved: np.ndarray = points @ np.swapaxes(turn, -1, -2) + pose[..., None, :3]
    return moved


def world_pose(axes: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, "7"]:
    """Pose of a world whose axes differ from the clip's, from a result of ``poses.axes``."""
    return np.concatenate([np.zeros(3), poses.quaternions(axes)])


def checked_count(counts: Mapping[str, int], where: str) -> int:
    """Returns the common number of frames of all parts of a file.

    Raises:
        RecordingError: the numbers differ, are zero or too large.
    """
    count = next(iter(counts.values()))
    if len(set(counts.values())) > 1:
        counted = ", ".join(f"{name} {n}" for name, n in counts.items())
        raise RecordingError(f"{where}: its parts have different numbers of frames: {counted}")
    if not 0 < count <= MOST_FRAMES:
        raise RecordingError(f"{where}: it has {count} frames, not 1 to {MOST_FRAMES:,}")
    return count


def rigid(
    matrices: Float[np.ndarray, "*n 4 4"], where: str, *, inverse: bool = False
) -> Float[np.ndarray, "*n 7"]:
    """Converts homogeneous matrices, or their inverses, to poses.

    Raises:
        RecordingError: a matrix is not a rigid transform.
    """
    if not poses.is_rigid(matrices).all():
        raise RecordingError(f"{where}: it has a matrix that is not a rigid transform")
    quaternions = poses.from_matrices(matrices)
    return poses.invert(quaternions) if inverse else quaternions


def nearby(folder: Path, *names: str) -> Path | None:
    """Returns the first relative path that exists in a folder or one of its six nearest parents."""
    for place in (folder, *list(folder.parents)[:6]):
        for name in names:
            if (place / name).exists():
                return place / name
    return None


def read_table(path: Path, needs: Collection[str] = ()) -> dict[Any, Any]:
    """Reads a JSON file that must hold a table with some keys.

    Raises:
        RecordingError: the file can't be read, or holds something else.
    """
    try:
        return table(read_json(path), str(path), needs)
    except (OSError, DocumentError) as error:
        raise RecordingError(f"{path}: it can't be read: {error}") from error


def wrist_of_points(points: Float[np.ndarray, "T 21 3"], side: Side) -> Float[np.ndarray, "T 7"]:
    """Computes poses of the wrist from the points of a hand in a fixed frame, such as the camera's.

    Args:
        points: (T, 21, 3) [m] in a right-handed frame; NaN where missing.

    Returns:
        (T, 7) poses in that frame, NaN where the palm is not seen.
    """
    with np.errstate(all="ignore"):  # of points beyond any hand, which are refused later
        wrist: np.ndarray = wrist_from_landmarks(points, side)
    return wrist
