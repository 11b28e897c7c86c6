"""Registry of the built-in and plugin methods by name. This module does not import JAX.

A name refers to a mapping of preset names to configurations, of which the first is the default, or
to one configuration, whose preset is called ``default``. A class refers to its default instance.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

from smooth_operator.plugins import Entry, Registry

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
    },
)
"""Maps names to presets. The summaries list the presets, with the default first."""


def as_presets(presets: Any) -> Mapping[str, Any]:
    """Maps preset names to configurations, for the object that the name of a method refers to."""
    presets = presets() if isinstance(presets, type) else presets
    return presets if isinstance(presets, Mapping) else {"default": presets}


DEFAULT_METHOD: Final = "smooth"
"""Name of the default method; its default preset is the first of ``PRESETS``."""
