"""``smooth-operator view``: plays a result with its recording."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from smooth_operator.cli.console import Progressing
from smooth_operator.cli.meshes import hand_to_draw
from smooth_operator.cli.outputs import folder_for, read_configuration
from smooth_operator.cli.page import playback
from smooth_operator.cli.view_options import View
from smooth_operator.errors import ConfigError, HandModelError, RecordingError
from smooth_operator.formats.commands import config_path, read_commands
from smooth_operator.formats.frames import frame_slice
from smooth_operator.formats.readers import read_recording
from smooth_operator.hands.hand import Hand
from smooth_operator.hands.registry import load_hand
from smooth_operator.hands.selection import FingerChoice, parse_fingers
from smooth_operator.human.alignment import AlignmentConfig
from smooth_operator.metrics import Trace, evaluate
from smooth_operator.metrics.assemble import assemble_trace
from smooth_operator.teleop.pages import Playback, serve
from smooth_operator.teleop.pages.clip import save_clip
from smooth_operator.types import CommandTrajectory, HandRecording


def view(options: View) -> None:
    """Matches commands and frames, and serves the page until Ctrl-C.

    Raises:
        RecordingError: a file can't be read, or the commands do not belong to the recording.
        HandModelError: the commands are not of this hand, or of different hands.
        ConfigError: too few files are named, or the page can't be served there.
    """
    *outs, source = options.files
    if not outs:
        raise ConfigError(
            "view takes commands and then their recording, such as out.npz glove.npz; only "
            f"{str(source)!r} is named"
        )
    runs = [_run(options, out, source) for out in outs]
    hands = {run.hand.name: run.out for run in runs}
    if len(hands) > 1:
        (one, first), (other, second) = list(hands.items())[:2]
        raise HandModelError(
            f"{first} is of the hand {one!r} and {second} of {other!r}; side by side stand results "
            "of one hand"
        )
    labels = ["robot"] if len(runs) == 1 else _labels(runs)
    hand = runs[0].hand
    drawn = hand_to_draw(hand, options)
    title = f"{hand.name} {hand.spec.side}"
    if len(runs) == 1 and runs[0].made_by:
        title += f": {runs[0].made_by}"
    pages = [
        playback(title, run.hand, run.trace, evaluate(run.trace), drawn, label)
        for run, label in zip(runs, labels, strict=True)
    ]
    if options.save is not None:
        _save(pages, options.save)
        return
    serve(pages, host=options.host, port=options.port, open_browser=not options.no_browser)


def _save(pages: Sequence[Playback], path: Path) -> None:
    progress = Progressing()
    with folder_for(path.parent):
        save_clip(pages, path, track=progress.frames("drawing"))
    progress.note(f"wrote {path}")


@dataclass(frozen=True, eq=False)
class _Run:
    """One file of commands with what it answers."""

    out: Path
    hand: Hand
    trace: Trace
    made_by: str


def _run(options: View, out: Path, source: Path) -> _Run:
    commands = _chosen(read_commands(out), options.frames)
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
    if commands.joint_names != hand.joint_names:
        raise HandModelError(
            f"{out} holds commands for the joints {', '.join(commands.joint_names)}, "
            f"but the hand {hand.name!r} has {', '.join(hand.joint_names)}; name the right hand "
            "with --hand"
        )
    trace = assemble_trace(recording, commands, hand, _alignment(config))
    made_by = " ".join(str(config[key]) for key in ("method", "preset") if key in config)
    return _Run(out, hand, trace, made_by)


def _chosen(commands: CommandTrajectory, frames: str | None) -> CommandTrajectory:
    if frames is None:
        return commands
    cut = frame_slice(frames, len(commands))
    return replace(
        commands,
        **{
            name: getattr(commands, name)[cut]
            for name in ("joint_positions", "stamps", "latency_ms", "status")
        },
    )


def _labels(runs: Sequence[_Run]) -> list[str]:
    """What each is called: its method, or its file where that is not known or two share one."""
    said = [run.made_by or run.out.stem for run in runs]
    return [
        name if said.count(name) == 1 else f"{name} ({run.out.stem})"
        for name, run in zip(said, runs, strict=True)
    ]


def _answered(
    commands: CommandTrajectory, recording: HandRecording, out: Path, source: Path
) -> HandRecording:
    """The frames that the commands answer, found by their stamps."""
    at = np.searchsorted(recording.stamps, commands.stamps)
    found = recording.stamps[np.minimum(at, len(recording) - 1)] == commands.stamps
    consecutive = bool((np.diff(at) == 1).all())
    if not len(commands) or not found.all() or not consecutive:
        raise RecordingError(
            f"{out} was not made from {source}: {int(found.sum())} of its {len(commands)} time "
            "stamps are those of consecutive frames in it; give the recording that it was made "
            "from, with the same --rate if it holds no stamps"
        )
    return recording[int(at[0]) : int(at[-1]) + 1]


def _fingers(options: View, config: dict[str, Any]) -> FingerChoice | None:
    """The fingers that are driven: as asked for, or as the configuration says."""
    if options.fingers is not None:
        return parse_fingers(options.fingers)
    known = config.get("fingers")
    return known if isinstance(known, dict) and options.hand is None else None


def _alignment(config: dict[str, Any]) -> AlignmentConfig:
    """The scale that the method used, where the configuration says."""
    try:
        return AlignmentConfig(scale=config["config"]["alignment"]["scale"])
    except (KeyError, TypeError):
        return AlignmentConfig()
