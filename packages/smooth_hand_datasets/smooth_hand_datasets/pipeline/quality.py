"""Quality metrics of episodes, and the selection of episodes by limits."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final, TypeAlias

import numpy as np
from jaxtyping import Bool, Float

from smooth_hand_datasets.pipeline.clip import RobotClip, robot_part
from smooth_hand_datasets.pipeline.request import Limits
from smooth_operator import poses
from smooth_operator.formats.checks import finger_motion
from smooth_operator.hands.hand import Hand
from smooth_operator.hands.penetration import penetration_depths
from smooth_operator.landmarks import BASES, FINGERS, LANDMARKS, TIPS, WRIST
from smooth_operator.metrics import summary
from smooth_operator.metrics.consistency import second_derivative
from smooth_operator.metrics.joints import max_joint_step
from smooth_operator.metrics.safety import COLLISION_DEPTH
from smooth_operator.metrics.table import Metric
from smooth_operator.retargeting.aligned_recording import align_recording
from smooth_operator.retargeting.alignment import AlignmentConfig
from smooth_operator.types import CommandTrajectory, HandRecording, Side, Status

REACHED: Final = 0.25
"""Largest distance at which a robot fingertip counts as reaching the human's, as a share of the
robot hand's length.

The distance is measured to the human fingertip or, if it is closer, to the tip of a finger with
the human's posture and the robot's lengths. An open robot hand with fingers twice as long is
therefore correct too."""

COLLISION_RATE_HZ: Final = 5.0
"""Rate at which self-collision is measured [Hz]; one measurement takes a tenth of the time of a
command."""


FIGURES: Final = (
    Metric("confidence", "", "up", "mean confidence reported by the tracker"),
    Metric("valid", "", "up", "share of frames with a valid command from a visible hand"),
    Metric("gap_s", "s", "down", "longest time without a valid command"),
    Metric("wrist", "", "up", "share of frames with a known wrist pose"),
    Metric(
        "jump_m_s",
        "m/s",
        "down",
        "largest speed of the human wrist, or of a fingertip relative to the wrist",
    ),
    Metric("finger_motion_mm", "mm", "up", "range of the human fingertips' motion in the clip"),
    Metric(
        "tip_error_mm", "mm", "down", "mean distance between robot and aligned human fingertips"
    ),
    Metric(
        "tip_error_p95_mm", "mm", "down", "95th percentile of that distance for the worst finger"
    ),
    Metric("reach", "", "up", "share of frames in which every robot fingertip is near its target"),
    Metric("collision", "", "down", "share of frames in which links overlap by over 2 mm"),
    Metric("collision_depth_mm", "mm", "down", "deepest overlap of two links"),
    Metric("joint_step_rad", "rad", "down", "largest change of a joint between two frames"),
    Metric("jerk_rad_s3", "rad/s³", "down", "mean jerk of the joints"),
    Metric("tracking_loss", "", "down", "mean of the method's own objective"),
    Metric("contact_precision", "", "up", "share of the robot's contacts that the human also has"),
    Metric("contact_recall", "", "up", "share of the human's contacts that the robot also has"),
    Metric(
        "contact_error_mm",
        "mm",
        "down",
        "distance from robot fingertip to object where the human has contact",
    ),
    Metric("object_depth_mm", "mm", "down", "depth of the robot hand's deepest point in an object"),
)
"""All quality metrics. An episode has ``SIDE.NAME``, such as ``right.reach``, for each hand, and
``frames``, ``seconds`` and ``rate_hz``. The last four exist only for clips that were retargeted
with their objects."""


@dataclass(frozen=True)
class Rule:
    """Which values of a quality metric violate a limit.

    Attributes:
        limit: name of the limit in ``Limits``; it begins with ``min`` or ``max``.
        figure: ``seconds``, or the metric of each hand whose worse value is judged.
        text: description of a value that violates the limit.
        either: True if one good hand is enough when ``Limits.hands`` is ``any``.
        cuts: True if the limit cuts clips, so that it judges only clips that stay whole.
    """

    limit: str
    figure: str
    text: str
    either: bool = False
    cuts: bool = False

    def violation(self, figures: Mapping[str, float], limits: Limits) -> str | None:
        """Describes the value that violates the limit; None if it is within, or unknown."""
        values = [value for key, value in figures.items() if key.rpartition(".")[2] == self.figure]
        if not values:
            return None
        lower, better = self.limit.startswith("min"), self.either and limits.hands == "any"
        value = min(values) if lower != better else max(values)
        bound = getattr(limits, self.limit)
        violated = value < bound if lower else value > bound
        return self.text.format(value) if violated else None


RULES: Final = (
    Rule("min_seconds", "seconds", "{:.2f} s long"),
    Rule("min_valid", "valid", "a hand is seen in {:.0%} of the frames", either=True),
    Rule(
        "min_finger_motion",
        "finger_motion_mm",
        "the fingers never move: {:.1f} mm in the clip",
        either=True,
    ),
    Rule("min_confidence", "confidence", "confidence {:.2f}", cuts=True),
    Rule("max_jump", "jump_m_s", "a hand jumps at {:.1f} m/s", cuts=True),
    Rule("max_gap", "gap_s", "no hand is seen for {:.1f} s", either=True, cuts=True),
    Rule("max_collision", "collision", "links collide in {:.0%} of the frames"),
    Rule("max_tip_error", "tip_error_mm", "robot fingertips are {:.0f} mm off"),
    Rule("min_reach", "reach", "robot fingertips reach their targets in {:.0%} of the frames"),
)


Tracks: TypeAlias = dict[str, Float[np.ndarray, " T"]]


def quality_tracks(
    recordings: Sequence[HandRecording],
    commands: Sequence[CommandTrajectory],
    losses: Sequence[Float[np.ndarray, " T"]],
    hand: Hand,
    alignment: AlignmentConfig,
) -> list[Tracks]:
    """Computes quality metrics for each frame of the recordings of one hand; NaN where unknown.

    The recordings are measured together, which is faster.

    Args:
        alignment: the method's alignment, so that the human hand is measured as the method saw it.

    Returns:
        for each recording: ``speed`` [m/s] since the previous frame, that of the wrist or of a
        fingertip relative to it, whichever is faster; ``tip_error`` [m], mean over fingertips;
        ``tip_error_max`` [m];
        ``reached``, 1 where every fingertip reaches the human's (``REACHED``), or else 0;
        ``penetration`` [m], at ``COLLISION_RATE_HZ``; ``loss``.
    """
    joined = _joined(recordings)
    human = align_recording(joined, hand, alignment)
    tips = human[:, [TIPS[FINGERS.index(name)] for name in hand.fingers]]
    names = hand.tree.names
    columns = [names.index(name) for name in hand.tip_names]
    positions = np.concatenate([each.joint_positions for each in commands])
    robot = np.asarray(hand.tree.positions(positions))
    error = np.linalg.norm(robot[:, columns] - tips, axis=-1)
    error[np.concatenate([each.status for each in commands]) != Status.OK] = np.nan
    worst_tip = error.max(axis=-1)
    from_place = np.linalg.norm(robot[:, columns] - _places(hand, human, robot), axis=-1)
    nearest = np.fmin(error, from_place).max(axis=-1)
    reached = np.where(np.isnan(worst_tip), np.nan, nearest <= REACHED * hand_length(hand))
    looks = [_looks(recording) for recording in recordings]
    depths = penetration_depths(
        hand, np.concatenate([c.joint_positions[at] for c, at in zip(commands, looks, strict=True)])
    )
    tracks: list[Tracks] = []
    start = looked = 0
    for recording, look, loss in zip(recordings, looks, losses, strict=True):
        own = slice(start, start + len(recording))
        start = own.stop
        penetration = np.full(len(recording), np.nan)
        if depths is not None:
            penetration[look] = depths[looked : looked + len(penetration[look])]
        looked += len(penetration[look])
        tracks.append(
            {
                "speed": _speed(recording, tips[own] - human[own, WRIST, None]),
                "tip_error": error[own].mean(axis=-1),
                "tip_error_max": worst_tip[own],
                "reached": reached[own],
                "penetration": penetration,
                "loss": np.asarray(loss, np.float64),
            }
        )
    return tracks


def _places(
    hand: Hand, human: Float[np.ndarray, "T 21 3"], robot: Float[np.ndarray, "T k 3"]
) -> Float[np.ndarray, "T f 3"]:
    """Fingertips of a hand with the human's posture and the robot's finger lengths [m]."""
    names, numbers = hand.tree.names, [FINGERS.index(name) for name in hand.fingers]
    bases = robot[:, [names.index(LANDMARKS[BASES[finger]]) for finger in numbers]]
    points = human[:, [[BASES[finger] + i for i in range(4)] for finger in numbers]]
    bones = np.linalg.norm(np.diff(points, axis=2), axis=-1).sum(axis=-1)
    gain = hand.straight_pose.reach / np.maximum(bones, 1e-6)
    places: np.ndarray = bases + gain[..., None] * (points[:, :, 3] - points[:, :, 0])
    return places


def hand_length(hand: Hand) -> float:
    """Distance from a robot hand's wrist to its farthest fingertip, in the neutral pose [m]."""
    names = hand.tree.names
    points = np.asarray(hand.tree.positions(hand.full_configuration(hand.neutral)))
    tips = points[[names.index(name) for name in hand.tip_names]]
    return float(np.linalg.norm(tips - hand.wrist, axis=-1).max())


