"""Object-aware retargeting against methods that do not know of objects, on the same made clips."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Float
from object_scenes import MadeClip

from smooth_hand_datasets.objects.hand_surface import HandSurface
from smooth_hand_datasets.objects.interaction_metrics import interaction_figures, interaction_tracks
from smooth_operator.metrics.accuracy import cosine_similarity
from smooth_operator.metrics.assemble import assemble_trace
from smooth_operator.retargeting.alignment import AlignmentConfig
from smooth_operator.types import CommandTrajectory

AWARE: Final = "object-aware"
BLIND: Final = "smooth:offline"

COLUMNS: Final = (
    "contact_precision",
    "contact_recall",
    "contact_f1",
    "contact_error_mm",
    "contact_place_mm",
    "penetration_max_mm",
    "penetration_mean_mm",
    "cosine",
)
"""Figures of a clip that are compared."""


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


def interval(values: Float[np.ndarray, "n ..."]) -> tuple[float, float, float]:
    """Mean of (n,) values, or ratio of the means of (n, 2), and its 95 % interval by a bootstrap
    over clips; NaN values are left out."""
    pairs = values if values.ndim == 2 else np.stack([values, np.ones(len(values))], axis=1)
    pairs = pairs[np.isfinite(pairs).all(axis=1)]
    if not len(pairs):
        return float("nan"), float("nan"), float("nan")
    rng = np.random.default_rng(0)
    drawn = pairs[rng.integers(0, len(pairs), (4000, len(pairs)))].mean(axis=1)
    low, high = np.quantile(drawn[:, 0] / np.maximum(drawn[:, 1], 1e-12), [0.025, 0.975])
    mean = pairs.mean(axis=0)
    return float(mean[0] / max(mean[1], 1e-12)), float(low), float(high)


def table(rows: Sequence[Judged]) -> str:
    """A Markdown table of means with 95 % intervals over clips, one line for each method.

    The column of the largest depth has the largest of all clips as well.
    """
    lines = []
    for method in dict.fromkeys(row.method for row in rows):
        cells = [f"`{method}`"]
        for column in COLUMNS:
            values = np.array([r.figures[column] for r in rows if r.method == method])
            mean, low, high = interval(values)
            digits = 4 if column == "cosine" else 2 if column.endswith("_mm") else 3
            cell = f"{mean:.{digits}f} [{low:.{digits}f}, {high:.{digits}f}]"
            if column == "penetration_max_mm":
                cell += f", {np.nanmax(values):.2f}"
            cells.append(cell)
        lines.append(cells)
    head = ["method", *COLUMNS]
    return "\n".join("| " + " | ".join(c) + " |" for c in (head, ["---"] * len(head), *lines))


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
        "precision_error_ratio": interval(1.0 - values("contact_precision")),
        "contact_error_ratio": interval(values("contact_error_mm")),
        "worst_penetration_mm": (worst, worst, worst),
        "cosine_change": interval(change[:, 0] - change[:, 1]),
    }
