"""Methods and their presets, as Python objects."""

from __future__ import annotations

from typing import Final

from smooth_operator.errors import UnknownNameError
from smooth_operator.retargeters.method import MethodConfig
from smooth_operator.retargeters.sbr import SbrConfig
from smooth_operator.solvers.newton import NewtonConfig
from smooth_operator.solvers.sampling import SamplingConfig

SBR_PAPER: Final = SbrConfig()
"""The paper's table of hyper-parameters, fresh normals in every cycle."""

SBR_REALTIME: Final = SbrConfig(
    sampling=SamplingConfig(samples=256, elites=24, cycles=6, draws="sobol"),
    polish=NewtonConfig(iterations=3),
    settle_rounds=10,
)
"""For an ordinary CPU: few quasi-random base samples find the basin, Newton its floor."""

PRESETS: Final[dict[str, dict[str, MethodConfig]]] = {
    "sbr": {"realtime": SBR_REALTIME, "paper": SBR_PAPER},
}
"""Method name -> preset name -> configuration; the first preset of a method is its default."""


def method_names() -> tuple[str, ...]:
    """Names of the methods."""
    return tuple(PRESETS)


def method_config(method: str = "sbr", preset: str | None = None) -> MethodConfig:
    """Configuration of a method by preset name; None gives the method's default preset.

    Raises:
        UnknownNameError: if there is no such method or preset.
    """
    if method not in PRESETS:
        raise UnknownNameError("method", method, PRESETS)
    presets = PRESETS[method]
    if preset is None:
        return next(iter(presets.values()))
    if preset not in presets:
        raise UnknownNameError(f"preset of method {method!r}:", preset, presets)
    return presets[preset]
