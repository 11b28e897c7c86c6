"""The measures of ``bench --physics`` by name; each is imported when it is asked for."""

from __future__ import annotations

from importlib import import_module
from importlib.util import find_spec
from typing import Final

from smooth_operator.errors import UnknownNameError
from smooth_operator_research.physics.measure import Measure

MEASURES: Final[dict[str, tuple[str, str]]] = {
    "reachable": ("reachable_motion", "ReachableMotion"),
    "demonstrations": ("demonstrations", "Demonstrations"),
    "pinch": ("pinch_hold", "PinchHold"),
    "grasp": ("power_grasp", "PowerGrasp"),
    "operators": ("virtual_operators", "VirtualOperators"),
}
"""Name -> module of this package and class in it, in the order of the report. A new measure is a
file and a line here."""


def measure_names() -> tuple[str, ...]:
    """The measures whose module is there."""
    home = "smooth_operator_research.physics"
    return tuple(n for n, (module, _) in MEASURES.items() if find_spec(f"{home}.{module}"))


def find_measure(name: str) -> Measure:
    """A measure by its name.

    Raises:
        UnknownNameError: there is none of that name.
    """
    if name not in measure_names():
        raise UnknownNameError("measure", name, measure_names())
    module, kind = MEASURES[name]
    made: Measure = getattr(import_module(f"smooth_operator_research.physics.{module}"), kind)()
    return made
