"""Commands for recordings of one robot hand, by a retargeter that is built once in a process."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Sequence
from typing import Final, TypeAlias

import numpy as np
from jaxtyping import Float

from smooth_operator.compilation.cache import jax_cache
from smooth_operator.compilation.start import dispatch_here
from smooth_operator.formats.jsonable import to_json
from smooth_operator.lab.offline.execution import Runner, runner
from smooth_operator.planning import Plan
from smooth_operator.types import CommandTrajectory

Answer: TypeAlias = tuple[CommandTrajectory, Float[np.ndarray, " T"]]
"""Commands without latencies, and the (T,) tracking loss of each frame."""

_SHELF: Final[OrderedDict[object, Runner]] = OrderedDict()
"""The retargeters of this process: compiled once, used for every recording that they fit."""

_SHELF_SIZE: Final = 4


def tools_of(todo: Plan) -> object:
    """Key that is equal for all plans that one retargeter can serve."""
    return to_json(todo.hand.spec), to_json(todo.config), todo.seed


def answers(plans: Sequence[Plan], *, keep: bool = True) -> list[Answer]:
    """Answers of the recordings of some plans, side by side (``Retargeter.batch``).

    Programs run on the calling thread, and JAX's compilation cache is switched on.

    Args:
        plans: not empty, all with the same ``tools_of``.
        keep: retargeters that are built and compiled, for the next plans.

    Raises:
        SmoothOperatorError: a recording can't be retargeted.
    """
    dispatch_here()
    with jax_cache():  # the first batch compiles
        retargeter = _runner(plans[0]) if keep else runner(plans[0])
        return retargeter.batch([each.recording for each in plans])


def _runner(todo: Plan) -> Runner:
    key = tools_of(todo)
    if key not in _SHELF:
        _SHELF[key] = runner(todo)
        while len(_SHELF) > _SHELF_SIZE:
            _SHELF.popitem(last=False)
    _SHELF.move_to_end(key)
    return _SHELF[key]
