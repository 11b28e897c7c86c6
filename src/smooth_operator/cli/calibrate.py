"""``smooth-operator calibrate``: an operator's poses into a profile, with a report."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, cast

from tyro.conf import Positional, arg

from smooth_operator.cli.common_options import Common, HandSide, Ordered, Quiet
from smooth_operator.errors import ConfigError, OutputError
from smooth_operator.methods.registry import DEFAULT_METHOD

if TYPE_CHECKING:
    from smooth_operator.calibration.segments import Segment
    from smooth_operator.cli.console import Progressing
    from smooth_operator.human.operator import Component
    from smooth_operator.types import HandRecording


@dataclass(frozen=True, kw_only=True)
class Calibrate(Ordered, Common, Quiet):
    """Fit a robot hand to its operator by poses in a recording; writes a file for --operator."""

    work: ClassVar[str] = "smooth_operator.cli.calibrate:calibrate_recording"
    details: ClassVar[
        str
    ] = """With --source the operator is asked for the poses, one after the other.
A recording should show, for some seconds each and in any order, a flat hand, the fingers
spread, a fist, and a pinch of the thumb with each finger. Missing poses are reported, and
the rest is calibrated. With OPERATOR.json come OPERATOR.png (the poses on a time
line; reach and pinches before and after) and OPERATOR.report.json (the same as figures).

Parts of a calibration (--apply names those that the file uses):
  scale    one scale of the palm instead of one a frame
  tips     from the tracker's tip landmark to the pad
  pinch    the distance left in a pinch is closed; latches at the operator's distances
  fingers  each finger's reach to the robot's
  palm     the flat hand's direction to that of the robot's straight fingers
All are found and written in any case.

Examples:
  smooth-operator calibrate glove.npz --output operator.json
  smooth-operator calibrate --source webcam --output operator.json
  smooth-operator retarget glove.npz --operator operator.json --output out.npz
  smooth-operator calibrate glove.npz --hand shadow_hand --frames :2500 --output operator.json
