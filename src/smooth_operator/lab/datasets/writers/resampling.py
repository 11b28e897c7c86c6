"""A robot clip at another number of frames a second.

Positions and joint positions are interpolated linearly, rotations along the shortest way; status,
confidence and validity are those of the nearer frame. A value is known only if it is known in both
frames around it, and a command is valid only if both are and no pause of the tracker is between.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Float

from smooth_operator import poses
from smooth_operator.episode_files.lerobot.tables import PAUSE
from smooth_operator.lab.datasets.clip import RobotClip
from smooth_operator.lab.datasets.writers.arrays import clip_valid
from smooth_operator.types import CommandTrajectory, HandRecording, Side


def drift(stamps: Float[np.ndarray, " T"], rate: float) -> float:
    """Distance of stamps from frames at ``rate`` that begin with the first [frames]."""
    if len(stamps) < 2:
        return 0.0
    nominal = np.arange(len(stamps)) / rate
    return float(np.abs(stamps - stamps[0] - nominal).max() * rate)


def resampled(clip: RobotClip, rate: float) -> RobotClip:
    """The clip with frames every 1 / ``rate`` seconds from its first to its last."""
    human = clip.clip
    grid = Grid.of(human.stamps, rate)
    hands: dict[Side, HandRecording] = {s: _hand(h, grid) for s, h in human.hands.items()}
    scene = replace(
        human,
        hands=hands,
        confidence={s: np.asarray(c)[grid.nearest] for s, c in human.confidence.items()},
        T_world_camera=None if human.T_world_camera is None else grid.poses(human.T_world_camera),
        objects=tuple(
            replace(o, T_world_object=grid.poses(o.T_world_object)) for o in human.objects
        ),
    )
    return replace(
        clip,
        clip=scene,
        commands={s: _commands(c, grid) for s, c in clip.commands.items()},
        T_world_wrist={s: grid.poses(w) for s, w in clip.T_world_wrist.items()},
        valid={s: grid.flags(clip_valid(clip, s)) & ~grid.pause for s in clip.commands},
        tracks={name: np.asarray(track)[grid.nearest] for name, track in clip.tracks.items()},
    )


@dataclass(frozen=True, eq=False)
class Grid:
    """Places of new frames among the old ones.

    Attributes:
        stamps: (T,) of the new frames [s].
        before: (T,) number of the old frame before it, or of itself.
        after: (T,) number of the old frame after it, or of itself.
        share: (T,) part of the way from the one to the other.
        pause: (T,) whether the tracker paused between the two.
    """

    stamps: np.ndarray
    before: np.ndarray
    after: np.ndarray
    share: np.ndarray
    pause: np.ndarray

    @classmethod
    def of(cls, old: np.ndarray, rate: float) -> Grid:
        """With frames every 1 / ``rate`` seconds."""
        count = int(np.floor((old[-1] - old[0]) * rate + 1e-6)) + 1
        return cls.at(old, old[0] + np.arange(count) / rate)

    @classmethod
    def at(cls, old: np.ndarray, new: np.ndarray) -> Grid:
        """With frames at given times; those before the first and after the last are these."""
        new = np.clip(new, old[0], old[-1])
        before = np.clip(np.searchsorted(old, new, side="right") - 1, 0, len(old) - 1)
        after = np.minimum(before + 1, len(old) - 1)
        step = np.where(after > before, old[after] - old[before], 1.0)
        share = (new - old[before]) / step
        # An old frame stays as it is, and is not made unknown by the one after it.
        share[share < 1e-6] = 0.0
        share[share > 1.0 - 1e-6] = 1.0
        after = np.where(share == 0.0, before, after)
        before = np.where(share == 1.0, after, before)
        share = np.where(before == after, 0.0, share)
        usual = float(np.median(np.diff(old))) if len(old) > 1 else 1.0
        pause = (old[after] - old[before]) > PAUSE * usual
        return cls(new, before, after, share, pause)

    @property
    def nearest(self) -> np.ndarray:
        """(T,) the nearer old frame."""
        return np.where(self.share > 0.5, self.after, self.before)

    def values(self, old: Any) -> np.ndarray:
        """Numbers between those of the two frames."""
        rows = np.asarray(old, np.float64)
        share = self.share.reshape(-1, *[1] * (rows.ndim - 1))
        between: np.ndarray = rows[self.before] * (1.0 - share) + rows[self.after] * share
        return between

    def flags(self, old: np.ndarray) -> np.ndarray:
        """True where it is in both frames."""
        return np.asarray(old[self.before] & old[self.after])

    def poses(self, old: np.ndarray) -> np.ndarray:
        """Poses between those of the two frames."""
        a, b = old[self.before], old[self.after]
        turn = poses.multiply(poses.conjugate(a[..., 3:]), b[..., 3:])
        part = poses.from_rotation_vectors(self.share[:, None] * poses.rotation_vectors(turn))
        moved = np.concatenate([self.values(old[..., :3]), poses.multiply(a[..., 3:], part)], -1)
        return np.where((self.share == 0.0)[:, None], a, moved)


def _hand(hand: HandRecording, grid: Grid) -> HandRecording:
    assert hand.valid is not None  # filled in by HandRecording
    return replace(
        hand,
        landmarks=grid.values(hand.landmarks),
        stamps=grid.stamps,
        valid=grid.flags(hand.valid),
        metacarpals=None if hand.metacarpals is None else grid.values(hand.metacarpals),
        orientations=None if hand.orientations is None else hand.orientations[grid.nearest],
        T_world_wrist=None if hand.T_world_wrist is None else grid.poses(hand.T_world_wrist),
    )


def _commands(commands: CommandTrajectory, grid: Grid) -> CommandTrajectory:
    return replace(
        commands,
        joint_positions=grid.values(commands.joint_positions),
        stamps=grid.stamps,
        latency_ms=np.asarray(commands.latency_ms)[grid.nearest],
        status=np.asarray(commands.status)[grid.nearest],
    )
