"""The column ``observation.environment_state``, for which LeRobot's robots have no place.

LeRobot collects all numbers that a robot observes in ``observation.state``, by its function
``hw_to_dataset_features``. For a robot with an environment state, another one replaces it in this
process, which gives the keys of the environment their own column; ``lerobot-record`` and
``lerobot-rollout`` then fill it.
"""

from __future__ import annotations

import contextlib
import functools
import importlib
import sys
from collections.abc import Callable
from typing import Any, Final

PREFIX: Final = "environment."
"""Prefix of the keys of the environment state."""

KINDS: Final = ("none", "joints", "object")
"""Values of the setting ``environment_state``."""

_FUNCTION: Final = "hw_to_dataset_features"
_HOMES: Final = ("lerobot.utils.feature_utils", "lerobot.datasets.utils")  # 0.6; 0.4.4
_STATE, _ENVIRONMENT = "observation.state", "observation.environment_state"

Features = dict[str, dict[str, Any]]


def separate_environment_state() -> None:
    """Make LeRobot write the keys that begin with ``PREFIX`` as a column; again changes nothing.

    Raises:
        ValueError: this release of LeRobot has no such function.
    """
    for name in _HOMES:
        with contextlib.suppress(ModuleNotFoundError):
            importlib.import_module(name)
    modules = [
        module
        for name, module in list(sys.modules.items())
        if name.startswith("lerobot.") and callable(vars(module).get(_FUNCTION))
    ]
    if not modules:
        raise ValueError(
            f"environment_state: this release of LeRobot has no {_FUNCTION}; expected 0.4.4 to "
            "0.6, or leave out --robot.environment_state"
        )
    for module in modules:
        original = vars(module)[_FUNCTION]
        if not hasattr(original, "__wrapped__"):
            setattr(module, _FUNCTION, _separated(original))


def _separated(original: Callable[..., Features]) -> Callable[..., Features]:
    @functools.wraps(original)
    def features(*arguments: Any, **options: Any) -> Features:
        columns = original(*arguments, **options)
        state = columns.pop(_STATE, None)
        if state is None:
            return columns
        for column, own in ((_STATE, False), (_ENVIRONMENT, True)):
            names = [name for name in state["names"] if name.startswith(PREFIX) is own]
            if names:
                columns[column] = {**state, "shape": (len(names),), "names": names}
        return columns

    return features
