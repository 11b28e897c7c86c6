"""Tables of research/docs/smooth-appendix.md: what each part of ``smooth`` is worth.

    python -m smooth_operator_research.judging.method_tables --data RECORDINGS
    python -m smooth_operator_research.judging.method_tables without fronts --data RECORDINGS \
        --rows self-collision lag
    python -m smooth_operator_research.judging.method_tables alone --recordings glove.npz@:500 \
        synthetic:7 --preset mine.toml

Tables are ``without`` (each part taken out of the whole), ``alone`` (each part added to nothing),
``fronts`` (what is traded for what, with a picture) and ``hands`` (against sbr on other hands, with
the lines of "better than sbr" that are missed); all of them, if none is named. With ``--data`` a
cell holds the folder's glove recording (frames 0-499), ``human_alex`` (the first 1749) and 12 s of
the built-in operator; without it the built-in operator alone. What rows change is in
``smooth_parts``, as data. What was measured is kept: the same command, or one with another row,
goes on where the last one stopped, as long as the method's own code is the same.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

import tyro

from smooth_operator import SmoothOperatorError
from smooth_operator.compilation.start import dispatch_here
from smooth_operator.formats.jsonable import to_json
from smooth_operator.formats.setting_paths import numeric_settings, with_settings, with_unchecked
from smooth_operator.lab.benchmark.cells import Cell, hand_identity
from smooth_operator.lab.benchmark.recordings import SYNTHETIC, Source, load_sources, parse_request
from smooth_operator.lab.benchmark.settings import Choice, method_label, select_methods
from smooth_operator.lab.tuning.pareto import (
    ALL_VECTORS,
    COLLISION,
    FLATNESS,
    MOTION,
    PINCH,
    THUMB,
    VELOCITY,
    Axis,
    TradeOff,
    save_trade_offs,
)
from smooth_operator.lab.tuning.score import figure
from smooth_operator.lab.tuning.trial import TrialTask, run_trial
from smooth_operator.methods.method import MethodConfig
from smooth_operator.parallel import TaskResult, run_tasks
from smooth_operator.result_cache import (
    Job,
    ResultCache,
    ResultLog,
    compute_results,
    find_results,
)
from smooth_operator_research.judging.judge import (
    GLOVE,
    OTHERS,
    CellFigures,
    code_of,
    measure_cells,
    warn,
)
from smooth_operator_research.judging.targets import SBR, judge_hand
from smooth_operator_research.run_report import RESULTS, BenchmarkError, Report

Values = Mapping[str, float]
"""Path of a setting -> its value; the others are those of the preset."""
Row = tuple[str, str]
"""Table and name of a row."""
Found = Mapping[Row, Sequence[Mapping[str, Any] | None]]
"""Row -> figures on each recording; None where it failed."""


@dataclass(frozen=True, eq=False)
class Variants:
    """What is measured, but for the rows.

    Attributes:
        config: whose settings rows change.
        sources: recordings.
        hand: robot hand.
        like_any_value: settings whose 0 a compiled program takes as it takes any value. Other
            zeros mean that something is left out while it is compiled, and cost a program.
        seed: of the method's random numbers.
        workers: processes; 0 for none.
        log: file of the rows that were measured.
    """

    config: MethodConfig
    sources: tuple[Source, ...]
    hand: str
    like_any_value: frozenset[str]
    seed: int
    workers: int
    log: Path

    @property
    def key(self) -> dict[str, Any]:
        """What the figures of a row depend on but for its values and for code."""
        return {
            "config": self.config,
            "hand": [hand_identity(self.hand, source.side, ()) for source in self.sources],
            "frames": [source.digest for source in self.sources],
            "seed": self.seed,
        }

    def task(self, values: Values) -> TrialTask:
        """A row, its values arguments of a compiled program as far as they can be."""
        constant = {
            path: value
            for path, value in values.items()
            if isinstance(value, int) or (value == 0 and path not in self.like_any_value)
        }
        return TrialTask(
            tuple(source.request for source in self.sources),
            tuple(source.digest for source in self.sources),
            self.hand,
            with_unchecked(self.config, constant),  # checked before, with the others
            {path: value for path, value in values.items() if path not in constant},
            self.seed,
        )


def full_values(config: MethodConfig, rows: Mapping[Row, Values]) -> dict[Row, Values]:
    """Row -> the values there of all settings that any row changes.

    Raises:
        BenchmarkError: a row names a setting that is none, or a value that can't be.
    """
    paths = dict.fromkeys(path for values in rows.values() for path in values)
    full: dict[Row, Values] = {}
    for (table, name), values in rows.items():
        try:
            now = numeric_settings(with_settings(config, values))
        except SmoothOperatorError as error:
            raise BenchmarkError(f"row {name!r} of {table!r} can't be: {error}") from error
        full[table, name] = now
    return {row: {path: now[path] for path in paths} for row, now in full.items()}


def measure_rows(variants: Variants, rows: Mapping[Row, Values]) -> tuple[Found, list[str]]:
    """Measures what is not known; rows of the same values are measured once.

    Args:
        variants: what is measured, but for the rows.
        rows: row -> what it changes.

    Returns:
        the figures, and why rows failed.
    """
    full = full_values(variants.config, rows)
    log, code = ResultLog(variants.log), code_of(variants.config)
    preset = numeric_settings(variants.config)
    rows_of: dict[str, Row] = {}
    for row, values in full.items():
        rows_of.setdefault(to_json(values), row)
    tasks = {key: variants.task(full[row]) for key, row in rows_of.items()}
    # those of one program one after the other, so that a worker compiles it once
    order = sorted(tasks, key=lambda key: to_json(tasks[key].config))
    jobs = [
        Job(key, [variants.key, _changed(full[rows_of[key]], preset)], code, tasks[key])
        for key in order
    ]
    finished, missing = find_results(jobs, log)
    if missing:
        programs = len({to_json(job.task.config) for job in missing})
        print(
            f"rows to measure: {len(missing)}, kept: {len(finished)}; "
            f"programs to compile: {programs}",
            file=sys.stderr,
        )
    metrics: dict[str, Any] = {one.job.name: one.value["metrics"] for one in finished if one.value}
    failures: list[str] = []

    def execute(tasks: Sequence[TrialTask]) -> Iterable[TaskResult[Any]]:
        return run_tasks(run_trial, tasks, workers=variants.workers)

    def line(job: Job[TrialTask], result: TaskResult[Any]) -> dict[str, Any] | None:
        return None if result.value is None else {"metrics": result.value}

    for done, result in enumerate(compute_results(missing, log, execute, line), 1):
        table, name = rows_of[result.job.name]
        if result.value is None:
            failures.append(f"{name} ({table}) failed: {result.error}")
        else:
            metrics[result.job.name] = result.value["metrics"]
        reason = "" if result.error is None else f": {result.error}"
        print(f"{done} of {len(missing)}: {table}, {name}{reason}", file=sys.stderr)
    nothing = [None] * len(variants.sources)
    figures = {row: list(metrics.get(to_json(v)) or nothing) for row, v in full.items()}
    return figures, failures


def _changed(values: Values, preset: Values) -> dict[str, float]:
    """Those that are not the preset's own: by them a row is known, whatever the others are."""
    return {path: value for path, value in values.items() if value != preset[path]}


