"""``smooth-operator tune``: searches the numeric settings of a preset."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterator, Sequence

from smooth_operator.cli.console import Progressing, output_console, plain_table
from smooth_operator.cli.outputs import folder_for, stopped
from smooth_operator.cli.tune_options import Tune
from smooth_operator.compilation.start import dispatch_here
from smooth_operator.errors import ConfigError, counted
from smooth_operator.lab import tuning
from smooth_operator.lab.offline.finished import claimed
from smooth_operator.lab.tuning.search_plan import Bound, figure
from smooth_operator.lab.tuning.tune import FIGURES


def tune(options: Tune) -> None:
    """Looks everything up, searches, writes, prints."""
    progress = Progressing(options.quiet)
    dispatch_here()  # before planning, which may start JAX
    settings = tuning.TuningSettings(
        output=options.output,
        method=options.method,
        preset=options.preset,
        recordings=options.recordings,
        held_out=options.held_out,
        vary=options.vary,
        fix=dict(_numbers(options.fix, "--fix")),
        hand=options.hand,
        rate=options.rate,
        trials=options.trials,
        seed=options.seed,
        weights=dict(_numbers(options.weight, "--weight")),
        bounds=(
            *(Bound(name, value, True) for name, value in _numbers(options.at_least, "--at-least")),
            *(Bound(name, value) for name, value in _numbers(options.at_most, "--at-most")),
        ),
        workers=options.workers,
    )
    plan = tuning.plan_tuning(settings)
    with folder_for(options.output), claimed(options.output):
        try:
            with _bar(progress, settings.trials) as advance:
                tuned = tuning.tune(plan, advance)
        except KeyboardInterrupt:
            raise stopped(options.output) from None
    if not options.quiet:
        _print(plan, tuned)
        progress.note(f"{counted(tuned.trials, 'trial')}, {tuned.fresh} new; wrote {tuned.preset}")


def _numbers(texts: Sequence[str], option: str) -> Iterator[tuple[str, float]]:
    for text in texts:
        name, _, value = text.partition("=")
        try:
            number = float(value)
        except ValueError:
            number = math.nan
        if not name or not math.isfinite(number):
            raise ConfigError(f"{option} {text!r}: expected NAME=NUMBER")
        yield name, number


@contextlib.contextmanager
def _bar(progress: Progressing, trials: int) -> Iterator[Callable[..., None]]:
    bar = progress.counter("trials", extra="score {task.fields[score]}")
    shown = math.inf

    def advance(count: int, best: float, reason: str | None) -> None:
        nonlocal shown
        score = f"{best:.4f}" if math.isfinite(best) else "–"
        bar.update(task, completed=count, score=score)
        if reason is not None:
            progress.note(f"a trial failed: {reason}")
        if best < shown and progress.lines:
            progress.note(f"trial {count} of {trials}: score {score}")
        shown = min(shown, best)

    with bar:
        task = bar.add_task("tuning", total=trials, score="–")
        yield advance


def _print(plan: tuning.Tuning, tuned: tuning.Tuned) -> None:
    console = output_console()
    rows = (
        (v.path, f"{v.start:.4g}", f"{tuned.values[v.path]:.4g}", f"{v.low:.4g} … {v.high:.4g}")
        for v in plan.variables
    )
    headers = ("setting", "start", "best", "between")
    console.print(plain_table(f"score {tuned.score:.4f}", headers, rows, left=1))
    figures = plain_table()
    figures.add_column("figure, start → best", no_wrap=True)
    for source in plan.sources:
        figures.add_column(source.name, justify="right", overflow="fold")
    for name in FIGURES:
        pairs = zip(tuned.start, tuned.best, strict=True)
        cells = (f"{_shown(figure(a, name))} → {_shown(figure(b, name))}" for a, b in pairs)
        figures.add_row(name, *cells)
    console.print(figures)


def _shown(value: float | None) -> str:
    return "–" if value is None else f"{value:.4g}"
