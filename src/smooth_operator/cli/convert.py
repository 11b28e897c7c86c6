"""``smooth-operator convert``: recordings and commands from any format into any other."""

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
    """Turn recordings and their commands into another file format, and back."""

    work: ClassVar[str] = "smooth_operator.cli.convert:convert"
    details: ClassVar[str] = """Formats, of inputs by what they hold and of the output by its name:
  .mcap        this program's log, opens in Foxglove
  .npz         plain arrays, for NumPy
  .h5, .hdf5   HDF5, with units (extra hdf5)
  a folder     a LeRobot dataset, v3.0 (extra lerobot)
A video (.mp4, .mov, .avi, .mkv, .webm), as input only, is tracked (extra webcam).

All formats store everything: hand, flags, commands, status, timing, configuration. What a
format can't hold is reported on standard error.

Several inputs, or a folder of them, become the episodes of one LeRobot dataset; or,
with --to mcap|npz|hdf5, a file each in the folder --output.

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
    """File or folder to write; its parent folder is created if missing."""

    commands: Annotated[Path | None, arg(metavar="OUT.npz")] = None
    """Commands to add to the recording: the result of retargeting it. For several recordings
    the folder of their results, each with the name of its recording."""

    to: Annotated[
        Literal["mcap", "npz", "hdf5", "lerobot"] | None, arg(metavar="mcap|npz|hdf5|lerobot")
    ] = None
    """Output format. Default: from the file name. Required to convert a data set into a folder."""

    rate: Annotated[float | None, arg(metavar="HZ")] = None
    """Frames per second of a recording without time stamps [Hz]; of several recordings or a
    folder, of those."""

    side: Annotated[HandSide | None, arg(metavar="right|left")] = None
    """Hand side. Default: the side of the recording; in a video, of the hand seen more often."""

    mirrored: bool = False
    """The video is mirrored, as selfie views are."""

    frames: Annotated[str | None, arg(metavar="A:B")] = None
    """Only these frames of each episode, as a Python slice: :500, 2600:3100, -500:"""

    task: Annotated[str | None, arg(metavar="TEXT")] = None
    """The task in words. Default: the task of the input."""

    fps: Annotated[int | None, arg(metavar="N")] = None
    """Frames per second of a LeRobot data set. Default: the median of the recordings, as
    a usual rate such as 30 or 100 where it is within 5 % of one."""

    columns: Annotated[
        Literal["all", "robot", "robot-wrist"], arg(metavar="all|robot|robot-wrist")
    ] = "all"
    """Columns of a LeRobot dataset: all that the input holds, or those that lerobot-record writes
    for the robot smooth_hand, at --fps (default: 30), so that both merge; robot-wrist: with
    --robot.wrist=quaternion."""

    environment_state: bool = False
    """With --columns robot: also observation.environment_state, the measured positions of all
    joints [rad], which some policies ask for where there is no picture."""

    episode: Annotated[int | None, arg(metavar="N")] = None
    """Only this episode of a LeRobot dataset."""

    overwrite: bool = False
    """Replace an output that this program wrote."""


_SUFFIX_OF: dict[Format, str] = {"mcap": ".mcap", "npz": ".npz", "hdf5": ".h5"}


def convert(options: Convert) -> None:
    """Finds the episodes, looks whether they may be written, and converts one after the other."""
    from smooth_operator.cli.console import Progressing
    from smooth_operator.teleop.recording.convert import Source, find_sources, format_of, losses
    from smooth_operator.teleop.sources.webcam.camera import is_video

    progress = Progressing(options.quiet)
    to = format_of(options.output, options.to)
    if options.fps is not None and to != "lerobot":
        raise ConfigError("--fps is of LeRobot datasets; the other formats keep each true stamp")
    if (options.columns != "all" or options.environment_state) and to != "lerobot":
        raise ConfigError("--columns and --environment-state are of LeRobot datasets")
    if options.environment_state and options.columns == "all":
        raise ConfigError("--environment-state is one of the columns of --columns robot; add that")
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
            if note not in reported:  # a dataset looks at its episodes twice
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
            f"the input is a LeRobot dataset, and without --to {options.output.name!r} would be "
            "another; say --to npz, mcap or hdf5 for a file of each episode, or --to lerobot for a "
            "dataset"
        )
    with folder_for(options.output.resolve().parent):
        written = 0

        def done(frames: int) -> None:
            nonlocal written
            written += frames

        with progress.waiting(f"converting {len(loads)} episodes"):
            notes = write_dataset(
                options.output, loads, fps=options.fps, columns=options.columns,
                environment_state=options.environment_state, done=done,
            )  # fmt: skip
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
    """A file for each episode."""
    from smooth_operator.teleop.recording.convert import SUFFIXES

    named = SUFFIXES.get(options.output.suffix.lower()) is not None
    if len(sources) == 1 and not options.output.is_dir() and (named or not _in_folder(options)):
        return [options.output]
    if named:
        raise ConfigError(
            f"the inputs hold {len(sources)} episodes, which do not go into one file "
            f"{options.output.name!r}; name a folder with --to {to} for a file each, or one "
            "without suffix for a LeRobot dataset"
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
    """Name of an output without its suffix; that of a dataset only if there are others."""
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
                f"can't write {str(path)!r}, the configuration of {main.name}: it holds "
                "something else; choose another name, or remove it first"
            )


def _commands_of(commands: Path | None, sources: list[Source]) -> list[Path | None]:
    """The file of commands for each episode."""
    if commands is None:
        return [None] * len(sources)
    if not commands.exists():
        raise RecordingError(f"{commands}: no such file; check the name and the folder")
    if not commands.is_dir():
        if len(sources) > 1:
            raise ConfigError(
                f"the inputs hold {len(sources)} episodes and {commands} the commands of one; "
                "give the folder of their results, each with the name of its recording"
            )
        return [commands]
    files = [commands / source.relative.with_suffix(".npz") for source in sources]
    missing = [str(path) for path in files if not path.is_file()]
    if missing:
        raise RecordingError(
            f"{commands}: {len(missing)} of {len(files)} recordings have no commands there, such "
            f"as {missing[0]}; retarget them first: smooth-operator retarget"
        )
    return list(files)


def _load(source: Source, commands: Path | None, options: Convert, several: bool) -> Episode:
    from smooth_operator.formats.checks import frame_slice
    from smooth_operator.formats.readers import rated_if_unstamped
    from smooth_operator.teleop.recording.convert import read_episode
    from smooth_operator.teleop.sources.webcam.camera import is_video

    if is_video(source.path):
        episode = _track(source.path, options)
    else:

        def read(rate: float | None) -> Episode:
            return source.read(rate=rate, side=options.side, layout=options.layout)

        # Of several, the rate is that of those without stamps.
        episode = rated_if_unstamped(read, options.rate)[0] if several else read(options.rate)
    if commands is not None:
        episode = episode.joined(read_episode(commands), str(commands))
        answered = len(set(episode.answered().tolist()))
        if options.frames is None and answered < len(episode):
            note = f"{commands} answers {answered} of the {len(episode)} frames of {source.path}"
            episode = replace(episode, notes=(*episode.notes, note))
    if options.frames is not None:
        episode = episode.sliced(frame_slice(options.frames, len(episode)))
    if options.task is not None:
        episode = replace(episode, task=options.task)
    return episode


def _track(path: Path, options: Convert) -> Episode:
    """The hand in a video."""
    from smooth_operator.formats.checks import check_rate
    from smooth_operator.formats.episode import Episode
    from smooth_operator.teleop.sources.webcam.picture_tracker import PictureConfig
    from smooth_operator.teleop.sources.webcam.webcam_source import track_video

    config = PictureConfig(mirrored=options.mirrored)
    recording = track_video(path, side=options.side, config=config)
    check_rate(recording.stamps, options.rate, str(path))
    assert recording.valid is not None  # filled in by HandRecording
    tracked = int(recording.valid.any(axis=1).sum())
    note = f"{path}: a {recording.side} hand on {tracked} of {len(recording)} pictures"
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
