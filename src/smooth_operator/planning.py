"""From what a user asks for to a plan: names looked up, scale and operator put in their place."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Literal, TypeAlias

from smooth_operator.calibration.operator_file import read_operator
from smooth_operator.errors import ConfigError, RecordingError
from smooth_operator.formats.environment import environment
from smooth_operator.formats.readers import read_recording
from smooth_operator.hands.hand import Hand
from smooth_operator.hands.registry import default_side, load_hand
from smooth_operator.hands.spec import HandSpec, parse_fingers
from smooth_operator.hands.spec_file import read_hand_spec
from smooth_operator.human.alignment import calibrate_scale
from smooth_operator.human.operator import OperatorProfile
from smooth_operator.methods.default import DEFAULT_METHOD
from smooth_operator.methods.method import MethodConfig
from smooth_operator.methods.presets import default_preset, method_config
from smooth_operator.types import HandRecording, Side

PROGRAM: Final = "smooth-operator"
"""Value of ``program`` in every configuration that this program writes."""

Scale: TypeAlias = float | Literal["frame", "calibrate"]
"""Robot size over human size: a number, found in every frame, or once for the recording."""


@dataclass(frozen=True)
class RetargetRequest:
    """What is to be done to a recording, or to each of many; see ``make_request``.

    Attributes:
        hand: name of the robot hand, or its description.
        method: name of the method.
        preset: name of its preset.
        config: its configuration; that of the preset, so that workers need not know the name.
        seed: of the random numbers; each recording starts from it.
        scale: robot size over human size; None for the configuration's own.
        side: which hand; None for what each recording says.
        rate: frames a second of recordings without stamps [Hz].
        layout: order of the landmarks in plain arrays; None for the project's own.
        frames: only these of each recording, as text.
        fingers: robot finger -> human finger that drives it; None for all, each by its own.
        operator: the calibrated operator; None for none.
    """

    hand: str | HandSpec
    method: str
    preset: str
    config: MethodConfig
    seed: int = 0
    scale: Scale | None = None
    side: Side | None = None
    rate: float | None = None
    layout: str | None = None
    frames: str | None = None
    fingers: Mapping[str, str] | None = None
    operator: OperatorProfile | None = None

    @property
    def hand_name(self) -> str:
        """Name of the robot hand."""
        return self.hand.name if isinstance(self.hand, HandSpec) else self.hand

    def read_recording(self, path: Path, rate: float | None) -> HandRecording:
        """A recording of the side that is asked for.

        Where none is asked for, it is what the recording says; one that says nothing is taken for a
        right hand, or for a left one if the robot hand is a left one only.

        Args:
            path: file of the recording.
            rate: frames a second [Hz], for one without stamps.

        Raises:
            RecordingError: it can't be read, or is of the other side by its shape.
        """
        if self.side is None and default_side(self.hand) == "left":
            with suppress(RecordingError):  # it is a right hand, by what it says or by its shape
                return read_recording(path, rate=rate, side="left", layout=self.layout)
        return read_recording(path, rate=rate, side=self.side, layout=self.layout)

    def load_hand(self, side: Side) -> Hand:
        """The robot hand of one side, with the fingers that are asked for.

        Raises:
            UnknownNameError: there is no such hand, or it has no such finger.
            HandModelError: the hand's files can't be used, or the fingers can't be chosen so.
        """
        hand = self.hand
        if isinstance(hand, HandSpec) and hand.side != side:
            hand = hand.mirrored
        return load_hand(hand, side, fingers=self.fingers)


def make_request(
    *,
    hand: str | Path | HandSpec = "mimic_p050",
    method: str = DEFAULT_METHOD,
    preset: str | None = None,
    seed: int = 0,
    scale: Scale | None = None,
    side: Side | None = None,
    rate: float | None = None,
    layout: str | None = None,
    frames: str | None = None,
    fingers: str | None = None,
    operator: Path | None = None,
) -> RetargetRequest:
    """A request from what a user says: names looked up, texts read, the operator's file too.

    Raises:
        UnknownNameError: there is no such method or preset.
        HandModelError: the choice of fingers is none.
        ConfigError: the operator's file can't be used.
    """
    return RetargetRequest(
        read_hand_spec(hand) if isinstance(hand, Path) else hand,
        method,
        default_preset(method) if preset is None else preset,
        method_config(method, preset),
        seed,
        scale,
        side,
        rate,
        layout,
        frames,
        None if fingers is None else parse_fingers(fingers),
        None if operator is None else read_operator(operator),
    )


@dataclass(frozen=True, eq=False)
class Plan:
    """What is to be done, every name looked up.

    Attributes:
        recording: the human hand.
        hand: the robot hand.
        method: name of the method.
        preset: name of its preset.
        config: its configuration, scale and operator filled in.
        seed: of the random numbers.
        fingers: robot finger -> human finger that drives it, as asked for; None for all. The hand
            has them already; this is for the configuration of the result.
    """

    recording: HandRecording
    hand: Hand
    method: str
    preset: str
    config: MethodConfig
    seed: int
    fingers: Mapping[str, str] | None = None


def plan(recording: HandRecording, request: RetargetRequest) -> Plan:
    """Looks up the hand for the recording's side, and puts scale and operator in their place.

    Args:
        recording: the human hand, of the side, rate and frames that are asked for.
        request: what is to be done.

    Raises:
        UnknownNameError: there is no such hand, or it has no such finger.
        HandModelError: the fingers can't be chosen so.
        ConfigError: the scale is not a possible one, or the operator was calibrated for another
            hand.
        RecordingError: the scale is to be calibrated on a recording without a usable palm.
    """
    robot, config = resolve(request, recording.side, recording)
    return Plan(
        recording, robot, request.method, request.preset, config, request.seed, request.fingers
    )


def resolve(
    request: RetargetRequest, side: Side, recording: HandRecording | None = None
) -> tuple[Hand, MethodConfig]:
    """The hand and the configuration that are asked for, scale and operator in their place.

    Args:
        request: what is to be done.
        side: which hand.
        recording: what a scale may be calibrated on; None where there is none, as in live use.

    Raises:
        UnknownNameError, HandModelError, ConfigError, RecordingError: as ``plan``.
    """
    robot = request.load_hand(side)
    return robot, resolve_config(request, robot, recording)


def resolve_config(
    request: RetargetRequest, robot: Hand, recording: HandRecording | None = None
) -> MethodConfig:
    """The configuration that is asked for, scale and operator in their place, of a loaded hand.

    Raises:
        ConfigError, RecordingError: as ``plan``.
    """
    config = request.config
    if request.operator is not None:
        request.operator.check(robot)
        config = config.with_operator(request.operator)
    if request.scale is not None:
        fixed: float | None
        if request.scale == "calibrate":
            if recording is None:
                raise ConfigError(
                    "there is no recording to calibrate the scale on; run `smooth-operator "
                    "calibrate` and give its file with --operator, or give --scale a number"
                )
            fixed = calibrate_scale(recording, robot)
        else:
            fixed = None if request.scale == "frame" else float(request.scale)
        operator = config.alignment.operator
        # What the user says of the scale goes before what the calibration found.
        operator = None if operator is None else operator.without("scale")
        config = config.with_alignment(scale=fixed, operator=operator)
    return config


def configuration(command: str, todo: Plan, **more: Any) -> dict[str, Any]:
    """The resolved configuration, to be written with a result.

    Args:
        command: which command made it.
        todo: its plan; the operator is in the configuration's alignment.
        more: what only that command knows.
    """
    recording = todo.recording
    return {
        "program": PROGRAM,
        "command": command,
        "hand": todo.hand.name,
        "side": todo.hand.spec.side,
        "fingers": todo.fingers,
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


def live_configuration(
    command: str, request: RetargetRequest, configs: Mapping[Side, MethodConfig], **more: Any
) -> dict[str, Any]:
    """The same of a run without a recording.

    Args:
        command: which command made it.
        request: what was asked for.
        configs: side -> configuration of the method, as ``resolve`` gave it.
        more: what only that command knows.
    """
    return {
        "program": PROGRAM,
        "command": command,
        "hand": request.hand_name,
        "fingers": request.fingers,
        "method": request.method,
        "preset": request.preset,
        "seed": request.seed,
        "config": dict(configs),
        **more,
        **environment(),
    }
