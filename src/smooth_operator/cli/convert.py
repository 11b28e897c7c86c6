"""``smooth-operator convert``: converts recordings and commands between formats."""

from __future__ import annotations

import functools
import re
from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal

from tyro.conf import Positional, arg

from smooth_operator.cli.common_options import Common, HandSide, Ordered, Quiet
from smooth_operator.errors import ConfigError, OutputError, RecordingError

if TYPE_CHECKING:
    from smooth_operator.cli.console import Progressing
    from smooth_operator.formats.episode import Episode
    from smooth_operator.teleop.recording.convert import Format, Source


@dataclass(frozen=True, kw_only=True)
class Convert(Ordered, Common, Quiet):
    """Convert recordings and their commands to another file format, and back."""

    work: ClassVar[str] = "smooth_operator.cli.convert:convert"
    details: ClassVar[
        str
    ] = """The format of an input is recognised by its content, that of the output by
its name:
  .mcap        this program's log, which Foxglove can open
  .npz         plain arrays, for NumPy
  .h5, .hdf5   HDF5, with units (extra hdf5)
  a folder     a LeRobot dataset, v3.0 (extra lerobot)
A video (.mp4, .mov, .avi, .mkv, .webm) can only be an input; the hand in it is tracked (extra
webcam).

All formats store the hand, flags, commands, status, timing and configuration. Data that a format
can't store is reported on standard error.

Several inputs, or a folder of them, become the episodes of one LeRobot dataset, or, with --to
mcap|npz|hdf5, one file per input in the folder --output.

Examples:
  smooth-operator convert glove.npz --output glove.mcap
  smooth-operator convert glove.npz --commands out.npz --output demo.mcap
  smooth-operator convert recordings --commands results --task "pinch" --output dataset
  smooth-operator convert takes --columns robot --task "pinch" --output dataset
  smooth-operator convert dataset --episode 3 --output demo.h5
  smooth-operator convert dataset --to npz --output episodes
  smooth-operator convert clip.mp4 --side right --output clip.npz
"""

    inputs: Annotated[Positional[tuple[Path, ...]], arg(metavar="INPUT...")]
    """Recordings, results, logs, HDF5 files, LeRobot datasets, or folders of these."""

    output: Annotated[Path, arg(metavar="OUT")]
    """File or folder to write. Its parent folder is created if missing."""

    commands: Annotated[Path | None, arg(metavar="OUT.npz")] = None
    """Commands to add to the recording: the file that retarget wrote. For several recordings, give
    the folder with all results, in which each result is named after its recording."""

    to: Annotated[
        Literal["mcap", "npz", "hdf5", "lerobot"] | None, arg(metavar="mcap|npz|hdf5|lerobot")
    ] = None
    """Output format. Default: the format that the file name indicates. Required to convert a data
    set into a folder."""

    rate: Annotated[float | None, arg(metavar="HZ")] = None
    """Frame rate of recordings without timestamps [Hz]."""

    side: Annotated[HandSide | None, arg(metavar="right|left")] = None
    """Hand side. Default: the side of the recording; in a video, the hand that is visible more
    often."""

    mirrored: bool = False
    """The video is mirrored, like a selfie view."""

    frames: Annotated[str | None, arg(metavar="A:B")] = None
    """Only these frames of each episode, as a Python slice: :500, 2600:3100, -500:"""

    task: Annotated[str | None, arg(metavar="TEXT")] = None
    """Description of the task. Default: the task of the input."""

    fps: Annotated[int | None, arg(metavar="N")] = None
    """Frame rate of the LeRobot dataset [Hz]. Default: the median rate of the recordings, rounded
    to a common rate such as 30 or 100 if it is within 5 %."""

    columns: Annotated[
        Literal["all", "robot", "robot-wrist"], arg(metavar="all|robot|robot-wrist")
    ] = "all"
    """Columns of the LeRobot dataset. all: everything in the input. robot: the columns that
    lerobot-record writes for the robot smooth_hand, at --fps (default: 30), so that the datasets
    can be merged. robot-wrist: the columns for --robot.wrist=quaternion too."""

    environment_state: bool = False
    """With --columns robot: also write observation.environment_state, the measured positions of all
    joints [rad], which some policies require if there is no camera image."""

    episode: Annotated[int | None, arg(metavar="N")] = None
    """Convert only this episode of a LeRobot dataset."""

    overwrite: bool = False
    """Replace an output that this program wrote."""


_SUFFIX_OF: dict[Format, str] = {"mcap": ".mcap", "npz": ".npz", "hdf5": ".h5"}


