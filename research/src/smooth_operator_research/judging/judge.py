"""One method or more against all others, target by target, recording by recording.

    python -m smooth_operator_research.judging.judge smooth --data RECORDINGS
    python -m smooth_operator_research.judging.judge smooth:offline mine:tuned.toml \
        glove.npz@0:500 synthetic:7@1mm
    python -m smooth_operator_research.judging.judge smooth --data RECORDINGS --hand allegro_hand

Words with the name of a method in front (METHOD, METHOD:PRESET, METHOD:FILE.toml) are judged; all
others are recordings, named as for ``smooth-operator bench``. With ``--data`` the folder's glove
recording (frames 0-499, 2600-3099, whole), ``human_alex`` and ``wilor_test_long`` are judged, and
three synthetic operators: clean, and with 0.5 and 1 mm of tracker noise. The targets are those of
``smooth_operator_research.judging.targets``: against every other method for the mimic hand, "better
than sbr" for other hands. The other methods' figures are kept, and measured again only where
their own code, or that of a metric, has changed.

Noise counts as the human's motion in these targets, so an operator with noise has a column more:
the same runs, of all methods, against the same operator without it. A table has the motion of each.
"""

from __future__ import annotations

import inspect
import sys
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Annotated, Any, Literal, TypeAlias

import tyro

from smooth_operator import SmoothOperatorError
from smooth_operator.atomic_files import file_name
from smooth_operator.compilation.start import dispatch_here
from smooth_operator.hands.registry import load_hand
from smooth_operator.human.alignment import align_recording
from smooth_operator.lab.benchmark.built import built_for
from smooth_operator.lab.benchmark.cells import Cell, hand_identity
from smooth_operator.lab.benchmark.latency import measure_latency
from smooth_operator.lab.benchmark.recordings import Source, load_sources, parse_request
from smooth_operator.lab.benchmark.settings import Choice, method_label, select_methods
from smooth_operator.lab.offline import execute, measure
from smooth_operator.lab.offline.finished import digest
from smooth_operator.methods.method import MethodConfig
from smooth_operator.methods.presets import PRESETS
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
from smooth_operator_research.judging.targets import (
    SBR,
    AgainstTruth,
    HumanFigures,
    TargetLine,
    TruthFigures,
    against_truth,
    human_figures,
    judge,
    judge_hand,
    without_noise,
)
from smooth_operator_research.run_report import RESULTS, BenchmarkError, Report, markdown


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
        truth_record = result.value.get("truth")
        truth = None if truth_record is None else AgainstTruth.kept(truth_record)
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
    figures = {"metrics": metrics, "human": asdict(human_figures(trace.human, trace.fingers))}
    if task.clean is not None:
        clean = align_recording(task.clean, hand, todo.config.alignment)
        figures["truth"] = asdict(against_truth(trace, clean))
    return figures


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
        "methods/method.py", "lab/offline/segments.py", "lab/offline/trajectory_solver.py"
    )
    return code_digest(*sorted({*needed, *more}), "lab/offline/trajectory_retargeter.py")


GLOVE = "manus_right_subject-000_run-010.npz"
FILES = (
    f"{GLOVE}@0:500", f"{GLOVE}@2600:3100", GLOVE, "human_alex_21x3.npy@30hz",
    "wilor_test_long_21x3.npz@30hz",
)  # fmt: skip
OPERATORS = ("synthetic:8101", "synthetic:8102@0.5mm", "synthetic:8103@1mm")
"""Seeds that nothing was tuned on."""
OTHERS = ("sbr", "sbr:paper", "dexpilot", "ako", "keyvector", "hybrid", "joint_angle", "geort")
NOT_TIMED: dict[str, float | None] = dict.fromkeys(("mean", "p50", "p95", "p99", "first"))
OWN_HAND = "mimic_p050"
"""The hand that the targets against every method are for."""


_Table: TypeAlias = tuple[str, Sequence[str], Sequence[Sequence[object]]]
"""Title, header, rows."""


@dataclass(frozen=True)
class Settings:
    """What to judge.

    Attributes:
        words: methods to judge, and recordings.
        data: folder of the recordings that are always judged.
        hand: robot hand.
        lines: all targets, or only "better than sbr"; by the hand, if left out.
        only: of the recordings, those whose name holds one of these words.
        tuned: of the recordings, those whose name holds one of these words were tuned on, and are
            marked so.
        latency: frames of each recording to measure latency over, alone; 0 for none.
        human: scale that the human is measured with: each method's own, or for all alike the one
            of each frame.
        workers: processes; one for each core, if left out.
        stale: use kept figures of other methods though their code has changed since.
        seed: of the methods' random numbers.
        cache: folder of kept figures.
        output: JSON file; a Markdown file of the same name stands next to it.
        compare: an earlier JSON file to compare this run with.
    """

    words: Annotated[tuple[str, ...], tyro.conf.Positional]
    data: Path | None = None
    hand: str = OWN_HAND
    lines: Literal["all", "sbr"] | None = None
    only: tuple[str, ...] = ()
    tuned: tuple[str, ...] = ()
    latency: int = 500
    human: Literal["own", "frame"] = "own"
    workers: int | None = None
    stale: bool = False
    seed: int = 0
    cache: Path = RESULTS / "judged"
    output: Path = RESULTS / "judge.json"
    compare: Path | None = None


