"""Registry of the built-in and plugin methods by name. This module does not import JAX.

A name refers to a mapping of preset names to configurations, of which the first is the default, or
to one configuration, whose preset is called ``default``. A class refers to its default instance.
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
"""Maps names to presets. The summaries list the presets, with the default first."""


def as_presets(presets: Any) -> Mapping[str, Any]:
    """Maps preset names to configurations, for the object that the name of a method refers to."""
    presets = presets() if isinstance(presets, type) else presets
    return presets if isinstance(presets, Mapping) else {"default": presets}


DEFAULT_METHOD: Final = "smooth"
"""Name of the default method; its default preset is the first of ``PRESETS``."""