# -- how figures are written ----------------------------------------------------------------------


@dataclass(frozen=True)
class Column:
    """A figure in the tables: how it is written with others in a cell, and alone."""

    name: str
    metric: str
    beside: Callable[[float], str]
    alone: Callable[[float], str]
    unit: str = ""

    def cell(self, values: Sequence[float | None]) -> str:
        """The values of a row, those that were not measured left out."""
        finite = [value for value in values if value is not None]
        write = self.beside if len(values) > 1 else self.alone
        return " / ".join(write(value) for value in finite) + self.unit if finite else "–"


def _fixed(digits: int) -> Callable[[float], str]:
    return lambda value: f"{value:.{digits}f}"


def _short(digits: int) -> Callable[[float], str]:
    return lambda value: f"{value:.{digits}f}".removeprefix("0")


def _power(value: float) -> str:
    mantissa, _, exponent = f"{value:.1e}".partition("e")
    return f"{mantissa}e{int(exponent)}"


def _percent(value: float) -> str:
    return f"{100 * value:.0f}"


COLUMNS = (
    Column("cos thumb", "cosine_similarity", _short(4), _fixed(4)),
    Column("cos all", "cosine_similarity_all", _short(4), _fixed(4)),
    Column("motion", "motion_preservation", _short(3), _fixed(3)),
    Column("flatness [m²]", "flatness", _power, _power),
    Column("vel. corr.", "velocity_correlation", _short(3), _fixed(3)),
    Column("collision", "self_collision.share", _percent, _percent, " %"),
    Column("pinch [mm]", "pinch_error_mm", _fixed(1), _fixed(1)),
)
HEADER = tuple(column.name for column in COLUMNS)


