"""A user's requests, and the plans made from them: resolves names, scale and pinch gaps."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any, Final

from smooth_operator.calibration.operator_file import OperatorProfile, read_operator
from smooth_operator.errors import ConfigError, RecordingError
from smooth_operator.formats.commands import config_path, read_commands
from smooth_operator.formats.environment import environment
from smooth_operator.formats.readers import read_recording
from smooth_operator.formats.registry import with_assumed_side
from smooth_operator.hands.hand import Hand
from smooth_operator.hands.registry import default_side, load_hand
from smooth_operator.hands.spec import HandSpec
from smooth_operator.hands.spec_file import read_hand_spec
from smooth_operator.hands.wrist_joints import with_wrist_joints
from smooth_operator.io.documents import read_json
from smooth_operator.request import PinchGapChoice, Scale, parse_fingers
from smooth_operator.result_cache import content_digest
from smooth_operator.retargeting.aligned_recording import calibrate_scale
from smooth_operator.retargeting.known_gaps import MEDIAPIPE, NO_GAPS
from smooth_operator.retargeting.method import MethodConfig
from smooth_operator.retargeting.preset_files import method_config
from smooth_operator.retargeting.presets import default_preset
from smooth_operator.retargeting.registry import DEFAULT_METHOD
from smooth_operator.types import HandRecording, Side

PROGRAM: Final = "smooth-operator"
"""Value of ``program`` in every configuration that this program writes."""

_MOST_BYTES: Final = 64_000_000  # of a configuration that lists thousands of recordings

CODE_OF_COMMANDS: Final = (
    *("geometry.py", "landmarks.py", "planning.py", "execution.py", "poses.py", "types.py"),
    "wrist_following.py",
    *("hands", "retargeting", "baselines"),
    *("io", "formats", "episode_files", "headsets", "teleop/recording"),
)
"""Files and folders of this package that commands depend on."""


@dataclass(frozen=True, kw_only=True, eq=False)
class MethodChoice:
    """A method with its settings, and the fingers that it drives.

    Attributes:
        method: name of the method.
        preset: name of its preset.
        config: configuration of the preset, so that workers do not need its name.
        seed: seed of the random numbers of each recording.
        fingers: maps robot fingers to the human fingers that drive them; None drives each finger by
            the human finger of its name.
    """

    method: str
    preset: str
    config: MethodConfig
    seed: int = 0
    fingers: Mapping[str, str] | None = None


@dataclass(frozen=True, kw_only=True)
class RetargetRequest(MethodChoice):
    """Request to retarget one or several recordings; see ``make_request``.

    Attributes:
        hand: name of the robot hand, or its description.
        scale: robot size over human size; None for the scale of the configuration.
        side: side of the hand; None for the side of each recording.
        rate: frame rate of recordings without timestamps [Hz].
        layout: order of the landmarks in plain arrays; None for the order of ``LANDMARKS``.
        frames: range of frames of each recording, as text; None for all frames.
        operator: known properties of the operator, or None.
        pinch_gaps: see ``PinchGapChoice``.
        wrist_joints: True to command the wrist joints of the hand, if it has any.
    """

    hand: str | HandSpec
    scale: Scale | None = None
    side: Side | None = None
    rate: float | None = None
    layout: str | None = None
    frames: str | None = None
    operator: OperatorProfile | None = None
    pinch_gaps: PinchGapChoice = "tracker"
    wrist_joints: bool = False

    def known_gaps(self, tracker: Mapping[str, float] = NO_GAPS) -> Mapping[str, float] | None:
        """Returns the pinch gaps that a retargeter should assume: those of the operator or, if
        unknown, those of the tracker.

        Args:
            tracker: known gaps of a live source's tracker [palm lengths].
        """
        if self.pinch_gaps == "off":
            return None
        own = NO_GAPS if self.operator is None else self.operator.pinch_gaps
        return {**(MEDIAPIPE if self.pinch_gaps == "mediapipe" else tracker), **own}

    def of(self, side: Side) -> RetargetRequest:
        """Returns the request for one side, without the operator profile if that belongs to the
        other hand."""
        if self.operator is None or self.operator.side == side:
            return self
        return replace(self, operator=None)

    @property
    def hand_name(self) -> str:
        """Name of the robot hand."""
        return self.hand.name if isinstance(self.hand, HandSpec) else self.hand

    def read_recording(self, path: Path, rate: float | None) -> HandRecording:
        """Reads a recording of the requested side.

        Without a requested side, it is the side of the recording. A recording without a side counts
        as a right hand, or as a left hand if the robot hand has only a left side.

        Args:
            path: file of the recording.
            rate: frame rate of a recording without timestamps [Hz].

        Raises:
            RecordingError: the file can't be read, or shows the other hand.
        """
        return with_assumed_side(
            lambda side: read_recording(path, rate=rate, side=side, layout=self.layout),
            self.side,
            default_side(self.hand),
        )

    def load_hand(self, side: Side) -> Hand:
        """Loads the robot hand of one side, with the requested fingers.

        Raises:
            UnknownNameError: there is no such hand, or it has no such finger.
            HandModelError: the hand's files or the choice of fingers can't be used.
        """
        hand = self.hand
        if isinstance(hand, HandSpec) and hand.side != side:
            hand = hand.mirrored
        return load_hand(hand, side, fingers=self.fingers)

    def commanded(self, hand: Hand) -> Hand:
        """Returns a loaded hand with the joints that are commanded, including wrist joints if
        requested. Raises HandModelError if its wrist joints can't be commanded."""
        return with_wrist_joints(hand) if self.wrist_joints else hand


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
    operator: OperatorProfile | Path | None = None,
    pinch_gaps: PinchGapChoice = "tracker",
    wrist_joints: bool = False,
) -> RetargetRequest:
    """Makes a request from a user's settings: resolves names, parses texts, reads files.

    Raises:
        UnknownNameError: there is no such method or preset.
        HandModelError: the choice of fingers is not valid.
        ConfigError: the operator's file can't be used.
    """
    return RetargetRequest(
        hand=read_hand_spec(hand) if isinstance(hand, Path) else hand,
        method=method,
        preset=default_preset(method) if preset is None else preset,
        config=method_config(method, preset),
        seed=seed,
        scale=scale,
        side=side,
        rate=rate,
        layout=layout,
        frames=frames,
        fingers=None if fingers is None else parse_fingers(fingers),
        operator=read_operator(operator) if isinstance(operator, Path) else operator,
        pinch_gaps=pinch_gaps,
        wrist_joints=wrist_joints,
    )


