"""Object-aware retargeting against methods that do not know of objects, on the same made clips."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final, TypeAlias

import numpy as np
from jaxtyping import Float

from smooth_hand_datasets.objects.hand_surface import HandSurface
from smooth_hand_datasets.objects.interaction_metrics import interaction_figures, interaction_tracks
from smooth_hand_datasets.objects.placement import landmarks_in_world, palm_in_world
from smooth_hand_datasets.objects.retargeter import ObjectAwareRetargeter
from smooth_hand_datasets.objects.terms import DEFAULT, ObjectSettings
from smooth_operator import poses
from smooth_operator.hands.hand import Hand
from smooth_operator.hands.registry import load_hand
from smooth_operator.human.alignment import AlignmentConfig
from smooth_operator.lab.datasets.retargeting import whole_config
from smooth_operator.lab.offline.trajectory_retargeter import TrajectoryRetargeter
from smooth_operator.landmarks import FINGERS, TIPS
from smooth_operator.methods.presets import method_config
from smooth_operator.methods.retargeter import Retargeter
from smooth_operator.metrics.accuracy import cosine_similarity
from smooth_operator.metrics.assemble import assemble_trace
from smooth_operator.types import CommandTrajectory
from smooth_operator_research.objects.scenes import Form, Kind, MadeClip

AWARE: Final = "object-aware"
FIXED_WRIST: Final = "object-aware, wrist fixed"
BLIND: Final = "smooth:offline"
_FITTED: Final = ", wrist fitted"
FITTED: Final = BLIND + _FITTED
"""Such a wrist is moved so that the fingertips are, in the mean, where the human's are: a stronger
opponent, of any method."""
PUBLISHED: Final = (
    "keyvector:vector",
    "keyvector:vector" + _FITTED,
    "dexpilot:published",
    "dexpilot:published" + _FITTED,
)
"""dex-retargeting's ``vector`` by our solver, and DexPilot as published."""

COMBINATIONS: Final[tuple[tuple[Kind, Form], ...]] = (
    ("grasp", "sphere"), ("grasp", "cylinder"), ("grasp", "box"), ("grasp", "mesh"),
    ("pinch", "sphere"), ("pinch", "cylinder"), ("pinch", "box"), ("pinch", "mesh"),
    ("twist", "capsule"), ("twist", "cylinder"), ("twist", "box"), ("twist", "mesh"),
    ("slide", "capsule"), ("slide", "cylinder"), ("slide", "box"), ("slide", "mesh"),
)  # fmt: skip

# The weights were chosen on mimic_p050 and leap_hand with seeds 0 and 1, not on these.
REPORTED_HANDS: Final = ("shadow_hand", "allegro_hand", "sharpa_wave", "inspire_hand")
REPORTED_SEEDS: Final = (100,)

COLUMNS: Final = (
    "contact_precision", "contact_recall", "contact_f1", "contact_error_mm", "contact_place_mm",
    "penetration_max_mm", "penetration_mean_mm", "cosine",
)  # fmt: skip
"""Figures of a clip that are compared."""

Answer: TypeAlias = Callable[[MadeClip], tuple[CommandTrajectory, Float[np.ndarray, "T 7"]]]
"""A clip to commands and the robot's palm in the world."""


@dataclass(frozen=True)
class Judged:
    """Figures of one method, hand and clip.

    Attributes:
        method: whose.
        hand: name of the robot hand.
        clip: name of the clip.
        figures: by name, ``COLUMNS`` and more.
    """

    method: str
    hand: str
    clip: str
    figures: Mapping[str, float]


def compare(
    hands: Iterable[str],
    clips: Sequence[MadeClip],
    methods: Sequence[str],
    settings: ObjectSettings = DEFAULT,
    note: Callable[[str], None] = lambda _: None,
) -> list[Judged]:
    """Runs methods on clips and measures them.

    Args:
        hands: names of robot hands.
        clips: of hands of one side.
        methods: as ``answer_of`` takes them.
        settings: of the object-aware ones.
        note: takes a line for each hand.
    """
    side = next(iter(clips[0].clip.hands))
    out = []
    for name in hands:
        hand = load_hand(name, side)
        surface = HandSurface(hand)
        for method in methods:
            answer, alignment = answer_of(method, hand, settings)
            for clip in clips:
                commands, palm = answer(clip)
                figures = judge(clip, surface, commands, palm, alignment)
                out.append(Judged(method, name, clip.clip.name, figures))
            note(f"{name}: {method}")
    return out


def judge(
    clip: MadeClip,
    surface: HandSurface,
    commands: CommandTrajectory,
    T_world_palm: Float[np.ndarray, "T 7"],
    alignment: AlignmentConfig,
) -> dict[str, float]:
    """Figures of one run, against the contacts of record."""
    side = next(iter(clip.clip.hands))
    trace = assemble_trace(
        clip.clip.hands[side], commands, surface.hand, alignment, reach_samples=0
    )
    figures = interaction_figures(
        interaction_tracks(surface, commands.joint_positions, T_world_palm, clip.scene, clip.truth)
    )
    cosine = cosine_similarity(trace.human_keyvectors, trace.robot_keyvectors)
    return figures | {"cosine": float("nan") if cosine is None else cosine}


