"""Selection of episodes: they are cut where a hand is lost, and dropped by quality."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, fields, replace
from typing import Final, Literal, TypeAlias

import numpy as np
from jaxtyping import Bool

from smooth_operator.errors import ConfigError
from smooth_operator.lab.datasets.clip import RobotClip, robot_part
from smooth_operator.lab.datasets.quality import quality_figures, worst

Needed: TypeAlias = Literal["any", "all"]
"""Of how many hands of a clip a frame needs: one of them, or each."""


@dataclass(frozen=True)
class Limits:
    """Limits of an episode's quality. Figures that are not known break no limit.

    Attributes:
        cut: cut clips into their good parts; otherwise a clip is kept or dropped whole.
        hands: a frame is good if any hand is seen in it, or if all of the clip's are.
        max_gap: longest time without a good frame in an episode [s]; a clip is cut there.
        max_jump: largest speed of the wrist or of a fingertip to it [m/s]: beyond it the tracker
            has jumped, and a clip is cut there.
        min_confidence: least confidence of the tracker: frames below it count as not seen.
        min_seconds: shortest episode [s].
        min_valid: least share of frames of an episode with a good hand.
        max_collision: largest share of frames with two links more than 2 mm inside.
        max_tip_error: largest mean distance of robot and human fingertips [mm].
        min_reach: least share of frames in which every fingertip reaches the human's; see
            ``quality.REACHED``.

    Raises:
        ConfigError: a limit is not a possible one.
    """

    cut: bool = True
    hands: Needed = "any"
    max_gap: float = 0.5
    max_jump: float = 5.0
    min_confidence: float = 0.3
    min_seconds: float = 1.0
    min_valid: float = 0.6
    max_collision: float = 0.2
    max_tip_error: float = 60.0
    min_reach: float = 0.5

    def __post_init__(self) -> None:
        for each in fields(self):
            value = getattr(self, each.name)
            if each.name in ("cut", "hands"):
                continue
            share = each.name in ("min_confidence", "min_valid", "max_collision", "min_reach")
            if not 0.0 <= value <= (1.0 if share else math.inf):
                expected = "between 0 and 1" if share else "0 or more"
                raise ConfigError(f"{each.name} must be {expected}, not {value:g}")


NO_LIMITS: Final = Limits(
    cut=False,
    max_gap=math.inf,
    max_jump=math.inf,
    min_confidence=0.0,
    min_seconds=0.0,
    min_valid=0.0,
    max_collision=1.0,
    max_tip_error=math.inf,
    min_reach=0.0,
)
"""Keeps every clip whole."""


@dataclass(frozen=True)
class Dropped:
    """Frames that are not kept.

    Attributes:
        name: name of the episode they would be.
        frames: first frame in the clip, and the one after the last.
        reasons: name of a limit -> what was found, in words.
        figures: quality of the episode; empty if there is none to measure.
    """

    name: str
    frames: tuple[int, int]
    reasons: dict[str, str]
    figures: dict[str, float]


def select(whole: RobotClip, limits: Limits) -> Iterator[RobotClip | Dropped]:
    """The episodes of a clip, in the order of time: kept, with their figures, or dropped."""
    if not whole.commands:  # packed alone
        yield whole
        return
    whole = _confident(whole, limits.min_confidence)
    if not limits.cut:
        yield _judged(whole, whole, slice(0, len(whole.clip)), limits)
        return
    good = _good(whole, limits)
    parts = list(_parts(good, _jumps(whole, limits), whole.clip.stamps, limits.max_gap))
    at = 0
    for part in parts:
        if at < part.start:
            yield _lost(whole, at, part.start)
        yield _judged(whole, robot_part(whole, part), part, limits)
        at = part.stop
    if at < len(good):
        yield _lost(whole, at, len(good))


def _confident(whole: RobotClip, least: float) -> RobotClip:
    """A clip in which frames count as not seen that the tracker is not sure of."""
    valid = dict(whole.valid)
    for side, confidence in whole.clip.confidence.items():
        if side in valid:
            valid[side] = valid[side] & ~(confidence < least)  # NaN: not known
    return replace(whole, valid=valid)


def _good(whole: RobotClip, limits: Limits) -> Bool[np.ndarray, " T"]:
    each = np.array(list(whole.valid.values()))
    return np.asarray(each.any(axis=0) if limits.hands == "any" else each.all(axis=0))


def _jumps(whole: RobotClip, limits: Limits) -> Bool[np.ndarray, " T"]:
    """Frames that a hand has jumped to."""
    jumped = np.zeros(len(whole.clip), bool)
    for name, values in whole.tracks.items():
        if name.endswith(".speed"):
            jumped |= values > limits.max_jump  # NaN compares as False
    return jumped


def _parts(
    good: Bool[np.ndarray, " T"], jumped: Bool[np.ndarray, " T"], stamps: np.ndarray, gap: float
) -> Iterator[slice]:
    """Good parts: they begin and end with a good frame, and have no jump and no long gap inside."""
    frames = np.flatnonzero(good)
    if not len(frames):
        return
    jumps = np.cumsum(jumped)
    apart = np.diff(stamps[frames]) > gap
    if len(stamps) > 1:  # neighbours are no gap, however slow the clip
        apart &= np.diff(frames) > 1
    cuts = np.flatnonzero(apart | (np.diff(jumps[frames]) > 0)) + 1
    for group in np.split(frames, cuts):
        yield slice(int(group[0]), int(group[-1]) + 1)


def _lost(whole: RobotClip, start: int, stop: int) -> Dropped:
    name = f"{whole.clip.name}_{start:06d}-{stop:06d}"
    return Dropped(name, (start, stop), {"hands": "no hand is seen"}, {})


def _judged(
    whole: RobotClip, episode: RobotClip, frames: slice, limits: Limits
) -> RobotClip | Dropped:
    figures = quality_figures(episode)
    reasons = dict(_reasons(figures, limits))
    if reasons:
        return Dropped(episode.clip.name, (frames.start, frames.stop), reasons, figures)
    return replace(episode, figures=figures)


def _reasons(figures: dict[str, float], limits: Limits) -> Iterator[tuple[str, str]]:
    """The limits that an episode breaks, with what was found."""
    seconds = figures["seconds"]
    if seconds < limits.min_seconds:
        yield "min_seconds", f"{seconds:.2f} s long"
    shares = [value for name, value in figures.items() if name.endswith(".valid")]
    share = (max if limits.hands == "any" else min)(shares)
    if share < limits.min_valid:
        yield "min_valid", f"a hand is seen in {share:.0%} of the frames"
    if not limits.cut:
        yield from _of_whole(figures, limits)
    checks: tuple[tuple[str, str, float, str], ...] = (
        ("max_collision", "collision", limits.max_collision, "links collide in {:.0%} of frames"),
        ("max_tip_error", "tip_error_mm", limits.max_tip_error, "fingertips are {:.0f} mm off"),
        ("min_reach", "reach", limits.min_reach, "fingertips reach the human's in {:.0%}"),
    )
    for name, figure, limit, text in checks:
        value = worst(figures, figure)
        if value is not None and (value < limit if name.startswith("min") else value > limit):
            yield name, text.format(value)


def _of_whole(figures: dict[str, float], limits: Limits) -> Iterator[tuple[str, str]]:
    """Limits that cut a clip, for one that is to stay whole."""
    confidence, jump = worst(figures, "confidence"), worst(figures, "jump_m_s")
    gaps = [value for name, value in figures.items() if name.endswith(".gap_s")]
    gap = (min if limits.hands == "any" else max)(gaps)
    if confidence is not None and confidence < limits.min_confidence:
        yield "min_confidence", f"confidence {confidence:.2f}"
    if jump is not None and jump > limits.max_jump:
        yield "max_jump", f"a hand jumps with {jump:.1f} m/s"
    if gap > limits.max_gap:
        yield "max_gap", f"no hand for {gap:.1f} s"
