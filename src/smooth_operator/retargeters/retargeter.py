"""From a hand frame to a joint command: one compiled program per frame, explicit state."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from pathlib import Path

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from smooth_operator.errors import ConfigError
from smooth_operator.hands.catalogue import load_hand
from smooth_operator.hands.hand import Hand
from smooth_operator.hands.spec import HandSpec
from smooth_operator.human.alignment import reference_landmarks
from smooth_operator.retargeters.default import DEFAULT_METHOD
from smooth_operator.retargeters.method import HostMethod, Method, MethodConfig
from smooth_operator.retargeters.presets import method_config
from smooth_operator.retargeters.program import RetargetState as RetargetState
from smooth_operator.retargeters.program import ticks_of
from smooth_operator.retargeters.shared import shared_program
from smooth_operator.types import (
    CommandTrajectory,
    HandFrame,
    HandRecording,
    JointCommand,
    Result,
    Status,
)

_REFLECTION = np.array([-1, 1, 1], np.float32)


class Retargeter:
    """Retargets frames of a tracked human hand onto one robot hand.

    Use it with explicit state (:meth:`init`, :meth:`step`), or call it and let it keep the state
    (:meth:`__call__`, :meth:`reset`). Either way a frame is one compiled program from landmarks to
    command (up to the solver, for methods whose solver is a library on the host), compiled at the
    first frame or by :meth:`warm_up`.

    A frame that is invalid, not finite or degenerate gives the last good command (before the first
    good frame: the neutral pose) with a status that says why, and leaves the state as it was.

    Args:
        hand: name of a hand, the path of a spec file, a description, or a loaded hand.
        side: side of a hand given by name, ``right`` if left out; a spec file brings its own.
        method: name of the method.
        preset: name of its preset; None for the method's default.
        config: a configuration of your own, instead of method and preset.
        seed: of the method's random numbers.

    Attributes:
        method: the method for this hand.
        shared: the compiled program, and the method that it was made from: that of the mirror image
            for a hand that is described as one.

    Raises:
        UnknownNameError: for an unknown hand, method or preset.
        HandModelError: if the hand's model can't be used.
        ConfigError: if the operator in the configuration was calibrated for another hand.
    """

    def __init__(
        self,
        hand: str | Path | HandSpec | Hand = "mimic_p050",
        *,
        side: str | None = None,
        method: str = DEFAULT_METHOD,
        preset: str | None = None,
        config: MethodConfig | None = None,
        seed: int = 0,
    ) -> None:
        self.hand = hand if isinstance(hand, Hand) else load_hand(hand, side)
        self.config = method_config(method, preset) if config is None else config
        if self.config.alignment.operator is not None:
            self.config.alignment.operator.check(self.hand)
        self.seed = seed
        self.method: Method | HostMethod = self.config.build(self.hand)
        self.shared = shared_program(self.hand, self.config)
        self._state = self.init()

    @property
    def timed(self) -> bool:
        """Whether the method goes by the frames' stamps."""
        return bool(getattr(self.method, "timed", False))

    def init(self, seed: int | None = None) -> RetargetState:
        """The state before the first frame."""
        method = self.method.init(self.seed if seed is None else seed)
        return RetargetState(method, jnp.asarray(self.hand.neutral, jnp.float32))

    def step(
        self, state: RetargetState, frame: HandFrame | ArrayLike
    ) -> tuple[RetargetState, Result]:
        """One frame.

        Args:
            state: from :meth:`init` or the last step; not changed.
            frame: a hand frame, or (21, 3) landmarks [m].

        Returns:
            the next state and the result.

        Raises:
            ConfigError: if the frame is of the other hand's side.
            RecordingError: if landmarks have another shape.
        """
        start = time.perf_counter()
        if not isinstance(frame, HandFrame):
            frame = HandFrame(np.asarray(frame), side=self.hand.spec.side)
        if frame.side != self.hand.spec.side:
            raise ConfigError(
                f"a {frame.side} human hand can't drive the {self.hand.spec.side} hand "
                f"{self.hand.name!r}: load the {frame.side} one, or mirror the landmarks"
            )
        assert frame.valid is not None  # filled in on construction
        ticks = (ticks_of(frame.stamp),) if self.timed else ()
        state, answer = self.shared.run(state, self.seen(frame.landmarks), frame.valid, *ticks)
        q, status = np.asarray(answer.q, float), Status(int(answer.status))
        # float32 may round a limit outwards: the last word is in float64
        q = self.hand.expand(np.clip(q, self.hand.limits[:, 0], self.hand.limits[:, 1]))
        latency_ms = (time.perf_counter() - start) * 1e3
        return state, Result(
            JointCommand(q, self.hand.joint_names, frame.stamp),
            status,
            latency_ms,
            float(answer.tracking_loss),
            float(answer.scale),
        )

    def seen(self, landmarks: Float[np.ndarray, "*batch 21 3"]) -> Float[np.ndarray, "*batch 21 3"]:
        """Landmarks as the program takes them [m]: in its precision, reflected if it is the mirror
        image's."""
        with np.errstate(over="ignore"):  # what overflows is not finite, and has its status
            taken = landmarks.astype(np.float32)
        return taken * _REFLECTION if self.shared.reflects else taken

    def __call__(self, frame: HandFrame | ArrayLike) -> Result:
        """One frame, with the state kept inside; see :meth:`step`."""
        self._state, result = self.step(self._state, frame)
        return result

    def reset(self, seed: int | None = None) -> None:
        """Back to the start: latches, random numbers, last command. Never recompiles."""
        self._state = self.init(seed)

    def warm_up(self) -> float:
        """Compile, without touching the state kept inside.

        Returns:
            seconds it took.
        """
        start = time.perf_counter()
        self.step(self.init(), reference_landmarks(self.hand))
        return time.perf_counter() - start

    def run(
        self,
        recording: HandRecording,
        *,
        seed: int | None = None,
        track: Callable[[Iterable[int]], Iterable[int]] | None = None,
    ) -> tuple[CommandTrajectory, Float[np.ndarray, " T"]]:
        """A whole recording from a fresh state, frame by frame, as a live loop would.

        Args:
            recording: the human hand.
            seed: of the random numbers; None for the retargeter's own.
            track: wraps the iteration over frames, for a progress bar.

        Returns:
            the commands, and the (T,) tracking loss of each frame (NaN where a command was held).
        """
        self.warm_up()
        state = self.init(seed)
        steps = range(len(recording))
        results: list[Result] = []
        for i in steps if track is None else track(steps):
            state, result = self.step(state, recording[i])
            results.append(result)
        trajectory = CommandTrajectory(
            np.stack([r.command.positions for r in results]),
            self.hand.joint_names,
            recording.stamps,
            np.array([r.latency_ms for r in results]),
            np.array([r.status for r in results], np.int8),
        )
        loss = [r.tracking_loss if r.status == Status.OK else np.nan for r in results]
        return trajectory, np.array(loss)