def quality_figures(episode: RobotClip) -> dict[str, float]:
    """Computes the quality metrics of an episode from its tracks; unknown metrics are left out.

    Args:
        episode: a clip with commands and tracks, whole or a part of one.

    Returns:
        ``frames``, ``seconds`` (to the end of the last frame), ``rate_hz``; and the other metrics
        of ``FIGURES`` for each hand, such as ``right.valid``.
    """
    stamps = episode.clip.stamps
    steps = np.diff(stamps)
    period = float(np.median(steps)) if len(steps) else 0.0
    figures: dict[str, float | None] = {
        "frames": float(len(stamps)),
        "seconds": float(stamps[-1] - stamps[0]) + period if len(stamps) else 0.0,
        "rate_hz": 1.0 / period if period > 0 else None,
    }
    for side in episode.commands:
        own = _of_hand(episode, side, period)
        figures |= {f"{side}.{name}": value for name, value in own.items()}
    return {name: float(value) for name, value in figures.items() if value is not None}


def worst(figures: Mapping[str, float], name: str) -> float | None:
    """The worse of the two hands' values of a metric; None if it is unknown for both."""
    goal = next(figure.goal for figure in FIGURES if figure.name == name)
    values = [value for key, value in figures.items() if key.partition(".")[2] == name]
    if not values:
        return None
    return min(values) if goal == "up" else max(values)


