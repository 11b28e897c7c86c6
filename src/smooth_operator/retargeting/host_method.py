"""Methods whose solver is a library on the host."""

from __future__ import annotations

from abc import abstractmethod
from typing import Any

import numpy as np
from jaxtyping import Array, Float, UInt32

from smooth_operator.retargeting.alignment import (
    AlignmentConfig,
)
from smooth_operator.retargeting.method import Compiling, Method, MethodOutput
from smooth_operator.retargeting.program import (
    FrameResult,
    FrameState,
    Program,
    RetargetState,
    align_frame,
    packed_result,
)
from smooth_operator.types import Status


class HostMethod(Method):
    """Base class of methods whose solver is a library on the host. The program is compiled up to
    the solver and continues in plain Python."""

    on_host = True

    @abstractmethod
    def prepare(self, state: Any, aligned: Float[Array, "21 3"], ticks: UInt32[Array, ""]) -> Any:
        """Returns the problem of one frame as a pytree, from the arguments of ``step``."""

    @abstractmethod
    def solve(self, state: Any, problem: Any) -> tuple[Any, MethodOutput]:
        """Solves a problem of ``prepare``, with NumPy arrays and without side effects."""

    def step(
        self, state: Any, aligned: Float[Array, "21 3"], ticks: UInt32[Array, ""]
    ) -> tuple[Any, MethodOutput]:
        """Processes one frame on the host; not traceable."""
        return self.solve(state, self.prepare(state, aligned, ticks))

    def compile_with(self, compiling: Compiling) -> None:
        """Receives the compiler for the functions that ``solve`` calls, before the first frame."""
        del compiling

    def program(self, alignment: AlignmentConfig, compiling: Compiling) -> Program:
        """The program of one frame, compiled up to the method's solver."""

        def prepare(state: Any, landmarks: Array, valid: Array, ticks: Array) -> tuple[Any, Array]:
            frame = align_frame(self, alignment, landmarks, valid)
            return self.prepare(state, frame.aligned, ticks), packed_result(
                frame.status, frame.scale
            )

        before = compiling(prepare, "frame")
        self.compile_with(compiling)

        def run(
            state: RetargetState, landmarks: np.ndarray, valid: np.ndarray, ticks: np.uint32
        ) -> tuple[RetargetState, FrameResult]:
            problem, flat = before(state.method, landmarks, valid, ticks)
            code, scale = np.asarray(flat).tolist()
            if code != Status.OK:
                return state, FrameResult(state.q, int(code), np.nan, scale)
            after, output = self.solve(state.method, problem)
            loss = float(output.tracking_loss)
            if not np.isfinite(output.q).all():
                return state, FrameResult(state.q, Status.SOLVER_FAILED, loss, scale)
            state = RetargetState.of(FrameState(after, np.asarray(output.q)), joined=False)
            return state, FrameResult(output.q, int(code), loss, scale)

        return run
