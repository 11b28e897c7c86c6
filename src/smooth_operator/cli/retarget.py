"""``smooth-operator retarget``: turns a recording, or a folder of them, into joint commands."""

from __future__ import annotations

import shlex
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar, Final, Literal

from tyro.conf import Positional, arg

from smooth_operator.cli.common_options import (
    RARE,
    Common,
    HandSide,
    Measured,
    Ordered,
    Retargeting,
)
from smooth_operator.errors import ConfigError
from smooth_operator.extras import PART_OF_DATA_SETS
from smooth_operator.plugins import Registry
from smooth_operator.request import WristJointChoice

if TYPE_CHECKING:
    from smooth_operator.planning import RetargetRequest


@dataclass(frozen=True, kw_only=True)
class Retarget(Common, Ordered, Retargeting, Measured):
    """Turn a recording of a human hand, or a folder of them, into joint commands."""

    work: ClassVar[str] = "smooth_operator.cli.retarget:retarget"
    details: ClassVar[str] = """OUT.npz holds joint_positions (T, n) [rad], joint_names (n,),
timestamps (T,) [s], latency_ms (T,) and status (T,); the resolved configuration is
written with it, as OUT.json.

To retarget a folder or with --dataset, install packages/smooth_hand_datasets. For a folder, all
recordings (including subfolders) are retargeted, several in parallel. The output folder has the
same structure. Its report.json lists the counts and the failures; its episodes.jsonl has one line
per recording, with quality metrics. Latency is not measured for a folder, so latency_ms is NaN. Run
the same command again to continue after a stop, or to add new recordings: finished results are
kept, unless their recording, settings, robot hand or this program's code have changed.

Exit status: 0 done, 1 some recordings of the folder failed (the others are done), 2 the
request is invalid, 130 stopped.

Examples:
  smooth-operator retarget glove.npz --output out.npz
  smooth-operator retarget landmarks.npy --rate 60 --side left --output out.npz
  smooth-operator retarget glove.npz --method sbr --preset paper --json --output out.npz
  smooth-operator retarget recordings/ --workers 8 --output commands/
  smooth-operator retarget --dataset fingers --hand leap_hand --output fingers-leap
  smooth-operator retarget /nfs/recordings --cluster auto --output /nfs/commands
"""

    rare: ClassVar[frozenset[str]] = RARE | {"wrist_joints", "videos"}

    recording: Annotated[Positional[Path | None], arg(metavar="RECORDING|FOLDER")] = None
    """MANUS .npz, (T, 21, 3) landmarks [m] as .npy or .npz, or this program's .mcap log; or a
    folder of such files. Required without --dataset."""

    dataset: Annotated[str | None, arg(metavar="REPO|FOLDER")] = None
    """LeRobot data set with recorded human hands; its actions are replaced by those of another
    robot hand (docs/how-to/lerobot.md). Give its folder, or its name in LeRobot's data folder."""

    output: Annotated[Path, arg(metavar="OUT.npz|FOLDER")]
    """File to write, or, if the input is a folder or data set, folder for the results; created if
    missing."""

    side: Annotated[HandSide | None, arg(metavar="right|left")] = None
    """Hand side. Default: the side of the recording."""

    wrist_joints: WristJointChoice = "auto"
    """Whether the robot hand's wrist joints, if it has any, follow the wrist of the recording,
    relative to its first valid frame (docs/how-to/hands.md). auto: on."""

    frames: Annotated[str | None, arg(metavar="A:B")] = None
    """Only these frames, as a Python slice: :500, 2600:3100, -500:"""

    videos: Literal["link", "copy"] = "link"
    """With --dataset: link the videos of the data set with hard links, or copy them."""

    rate: Annotated[float | None, arg(metavar="HZ")] = None
    """Frame rate of recordings without timestamps [Hz]."""

    workers: Annotated[int | None, arg(metavar="N")] = None
    """Number of recordings of a folder to retarget in parallel; 0 retargets one at a time in this
    process. Default: one per core."""

    cluster: Annotated[str | None, arg(metavar="auto|local|ADDRESS")] = None
    """Retarget a folder on a running Ray cluster (auto finds it), or start Ray here (local); its
    nodes need this package and the same folders."""

    overwrite: bool = False
    """Replace existing results: OUT.npz, or the finished results of a folder."""

    json: bool = False
    """Print only one JSON object on standard output: the metrics, or for a folder its report."""


