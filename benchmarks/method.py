"""Tables of docs/explanation/smooth.md: what each part of ``smooth`` is worth, and what conflicts.

    python benchmarks/method.py --data RECORDINGS
    python benchmarks/method.py without fronts --data RECORDINGS --rows clearance lag
    python benchmarks/method.py alone --recordings glove.npz@:500 synthetic:7 --preset mine.toml

Tables are ``without`` (each part taken out of the whole), ``alone`` (each part added to nothing),
``fronts`` (what is traded for what, with a picture) and ``hands`` (against sbr on other hands, with
the lines of "better than sbr" that are missed); all of them, if none is named. With ``--data`` a
cell holds the folder's glove recording (frames 0-499), ``human_alex`` (the first 1749) and 12 s of
the built-in operator; without it the built-in operator alone. What rows change stands at the top of
this file, as data. What was measured is kept: the same command, or one with another row, goes on
where the last one stopped, as long as the method's own code is the same.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal, get_args

import tyro
from judge import GLOVE, OTHERS, warn
from judging import Measured, measure_cells
from report import RESULTS, BenchmarkError, Report
from variants import (
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

from smooth_operator import SmoothOperatorError
from smooth_operator.lab.benchmark.cells import Cell
from smooth_operator.lab.benchmark.settings import Choice, method_label, select_methods
from smooth_operator.lab.benchmark.sources import SYNTHETIC, Source, load_sources, parse_request
from smooth_operator.lab.benchmark.targets import SBR, judge_hand
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
from smooth_operator.methods.dispatch import dispatch_here
from smooth_operator.result_cache import ResultCache

METHOD = "smooth"

# -- what is measured: a part more is a line more -------------------------------------------------

TARGETS = "objective.targets"
SQUARED = 0.02
"""``polar.knee`` [m] beyond any pinch that is off in length: the price is a parabola there."""
WITHOUT: dict[str, Values] = {
    "motion term": {"motion_weight": 0.0},
    "its fall with speed (s → ∞)": {"motion_speed": 1e6},
    "clearance": {"clearance.weight": 0.0},
    "weights by kind (all 1)": {
        f"{TARGETS}.w_wrist": 1.0, f"{TARGETS}.w_thumb": 1.0, f"{TARGETS}.w_between": 1.0,
    },
    "focus (powers 0)": {f"{TARGETS}.focus": 0.0, f"{TARGETS}.focus_between": 0.0},
    "velocity term": {"objective.velocity_weight": 0.0},
    "lag": {"landmarks.lag": 0.0},
    "leap": {"landmarks.leap": 1e9},
    "its growth with noise": {"landmarks.noise": 0.0},
    "price of angles": {"polar.direction": 0.0},
    "price of pinches' lengths": {"polar.length": 0.0},
    "its kink (squared instead)": {"polar.length": 1000.0, "polar.knee": SQUARED},
    "targets apart": {f"{TARGETS}.apart": 0.0},
    "pose term (γ = 0.0005)": {"objective.pose_weight": 0.0005},
}  # fmt: skip
"""Part -> settings with which it is out of the whole."""

ALWAYS_IN = ("pose term (γ = 0.0005)", "its kink (squared instead)")
"""Parts that stay where nothing else is left."""

ALONE: dict[str, tuple[str, ...]] = {
    "motion term, constant": ("motion term",),
    "motion term, falling with speed": ("motion term", "its fall with speed (s → ∞)"),
    "clearance": ("clearance",),
    "weights by kind": ("weights by kind (all 1)",),
    "focus": ("focus (powers 0)",),
    "velocity term": ("velocity term",),
    "lag": ("lag",),
    "leap": ("leap",),
    "leap, growing with noise": ("leap", "its growth with noise"),
    "price of angles": ("price of angles",),
    "price of pinches' lengths": ("price of pinches' lengths",),
    "prices of angles and lengths": ("price of angles", "price of pinches' lengths"),
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
        "lag, leap",
        {  # a leap_speed would make leaps of 0.05 m longer at 30 Hz
            f"lag {1e3 * lag:g} ms, leap {'∞' if leap > 1e3 else f'{leap:g}'}": {
                "landmarks.lag": lag, "landmarks.leap": leap, "landmarks.leap_speed": 0.0,
                "landmarks.noise": 0.0,
            }
            for lag, leap in ((0.0, 1e9), (5e-4, 0.2), (1.75e-3, 0.2), (1.75e-3, 0.1),
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
        "Accurate against clear of itself",
        "weight of clearance",
        {f"w_c = {w:g}": {"clearance.weight": w} for w in (300.0, 1000.0, 3000.0, 20000.0)},
        COLLISION,
        THUMB,
        without="clearance",
    ),
    Front(
        "Pointing as the human against closing",
        "prices of angle and length",
        {
            f"direction {d:g}, length {w:g}": {"polar.direction": d, "polar.length": w}
            for d, w in ((0.0, 0.0), (0.5, 115.0), (1.0, 115.0), (1.5, 200.0), (1.5, 50.0),
                         (2.0, 0.0))
        }
        | {
            f"direction 1.5, length {w:g}, squared": {
                "polar.direction": 1.5, "polar.length": w, "polar.knee": SQUARED,
            }
            for w in (3000.0, 6000.0)
        },
        PINCH,
        THUMB,
    ),
)  # fmt: skip

LIKE_ANY_VALUE = frozenset({
    "motion_weight", "clearance.weight", f"{TARGETS}.focus", f"{TARGETS}.focus_between",
    "objective.velocity_weight", "objective.pose_weight", "landmarks.lag",
    "landmarks.leap_speed", "landmarks.noise", "polar.direction", "polar.length",
    f"{TARGETS}.apart",
})  # fmt: skip
"""Settings whose 0 needs no program of its own, see ``variants.py``."""

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
        others: methods that the picture shows beside the fronts.
        workers: processes; 0 for none.
        seed: of the methods' random numbers.
        cache: folder of what was measured before.
        output: JSON file; Markdown and picture of the fronts stand beside it.
        compare: an earlier JSON file to lay beside this run.
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
            beside = {
                label: one.metrics
                for (name, _, label), one in measured.items()
                if name == source.name and one.metrics is not None
            }
            marked = {} if chosen is None else {"as chosen": chosen}
            title, called = f"{recording}: {front.setting}", f"settings of {METHOD}"
            row.append(TradeOff(title, front.x, front.y, tried, marked, beside, called))
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
) -> dict[tuple[str, str, str], Measured]:
    """(recording, hand, method) -> figures, kept as those of judge.py are."""
    cells = [
        Cell(source, hand, choice.method, choice.preset, choice.config)
        for hand in hands
        for choice in choices
        for source in sources
    ]
    found: dict[tuple[str, str, str], Measured] = {}
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
