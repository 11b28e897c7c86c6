"""Commands for recordings of one robot hand, by a retargeter that is built once in a process."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Final, TypeAlias

import numpy as np
from jaxtyping import Float

from smooth_operator.io.jsonable import to_json
from smooth_operator.lab.offline.execution import Runner, build
from smooth_operator.planning import Plan
from smooth_operator.types import CommandTrajectory

Answer: TypeAlias = tuple[CommandTrajectory, Float[np.ndarray, " T"]]
"""Commands without latencies, and the (T,) tracking loss of each frame."""

_SHELF: Final[OrderedDict[tuple[str, str, int], Runner]] = OrderedDict()
_SHELF_SIZE: Final = 4


def answers(plans: Sequence[Plan], *, keep: bool = True) -> list[Answer]:
    """Answers of the recordings of some plans for the same hand, configuration and seed.

    Recordings are retargeted side by side where the method can (``Retargeter.batch``).

    Args:
        plans: not empty.
        keep: what is built, for the next recordings of this hand.

    Raises:
        SmoothOperatorError: a recording can't be retargeted.
    """
    retargeter: Any = _runner(plans[0]) if keep else build(plans[0])[0]
    recordings = [each.recording for each in plans]
    if hasattr(retargeter, "batch"):
        found: list[Answer] = retargeter.batch(recordings)
        return found
    singles = [retargeter.run(recording) for recording in recordings]
    return [(replace(c, latency_ms=np.full(len(c), np.nan)), loss) for c, loss in singles]


def _runner(todo: Plan) -> Runner:
    key = (to_json(todo.hand.spec), to_json(todo.config), todo.seed)
    if key not in _SHELF:
        _SHELF[key] = build(todo)[0]
        while len(_SHELF) > _SHELF_SIZE:
            _SHELF.popitem(last=False)
    _SHELF.move_to_end(key)
    return _SHELF[key]