COLLECTIONS: Final = Registry("retargeting", {})
"""Functions that retarget a folder of recordings, or a LeRobot data set, from the options and the
folder or name of the source."""


def _retarget_collection(kind: str, options: Retarget, source: str | Path) -> None:
    if kind not in COLLECTIONS:
        raise ConfigError(f"retargeting of a {kind} is {PART_OF_DATA_SETS}")
    COLLECTIONS.load(kind)(options, source)


def retarget(options: Retarget) -> None:
    """Reads, retargets, measures and writes a recording, after a check of all options."""
    from smooth_operator.cli.console import Progressing, print_metrics, print_summary
    from smooth_operator.cli.outputs import check_commands_path, folder_for
    from smooth_operator.cli.session import execute_shown
    from smooth_operator.execution import measure
    from smooth_operator.formats.checks import frame_slice, reading_notes
    from smooth_operator.formats.commands import write_commands
    from smooth_operator.io.jsonable import to_json
    from smooth_operator.planning import configuration, plan
    from smooth_operator.retargeting.trajectory import TrajectoryMethodConfig
    from smooth_operator.types import Status
    from smooth_operator.wrist_following import add_wrist_commands

    if options.dataset is not None:
        _retarget_collection("dataset", options, options.dataset)
        return
    if options.recording is None:
        raise ConfigError("name a RECORDING or a FOLDER of recordings, or give --dataset")
    if options.recording.is_dir():
        _retarget_collection("folder", options, options.recording)
        return
    for name in ("workers", "cluster"):
        if getattr(options, name) is not None:
            raise ConfigError(
                f"--{name} is for a folder of recordings; {options.recording} is not a folder"
            )
    progress = Progressing(options.quiet)
    check_commands_path(options.output, options.recording, options.overwrite)
    request = request_from(options)
    recording = request.read_recording(options.recording, options.rate)
    for note in reading_notes(recording, str(options.recording)):
        progress.note(note, matters=True)
    total = len(recording)
    frames = slice(0, total) if options.frames is None else frame_slice(options.frames, total)
    todo = plan(recording[frames], request)
    with folder_for(options.output.parent):
        outcome = execute_shown(todo, progress)
        with progress.waiting("measuring"):
            _, metrics = measure(todo, outcome, options.definition)
        config = configuration(
            "retarget",
            todo,
            source={"path": options.recording, "frames": [frames.start, frames.stop]},
            rate=options.rate,
            layout=options.layout,
        )
        commands = outcome.commands
        if request.wrist_joints:
            commands = add_wrist_commands(commands, todo.recording, todo.hand)
        write_commands(options.output, commands, config)
    held = int((outcome.commands.status != Status.OK).sum())
    if held:
        done = (
            "had no usable hand: short gaps are bridged, and in longer gaps the robot holds its "
            "last pose"
            if isinstance(todo.config, TrajectoryMethodConfig)
            else "repeat the last good command"
        )
        progress.note(f"{held} of {len(outcome.commands)} frames {done}")
    progress.note(f"wrote {options.output}")
    if options.json:
        print(to_json(metrics))
        return
    title = f"{recording.name} on {todo.hand.name}, {todo.method} {todo.preset}"
    if options.all:
        print_metrics(title, metrics)
        return
    files = shlex.join(map(str, (options.output, options.recording)))
    look = f"Next: smooth-operator view {files} plays both in the browser; --all or --json prints"
    print_summary(title, todo.method, metrics, [f"{look} all figures"])


def request_from(options: Retarget) -> RetargetRequest:
    """Builds the request from the options; raises the same errors as ``make_request``."""
    from smooth_operator.planning import make_request

    return make_request(
        **options.settings(),
        side=options.side,
        rate=options.rate,
        layout=options.layout,
        frames=options.frames,
        wrist_joints=options.wrist_joints != "off",
    )
