"""A method's configuration for one calibrated operator."""

from __future__ import annotations

import dataclasses
from typing import Any, cast

from smooth_operator.human.alignment import AlignmentConfig
from smooth_operator.human.operator import Component, OperatorProfile
from smooth_operator.methods.method import MethodConfig
from smooth_operator.methods.whole import WholeConfig
from smooth_operator.objective.close_targets import CloseTargets
from smooth_operator.objective.loss import ObjectiveConfig
from smooth_operator.objective.targets import DexPilotTargets


def operated_by(config: MethodConfig, operator: OperatorProfile) -> MethodConfig:
    """The configuration with the operator's corrections, and latches at the operator's distances.

    Once tips are corrected, thumb and finger read nearly nothing in every pinch, so one pair of
    distances serves all fingers. DexPilot's own (30 and 50 mm) allow for an operator that nobody
    measured, and close the neighbours of a pinching finger with it. Targets without latches have
    nothing to set.

    ``smooth`` holds the thumb's vectors by direction and by length. So its pinches are closed by
    the length alone: to move landmarks would turn the directions with them, which cost it cosine
    similarity (docs/how-to/calibrate.md). It does not use the components that ``left_out`` names.

    Args:
        config: of any method.
        operator: who is to drive it.
    """
    objective = getattr(config, "objective", None)
    targets = objective.targets if isinstance(objective, ObjectiveConfig) else None
    kept = operator.without(*left_out(config, operator))
    if isinstance(targets, CloseTargets) and operator.has("pinch"):
        gaps = tuple((name, gap * operator.scale) for name, gap in operator.pinch_gaps.items())
        closing = dataclasses.replace(targets, pinch_gaps=gaps)
        config = aligned_by(config, operator=kept.without("pinch"))
        return _with_targets(config, objective, closing)
    config = aligned_by(config, operator=kept)
    project, escape = operator.project, operator.escape
    if not (isinstance(targets, DexPilotTargets) and operator.has("pinch")):
        return config
    if project is None or escape is None:
        return config
    latching = dataclasses.replace(targets, project=project, escape=escape)
    return _with_targets(config, objective, latching)


def left_out(config: MethodConfig, operator: OperatorProfile) -> tuple[Component, ...]:
    """Which components of a calibration a method does not use.

    ``smooth`` leaves out ``scale``: one scale for all frames helped it on no recording, and on
    video it preserved motion less (docs/how-to/calibrate.md). A scale in the configuration
    itself is used.

    Args:
        config: of any method.
        operator: the calibration.
    """
    objective = getattr(config, "objective", None)
    if isinstance(getattr(objective, "targets", None), CloseTargets) and operator.has("scale"):
        return ("scale",)
    return ()


def aligned_by(config: MethodConfig, **changes: Any) -> MethodConfig:
    """The configuration with another alignment.

    Args:
        config: of any method.
        changes: fields of its ``AlignmentConfig``.

    Raises:
        ConfigError: a field can't be so.
    """
    alignment: AlignmentConfig = dataclasses.replace(config.alignment, **changes)
    return _replaced(config, alignment=alignment)


def _with_targets(config: MethodConfig, objective: Any, targets: Any) -> MethodConfig:
    return _replaced(config, objective=dataclasses.replace(objective, targets=targets))


def _replaced(config: MethodConfig, **changes: Any) -> MethodConfig:
    if isinstance(config, WholeConfig):
        return dataclasses.replace(config, causal=_replaced(config.causal, **changes))
    # Every method's configuration is a dataclass with these fields; the protocol can't say so.
    return cast(MethodConfig, dataclasses.replace(cast(Any, config), **changes))
