"""``smooth-operator tune``: the numbers of a preset, searched."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterator, Sequence

from rich import box
from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.table import Table

from smooth_operator.cli.outputs import folder_for
from smooth_operator.cli.tune_options import Tune
from smooth_operator.compilation.dispatch import dispatch_here
from smooth_operator.errors import ConfigError
from smooth_operator.lab import tuning
from smooth_operator.lab.offline.finished import claimed
from smooth_operator.lab.tuning.score import Bound, figure
from smooth_operator.lab.tuning.tune import KEPT
from smooth_operator.terminal import open_console

_WIDTH_OF_A_FILE = 140


def tune(options: Tune) -> None:
    """Looks everything up, searches, writes, prints.

    Raises:
        SmoothOperatorError: what was asked for can't be; nothing was tried then.
        KeyboardInterrupt: stopped; what was tried is kept, and the best of it written.
    """
    console = open_console(stderr=True)
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
    todo = tuning.plan_tuning(settings)
    with folder_for(options.output), claimed(options.output):
        try:
            with _bar(console, options.quiet, settings.trials) as progress:
                tuned = tuning.tune(todo, progress, lambda text: _note(console, text))
        except KeyboardInterrupt:
            _note(console, f"stopped; the same command goes on with what is in {options.output}")
            raise
    if not options.quiet:
        _print(todo, tuned)
        _note(console, f"{tuned.trials} trials, {tuned.fresh} of them new; wrote {tuned.preset}")


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


def _note(console: Console, text: str) -> None:
    console.print(text, markup=False, soft_wrap=True)


@contextlib.contextmanager
def _bar(console: Console, quiet: bool, trials: int) -> Iterator[Callable[..., None]]:
    bar = Progress(
        TextColumn("tuning"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("trials  score {task.fields[score]}", markup=False),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        console=console,
        disable=quiet or not console.is_terminal,
        refresh_per_second=2,
    )
    told = math.inf

    def progress(count: int, best: float, reason: str | None) -> None:
        nonlocal told
        score = f"{best:.4f}" if math.isfinite(best) else "–"
        bar.update(task, completed=count, score=score)
        if reason is not None and not quiet:
            _note(bar.console, f"a trial failed: {reason}")
        if best < told and not (quiet or console.is_terminal):
            _note(console, f"trial {count} of {trials}: score {score}")
        told = min(told, best)

    with bar:
        task = bar.add_task("", total=trials, score="–")
        yield progress


def _print(todo: tuning.Tuning, tuned: tuning.Tuned) -> None:
    console = open_console()
    if not console.is_terminal:  # a pipe or file has no width
        console.width = _WIDTH_OF_A_FILE
    values = Table(box=box.SIMPLE_HEAD, pad_edge=False, title=f"score {tuned.score:.4f}",
                   title_justify="left")  # fmt: skip
    for header in ("setting", "start", "best", "between"):
        values.add_column(header, justify="left" if header == "setting" else "right")
    for v in todo.variables:
        best = tuned.values[v.path]
        values.add_row(v.path, f"{v.start:.4g}", f"{best:.4g}", f"{v.low:.4g} … {v.high:.4g}")
    console.print(values)
    figures = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    figures.add_column("figure, start → best", no_wrap=True)
    for source in todo.sources:
        figures.add_column(source.name, justify="right", overflow="fold")
    for name in KEPT:
        pairs = zip(tuned.start, tuned.best, strict=True)
        cells = (f"{_shown(figure(a, name))} → {_shown(figure(b, name))}" for a, b in pairs)
        figures.add_row(name, *cells)
    console.print(figures)


def _shown(value: float | None) -> str:
    return "–" if value is None else f"{value:.4g}"
