"""Answers from the first frame on: the first stage until the method's program is there.

The program compiles, or is read, on a thread of its own. Until it is there, frames are answered by
``FirstStage``; their results are ``provisional``. The first frame after that is answered by both:
the method begins with it, from a fresh state, and the difference of the two commands is added to
its commands and taken away again, by at most ``MOST_STEP`` a frame. Then the commands are the
method's own, as if the recording had begun with that frame.

The program compiles in this process, not in a helper (``helper_process``): a helper has to import
everything again, which takes 0.5 s longer, and until the program is there the frames need the
interpreter for a few milliseconds each only.
"""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass, replace
from typing import Any, Final, NamedTuple

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from smooth_operator.compilation.collection import uncollected
from smooth_operator.compilation.first_stage import FirstStage, StageAnswer
from smooth_operator.compilation.kept_program import before_compiling, find_lapack
from smooth_operator.human.alignment import reference_landmarks
from smooth_operator.methods.program import RetargetState
from smooth_operator.methods.retargeter import Retargeter
from smooth_operator.result_cache.code import HOME
from smooth_operator.types import HandFrame, JointCommand, Result, Status

MOST_STEP: Final = 0.02
"""Most that a joint of a command moves in one frame because of the hand-over [rad]."""
_SPEED: Final = 1.0
"""And in a second [rad/s], where frames come more often than 50 times a second."""
_SHORTEST: Final = 1e-3
"""Time between frames that counts as some [s]."""


class EarlyState(NamedTuple):
    """All that is remembered between frames.

    Attributes:
        full: the method's state, fresh until it has answered a frame.
        q: (m,) last good command of the actuated joints [rad]; None before the first.
        offset: (m,) what is added to the method's commands [rad]; None where nothing is, and
            before it has answered.
        begun: whether the method has answered.
        time: stamp of the last good frame [s].
        stamp: of the last frame, where the retargeter counts frames by a rate; else None.
    """

    full: RetargetState
    q: Float[np.ndarray, " m"] | None = None
    offset: Float[np.ndarray, " m"] | None = None
    begun: bool = False
    time: float = 0.0
    stamp: float | None = None

    @property
    def method(self) -> Any:
        """State of the method."""
        return self.full.method


@dataclass(frozen=True, eq=False)
class _Work:
    """What the thread that compiles and those that answer share."""

    known: threading.Event  # whether it has to compile is known
    done: threading.Event
    failed: list[BaseException]


