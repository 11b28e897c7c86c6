"""``smooth-operator retarget``: a recording, or a folder of them, into joint commands."""

from __future__ import annotations

from smooth_operator.cli.console import Progressing, print_metrics
from smooth_operator.cli.outputs import check_commands_path, folder_for
from smooth_operator.cli.retarget_options import Retarget
from smooth_operator.cli.session import execute_shown, measure_shown, requested
from smooth_operator.errors import ConfigError
from smooth_operator.formats.checks import reading_notes
from smooth_operator.formats.commands import write_commands
from smooth_operator.formats.frames import frame_slice
from smooth_operator.formats.jsonable import to_json
from smooth_operator.planning import configuration, plan
from smooth_operator.types import Status


def retarget(options: Retarget) -> None:
    """Reads, retargets, measures, writes; all that a user can get wrong is checked first.

    Raises:
        SmoothOperatorError: with the reason; nothing is then left half done.
        SystemExit: 1, if some recordings of a folder failed.
    """
    if options.recording.is_dir():
        from smooth_operator.cli.retarget_folder import retarget_folder

        retarget_folder(options)
        return
    for name in ("workers", "cluster"):
        if getattr(options, name) is not None:
            raise ConfigError(
                f"--{name} is for a folder of recordings, and {options.recording} is none"
            )
    progress = Progressing(options.quiet)
    check_commands_path(options.output, options.recording)
    asked = requested(
        options,
        side=options.side,
        rate=options.rate,
        layout=options.layout,
        frames=options.frames,
    )
    recording = asked.read_recording(options.recording, options.rate)
    for note in reading_notes(recording, str(options.recording)):
        progress.note(note, matters=True)
    total = len(recording)
    frames = slice(0, total) if options.frames is None else frame_slice(options.frames, total)
    todo = plan(recording[frames], asked)
    if asked.operator is not None and (unused := todo.config.unused_components(asked.operator)):
        progress.note(f"{todo.method} does not use {', '.join(unused)} of the operator")
    with folder_for(options.output.parent):
        outcome = execute_shown(todo, progress)
        _, metrics = measure_shown(todo, outcome, options.definition, progress)
        config = configuration(
            "retarget",
            todo,
            source={"path": options.recording, "frames": [frames.start, frames.stop]},
            rate=options.rate,
            layout=options.layout,
        )
        write_commands(options.output, outcome.commands, config)
    held = int((outcome.commands.status != Status.OK).sum())
    if held:
        done = (
            "had no usable hand: short gaps are bridged, over longer ones the last pose is held"
            if todo.config.trajectory is not None
            else "repeat the last good command"
        )
        progress.note(f"{held} of {len(outcome.commands)} frames {done}")
    progress.note(f"wrote {options.output}")
    if options.json:
        print(to_json(metrics))
    else:
        print_metrics(f"{recording.name} on {todo.hand.name}, {todo.method} {todo.preset}", metrics)
