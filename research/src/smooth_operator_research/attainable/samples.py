"""Frames of recordings and of answers to them: their figures, and the picture."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Bool, Float, Int

from smooth_operator.hands.hand import Hand
from smooth_operator.hands.registry import load_hand
from smooth_operator.lab.benchmark.built import built_for
from smooth_operator.lab.benchmark.recordings import Source
from smooth_operator.lab.benchmark.settings import Choice, method_label
from smooth_operator.lab.offline import execute
from smooth_operator.metrics import accuracy, summary
from smooth_operator.metrics.assemble import assemble_trace
from smooth_operator.metrics.safety import COLLISION_DEPTH
from smooth_operator.metrics.trace import keyvectors
from smooth_operator.objective.keyvectors import KeyvectorLayout
from smooth_operator.planning import Plan
from smooth_operator.reporting.drawing import INK, MARKERS, colors_of, name_points, styled
from smooth_operator.types import Side
from smooth_operator_research.attainable.search import TOLERANCE, Attained
from smooth_operator_research.run_report import BenchmarkError

if TYPE_CHECKING:
    from matplotlib.axes import Axes

BINS = ((0.0, 8.0), (8.0, 15.0), (15.0, 25.0), (25.0, 40.0), (40.0, float("inf")))
"""Of the human's thumb vectors [mm]."""


@dataclass(frozen=True, eq=False)
class Sampled:
    """Some frames of a recording, and what methods answer them.

    Attributes:
        name: of the recording.
        hand: the robot hand.
        frames: (T,) which frames.
        human: (T, K, 3) aligned human keyvectors [m].
        answers: label -> (T, K, 3) the robot's keyvectors [m].
        depths: label -> (T,) how much deeper than allowed parts are in each other [m].
        known: (T, S, m) poses of all answers, actuated joints [rad].
    """

    name: str
    hand: Hand
    frames: Int[np.ndarray, " T"]
    human: Float[np.ndarray, "T K 3"]
    answers: dict[str, Float[np.ndarray, "T K 3"]]
    depths: dict[str, Float[np.ndarray, " T"]]
    known: Float[np.ndarray, "T S m"]

    @property
    def side(self) -> Side:
        """Side of the hand."""
        return self.hand.spec.side

    @property
    def thumb(self) -> slice:
        """Keyvectors from the thumb to the other tips."""
        return KeyvectorLayout(self.hand.fingers).thumb

    @property
    def pinching(self) -> Bool[np.ndarray, " T"]:
        """Frames in which the human pinches."""
        lengths = np.linalg.norm(self.human[:, self.thumb], axis=-1)
        return np.asarray((lengths < accuracy.PINCH_DISTANCE).any(axis=1))

    def vectors(self, poses: Float[np.ndarray, "T m"]) -> Float[np.ndarray, "T K 3"]:
        """The robot's keyvectors at poses of the actuated joints [m]."""
        tips = self.hand.tips(self.hand.full_configuration(poses))
        return keyvectors(tips, np.broadcast_to(self.hand.wrist, (len(poses), 3)))

    def thumb_cosines(self, robot: Float[np.ndarray, "T K 3"]) -> Float[np.ndarray, "T P"]:
        """Cosine similarity of the thumb keyvectors."""
        return accuracy.cosines(self.human[:, self.thumb], robot[:, self.thumb])


@dataclass(frozen=True)
class Sums:
    """Means over frames; None where there is nothing.

    Attributes:
        thumb: cosine of the thumb's keyvectors.
        every: of all.
        gap_mm: distance of the robot's tips in the human's pinches [mm].
        scale: length of the thumb's keyvectors over the human's.
    """

    thumb: float | None = None
    every: float | None = None
    gap_mm: float | None = None
    scale: float | None = None


def sums_of(
    one: Sampled, robot: Float[np.ndarray, "T K 3"], chosen: Bool[np.ndarray, " T"]
) -> Sums:
    """Figures of the chosen frames, by the metrics' own definitions."""
    human, robot = one.human[chosen], robot[chosen]
    thumbs = human[:, one.thumb], robot[:, one.thumb]
    return Sums(
        accuracy.cosine_similarity(*thumbs),
        accuracy.cosine_similarity(human, robot),
        summary.scaled(summary.mean(accuracy.pinch_gaps(*thumbs)), 1e3),
        accuracy.scale_ratio(*thumbs),
    )


def spread(
    one: Sampled,
    poses: Float[np.ndarray, "G T m"],
    chosen: Bool[np.ndarray, " T"],
    gap_mm: float | None,
) -> float | None:
    """Thumb cosine where the pinch gap is limited in the mean only: frames share it out.

    Each frame takes one of its answers to the limits, wider where that gains most; a cost on the
    gap, the same for all, finds which (exact but for the last frame to be widened).

    Args:
        one: the frames.
        poses: answers to each limit.
        chosen: which frames; some of them pinch.
        gap_mm: what the mean may be [mm]; None where nothing pinches.

    Returns:
        the mean cosine; None where nothing pinches, or even the narrowest answers are wider.
    """
    if gap_mm is None:
        return None
    robots = np.stack([one.vectors(some)[chosen][:, one.thumb] for some in poses])
    human = one.human[chosen][:, one.thumb]
    value = np.stack([accuracy.cosines(human, robot).mean(axis=1) for robot in robots])
    gaps = 1e3 * np.stack([accuracy.pinch_gaps(human, robot) for robot in robots])
    pinches = int(np.isfinite(gaps[0]).sum())
    total, frames = np.nansum(gaps, axis=2), np.arange(value.shape[1])

    def at(price: float) -> tuple[float, float]:
        choice = np.argmax(value - price * total, axis=0)
        return float(value[choice, frames].mean()), float(total[choice, frames].sum() / pinches)

    low, high = 0.0, 1e4
    if at(low)[1] <= gap_mm:
        return at(low)[0]
    if at(high)[1] > gap_mm:
        return None
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (low, middle) if at(middle)[1] <= gap_mm else (middle, high)
    return at(high)[0]


