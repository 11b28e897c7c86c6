"""``smooth-operator calibrate``: measures an operator's pinches, or where a tracker is on a
glove, and writes a file."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

from tyro.conf import Positional, arg

from smooth_operator.cli.common_options import Common, HandSide, Ordered, Quiet
from smooth_operator.errors import ConfigError, OutputError

if TYPE_CHECKING:
    from smooth_operator.calibration.operator_file import OperatorProfile
    from smooth_operator.calibration.segments import Segment


@dataclass(frozen=True, kw_only=True)
class Calibrate(Ordered, Common, Quiet):
    """Measure the pinch gaps that a hand tracker reports, or find where a wrist tracker is mounted
    on a glove, and save the result for --operator."""

    work: ClassVar[str] = "smooth_operator.cli.calibrate:calibrate_recording"
    details: ClassVar[
        str
    ] = """Many trackers report a gap even while the thumb touches a finger. The method smooth
closes this gap. The gaps of MediaPipe (webcam, video) are built in, and small gaps are estimated
while the operator works. A tracker with large, unknown gaps needs a calibration.

A recording should show a light pinch of the thumb with each finger, pad to pad, for a few seconds
each and in any order. With --source, the program asks the operator for one pinch after the other.
Besides OPERATOR.json, it writes OPERATOR.png (distances and pinches over time) and
OPERATOR.report.json.

With --wrist-source, the program finds where a tracker is mounted on the glove: the operator
turns the hand about the wrist, then slides the flat hand along a table. The result is added to
OPERATOR.json; calibrate each hand separately (docs/how-to/trackers.md).

Examples:
  smooth-operator calibrate glove.npz --output operator.json
  smooth-operator calibrate --source webcam --output operator.json
  smooth-operator retarget glove.npz --operator operator.json --output out.npz
  smooth-operator calibrate --wrist-source openxr:track=trackers --side left --output operator.json
"""

    recording: Annotated[Positional[Path | None], arg(metavar="RECORDING")] = None
    """Recording of the operator's hand: MANUS .npz, (T, 21, 3) landmarks [m] as .npy or .npz, or
    .mcap. Can't be combined with --source."""

    source: Annotated[str | None, arg(metavar="NAME[:SETTINGS]")] = None
    """Live source to use instead of a recording, as for teleop. The program asks for one pinch
    after another, which takes about half a minute."""

    wrist_source: Annotated[str | None, arg(metavar="NAME[:SETTINGS]")] = None
    """Live source of a tracker on a glove, as for teleop. Instead of pinch gaps, the program
    measures where the tracker is mounted on the glove."""

    output: Annotated[Path, arg(metavar="OPERATOR.json")]
    """File to write. An earlier calibration of the same kind in this file is replaced; other
    calibrations are kept."""

    side: Annotated[HandSide | None, arg(metavar="right|left")] = None
    """Hand side. Default: the side of the recording, or right for a live source."""

    frames: Annotated[str | None, arg(metavar="A:B")] = None
    """Only these frames, as a Python slice: :500, 2600:3100, -500:"""

    rate: Annotated[float | None, arg(metavar="HZ")] = None
    """Frame rate of a recording without timestamps [Hz]."""

    json: bool = False
    """Print only the report, as one JSON object, on standard output."""


def calibrate_recording(options: Calibrate) -> None:
    """Measures an operator's pinches, or finds where a tracker is mounted; writes files and prints
    the result."""
    if options.wrist_source is None:
        _calibrate_pinches(options)
    else:
        _calibrate_mount(options, options.wrist_source)


