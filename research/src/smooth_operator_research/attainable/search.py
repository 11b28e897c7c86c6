"""For each frame the best pose that keeps to its limits.

A frame is a separate problem: of all poses within the joint limits, without two parts that are
deeper in each other than allowed and whose pinch gaps are not wider than allowed, the one whose
keyvectors point most like the human's. It has many local optima, so the search goes in three steps:
many starts descend with a rising cost on what breaks a limit; the best of them are finished by
SLSQP, which keeps the limits; and frames try what their neighbours and the other gap limits have
found, until nobody gains any more. What is kept has been checked with the exact shapes
(``penetration_depths``).

Not every gap can be reached: fingertips have a thickness. Where no pose was found that keeps the
limit, the answer is the best one at the narrowest gap that was found, and it is said by how much
that is too wide. Depth is never traded.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from jaxtyping import Bool, Float

from smooth_operator.compilation.cache import jax_cache
from smooth_operator.compilation.start import dispatch_here
from smooth_operator.hands.registry import load_hand
from smooth_operator.metrics.accuracy import PINCH_DISTANCE
from smooth_operator.types import Side
from smooth_operator_research.attainable.pose_search import ELASTIC, Aim, Search

TOLERANCE = 5e-5
"""By how much a pose may break a limit and still count as keeping it [m]."""
RISE = 1e-4
"""A round over all frames that gains less than this in the mean is the last. No cosine is above 1,
so a frame that is no further from it is not searched any more."""
TRIES = 3


@dataclass(frozen=True, eq=False)
class Frames:
    """Some frames of a recording, to be searched.

    Attributes:
        hand: catalogue name.
        side: which hand.
        human: (T, K, 3) aligned human keyvectors [m], all finite.
        known: (T, S, m) poses to begin with among others, as answers of methods; actuated joints
            [rad].
        gaps: limits of the robot's pinch gaps beyond the human's [m], rising; infinite for none.
        aims: what is sought, one after the other.
        starts: for each frame, random ones and those of ``known`` together.
        finish: how many of them are finished by SLSQP.
        rounds: at most, of trying what other frames have found.
        seed: of the random starts.
    """

    hand: str
    side: Side
    human: Float[np.ndarray, "T K 3"]
    known: Float[np.ndarray, "T S m"]
    gaps: tuple[float, ...]
    aims: tuple[Aim, ...] = ("thumb",)
    starts: int = 24
    finish: int = 4
    rounds: int = 5
    seed: int = 0


@dataclass(frozen=True, eq=False)
class Attained:
    """The best poses found for one aim.

    Attributes:
        poses: (G, T, m) for each gap limit and frame, actuated joints [rad].
        value: (G, T) what was sought, of these poses; NaN where none is shallow enough.
        excess: (G, T) by how much a gap is wider than allowed [m]: the frame counts as solved up
            to ``TOLERANCE``.
        gains: what each round over the frames gained in the mean.
    """

    poses: Float[np.ndarray, "G T m"]
    value: Float[np.ndarray, "G T"]
    excess: Float[np.ndarray, "G T"]
    gains: tuple[float, ...]


@cache
def search_for(hand: str, side: Side) -> Search:
    """Compiled once in a process."""
    dispatch_here()
    return Search(load_hand(hand, side))


def attain(task: Frames) -> dict[Aim, Attained]:
    """The best poses of some frames, for each aim."""
    attained: dict[Aim, Attained] = {}
    poses = task.known
    for aim in task.aims:
        with jax_cache():
            attained[aim] = _Run(task, aim, poses).result()
        poses = np.concatenate([poses, np.moveaxis(attained[aim].poses[-1:], 0, 1)], axis=1)
    return attained


class _Run:
    """The search of some frames for one aim.

    A frame without a pinch has one problem, whatever the gap: that of the last, loosest limit.
    """

    def __init__(self, task: Frames, aim: Aim, poses: Float[np.ndarray, "T S m"]) -> None:
        self.task, self.aim = task, aim
        self.search = search = search_for(task.hand, task.side)
        neutral = np.broadcast_to(search.hand.neutral, (len(poses), 1, search.low.size))
        self.known = np.concatenate([poses, neutral], axis=1)  # at least that one is shallow
        lengths = np.linalg.norm(task.human[:, search.thumb], axis=-1)
        self.pinching: Bool[np.ndarray, " T"] = (lengths < PINCH_DISTANCE).any(axis=1)
        shape = (len(task.gaps), len(task.human))
        self.value = np.full(shape, -np.inf)
        self.excess = np.full(shape, np.inf)
        self.poses = np.zeros((*shape, search.low.size))
        self.tried: set[tuple[int, int, bytes]] = set()

    def result(self) -> Attained:
        rng = np.random.default_rng(self.task.seed)
        for g, gap in enumerate(self.task.gaps):
            self.improve(g, [(t, pose) for t in self.frames(g) for pose in self.known[t]])
            frames = self.frames(g)  # fewer: some are solved from there
            ends = self.search.explore(
                self.aim, self.task.human[frames], gap, self.known[frames], self.task.starts,
                self.task.finish, rng,
            )  # fmt: skip
            self.improve(g, [(t, q) for t, some in zip(frames, ends, strict=True) for q in some])
        gains = []
        for _ in range(self.task.rounds):
            gains.append(self.exchange())
            if gains[-1] < RISE:
                break
        for g in range(len(self.task.gaps) - 1):
            for array in (self.value, self.excess, self.poses):
                array[g, ~self.pinching] = array[-1, ~self.pinching]
        value = np.where(np.isfinite(self.excess), self.value, np.nan)
        return Attained(self.poses, value, self.excess, tuple(gains))

    def frames(self, g: int) -> np.ndarray:
        """Those that the g-th limit is a separate problem for, and not solved to perfection."""
        last = g == len(self.task.gaps) - 1
        return np.flatnonzero((self.pinching | last) & ~(self.merit[g] > 1 - RISE))

    @property
    def merit(self) -> Float[np.ndarray, "G T"]:
        """What is brought up: a gap too wide costs more than it could gain."""
        over = np.maximum(self.excess - TOLERANCE, 0.0)
        return self.value - 1e3 * ELASTIC * over

    def exchange(self) -> float:
        """Every problem tries the answers of its neighbours; the mean gain."""
        before = self.merit
        for g in range(len(self.task.gaps)):
            starts = []
            for t in self.frames(g):
                for at in ((g, t - 1), (g, t + 1), (g - 1, t), (g + 1, t)):
                    if not (0 <= at[0] < len(self.task.gaps) and 0 <= at[1] < len(self.pinching)):
                        continue
                    pose = self.poses[at if np.isfinite(self.excess[at]) else (-1, at[1])]
                    key = (g, int(t), pose.tobytes())
                    if key not in self.tried:
                        self.tried.add(key)
                        starts.append((t, pose))
            self.improve(g, starts)
        finite = np.isfinite(before)
        return float((self.merit[finite] - before[finite]).mean()) if finite.any() else 0.0

    def improve(self, g: int, starts: Sequence[tuple[int, np.ndarray]]) -> None:
        """Finishes starts, each for a frame, and keeps what is better than the best so far.

        The capsules fill some shapes from within only, so a pose that they let pass may be too deep
        by the exact shapes; it is then finished again with less depth allowed.
        """
        search, human = self.search, self.task.human
        caps = search.caps(human, self.task.gaps[g])
        todo = [(int(t), np.asarray(pose, float), search.depth) for t, pose in starts]
        as_they_are = [pose for _, pose, _ in todo]
        for turn in range(TRIES + 1):
            if not todo:
                return
            ends = np.array(as_they_are)  # the answer to a tighter limit may be good already
            if turn:
                ends = np.array(
                    [search.finish(self.aim, human[t], caps[t], q, d) for t, q, d in todo]
                )
            rows = np.array([t for t, _, _ in todo])
            values, deep, wide = search.check(self.aim, ends, human[rows], caps[rows])
            again = []
            for (t, _, allowed), pose, value, depth, gap in zip(
                todo, ends, values, deep, wide, strict=True
            ):
                merit = float(value - 1e3 * ELASTIC * max(gap - TOLERANCE, 0.0))
                if depth > TOLERANCE:
                    if turn and merit > self.merit[g, t]:
                        again.append((t, pose, allowed - float(depth)))
                elif not np.isfinite(self.excess[g, t]) or merit > self.merit[g, t]:
                    self.value[g, t], self.poses[g, t] = value, pose
                    self.excess[g, t] = max(float(gap), 0.0)
            todo = todo if turn == 0 else again
