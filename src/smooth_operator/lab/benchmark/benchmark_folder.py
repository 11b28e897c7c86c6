"""The folder of a benchmark: what is in it, and what of it may be used again.

``config.json`` says what was asked for; ``cells/SLUG.npz`` and ``.json`` are the commands of a cell
and what was measured, as ``smooth-operator retarget`` writes them; ``cells/SLUG.latency.json`` its
latency; ``results.json`` and ``report.html`` what all of it comes to. Files are whole or not there.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np

from smooth_operator.atomic_files import output_error, write_json
from smooth_operator.errors import DocumentError, OutputError
from smooth_operator.formats.commands import read_commands, write_commands
from smooth_operator.formats.environment import environment
from smooth_operator.io.documents import read_json
from smooth_operator.lab.benchmark.cells import Cell, benchmark_code, fingerprint
from smooth_operator.lab.benchmark.latency import Latency
from smooth_operator.lab.benchmark.quality import Measured
from smooth_operator.lab.benchmark.settings import Settings
from smooth_operator.lab.offline.finished import read_configuration
from smooth_operator.planning import PROGRAM
from smooth_operator.result_cache import Job, Note, ResultCache, no_note
from smooth_operator.types import CommandTrajectory

COMMAND: Final = "bench"
CELLS: Final = "cells"
CONFIG: Final = "config.json"
RESULTS: Final = "results.json"
REPORT: Final = "report.html"
PLOTS: Final = "plots"


def check_folder(
    folder: Path, command: str = COMMAND, former: str = "an earlier benchmark"
) -> None:
    """Looks whether results may be written into a folder; writes nothing.

    Args:
        command: whose results may stand there already.
        former: origin of those, for the message.

    Raises:
        OutputError: a file stands there, or the folder holds something other than such results.
    """
    if not folder.exists():
        return
    if not folder.is_dir():
        raise OutputError(f"can't write into {str(folder)!r}: a file stands there; name a folder")
    try:
        empty = not any(folder.iterdir())
    except OSError as error:
        raise output_error(folder, error) from error
    if not empty and (read_configuration(folder / CONFIG) or {}).get("command") != command:
        raise OutputError(
            f"can't write into {str(folder)!r}: it holds something other than {former}; give "
            "another folder with --output"
        )


class MeasuredCache(ResultCache):
    """Measured cells: commands and configuration, as ``smooth-operator retarget`` writes them.

    The metrics and what the cell depends on are in the configuration, under ``cell``.
    """

    def _read(self, path: Path) -> tuple[Mapping[str, Any], Measured]:
        content = dict(read_json(path))
        record = content.pop("cell")
        commands = read_commands(path.with_suffix(".npz"))
        # The two files are written one after the other, and a crash may come between them.
        if record["commands"] != _digest(commands):
            raise DocumentError(f"it is not of {path.stem}.npz")
        return record, Measured(
            commands, dict(record["metrics"]), dict(record["fingers"]), content, record["seconds"]
        )

    def _write(self, path: Path, record: Mapping[str, str], value: Measured) -> None:
        cell = {
            **record,
            "commands": _digest(value.commands),
            "metrics": value.metrics,
            "fingers": value.fingers,
            "seconds": value.seconds,
        }
        write_commands(
            path.with_suffix(".npz"), value.commands, value.configuration | {"cell": cell}
        )


class BenchmarkFolder:
    """The folder of one benchmark.

    Args:
        settings: settings of the benchmark; its ``output`` is the folder, which is created.
        note: called with cells that can't be used.

    Attributes:
        measured: measurements of cells, without latency.

    Raises:
        OutputError: the folder can't be written to, or holds something else.
    """

    def __init__(self, settings: Settings, note: Note = no_note) -> None:
        self.settings = settings
        self.folder = settings.output
        self.environment = environment()
        check_folder(self.folder)
        self.measured = MeasuredCache(self.folder / CELLS, note)
        self._latencies = ResultCache(self.folder / CELLS, note)
        config = {"program": PROGRAM, "command": COMMAND, "settings": settings}
        write_json(self.folder / CONFIG, config | self.environment, indent=2)

    def job(self, cell: Cell) -> Job[Cell]:
        """A cell to be measured, unless that was done before; long recordings take longest."""
        key = fingerprint(cell, self.settings)
        effort = len(cell.source.recording or ())
        return Job(cell.slug, key, benchmark_code(), cell, cell.label, effort)

    def save_latency(self, cell: Cell, latency: Latency) -> None:
        """Keeps the latency of a cell.

        Raises:
            OutputError: it can't be written.
        """
        content = {
            "samples_ms": latency.samples_ms,
            "first_ms": latency.first_ms,
            "warm_up": latency.warm_up,
            "load": latency.load,
            "others": latency.others,
        }
        self._latencies.keep(*self._latency(cell), content)

    def load_latency(self, cell: Cell) -> Latency | None:
        """The latency of a cell, measured before on this kind of machine; None if there is none."""
        content = self._latencies.find(*self._latency(cell))
        if content is None:
            return None
        return Latency(**{**content, "samples_ms": np.array(content["samples_ms"], np.float64)})

    def _latency(self, cell: Cell) -> tuple[str, object, str]:
        machine = [self.environment[key] for key in ("cpu", "cpu_cores", "device", "versions")]
        key = [fingerprint(cell, self.settings), self.settings.latency_frames, machine]
        return f"{cell.slug}.latency", key, benchmark_code()


def _digest(commands: CommandTrajectory) -> str:
    total = hashlib.sha256("\n".join(commands.joint_names).encode())
    for array in (commands.joint_positions, commands.stamps, commands.status):
        total.update(np.ascontiguousarray(array, "<f8").tobytes())
    return total.hexdigest()