def _of_hand(episode: RobotClip, side: Side, period: float) -> dict[str, float | None]:
    commands, valid = episode.commands[side], episode.valid[side]
    unknown = np.full(len(valid), np.nan)

    def track(name: str) -> np.ndarray:
        return episode.tracks.get(f"{side}.{name}", unknown)

    depth = track("penetration")
    known_depth = depth[np.isfinite(depth)]
    confidence = episode.clip.confidence.get(side, unknown)
    wrist = episode.T_world_wrist.get(side)
    stamps = episode.clip.stamps
    return {
        "confidence": summary.mean(confidence),
        "valid": summary.mean(valid),
        "gap_s": longest_gap(valid, stamps, period),
        "wrist": None if wrist is None else summary.mean(poses.is_valid(wrist)),
        "jump_m_s": summary.maximum(track("speed")[1:]),
        "tip_error_mm": summary.scaled(summary.mean(track("tip_error")), 1e3),
        "tip_error_p95_mm": summary.scaled(summary.percentile(track("tip_error_max"), 95.0), 1e3),
        "reach": summary.mean(track("reached")),
        "collision": summary.mean(known_depth > COLLISION_DEPTH),
        "collision_depth_mm": summary.scaled(summary.maximum(known_depth), 1e3),
        "joint_step_rad": max_joint_step(commands.joint_positions),
        "jerk_rad_s3": _jerk(commands.joint_positions, stamps),
        "tracking_loss": summary.mean(track("loss")),
    } | _at_objects(episode, side)


def _at_objects(episode: RobotClip, side: Side) -> dict[str, float | None]:
    """Contact metrics of a hand; empty for an episode without contact tracks."""
    if f"{side}.object_depth" not in episode.tracks:
        return {}
    names = ("shared_contacts", "robot_contacts", "human_contacts")
    shared, robot, human = (int(episode.tracks[f"{side}.{name}"].sum()) for name in names)
    error = 1e3 * float(episode.tracks[f"{side}.contact_error"].sum())
    depth = np.maximum(episode.tracks[f"{side}.object_depth"], 0.0)
    return {
        "contact_precision": shared / robot if robot else None,
        "contact_recall": shared / human if human else None,
        "contact_error_mm": error / human if human else None,
        "object_depth_mm": summary.scaled(summary.maximum(depth), 1e3),
    }


def longest_gap(valid: np.ndarray, stamps: np.ndarray, period: float) -> float:
    """Longest time without a valid frame [s], where each frame lasts one period."""
    edges = np.flatnonzero(np.diff(np.r_[True, valid, True].astype(np.int8)))
    starts, stops = edges[::2], edges[1::2]
    if not len(starts):
        return 0.0
    return float((stamps[stops - 1] - stamps[starts] + period).max())