def figures_of(metrics: Mapping[str, Any] | None) -> dict[str, float | None]:
    """Metric of a column -> figure."""
    return {c.metric: None if metrics is None else figure(metrics, c.metric) for c in COLUMNS}


def cells_of(figures: Sequence[Mapping[str, float | None]]) -> list[str]:
    """A row of the tables from the figures on each recording."""
    return [column.cell([one[column.metric] for one in figures]) for column in COLUMNS]


TARGETS = "objective.targets"
VECTORS = "direction_length"
SQUARED = 0.02
"""``huber_width`` [m] beyond any length error of a pinch: the cost is a parabola there."""
WITHOUT: dict[str, Values] = {
    "motion term": {"motion_weight": 0.0},
    "its decrease with speed (s → ∞)": {"motion_speed": 1e6},
    "self-collision cost": {"self_collision.weight": 0.0},
    "weights by kind (all 1)": {
        f"{TARGETS}.w_wrist": 1.0, f"{TARGETS}.w_thumb": 1.0, f"{TARGETS}.w_between": 1.0,
    },
    "focus (powers 0)": {f"{TARGETS}.focus": 0.0, f"{TARGETS}.focus_between": 0.0},
    "velocity term": {"objective.velocity_weight": 0.0},
    "lag": {"landmarks.time_constant": 0.0},
    "jump threshold": {"landmarks.jump_threshold": 1e9},
    "its growth with noise": {"landmarks.noise": 0.0},
    "direction cost": {f"{VECTORS}.direction": 0.0},
    "length cost": {f"{VECTORS}.length": 0.0},
    "its linear form (squared instead)": {
        f"{VECTORS}.length": 1000.0, f"{VECTORS}.huber_width": SQUARED,
    },
    "targets apart": {f"{TARGETS}.apart": 0.0},
    "pose term (γ = 0.0005)": {"objective.pose_weight": 0.0005},
}  # fmt: skip
"""Part -> settings with which it is out of the whole."""

ALWAYS_IN = ("pose term (γ = 0.0005)", "its linear form (squared instead)")
"""Parts that stay where nothing else is left."""

ALONE: dict[str, tuple[str, ...]] = {
    "motion term, constant": ("motion term",),
    "motion term, decreasing with speed": ("motion term", "its decrease with speed (s → ∞)"),
    "self-collision cost": ("self-collision cost",),
    "weights by kind": ("weights by kind (all 1)",),
    "focus": ("focus (powers 0)",),
    "velocity term": ("velocity term",),
    "lag": ("lag",),
    "jump threshold": ("jump threshold",),
    "jump threshold, growing with noise": ("jump threshold", "its growth with noise"),
    "direction cost": ("direction cost",),
    "length cost": ("length cost",),
    "direction and length costs": ("direction cost", "length cost"),
}
"""Name -> which of those above are put back into nothing."""


@dataclass(frozen=True)
class Front:
    """Two things that can't be had together.

    Attributes:
        title: what they are.
        setting: what is changed.
        rows: name -> settings.
        x, y: how they stand against each other in the picture.
        without: part whose row of ``without`` is a point of the picture, too.
    """

    title: str
    setting: str
    rows: Mapping[str, Values]
    x: Axis
    y: Axis
    without: str | None = None


