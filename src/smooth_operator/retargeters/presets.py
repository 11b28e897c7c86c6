"""Methods and their presets, as Python objects."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Final

from smooth_operator.errors import UnknownNameError
from smooth_operator.objective.key_objectives import AkoTargets
from smooth_operator.objective.loss import ObjectiveConfig
from smooth_operator.objective.targets import DexPilotTargets, PlainTargets, TipTargets
from smooth_operator.retargeters.descent import DescentConfig
from smooth_operator.retargeters.geort import GeortConfig
from smooth_operator.retargeters.joint_angle import JointAngleConfig
from smooth_operator.retargeters.method import MethodConfig
from smooth_operator.retargeters.sbr import SbrConfig
from smooth_operator.solvers.newton import NewtonConfig
from smooth_operator.solvers.sampling import SamplingConfig
from smooth_operator.solvers.slsqp import SlsqpConfig

SBR_PAPER: Final = SbrConfig()
"""The paper's table of hyper-parameters, fresh normals in every cycle."""

SBR_REALTIME: Final = SbrConfig(
    objective=ObjectiveConfig(
        targets=DexPilotTargets(w_thumb=1.4, w_between=0.85, blend=0.4),
        pose_weight=0.049,
        velocity_weight=0.107,
    ),
    sampling=SamplingConfig(samples=256, elites=24, cycles=5, draws="quasi"),
    polish=NewtonConfig(iterations=3, damping=(0.0, 1.0)),
    settle_rounds=10,
)
"""For an ordinary CPU: few quasi-random base samples find the basin, Newton steps its floor.

The optimum that the paper's sampler only approaches follows fast motion more closely, jumps of
the pinch latches included; so a latch moves over 2.5 frames, and weight goes from the
finger-to-finger keyvectors to the thumb's. The weights were tuned on three recordings (a glove, the
set that GeoRT trains on, the built-in operator); docs/benchmarks.md says which and shows others.
"""

KEYVECTOR: Final = DescentConfig(
    objective=ObjectiveConfig(targets=PlainTargets(), pose_weight=2.5e-3, velocity_weight=0.0)
)
"""All keyvectors follow the human's, solved by SLSQP from the last command.

Smooth-L1 in units of its transition and a tolerance of 1e-6 leave no dead band: the hand moves in
every frame that the human's does.
"""

KEYVECTOR_VECTOR: Final = replace(
    KEYVECTOR,
    objective=ObjectiveConfig(
        targets=PlainTargets(w_thumb=0.0, w_between=0.0), pose_weight=0.0, velocity_weight=4e-3
    ),
)
"""``vector`` in dex-retargeting's sense: wrist-to-tip vectors only, held by the last command."""

KEYVECTOR_POSITION: Final = replace(
    KEYVECTOR,
    objective=ObjectiveConfig(targets=TipTargets(), pose_weight=0.0, velocity_weight=4e-3),
)
"""``position`` in dex-retargeting's sense: fingertips at the human's places in the palm frame."""

HYBRID: Final = replace(KEYVECTOR, start="joint_angle", approach=NewtonConfig(iterations=12))
"""mimic-one's (Nava et al. 2025): the keyvector method, begun at the joint-angle solution.

That lies further from the minimum than the last command does, so it takes more Newton steps.
"""

DEXPILOT: Final = DescentConfig(
    objective=ObjectiveConfig(
        targets=DexPilotTargets(
            project=0.03, escape=0.05, eta1=5e-3, eta2=0.03, w_set1=200.0, w_set2=400.0
        ),
        pose_weight=2.5e-3,
        velocity_weight=0.0,
    )
)
"""DexPilot (Handa et al. 2019) with its own numbers; no velocity term."""

AKO: Final = DescentConfig(
    objective=ObjectiveConfig(targets=AkoTargets(), pose_weight=0.0, velocity_weight=0.1)
)
"""Analyzing Key Objectives (Xin et al. 2025)."""


def _alone(config: DescentConfig) -> DescentConfig:
    """As published: SLSQP from the start, until its own tolerance."""
    return replace(config, approach=NewtonConfig(iterations=0), solver=SlsqpConfig())


PRESETS: Final[dict[str, dict[str, MethodConfig]]] = {
    "sbr": {"realtime": SBR_REALTIME, "paper": SBR_PAPER},
    "joint_angle": {"default": JointAngleConfig()},
    "keyvector": {
        "default": KEYVECTOR,
        "vector": KEYVECTOR_VECTOR,
        "position": KEYVECTOR_POSITION,
        "slsqp": _alone(KEYVECTOR),
    },
    "hybrid": {"default": HYBRID, "slsqp": _alone(HYBRID)},
    "dexpilot": {"default": DEXPILOT, "slsqp": _alone(DEXPILOT)},
    "ako": {"default": AKO, "slsqp": _alone(AKO)},
    "geort": {"default": GeortConfig()},
}
"""Method name -> preset name -> configuration; the first preset of a method is its default."""


def method_names() -> tuple[str, ...]:
    """Names of the methods."""
    return tuple(PRESETS)


def method_config(method: str = "sbr", preset: str | None = None) -> MethodConfig:
    """Configuration of a method by preset name; None gives the method's default preset.

    For a method with a trained model (geort), the file of one may stand for the preset.

    Raises:
        UnknownNameError: if there is no such method or preset.
    """
    if method not in PRESETS:
        raise UnknownNameError("method", method, PRESETS)
    presets = PRESETS[method]
    if preset is None:
        return next(iter(presets.values()))
    if preset not in presets:
        default = next(iter(presets.values()))
        if isinstance(default, GeortConfig) and Path(preset).is_file():
            return replace(default, model=Path(preset))
        raise UnknownNameError(f"preset of method {method!r}:", preset, presets)
    return presets[preset]
