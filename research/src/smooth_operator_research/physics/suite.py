"""Runs the cases of measures in workers, and stores each result as soon as it is complete."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from importlib.util import find_spec
from typing import Any, Final

from smooth_operator.atomic_files import write_json
from smooth_operator.cli.outputs import CONFIG, check_folder
from smooth_operator.errors import UnknownNameError
from smooth_operator.formats.environment import environment
from smooth_operator.parallel import TaskResult, run_tasks
from smooth_operator.planning import PROGRAM
from smooth_operator.reporter import Reporter
from smooth_operator.result_cache import (
    Job,
    JobResult,
    compute_results,
    content_digest,
    find_results,
    outside_code,
)
from smooth_operator_benchmark.cells import (
    benchmark_code,
    files_of,
    hand_identity,
    select_methods,
)
from smooth_operator_research.code import research_digest
from smooth_operator_research.physics.measure import (
    Case,
    Clip,
    Measure,
    Measured,
    PhysicsSettings,
    clip_of_record,
    clip_record,
)
from smooth_operator_research.physics.results import MeasureResults, Row
from smooth_operator_study.result_log import ResultLog

MEASURES: Final[dict[str, tuple[str, str]]] = {
    "reachable": ("reachable_motion", "ReachableMotion"),
    "demonstrations": ("demonstrations", "Demonstrations"),
    "pinch": ("grasp_measures", "PinchHold"),
    "grasp": ("grasp_measures", "PowerGrasp"),
    "operators": ("virtual_operators", "VirtualOperators"),
}
"""Name -> module of this package and class in it, in the order of the report. A new measure needs a
file and a line here."""


def measure_names() -> tuple[str, ...]:
    """Names of the available measures."""
    home = "smooth_operator_research.physics"
    return tuple(n for n, (module, _) in MEASURES.items() if find_spec(f"{home}.{module}"))


def find_measure(name: str) -> Measure:
    """Finds a measure by its name."""
    if name not in measure_names():
        raise UnknownNameError("measure", name, measure_names())
    module, kind = MEASURES[name]
    measure: Measure = getattr(import_module(f"smooth_operator_research.physics.{module}"), kind)()
    return measure


COMMAND: Final = "bench --physics"
CASES: Final = "cases.jsonl"
"""File of the stored results, one line per case."""


_CODE: Final = ("physics", "demonstrations", "virtual_operator", "simulation", "synthetic")
"""Folders, here or in ``smooth_operator``, on which a row depends besides the methods."""


@dataclass(frozen=True, eq=False)
class MeasureOutcome:
    """Results of a measure.

    Attributes:
        measure: the measure.
        results: its rows.
        clips: hand, side and condition -> method as in tables -> clip of one unit.
    """

    measure: Measure
    results: MeasureResults
    clips: Mapping[tuple[str, str, str], Mapping[str, Clip]]


def plan_cases(settings: PhysicsSettings) -> dict[str, list[Case]]:
    """Plans the cases of each measure; reads recordings, writes nothing."""
    check_folder(settings.output, COMMAND, f"an earlier {COMMAND}")
    planned: dict[str, list[Case]] = {}
    for name in settings.measures or measure_names():
        measure = find_measure(name)
        units, conditions = measure.units(settings), measure.conditions(settings)
        planned[name] = [
            Case(
                name,
                hand,
                settings.side,
                choice.method,
                choice.preset,
                choice.config,
                condition,
                unit,
                settings.seed,
                settings.quick,
                clip=unit is units[0],
            )
            for hand in settings.hands
            for choice in select_methods(settings.methods)
            for condition in conditions
            for unit in units
        ]
    return planned


def run_cases(
    settings: PhysicsSettings,
    planned: Mapping[str, Sequence[Case]],
    reporter: Reporter | None = None,
) -> list[MeasureOutcome]:
    """Runs all cases that an earlier run in the folder has not finished.

    A case that fails has a reason instead of figures, and the others continue. A stopped run loses
    only the cases that were running.

    Args:
        planned: result of ``plan_cases``.
        reporter: receives the progress, and the stored results that can't be used.

    Returns:
        The outcome of each measure, with rows in the order of the cases.
    """
    config = {"program": PROGRAM, "command": COMMAND, "settings": settings, **environment()}
    write_json(settings.output / CONFIG, config, indent=2)
    reporter = Reporter() if reporter is None else reporter
    log = ResultLog(settings.output / CASES, partial(reporter.note, matters=True))
    return [_run_measure(name, cases, settings, log, reporter) for name, cases in planned.items()]


def _run_measure(
    name: str, cases: Sequence[Case], settings: PhysicsSettings, log: ResultLog, reporter: Reporter
) -> MeasureOutcome:
    measure = find_measure(name)
    results, missing = find_results([_job(measure, case) for case in cases], log)
    done: dict[tuple[str, ...], JobResult[Case]] = {r.job.task.key: r for r in results}

    def execute(tasks: Sequence[Case]) -> Iterable[TaskResult[Measured]]:
        return run_tasks(run_case, tasks, workers=settings.workers, cluster=settings.cluster)

    with reporter.counting(name, len(cases), "cases", done=len(results)) as advance:
        for result in compute_results(missing, log, execute, _to_keep):
            done[result.job.task.key] = result
            advance(label=result.job.label, reason=result.error)
    rows: list[Row] = []
    clips: dict[tuple[str, str, str], dict[str, Clip]] = {}
    for case in cases:
        result = done[case.key]
        rows.append(_row(case, result))
        if result.value is not None and result.value["clip"] is not None:
            shown = clips.setdefault((case.hand_name, case.side, case.condition), {})
            shown[case.method_label] = clip_of_record(result.value["clip"])
    return MeasureOutcome(measure, MeasureResults(measure.figures, rows), clips)


def run_case(case: Case) -> Measured:
    """Runs a case in a worker."""
    return find_measure(case.measure).run(case)


def _job(measure: Measure, case: Case) -> Job[Case]:
    unit = case.unit
    key = {
        "case": case.key,
        "hand": hand_identity(case.hand_name, case.side, ()),
        "config": case.config,
        "unit": unit.name if unit.key is None else unit.key,
        "seed": case.seed,
        "quick": case.quick,
        "clip": case.clip,
        "files": [content_digest(path) for path in files_of(case.config)],
        "outside": outside_code(case.config, measure),
    }
    code = benchmark_code() + research_digest(*_CODE)
    return Job("-".join(case.key), key, code, case, case.label, unit.effort)


def _to_keep(job: Job[Case], result: TaskResult[Measured]) -> dict[str, Any] | None:
    if result.value is None:
        return None
    clip = None if result.value.clip is None else clip_record(result.value.clip)
    return {"row": result.value.row, "clip": clip, "seconds": round(result.seconds, 3)}


def _row(case: Case, result: JobResult[Case]) -> Row:
    value = result.value
    row: Row = {
        "measure": case.measure,
        "hand": case.hand_name,
        "side": case.side,
        "method": case.method,
        "preset": case.preset,
        "condition": case.condition,
        "unit": case.unit.name,
        "status": "error" if value is None else "ok",
        "reason": (result.error or "it returned nothing") if value is None else None,
    }
    return row if value is None else row | value["row"]


def failed_rows(outcomes: Iterable[MeasureOutcome]) -> Iterator[Row]:
    """Rows that have a reason instead of figures."""
    for outcome in outcomes:
        yield from (row for row in outcome.results.rows if row["status"] != "ok")