def _speed(recording: HandRecording, reaches: np.ndarray) -> Float[np.ndarray, " T"]:
    """Speed of the wrist, or of a fingertip relative to the wrist if that is faster [m/s]."""
    moved = np.linalg.norm(np.diff(reaches, axis=0), axis=-1)  # (T - 1, F), NaN if one is missing
    if recording.T_world_wrist is not None:
        wrist = np.linalg.norm(np.diff(recording.T_world_wrist[:, :3], axis=0), axis=-1)
        moved = np.concatenate([moved, wrist[:, None]], axis=1)
    moved = np.where(np.isfinite(moved), moved, -1.0).max(axis=1)
    speed = moved / np.diff(recording.stamps)
    return np.concatenate([[np.nan], np.where(moved < 0, np.nan, speed)])


def _looks(recording: HandRecording) -> slice:
    """The frames in which self-penetration is measured."""
    rate = recording.rate_hz
    return slice(None, None, max(1, round(rate / COLLISION_RATE_HZ)) if np.isfinite(rate) else 1)


def _joined(recordings: Sequence[HandRecording]) -> HandRecording:
    """Joins the frames of recordings of one side, for functions that treat each frame alone."""
    landmarks = np.concatenate([each.landmarks for each in recordings])
    valid = np.concatenate([np.asarray(each.valid) for each in recordings])
    stamps = np.arange(len(landmarks), dtype=np.float64)
    return HandRecording(landmarks, stamps, recordings[0].side, valid)


def _jerk(positions: np.ndarray, stamps: np.ndarray) -> float | None:
    """Mean magnitude of the third derivative of the joints [rad/s^3]."""
    if len(stamps) < 4:
        return None
    acceleration = second_derivative(positions, stamps)
    return summary.mean(np.abs(np.diff(acceleration, axis=0) / np.diff(stamps[1:-1])[:, None]))


@dataclass(frozen=True)
class Dropped:
    """A part of a clip that was dropped.

    Attributes:
        name: name that the episode would have had.
        frames: first frame in the clip, and the frame after the last.
        reasons: name of a limit -> description of the value that violates it.
        figures: quality of the episode; empty for frames without a hand.
    """

    name: str
    frames: tuple[int, int]
    reasons: dict[str, str]
    figures: dict[str, float]


def select(whole: RobotClip, limits: Limits) -> Iterator[RobotClip | Dropped]:
    """Yields the episodes of a clip in time order: those that are kept, with quality metrics, and
    those that are dropped."""
    whole = _confident(whole, limits.min_confidence)
    motion = _finger_motions(whole)
    if limits.whole:
        yield _judged(whole, slice(0, len(whole.clip)), limits, motion)
        return
    valid = np.array(list(whole.valid.values()))
    good = np.asarray(valid.any(axis=0) if limits.hands == "any" else valid.all(axis=0))
    parts = list(_parts(good, _jumps(whole, limits), whole.clip.stamps, limits.max_gap))
    at = 0
    for part in parts:
        if at < part.start:
            yield _lost(whole, at, part.start)
        yield _judged(robot_part(whole, part), part, limits, motion)
        at = part.stop
    if at < len(good):
        yield _lost(whole, at, len(good))


def _confident(whole: RobotClip, least: float) -> RobotClip:
    """Marks frames in which the tracker's confidence is low as not valid."""
    valid = dict(whole.valid)
    for side, confidence in whole.clip.confidence.items():
        if side in valid:
            valid[side] = valid[side] & ~(confidence < least)  # NaN: not known
    return replace(whole, valid=valid)


def _finger_motions(whole: RobotClip) -> dict[str, float]:
    """Finger motion over the whole clip, because a hand may be still in a part of it."""
    return {
        f"{side}.finger_motion_mm": 1e3 * motion
        for side in whole.commands
        if (motion := finger_motion(whole.clip.hands[side])) is not None
    }


def _jumps(whole: RobotClip, limits: Limits) -> Bool[np.ndarray, " T"]:
    """True for frames to which a hand jumped."""
    jumped = np.zeros(len(whole.clip), bool)
    for name, values in whole.tracks.items():
        if name.endswith(".speed"):
            jumped |= values > limits.max_jump  # NaN compares as False
    return jumped


def _parts(
    good: Bool[np.ndarray, " T"], jumped: Bool[np.ndarray, " T"], stamps: np.ndarray, gap: float
) -> Iterator[slice]:
    """Yields the parts that begin and end with a good frame and contain no jump or long gap."""
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
    episode: RobotClip, frames: slice, limits: Limits, motion: Mapping[str, float]
) -> RobotClip | Dropped:
    figures = {**quality_figures(episode), **motion}
    rules = (rule for rule in RULES if limits.whole or not rule.cuts)
    violations = ((rule.limit, rule.violation(figures, limits)) for rule in rules)
    reasons = {limit: text for limit, text in violations if text is not None}
    if reasons:
        return Dropped(episode.clip.name, (frames.start, frames.stop), reasons, figures)
    return replace(episode, figures=figures)
