"""The experiments by name; each is imported when it is asked for."""

from __future__ import annotations

from importlib import import_module
from typing import Final

from smooth_operator.errors import UnknownNameError
from smooth_operator_research.paper.experiment import Experiment

EXPERIMENTS: Final[dict[str, tuple[str, str]]] = {
    "fk": ("fk", "FkLibraries"),
    "compute": ("compute", "Compute"),
    "solver": ("solver", "SolverSwap"),
    "velocity": ("velocity", "VelocityTerm"),
    "hessian": ("hessian", "HessianDirections"),
    "table": ("table", "BenchmarkTable"),
    "noise": ("sweeps", "TrackerNoise"),
    "rate": ("sweeps", "FrameRate"),
}
"""Name -> module of this package and class in it, in the order of the report. A new experiment is a
file and a line here."""


def experiment(name: str) -> Experiment:
    """An experiment by its name.

    Raises:
        UnknownNameError: there is none of that name.
    """
    if name not in EXPERIMENTS:
        raise UnknownNameError("experiment", name, EXPERIMENTS)
    module, kind = EXPERIMENTS[name]
    result: Experiment = getattr(import_module(f"smooth_operator_research.paper.{module}"), kind)()
    return result
