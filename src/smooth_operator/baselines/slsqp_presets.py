"""Presets of the methods that SLSQP solves: keyvector, hybrid, dexpilot and ako."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

from smooth_operator.baselines.slsqp import ScipySlsqpConfig, SlsqpConfig
from smooth_operator.baselines.slsqp_method import AkoTargets, SlsqpMethodConfig, TipTargets
from smooth_operator.objective.loss import ObjectiveConfig
from smooth_operator.objective.published import DexPilotTargets, PlainTargets
from smooth_operator.solvers.newton import NewtonConfig

KEYVECTOR: Final = SlsqpMethodConfig(
    objective=ObjectiveConfig(targets=PlainTargets(), pose_weight=2.5e-3, velocity_weight=0.0)
)
"""All keyvectors follow the human's, by SLSQP from the last command.

Smooth-L1 in units of its transition and a tolerance of 1e-6 leave no dead band: the hand moves in
every frame in which the human's moves.
"""

KEYVECTOR_VECTOR: Final = replace(
    KEYVECTOR,
    objective=ObjectiveConfig(
        targets=PlainTargets(w_thumb=0.0, w_between=0.0), pose_weight=0.0, velocity_weight=4e-3
    ),
)
"""``vector`` as in dex-retargeting: wrist-to-tip vectors, regularised to the last command."""

KEYVECTOR_POSITION: Final = replace(
    KEYVECTOR,
    objective=ObjectiveConfig(targets=TipTargets(), pose_weight=0.0, velocity_weight=4e-3),
)
"""``position`` as in dex-retargeting: fingertips at the human's positions in the palm frame."""

HYBRID: Final = replace(KEYVECTOR, start="joint_angle", approach=NewtonConfig(iterations=12))
"""The hybrid of mimic-one (Nava et al. 2025): the keyvector method from the joint-angle solution.

That start lies further from the minimum than the last command, so it takes more Newton steps.
"""

DEXPILOT: Final = SlsqpMethodConfig(
    objective=ObjectiveConfig(
        targets=DexPilotTargets(
            project=0.03, escape=0.05, eta1=5e-3, eta2=0.03, w_set1=200.0, w_set2=400.0
        ),
        pose_weight=2.5e-3,
        velocity_weight=0.0,
    )
)
"""DexPilot (Handa et al. 2019) with its published numbers, without a velocity term."""

AKO: Final = SlsqpMethodConfig(
    objective=ObjectiveConfig(
        targets=AkoTargets(),
        loss="smooth_l1_norm",
        pose_weight=0.0,
        velocity_weight=0.1,
        velocity_loss="smooth_l1",
    )
)
"""Analyzing Key Objectives (Yu et al. 2025), but pinch vectors do not fade with distance."""


def _as_published(
    config: SlsqpMethodConfig, objective: ObjectiveConfig, tolerance: float = 1e-6
) -> SlsqpMethodConfig:
    """The configuration with the authors' solver: SciPy's SLSQP, at most 20 iterations a frame."""
    return replace(
        config,
        objective=objective,
        approach=NewtonConfig(iterations=0),
        solver=ScipySlsqpConfig(tolerance=tolerance, max_iterations=20),
    )


_FIVE_VECTORS: Final = ObjectiveConfig(
    targets=PlainTargets(w_thumb=0.0, w_between=0.0),
    loss="squared",
    pose_weight=0.0,
    velocity_weight=0.0,
)

KEYVECTOR_PUBLISHED: Final = _as_published(KEYVECTOR, _FIVE_VECTORS)
"""The baseline of the paper's authors: wrist to tips with a squared error."""

HYBRID_PUBLISHED: Final = replace(KEYVECTOR_PUBLISHED, start="published_angles")
"""The paper's baseline: the same, from the authors' joint angles."""

DEXPILOT_PUBLISHED: Final = _as_published(DEXPILOT, replace(DEXPILOT.objective, pose_centre="zero"))
"""The paper's baseline: the pose term pulls to zero angles."""

AKO_PUBLISHED: Final = _as_published(
    AKO, replace(AKO.objective, targets=AkoTargets(switch_pinch=True)), tolerance=1e-5
)
"""The paper's baseline: pinch vectors fade with the distance from the thumb."""


def _alone(config: SlsqpMethodConfig) -> SlsqpMethodConfig:
    """The configuration with NLopt's SLSQP alone, until its own tolerance."""
    return replace(config, approach=NewtonConfig(iterations=0), solver=SlsqpConfig())


KEYVECTOR_PRESETS: Final = {
    "default": KEYVECTOR,
    "vector": KEYVECTOR_VECTOR,
    "position": KEYVECTOR_POSITION,
    "slsqp": _alone(KEYVECTOR),
    "published": KEYVECTOR_PUBLISHED,
}
HYBRID_PRESETS: Final = {
    "default": HYBRID,
    "slsqp": _alone(HYBRID),
    "published": HYBRID_PUBLISHED,
}
DEXPILOT_PRESETS: Final = {
    "default": DEXPILOT,
    "slsqp": _alone(DEXPILOT),
    "published": DEXPILOT_PUBLISHED,
}
AKO_PRESETS: Final = {"default": AKO, "slsqp": _alone(AKO), "published": AKO_PUBLISHED}
