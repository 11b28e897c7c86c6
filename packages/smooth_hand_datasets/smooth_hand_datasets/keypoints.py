"""Base of the writers for SPIDER and FlashDexRetarget: hands and objects without gaps.

Both programs read hands in a z-up world at one frame rate, accept no missing value, and keep the
mesh of each object in a folder. Short gaps are filled by interpolation. The scene is moved
along z so that the lowest point of the objects is on the floor, z = 0, if their meshes are known.
"""

from __future__ import annotations

import hashlib
import itertools
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from jaxtyping import Float

from smooth_hand_datasets.objects.placement import landmarks_in_world
from smooth_hand_datasets.pipeline.clip import RobotClip
from smooth_hand_datasets.pipeline.writers.arrays import Grid, resampled, slug
from smooth_hand_datasets.pipeline.writers.shards import TarShards
from smooth_operator import poses
from smooth_operator.atomic_files import atomic_write
from smooth_operator.errors import RecordingError, reason, require
from smooth_operator.formats.clip import CAMERA, SIDES, Clip, ObjectTrack
from smooth_operator.types import Side

MOST_MISSING: Final = 0.2
"""Largest share of frames without a hand or an object; such frames are filled by interpolation."""


@dataclass(frozen=True, eq=False)
class Scene:
    """A clip's hands and objects in a z-up world, at one rate, without missing values.

    Attributes:
        points: (T, 21, 3) landmarks [m] by side.
        wrists: (T, 7) poses by side.
        objects: (T, 7) poses of each object, and the folder of its mesh, or None without a mesh.
        holds: index of the object nearest to the hand, by side; empty without objects.
        filled: share of frames with interpolated values.
    """

    points: Mapping[Side, Float[np.ndarray, "T 21 3"]]
    wrists: Mapping[Side, Float[np.ndarray, "T 7"]]
    objects: tuple[tuple[Float[np.ndarray, "T 7"], str | None], ...]
    holds: Mapping[Side, int]
    filled: float


class FileShards(TarShards):
    """Writes files at the paths that another program reads, in tar shards or directly in the
    folder."""

    folder = "shards"

    def __init__(self, *args: Any) -> None:
        self._meshes: dict[tuple[str, str, float], tuple[str, np.ndarray]] = {}
        self._added = 0
        super().__init__(*args)

    def _begin(self, number: int) -> None:
        self._added = 0
        if not self.options.loose:
            super()._begin(number)

    def add_file(self, name: str, content: bytes) -> None:
        """Adds a file to the shard, or writes it to its final path."""
        self._added += len(content)
        if self.options.loose:
            self._put(name, content)
        else:
            super().add_file(name, content)

    def _size(self) -> int:
        return self._added

    def _end(self, number: int) -> dict[str, Any]:
        return {"shard": None} if self.options.loose else super()._end(number)

    def _drop(self) -> None:
        if not self.options.loose:
            super()._drop()

    def _put(self, name: str, content: bytes) -> None:
        path = self.output / name
        path.parent.mkdir(parents=True, exist_ok=True)
        with atomic_write(path) as file:
            file.write(content)

    # The scene of a clip.

    def scene(self, clip: RobotClip, rate: float, folder: str) -> Scene:
        """Collects the hands that are tracked in the world, and the objects.

        Args:
            clip: the clip.
            rate: frames per second.
            folder: folder of the objects' meshes in the output.

        Raises:
            RecordingError: the hands' poses are unknown in a z-up world, too many frames lack a
                hand or an object, or a mesh can't be read.
        """
        name = clip.clip.name
        if clip.clip.world is None or clip.clip.world == CAMERA:
            raise RecordingError(
                f"{name}: its wrists are unknown in a world with gravity along -z, which this "
                "format needs; use a layout with camera poses"
            )
        human = resampled(clip, rate).clip
        points: dict[Side, np.ndarray] = {}
        wrists: dict[Side, np.ndarray] = {}
        missing = np.zeros(len(human), bool)
        for side in SIDES:
            hand = human.hands.get(side)
            if hand is None or hand.T_world_wrist is None:
                continue
            world_points = landmarks_in_world(hand)
            good = np.isfinite(world_points).all(axis=(1, 2)) & poses.is_valid(hand.T_world_wrist)
            if not good.any():  # the hand is not in the clip
                continue
            grid = _filled(human, good, f"the {side} hand")
            points[side] = grid.values(world_points[good])
            wrists[side] = grid.poses(hand.T_world_wrist[good])
            missing |= ~good
        if not points:
            raise RecordingError(f"{name}: the world poses of its hands are unknown; leave it out")
        tracks: list[tuple[np.ndarray, str | None]] = []
        lowest = np.inf
        for item in human.objects:
            good = poses.is_valid(item.T_world_object)
            track = _filled(human, good, f"object {item.name!r}").poses(item.T_world_object[good])
            missing |= ~good
            mesh, hull = (None, None) if item.mesh is None else self._mesh(item, folder)
            if hull is not None:
                matrix = poses.matrices(track)
                heights = hull @ matrix[:, 2, :3].T + matrix[:, 2, 3]
                lowest = min(lowest, float(heights.min()))
            tracks.append((track, mesh))
        lift = -lowest if np.isfinite(lowest) else 0.0
        for values in (*points.values(), *wrists.values(), *(track for track, _ in tracks)):
            values[..., 2] += lift
        if missing.any():
            self.note("short gaps of the tracker were filled by interpolation")
        holds = _held(wrists, [track for track, _ in tracks])
        return Scene(points, wrists, tuple(tracks), holds, float(missing.mean()))

    def _mesh(self, item: ObjectTrack, folder: str) -> tuple[str, np.ndarray]:
        """Writes the mesh of an object once, in metres; returns its folder and convex hull."""
        assert item.mesh is not None
        key = (item.name, item.mesh.as_posix(), item.scale)
        if key not in self._meshes:
            content, hull = read_mesh(item.mesh, item.scale)
            digest = hashlib.sha256(content).hexdigest()[:8]
            place = f"{slug(item.name)}-{digest}"
            if not (self.output / folder / place / "visual.obj").exists():
                self._put(f"{folder}/{place}/visual.obj", content)
            self._meshes[key] = place, hull
        return self._meshes[key]


