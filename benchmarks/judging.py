"""What ``judge.py`` measures and keeps: figures of methods, and what those depend on."""

from __future__ import annotations

import ast
import hashlib
import json
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import smooth_operator
from smooth_operator.hands.catalogue import load_hand
from smooth_operator.io import to_json
from smooth_operator.lab.benchmark.built import built_for
from smooth_operator.lab.benchmark.cells import Cell, file_name, hand_identity
from smooth_operator.lab.benchmark.store import write_json
from smooth_operator.lab.benchmark.targets import HumanFigures, human_figures
from smooth_operator.lab.offline import execute, measure
from smooth_operator.methods.method import MethodConfig
from smooth_operator.methods.operated import aligned_by
from smooth_operator.methods.request import Plan
from smooth_operator.parallel import run_tasks
from smooth_operator.types import HandRecording

HOME = Path(smooth_operator.__file__).parent
ALL_METHODS = (HOME / "retargeters" / "presets.py", HOME / "offline" / "whole.py")
"""These import every method; what a method is configured to is in its key anyway."""
ALWAYS = ("methods/retargeter.py", "metrics/evaluation.py", "metrics/assemble.py",
          "lab/offline/execution.py")  # fmt: skip
"""What every figure comes from, whatever the method."""
WHOLE = ("lab/offline/frame_goals.py", "lab/offline/segments.py", "solvers/trajectory.py")
"""And that of a preset for whole recordings."""


@dataclass(frozen=True, eq=False)
class Measured:
    """Figures of one cell.

    Attributes:
        cell: recording, hand, method.
        metrics: as evaluate() gives them; None where the method failed.
        human: what the human did, aligned as for the metrics.
        reason: why it failed.
        fresh: measured now.
        stale: kept from other code than the present one.
    """

    cell: Cell
    metrics: dict[str, Any] | None
    human: HumanFigures
    reason: str | None = None
    fresh: bool = False
    stale: bool = False


class Shelf:
    """Measured cells in a folder, one file each.

    A cell is used again where recording, hand and configuration are the same, and every module that
    its method imports, and that the metrics import, is the same to the byte. A new method beside it
    changes none of that.

    Args:
        folder: made if need be.
        stale: use cells of other code, too, where there is nothing else.
    """

    def __init__(self, folder: Path, stale: bool = False) -> None:
        self.folder, self.stale = folder, stale
        folder.mkdir(parents=True, exist_ok=True)

    def load(self, cell: Cell, how: str) -> Measured | None:
        try:
            content = json.loads(self._path(cell, how).read_text(encoding="utf-8"))
            metrics, human = content["metrics"], HumanFigures(**content["human"])
        except (OSError, ValueError, KeyError, TypeError):
            return None  # none, or another version's
        same = content.get("code") == code_of(cell.config)
        return Measured(cell, metrics, human, stale=not same) if same or self.stale else None

    def save(self, measured: Measured, how: str) -> None:
        content = {
            "code": code_of(measured.cell.config),
            "metrics": measured.metrics,
            "human": measured.human,
        }
        write_json(self._path(measured.cell, how), content, indent=1)

    def _path(self, cell: Cell, how: str) -> Path:
        return self.folder / f"{file_name('-'.join(cell.key), (_depends_on(cell), how))}.json"


@dataclass(frozen=True, eq=False)
class _Task:
    """A cell as a worker needs it; ``per_frame`` as in ``measure_cells``."""

    recording: HandRecording
    hand: str
    config: MethodConfig
    seed: int
    per_frame: bool


def measure_cells(
    cells: Sequence[Cell], shelf: Shelf, workers: int | None, seed: int, per_frame: bool
) -> Iterator[Measured]:
    """Those that are kept at once, the others as they are measured.

    Args:
        cells: what to measure.
        shelf: where figures are kept.
        workers: processes, as in run_tasks().
        seed: of the methods' random numbers.
        per_frame: measure the human with the scale of each frame, whatever the method's own is.
    """
    how = f"{seed} {per_frame}"
    todo = []
    for cell in cells:
        kept = shelf.load(cell, how)
        if kept is not None:
            yield kept
        else:
            todo.append(cell)
    # The long ones first, or the last worker would be at one while the others wait.
    todo.sort(key=lambda cell: -len(cell.source.recording or ()))
    tasks = [
        _Task(cell.source.recording, cell.hand, cell.config, seed, per_frame)
        for cell in todo
        if cell.source.recording is not None
    ]
    for result in run_tasks(_figures, tasks, workers=workers) if tasks else ():
        cell = todo[result.index]
        if result.value is None:
            yield Measured(cell, None, HumanFigures(None, None, None), result.error, fresh=True)
            continue
        measured = Measured(cell, *result.value, fresh=True)
        shelf.save(measured, how)
        yield measured


def _figures(task: _Task) -> tuple[dict[str, Any], HumanFigures]:
    """The work of a cell, in a worker."""
    hand = load_hand(task.hand, task.recording.side)
    todo = Plan(task.recording, hand, "", "", task.config, task.seed)
    outcome = execute(todo, built_for(todo))
    if task.per_frame:  # of the human that is measured against, not of the one that was retargeted
        todo = replace(todo, config=aligned_by(task.config, scale=None, operator=None))
    trace, metrics = measure(todo, outcome)
    return metrics, human_figures(trace.human, trace.fingers)


def _depends_on(cell: Cell) -> str:
    content = {
        "frames": cell.source.digest,
        "hand": hand_identity(cell.hand, cell.side, tuple((cell.fingers or {}).items())),
        "method": cell.method,
        "config": cell.config,
    }
    return hashlib.sha256(to_json(content).encode()).hexdigest()


def code_of(config: object) -> str:
    """SHA-256 of all modules of this package that a configuration's method or a metric needs."""
    inner = getattr(config, "causal", config)  # of a preset for whole recordings
    module = type(inner).__module__.removeprefix("smooth_operator.").replace(".", "/")
    return _digest_of((f"{module}.py", *ALWAYS, *(() if inner is config else WHOLE)))


@cache
def _digest_of(names: tuple[str, ...]) -> str:
    total = hashlib.sha256()
    paths = _needed(HOME / name for name in names)
    if set(WHOLE) <= set(names):
        paths |= set(ALL_METHODS[1:])
    for path in sorted(paths):
        total.update(path.relative_to(HOME).as_posix().encode() + b"\0" + path.read_bytes())
    return total.hexdigest()


def _needed(start: Iterable[Path]) -> set[Path]:
    found: set[Path] = set()
    waiting = list(start)
    while waiting:
        path = waiting.pop()
        if path in found or path in ALL_METHODS:
            continue
        found.add(path)
        waiting += _imports(path)
    return found


@cache
def _imports(path: Path) -> tuple[Path, ...]:
    """Modules of this package that one imports, however deep in a function."""
    names = []
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and node.module:
            names += [node.module, *(f"{node.module}.{alias.name}" for alias in node.names)]
        elif isinstance(node, ast.Import):
            names += [alias.name for alias in node.names]
    paths = (
        HOME.joinpath(*name.split(".")[1:]).with_suffix(".py")
        for name in names
        if name.startswith("smooth_operator.")
    )
    return tuple(path for path in paths if path.is_file())
