"""Retargeting methods of other authors: joint angles, keyvectors, hybrid, DexPilot, AKO and GeoRT.

Importing the package adds their names to ``METHODS``; the core names none of them, and none of
their modules is imported before its method is asked for.
"""

from __future__ import annotations

from typing import Final

from smooth_operator.methods.registry import COLORS, METHODS
from smooth_operator.plugins import Entry

_SLSQP: Final = f"{__name__}.slsqp_presets"

METHODS.built_in |= {
    "joint_angle": Entry(f"{__name__}.joint_angle:JOINT_ANGLE_PRESETS", "default"),
    "keyvector": Entry(
        f"{_SLSQP}:KEYVECTOR_PRESETS", "default, vector, position, slsqp or published"
    ),
    "hybrid": Entry(f"{_SLSQP}:HYBRID_PRESETS", "default, slsqp or published"),
    "dexpilot": Entry(f"{_SLSQP}:DEXPILOT_PRESETS", "default, slsqp or published"),
    "ako": Entry(f"{_SLSQP}:AKO_PRESETS", "default, slsqp or published"),
    "geort": Entry(
        f"{__name__}.geort:GEORT_PRESETS", "default, or the file of a model that you trained"
    ),
}
COLORS.update(
    joint_angle="#8c6d4f",
    keyvector="#e69f00",
    hybrid="#cc79a7",
    dexpilot="#d55e00",
    ako="#56b4e9",
    geort="#009e73",
)
