"""Which settings of ``smooth`` are changed for the tables of ``method_tables``, as data."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from smooth_operator.lab.tuning.pareto import (
    ALL_VECTORS,
    COLLISION,
    FLATNESS,
    MOTION,
    PINCH,
    THUMB,
    VELOCITY,
    Axis,
)
from smooth_operator_research.judging.judge import GLOVE
from smooth_operator_research.judging.setting_rows import Values

TARGETS = "objective.targets"
VECTORS = "direction_length"
SQUARED = 0.02
"""``huber_width`` [m] beyond any length error of a pinch: the cost is a parabola there."""
WITHOUT: dict[str, Values] = {
    "motion term": {"motion_weight": 0.0},
    "its decrease with speed (s → ∞)": {"motion_speed": 1e6},
    "self-collision cost": {"self_collision.weight": 0.0},
    "weights by kind (all 1)": {
        f"{TARGETS}.w_wrist": 1.0, f"{TARGETS}.w_thumb": 1.0, f"{TARGETS}.w_between": 1.0,
    },
    "focus (powers 0)": {f"{TARGETS}.focus": 0.0, f"{TARGETS}.focus_between": 0.0},
    "velocity term": {"objective.velocity_weight": 0.0},
    "lag": {"landmarks.time_constant": 0.0},
    "jump threshold": {"landmarks.jump_threshold": 1e9},
    "its growth with noise": {"landmarks.noise": 0.0},
    "direction cost": {f"{VECTORS}.direction": 0.0},
    "length cost": {f"{VECTORS}.length": 0.0},
    "its linear form (squared instead)": {
        f"{VECTORS}.length": 1000.0, f"{VECTORS}.huber_width": SQUARED,
    },
    "targets apart": {f"{TARGETS}.apart": 0.0},
    "pose term (γ = 0.0005)": {"objective.pose_weight": 0.0005},
}  # fmt: skip
"""Part -> settings with which it is out of the whole."""

ALWAYS_IN = ("pose term (γ = 0.0005)", "its linear form (squared instead)")
"""Parts that stay where nothing else is left."""

ALONE: dict[str, tuple[str, ...]] = {
    "motion term, constant": ("motion term",),
    "motion term, decreasing with speed": ("motion term", "its decrease with speed (s → ∞)"),
    "self-collision cost": ("self-collision cost",),
    "weights by kind": ("weights by kind (all 1)",),
    "focus": ("focus (powers 0)",),
    "velocity term": ("velocity term",),
    "lag": ("lag",),
    "jump threshold": ("jump threshold",),
    "jump threshold, growing with noise": ("jump threshold", "its growth with noise"),
    "direction cost": ("direction cost",),
    "length cost": ("length cost",),
    "direction and length costs": ("direction cost", "length cost"),
}
"""Name -> which of those above are put back into nothing."""


@dataclass(frozen=True)
class Front:
    """Two things that can't be had together.

    Attributes:
        title: what they are.
        setting: what is changed.
        rows: name -> settings.
        x, y: how they stand against each other in the picture.
        without: part whose row of ``without`` is a point of the picture, too.
    """

    title: str
    setting: str
    rows: Mapping[str, Values]
    x: Axis
    y: Axis
    without: str | None = None


FRONTS = (
    Front(
        "Smooth against correlated",
        "lag, jump threshold",
        {  # a jump_speed would widen a threshold of 0.05 m at 30 Hz
            f"lag {1e3 * lag:g} ms, jump {'∞' if jump > 1e3 else f'{jump:g}'}": {
                "landmarks.time_constant": lag, "landmarks.jump_threshold": jump,
                "landmarks.jump_speed": 0.0, "landmarks.noise": 0.0,
            }
            for lag, jump in ((0.0, 1e9), (5e-4, 0.2), (1.75e-3, 0.2), (1.75e-3, 0.1),
                              (1.75e-3, 0.05), (4e-3, 0.1), (4e-3, 0.05), (8e-3, 0.1))
        },
        FLATNESS,
        VELOCITY,
    ),
    Front(
        "Accurate against moving",
        "weight of the motion term",
        {f"w_m = {w:g}": {"motion_weight": w} for w in (50.0, 150.0, 400.0, 1500.0)},
        ALL_VECTORS,
        MOTION,
    ),
    Front(
        "Accurate against collision-free",
        "weight of the self-collision cost",
        {f"w_c = {w:g}": {"self_collision.weight": w} for w in (300.0, 1000.0, 3000.0, 20000.0)},
        COLLISION,
        THUMB,
        without="self-collision cost",
    ),
    Front(
        "Direction against pinch gap",
        "weights of direction and length",
        {
            f"direction {d:g}, length {w:g}": {f"{VECTORS}.direction": d, f"{VECTORS}.length": w}
            for d, w in ((0.0, 0.0), (0.5, 115.0), (1.0, 115.0), (1.5, 200.0), (1.5, 50.0),
                         (2.0, 0.0))
        }
        | {
            f"direction 1.5, length {w:g}, squared": {
                f"{VECTORS}.direction": 1.5, f"{VECTORS}.length": w,
                f"{VECTORS}.huber_width": SQUARED,
            }
            for w in (3000.0, 6000.0)
        },
        PINCH,
        THUMB,
    ),
)  # fmt: skip

LIKE_ANY_VALUE = frozenset({
    "motion_weight", "self_collision.weight", f"{TARGETS}.focus", f"{TARGETS}.focus_between",
    "objective.velocity_weight", "objective.pose_weight", "landmarks.time_constant",
    "landmarks.jump_speed", "landmarks.noise", f"{VECTORS}.direction", f"{VECTORS}.length",
    f"{TARGETS}.apart",
})  # fmt: skip
"""Settings whose 0 needs no separate program, see ``setting_rows``."""

TUNED_ON = {
    "glove, frames 0–499": f"{GLOVE}@0:500",
    "human_alex, frames 0–1748": "human_alex_21x3.npy@30hz,0:1749",
    "synthetic operator 11": "synthetic:11@0:1200",
}
HANDS_ON = {
    "glove 0–499": f"{GLOVE}@0:500",
    "synthetic 11, 10 s": "synthetic:11@0:1000",
    "alex 0–599": "human_alex_21x3.npy@30hz,0:600",
}
HANDS = ("allegro_hand", "leap_hand", "shadow_hand", "inspire_hand")
