"""The methods by name, built-in and of plugins; nothing here imports JAX.

What a name stands for is a mapping of preset names to configurations, whose first is the
default, or one configuration, whose preset is called ``default``. A class of configurations
stands for the one that it gives without arguments.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

from smooth_operator.errors import SmoothOperatorError
from smooth_operator.plugins import Entry, Registry

_BASELINES: Final = "smooth_operator.baselines"

METHODS: Final = Registry(
    "method",
    {
        "sbr": Entry(
            "smooth_operator.methods.sbr:SBR", "realtime, paper, or offline for recordings"
        ),
        "smooth": Entry(
            "smooth_operator.methods.smooth:SMOOTH",
            "teleop, precise, grasp for objects, or offline",
        ),
        "joint_angle": Entry(f"{_BASELINES}.joint_angle:JOINT_ANGLE_PRESETS", "default"),
        "keyvector": Entry(
            f"{_BASELINES}.slsqp_method:KEYVECTOR_PRESETS",
            "default, vector, position, slsqp or published",
        ),
        "hybrid": Entry(f"{_BASELINES}.slsqp_method:HYBRID_PRESETS", "default, slsqp or published"),
        "dexpilot": Entry(
            f"{_BASELINES}.slsqp_method:DEXPILOT_PRESETS", "default, slsqp or published"
        ),
        "ako": Entry(f"{_BASELINES}.slsqp_method:AKO_PRESETS", "default, slsqp or published"),
        "geort": Entry(
            f"{_BASELINES}.geort:GEORT_PRESETS", "default, or the file of a model that you trained"
        ),
    },
)
"""Name -> presets. The summaries list the presets, the default one first."""

COLORS: Final = {
    "sbr": "#0072b2",
    "smooth": "#7a68c7",
    "joint_angle": "#8c6d4f",
    "keyvector": "#e69f00",
    "hybrid": "#cc79a7",
    "dexpilot": "#d55e00",
    "ako": "#56b4e9",
    "geort": "#009e73",
}
"""Built-in method -> its colour in every report; most are of Okabe and Ito's safe palette. They go
by name, since the settings of keyvector, hybrid, dexpilot and ako are of one class."""


def as_presets(presets: Any) -> Mapping[str, Any]:
    """Preset name -> configuration, of what the name of a method stands for."""
    presets = presets() if isinstance(presets, type) else presets
    return presets if isinstance(presets, Mapping) else {"default": presets}


def method_color(name: str) -> str | None:
    """The colour of a method in reports, ``#rrggbb``; None if it has none.

    A plugin's method has that of its settings, ``MethodConfig.color``.
    """
    if name not in METHODS.plugins:
        return COLORS.get(name)
    try:
        presets = as_presets(METHODS.load(name))
    except SmoothOperatorError:  # reports go on without it
        return None
    color: str | None = next(iter(presets.values())).color
    return color