FRONTS = (
    Front(
        "Smooth against correlated",
        "lag, jump threshold",
        {  # a jump_speed would widen a threshold of 0.05 m at 30 Hz
            f"lag {1e3 * lag:g} ms, jump {'∞' if jump > 1e3 else f'{jump:g}'}": {
                "landmarks.time_constant": lag, "landmarks.jump_threshold": jump,
                "landmarks.jump_speed": 0.0, "landmarks.noise": 0.0,
            }
            for lag, jump in ((0.0, 1e9), (5e-4, 0.2), (1.75e-3, 0.2), (1.75e-3, 0.1),
                              (1.75e-3, 0.05), (4e-3, 0.1), (4e-3, 0.05), (8e-3, 0.1))
        },
        FLATNESS,
        VELOCITY,
    ),
    Front(
        "Accurate against moving",
        "weight of the motion term",
        {f"w_m = {w:g}": {"motion_weight": w} for w in (50.0, 150.0, 400.0, 1500.0)},
        ALL_VECTORS,
        MOTION,
    ),
    Front(
        "Accurate against collision-free",
        "weight of the self-collision cost",
        {f"w_c = {w:g}": {"self_collision.weight": w} for w in (300.0, 1000.0, 3000.0, 20000.0)},
        COLLISION,
        THUMB,
        without="self-collision cost",
    ),
    Front(
        "Direction against pinch gap",
        "weights of direction and length",
        {
            f"direction {d:g}, length {w:g}": {f"{VECTORS}.direction": d, f"{VECTORS}.length": w}
            for d, w in ((0.0, 0.0), (0.5, 115.0), (1.0, 115.0), (1.5, 200.0), (1.5, 50.0),
                         (2.0, 0.0))
        }
        | {
            f"direction 1.5, length {w:g}, squared": {
                f"{VECTORS}.direction": 1.5, f"{VECTORS}.length": w,
                f"{VECTORS}.huber_width": SQUARED,
            }
            for w in (3000.0, 6000.0)
        },
        PINCH,
        THUMB,
    ),
)  # fmt: skip

LIKE_ANY_VALUE = frozenset({
    "motion_weight", "self_collision.weight", f"{TARGETS}.focus", f"{TARGETS}.focus_between",
    "objective.velocity_weight", "objective.pose_weight", "landmarks.time_constant",
    "landmarks.jump_speed", "landmarks.noise", f"{VECTORS}.direction", f"{VECTORS}.length",
    f"{TARGETS}.apart",
})  # fmt: skip
"""Settings whose 0 needs no separate program, see ``setting_rows``."""

TUNED_ON = {
    "glove, frames 0–499": f"{GLOVE}@0:500",
    "human_alex, frames 0–1748": "human_alex_21x3.npy@30hz,0:1749",
    "synthetic operator 11": "synthetic:11@0:1200",
}
HANDS_ON = {
    "glove 0–499": f"{GLOVE}@0:500",
    "synthetic 11, 10 s": "synthetic:11@0:1000",
    "alex 0–599": "human_alex_21x3.npy@30hz,0:600",
}
HANDS = ("allegro_hand", "leap_hand", "shadow_hand", "inspire_hand")


METHOD = "smooth"

Part = Literal["without", "alone", "fronts", "hands"]
TITLES = {
    "without": "Each part taken out of the whole",
    "alone": "Each part alone, added to nothing but keyvectors of weight 1 and the pose term",
}
WHOLE, NOTHING = "**all of it**", "**none of it**"


@dataclass(frozen=True)
class Settings:
    """What to measure.

    Attributes:
        parts: which tables.
        data: folder of the recordings that the method was tuned on.
        recordings: others instead of these, named as for ``smooth-operator bench``.
        preset: preset of the method, or preset file.
        rows: of the tables but ``hands``, the rows whose name holds one of these words, and the
            first.
        hand: robot hand of all but ``hands``.
        hands: robot hands of ``hands``.
        others: methods that the picture shows with the fronts.
        workers: processes; 0 for none.
        seed: of the methods' random numbers.
        cache: folder of what was measured before.
        output: JSON file; Markdown and picture of the fronts stand next to it.
        compare: an earlier JSON file to compare this run with.
    """

    parts: Annotated[tuple[Part, ...], tyro.conf.Positional] = get_args(Part)
    data: Path | None = None
    recordings: tuple[str, ...] = ()
    preset: str | None = "precise"
    rows: tuple[str, ...] = ()
    hand: str = "mimic_p050"
    hands: tuple[str, ...] = HANDS
    others: tuple[str, ...] = OTHERS
    workers: int = 2
    seed: int = 0
    cache: Path = RESULTS / "judged"
    output: Path = RESULTS / "method.json"
    compare: Path | None = None


