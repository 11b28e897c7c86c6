"""The folder of a benchmark: what is in it, and what of it may be used again.

``config.json`` says what was asked for; ``cells/SLUG.npz`` and ``.json`` are the commands of a cell
and what was measured, as ``smooth-operator retarget`` writes them; ``cells/SLUG.latency.json`` its
latency; ``results.json`` and ``report.html`` what all of it comes to. Files are whole or not there.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from smooth_operator.errors import OutputError, SmoothOperatorError
from smooth_operator.io import (
    atomic_write,
    config_path,
    output_error,
    read_commands,
    to_json,
    write_commands,
)
from smooth_operator.io.documents import read_json
from smooth_operator.io.environment import environment
from smooth_operator.lab.benchmark.cells import Cell, fingerprint
from smooth_operator.lab.benchmark.latency import Latency
from smooth_operator.lab.benchmark.quality import Measured
from smooth_operator.lab.benchmark.settings import Settings
from smooth_operator.lab.offline.finished import read_configuration
from smooth_operator.methods.request import PROGRAM
from smooth_operator.types import CommandTrajectory

COMMAND: Final = "bench"
CELLS: Final = "cells"
CONFIG: Final = "config.json"
RESULTS: Final = "results.json"
REPORT: Final = "report.html"
PLOTS: Final = "plots"


@dataclass(frozen=True, eq=False)
class Kept:
    """A finished cell.

    Attributes:
        commands: the joint commands.
        metrics: what was measured, without latency.
        fingers: the same finger by finger.
        configuration: what it depended on.
        seconds: how long it took [s].
    """

    commands: CommandTrajectory
    metrics: dict[str, Any]
    fingers: dict[str, dict[str, float | None]]
    configuration: dict[str, Any]
    seconds: float | None


def check_folder(
    folder: Path, command: str = COMMAND, former: str = "an earlier benchmark"
) -> None:
    """Looks whether results may be written into a folder; writes nothing.

    Args:
        folder: where to.
        command: whose results may stand there already.
        former: what those are, for the message.

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


class Store:
    """The folder of one benchmark.

    Args:
        settings: what is asked for; its ``output`` is the folder, made if need be.

    Raises:
        OutputError: the folder can't be written to, or holds something else.
    """

    def __init__(self, settings: Settings) -> None:
        self.settings = settings
        self.folder = settings.output
        self.environment = environment()
        check_folder(self.folder)
        try:
            (self.folder / CELLS).mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise output_error(self.folder, error) from error
        config = {"program": PROGRAM, "command": COMMAND, "settings": settings}
        write_json(self.folder / CONFIG, config | self.environment, indent=2)

    def path(self, cell: Cell) -> Path:
        """Where the commands of a cell stand."""
        return self.folder / CELLS / f"{cell.slug}.npz"

    def save(self, cell: Cell, measured: Measured, seconds: float) -> Kept:
        """Keeps a finished cell.

        Raises:
            OutputError: it can't be written.
        """
        configuration = measured.configuration | {
            # As `retarget` has them, so that `view` finds the frames again.
            "source": cell.source.facts,
            "rate": cell.source.request.rate,
        }
        record = {
            "fingerprint": fingerprint(cell, self.settings),
            # The two files are written one after the other: this tells that they belong together.
            "commands": _digest(measured.commands),
            "metrics": measured.metrics,
            "fingers": measured.fingers,
            "seconds": seconds,
        }
        write_commands(self.path(cell), measured.commands, configuration | {"cell": record})
        return Kept(measured.commands, measured.metrics, measured.fingers, configuration, seconds)

    def load(self, cell: Cell) -> Kept | None:
        """A cell that was finished before and is still valid; None if there is none."""
        path = self.path(cell)
        content = _read_json(config_path(path))
        record = content.pop("cell", None)
        if not isinstance(record, dict):
            return None
        if record.get("fingerprint") != fingerprint(cell, self.settings):
            return None
        try:
            commands = read_commands(path)
        except SmoothOperatorError:
            return None
        metrics, fingers = record.get("metrics"), record.get("fingers")
        if not (isinstance(metrics, dict) and isinstance(fingers, dict)):
            return None
        if record.get("commands") != _digest(commands):
            return None
        return Kept(commands, metrics, fingers, content, record.get("seconds"))

    def save_latency(self, cell: Cell, latency: Latency) -> None:
        """Keeps the latency of a cell.

        Raises:
            OutputError: it can't be written.
        """
        content = {
            "fingerprint": self._latency_fingerprint(cell),
            "samples_ms": latency.samples_ms,
            "first_ms": latency.first_ms,
            "warm_up": latency.warm_up,
            "load": latency.load,
            "others": latency.others,
        }
        write_json(self._latency_path(cell), content)

    def load_latency(self, cell: Cell) -> Latency | None:
        """The latency of a cell, measured before on this kind of machine; None if there is none."""
        content = _read_json(self._latency_path(cell))
        if content.get("fingerprint") != self._latency_fingerprint(cell):
            return None
        try:
            return Latency(
                np.array(content["samples_ms"], np.float64),
                content["first_ms"],
                content["warm_up"],
                content["load"],
                content["others"],
            )
        except (KeyError, ValueError, TypeError):
            return None

    def _latency_path(self, cell: Cell) -> Path:
        return self.path(cell).with_suffix(".latency.json")

    def _latency_fingerprint(self, cell: Cell) -> str:
        machine = [self.environment[key] for key in ("cpu", "cpu_cores", "device", "versions")]
        words = [fingerprint(cell, self.settings), self.settings.latency_frames, machine]
        return hashlib.sha256(to_json(words).encode()).hexdigest()


def write_json(path: Path, content: object, indent: int | None = None) -> None:
    """Writes JSON, whole or not at all.

    Raises:
        OutputError: it can't be written.
    """
    with atomic_write(path) as file:
        file.write(to_json(content, indent=indent).encode() + b"\n")


def _read_json(path: Path) -> dict[str, Any]:
    """An object in a JSON file; empty where there is none or it is something else."""
    try:
        content = read_json(path)
    except (OSError, ValueError):
        return {}
    return dict(content) if isinstance(content, Mapping) else {}


def _digest(commands: CommandTrajectory) -> str:
    total = hashlib.sha256("\n".join(commands.joint_names).encode())
    for array in (commands.joint_positions, commands.stamps, commands.status):
        total.update(np.ascontiguousarray(array, "<f8").tobytes())
    return total.hexdigest()