def read_mesh(path: Path, scale: float) -> tuple[bytes, Float[np.ndarray, "n 3"]]:
    """Converts a mesh to Wavefront OBJ in metres; also returns the corners of its convex hull.

    Raises:
        RecordingError: it can't be read, or has no faces.
        MissingExtraError: trimesh is not installed.
    """
    require("reading the mesh of an object", "objects", "trimesh")
    import trimesh

    try:
        mesh: Any = trimesh.load(path, force="mesh", process=False)
        mesh.apply_scale(scale)
        hull = np.asarray(mesh.convex_hull.vertices, np.float64)
        lines = [f"v {x:.9g} {y:.9g} {z:.9g}\n" for x, y, z in np.asarray(mesh.vertices).tolist()]
        lines += [f"f {a} {b} {c}\n" for a, b, c in (np.asarray(mesh.faces) + 1).tolist()]
    except Exception as error:  # trimesh documents no list of errors
        raise RecordingError(
            f"{path}: can't be read as the mesh of an object ({type(error).__name__}: "
            f"{reason(error)}); use an .obj, .ply, .stl or .glb file with faces"
        ) from error
    return "".join(lines).encode(), hull


def _filled(human: Clip, good: np.ndarray, what: str) -> Grid:
    """Makes the interpolation from the frames in which something is known to all frames of a clip.

    Raises:
        RecordingError: it is unknown in too many frames.
    """
    share = 1.0 - float(good.mean())
    if share > MOST_MISSING:
        raise RecordingError(
            f"{human.name}: {what} is unknown in {share:.0%} of the frames, but at most "
            f"{MOST_MISSING:.0%} can be filled; cut the clip to the frames in which it is tracked"
        )
    return Grid.at(human.stamps[good], human.stamps)


def _held(wrists: Mapping[Side, np.ndarray], tracks: list[np.ndarray]) -> dict[Side, int]:
    """Index of the object that each hand holds: the nearest on average, each object once if
    possible."""
    if not tracks:
        return {}
    sides = list(wrists)
    apart = {
        (side, i): float(np.linalg.norm(wrists[side][:, :3] - track[:, :3], axis=1).mean())
        for side in sides
        for i, track in enumerate(tracks)
    }
    if len(tracks) < len(sides):
        return {side: min(range(len(tracks)), key=lambda i: apart[side, i]) for side in sides}
    best = min(
        itertools.permutations(range(len(tracks)), len(sides)),
        key=lambda pick: sum(apart[side, i] for side, i in zip(sides, pick, strict=True)),
    )
    return dict(zip(sides, best, strict=True))
