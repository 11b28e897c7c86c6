"""The files that a robot model consists of, and copying them to another folder."""

from __future__ import annotations

import os
import shutil
import tempfile
from pathlib import Path
from typing import Final

from smooth_operator.atomic_files import output_error
from smooth_operator.errors import HandModelError
from smooth_operator.hands.loading import load_model
from smooth_operator.hands.model_assets import read_model_files

MOST_BYTES: Final = 500_000_000
"""Models with their meshes have 0.1 to 100 MB; what is larger is left where it is."""
_HIGHEST: Final = 4
"""Folders above the model's own from which files are taken; what lies further away is not part of
the model's package, and stays where it is."""


def model_files(path: Path) -> tuple[Path, ...]:
    """The model file, what it includes, and its meshes and textures, as far as they are there.

    Args:
        path: MJCF or URDF file.

    Raises:
        HandModelError: the file is no model.
    """
    files = read_model_files(path)
    return tuple(dict.fromkeys([*files.documents, *files.assets.values()]))


def copy_model(path: Path, folder: Path) -> Path | None:
    """Copies a model with all its files, so that it no longer depends on the original.

    The files keep their places relative to each other. The folder is replaced as a whole, and only
    if the copy can be loaded.

    Args:
        path: MJCF or URDF file that can be loaded.
        folder: where to; what is there is replaced.

    Returns:
        the copy of the model file; None if the files are too large, or the copy is not the same
        model, as where files are named by absolute paths. Then nothing was changed.

    Raises:
        HandModelError: the file is no model.
        OutputError: the copy can't be written.
    """
    path = path.absolute()
    top = path.parents[min(_HIGHEST, len(path.parents) - 1)]
    files = [file for file in model_files(path) if file.is_relative_to(top)]
    if sum(file.stat().st_size for file in files) > MOST_BYTES:
        return None
    root = Path(os.path.commonpath([file.parent for file in files]))
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        trial = Path(tempfile.mkdtemp(prefix=".copying-", dir=folder.parent))
    except OSError as error:
        raise output_error(folder, error) from error
    try:
        for file in files:
            target = trial / file.relative_to(root)
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(file, target)
        if not _same_model(path, trial / path.relative_to(root)):
            return None
        if folder.exists():
            shutil.rmtree(folder)
        trial.replace(folder)
    except OSError as error:
        raise output_error(folder, error) from error
    finally:
        shutil.rmtree(trial, ignore_errors=True)
    return folder / path.relative_to(root)


def _same_model(one: Path, other: Path) -> bool:
    try:
        ours, theirs = load_model(one), load_model(other)
    except HandModelError:
        return False
    return (
        ours.model.nq == theirs.model.nq
        and ours.model.ngeom == theirs.model.ngeom
        and ours.unreadable == theirs.unreadable
    )