def main(settings: Settings) -> None:
    """Measures what is not kept, and writes the verdicts."""
    dispatch_here()
    names = [word for word in settings.words if word.partition(":")[0] in PRESETS]
    if not names:
        raise BenchmarkError(f"name a method to judge: one of {', '.join(PRESETS)}")
    candidates = select_methods(tuple(names))
    sources = recordings(settings, [word for word in settings.words if word not in names])
    kind = settings.lines or ("all" if settings.hand == OWN_HAND else "sbr")
    others = select_methods(OTHERS if kind == "all" else (SBR,))
    measured = measure_methods(settings, sources, candidates, others)
    timed = time_alone(settings, sources, candidates)
    report = Report("judge", vars(settings))
    lines: dict[str, dict[str, list[TargetLine]]] = {}
    for candidate in candidates:
        label = method_label(candidate.method, candidate.preset)
        lines[label] = {}
        for source in sources:
            own = measured[source.name, label]
            if own.metrics is None:
                report.notes.append(f"{label} on {source.name} failed: {own.reason}")
                continue
            theirs = {
                name: cell.metrics
                for name in (method_label(one.method, one.preset) for one in others)
                if name != label and (cell := measured[source.name, name]).metrics is not None
            }
            figures = own.metrics | {"latency_ms": timed.get((source.name, label), NOT_TIMED)}
            lines[label][source.name] = (
                judge(figures, theirs, own.human)
                if kind == "all"
                else judge_hand(figures, theirs.get(SBR, {}))
            )
            if own.truth is not None and kind == "all":
                pairs = {
                    name: truth.metrics
                    for name in theirs
                    if (truth := measured[source.name, name].truth) is not None
                }
                timeless = own.truth.metrics | {"latency_ms": NOT_TIMED}
                against = judge(timeless, pairs, own.truth.human)
                lines[label][f"{source.name}, without noise"] = against
    for one in measured.values():
        if one.stale:
            report.notes.append(f"{one.cell.label}: figures of other code than the present one")
    write(report, settings, lines, measured)


def warn(note: str) -> None:
    """Shows a note on standard error."""
    print(note, file=sys.stderr)


def recordings(settings: Settings, words: Sequence[str]) -> list[Source]:
    """The recordings that are judged."""
    texts = list(words)
    if settings.data is not None:
        texts += [str(settings.data / name) for name in FILES]
    if settings.data is not None or not words:
        texts += OPERATORS
    sources = load_sources([parse_request(text) for text in texts])
    if settings.only:
        sources = [s for s in sources if any(word in s.name for word in settings.only)]
        if not sources:
            raise BenchmarkError(f"no recording's name holds one of {', '.join(settings.only)}")
    for source in sources:
        if source.error is not None:
            raise BenchmarkError(source.error)
    return sources


def cells_of(
    settings: Settings, sources: Sequence[Source], choices: Sequence[Choice]
) -> list[Cell]:
    """Each recording with each method."""
    every = {(c.method, c.preset): c for c in choices}
    return [
        Cell(source, settings.hand, choice.method, choice.preset, choice.config)
        for source in sources
        for choice in every.values()
    ]


def measure_methods(
    settings: Settings,
    sources: Sequence[Source],
    candidates: Sequence[Choice],
    others: Sequence[Choice],
) -> dict[tuple[str, str], CellFigures]:
    """(recording, label) -> figures."""
    cells = cells_of(settings, sources, (*candidates, *others))
    cache = ResultCache(settings.cache, warn, other_code=settings.stale)
    figures: dict[tuple[str, str], CellFigures] = {}
    per_frame = settings.human == "frame"
    for one in measure_cells(cells, cache, settings.workers, settings.seed, per_frame):
        figures[one.cell.source.name, method_label(one.cell.method, one.cell.preset)] = one
        if one.fresh:
            failed = "" if one.reason is None else f": {one.reason}"
            print(f"{len(figures)} of {len(cells)}: {one.cell.label}{failed}", file=sys.stderr)
    return figures


def time_alone(
    settings: Settings, sources: Sequence[Source], candidates: Sequence[Choice]
) -> dict[tuple[str, str], dict[str, float | None]]:
    """(recording, label) -> latency, those to be judged taking turns and nothing else running."""
    times: dict[tuple[str, str], dict[str, float | None]] = {}
    for source in sources if settings.latency else ():
        cells = cells_of(settings, [source], candidates)
        for cell, latency in zip(
            cells,
            measure_latency(cells, settings.latency, settings.seed, lambda cell: None),
            strict=True,
        ):
            times[source.name, method_label(cell.method, cell.preset)] = latency.summary
    return times


