"""The folder of the experiments: what is in it, and what of it need not be done again.

``config.json`` says what was asked for. ``cells/`` holds what was computed, one ``.npz`` a cell,
shared by the experiments. ``NAME/results.json`` and the figures are what an experiment
comes to, ``report.html`` all of them. Files are whole or not there.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from smooth_operator.atomic_files import output_error, write_json
from smooth_operator.formats.environment import environment
from smooth_operator.lab.benchmark import benchmark_folder as benchmark_store
from smooth_operator.lab.offline.finished import read_configuration
from smooth_operator.planning import PROGRAM
from smooth_operator.result_cache import ArrayCache, Note, no_note
from smooth_operator_research.code import research_digest

COMMAND: Final = "ablate"
CELLS: Final = "cells"
CONFIG: Final = "config.json"
RESULTS: Final = "results.json"


def check_folder(folder: Path) -> None:
    """Looks whether experiments may be written into a folder; writes nothing.

    Raises:
        OutputError: a file stands there, or the folder holds something other than experiments.
    """
    benchmark_store.check_folder(folder, COMMAND, "earlier experiments")


class ExperimentFolder:
    """The folder of some experiments.

    Args:
        folder: made if need be.
        settings: what was asked for, as JSON has it.
        note: called with cells that can't be used.

    Attributes:
        cells: what was computed.
        environment: versions and machine.

    Raises:
        OutputError: the folder can't be written to, or holds something else.
    """

    def __init__(self, folder: Path, settings: Mapping[str, Any], note: Note = no_note) -> None:
        self.folder = folder
        self.environment = environment()
        check_folder(folder)
        before = read_configuration(folder / CONFIG)
        if before is not None and "code" not in before:
            note(f"{folder} is of an earlier version: its cells are computed again")
        self.cells = ArrayCache(folder / CELLS, note)
        config = {"program": PROGRAM, "command": COMMAND, "settings": dict(settings)}
        write_json(
            folder / CONFIG, config | self.environment | {"code": experiment_code()}, indent=2
        )

    @property
    def machine(self) -> dict[str, Any]:
        """What times depend on: processor, cores and device."""
        return {key: self.environment[key] for key in ("cpu", "cpu_cores", "device")}

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


def experiment_code() -> str:
    """Digest of the code and the models that a cell depends on."""
    return research_digest(
        "hands", "objective", "solvers", "baselines/slsqp.py", "baselines/scipy_slsqp.py",
        "paper/compared_solvers.py",
        "paper/budget_grid.py", "paper/rmsprop.py", "paper/runs.py",
        "paper/starts.py",
    )  # fmt: skip
