"""Compiled retargeters of this process, the last used ones: the next recording reuses them."""

from __future__ import annotations

import hashlib
from collections import OrderedDict
from typing import Final

from smooth_operator.formats.jsonable import to_json
from smooth_operator.lab.offline import Runner, build
from smooth_operator.planning import Plan

_KEPT: Final = 16
_built: OrderedDict[str, tuple[Runner, float]] = OrderedDict()


def built_for(todo: Plan) -> tuple[Runner, float]:
    """Builds a hand and a configuration once.

    A retargeter serves many recordings, since its state is not inside it.

    Raises:
        SmoothOperatorError: the method can't serve the hand.
    """
    spec = todo.hand.spec
    words = (to_json(spec), todo.method, str(todo.seed), to_json(todo.config))
    key = hashlib.sha256("\n".join(words).encode()).hexdigest()
    if key not in _built:
        _built[key] = build(todo)
    _built.move_to_end(key)
    while len(_built) > _KEPT:
        _built.popitem(last=False)
    return _built[key]
