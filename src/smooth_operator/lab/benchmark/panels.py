"""One recording on one hand, all methods: the data of plots and clips."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from smooth_operator.hands.hand import Hand
from smooth_operator.hands.registry import load_hand
from smooth_operator.human.alignment import align_recording
from smooth_operator.lab.benchmark.cells import Cell
from smooth_operator.lab.benchmark.quality import Measured
from smooth_operator.lab.benchmark.settings import method_label
from smooth_operator.lab.benchmark.suite import Finished
from smooth_operator.landmarks import BASES, FINGERS, LANDMARKS, NUM_LANDMARKS, TIPS, WRIST
from smooth_operator.planning import Plan
from smooth_operator.types import CommandTrajectory


@dataclass(frozen=True, eq=False)
class Run:
    """A method in a panel; positions in the palm frame [m].

    Attributes:
        method: name of the method.
        human: (T, 21, 3) the human as the method saw it; NaN where a frame was not usable.
        robot: (T, 21, 3) the robot's landmarks; NaN where it has none.
        joints: (T, n) joint positions [rad].
        objects: (T, p, 3) points of objects; None for none.
    """

    method: str
    human: Float[np.ndarray, "T 21 3"]
    robot: Float[np.ndarray, "T 21 3"]
    joints: Float[np.ndarray, "T n"]
    objects: Float[np.ndarray, "T p 3"] | None = None


@dataclass(frozen=True, eq=False)
class Panel:
    """One recording on one hand.

    Attributes:
        key: recording, hand, side.
        hand: the robot hand.
        stamps: (T,) time since the first frame [s].
        runs: the methods that served it, one at least.
        edges: pairs of the runs' object points that a line joins.
    """

    key: tuple[str, str, str]
    hand: Hand
    stamps: Float[np.ndarray, " T"]
    runs: tuple[Run, ...]
    edges: tuple[tuple[int, int], ...] = ()

    @property
    def title(self) -> str:
        """For a person."""
        recording, hand, side = self.key
        return f"{recording} on {hand} {side}"

    @property
    def tips(self) -> list[int]:
        """Landmarks of the fingertips that the robot has, thumb first."""
        return [TIPS[FINGERS.index(finger)] for finger in self.hand.fingers]

    def window(self, seconds: float) -> slice:
        """The stretch of that many seconds in which the human's fingertips travel furthest."""
        tips = self.runs[0].human[:, self.tips] - self.runs[0].human[:, None, WRIST]
        steps = np.linalg.norm(np.diff(tips, axis=0), axis=-1)
        travelled = np.concatenate([[0.0], np.cumsum(np.nan_to_num(steps).sum(axis=-1))])
        ends = np.searchsorted(self.stamps, self.stamps + seconds, side="right") - 1
        start = int(np.argmax(travelled[ends] - travelled))
        return slice(start, int(ends[start]) + 1)


def make_panels(finished: Iterable[Finished]) -> Iterator[Panel]:
    """The panels of a benchmark, in the order of its cells; of what failed there is none."""
    groups: dict[tuple[str, str, str], list[tuple[Cell, Measured]]] = {}
    for one in finished:
        if one.measured is not None:
            groups.setdefault(one.cell.key[:3], []).append((one.cell, one.measured))
    for key, group in groups.items():
        cell = group[0][0]
        assert cell.source.recording is not None  # or there would be no commands
        hand = load_hand(cell.hand, cell.side, fingers=cell.fingers)
        stamps = cell.source.recording.stamps
        runs = tuple(_run(cell, measured, hand) for cell, measured in group)
        yield Panel(key, hand, stamps - stamps[0], runs)


def _run(cell: Cell, measured: Measured, hand: Hand) -> Run:
    assert cell.source.recording is not None
    todo = Plan(cell.source.recording, hand, cell.method, cell.preset, cell.config, 0)
    return run_of(todo, measured.commands)


def run_of(todo: Plan, commands: CommandTrajectory) -> Run:
    """The run of a plan with its commands."""
    human = align_recording(todo.recording, todo.hand, todo.config.alignment)
    joints = np.asarray(commands.joint_positions, np.float64)
    label = method_label(todo.method, todo.preset)
    return Run(label, human, robot_landmarks(todo.hand, joints), joints)


def robot_landmarks(hand: Hand, joints: Float[np.ndarray, "T n"]) -> Float[np.ndarray, "T 21 3"]:
    """Landmarks of a robot in the palm frame [m]; NaN where it has none."""
    robot = np.full((len(joints), NUM_LANDMARKS, 3), np.nan)
    robot[:, [LANDMARKS.index(name) for name in hand.tree.names]] = hand.tree.positions(joints)
    return robot


def robot_bones(hand: Hand) -> list[tuple[int, int]]:
    """(parent, child) landmarks of the robot's skeleton, by what landmarks it has."""
    has = {LANDMARKS.index(name) for name in hand.tree.names}
    bones: list[tuple[int, int]] = []
    for base in BASES:
        chain = [WRIST, *(i for i in range(base, base + 4) if i in has)]
        bones += itertools.pairwise(chain)
    return bones


def view_basis(hand: Hand) -> Float[np.ndarray, "3 3"]:
    """Rows are right, up and towards the viewer, in the palm frame: fingers up, palm in sight.

    The thumb is on the right for a right hand, as one sees one's own palm, and on the left for a
    left one.
    """
    at = dict(zip(hand.tree.names, hand.landmark_positions(hand.neutral), strict=True))
    bases = [at[LANDMARKS[BASES[FINGERS.index(finger)]]] for finger in hand.fingers]
    long = bases[1:]
    up = np.mean(long, axis=0) - hand.wrist
    across = bases[0] - bases[-1]
    if hand.spec.side == "left":
        across = -across
    up = up / max(float(np.linalg.norm(up)), 1e-9)
    right = across - up * (across @ up)
    length = float(np.linalg.norm(right))
    if length < 1e-6:  # finger bases in line with the wrist: any direction across will do
        right = np.cross(up, np.eye(3)[np.argmin(np.abs(up))])
        length = float(np.linalg.norm(right))
    right /= length
    return np.stack([right, up, np.cross(right, up)])