def main(settings: Settings) -> None:
    """Measures what is not kept, and writes tables and pictures."""
    dispatch_here()
    chosen = select_methods((f"{METHOD}:{settings.preset}" if settings.preset else METHOD,))[0]
    rows = rows_of(settings)
    full_values(chosen.config, rows)  # a row that can't be is said before anything is measured
    others = select_methods(settings.others) if "fronts" in settings.parts else []
    report = Report("method", vars(settings))
    settings.cache.mkdir(parents=True, exist_ok=True)
    settings.output.parent.mkdir(parents=True, exist_ok=True)
    if rows:
        sources = recordings(settings, TUNED_ON)
        variants = Variants(
            chosen.config, tuple(sources.values()), settings.hand, LIKE_ANY_VALUE, settings.seed,
            settings.workers, settings.cache / "method.jsonl",
        )  # fmt: skip
        figures, failures = measure_rows(variants, rows)
        report.notes += failures
        write_rows(report, sources, rows, figures)
        if "fronts" in settings.parts:
            draw_fronts(settings, report, sources, figures, others)
    if "hands" in settings.parts:
        write_hands(settings, report, chosen)
    report.finish(settings.output, settings.compare)
    notes = "".join(f"\n- {note}" for note in report.notes)
    text = f"{report.tables()}\n{notes}\n"
    settings.output.with_suffix(".md").write_text(text, encoding="utf-8")


def recordings(settings: Settings, named: Mapping[str, str]) -> dict[str, Source]:
    """What they are called in tables -> recordings."""
    if settings.recordings:
        named = {text: text for text in settings.recordings}
    result = {}
    for name, text in named.items():
        if not (settings.recordings or text.startswith(SYNTHETIC)):
            if settings.data is None:
                continue
            text = str(settings.data / text)
        sources = load_sources([parse_request(text)])
        if len(sources) != 1:
            raise BenchmarkError(f"{name} holds {len(sources)} recordings: name each by itself")
        result[name] = sources[0]
    return result


# -- rows: one method, other settings -------------------------------------------------------------


def rows_of(settings: Settings) -> dict[Row, Values]:
    """(table, name) -> what is changed; the first row of the whole, wherever it is needed."""
    nothing: dict[str, float] = {}
    for part, values in WITHOUT.items():
        nothing |= {} if part in ALWAYS_IN else values
    tables: dict[str, dict[str, Values]] = {}
    if "without" in settings.parts:
        tables["without"] = {WHOLE: {}} | {f"without {k}": v for k, v in WITHOUT.items()}
    if "alone" in settings.parts:
        tables["alone"] = {NOTHING: nothing}
        for name, parts in ALONE.items():
            back = {path for part in parts for path in WITHOUT[part]}
            others = {path: value for path, value in nothing.items() if path not in back}
            tables["alone"][f"only {name}"] = others
    if "fronts" in settings.parts:
        tables["fronts"] = {WHOLE: {}}  # for the picture, and what is out in one of its points
        tables["fronts"] |= {f.without: WITHOUT[f.without] for f in FRONTS if f.without}
        tables |= {front.title: dict(front.rows) for front in FRONTS}
    words = (*(settings.rows or ("",)), WHOLE, NOTHING)
    return {
        (table, name): values
        for table, rows in tables.items()
        for name, values in rows.items()
        if table == "fronts" or any(word in name for word in words)
    }


def write_rows(
    report: Report, sources: Mapping[str, Source], rows: Iterable[Row], measured: Found
) -> None:
    """Adds the rows to the report, a table for each part."""
    tables: dict[str, list[list[object]]] = {}
    for table, name in rows:
        if table == "fronts":
            continue
        every = [figures_of(metrics) for metrics in measured[table, name]]
        for recording, figures in zip(sources, every, strict=True):
            report.add(f"{table}/{name.strip('*')}/{recording}", figures)
        tables.setdefault(table, []).append([name, *cells_of(every)])
    for table, lines in tables.items():
        report.table(TITLES.get(table, table), ("", *HEADER), lines)
    report.notes.append(f"each cell: {' / '.join(sources)}; pinch where the human does")


