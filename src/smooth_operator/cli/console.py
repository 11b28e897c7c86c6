"""Output of the commands: progress on standard error, tables on standard output."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, Literal

from rich import box
from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.table import Table
from rich.text import Text

from smooth_operator.console import open_console
from smooth_operator.reporter import Advance, Reporter

_REDRAW_S: Final = 0.1
_EXTRAS: Final = {"first_command_s": ("s", "↓", "building and compiling (once per start)")}
_WIDTH_OF_A_FILE: Final = 160
_WIDTH_TO_EXPLAIN: Final = 115


@dataclass(frozen=True)
class Figure:
    """A metric that is printed after a run, with a limit and advice for values beyond it.

    Attributes:
        metric: name of the metric.
        good: worst value that counts as good; None uses the time between two frames [ms].
        sentence: sentence with a format field for the value.
        absent: sentence if the value is unknown.
        advice: advice that is printed if the value is not good.
        method: method that does better; recommended if another method ran.
    """

    metric: str
    good: float | None
    sentence: str
    absent: str
    advice: str
    method: str = ""


SUMMARY: Final = (
    Figure(
        "finger_direction_error_deg",
        10.0,
        "On average, the robot's fingers point {:.3g}° away from the human's (good: up to {:.3g}°)",
        "The human's finger directions could not be measured in any frame",
        "smooth-operator bench compares methods; hands check measures the palm's tilt",
    ),
    Figure(
        "pinch_touch_share",
        0.8,
        "The robot's thumb and finger touch in {:.3g} % of the human's pinches (good: at "
        "least {:.3g} %)",
        "There are too few frames with a pinch to measure pinching",
        "smooth-operator calibrate measures the gap that the tracker reports when fingertips touch",
    ),
    Figure(
        "self_collision.share",
        0.05,
        "Parts of the robot hand overlap in {:.3g} % of the frames (good: up to {:.3g} %)",
        "Self-collision can't be measured for this hand",
        "hands check tests the hand's description: its collision shapes may be too large",
        method="smooth",
    ),
    Figure(
        "jumps_per_1000",
        1.0,
        "A robot fingertip jumps in {:.3g} of 1,000 frames (good: up to {:.3g})",
        "There are too few frames to detect jumps",
        "look at the jumps with smooth-operator view; the tracker may have jumped too",
    ),
    Figure(
        "latency_ms.p99",
        None,
        "99 of 100 commands took at most {:.3g} ms (good: up to {:.3g} ms, the time between two "
        "frames)",
        "Computation time was not measured",
        "smooth-operator doctor shows what slows this machine down",
    ),
)
"""The five metrics that ``demo`` and ``retarget`` print: shape, pinches, collision, jumps,
speed."""


class Progressing(Reporter):
    """Shows notes and a progress bar on standard error.

    Args:
        quiet: print only important notes.
    """

    def __init__(self, quiet: bool = False) -> None:
        self._quiet = quiet
        self._console = open_console(stderr=True)

    @property
    def lines(self) -> bool:
        """True if progress is printed as lines, because there is no terminal for a bar; False in
        quiet mode."""
        return not (self._quiet or self._console.is_terminal)

    def note(self, text: str, *, matters: bool = False) -> None:
        """Prints a line. In quiet mode, prints it only if it ``matters``."""
        if matters or not self._quiet:
            self._console.print(text, markup=False, soft_wrap=True)

    @contextlib.contextmanager
    def waiting(self, text: str) -> Iterator[None]:
        """Shows that a task of unknown length is running."""
        if self._quiet:
            yield
        elif self._console.is_terminal:
            with self._console.status(text):
                yield
        else:
            self.note(text)
            yield

    @contextlib.contextmanager
    def bar(self, text: str) -> Iterator[Callable[[str, float], None]]:
        """Shows a progress bar. Yields a function that sets its text and the completed fraction, 0
        to 1."""
        if self._quiet or not self._console.is_terminal:
            told = ""

            def note(now: str, done: float) -> None:
                nonlocal told
                what = now.split(" (")[0]  # without the remaining time
                if what != told:
                    self.note(what)
                    told = what

            yield note
            return
        bar = Progress(
            BarColumn(), TextColumn("{task.description}", markup=False), console=self._console
        )
        with bar:
            task = bar.add_task(text, total=1.0)
            yield lambda now, done: bar.update(task, description=now, completed=done)

    def counter(
        self, unit: str = "", *, extra: str = "", in_files: bool = False, **options: Any
    ) -> Progress:
        """Makes a progress bar with the remaining time; the caller adds the tasks.

        Args:
            unit: unit of the count, as in "3/8 cells"; empty for no count.
            extra: text after it, a format of the task's ``fields``.
            in_files: print the final state of the bar if the output is not a terminal.
            options: options of rich's ``Progress``.
        """
        columns: list[ProgressColumn] = [
            TextColumn("{task.description}", markup=False),
            BarColumn(),
            *([MofNCompleteColumn(), TextColumn(unit)] if unit else ()),
            TimeElapsedColumn(),
            TimeRemainingColumn(),
            *([TextColumn(extra, style="dim", markup=False)] if extra else ()),
        ]
        settings: dict[str, Any] = {
            "console": self._console,
            "disable": self._quiet or not (in_files or self._console.is_terminal),
            "refresh_per_second": 2,  # Drawing occasionally occupies a core, and frames are timed.
            "redirect_stdout": False,
            "redirect_stderr": False,
        }
        return Progress(*columns, **settings | options)

    @contextlib.contextmanager
    def counting(
        self, name: str, total: int, unit: str, *, done: int = 0, in_files: bool = False
    ) -> Iterator[Advance]:
        """Shows a progress bar with the remaining time on a terminal; elsewhere, prints a line for
        each label."""
        if done:
            self.note(f"{name}: {done} of {total} {unit} are unchanged and not measured again")
        left = total - done
        if not left:
            yield lambda count=1, **_: None
            return
        with self.counter(unit, extra="{task.fields[extra]}", in_files=in_files) as bar:
            task = bar.add_task(name, total=left, extra="")

            def advance(
                count: int = 1, *, label: str = "", reason: str | None = None, extra: str = ""
            ) -> None:
                nonlocal left
                left -= count
                bar.update(task, advance=count, extra=extra)
                if reason is not None:
                    self.note(f"failed: {label}: {reason}", matters=True)
                elif label and self.lines:
                    self.note(f"{name}: {label} ({left} to go)")

            yield advance

    def frames(self, text: str) -> Callable[[Iterable[int]], Iterator[int]]:
        """Shows a progress bar while the caller iterates over frames.

        The bar is drawn between frames and not by another thread, so it does not add to their
        latency.
        """

        def track(steps: Iterable[int]) -> Iterator[int]:
            if self._quiet:
                yield from steps
                return
            steps = list(steps)
            bar = self.counter("frames", in_files=True, auto_refresh=False)
            with bar:
                task = bar.add_task(text, total=len(steps))
                drawn = time.monotonic()
                for done, step in enumerate(steps):
                    if time.monotonic() - drawn > _REDRAW_S:
                        bar.update(task, completed=done, refresh=True)
                        drawn = time.monotonic()
                    yield step
                bar.update(task, completed=len(steps), refresh=True)

        return track


def output_console(width: int = _WIDTH_OF_A_FILE) -> Console:
    """Opens the console for standard output.

    Args:
        width: width to use without a terminal, for example in a pipe or file, where 80 columns
            would break lines.
    """
    console = open_console()
    if not console.is_terminal:
        console.width = width
    return console


def plain_table(
    title: str | Text | None = None,
    headers: Iterable[str | Text] = (),
    rows: Iterable[Iterable[str | Text]] = (),
    *,
    left: int | None = None,
    **options: Any,
) -> Table:
    """Makes a table with a line below its header and no frame.

    Args:
        left: number of columns that are aligned to the left, the others to the right; None for all.
        options: options of rich for all columns.
    """
    table = Table(title=title, title_justify="left", box=box.SIMPLE_HEAD, pad_edge=False)
    for k, header in enumerate(headers):
        aligned: Literal["left", "right"] = "left" if left is None or k < left else "right"
        table.add_column(header, justify=aligned, **options)
    for row in rows:
        table.add_row(*row)
    return table


def print_summary(
    title: str, method: str, metrics: Mapping[str, object], following: Sequence[str]
) -> None:
    """Prints the metrics of ``SUMMARY`` with their verdicts, and the next steps.

    Args:
        method: name of the method that ran.
        metrics: result of ``evaluate``.
        following: commands that a user may try next, each with an explanation.
    """
    from smooth_operator.metrics.table import METRICS

    console = output_console()
    console.print(title, markup=False, soft_wrap=True)
    metric = {metric.name: metric for metric in METRICS}
    table = Table(box=None, show_header=False, pad_edge=False)
    advice: dict[str, None] = {}
    for figure in SUMMARY:
        value = metric[figure.metric].of(metrics)
        rate = metric["rate_hz"].of(metrics)
        good = figure.good or (1e3 / rate if isinstance(rate, float) and rate > 0 else None)
        if not isinstance(value, int | float) or good is None:
            table.add_row("–", figure.absent)
            continue
        enough = value >= good if metric[figure.metric].goal == "up" else value <= good
        mark, style = ("good", "green") if enough else ("look", "yellow")
        if not enough:
            if figure.method not in ("", method):
                advice[f"use --method {figure.method} to avoid self-collision"] = None
            advice[figure.advice] = None
        times = 100 if "%" in figure.sentence else 1
        table.add_row(Text(mark, style), figure.sentence.format(times * value, times * good))
    console.print(table)
    for line in (*(f"To improve: {text}" for text in advice), *following):
        console.print(line, markup=False, soft_wrap=True)


def print_metrics(title: str, metrics: Mapping[str, object]) -> None:
    """Prints a table of all metrics on standard output.

    Args:
        metrics: result of ``evaluate``.
    """
    from smooth_operator.metrics.table import GROUPS, known_metrics

    console = output_console()
    explained = console.width >= _WIDTH_TO_EXPLAIN
    table = plain_table(title)
    for header in ("metric", "value", "unit", "best", "what it is")[: 5 if explained else 4]:
        table.add_column(
            header,
            justify="right" if header == "value" else "left",
            no_wrap=header != "what it is",  # the column that shrinks on a narrow console
        )

    def add(name: str, value: object, *rest: str) -> None:
        shown = rest[: 3 if explained else 2]
        if not isinstance(value, Mapping):
            table.add_row(name, _shown(value), *shown)
            return
        table.add_row(name, "", *shown)
        for part, own in value.items():  # one value per finger or per status
            if own != 0:
                table.add_row(f"  {part}", _shown(own))

    available = [metric for metric in known_metrics() if metric.key in metrics]
    for group, question in GROUPS.items():
        table.add_row(Text(question.split(":")[0], "bold"))
        for metric in available:
            if metric.group == group:
                add(metric.name, metric.of(metrics), metric.unit, metric.sign, metric.meaning)
        table.add_section()
    for metric in available:  # metrics of a plugin have no group
        if metric.group not in GROUPS:
            add(metric.name, metric.of(metrics), metric.unit, metric.sign, metric.meaning)
    named = {metric.key for metric in available}
    for name, value in metrics.items():
        if name not in named:
            add(name, value, *_EXTRAS.get(name, ("", "", "")))
    console.print(table)


def _shown(value: object) -> str:
    if value is None:
        return "–"
    if isinstance(value, float):
        return f"{value:.4g}"
    return str(value)