def content_of(spec: HandSpec) -> tuple[HandSpec, str]:
    """Returns the description of a hand and the digest of its model, without the model's folder."""
    return replace(spec, model=Path(spec.model.name)), content_digest(spec.model)


@dataclass(frozen=True, kw_only=True, eq=False)
class Plan(MethodChoice):
    """A request for one recording, with all names resolved and the scale set in its configuration.

    Attributes:
        recording: the human hand.
        hand: the robot hand, with the requested fingers.
        pinch_gaps: known gaps, as for ``Retargeter``.
    """

    recording: HandRecording
    hand: Hand
    pinch_gaps: Mapping[str, float] | None = field(default_factory=dict)


def plan(recording: HandRecording, request: RetargetRequest) -> Plan:
    """Plans a request for a recording: loads the hand of its side, resolves scale and operator.

    Args:
        recording: the human hand, with the requested side, rate and frames.

    Raises:
        UnknownNameError: there is no such hand, or it has no such finger.
        HandModelError: the choice of fingers is not valid.
        ConfigError: the scale is not valid, or the operator's file is of the other side.
        RecordingError: the scale can't be calibrated, because no frame has a usable palm.
    """
    robot, config = resolve(request, recording.side, recording)
    choice = {each.name: getattr(request, each.name) for each in fields(MethodChoice)}
    choice |= {"config": config, "pinch_gaps": request.known_gaps()}
    return Plan(recording=recording, hand=robot, **choice)


