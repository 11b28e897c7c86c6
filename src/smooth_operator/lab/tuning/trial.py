"""The work of a trial, in a worker: retarget all recordings with some values, and measure."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import jax

from smooth_operator.compilation.start import dispatch_here
from smooth_operator.errors import RecordingError
from smooth_operator.formats.setting_paths import with_settings
from smooth_operator.hands.registry import load_hand
from smooth_operator.lab.benchmark.recordings import Request, load_sources
from smooth_operator.lab.offline import TrajectoryRetargeter
from smooth_operator.lab.tuning.traced import TracedRun, can_trace
from smooth_operator.methods.method import MethodConfig
from smooth_operator.methods.retargeter import Retargeter
from smooth_operator.metrics import evaluate
from smooth_operator.metrics.assemble import assemble_trace
from smooth_operator.types import CommandTrajectory, HandRecording

UNTRACEABLE = (
    jax.errors.ConcretizationTypeError,
    jax.errors.TracerArrayConversionError,
    jax.errors.TracerBoolConversionError,
    jax.errors.TracerIntegerConversionError,
)
"""What JAX raises where a method looks at a value that is traced."""


@dataclass(frozen=True, eq=False)
class TrialTask:
    """Values to be tried.

    Attributes:
        requests: the recordings; a worker reads them once.
        digests: digests of their frames, by which a change of the file is noticed.
        hand: name of the robot hand.
        config: configuration that takes the values.
        values: path of a setting -> value.
        seed: seed of the method's random numbers.
    """

    requests: tuple[Request, ...]
    digests: tuple[str, ...]
    hand: str
    config: MethodConfig
    values: Mapping[str, float | int]
    seed: int


def run_trial(task: TrialTask) -> list[dict[str, Any]]:
    """Metrics, one for each recording; workspace utilisation is left out.

    Raises:
        ConfigError: the values can't be, alone or together.
        RecordingError: a recording has changed since the search began.
    """
    dispatch_here()
    config = with_settings(task.config, task.values)
    results = []
    for recording in _recordings(task.requests, task.digests):
        hand = load_hand(task.hand, recording.side)
        commands = _commands(task, config, recording)
        trace = assemble_trace(recording, commands, hand, config.alignment, reach_samples=0)
        results.append(dict(evaluate(trace)))
    return results


@lru_cache(maxsize=4)
def _recordings(
    requests: tuple[Request, ...], digests: tuple[str, ...]
) -> tuple[HandRecording, ...]:
    sources = load_sources(requests)
    if tuple(source.digest for source in sources) != digests:
        raise RecordingError(
            "a recording has changed since the search began; begin the search again"
        )
    return tuple(source.recording for source in sources if source.recording is not None)


_traced: dict[tuple[Any, ...], TracedRun | None] = {}
"""Programs of this process; None where a method's values can't be traced."""


_whole: dict[tuple[Any, ...], TrajectoryRetargeter] = {}
"""The last one for whole recordings; its costs need no compiling."""


def _commands(task: TrialTask, config: MethodConfig, recording: HandRecording) -> CommandTrajectory:
    if (whole := config.trajectory) is not None:
        cell = (task.hand, recording.side, whole.causal, task.seed)
        if cell not in _whole:
            _whole.clear()
            _whole[cell] = TrajectoryRetargeter(
                load_hand(task.hand, recording.side), whole, task.seed
            )
        return _whole[cell].priced(whole).run(recording)[0]
    key = (task.hand, recording.side, task.config, tuple(task.values), task.seed)
    if key not in _traced:
        base = Retargeter(task.hand, side=recording.side, config=task.config, seed=task.seed)
        _traced[key] = TracedRun(base, tuple(task.values)) if can_trace(base, task.values) else None
    traced = _traced[key]
    if traced is not None:
        try:
            return traced.run(recording, task.values)
        except UNTRACEABLE:
            _traced[key] = None
    return _compiled(task, config, recording)


def _compiled(task: TrialTask, config: MethodConfig, recording: HandRecording) -> CommandTrajectory:
    """Compiled for these values."""
    retargeter = Retargeter(task.hand, side=recording.side, config=config, seed=task.seed)
    if retargeter.method.on_host:
        return retargeter.run(recording)[0]
    return TracedRun(retargeter, ()).run(recording, {})
