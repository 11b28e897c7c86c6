"""Registry of the methods by name: ``sbr``, ``smooth``, the published methods in
``smooth_operator.baselines``, and those of installed plugins. This module does not import JAX.

A name refers to a mapping of preset names to configurations, of which the first is the default, or
to one configuration, whose preset is called ``default``. A class refers to its default instance.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

from smooth_operator.extras import UPGRADE
from smooth_operator.plugins import Entry, Registry

_PUBLISHED: Final = {
    "joint_angle": "default",
    "keyvector": "published or fast",
    "hybrid": "published or fast",
    "dexpilot": "published or fast",
    "ako": "published or fast",
    "geort": "default, or the file of your trained model",
}
"""Maps the published methods, which this distribution offers as entry points, to summaries."""

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
    elsewhere=dict.fromkeys(
        _PUBLISHED, f"not in your installation, which is older than the code: run {UPGRADE}"
    ),
    summaries=_PUBLISHED,
)
"""Maps names to presets. The summaries list the presets, with the default first."""


def as_presets(presets: Any) -> Mapping[str, Any]:
    """Maps preset names to configurations, for the object that the name of a method refers to."""
    presets = presets() if isinstance(presets, type) else presets
    return presets if isinstance(presets, Mapping) else {"default": presets}


DEFAULT_METHOD: Final = "smooth"
"""Name of the default method; its default preset is the first of ``PRESETS``."""