def write(
    report: Report,
    settings: Settings,
    lines: dict[str, dict[str, list[TargetLine]]],
    measured: dict[tuple[str, str], CellFigures],
) -> None:
    """Tables of every recording, then one of all; the Markdown file has them the other way."""
    detailed: list[_Table] = []
    overview: list[_Table] = []
    for label, by_recording in lines.items():
        for recording, found_lines in by_recording.items():
            title = f"{label} on {recording}{mark(settings, recording)}, {settings.hand}"
            header = ("target", "asked", "reached", "best other", "verdict", "note")
            detailed.append((title, header, [row(line) for line in found_lines]))
            for line in found_lines:
                prefix = f"{label}/{recording}/{line.name}"
                passed = None if line.passed is None else float(line.passed)
                figures = {"reached": line.reached, "asked": line.asked, "passed": passed}
                report.add(prefix, figures)
        names = dict.fromkeys(
            line.name for found_lines in by_recording.values() for line in found_lines
        )
        rows = []
        for name in names:
            of = {
                r: {x.name: x for x in found_lines}.get(name)
                for r, found_lines in by_recording.items()
            }
            rows.append([name, *(verdict(line) for line in of.values())])
        rows.append(
            ["**missed**", *(str(missed(found_lines)) for found_lines in by_recording.values())]
        )
        names_of = (label, *(f"{name}{mark(settings, name)}" for name in by_recording))
        overview.append((f"{label}, all targets, {settings.hand}", names_of, rows))
    overview += truth_tables(report, measured)
    for title, columns, cells in (*detailed, *overview):
        report.table(title, columns, cells)
    if settings.tuned:
        report.notes.append("tuned on: recordings marked with (t)")
    scale = "each method's own" if settings.human == "own" else "each frame's, for all alike"
    report.notes.append(f"scale of the human: {scale}; ✓ reached, ✗ missed, – does not apply")
    report.finish(settings.output, settings.compare)
    text = "\n".join(
        f"**{title}**\n\n{markdown(columns, cells)}\n"
        for title, columns, cells in (*overview, *detailed)
    )
    notes = "".join(f"- {note}\n" for note in report.notes)
    settings.output.with_suffix(".md").write_text(f"{text}\n{notes}", encoding="utf-8")


def truth_tables(report: Report, measured: dict[tuple[str, str], CellFigures]) -> list[_Table]:
    """For each operator with noise, all methods against the same operator without it."""
    rows: dict[str, dict[str, TruthFigures]] = {}
    for (recording, label), one in measured.items():
        if one.truth is not None:
            rows.setdefault(recording, {"tracked landmarks": one.truth.tracked})
            rows[recording][label] = one.truth.robot
    header = ("", "motion preservation", "velocity correlation", "lag [ms]", "jitter [mm]")
    tables: list[_Table] = []
    for recording, truth_cells in rows.items():
        for label, figures in truth_cells.items():
            report.add(f"truth/{recording}/{label}", asdict(figures))
        cells = [[label, *map(figure, asdict(one).values())] for label, one in truth_cells.items()]
        tables.append((f"Against {recording} without noise", header, cells))
    return tables


def mark(settings: Settings, recording: str) -> str:
    """What is added to the name of a recording that was tuned on."""
    return " (t)" if any(word in recording for word in settings.tuned) else ""


def missed(lines: Sequence[TargetLine]) -> int:
    """How many targets were missed."""
    return sum(line.passed is False for line in lines)


def row(line: TargetLine) -> list[object]:
    """A target as a row of a table."""
    name = f"{line.name} [{line.unit}]" if line.unit else line.name
    goal = "–" if line.asked is None else f"{line.sense} {figure(line.asked)}"
    other = "–" if line.other is None else f"{figure(line.other_value)} {line.other}"
    sign = {True: "✓", False: "✗", None: "–"}[line.passed]
    return [name, goal, figure(line.reached), other, sign, line.note]


def verdict(line: TargetLine | None) -> str:
    """What came of a target, as a cell of the overview."""
    if line is None:
        return "–"
    sign = {True: "✓", False: "✗", None: "–"}[line.passed]
    goal = f" ({figure(line.asked)})" if line.passed is False else ""
    return f"{sign} {figure(line.reached)}{goal}"


def figure(value: float | None) -> str:
    """A number as tables have it."""
    if value is None:
        return "–"
    if value == 0:
        return "0"
    if abs(value) < 1e-3:
        return f"{value:.2e}"
    return f"{value:.4f}" if abs(value) < 2 else f"{value:.3g}"


if __name__ == "__main__":
    try:
        main(tyro.cli(Settings, description=__doc__))
    except SmoothOperatorError as error:
        raise BenchmarkError(str(error)) from error
