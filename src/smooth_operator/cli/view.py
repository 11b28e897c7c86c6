"""``smooth-operator view``: plays a result with its recording."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

from tyro.conf import Positional, arg

from smooth_operator.cli.common_options import Common, HandSide, Meshes, Ordered, Page
from smooth_operator.errors import ConfigError, HandModelError, RecordingError

if TYPE_CHECKING:
    import numpy as np
    from jaxtyping import Float

    from smooth_operator.hands.hand import Hand
    from smooth_operator.hands.spec import FingerChoice
    from smooth_operator.metrics import Trace
    from smooth_operator.retargeting.alignment import AlignmentConfig
    from smooth_operator.teleop.pages import Playback
    from smooth_operator.types import CommandTrajectory, HandRecording


@dataclass(frozen=True, kw_only=True)
class View(Common, Page, Ordered, Meshes):
    """Play joint commands and the recorded hand in the browser."""

    work: ClassVar[str] = "smooth_operator.cli.view:view"
    details: ClassVar[
        str
    ] = """Commands and frames are matched by their timestamps. Several files of commands for the
same frames and the same hand are shown side by side, each labelled with its method; the human hand
is aligned with the settings of the first method.

Examples:
  smooth-operator view out.npz glove.npz
  smooth-operator view smooth.npz dexpilot.npz glove.npz
  smooth-operator view out.npz glove.npz --model vendor/right_hand.xml
  smooth-operator view smooth.npz sbr.npz glove.npz --frames 500:1200 --save clip.gif
  smooth-operator view smooth-operator-demo/commands.npz smooth-operator-demo/log.mcap
