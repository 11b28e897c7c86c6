"""One recording on one hand, all methods: the data of plots and clips."""

from __future__ import annotations

import base64
import itertools
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from jaxtyping import Float

from smooth_operator.hands.hand import Hand
from smooth_operator.hands.registry import load_hand
from smooth_operator.human.aligned_recording import align_recording
from smooth_operator.lab.benchmark.cells import Cell
from smooth_operator.lab.benchmark.quality import Measured
from smooth_operator.lab.benchmark.settings import method_label
from smooth_operator.lab.benchmark.suite import Finished
from smooth_operator.landmarks import BASES, BONES, FINGERS, LANDMARKS, NUM_LANDMARKS, TIPS, WRIST
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


SECONDS: Final = 8.0
RATE_HZ: Final = 30.0
BUDGET: Final = 12_000_000
"""All clips of a page together [bytes]; where there are many, each gets fewer frames."""
MIN_FRAMES: Final = 40

_UNIT: Final = 1e-4
"""Of the packed numbers [m]."""
_ABSENT: Final = -32768
_POINTS: Final = 21 * 3 * 2 * 4 / 3  # bytes of one hand in one frame, in base64


def make_clip(panel: Panel, colors: Mapping[str, str], hands: int) -> dict[str, Any]:
    """Clip of one panel for the player, ready for JSON.

    Args:
        colors: method -> colour.
        hands: number of hands in all clips of the page, which share the budget.

    Returns:
        ``times`` of the frames [s]; ``humans`` and ``robots``, each (frames, 21, 3) int16 in base64
        little-endian, in units of 0.1 mm about the middle of the clip, turned so that x is right, y
        up and z towards the viewer; -32768 stands for what is not there; each method's ``objects``,
        (frames, points, 3), where there are some; and how to draw them.
    """
    cut = panel.window(SECONDS)
    stamps = panel.stamps[cut]
    allowed = max(MIN_FRAMES, int(BUDGET / (max(hands, 1) * _POINTS)))
    duration = float(stamps[-1] - stamps[0])
    count = min(len(stamps), allowed, max(2, int(duration * RATE_HZ) + 1))
    times = np.linspace(stamps[0], stamps[-1], count)
    chosen = np.unique(np.searchsorted(stamps, times).clip(0, len(stamps) - 1)) + cut.start

    basis = view_basis(panel.hand)
    humans: list[np.ndarray] = []
    panes: list[dict[str, Any]] = []
    drawn = [run.robot[chosen] @ basis.T for run in panel.runs]
    points = np.concatenate([panel.runs[0].human[chosen] @ basis.T, *drawn]).reshape(-1, 3)
    points = points[np.isfinite(points).all(axis=-1)]
    middle = (points.min(axis=0) + points.max(axis=0)) / 2 if len(points) else np.zeros(3)
    reach = float(np.linalg.norm(points - middle, axis=-1).max()) if len(points) else 0.1
    for run, robot in zip(panel.runs, drawn, strict=True):
        human = run.human[chosen] @ basis.T
        # Methods that align alike share one human.
        same = (i for i, h in enumerate(humans) if np.array_equal(h, human, equal_nan=True))
        at = next(same, None)
        if at is None:
            at = len(humans)
            humans.append(human)
        panes.append(
            {
                "method": run.method,
                "color": colors[run.method],
                "human": at,
                "robot": _packed(robot - middle),
                "objects": None
                if run.objects is None
                else _packed(run.objects[chosen] @ basis.T - middle),
            }
        )
    objects = [run.objects.shape[1] for run in panel.runs if run.objects is not None]
    return {
        "times": [round(float(t), 3) for t in panel.stamps[chosen]],
        "reach": round(reach / _UNIT),
        "humans": [_packed(human - middle) for human in humans],
        "humanBones": [list(bone) for bone in BONES],
        "robotBones": [list(bone) for bone in robot_bones(panel.hand)],
        "objectPoints": max(objects, default=0),
        "objectEdges": [list(edge) for edge in panel.edges],
        "panes": panes,
    }


def _packed(points: Float[np.ndarray, "F k 3"]) -> str:
    finite = np.isfinite(points)
    units = np.rint(np.where(finite, points, 0.0) / _UNIT).clip(-32767, 32767)
    return base64.b64encode(np.where(finite, units, _ABSENT).astype("<i2").tobytes()).decode()