def draw_fronts(
    settings: Settings,
    report: Report,
    sources: Mapping[str, Source],
    figures: Found,
    others: Sequence[Choice],
) -> None:
    """A row of panels for each front, a panel for each recording."""
    measured = measure_others(settings, report, list(sources.values()), (settings.hand,), others)
    grid = []
    for front in FRONTS:
        row = []
        for i, (recording, source) in enumerate(sources.items()):
            chosen = figures["fronts", WHOLE][i]
            own = [one[i] for key, one in figures.items() if key[0] == front.title]
            own += [chosen, figures["fronts", front.without][i] if front.without else None]
            tried = [metrics for metrics in own if metrics is not None]
            compared = {
                label: one.metrics
                for (name, _, label), one in measured.items()
                if name == source.name and one.metrics is not None
            }
            marked = {} if chosen is None else {"as chosen": chosen}
            title, called = f"{recording}: {front.setting}", f"settings of {METHOD}"
            row.append(TradeOff(title, front.x, front.y, tried, marked, compared, called))
        grid.append(row)
    picture = settings.output.with_name(f"{settings.output.stem}-fronts.png")
    save_trade_offs(picture, grid)
    print(f"wrote {picture}", file=sys.stderr)


# -- cells: other methods, other hands ------------------------------------------------------------


def measure_others(
    settings: Settings,
    report: Report,
    sources: Sequence[Source],
    hands: Sequence[str],
    choices: Sequence[Choice],
) -> dict[tuple[str, str, str], CellFigures]:
    """(recording, hand, method) -> figures, kept as those of the judge are."""
    cells = [
        Cell(source, hand, choice.method, choice.preset, choice.config)
        for hand in hands
        for choice in choices
        for source in sources
    ]
    figures: dict[tuple[str, str, str], CellFigures] = {}
    cache = ResultCache(settings.cache, warn)
    for one in measure_cells(cells, cache, settings.workers, settings.seed, per_frame=False):
        label = method_label(one.cell.method, one.cell.preset)
        figures[one.cell.source.name, one.cell.hand, label] = one
        if one.fresh:
            print(f"{len(figures)} of {len(cells)}: {one.cell.label}", file=sys.stderr)
        if one.metrics is None:
            report.notes.append(f"{one.cell.label} failed: {one.reason}")
    return figures


def write_hands(settings: Settings, report: Report, chosen: Choice) -> None:
    """Against sbr on other hands, and what of "better than sbr" is missed."""
    sources = recordings(settings, HANDS_ON)
    choices = (*select_methods((SBR,)), chosen)
    labels = [method_label(choice.method, choice.preset) for choice in choices]
    measured = measure_others(settings, report, list(sources.values()), settings.hands, choices)
    rows: list[list[object]] = []
    missed: list[list[object]] = []
    count = 0
    for hand in settings.hands:
        for recording, source in sources.items():
            both = [measured[source.name, hand, label].metrics for label in labels]
            for label, metrics in zip(labels, both, strict=True):
                figures = figures_of(metrics)
                report.add(f"hands/{hand}/{recording}/{label}", figures)
                rows.append([f"`{hand}`", recording, f"`{label}`", *cells_of([figures])])
            if both[0] is None or both[1] is None:
                continue
            for line in judge_hand(both[1], both[0]):
                if line.passed is None:
                    continue
                count += 1
                where = f"hands/{hand}/{recording}/better/{line.name}"
                report.add(where, {"passed": float(line.passed)})
                if not line.passed:
                    name = f"{line.name} [{line.unit}]" if line.unit else line.name
                    missed.append([f"`{hand}`", recording, name, line.reached, line.asked])
    report.table("Other hands", ("hand", "recording", "", *HEADER), rows, texts=3)
    header = ("hand", "recording", "line", labels[1], labels[0])
    report.table(f"Not better than {SBR}: {len(missed)} of {count} lines", header, missed, texts=3)


if __name__ == "__main__":
    try:
        main(tyro.cli(Settings, description=__doc__))
    except SmoothOperatorError as error:
        raise BenchmarkError(str(error)) from error
    except KeyboardInterrupt:
        print("stopped; what was measured is kept: the same command goes on", file=sys.stderr)
        sys.exit(130)
