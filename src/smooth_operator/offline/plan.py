"""What is to be done to one recording, every name looked up."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any, Final, Literal, TypeAlias, cast

from smooth_operator.hands.catalogue import load_hand
from smooth_operator.hands.hand import Hand
from smooth_operator.human.alignment import calibrate_scale
from smooth_operator.offline.environment import environment
from smooth_operator.retargeters.method import MethodConfig
from smooth_operator.retargeters.presets import PRESETS, method_config
from smooth_operator.types import HandRecording

PROGRAM: Final = "smooth-operator"
"""Value of ``program`` in every configuration that this program writes."""

Scale: TypeAlias = float | Literal["frame", "calibrate"]
"""Robot size over human size: a number, found in every frame, or once for the recording."""


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


def plan(
    recording: HandRecording,
    *,
    hand: str,
    method: str,
    preset: str | None,
    seed: int,
    scale: Scale | None,
    config: MethodConfig | None = None,
) -> Plan:
    """Looks up all names.

    Args:
        recording: the human hand.
        hand: name of a built-in hand.
        method: name of a method.
        preset: name of its preset; None for the default one.
        seed: of the random numbers.
        scale: robot size over human size; None for the configuration's own.
        config: the method's configuration, where it is no preset's as it stands.

    Raises:
        UnknownNameError: there is no such hand, method or preset.
        ConfigError: the scale is not a possible one.
        RecordingError: the scale is to be calibrated on a recording without a usable palm.
    """
    robot = load_hand(hand, recording.side)
    config = method_config(method, preset) if config is None else config
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
