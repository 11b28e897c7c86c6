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

_HERE: Final = "smooth_operator.methods.presets"

METHODS: Final = Registry(
    "method",
    {
        "sbr": Entry(f"{_HERE}:SBR", "realtime, paper, or offline for recordings"),
        "smooth": Entry(f"{_HERE}:SMOOTH", "teleop, precise, grasp for objects, or offline"),
    },
)
"""Name -> presets. The summaries list the presets, the default one first. The package
``smooth_operator.baselines`` adds its methods on import, as the root package imports it."""

COLORS: Final = {"sbr": "#0072b2", "smooth": "#7a68c7"}
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