def convert(options: Convert) -> None:
    """Finds the episodes, checks that the outputs may be written, and converts the episodes in
    turn.
    """
    from smooth_operator.cli.console import Progressing
    from smooth_operator.teleop.recording.convert import Source, find_sources, format_of, losses
    from smooth_operator.teleop.sources.webcam.camera import is_video

    progress = Progressing(options.quiet)
    to = format_of(options.output, options.to)
    if options.fps is not None and to != "lerobot":
        raise ConfigError(
            "--fps applies only to LeRobot datasets; other formats keep the original timestamps"
        )
    if (options.columns != "all" or options.environment_state) and to != "lerobot":
        raise ConfigError("--columns and --environment-state apply only to LeRobot datasets")
    if options.environment_state and options.columns == "all":
        raise ConfigError("--environment-state needs --columns robot or robot-wrist")
    if not options.inputs:
        raise ConfigError("give at least one INPUT to convert")
    apart = [options.output, *([] if options.commands is None else [options.commands])]
    videos = [path for path in options.inputs if is_video(path)]
    others = [path for path in options.inputs if not is_video(path)]
    sources, notes = find_sources(others, episode=options.episode, leave=apart)
    sources += [Source(path, Path(path.name)) for path in videos]
    for note in notes:
        progress.note(note)
    beside = _commands_of(options.commands, sources)
    several = len(sources) > 1 or _in_folder(options)
    reported: set[str] = set()

    def load(source: Source, commands: Path | None) -> Episode:
        episode = _load(source, commands, options, several)
        for note in (*episode.notes, *losses(episode, to)):
            if note not in reported:  # a dataset reads its episodes twice
                reported.add(note)
                progress.note(note, matters=True)
        return episode

    loads = [functools.partial(load, s, c) for s, c in zip(sources, beside, strict=True)]
    if to == "lerobot":
        _write_dataset(options, loads, progress)
    else:
        _write_files(options, to, sources, loads, progress)


def _write_dataset(
    options: Convert, loads: list[functools.partial[Episode]], progress: Progressing
) -> None:
    from smooth_operator.cli.outputs import folder_for
    from smooth_operator.episode_files.lerobot import write_dataset
    from smooth_operator.errors import counted
    from smooth_operator.formats.registry import is_dataset
    from smooth_operator.teleop.recording.convert import check_target

    check_target(options.output, "lerobot", options.inputs, options.overwrite)
    if options.to is None and any(is_dataset(path) for path in options.inputs):
        raise ConfigError(
            "the input is a LeRobot dataset, so --to is required for "
            f"{options.output.name!r}: use --to npz, mcap or hdf5 for one file per episode, "
            "or --to lerobot for another dataset"
        )
    with folder_for(options.output.resolve().parent):
        written = 0

        def done(frames: int) -> None:
            nonlocal written
            written += frames

        with progress.waiting(f"converting {len(loads)} episodes"):
            notes = write_dataset(
                options.output,
                loads,
                fps=options.fps,
                columns=options.columns,
                environment_state=options.environment_state,
                done=done,
            )
    for note in notes:
        progress.note(note, matters=True)
    progress.note(
        f"wrote {options.output}: {counted(len(loads), 'episode')}, {counted(written, 'frame')}"
    )


def _write_files(
    options: Convert,
    to: Format,
    sources: list[Source],
    loads: list[functools.partial[Episode]],
    progress: Progressing,
) -> None:
    from smooth_operator.cli.outputs import folder_for
    from smooth_operator.teleop.recording.convert import write_episode

    targets = _targets(options, to, sources)
    for target in targets:
        _check(target, to, options)
    for target, load in zip(targets, loads, strict=True):
        with folder_for(target.parent):
            episode = load()
            write_episode(target, episode, to)
        progress.note(f"wrote {target}: {_described(episode)}")


def _targets(options: Convert, to: Format, sources: list[Source]) -> list[Path]:
    """Paths of the files to write, one for each episode."""
    from smooth_operator.teleop.recording.convert import SUFFIXES

    named = SUFFIXES.get(options.output.suffix.lower()) is not None
    if len(sources) == 1 and not options.output.is_dir() and (named or not _in_folder(options)):
        return [options.output]
    if named:
        raise ConfigError(
            f"the inputs contain {len(sources)} episodes, which do not fit into the single file "
            f"{options.output.name!r}; for one file per episode, name a folder and add --to {to}; "
            "for a LeRobot dataset, name a folder"
        )
    alone = len(options.inputs) == 1 and sources[0].path == options.inputs[0]
    targets = [
        options.output / source.relative.parent / f"{_stem(source, alone)}{_SUFFIX_OF[to]}"
        for source in sources
    ]
    twice = [target for target, count in Counter(targets).items() if count > 1]
    if twice:
        raise ConfigError(
            f"{len(twice)} outputs would have the same name, such as {twice[0]}; convert their "
            "inputs into separate folders"
        )
    return targets