class EarlyAnswers:
    """A retargeter's answers while its program compiles, and after that.

    Where the program was kept, it is read before this returns, and no answer is provisional. The
    methods of plugins are compiled before it returns, too: nothing is known of what their commands
    are.

    Args:
        retargeter: whose answers they are.
    """

    def __init__(self, retargeter: Retargeter) -> None:
        self._full = retargeter
        self._hand = retargeter.hand
        self._actuated = list(self._hand.actuated)
        config = retargeter.config
        self._stage = FirstStage(self._hand, config.alignment, tuple(retargeter.method.needs))
        self._work = work = _Work(threading.Event(), threading.Event(), [])
        if type(config).__module__.partition(".")[0] != HOME.name:
            _compile(retargeter, work)
            self.check()
            return
        # Not a daemon: one that is inside XLA when the interpreter ends can abort the process.
        threading.Thread(target=_compile, args=(retargeter, work), name="compile").start()
        work.known.wait()

    @property
    def ready(self) -> bool:
        """Whether the program is there, or has failed to compile."""
        return self._work.done.is_set()

    @property
    def failed(self) -> bool:
        """Whether the program can't be compiled."""
        return bool(self._work.failed)

    def wait(self, timeout: float | None = None) -> bool:
        """Wait until the program is there; whether it is.

        Raises:
            Exception: what compiling raised.
        """
        done = self._work.done.wait(timeout)
        self.check()
        return done

    def init(self, seed: int | None = None) -> EarlyState:
        """The state before the first frame."""
        return EarlyState(self._full.init(seed))

    def step(self, state: EarlyState, frame: HandFrame | ArrayLike) -> tuple[EarlyState, Result]:
        """One frame; see ``Retargeter.step``.

        Raises:
            Exception: what compiling raised, in the first frame after that.
        """
        ready = self.ready
        if ready:
            self.check()
            if state.begun and state.offset is None:
                full, result = self._full.step(state.full, frame)
                return state._replace(full=full, stamp=full.stamp), result
        start = time.perf_counter()
        frame = self._stamped(state, frame)
        dt = frame.time - state.time
        if state.begun:
            state, result = self._blended(state, frame, dt)
        else:
            state, result = self._staged(state, frame, dt, ready)
        if self._full.rate is not None:
            state = state._replace(stamp=frame.time)
        return state, replace(result, latency_ms=(time.perf_counter() - start) * 1e3)

    def _stamped(self, state: EarlyState, frame: HandFrame | ArrayLike) -> HandFrame:
        """The frame with a stamp, as ``Retargeter.step`` gives it one."""
        full = self._full
        if not isinstance(frame, HandFrame):
            frame = HandFrame(np.asarray(frame), side=self._hand.spec.side)
        if frame.stamp is None:
            if full.rate is None:
                full.step(state.full, frame)  # which refuses it
            last = state.stamp
            frame = replace(frame, stamp=0.0 if last is None else last + 1.0 / (full.rate or 1.0))
        full.check_side(frame.side)
        return frame

    def _staged(
        self, state: EarlyState, frame: HandFrame, dt: float, ready: bool
    ) -> tuple[EarlyState, Result]:
        """A frame before the method has answered one."""
        if ready and state.q is None:  # nothing to go over from
            full, result = self._full.step(state.full, frame)
            if result.status != Status.OK:
                return state, result
            q = result.command.positions[self._actuated]
            return EarlyState(full, q, None, True, frame.time), result
        assert frame.valid is not None  # filled in on construction
        answer = self._stage(frame.landmarks, frame.valid, state.q, dt)
        if answer.q is None:
            return state, self._provisional(state.q, answer, frame.time)
        after = state._replace(q=answer.q, time=frame.time)
        if ready:
            full, result = self._full.step(state.full, frame)
            if result.status == Status.OK:
                offset = answer.q - result.command.positions[self._actuated]
                after = after._replace(full=full, offset=offset, begun=True)
        return after, self._provisional(answer.q, answer, frame.time)

    def _blended(self, state: EarlyState, frame: HandFrame, dt: float) -> tuple[EarlyState, Result]:
        """The method's answer, and what is left of the difference to the first stage's."""
        full, result = self._full.step(state.full, frame)
        if result.status != Status.OK:
            assert state.q is not None  # the method has answered
            return state._replace(full=full), self._with(result, state.q)
        left = _nearer(state.offset, dt)
        q = result.command.positions[self._actuated]
        if left is None:
            return EarlyState(full, q, None, True, frame.time), result
        low, high = self._hand.limits.T
        sent = np.clip(q + left, low, high)
        return EarlyState(full, sent, sent - q, True, frame.time), self._with(result, sent)

    def _provisional(
        self, q: Float[np.ndarray, " m"] | None, answer: StageAnswer, stamp: float
    ) -> Result:
        held = self._hand.neutral if q is None else q
        command = JointCommand(self._hand.full_configuration(held), self._hand.joint_names, stamp)
        return Result(command, answer.status, 0.0, answer.loss, answer.scale, provisional=True)

    def _with(self, result: Result, q: Float[np.ndarray, " m"]) -> Result:
        command = replace(result.command, positions=self._hand.full_configuration(q))
        return replace(result, command=command, provisional=True)

    def check(self) -> None:
        """Raises what compiling raised, if it did."""
        if self._work.failed:
            raise self._work.failed[0]


def _nearer(offset: Float[np.ndarray, " m"] | None, dt: float) -> Float[np.ndarray, " m"] | None:
    """The offset of the next frame; None once there is none."""
    if offset is None:
        return None
    step = min(MOST_STEP, _SPEED * max(dt, _SHORTEST))
    size = float(np.abs(offset).max(initial=0.0))
    return None if size <= step else offset * (1 - step / size)


def _compile(retargeter: Retargeter, work: _Work) -> None:
    reference = HandFrame(reference_landmarks(retargeter.hand), 0.0, retargeter.hand.spec.side)

    def notice(_: bool) -> bool:
        if not work.known.is_set():
            find_lapack()  # while nothing waits for the interpreter but who made this
            work.known.set()
        return False

    try:
        with uncollected(), before_compiling(notice):
            retargeter.step(retargeter.init(), reference)
    except BaseException as error:  # raised again by who asks for an answer
        work.failed.append(error)
    finally:
        work.done.set()
        work.known.set()
