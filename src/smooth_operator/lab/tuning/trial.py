"""The work of a trial, in a worker: retarget all recordings with some values, and measure.

One compiled program serves all values of some settings: they go in as arguments, not as constants.
Compiling takes seconds, and a trial would spend them for a second of work. So the configuration is
built within the program, of what the compiler traces. A method whose code looks at a value before
that can't be done so, nor one whose solver runs on the host: those are compiled for each trial."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Final

import jax
import jax.numpy as jnp
import numpy as np

from smooth_operator.compilation.compiled_program import compiled
from smooth_operator.compilation.start import dispatch_here
from smooth_operator.errors import RecordingError
from smooth_operator.formats.setting_paths import with_settings, with_unchecked
from smooth_operator.hands.registry import load_hand
from smooth_operator.lab.benchmark.recordings import Request, load_sources
from smooth_operator.lab.offline import TrajectoryRetargeter
from smooth_operator.methods.method import MethodConfig
from smooth_operator.methods.program import FrameState, frame_step, ticks_of
from smooth_operator.methods.retargeter import Retargeter
from smooth_operator.metrics import evaluate
from smooth_operator.metrics.assemble import assemble_trace
from smooth_operator.types import CommandTrajectory, HandRecording

CHUNK: Final = 256
"""Frames in a call."""


class TracedRun:
    """A method over recordings, for any values of some of its settings.

    Args:
        retargeter: retargeter of the configuration that the others are made from.
        paths: paths of the settings.
    """

    def __init__(self, retargeter: Retargeter, paths: Sequence[str]) -> None:
        self._retargeter, self._paths = retargeter, tuple(paths)
        config, served = retargeter.config, retargeter.shared.method.hand

        def chunk(values: jax.Array, state: FrameState, *frames: Any) -> Any:
            traced: MethodConfig = with_unchecked(
                config, {path: values[i] for i, path in enumerate(self._paths)}
            )
            method = traced.build(served)
            assert method.host is None  # looked at by can_trace
            step = frame_step(method, traced.alignment)
            return jax.lax.scan(lambda carry, frame: step(carry, *frame), state, frames)

        self._chunk = compiled(chunk)

    def run(self, recording: HandRecording, values: Mapping[str, float | int]) -> CommandTrajectory:
        """The commands for a recording; latencies are NaN.

        Raises:
            TypeError, ValueError: the method looks at a value while it is compiled.
        """
        retargeter, hand = self._retargeter, self._retargeter.hand
        assert recording.valid is not None  # filled in on construction
        frames = [
            retargeter.program_landmarks(recording.landmarks),
            recording.valid,
            ticks_of(recording.stamps),
        ]
        # What is too much is invalid, so that every call is of one shape.
        count, lacking = len(recording), -len(recording) % CHUNK
        frames = [np.concatenate([each, np.repeat(each[-1:], lacking, 0)]) for each in frames]
        frames[1][count:] = False
        parameters = jnp.asarray([values[path] for path in self._paths], jnp.float32)
        state, poses, status = retargeter.init().trees, [], []
        for start in range(0, count, CHUNK):
            part = slice(start, start + CHUNK)
            state, answer = self._chunk(parameters, state, *(each[part] for each in frames))
            poses.append(np.asarray(answer.q, float))
            status.append(np.asarray(answer.status))
        q = np.clip(np.concatenate(poses)[:count], hand.limits[:, 0], hand.limits[:, 1])
        return CommandTrajectory(
            hand.full_configuration(q),
            hand.joint_names,
            recording.stamps,
            np.full(count, np.nan),
            np.concatenate(status)[:count].astype(np.int8),
        )


def can_trace(retargeter: Retargeter, values: Mapping[str, float | int]) -> bool:
    """True if tracing may work: fractions only, and a method that is one program."""
    fractions = all(isinstance(value, float) for value in values.values())
    return fractions and retargeter.method.host is None


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
    if retargeter.method.host is not None:
        return retargeter.run(recording)[0]
    return TracedRun(retargeter, ()).run(recording, {})