def _in_folder(options: Convert) -> bool:
    return any(path.is_dir() for path in options.inputs) and options.episode is None


def _stem(source: Source, alone: bool) -> str:
    """Name of an output without its suffix. The dataset's name is included only if there are
    several inputs."""
    if source.dataset is None:
        return source.relative.stem
    number = f"episode_{source.number:06d}"
    name = re.sub(r"[^\w.-]+", "_", source.dataset.name_of(source.number))
    stem = number if name == number else f"{number}_{name}"
    return stem if alone else f"{source.relative.name}/{stem}"


def _check(target: Path, to: Format, options: Convert) -> None:
    from smooth_operator.planning import read_configuration
    from smooth_operator.teleop.recording.convert import check_target, files_of

    main, *others = files_of(target, to)
    check_target(main, to, options.inputs, options.overwrite)
    for path in others:
        if path.exists() and (not path.is_file() or read_configuration(path) is None):
            raise OutputError(
                f"can't write {str(path)!r}, the configuration file of {main.name}: it "
                "exists and is not a configuration; choose another name, or remove the file "
                "first"
            )


def _commands_of(commands: Path | None, sources: list[Source]) -> list[Path | None]:
    """Path of the commands of each episode; None without commands."""
    if commands is None:
        return [None] * len(sources)
    if not commands.exists():
        raise RecordingError(f"{commands}: no such file; check the name and the folder")
    if not commands.is_dir():
        if len(sources) > 1:
            raise ConfigError(
                f"the inputs contain {len(sources)} episodes, but {commands} contains the commands "
                "of only one; name the folder with all results, in which each result is named "
                "after its recording"
            )
        return [commands]
    files = [commands / source.relative.with_suffix(".npz") for source in sources]
    missing = [str(path) for path in files if not path.is_file()]
    if missing:
        raise RecordingError(
            f"{commands}: {len(missing)} of {len(files)} recordings have no commands there, "
            f"for example {missing[0]}; retarget them first: smooth-operator retarget"
        )
    return list(files)


def _load(source: Source, commands: Path | None, options: Convert, several: bool) -> Episode:
    from smooth_operator.formats.checks import frame_slice
    from smooth_operator.formats.registry import rated_if_unstamped
    from smooth_operator.teleop.recording.convert import read_episode
    from smooth_operator.teleop.sources.webcam.camera import is_video

    if is_video(source.path):
        episode = _track(source.path, options)
    else:

        def read(rate: float | None) -> Episode:
            return source.read(rate=rate, side=options.side, layout=options.layout)

        # With several inputs, the rate applies to those without timestamps.
        episode = rated_if_unstamped(read, options.rate)[0] if several else read(options.rate)
    if commands is not None:
        episode = episode.joined(read_episode(commands), str(commands))
        answered = len(set(episode.answered().tolist()))
        if options.frames is None and answered < len(episode):
            note = (
                f"{commands} has commands for {answered} of the {len(episode)} frames of "
                f"{source.path}"
            )
            episode = replace(episode, notes=(*episode.notes, note))
    if options.frames is not None:
        episode = episode.sliced(frame_slice(options.frames, len(episode)))
    if options.task is not None:
        episode = replace(episode, task=options.task)
    return episode


def _track(path: Path, options: Convert) -> Episode:
    """Tracks the hand in a video."""
    from smooth_operator.formats.checks import check_rate
    from smooth_operator.formats.episode import Episode
    from smooth_operator.teleop.sources.webcam.picture_tracker import PictureConfig
    from smooth_operator.teleop.sources.webcam.webcam_source import track_video

    config = PictureConfig(mirrored=options.mirrored)
    recording = track_video(path, side=options.side, config=config)
    check_rate(recording.stamps, options.rate, str(path))
    assert recording.valid is not None  # HandRecording fills it in
    tracked = int(recording.valid.any(axis=1).sum())
    note = f"{path}: a {recording.side} hand in {tracked} of {len(recording)} video frames"
    return Episode(recording, name=recording.name, notes=(note,))


def _described(episode: Episode) -> str:
    from smooth_operator.errors import counted

    parts = []
    if episode.recording is not None:
        parts.append(
            f"{counted(len(episode.recording), 'frame')} of a {episode.recording.side} hand"
        )
    if episode.commands is not None:
        parts.append(counted(len(episode.commands), "command"))
    return ", ".join(parts)
