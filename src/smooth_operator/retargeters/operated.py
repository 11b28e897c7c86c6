"""A method's configuration for one calibrated operator."""

from __future__ import annotations

import dataclasses
from typing import Any, cast

from smooth_operator.human.alignment import AlignmentConfig
from smooth_operator.human.operator import OperatorProfile
from smooth_operator.objective.loss import ObjectiveConfig
from smooth_operator.objective.targets import DexPilotTargets
from smooth_operator.retargeters.method import MethodConfig
from smooth_operator.retargeters.whole import WholeConfig


def operated_by(config: MethodConfig, operator: OperatorProfile) -> MethodConfig:
    """The configuration with the operator's corrections, and latches at the operator's distances.

    Once tips are corrected, thumb and finger read nearly nothing in every pinch, so one pair of
    distances serves all fingers. DexPilot's own (30 and 50 mm) allow for an operator that nobody
    measured, and close the neighbours of a pinching finger with it. Targets without latches have
    nothing to set.

    Args:
        config: of any method.
        operator: who is to drive it.
    """
    config = aligned_by(config, operator=operator)
    objective = getattr(config, "objective", None)
    if not (isinstance(objective, ObjectiveConfig) and operator.has("pinch")):
        return config
    targets, project, escape = objective.targets, operator.project, operator.escape
    if not isinstance(targets, DexPilotTargets) or project is None or escape is None:
        return config
    targets = dataclasses.replace(targets, project=project, escape=escape)
    return _replaced(config, objective=dataclasses.replace(objective, targets=targets))


def aligned_by(config: MethodConfig, **changes: Any) -> MethodConfig:
    """The configuration with another alignment.

    Args:
        config: of any method.
        changes: fields of its :class:`~smooth_operator.human.alignment.AlignmentConfig`.

    Raises:
        ConfigError: a field can't be so.
    """
    alignment: AlignmentConfig = dataclasses.replace(config.alignment, **changes)
    return _replaced(config, alignment=alignment)


def _replaced(config: MethodConfig, **changes: Any) -> MethodConfig:
    if isinstance(config, WholeConfig):
        return dataclasses.replace(config, causal=_replaced(config.causal, **changes))
    # Every method's configuration is a dataclass with these fields; the protocol can't say so.
    return cast(MethodConfig, dataclasses.replace(cast(Any, config), **changes))