def resolve(
    request: RetargetRequest, side: Side, recording: HandRecording | None = None
) -> tuple[Hand, MethodConfig]:
    """Returns the requested hand, and its configuration with the scale set.

    Args:
        recording: recording for the calibration of a scale; None in live use.

    Raises:
        UnknownNameError, HandModelError, ConfigError, RecordingError: as ``plan``.
    """
    robot = request.load_hand(side)
    return robot, resolve_config(request, robot, recording)


def resolve_config(
    request: RetargetRequest, robot: Hand, recording: HandRecording | None = None
) -> MethodConfig:
    """Returns the requested configuration with the scale set, for a loaded hand.

    Raises:
        ConfigError, RecordingError: as ``plan``.
    """
    config = request.config
    if request.operator is not None:
        request.operator.check(robot.spec.side)
    if request.scale is not None:
        fixed: float | None
        if request.scale == "calibrate":
            if recording is None:
                raise ConfigError(
                    "the scale can't be estimated without a recording; give --scale a number"
                )
            fixed = calibrate_scale(recording, robot)
        else:
            fixed = None if request.scale == "frame" else float(request.scale)
        config = config.with_alignment(scale=fixed)
    return config


def read_configuration(path: Path) -> dict[str, Any] | None:
    """Reads a configuration that this program wrote. Returns None if the file is missing or is
    something else."""
    try:
        content = read_json(path, most_bytes=_MOST_BYTES)
    except (OSError, ValueError):
        return None
    ours = isinstance(content, dict) and content.get("program") == PROGRAM
    return content if ours else None


def foreign_result(path: Path) -> str | None:
    """Returns a message if ``OUT.npz`` or its configuration file exists and is not an earlier
    result; None if both files can be written."""
    settings_file = config_path(path)
    for existing in (path, settings_file):
        if existing.exists() and not existing.is_file():
            return f"can't write {str(existing)!r}: it is not a regular file; {_ELSEWHERE}"
    if read_configuration(settings_file) is not None:
        return None  # the other file is its result, whole or damaged
    if settings_file.exists():
        return (
            f"can't write {str(settings_file)!r}, the configuration file of {path.name}: it exists "
            f"and is not a configuration; {_ELSEWHERE}"
        )
    if path.exists():
        try:
            read_commands(path)
        except RecordingError:
            return (
                f"can't write {str(path)!r}: it contains something other than commands; "
                f"{_ELSEWHERE}"
            )
    return None


_ELSEWHERE: Final = "choose another name, or remove the file first"


def configuration(command: str, todo: Plan, **more: Any) -> dict[str, Any]:
    """Resolved configuration of a plan, which is written with the plan's result."""
    recording = todo.recording
    about = {
        "name": recording.name,
        "side": recording.side,
        "frames": len(recording),
        "rate_hz": recording.rate_hz,
        "duration_s": recording.duration,
    }
    more = {"pinch_gaps": todo.pinch_gaps, "recording": about, **more}
    return (
        _configuration(command, todo, todo.hand.name, todo.config, side=todo.hand.spec.side) | more
    )


def live_configuration(
    command: str, request: RetargetRequest, configs: Mapping[Side, MethodConfig], **more: Any
) -> dict[str, Any]:
    """Resolved configuration of a run that does not retarget a recording, such as a live run.

    Args:
        configs: configuration of the method by side, from ``resolve``.
    """
    return _configuration(command, request, request.hand_name, dict(configs)) | more


def _configuration(
    command: str, choice: MethodChoice, hand: str, config: object, **more: Any
) -> dict[str, Any]:
    return {
        "program": PROGRAM,
        "command": command,
        "hand": hand,
        **more,
        "fingers": choice.fingers,
        "method": choice.method,
        "preset": choice.preset,
        "seed": choice.seed,
        "config": config,
        **environment(),
    }
