"""The methods by name, built-in and of plugins; nothing here imports JAX.

What a name stands for is a mapping of preset names to configurations, of which the first is the
default, or one configuration, whose preset is called ``default``.
"""

from __future__ import annotations

from typing import Final

from smooth_operator.plugins import Entry, Registry

_HERE: Final = "smooth_operator.methods.presets"

METHODS: Final = Registry(
    "method",
    {
        "sbr": Entry(f"{_HERE}:SBR", "realtime, paper, or offline for recordings"),
        "smooth": Entry(f"{_HERE}:SMOOTH", "teleop, or offline for recordings"),
        "joint_angle": Entry(f"{_HERE}:JOINT_ANGLE_PRESETS", "default"),
        "keyvector": Entry(
            f"{_HERE}:KEYVECTOR_PRESETS", "default, vector, position, slsqp or published"
        ),
        "hybrid": Entry(f"{_HERE}:HYBRID_PRESETS", "default, slsqp or published"),
        "dexpilot": Entry(f"{_HERE}:DEXPILOT_PRESETS", "default, slsqp or published"),
        "ako": Entry(f"{_HERE}:AKO_PRESETS", "default, slsqp or published"),
        "geort": Entry(f"{_HERE}:GEORT", "default, or the file of a model that you trained"),
    },
    needs=("alignment", "build", "trajectory"),
    advice="derive its settings from smooth_operator.methods.MethodConfig",
)
"""Name -> presets. The summaries list the presets, the default one first."""