def sample(
    source: Source,
    hand_name: str,
    choices: Sequence[Choice],
    every: int | None,
    usual: int,
    seed: int,
) -> Sampled:
    """Runs the methods over the whole recording, and takes some of the frames.

    Raises:
        BenchmarkError: no frame has a usable hand.
    """
    assert source.recording is not None  # checked before
    hand = load_hand(hand_name, source.side)
    frames: np.ndarray | None = None
    human, poses = np.empty(0), []
    answers, depths = {}, {}
    for choice in choices:
        todo = Plan(source.recording, hand, choice.method, choice.preset, choice.config, seed)
        outcome = execute(todo, built_for(todo))
        trace = assemble_trace(source.recording, outcome.commands, hand, reach_samples=0)
        if frames is None:
            usable = np.flatnonzero(np.isfinite(trace.human_keyvectors).all(axis=(1, 2)))
            if not len(usable):
                raise BenchmarkError(f"{source.name}: no frame has a usable hand")
            frames = usable[:: every or max(1, round(len(usable) / usual))]
            human = trace.human_keyvectors[frames]
        label = method_label(choice.method, choice.preset)
        answers[label] = trace.robot_keyvectors[frames]
        deep = trace.penetration
        depths[label] = np.zeros(len(frames)) if deep is None else deep[frames] - COLLISION_DEPTH
        poses.append(trace.joint_positions[frames][:, list(hand.actuated)])
    assert frames is not None  # there is a method
    return Sampled(source.name, hand, frames, human, answers, depths, np.stack(poses, axis=1))


def draw(
    samples: Sequence[Sampled], bounds: Sequence[Attained], limits: Sequence[float], path: Path
) -> None:
    """Attainable thumb cosine against pinch gap, on pinching frames: a panel for each recording.

    Args:
        samples: frames and answers; a recording without pinches is left out.
        bounds: what is attainable, for each.
        limits: of the gaps [m].
        path: PNG file.
    """
    from matplotlib.figure import Figure  # not pyplot: no display, no global list of figures

    shown = [(s, f) for s, f in zip(samples, bounds, strict=True) if s.pinching.any()]
    if not shown:
        return
    columns = min(3, len(shown))
    rows = -(-len(shown) // columns)
    colors = colors_of(dict.fromkeys(name for one, _ in shown for name in one.answers))
    with styled():
        figure = Figure(figsize=(4.2 * columns, 3.3 * rows + 0.5), layout="constrained")
        axes = figure.subplots(rows, columns, sharey=True, squeeze=False)
        for ax in axes.ravel()[len(shown) :]:
            ax.set_axis_off()
        named = [
            _panel(ax, one, attained, limits, colors)
            for ax, (one, attained) in zip(axes.ravel(), shown, strict=False)
        ]
        for ax in axes[:, 0]:
            ax.set_ylabel("thumb cosine, pinching frames")
        for ax in axes.ravel()[max(0, len(shown) - columns) : len(shown)]:
            ax.set_xlabel("mean pinch gap of the robot [mm]")
        figure.suptitle(
            "Line: attainable by any method, each frame alone, parts at most 2 mm in each other, "
            "by the limit of every gap (hollow: not all can keep it).\nDashed: only the mean gap "
            "is limited. Dotted: the human's gap. In brackets: a method's frames deeper than 2 mm",
            fontsize=9,
            color=INK,
        )
        figure.draw_without_rendering()  # names need the final places
        for ax, (points, others) in zip(axes.ravel(), named, strict=False):
            name_points(ax, points, others, 7.5)
        path.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(path, dpi=150)


def _panel(
    ax: Axes, one: Sampled, attained: Attained, limits: Sequence[float], colors: dict[str, str]
) -> tuple[dict[str, tuple[float, float]], list[tuple[float, float]]]:
    """Draws a recording; answers points with their names, and those that have none."""
    chosen, human = one.pinching, sums_of(one, one.human, one.pinching).gap_mm

    def at(robot: Float[np.ndarray, "T K 3"]) -> tuple[float, float]:
        got = sums_of(one, robot, chosen)
        return got.gap_mm or np.nan, got.thumb or np.nan

    line = [at(one.vectors(poses)) for poses in attained.poses]
    ax.plot(*zip(*line, strict=True), color=INK, linewidth=1.4)
    means = np.linspace(line[0][0], line[-1][0], 40)
    free = [spread(one, attained.poses, chosen, float(gap) + 1e-6) or np.nan for gap in means]
    ax.plot(means, free, color=INK, linewidth=1.0, linestyle="--")
    named = {}
    for gap, point, excess in zip(limits, line, attained.excess, strict=True):
        solved = bool((excess[chosen] <= TOLERANCE).all())
        ax.plot(*point, "o", color=INK, markersize=5, markerfacecolor=INK if solved else "white")
        named[f"+{1e3 * gap:g} mm" if np.isfinite(gap) else "no limit"] = point
    for k, (name, robot) in enumerate(one.answers.items()):
        deep = float((one.depths[name][chosen] > TOLERANCE).mean())
        point = at(robot)
        marker = MARKERS[(k + 1) % len(MARKERS)]
        ax.plot(*point, marker, color=colors[name], markersize=6)
        named[f"{name} ({deep:.0%})" if deep >= 0.005 else name] = point
    if human is not None:
        ax.axvline(human, color=INK, linewidth=0.8, linestyle=":")
    ax.margins(0.12)
    ax.set_title(f"{one.name} ({chosen.sum()} frames)")
    return named, line