"""

    files: Annotated[Positional[tuple[Path, ...]], arg(metavar="OUT.npz... RECORDING")]
    """One or more files of commands from retarget, followed by the recording that they were made
    from."""

    hand: Annotated[str | None, arg(metavar="NAME")] = None
    """Robot hand. Default: the hand in OUT.json."""

    fingers: Annotated[str | None, arg(metavar="A,B=C")] = None
    """Robot fingers that were driven, in the form of --fingers of retarget. Default: those in
    OUT.json."""

    side: Annotated[HandSide | None, arg(metavar="right|left")] = None
    """Hand side. Default: the side in OUT.json, or that of the recording."""

    rate: Annotated[float | None, arg(metavar="HZ")] = None
    """Frame rate of a recording without timestamps [Hz]. Default: the rate in OUT.json."""

    save: Annotated[Path | None, arg(metavar="CLIP.gif|CLIP.webp")] = None
    """Write a video clip to this file instead of serving the page. Use --model to draw the vendor's
    meshes."""

    frames: Annotated[str | None, arg(metavar="A:B")] = None
    """Only these frames of the commands, as a Python slice: :500, 2600:3100"""


def view(options: View) -> None:
    """Matches commands and frames, and serves the page until Ctrl-C."""
    if options.save is not None:
        from smooth_operator.simulation.renderer import draw_off_screen

        draw_off_screen()
    from smooth_operator.cli.console import print_metrics
    from smooth_operator.cli.page import hand_to_draw
    from smooth_operator.metrics import evaluate
    from smooth_operator.teleop.pages import Playback, serve

    *outs, source = options.files
    if not outs:
        raise ConfigError(
            "view needs files of commands and then the recording, such as out.npz glove.npz; only "
            f"{str(source)!r} was given"
        )
    runs = [_run(options, out, source) for out in outs]
    hands = {run.hand.name: run.out for run in runs}
    if len(hands) > 1:
        (one, first), (other, second) = list(hands.items())[:2]
        raise HandModelError(
            f"{first} is for the hand {one!r}, but {second} is for {other!r}; only results "
            "of the same hand can be compared"
        )
    labels = ["robot"] if len(runs) == 1 else _labels(runs)
    hand = runs[0].hand
    drawn = hand_to_draw(hand, options)
    title = f"{hand.name} {hand.spec.side}"
    if len(runs) == 1 and runs[0].made_by:
        title += f": {runs[0].made_by}"
    pages = [
        Playback(title, run.hand, run.trace, drawn, label, run.palms)
        for run, label in zip(runs, labels, strict=True)
    ]
    if options.save is not None:
        _save(pages, options.save)
        return
    for run, label in zip(runs, labels, strict=True):
        print_metrics(label if len(runs) > 1 else title, evaluate(run.trace))
    serve(pages, host=options.host, port=options.port, open_browser=not options.no_browser)


def _save(pages: Sequence[Playback], path: Path) -> None:
    from smooth_operator.cli.console import Progressing
    from smooth_operator.cli.outputs import folder_for
    from smooth_operator.teleop.pages.clip import save_clip

    progress = Progressing()
    with folder_for(path.parent):
        save_clip(pages, path, track=progress.frames("drawing"))
    progress.note(f"wrote {path}")


@dataclass(frozen=True, eq=False)
class _Run:
    """One file of commands with the frames that it was made from."""

    out: Path
    hand: Hand
    trace: Trace
    made_by: str
    palms: Float[np.ndarray, "T 7"] | None = None


def _run(options: View, out: Path, source: Path) -> _Run:
    import numpy as np

    from smooth_operator.formats.checks import frame_slice
    from smooth_operator.formats.commands import config_path, read_commands
    from smooth_operator.formats.readers import read_recording
    from smooth_operator.hands.registry import load_hand
    from smooth_operator.hands.wrist_joints import has_joints
    from smooth_operator.metrics.assemble import assemble_trace
    from smooth_operator.planning import read_configuration
    from smooth_operator.wrist_following import PalmMotion

    commands = read_commands(out)
    if options.frames is not None:
        commands = commands[frame_slice(options.frames, len(commands))]
    config = read_configuration(config_path(out)) or {}
    rate = options.rate if options.rate is not None else config.get("rate")
    recording = read_recording(
        source,
        rate=rate,
        side=options.side or config.get("side"),
        layout=options.layout or config.get("layout"),
    )
    recording = _answered(commands, recording, out, source)
    name = options.hand or config.get("hand", "mimic_p050")
    hand = load_hand(name, recording.side, fingers=_fingers(options, config))
    if not has_joints(hand, commands.joint_names):
        raise HandModelError(
            f"{out} contains commands for the joints {', '.join(commands.joint_names)}, but the "
            f"hand {hand.name!r} has {', '.join(hand.joint_names)}; choose the correct hand with "
            "--hand"
        )
    trace = assemble_trace(recording, commands, hand, _alignment(config))
    made_by = " ".join(str(config[key]) for key in ("method", "preset") if key in config)
    wrist = commands.joint_positions[:, len(hand.joint_names) :]
    palms = np.stack([*map(PalmMotion(hand).at, wrist)]) if wrist.shape[1] else None
    return _Run(out, hand, trace, made_by, palms)


def _labels(runs: Sequence[_Run]) -> list[str]:
    """Returns the label of each run: its method, or its file name if the method is unknown or not
    unique.
    """
    names = [run.made_by or run.out.stem for run in runs]
    return [
        name if names.count(name) == 1 else f"{name} ({run.out.stem})"
        for name, run in zip(names, runs, strict=True)
    ]


def _answered(
    commands: CommandTrajectory, recording: HandRecording, out: Path, source: Path
) -> HandRecording:
    """Finds the frames from which the commands were made, by their timestamps."""
    import numpy as np

    at = np.searchsorted(recording.stamps, commands.stamps)
    equal = recording.stamps[np.minimum(at, len(recording) - 1)] == commands.stamps
    consecutive = bool((np.diff(at) == 1).all())
    if not len(commands) or not equal.all() or not consecutive:
        raise RecordingError(
            f"{out} was not made from {source}: {int(equal.sum())} of its {len(commands)} "
            "timestamps match consecutive frames of the recording; name the recording that "
            "it was made from, with the same --rate if it has no timestamps"
        )
    return recording[int(at[0]) : int(at[-1]) + 1]


def _fingers(options: View, config: dict[str, Any]) -> FingerChoice | None:
    """Returns the driven fingers: those of the options, or those of the configuration."""
    from smooth_operator.request import parse_fingers

    if options.fingers is not None:
        return parse_fingers(options.fingers)
    fingers = config.get("fingers")
    return fingers if isinstance(fingers, dict) and options.hand is None else None


def _alignment(config: dict[str, Any]) -> AlignmentConfig:
    """Returns the scale that the method used, if the configuration has it."""
    from smooth_operator.retargeting.alignment import AlignmentConfig

    try:
        return AlignmentConfig(scale=config["config"]["alignment"]["scale"])
    except (KeyError, TypeError):
        return AlignmentConfig()
