"""``smooth-operator edit``: cuts recordings made with ``teleop`` or adds named marks to them, and
writes new files."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar

from tyro.conf import Positional, arg

from smooth_operator.cli.common_options import Common
from smooth_operator.errors import ConfigError


@dataclass(frozen=True, kw_only=True)
class Edit(Common):
    """Cut a recording made with teleop or add named marks to it, and write a new file."""

    work: ClassVar[str] = "smooth_operator.cli.edit:edit"
    details: ClassVar[str] = """Times are seconds since the first frame or command. The
original recordings are not changed. The new ones contain the history of their edits, and can be
read like any other recording.

Examples:
  smooth-operator edit takes/pour.mcap --keep 1.5:8 --output takes/pour-short.mcap
  smooth-operator edit takes/pour.mcap --drop 3:4.2 --mark 2.5=grasp 6=release --output cut.mcap
  smooth-operator edit takes/two.right.mcap takes/two.left.mcap --keep 2: --output edited
"""

    takes: Annotated[Positional[tuple[Path, ...]], arg(metavar="TAKE.mcap...")]
    """Logs of one run, of one hand or of both hands."""

    output: Annotated[Path, arg(metavar="OUT")]
    """File to write; for several logs, a folder, in which they keep their names."""

    keep: Annotated[tuple[str, ...], arg(metavar="FROM:TO")] = ()
    """Time ranges to keep [s]. Default: all."""

    drop: Annotated[tuple[str, ...], arg(metavar="FROM:TO")] = ()
    """Time ranges to leave out [s]. Each leaves a gap, because the timestamps do not change."""

    mark: Annotated[tuple[str, ...], arg(metavar="SECONDS=TEXT")] = ()
    """Times to mark [s], with a text for each. A mark is stored as an event of the next command."""

    overwrite: bool = False
    """Replace existing files."""


def edit(options: Edit) -> None:
    """Writes the new recordings, and prints what each contains."""
    from smooth_operator.teleop.recording.edit import Edit as Changes
    from smooth_operator.teleop.recording.edit import as_mark, as_range, edit_logs
    from smooth_operator.teleop.recording.log_reader import read_log

    if not options.takes:
        raise ConfigError(
            "name a recording: smooth-operator edit a.mcap --keep 1:8 --output b.mcap"
        )
    changes = Changes(
        tuple(map(as_range, options.keep)),
        tuple(map(as_range, options.drop)),
        tuple(map(as_mark, options.mark)),
    )
    outputs = [options.output]
    if len(options.takes) > 1 or options.output.is_dir():
        options.output.mkdir(parents=True, exist_ok=True)
        outputs = [options.output / path.name for path in options.takes]
    for path in outputs:
        if path.exists() and not options.overwrite:
            raise ConfigError(f"{path} exists; name another --output, or add --overwrite")
    edit_logs(options.takes, outputs, changes)
    for path in outputs:
        log = read_log(path)
        stamps = log.recording if log.commands is None else log.commands
        frames = 0 if log.recording is None else len(log.recording)
        commands = 0 if log.commands is None else len(log.commands)
        assert stamps is not None
        seconds = float(stamps.stamps[-1] - stamps.stamps[0])
        print(f"{path}: {seconds:.1f} s, {frames} frames, {commands} commands")
