"""Retargets a recording as a plan says, and measures the result. Nothing here prints."""

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
from smooth_operator.planning import Plan, RetargetRequest
from smooth_operator.retargeting.batching import BatchRetargeter
from smooth_operator.retargeting.program_store import ProgramStore
from smooth_operator.retargeting.trajectory import TrajectoryMethodConfig
from smooth_operator.retargeting.trajectory_retargeter import TrajectoryRetargeter, check_method
from smooth_operator.types import CommandTrajectory
from smooth_operator.wrist_following import WristSolver

Runner: TypeAlias = BatchRetargeter | TrajectoryRetargeter
"""A retargeter for recordings: frame by frame, or as a whole."""


@dataclass(frozen=True, eq=False)
class Outcome:
    """Result of executing a plan.

    Attributes:
        commands: the joint commands.
        tracking_loss: (T,) of each frame, NaN where a command was held.
        first_command_s: time to build and compile the retargeter [s].
    """

    commands: CommandTrajectory
    tracking_loss: Float[np.ndarray, " T"]
    first_command_s: float


def runner(todo: Plan) -> Runner:
    """Returns a retargeter for a plan. It is compiled when it gets its first frame."""
    gaps, store = todo.pinch_gaps, ProgramStore.of_user()
    if isinstance(todo.config, TrajectoryMethodConfig):
        return TrajectoryRetargeter(todo.hand, todo.config, todo.seed, gaps, store)
    return BatchRetargeter(
        todo.hand, config=todo.config, seed=todo.seed, pinch_gaps=gaps, cache=store
    )


def build(todo: Plan) -> tuple[Runner, float]:
    """Returns a compiled retargeter for a plan, and the time that building and compiling took
    [s]."""
    started = time.perf_counter()
    built = runner(todo)
    built.warm_up()
    return built, time.perf_counter() - started


def execute(
    todo: Plan,
    built: tuple[Runner, float] | None = None,
    track: Callable[[Iterable[int]], Iterable[int]] | None = None,
) -> Outcome:
    """Retargets the recording of a plan, starting from a fresh state.

    Args:
        built: result of ``build`` for this plan, or for another plan of the same hand,
            configuration and seed; None to build now.
        track: wraps the iteration over frames, for a progress bar.
    """
    retargeter, first_command_s = build(todo) if built is None else built
    commands, loss = retargeter.run(todo.recording, track=track)
    return Outcome(commands, loss, first_command_s)


def measure(
    todo: Plan, outcome: Outcome, definition: Definition = "sound"
) -> tuple[Trace, dict[str, Any]]:
    """Returns the trace of a run and its metrics, including the tracking loss and the time to the
    first command."""
    trace = assemble_trace(todo.recording, outcome.commands, todo.hand, todo.config.alignment)
    loss = outcome.tracking_loss[np.isfinite(outcome.tracking_loss)]
    extra = {
        "tracking_loss": float(loss.mean()) if len(loss) else None,
        "first_command_s": outcome.first_command_s,
    }
    return trace, dict(evaluate(trace, definition, extra))


def checked(request: RetargetRequest) -> RetargetRequest:
    """Checks all parts of a request and returns it, so that a mistake does not fail once for each
    recording.

    Raises:
        UnknownNameError: there is no such hand or finger.
        HandModelError: the wrist joints of the hand can't be commanded.
        SmoothOperatorError: the method can't be used with the hand.
        ConfigError: scale, rate, frames or operator are not valid.
    """
    hand = _hand(request)
    if request.operator is not None:
        request.operator.check(hand.spec.side)
    config = request.config
    check_method(config, hand)
    if hand.spec.wrist_joints and request.wrist_joints:
        WristSolver(hand)
    else:  # results of a hand without wrist joints do not depend on the choice
        request = replace(request, wrist_joints=False)
    if isinstance(request.scale, float | int):
        replace(config.alignment, scale=float(request.scale))  # refuses a bad scale
    stamps_from_rate(0, request.rate, "--rate")  # refuses a bad rate
    if request.frames is not None:
        try:
            frame_slice(request.frames, None)
        except ConfigError as error:
            raise ConfigError(
                f"frames must be a range A:B that is not empty, such as ':500', '2600:3100' or "
                f"'-500:', not {request.frames!r}"
            ) from error
    return request


def request_notes(request: RetargetRequest) -> tuple[str, ...]:
    """Human-readable notes on what the method lacks for the hand of a checked request."""
    return request.config.notes(_hand(request))


def _hand(request: RetargetRequest) -> Hand:
    """Loads the hand of a request, on the side of the request or else of the operator."""
    operator = request.operator
    side = request.side or (default_side(request.hand) if operator is None else operator.side)
    return request.load_hand(side)


Answer: TypeAlias = tuple[CommandTrajectory, Float[np.ndarray, " T"]]
"""Commands without latencies, and the (T,) tracking loss of each frame."""

_SHELF: Final[OrderedDict[object, Any]] = OrderedDict()
"""Retargeters of this process. Each is compiled once and used for every recording that it fits."""

_SHELF_SIZE: Final = 16


def tools_of(todo: Plan) -> object:
    """Returns a key that is equal for all plans that one retargeter can execute."""
    # The class counts too: configurations of two methods may have the same settings.
    config = to_json(todo.config)
    return to_json(todo.hand.spec), type(todo.config), config, todo.seed, to_json(todo.pinch_gaps)


def answers(plans: Sequence[Plan], *, keep: bool = True) -> list[Answer]:
    """Retargets the recordings of several plans in parallel (``BatchRetargeter.batch``).

    Args:
        plans: at least one plan; all have the same ``tools_of``.
        keep: True to keep the compiled retargeter for the next plans.

    Raises:
        SmoothOperatorError: a recording can't be retargeted.
    """
    retargeter: Runner = _shelved(runner, plans[0]) if keep else runner(plans[0])
    return retargeter.batch([each.recording for each in plans])


def built_for(todo: Plan) -> tuple[Runner, float]:
    """Result of ``build``, kept for the next plan with the same hand, configuration and seed.
    Raises SmoothOperatorError if the method can't be used with the hand."""
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
