r"""Tables of docs/explanation/smooth-appendix.md: what each part of ``smooth`` is worth.

    python -m smooth_operator.lab.judging.method_tables --data RECORDINGS
    python -m smooth_operator.lab.judging.method_tables without fronts --data RECORDINGS \
        --rows self-collision lag
    python -m smooth_operator.lab.judging.method_tables alone --recordings glove.npz@:500 \
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
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal, get_args

import tyro

from smooth_operator import SmoothOperatorError
from smooth_operator.compilation.start import dispatch_here
from smooth_operator.lab.benchmark.cells import Cell
from smooth_operator.lab.benchmark.recordings import SYNTHETIC, Source, load_sources, parse_request
from smooth_operator.lab.benchmark.settings import Choice, method_label, select_methods
from smooth_operator.lab.judging.judge import OTHERS, warn
from smooth_operator.lab.judging.kept_figures import CellFigures, measure_cells
from smooth_operator.lab.judging.setting_rows import (
    HEADER,
    Found,
    Row,
    Values,
    Variants,
    cells_of,
    figures_of,
    full_values,
    measure_rows,
)
from smooth_operator.lab.judging.smooth_parts import (
    ALONE,
    ALWAYS_IN,
    FRONTS,
    HANDS,
    HANDS_ON,
    LIKE_ANY_VALUE,
    TUNED_ON,
    WITHOUT,
)
from smooth_operator.lab.judging.targets import SBR, judge_hand
from smooth_operator.lab.tuning.pareto import (
    TradeOff,
    save_trade_offs,
)
from smooth_operator.reporting.run_report import RESULTS, BenchmarkError, Report
from smooth_operator.result_cache import ResultCache

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
    preset: str | None = None
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
        found, failures = measure_rows(variants, rows)
        report.notes += failures
        write_rows(report, sources, rows, found)
        if "fronts" in settings.parts:
            draw_fronts(settings, report, sources, found, others)
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
    found = {}
    for name, text in named.items():
        if not (settings.recordings or text.startswith(SYNTHETIC)):
            if settings.data is None:
                continue
            text = str(settings.data / text)
        sources = load_sources([parse_request(text)])
        if len(sources) != 1:
            raise BenchmarkError(f"{name} holds {len(sources)} recordings: name each by itself")
        found[name] = sources[0]
    return found


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
            kept = {path: value for path, value in nothing.items() if path not in back}
            tables["alone"][f"only {name}"] = kept
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
    report: Report, sources: Mapping[str, Source], rows: Iterable[Row], found: Found
) -> None:
    """Adds the rows to the report, a table for each part."""
    tables: dict[str, list[list[object]]] = {}
    for table, name in rows:
        if table == "fronts":
            continue
        every = [figures_of(metrics) for metrics in found[table, name]]
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
    found: Found,
    others: Sequence[Choice],
) -> None:
    """A row of panels for each front, a panel for each recording."""
    measured = measure_others(settings, report, list(sources.values()), (settings.hand,), others)
    grid = []
    for front in FRONTS:
        row = []
        for i, (recording, source) in enumerate(sources.items()):
            chosen = found["fronts", WHOLE][i]
            own = [one[i] for key, one in found.items() if key[0] == front.title]
            own += [chosen, found["fronts", front.without][i] if front.without else None]
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
    found: dict[tuple[str, str, str], CellFigures] = {}
    kept = ResultCache(settings.cache, warn)
    for one in measure_cells(cells, kept, settings.workers, settings.seed, per_frame=False):
        label = method_label(one.cell.method, one.cell.preset)
        found[one.cell.source.name, one.cell.hand, label] = one
        if one.fresh:
            print(f"{len(found)} of {len(cells)}: {one.cell.label}", file=sys.stderr)
        if one.metrics is None:
            report.notes.append(f"{one.cell.label} failed: {one.reason}")
    return found


def write_hands(settings: Settings, report: Report, chosen: Choice) -> None:
    """Against sbr on other hands, and what of "better than sbr" is missed."""
    sources = recordings(settings, HANDS_ON)
    choices = (*select_methods((SBR,)), chosen)
    labels = [method_label(choice.method, choice.preset) for choice in choices]
    found = measure_others(settings, report, list(sources.values()), settings.hands, choices)
    rows: list[list[object]] = []
    missed: list[list[object]] = []
    asked = 0
    for hand in settings.hands:
        for recording, source in sources.items():
            both = [found[source.name, hand, label].metrics for label in labels]
            for label, metrics in zip(labels, both, strict=True):
                figures = figures_of(metrics)
                report.add(f"hands/{hand}/{recording}/{label}", figures)
                rows.append([f"`{hand}`", recording, f"`{label}`", *cells_of([figures])])
            if both[0] is None or both[1] is None:
                continue
            for line in judge_hand(both[1], both[0]):
                if line.passed is None:
                    continue
                asked += 1
                where = f"hands/{hand}/{recording}/better/{line.name}"
                report.add(where, {"passed": float(line.passed)})
                if not line.passed:
                    name = f"{line.name} [{line.unit}]" if line.unit else line.name
                    missed.append([f"`{hand}`", recording, name, line.reached, line.asked])
    report.table("Other hands", ("hand", "recording", "", *HEADER), rows, texts=3)
    header = ("hand", "recording", "line", labels[1], labels[0])
    report.table(f"Not better than {SBR}: {len(missed)} of {asked} lines", header, missed, texts=3)


if __name__ == "__main__":
    try:
        main(tyro.cli(Settings, description=__doc__))
    except SmoothOperatorError as error:
        raise BenchmarkError(str(error)) from error
    except KeyboardInterrupt:
        print("stopped; what was measured is kept: the same command goes on", file=sys.stderr)
        sys.exit(130)
