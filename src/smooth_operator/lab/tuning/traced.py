"""One compiled program for all values of some settings: they go in as arguments, not as constants.

Compiling takes seconds, and a trial would spend them for a second of work. So the configuration is
built within the program, of what the compiler traces. A method whose code looks at a value before
that can't be done so, nor one whose solver runs on the host: those are compiled for each trial.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

import jax
import jax.numpy as jnp
import numpy as np

from smooth_operator.compilation.compiled_program import compiled
from smooth_operator.formats.setting_paths import with_unchecked
from smooth_operator.methods.frame import FrameState
from smooth_operator.methods.method import MethodConfig
from smooth_operator.methods.program import frame_step, ticks_of
from smooth_operator.methods.retargeter import Retargeter
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
            assert not method.on_host  # looked at by can_trace
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
    return fractions and not retargeter.method.on_host