def _calibrate_mount(options: Calibrate, text: str) -> None:
    """Finds where a tracker sits on the hand, and adds it to the operator's file."""
    from smooth_operator.calibration.mount import PROMPTS, find_mount
    from smooth_operator.calibration.operator_file import OperatorProfile, write_operator
    from smooth_operator.cli.console import Progressing
    from smooth_operator.cli.outputs import folder_for
    from smooth_operator.cli.prompting import ask
    from smooth_operator.io.jsonable import to_json
    from smooth_operator.teleop.components import build_source

    if options.source is not None or options.recording is not None:
        raise ConfigError("--wrist-source can't be combined with a recording or with --source")
    before, side = _earlier(options.output), options.side or "right"
    progress = Progressing(options.quiet)
    recording, segments = ask(build_source(text, side), side, PROMPTS, progress)
    wrists = recording.T_world_wrist
    assert wrists is not None  # a session always has them
    of = {segment.finger: wrists[segment.start : segment.stop] for segment in segments}
    mount = find_mount(*(of.get(prompt.name, wrists[:0]) for prompt in PROMPTS))
    profile = before or OperatorProfile(side)
    pose = tuple(round(value, 5) for value in mount.T_tracker_wrist.tolist())
    with folder_for(options.output.parent):
        write_operator(options.output, replace(profile, mounts={**profile.mounts, side: pose}))
    progress.note(f"wrote {options.output}")
    figures = {
        "side": side,
        "T_tracker_wrist": pose,
        "residual_mm": 1e3 * mount.residual,
        "turn": mount.turn,
        "slide_m": mount.slide,
        "tilt_degrees": math.degrees(mount.tilt),
    }
    if options.json:
        print(to_json(figures))
        return
    x, y, z = (100 * value for value in pose[:3])
    print(
        f"{side} hand: the wrist is at {x:.1f}, {y:.1f}, {z:.1f} cm in the tracker's frame. It "
        f"moved by {1e3 * mount.residual:.1f} mm while the hand turned, and the hand turned by "
        f"{figures['tilt_degrees']:.1f}° while it slid by {100 * mount.slide:.0f} cm."
    )


def _calibrate_pinches(options: Calibrate) -> None:
    """Reads the recording, calibrates, writes three files and prints the result."""
    from smooth_operator.atomic_files import write_json
    from smooth_operator.calibration.estimate import calibrate, report
    from smooth_operator.calibration.operator_file import write_operator
    from smooth_operator.calibration.segments import PROMPTS
    from smooth_operator.cli.console import Progressing
    from smooth_operator.cli.outputs import folder_for
    from smooth_operator.cli.prompting import ask
    from smooth_operator.cli.session import read_shown
    from smooth_operator.formats.environment import environment
    from smooth_operator.io.jsonable import to_json
    from smooth_operator.planning import PROGRAM
    from smooth_operator.reporting.calibration_picture import draw_calibration
    from smooth_operator.teleop.components import build_source

    progress = Progressing(options.quiet)
    if options.source is not None and options.recording is not None:
        raise ConfigError("give a recording or a live source, not both")
    before = _earlier(options.output)
    picture, figures = (options.output.with_suffix(end) for end in (".png", ".report.json"))
    segments: list[Segment] | None = None
    if options.source is None:
        if options.recording is None:
            raise ConfigError("give a recording to calibrate from, or a live source with --source")
        reading = {"rate": options.rate, "side": options.side, "layout": options.layout}
        recording = read_shown(options.recording, progress, options.frames, **reading)
    else:
        side = options.side or "right"
        recording, segments = ask(build_source(options.source, side), side, PROMPTS, progress)
    with progress.waiting("searching for pinches"):
        calibration = calibrate(recording, segments)
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
        write_json(figures, content, indent=2)
        mounts = {} if before is None else before.mounts
        write_operator(options.output, replace(calibration.operator, mounts=mounts))
    progress.note(f"wrote {options.output}, {picture.name} and {figures.name}")
    if options.json:
        print(to_json(content))
    else:
        _print(content)


def _earlier(output: Path) -> OperatorProfile | None:
    """Profile that is in the file already; None without a file. OutputError if the name does not
    end in .json, or the file exists and is not a calibration."""
    from smooth_operator.calibration.operator_file import read_operator

    if output.suffix != ".json":
        raise OutputError(f"can't write {str(output)!r}: the name must end in .json")
    if not output.exists():
        return None
    try:
        return read_operator(output)
    except ConfigError:
        raise OutputError(
            f"can't write {str(output)!r}: the file exists and is not a calibration; "
            "choose another name, or remove the file first"
        ) from None


def _print(content: dict[str, Any]) -> None:
    from smooth_operator.cli.console import output_console, plain_table

    console = output_console()
    console.print(
        f"{content['recording']}, {content['side']} hand: {content['frames_used']} of "
        f"{content['frames']} frames used, palm {content['palm_length_mm']:.0f} mm long",
        markup=False,
    )
    table = plain_table(None, ("finger", "pinches", "sure", "gap [mm]", "note"), left=1)
    for name, finger in content["fingers"].items():
        times, gap = len(finger["segments"]), finger["pinch_gap_mm"]
        table.add_row(
            name,
            f"{times} ×" if times else "none",
            f"{finger['confidence']:.2f}" if times else "–",
            "–" if gap is None else f"{gap['median']:.1f} (90 %: {gap['p90']:.1f})",
            finger["note"],
        )
    console.print(table)
