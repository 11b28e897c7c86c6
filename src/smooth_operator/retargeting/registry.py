"""The methods by name, built-in and of plugins; nothing here imports JAX.

What a name stands for is a mapping of preset names to configurations, whose first is the
default, or one configuration, whose preset is called ``default``. A class of configurations
stands for the one that it gives without arguments.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

from smooth_operator.plugins import Entry, Registry

_BASELINES: Final = "smooth_operator.baselines"

METHODS: Final = Registry(
    "method",
    {
        "sbr": Entry(
            "smooth_operator.retargeting.sbr.method:SBR",
            "realtime, paper, or offline for recordings",
        ),
        "smooth": Entry(
            "smooth_operator.retargeting.smooth:SMOOTH",
            "teleop, precise, or offline for recordings",
        ),
        "joint_angle": Entry(f"{_BASELINES}.joint_angle:JOINT_ANGLE_PRESETS", "default"),
        "keyvector": Entry(f"{_BASELINES}.slsqp_method:KEYVECTOR_PRESETS", "published or fast"),
        "hybrid": Entry(f"{_BASELINES}.slsqp_method:HYBRID_PRESETS", "published or fast"),
        "dexpilot": Entry(f"{_BASELINES}.slsqp_method:DEXPILOT_PRESETS", "published or fast"),
        "ako": Entry(f"{_BASELINES}.slsqp_method:AKO_PRESETS", "published or fast"),
        "geort": Entry(
            f"{_BASELINES}.geort.method:GEORT_PRESETS",
            "default, or the file of your trained model",
        ),
    },
)
"""Name -> presets. The summaries list the presets, the default one first."""


def as_presets(presets: Any) -> Mapping[str, Any]:
    """Preset name -> configuration, of what the name of a method stands for."""
    presets = presets() if isinstance(presets, type) else presets
    return presets if isinstance(presets, Mapping) else {"default": presets}


DEFAULT_METHOD: Final = "smooth"
"""With its default preset, the first of ``PRESETS``."""
