"""Figures of methods on recordings, kept until the code of their method changes."""

from __future__ import annotations

import inspect
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any

from smooth_operator.atomic_files import file_name
from smooth_operator.hands.registry import load_hand
from smooth_operator.human.alignment import align_recording
from smooth_operator.lab.benchmark.built import built_for
from smooth_operator.lab.benchmark.cells import Cell, hand_identity
from smooth_operator.lab.offline import execute, measure
from smooth_operator.lab.offline.finished import digest
from smooth_operator.methods.method import MethodConfig
from smooth_operator.parallel import TaskResult, run_tasks
from smooth_operator.planning import Plan
from smooth_operator.result_cache import (
    Job,
    ResultCache,
    code_digest,
    imported_modules,
    key_digest,
    run_jobs,
)
from smooth_operator.types import HandRecording
from smooth_operator_research.judging.targets import HumanFigures, human_figures
from smooth_operator_research.judging.truth import (
    AgainstTruth,
    TruthFigures,
    against_truth,
    without_noise,
)


@dataclass(frozen=True, eq=False)
class CellFigures:
    """Figures of one cell.

    Attributes:
        cell: recording, hand, method.
        metrics: as evaluate() gives them; None where the method failed.
        human: what the human did, aligned as for the metrics.
        reason: why it failed.
        fresh: measured now.
        stale: kept from other code than the present one.
        truth: against the operator without noise; None where that isn't known.
    """

    cell: Cell
    metrics: dict[str, Any] | None
    human: HumanFigures
    reason: str | None = None
    fresh: bool = False
    stale: bool = False
    truth: AgainstTruth | None = None


def figures_job(cell: Cell, seed: int, per_frame: bool) -> Job[Cell]:
    """The figures of a cell, to be measured unless they are kept.

    They are found again where recording, hand and configuration are the same, and every module that
    the cell's method imports, and that the metrics import, is the same to the byte. Another method
    that is new or changed makes no difference.

    Args:
        cell: recording, hand, method.
        seed: of the method's random numbers.
        per_frame: measure the human with the scale of each frame, whatever the method's own is.
    """
    key = {
        "frames": cell.source.digest,
        "hand": hand_identity(cell.hand, cell.side, tuple((cell.fingers or {}).items())),
        "method": cell.method,
        "config": cell.config,
        "seed": seed,
        "per_frame": per_frame,
    }
    if cell.source.request.noise:
        key["truth"] = [field.name for field in (*fields(AgainstTruth), *fields(TruthFigures))]
    name = file_name("-".join(cell.key), (key_digest(key),))
    return Job(name, key, code_of(cell.config), cell, cell.label, len(cell.source.recording or ()))


@dataclass(frozen=True, eq=False)
class _Task:
    """A cell as a worker needs it; ``per_frame`` as in ``figures_job``, ``clean`` without noise."""

    recording: HandRecording
    hand: str
    config: MethodConfig
    seed: int
    per_frame: bool
    clean: HandRecording | None = None


def measure_cells(
    cells: Sequence[Cell], cache: ResultCache, workers: int | None, seed: int, per_frame: bool
) -> Iterator[CellFigures]:
    """Those that are kept first, then the others as they are measured.

    Args:
        cells: what to measure; each has a recording.
        cache: where figures are kept.
        workers: processes, as in run_tasks().
        seed: of the methods' random numbers.
        per_frame: as in ``figures_job``.
    """

    def execute(cells: Sequence[Cell]) -> Iterable[TaskResult[Any]]:
        tasks = [
            _Task(
                cell.source.recording, cell.hand, cell.config, seed, per_frame,
                without_noise(cell.source),
            )
            for cell in cells
            if cell.source.recording is not None
        ]  # fmt: skip
        return run_tasks(_figures, tasks, workers=workers)

    jobs = [figures_job(cell, seed, per_frame) for cell in cells]
    for result in run_jobs(jobs, cache, execute):
        cell = result.job.task
        if result.value is None:
            none = HumanFigures(None, None, None)
            yield CellFigures(cell, None, none, result.error, fresh=True)
            continue
        stale = result.job.name in cache.found_by_other_code
        human = HumanFigures(**result.value["human"])
        kept = result.value.get("truth")
        truth = None if kept is None else AgainstTruth.kept(kept)
        yield CellFigures(
            cell, result.value["metrics"], human, fresh=result.fresh, stale=stale, truth=truth
        )


def _figures(task: _Task) -> dict[str, Any]:
    """The work of a cell, in a worker."""
    hand = load_hand(task.hand, task.recording.side)
    todo = Plan(task.recording, hand, "", "", task.config, task.seed)
    outcome = execute(todo, built_for(todo))
    if task.per_frame:  # of the human that is measured against, not of the one that was retargeted
        todo = replace(todo, config=task.config.with_alignment(scale=None, operator=None))
    trace, metrics = measure(todo, outcome)
    found = {"metrics": metrics, "human": asdict(human_figures(trace.human, trace.fingers))}
    if task.clean is not None:
        clean = align_recording(task.clean, hand, todo.config.alignment)
        found["truth"] = asdict(against_truth(trace, clean))
    return found


def code_of(config: MethodConfig) -> str:
    """Digest of all modules of this package that a configuration's method or a metric needs."""
    inner = config if config.trajectory is None else config.trajectory.causal
    home, _, module = type(inner).__module__.partition(".")
    if home != "smooth_operator":  # of a plugin: its own file stands for it
        plugin = digest(Path(inspect.getfile(type(inner))))
        return f"{_code(())} {plugin}"
    return _code((f"{module.replace('.', '/')}.py",), whole=inner is not config)


def _code(method: tuple[str, ...], whole: bool = False) -> str:
    needed = imported_modules(
        *method,
        # What every figure comes from, whatever the method.
        "methods/retargeter.py",
        "metrics/evaluation.py",
        "metrics/assemble.py",
        "lab/offline/execution.py",
        # These know every method; what one is configured to is in its key anyway.
        leave_out=(
            "methods/__init__.py", "methods/presets.py", "lab/offline/trajectory_retargeter.py",
        ),
    )  # fmt: skip
    if not whole:
        return code_digest(*needed)
    more = imported_modules(
        "methods/frame_goals.py", "lab/offline/segments.py", "lab/offline/trajectory_solver.py"
    )
    return code_digest(*sorted({*needed, *more}), "lab/offline/trajectory_retargeter.py")