"""

    recording: Annotated[Positional[Path | None], arg(metavar="RECORDING")] = None
    """The operator's hand: MANUS .npz, (T, 21, 3) landmarks [m] as .npy or .npz, or .mcap; not with
    --source."""

    source: Annotated[str | None, arg(metavar="NAME[:SETTINGS]")] = None
    """A live source instead of a recording, as for teleop: poses are asked for one after the
    other, under a minute in all."""

    output: Annotated[Path, arg(metavar="OPERATOR.json")]
    """File to write; an earlier calibration there is replaced."""

    hand: Annotated[str, arg(metavar="NAME")] = "mimic_p050"
    """Robot hand, by its catalogue name."""

    side: Annotated[HandSide | None, arg(metavar="right|left")] = None
    """Hand side. Default: the side of the recording; for a source, right."""

    fingers: Annotated[str | None, arg(metavar="A,B=C")] = None
    """Robot fingers that will be driven, as for retarget. Default: all."""

    frames: Annotated[str | None, arg(metavar="A:B")] = None
    """Only these frames, as a Python slice: :500, 2600:3100, -500:"""

    rate: Annotated[float | None, arg(metavar="HZ")] = None
    """Frames per second of a recording without time stamps [Hz]."""

    apply: Annotated[str | None, arg(metavar="A,B|all")] = None
    """Parts that the file uses; see above. Default: the parts that lower the measured pinch error
    and scale error."""

    json: bool = False
    """Print the report as one JSON object on standard output, and nothing else there."""


def calibrate_recording(options: Calibrate) -> None:
    """Reads, calibrates, writes three files, prints what was found."""
    from smooth_operator.atomic_files import atomic_write
    from smooth_operator.calibration.estimate import calibrate, report
    from smooth_operator.calibration.operator_file import write_operator
    from smooth_operator.cli.console import Progressing
    from smooth_operator.cli.outputs import folder_for
    from smooth_operator.cli.prompting import ask
    from smooth_operator.formats.environment import environment
    from smooth_operator.formats.jsonable import to_json
    from smooth_operator.hands.finger_choice import parse_fingers
    from smooth_operator.hands.registry import load_hand
    from smooth_operator.lab.offline.calibration_picture import draw_calibration
    from smooth_operator.planning import PROGRAM
    from smooth_operator.teleop.components import build_source

    progress = Progressing(options.quiet)
    if options.source is not None and options.recording is not None:
        raise ConfigError("give a recording or a live source, not both")
    picture, figures = _check_output(options.output)
    apply = _components(options.apply)
    fingers = None if options.fingers is None else parse_fingers(options.fingers)
    segments: list[Segment] | None = None
    if options.source is None:
        recording = _read(options, progress)
        hand = load_hand(options.hand, recording.side, fingers=fingers)
    else:
        hand = load_hand(options.hand, options.side, fingers=fingers)
        recording, segments = ask(build_source(options.source, hand.spec.side), hand, progress)
    with progress.waiting("looking for poses"):
        calibration = calibrate(recording, hand, segments, apply=apply)
    content = {
        "program": PROGRAM,
        "command": "calibrate",
        "source": options.source or {"path": options.recording, "frames": options.frames},
        **report(calibration, recording),
        **environment(),
    }
    with folder_for(options.output.parent):
        with progress.waiting("drawing the report"):
            draw_calibration(calibration, recording, picture)
        with atomic_write(figures) as file:
            file.write(to_json(content, indent=2).encode() + b"\n")
        write_operator(options.output, calibration.operator)
    progress.note(f"wrote {options.output}, {picture.name} and {figures.name}")
    if options.json:
        print(to_json(content))
    else:
        _print(content)


def _read(options: Calibrate, progress: Progressing) -> HandRecording:
    from smooth_operator.formats.checks import frame_slice, reading_notes
    from smooth_operator.formats.readers import read_recording

    if options.recording is None:
        raise ConfigError(
            "there is nothing to calibrate on: name a recording, or a live source with --source"
        )
    recording = read_recording(
        options.recording, rate=options.rate, side=options.side, layout=options.layout
    )
    for note in reading_notes(recording, str(options.recording)):
        progress.note(note, matters=True)
    if options.frames is not None:
        recording = recording[frame_slice(options.frames, len(recording))]
    return recording


def _check_output(output: Path) -> tuple[Path, Path]:
    """Paths of the picture and of the figures.

    Raises:
        OutputError: the name does not end in .json, or something other than a calibration has it.
    """
    from smooth_operator.calibration.operator_file import read_operator

    if output.suffix != ".json":
        raise OutputError(f"can't write {str(output)!r}: the name must end in .json")
    if output.exists():
        try:
            read_operator(output)
        except ConfigError:
            raise OutputError(
                f"can't write {str(output)!r}: it holds something other than a calibration; choose "
                "another name, or remove it first"
            ) from None
    return output.with_suffix(".png"), output.with_suffix(".report.json")


def _components(text: str | None) -> tuple[Component, ...]:
    from smooth_operator.human.operator import COMPONENTS, DEFAULT_COMPONENTS, Component

    if text is None:
        return DEFAULT_COMPONENTS
    words = [word.strip() for word in text.split(",") if word.strip()]
    if words == ["all"]:
        return COMPONENTS
    if words == ["none"]:
        return ()
    return tuple(cast(Component, word) for word in words)  # the profile refuses what is none


def _print(content: dict[str, Any]) -> None:
    from smooth_operator.cli.console import output_console, plain_table

    console = output_console()
    console.print(
        f"{content['recording']} on {content['hand']} {content['side']}: "
        f"{content['frames_used']} of {content['frames']} frames used",
        markup=False,
    )
    table = plain_table(None, ("pose", "found", "sure", "note"))
    for pose, row in content["poses"].items():
        times = len(row["segments"])
        sure = f"{row['confidence']:.2f}" if times else "–"
        table.add_row(pose, f"{times} ×" if times else "no", sure, row["note"])
    console.print(table)
    headers = (
        "finger", "reach [mm]", "robot's [mm]", "scale", "tip along, to pad [mm]",
        "gap in pinch [mm]", "left, 90 % under [mm]",
    )  # fmt: skip
    table = plain_table(None, headers, left=1)
    for name, finger in content["fingers"].items():
        gap, after = finger["pinch_gap_mm"], finger["pinch_gap_corrected_mm"]
        table.add_row(
            name,
            f"{finger['reach_mm']:.1f}",
            f"{finger['robot_reach_mm']:.1f}",
            f"{finger['scale']:.3f}",
            f"{finger['tip_along_mm']:.1f}, {finger['tip_pad_mm']:.1f}",
            "–" if gap is None else f"{gap['median']:.1f} (90 %: {gap['p90']:.1f})",
            "–" if after is None else f"{after['p90']:.1f}",
        )
    console.print(table)
    angle, project = content["palm_rotation_deg"], content["project_mm"]
    console.print(
        f"palm {content['palm_width_mm']:.1f} mm wide, {content['palm_length_mm']:.1f} mm long, "
        f"scale {content['palm_scale']:.3f}; flat hand and robot's fingers "
        + ("not compared" if angle is None else f"{angle:.0f}° apart")
        + "; latch "
        + (
            "as the method has it"
            if project is None
            else f"closes at {project:.1f} mm, opens at {content['escape_mm']:.1f} mm"
        ),
        markup=False,
        soft_wrap=True,
    )
    console.print(f"in use: {', '.join(content['apply']) or 'nothing'}", markup=False)
    if "scale" in content["apply"]:
        console.print(
            f"{DEFAULT_METHOD} leaves out scale, which helped it on no recording",
            markup=False,
            soft_wrap=True,
        )
    console.print(
        "left: of the tracked gap, where each half of the pinch frames is corrected by the other "
        "half's; what the robot leaves is measured by retarget --operator and bench --operator",
        markup=False,
        soft_wrap=True,
    )
