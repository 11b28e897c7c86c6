"""``smooth-operator retarget`` for a folder of recordings and for a LeRobot data set."""

from __future__ import annotations

from pathlib import Path

from smooth_hand_datasets.commands.dataset import make_shown
from smooth_hand_datasets.pipeline.another_hand import find_dataset, retarget_dataset
from smooth_hand_datasets.pipeline.request import MirrorRequest
from smooth_operator.cli.console import Progressing
from smooth_operator.cli.outputs import folder_for
from smooth_operator.cli.retarget import Retarget, request_from
from smooth_operator.errors import ConfigError, OutputError
from smooth_operator.execution import checked
from smooth_operator.formats.registry import file_kind, is_dataset
from smooth_operator.io.jsonable import to_json
from smooth_operator.retargeting.start import start_jax


def retarget_lerobot(options: Retarget, name: str) -> None:
    """Derives the actions of another robot hand for a LeRobot data set.

    Raises:
        SmoothOperatorError: the data set can't be retargeted.
    """
    unused = ("recording", "frames", "rate", "layout", "workers", "cluster")
    for option in unused:
        if getattr(options, option) is not None:
            raise ConfigError(f"{option} can't be used with --dataset; leave it out")
    source, progress = find_dataset(name), Progressing(options.quiet)
    request = request_from(options)
    start_jax(one_thread=False)
    with folder_for(options.output.resolve().parent):
        provenance = retarget_dataset(
            source, options.output, checked(request), videos=options.videos, reporter=progress
        )
    progress.note(f"wrote {options.output}")
    if options.json:
        print(to_json(provenance))


def retarget_folder(options: Retarget, folder: Path) -> None:
    """Retargets the recordings of a folder that are not done yet.

    Raises:
        SmoothOperatorError: the folder can't be retargeted; finished results stay.
        SystemExit: 1, if a recording failed.
    """
    output = options.output
    if is_dataset(folder):
        file_kind(folder)  # raises an error that names the command for a data set
    if output.suffix == ".npz" and not output.is_dir():
        raise OutputError(
            f"can't write {str(output)!r}: {folder} is a folder of recordings, so the results need "
            "a folder too; name a folder with --output"
        )
    request = request_from(options)
    make_shown(
        MirrorRequest(
            sources=(str(folder),), output=output, workers=options.workers, cluster=options.cluster
        ),
        resolved=request,
        again=options.overwrite,
        quiet=options.quiet,
        json=options.json,
    )
