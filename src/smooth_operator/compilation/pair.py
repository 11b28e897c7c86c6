"""Frames of both hands in one program, where the hands share a program for one frame."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from smooth_operator.compilation.kept_program import KeptProgram
from smooth_operator.compilation.lanes import over_lanes
from smooth_operator.human.alignment import reference_landmarks
from smooth_operator.methods.program import (
    RetargetState,
    packed_step,
    tick_of,
    unpacked,
)
from smooth_operator.methods.retargeter import Retargeter
from smooth_operator.types import HandFrame, Result


def shares_program(first: Retargeter, second: Retargeter) -> bool:
    """Whether frames of two retargeters can be answered by one program: they are of one method with
    equal settings, for hands that are mirror images, and no solver runs on the host."""
    return first.shared.run is second.shared.run and first.method.host is None


class PairProgram:
    """The program of two frames that come together; the states are those of single frames.

    Commands are those of the single program but for rounding, since a matrix product of two hands
    adds in another order than two products.

    Args:
        retargeters: one for each hand, that ``shares_program`` says can be together.
    """

    def __init__(self, retargeters: Sequence[Retargeter]) -> None:
        first = retargeters[0]
        method, config = first.shared.method, first.config
        step = packed_step(method, config.alignment)

        def both(
            states: tuple[RetargetState, ...], landmarks: Any, valid: Any, ticks: Any
        ) -> tuple[tuple[RetargetState, ...], tuple[Any]]:
            one = (states[0], landmarks[0], valid[0], ticks[0])
            example = jax.tree.map(lambda x: jnp.zeros(jnp.shape(x), jnp.result_type(x)), one)
            stacked = jax.tree.map(lambda *leaves: jnp.stack(leaves), *states)
            everyone = jnp.ones(len(states), bool)
            after, (flat,) = over_lanes(step, *example)(everyone, stacked, landmarks, valid, ticks)
            apart = tuple(jax.tree.map(lambda x, i=i: x[i], after) for i in range(len(states)))
            return apart, (flat,)

        of: Any = {"constants": method.constants, "kept": first.cache}
        self._run = KeptProgram(both, method.hand, config, "pair", **of)
        self._retargeters = tuple(retargeters)

    def fits(self, retargeters: Sequence[Retargeter]) -> bool:
        """Whether it is the program of these retargeters."""
        return len(retargeters) == len(self._retargeters) and all(
            a.shared.run is b.shared.run and a.shared.reflects is b.shared.reflects
            for a, b in zip(retargeters, self._retargeters, strict=True)
        )

    def step(
        self, states: Sequence[RetargetState], frames: Sequence[HandFrame]
    ) -> list[tuple[RetargetState, Result]]:
        """What ``Retargeter.step`` gives of each state and frame; the frames have stamps."""
        start = time.perf_counter()
        pairs = list(zip(self._retargeters, frames, strict=True))
        landmarks = np.stack([made.program_landmarks(frame.landmarks) for made, frame in pairs])
        valid = np.stack([np.asarray(frame.valid) for frame in frames])
        ticks = np.array([tick_of(frame.time) for frame in frames])
        after, (flat,) = self._run(tuple(states), landmarks, valid, ticks)
        numbers = np.asarray(flat)
        return [
            (state, made.result(unpacked(row), frame.time, start))
            for state, row, (made, frame) in zip(after, numbers, pairs, strict=True)
        ]

    def warm_up(self) -> None:
        """Compile."""
        frames = [
            HandFrame(reference_landmarks(made.hand), 0.0, made.hand.spec.side)
            for made in self._retargeters
        ]
        self.step([made.init() for made in self._retargeters], frames)
