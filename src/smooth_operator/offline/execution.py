"""Executes and measures the plan for one recording."""

from __future__ import annotations

import time
from collections import OrderedDict
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, TypeAlias

import numpy as np
from jaxtyping import Float

from smooth_operator.errors import ConfigError
from smooth_operator.formats.checks import frame_slice, stamps_from_rate
from smooth_operator.hands.hand import Hand
from smooth_operator.hands.registry import default_side
from smooth_operator.io.jsonable import to_json
from smooth_operator.metrics import Trace, evaluate
from smooth_operator.metrics.assemble import assemble_trace
from smooth_operator.metrics.table import Definition
from smooth_operator.offline.trajectory_retargeter import TrajectoryRetargeter, check_method
from smooth_operator.planning import Plan, RetargetRequest
from smooth_operator.retargeting.retargeter import Retargeter
from smooth_operator.retargeting.start import build_retargeter as build_retargeter
from smooth_operator.retargeting.trajectory import TrajectoryMethodConfig
from smooth_operator.types import CommandTrajectory

Runner: TypeAlias = Retargeter | TrajectoryRetargeter
"""What answers a recording: frame by frame, or as a whole."""


@dataclass(frozen=True, eq=False)
class Outcome:
    """Result of a plan.

    Attributes:
        commands: the joint commands.
        tracking_loss: (T,) of each frame, NaN where a command was held.
        first_command_s: from the start of the plan's execution until the first command could be
            given [s]: building and compiling.
    """

    commands: CommandTrajectory
    tracking_loss: Float[np.ndarray, " T"]
    first_command_s: float


def runner(todo: Plan) -> Runner:
    """A retargeter for the plan, nothing compiled yet; for presets that need it one of whole
    recordings."""
    if isinstance(todo.config, TrajectoryMethodConfig):
        return TrajectoryRetargeter(todo.hand, todo.config, todo.seed, todo.pinch_gaps)
    gaps = todo.pinch_gaps
    return Retargeter(todo.hand, config=todo.config, seed=todo.seed, pinch_gaps=gaps)


def build(todo: Plan) -> tuple[Runner, float]:
    """A retargeter for the plan, compiled; for presets that need it one of whole recordings.

    Returns:
        the retargeter, and how long it took until it could give its first command [s].
    """
    if not isinstance(todo.config, TrajectoryMethodConfig):
        return build_retargeter(todo.hand, todo.config, todo.seed, todo.pinch_gaps)
    started = time.perf_counter()
    whole = runner(todo)
    whole.warm_up()
    return whole, time.perf_counter() - started


def execute(
    todo: Plan,
    built: tuple[Runner, float] | None = None,
    track: Callable[[Iterable[int]], Iterable[int]] | None = None,
) -> Outcome:
    """Retargets the recording from a fresh state.

    Args:
        built: result of ``build`` for it, or for another plan of the same hand,
            configuration and seed; None to build now.
        track: wraps the iteration over frames, for a progress bar.
    """
    retargeter, first_command_s = build(todo) if built is None else built
    commands, loss = retargeter.run(todo.recording, track=track)
    return Outcome(commands, loss, first_command_s)


def measure(
    todo: Plan, outcome: Outcome, definition: Definition = "sound"
) -> tuple[Trace, dict[str, Any]]:
    """The trace and its metrics, with those that only the run itself knows."""
    trace = assemble_trace(todo.recording, outcome.commands, todo.hand, todo.config.alignment)
    loss = outcome.tracking_loss[np.isfinite(outcome.tracking_loss)]
    extra = {
        "tracking_loss": float(loss.mean()) if len(loss) else None,
        "first_command_s": outcome.first_command_s,
    }
    return trace, dict(evaluate(trace, definition, extra))


def checked(request: RetargetRequest) -> RetargetRequest:
    """A request whose every part is possible, so that it does not fail once per recording.

    Raises:
        UnknownNameError: there is no such hand or finger.
        SmoothOperatorError: the method can't serve the hand.
        ConfigError: scale, rate, frames or operator can't be.
    """
    hand = _hand(request)
    if request.operator is not None:
        request.operator.check(hand.spec.side)
    config = request.config
    check_method(config, hand)
    if isinstance(request.scale, float | int):
        replace(config.alignment, scale=float(request.scale))  # refuses a bad scale
    stamps_from_rate(0, request.rate, "--rate")  # refuses a bad rate
    if request.frames is not None:
        try:
            frame_slice(request.frames, None)
        except ConfigError as error:
            raise ConfigError(
                f"frames must be a range A:B with something in it, such as ':500', '2600:3100' or "
                f"'-500:', not {request.frames!r}"
            ) from error
    return request


def request_notes(request: RetargetRequest) -> tuple[str, ...]:
    """Notes for a person on what the method of a checked request lacks on its hand."""
    return request.config.notes(_hand(request))


def _hand(request: RetargetRequest) -> Hand:
    """The robot hand of a request, of the side that it names, or its operator is of."""
    operator = request.operator
    side = request.side or (default_side(request.hand) if operator is None else operator.side)
    return request.load_hand(side)


Answer: TypeAlias = tuple[CommandTrajectory, Float[np.ndarray, " T"]]
"""Commands without latencies, and the (T,) tracking loss of each frame."""

_SHELF: Final[OrderedDict[object, Any]] = OrderedDict()
"""The retargeters of this process: compiled once, used for every recording that they fit."""

_SHELF_SIZE: Final = 16


def tools_of(todo: Plan) -> object:
    """Key that is equal for all plans that one retargeter can serve."""
    # The class counts too: configurations of two methods may have the same settings.
    config = to_json(todo.config)
    return to_json(todo.hand.spec), type(todo.config), config, todo.seed, to_json(todo.pinch_gaps)


def answers(plans: Sequence[Plan], *, keep: bool = True) -> list[Answer]:
    """Answers of the recordings of some plans, side by side (``Retargeter.batch``).

    Args:
        plans: not empty, all with the same ``tools_of``.
        keep: retargeters that are built and compiled, for the next plans.

    Raises:
        SmoothOperatorError: a recording can't be retargeted.
    """
    retargeter: Runner = _shelved(runner, plans[0]) if keep else runner(plans[0])
    return retargeter.batch([each.recording for each in plans])


def built_for(todo: Plan) -> tuple[Runner, float]:
    """Result of ``build``, kept for the next plan of the same hand, configuration and seed.

    Raises:
        SmoothOperatorError: the method can't serve the hand.
    """
    result: tuple[Runner, float] = _shelved(build, todo)
    return result


def _shelved(make: Callable[[Plan], Any], todo: Plan) -> Any:
    key = (make, tools_of(todo))
    if key not in _SHELF:
        _SHELF[key] = make(todo)
        while len(_SHELF) > _SHELF_SIZE:
            _SHELF.popitem(last=False)
    _SHELF.move_to_end(key)
    return _SHELF[key]