def answer_of(method: str, hand: Hand, settings: ObjectSettings) -> tuple[Answer, AlignmentConfig]:
    """How a method answers clips with one hand, and its alignment.

    Args:
        method: ``AWARE``, ``FIXED_WRIST``, or ``method:preset``; ``, wrist fitted`` may follow.
        hand: the robot hand.
        settings: of the object-aware ones.
    """
    if method in (AWARE, FIXED_WRIST):
        chosen = settings if method == AWARE else replace(settings, shift=0.0, turn=0.0)
        aware = ObjectAwareRetargeter(hand, settings=chosen)

        def with_objects(clip: MadeClip) -> tuple[CommandTrajectory, np.ndarray]:
            trajectory = aware.run(clip.clip, next(iter(clip.clip.hands)), clip.solids)
            return trajectory.commands, trajectory.T_world_palm

        return with_objects, aware.config.alignment
    name, _, preset = method.removesuffix(_FITTED).partition(":")
    config = method_config(name, preset or None)
    runner = (
        Retargeter(hand, config=config)
        if config.trajectory is None
        else TrajectoryRetargeter(hand, whole_config(config))
    )

    def without(clip: MadeClip) -> tuple[CommandTrajectory, np.ndarray]:
        recording = next(iter(clip.clip.hands.values()))
        commands, _ = runner.run(recording)
        palm = palm_in_world(recording, hand, config.alignment)
        if method.endswith(_FITTED):
            palm = _fitted(hand, commands, landmarks_in_world(recording), palm)
        return commands, palm

    return without, config.alignment


def _fitted(
    hand: Hand,
    commands: CommandTrajectory,
    landmarks: Float[np.ndarray, "T 21 3"],
    palm: Float[np.ndarray, "T 7"],
) -> Float[np.ndarray, "T 7"]:
    """The palm moved so that the robot's fingertips are, in the mean, where the human's are."""
    human = landmarks[:, [TIPS[FINGERS.index(finger)] for finger in hand.fingers]]
    tips = hand.tips(commands.joint_positions)
    robot = poses.rotate(palm[:, None, 3:], tips) + palm[:, None, :3]
    return np.concatenate([palm[:, :3] + (human - robot).mean(axis=1), palm[:, 3:]], axis=-1)


def interval(
    values: Float[np.ndarray, " n"], draws: int = 4000, seed: int = 0
) -> tuple[float, float, float]:
    """Mean and its 95 % interval by a bootstrap over clips; NaN values are left out."""
    values = values[np.isfinite(values)]
    if not len(values):
        return float("nan"), float("nan"), float("nan")
    rng = np.random.default_rng(seed)
    means = values[rng.integers(0, len(values), (draws, len(values)))].mean(axis=1)
    low, high = np.quantile(means, [0.025, 0.975])
    return float(values.mean()), float(low), float(high)


def table(rows: Sequence[Judged], hand: str | None = None) -> str:
    """A Markdown table of means with 95 % intervals over clips, one line for each method.

    The column of the largest depth has the largest of all clips as well.

    Args:
        rows: from ``compare``.
        hand: only of this hand; None for all.
    """
    chosen = [row for row in rows if hand in (None, row.hand)]
    lines = [
        "| method | precision | recall | F1 | contact error [mm] | place [mm] "
        "| deepest [mm]: mean of clips, worst | mean depth [mm] | cosine |",
        "|---|---:|---:|---:|---:|---:|---:|---:|---:|",
    ]
    for method in dict.fromkeys(row.method for row in chosen):
        cells = [f"`{method}`"]
        for column in COLUMNS:
            values = np.array([r.figures[column] for r in chosen if r.method == method])
            mean, low, high = interval(values)
            digits = 4 if column == "cosine" else 3 if column.startswith("contact_") else 2
            digits = 2 if column.endswith("_mm") else digits
            cell = f"{mean:.{digits}f} [{low:.{digits}f}, {high:.{digits}f}]"
            if column == "penetration_max_mm":
                cell += f", {np.nanmax(values):.2f}"
            cells.append(cell)
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def targets(rows: Sequence[Judged]) -> dict[str, tuple[float, float, float]]:
    """What is asked of the object-aware form against the blind one, each with its interval.

    Returns:
        ``precision_error_ratio``: (1 - precision) over the blind one's, of the means over clips;
        ``contact_error_ratio``: the same of the contact error; ``worst_penetration_mm``: the
        deepest of all clips; ``cosine_change``: mean difference of the cosines.
    """
    by = {
        method: {(r.hand, r.clip): r.figures for r in rows if r.method == method}
        for method in (AWARE, BLIND)
    }
    pairs = [(by[AWARE][key], by[BLIND][key]) for key in by[AWARE] if key in by[BLIND]]

    def values(name: str) -> np.ndarray:
        return np.array([[one[name], other[name]] for one, other in pairs])

    worst = float(np.nanmax(values("penetration_max_mm")[:, 0]))
    change = values("cosine")
    return {
        "precision_error_ratio": _ratio(1.0 - values("contact_precision")),
        "contact_error_ratio": _ratio(values("contact_error_mm")),
        "worst_penetration_mm": (worst, worst, worst),
        "cosine_change": interval(change[:, 0] - change[:, 1]),
    }


def _ratio(
    pairs: Float[np.ndarray, "n 2"], draws: int = 4000, seed: int = 0
) -> tuple[float, float, float]:
    """Ratio of two means over clips and its 95 % interval."""
    pairs = pairs[np.isfinite(pairs).all(axis=1)]
    rng = np.random.default_rng(seed)
    drawn = pairs[rng.integers(0, len(pairs), (draws, len(pairs)))].mean(axis=1)
    ratios = drawn[:, 0] / np.maximum(drawn[:, 1], 1e-12)
    mean = pairs.mean(axis=0)
    low, high = np.quantile(ratios, [0.025, 0.975])
    return float(mean[0] / max(mean[1], 1e-12)), float(low), float(high)
