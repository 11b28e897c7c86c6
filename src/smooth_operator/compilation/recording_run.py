"""A recording, frame by frame, as a live loop would have it."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np
from jaxtyping import Float

from smooth_operator.methods.retargeter import Retargeter
from smooth_operator.types import CommandTrajectory, HandRecording, Result, Status


def run_recording(
    retargeter: Retargeter,
    recording: HandRecording,
    seed: int | None,
    track: Callable[[Iterable[int]], Iterable[int]] | None,
) -> tuple[CommandTrajectory, Float[np.ndarray, " T"]]:
    """What ``Retargeter.run`` does, and says."""
    retargeter.warm_up()
    state = retargeter.init(seed)
    steps = range(len(recording))
    results: list[Result] = []
    for i in steps if track is None else track(steps):
        state, result = retargeter.step(state, recording[i])
        results.append(result)
    trajectory = CommandTrajectory(
        np.stack([r.command.positions for r in results]),
        retargeter.hand.joint_names,
        recording.stamps,
        np.array([r.latency_ms for r in results]),
        np.array([r.status for r in results], np.int8),
    )
    loss = [r.tracking_loss if r.status == Status.OK else np.nan for r in results]
    return trajectory, np.array(loss)
