"""Retargeter: converts hand frames to joint commands, with explicit state.

Retargeters of the same configuration share a program if they have the same hand. A mirrored hand
uses the program of the original with reflected landmarks.
"""

from __future__ import annotations

import threading
import time
from collections import OrderedDict
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from smooth_operator.errors import ConfigError, HandModelError, RecordingError
from smooth_operator.hands.hand import Hand, fingerprint, load_hand_spec
from smooth_operator.hands.registry import load_hand
from smooth_operator.hands.spec import HandSpec
from smooth_operator.io.anatomy import HandCheck
from smooth_operator.landmarks import NUM_LANDMARKS
from smooth_operator.retargeting.compiled_program import ProgramCache
from smooth_operator.retargeting.flat_hand import flat_hand
from smooth_operator.retargeting.known_gaps import NO_GAPS
from smooth_operator.retargeting.method import Method, MethodConfig
from smooth_operator.retargeting.presets import default_preset, preset_config
from smooth_operator.retargeting.program import (
    FrameState,
    Program,
    RetargetState,
    frame_program,
    tick_after,
)
from smooth_operator.retargeting.registry import DEFAULT_METHOD
from smooth_operator.settings import check_frame_rate
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

    Use it with explicit state (``init``, ``step``), or call it and let it keep the state
    (``__call__``, ``reset``). One compiled program maps landmarks to the command (or to the input
    of a solver on the host). It is compiled at the first frame or by ``warm_up``.

    A frame without a timestamp gets the time of the call or, with a ``rate``, one period after the
    previous frame. A frame that is invalid, not finite, degenerate or not a hand in metres gives
    the last good command (at first the neutral pose) with a status, and keeps the state.

    Args:
        hand: name of a hand, the path of a spec file, a description, or a loaded hand.
        side: side of a hand that is given by name. Default: ``right``.
        method: name of the method.
        preset: name of the preset; None for the method's default.
        config: a configuration of your own, instead of method and preset.
        seed: seed of the method's random numbers.
        rate: frame rate [Hz] of frames without timestamps, which then count from 0; None uses the
            time of the call.
        clock: monotonic clock [s], for the time of the call.
        cache: keeps traced programs, so that later processes start faster:
            ``smooth_operator.retargeting.ProgramStore``. None keeps nothing.
        pinch_gaps: known gaps that the tracker leaves between thumb and finger when they touch, by
            finger [palm lengths], such as ``smooth_operator.retargeting.known_gaps.MEDIAPIPE``; the
            estimate starts with them. None closes no gaps.

    Attributes:
        shared: the compiled program with its method; for a mirrored hand, those of the original.
        method: that method.

    Raises:
        UnknownNameError: for an unknown hand, method or preset.
        HandModelError: if the hand's model can't be used.
        ConfigError: if the rate is outside 1 to 2000 Hz, or a pinch gap outside 0 to 1 palm length.
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
        rate: float | None = None,
        clock: Callable[[], float] = time.perf_counter,
        cache: ProgramCache | None = None,
        pinch_gaps: Mapping[str, float] | None = NO_GAPS,
    ) -> None:
        self.hand = hand if isinstance(hand, Hand) else load_hand(hand, side)
        if config is None:
            self.config: MethodConfig = preset_config(method, preset)
            self._named = f"method={method!r}, preset={preset or default_preset(method)!r}"
        else:
            self.config = config
            self._named = f"config={type(config).__name__}(...)"
        check_frame_rate(rate)
        self.seed, self.rate, self.cache = seed, rate, cache
        self.known_gaps = pinch_gaps
        self._clock = clock
        self._stamped: bool | None = None
        self._input = HandCheck(self.hand.spec.side)
        self.shared = shared_program(self.hand, self.config, cache)
        self.method: Method = self.shared.method
        self._state = self.init()

    @property
    def notes(self) -> tuple[str, ...]:
        """Human-readable notes on this method with this hand; empty for most hands."""
        return self.config.notes(self.hand)

    @property
    def compiled(self) -> bool:
        """True if this process has computed a command with this hand and these settings: the next
        frame needs no compilation."""
        return self.shared.compiled.is_set()

    def __repr__(self) -> str:
        """Hand, side, method and preset; for given settings, their class instead."""
        kind, side = type(self).__name__, self.hand.spec.side
        return f"{kind}({self.hand.name!r}, side={side!r}, {self._named})"

    def init(self, seed: int | None = None, before: RetargetState | None = None) -> RetargetState:
        """Returns the state before the first frame.

        Args:
            seed: seed of the random numbers; None for the retargeter's own.
            before: earlier state of the operator, whose pinch gap estimate is continued.
        """
        method = self.method.init(self.seed if seed is None else seed)
        if before is None:
            method = self.method.with_pinch_gaps(method, self.known_gaps)
        else:
            method = self.method.continued(method, before.method)
        state = FrameState(method, self.hand.neutral.astype(np.float32))
        return RetargetState.of(state)

    def step(
        self, state: RetargetState, frame: HandFrame | ArrayLike
    ) -> tuple[RetargetState, Result]:
        """Retargets one frame.

        Args:
            state: from ``init`` or the last step; not changed.
            frame: a hand frame, or (21, 3) landmarks [m] if the retargeter has a rate.

        Returns:
            the next state and the result.

        Raises:
            ConfigError: if the frame is of the other side, or has no timestamp and there is no
                rate.
            RecordingError: if the landmarks have the wrong shape.
        """
        start = time.perf_counter()
        frame = self._framed(frame)
        stamp = self._stamp_of(state, frame)
        self.check_side(frame.side)
        assert frame.valid is not None  # filled in on construction
        landmarks = self.program_landmarks(frame.landmarks)
        ticks = tick_after(state.answered, stamp)
        after, output = self.shared.run(state, landmarks, frame.valid, np.uint32(ticks))
        q, status = np.asarray(output.q, float), Status(int(output.status))
        state = replace(
            after,
            stamp=None if self.rate is None else stamp,
            answered=(stamp, ticks) if status == Status.OK else state.answered,
        )
        if status == Status.OK:
            self.shared.compiled.set()
        # float32 may round a limit outwards, so the final limit is applied in float64
        q = self.hand.full_configuration(np.clip(q, self.hand.limits[:, 0], self.hand.limits[:, 1]))
        latency_ms = (time.perf_counter() - start) * 1e3
        return state, Result(
            JointCommand(q, self.hand.joint_names, stamp),
            status,
            latency_ms,
            float(output.tracking_loss),
            float(output.scale),
        )

    def fingertip_targets(
        self, state: RetargetState | None = None
    ) -> Float[np.ndarray, "F 3"] | None:
        """(F, 3) fingertip targets of the last frame in the palm frame [m], thumb first, of a state
        or of the internal one; None before the first frame or without fingertip targets."""
        state = self._state if state is None else state
        targets = self.method.fingertip_targets(state.method)
        if targets is None:
            return None
        return np.asarray(targets, float) * (_REFLECTION if self.shared.reflects else 1.0)

    def pinch_gaps(self, state: RetargetState | None = None) -> dict[str, float]:
        """Estimated gaps that the tracker reports between a touching thumb and finger, by finger
        [palm lengths], of a state or of the internal one; unknown gaps are left out."""
        state = self._state if state is None else state
        gaps = self.method.pinch_gaps(state.method)
        found = () if gaps is None else np.asarray(gaps, float).tolist()
        return {name: gap for name, gap in zip(self.hand.fingers[1:], found, strict=False) if gap}

    def check_side(self, side: str) -> None:
        """Raises ConfigError unless a human hand of this side can drive the robot hand."""
        if side != self.hand.spec.side:
            raise ConfigError(
                f"a {side} human hand can't drive the {self.hand.spec.side} hand "
                f"{self.hand.name!r}: load the {side} robot hand, or mirror the landmarks"
            )

    def program_landmarks(
        self, landmarks: Float[np.ndarray, "*batch 21 3"]
    ) -> Float[np.ndarray, "*batch 21 3"]:
        """Converts landmarks [m] to the program's precision, and reflects them if necessary."""
        with np.errstate(over="ignore"):  # overflows are not finite, which has its own status
            points = landmarks.astype(np.float32, copy=False)
        return points * _REFLECTION if self.shared.reflects else points

    def __call__(self, frame: HandFrame | ArrayLike) -> Result:
        """Retargets one frame with the internal state; see ``step``.

        A frame without a timestamp gets the current time, unless there is a rate.

        Raises:
            ConfigError: as ``step``, or frames with and without timestamps are mixed.
            RecordingError: as ``step``, or the first 30 frames are of the other hand, in another
                order or not of the shape of a hand. Later, such frames have the status
                ``IMPLAUSIBLE_HAND``.
        """
        frame = self._framed(frame)
        stamped = frame.stamp is not None
        if self._stamped not in (None, stamped):
            raise ConfigError(
                "frames with and without timestamps are mixed, so the time between them is "
                "unknown; use timestamps for all frames or for none, or call reset() in "
                "between"
            )
        if not stamped and self.rate is None:
            frame = replace(frame, stamp=self._clock())
        doubtful = self._check_input(frame)
        if doubtful:
            frame = replace(frame, valid=np.zeros(NUM_LANDMARKS, bool))
        self._state, result = self.step(self._state, frame)
        self._stamped = stamped
        return replace(result, status=Status.IMPLAUSIBLE_HAND) if doubtful else result

    def _check_input(self, frame: HandFrame) -> bool:
        """True if the last frames show another hand, which is an error in the first frames."""
        assert frame.valid is not None  # filled in on construction
        check = self._input
        doubtful = check.see(frame.landmarks, frame.valid, self._stamp_of(self._state, frame))
        sure = doubtful is not None and (doubtful.side is None or check.surely_other)
        if doubtful is not None and sure and check.judged <= HandCheck.WINDOW:
            self._input = HandCheck(self.hand.spec.side)
            raise RecordingError(f"the last frames: {doubtful.what}; {doubtful.in_python}")
        return doubtful is not None

    def _framed(self, frame: HandFrame | ArrayLike) -> HandFrame:
        if isinstance(frame, HandFrame):
            return frame
        return HandFrame(np.asarray(frame), side=self.hand.spec.side)

    def _stamp_of(self, state: RetargetState, frame: HandFrame) -> float:
        """Time of a frame [s]: its timestamp, or one period after the last frame."""
        if frame.stamp is not None:
            return frame.stamp
        if self.rate is None:
            raise ConfigError(
                "the frame has no timestamp, and step() has no clock: set the time of the "
                "measurement, HandFrame(landmarks, stamp=seconds), or the frame rate, "
                "Retargeter(..., rate=30)"
            )
        return 0.0 if state.stamp is None else state.stamp + 1.0 / self.rate

    def reset(self, seed: int | None = None) -> None:
        """Resets the internal state (latches, random numbers, last command) without recompiling."""
        self._state = self.init(seed)
        self._stamped = None
        self._input = HandCheck(self.hand.spec.side)

    def warm_up(self) -> float:
        """Compiles the program by retargeting two frames of a flat human hand. The internal state
        does not change.

        Returns:
            elapsed time [s].

        Raises:
            HandModelError: no command was found for these frames.
        """
        start = time.perf_counter()
        side, state = self.hand.spec.side, self.init()
        landmarks = flat_hand(side)
        for stamp in (0.0, 0.01):  # the second frame has a state that the program returned
            state, result = self.step(state, HandFrame(landmarks, stamp, side))
            if result.status != Status.OK:
                raise HandModelError(
                    f"{self!r} finds no command for a flat human hand "
                    f"({result.status.name}): run `smooth-operator hands check` on the hand, "
                    "or choose another method"
                )
        return time.perf_counter() - start

    def run(
        self,
        recording: HandRecording,
        *,
        seed: int | None = None,
        track: Callable[[Iterable[int]], Iterable[int]] | None = None,
    ) -> tuple[CommandTrajectory, Float[np.ndarray, " T"]]:
        """Retargets a whole recording from a fresh state, frame by frame, as a live loop would.

        Args:
            seed: seed of the random numbers; None for the retargeter's own.
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
        commands = CommandTrajectory(
            np.stack([r.command.joint_positions for r in results]),
            self.hand.joint_names,
            recording.stamps,
            np.array([r.latency_ms for r in results]),
            np.array([r.status for r in results], np.int8),
        )
        loss = [r.tracking_loss if r.status == Status.OK else np.nan for r in results]
        return commands, np.array(loss)


MOST_PROGRAMS: Final = 16
_programs: OrderedDict[tuple[str, MethodConfig], SharedProgram] = OrderedDict()
_lock = threading.Lock()


class SharedProgram(NamedTuple):
    """A compiled program and the method that it computes.

    Attributes:
        method: the method that it was made from.
        run: the program of one frame.
        reflects: True if the program is that of the hand's mirror image.
        compiled: set after the first frame with the status OK.
        lanes: programs of ``BatchRetargeter``, by their numbers of lanes and of threads.
    """

    method: Method
    run: Program
    reflects: bool
    compiled: threading.Event
    lanes: dict[tuple[int, int], Any]


def shared_program(
    hand: Hand, config: MethodConfig, cache: ProgramCache | None = None
) -> SharedProgram:
    """Returns the program of one frame for a hand; a mirrored hand uses that of the original hand.
    Raises SmoothOperatorError if the method can't be used with the hand."""
    if not config.shareable:
        return _built(hand, config, False, cache)
    reflects = hand.spec.mirror
    served = load_hand_spec(hand.spec.mirrored) if reflects else hand
    key = (fingerprint(served), config)  # a program is the same with and without a cache
    try:
        with _lock:
            stored = _programs.get(key)
    except TypeError:  # a user's configuration may have no hash
        return _built(served, config, reflects, cache)
    program = (stored or _built(served, config, reflects, cache))._replace(reflects=reflects)
    with _lock:
        _programs[key] = program
        _programs.move_to_end(key)
        while len(_programs) > MOST_PROGRAMS:
            _programs.popitem(last=False)
    return program


def _built(
    hand: Hand, config: MethodConfig, reflects: bool, cache: ProgramCache | None
) -> SharedProgram:
    method = config.build(hand)
    program = frame_program(method, config, cache)
    return SharedProgram(method, program, reflects, threading.Event(), {})
