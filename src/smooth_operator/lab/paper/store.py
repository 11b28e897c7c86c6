"""The folder of the experiments: what is in it, and what of it need not be done again.

``config.json`` says what was asked for. ``cells/`` holds what was computed, one ``.npz`` a cell,
shared by the experiments. ``NAME/results.json`` and the figures beside it are what an experiment
comes to, ``report.html`` all of them. Files are whole or not there.
"""

from __future__ import annotations

import hashlib
import json
import zipfile
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any, Final

import numpy as np

import smooth_operator
from smooth_operator.io import atomic_write, output_error, to_json
from smooth_operator.io.environment import environment
from smooth_operator.lab.benchmark import store as benchmark_store
from smooth_operator.lab.benchmark.store import write_json
from smooth_operator.methods.request import PROGRAM
from smooth_operator.version import package_version

COMMAND: Final = "ablate"
CELLS: Final = "cells"
CONFIG: Final = "config.json"
RESULTS: Final = "results.json"

_CODE: Final = (
    "hands",
    "objective",
    "solvers",
    "lab/paper/contestants.py",
    "lab/paper/grid.py",
    "lab/paper/rmsprop.py",
    "lab/paper/runs.py",
    "lab/paper/starts.py",
)
"""The parts of this package that a cell depends on."""


def check_folder(folder: Path) -> None:
    """Looks whether experiments may be written into a folder; writes nothing.

    Raises:
        OutputError: a file stands there, or the folder holds something other than experiments.
    """
    benchmark_store.check_folder(folder, COMMAND, "earlier experiments")


class Store:
    """The folder of some experiments.

    Args:
        folder: made if need be.
        settings: what was asked for, as JSON has it.

    Raises:
        OutputError: the folder can't be written to, or holds something else.
    """

    def __init__(self, folder: Path, settings: Mapping[str, Any]) -> None:
        self.folder = folder
        self.environment = environment()
        check_folder(folder)
        try:
            (folder / CELLS).mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise output_error(folder, error) from error
        config = {"program": PROGRAM, "command": COMMAND, "settings": dict(settings)}
        write_json(folder / CONFIG, config | self.environment, indent=2)

    def load(self, key: Mapping[str, Any]) -> dict[str, np.ndarray] | None:
        """A cell that was finished before; None if there is none that is whole and of this key."""
        text = self._text(key)
        try:
            with np.load(self._path(text), allow_pickle=False) as file:
                if str(file["key"]) != text:
                    return None
                return {name: file[name] for name in file.files if name != "key"}
        except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
            return None

    def save(self, key: Mapping[str, Any], arrays: Mapping[str, np.ndarray]) -> None:
        """Keeps a finished cell.

        Raises:
            OutputError: it can't be written.
        """
        text = self._text(key)
        content: dict[str, Any] = {"key": np.array(text), **arrays}
        with atomic_write(self._path(text)) as file:
            np.savez(file, **content)

    def experiment_folder(self, name: str) -> Path:
        """Where an experiment's results stand; made if need be.

        Raises:
            OutputError: it can't be.
        """
        path = self.folder / name
        try:
            path.mkdir(exist_ok=True)
        except OSError as error:
            raise output_error(path, error) from error
        return path

    def _text(self, key: Mapping[str, Any]) -> str:
        return to_json({**key, "version": package_version(), "code": code_digest()})

    def _path(self, text: str) -> Path:
        word = json.loads(text).get("kind", "cell")
        digest = hashlib.sha256(text.encode()).hexdigest()[:20]
        return self.folder / CELLS / f"{word}-{digest}.npz"


@cache
def code_digest() -> str:
    """SHA-256 of the code and the models that a cell depends on."""
    home = Path(smooth_operator.__file__).parent
    total = hashlib.sha256()
    for name in _CODE:
        path = home / name
        for file in [path] if path.is_file() else sorted(path.rglob("*")):
            if file.is_file() and file.suffix != ".pyc":
                total.update(file.relative_to(home).as_posix().encode() + b"\0" + file.read_bytes())
    return total.hexdigest()
