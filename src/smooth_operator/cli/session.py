"""Retargeting one recording and measuring it: what ``demo`` and ``retarget`` share."""

from __future__ import annotations

import dataclasses
import time
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
from jaxtyping import Float

from smooth_operator.cli.cache import enable_cache, healing
from smooth_operator.cli.console import Progressing
from smooth_operator.cli.environment import environment
from smooth_operator.cli.options import Scale
from smooth_operator.cli.outputs import PROGRAM
from smooth_operator.hands.catalogue import load_hand
from smooth_operator.hands.hand import Hand
from smooth_operator.human.alignment import calibrate_scale
from smooth_operator.metrics import Definition, Trace, evaluate
from smooth_operator.metrics.assemble import assemble_trace
from smooth_operator.retargeters.method import MethodConfig
from smooth_operator.retargeters.presets import PRESETS, method_config
from smooth_operator.retargeters.retargeter import Retargeter
from smooth_operator.types import CommandTrajectory, HandRecording


@dataclass(frozen=True, eq=False)
class Plan:
    """What is to be done, every name looked up.

    Attributes:
        recording: the human hand.
        hand: the robot hand.
        method: name of the method.
        preset: name of its preset.
        config: its configuration, the scale filled in.
        seed: of the random numbers.
    """

    recording: HandRecording
    hand: Hand
    method: str
    preset: str
    config: MethodConfig
    seed: int


@dataclass(frozen=True, eq=False)
class Outcome:
    """What came of a plan.

    Attributes:
        commands: the joint commands.
        tracking_loss: (T,) of each frame, NaN where a command was held.
        first_command_s: from the start of the plan's execution until the first command could be
            given [s]: building and compiling.
    """

    commands: CommandTrajectory
    tracking_loss: Float[np.ndarray, " T"]
    first_command_s: float


def plan(
    recording: HandRecording,
    *,
    hand: str,
    method: str,
    preset: str | None,
    seed: int,
    scale: Scale | None,
) -> Plan:
    """Looks up all names.

    Raises:
        UnknownNameError: there is no such hand, method or preset.
        ConfigError: the scale is not a possible one.
        RecordingError: the scale is to be calibrated on a recording without a usable palm.
    """
    robot = load_hand(hand, recording.side)
    config = method_config(method, preset)
    if scale is not None:
        fixed: float | None
        if scale == "calibrate":
            fixed = calibrate_scale(recording, robot)
        else:
            fixed = None if scale == "frame" else float(scale)
        alignment = dataclasses.replace(config.alignment, scale=fixed)
        # Every method's configuration is a dataclass with this field; the protocol can't say so.
        config = cast(MethodConfig, dataclasses.replace(cast(Any, config), alignment=alignment))
    return Plan(recording, robot, method, preset or next(iter(PRESETS[method])), config, seed)


def execute(todo: Plan, progress: Progressing) -> Outcome:
    """Retargets, with a progress bar."""
    started = time.perf_counter()
    cache = enable_cache()
    with (
        progress.waiting(f"compiling {todo.method} for {todo.hand.name} (slow the first time)"),
        healing(cache),
    ):
        retargeter = Retargeter(todo.hand, config=todo.config, seed=todo.seed)
        retargeter.warm_up()
    first_command_s = time.perf_counter() - started
    track = progress.frames("retargeting")
    commands, loss = retargeter.run(todo.recording, track=track)
    return Outcome(commands, loss, first_command_s)


def measure(
    todo: Plan, outcome: Outcome, definition: Definition, progress: Progressing
) -> tuple[Trace, dict[str, Any]]:
    """The trace and its metrics, with those that only the run itself knows."""
    with progress.waiting("measuring"):
        trace = assemble_trace(todo.recording, outcome.commands, todo.hand, todo.config.alignment)
        loss = outcome.tracking_loss[np.isfinite(outcome.tracking_loss)]
        extra = {
            "tracking_loss": float(loss.mean()) if len(loss) else None,
            "first_command_s": outcome.first_command_s,
        }
        return trace, dict(evaluate(trace, definition, extra))


def configuration(command: str, todo: Plan, **more: Any) -> dict[str, Any]:
    """The resolved configuration, to be written beside a result.

    Args:
        command: which command made it.
        todo: its plan.
        more: what only that command knows.
    """
    recording = todo.recording
    return {
        "program": PROGRAM,
        "command": command,
        "hand": todo.hand.name,
        "side": todo.hand.spec.side,
        "method": todo.method,
        "preset": todo.preset,
        "seed": todo.seed,
        "config": todo.config,
        "recording": {
            "name": recording.name,
            "side": recording.side,
            "frames": len(recording),
            "rate_hz": recording.rate_hz,
            "duration_s": recording.duration,
        },
        **more,
        **environment(),
    }
