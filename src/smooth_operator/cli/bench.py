"""``smooth-operator bench``: which method, and how good?"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Sequence

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from smooth_operator.cli.bench_options import Bench
from smooth_operator.cli.bench_tables import print_comparison, print_results
from smooth_operator.cli.outputs import folder_for
from smooth_operator.compilation.dispatch import dispatch_here
from smooth_operator.errors import SmoothOperatorError, require
from smooth_operator.hands.catalogue import load_hand
from smooth_operator.hands.selection import parse_fingers
from smooth_operator.human.operator_file import read_operator
from smooth_operator.io import reading_notes
from smooth_operator.lab.benchmark import (
    Settings,
    compare,
    make_rows,
    plan_cells,
    read_results,
    run_suite,
)
from smooth_operator.lab.benchmark.cells import Cell
from smooth_operator.lab.benchmark.store import REPORT, RESULTS, write_json
from smooth_operator.lab.benchmark.suite import Advance
from smooth_operator.lab.offline.finished import claimed
from smooth_operator.terminal import open_console

SOME_FAILED = 1
"""Exit status where everything was done, but some cells have a reason in place of figures."""


def bench(options: Bench) -> None:
    """Looks everything up, measures, writes, prints.

    Raises:
        SmoothOperatorError: what was asked for can't be; nothing was measured then.
        SystemExit: with ``SOME_FAILED``.
        KeyboardInterrupt: stopped; what is finished is kept.
    """
    if not options.no_report:
        require("the report (--no-report leaves it out)", "lab", "matplotlib")
    console = open_console(stderr=True)
    dispatch_here()  # before planning, which may start JAX
    # What a user can get wrong comes before what takes long.
    settings = Settings(
        output=options.output,
        recordings=options.recordings or ("synthetic",),
        hands=_words(options.hands),
        methods=_words(options.methods),
        frames=options.frames,
        rate=options.rate,
        layout=options.layout,
        side=options.side,
        seed=options.seed,
        definition=options.definition,
        latency_frames=options.latency_frames,
        workers=options.workers,
        cluster=options.cluster,
        fingers=None if options.fingers is None else parse_fingers(options.fingers),
        operator=None if options.operator is None else read_operator(options.operator),
    )
    others = None if options.compare is None else read_results(options.compare)
    cells = plan_cells(settings)
    _say_what_is_odd(cells, console)
    with folder_for(options.output), claimed(options.output):
        try:
            finished = run_suite(
                settings,
                cells,
                _track(console, options.quiet),
                lambda text: _note(console, text),
            )
        except KeyboardInterrupt:
            _note(console, f"stopped; the same command goes on with what is in {options.output}")
            raise
        rows = make_rows(finished, settings)
        comparison = None
        if others is not None:
            comparison = compare(rows, others, str(options.compare))
        write_json(options.output / RESULTS, rows, indent=1)
        if not options.no_report:
            from smooth_operator.lab.benchmark.page import write_report

            with _waiting(console, options.quiet, "drawing the report"):
                write_report(finished, rows, settings, comparison)
    if not options.quiet:
        print_results(rows)
        if comparison is not None:
            print_comparison(comparison)
        written = RESULTS if options.no_report else f"{RESULTS} and {REPORT}"
        _note(console, f"wrote {options.output}: {written}")
    failed = [row for row in rows if row["status"] != "ok"]
    if failed:
        where = "" if options.quiet else ", see above"
        _note(console, f"{len(failed)} of {len(rows)} cells failed{where}")
        raise SystemExit(SOME_FAILED)


def _words(text: str) -> tuple[str, ...]:
    return tuple(word for word in (part.strip() for part in text.split(",")) if word)


def _say_what_is_odd(cells: Sequence[Cell], console: Console) -> None:
    for source in dict.fromkeys(cell.source for cell in cells):
        if source.error is not None:
            _note(console, f"left out: {source.error}")
        elif source.recording is not None:
            for note in reading_notes(source.recording, source.name):
                _note(console, note)

    said = set()
    for cell in cells:
        if cell.source.recording is None:
            continue
        try:
            hand = load_hand(cell.hand, cell.side, fingers=cell.fingers)
        except SmoothOperatorError:
            continue  # the cell says so itself
        said |= set(cell.config.notes(hand))
    for note in sorted(said):
        _note(console, note)


def _note(console: Console, text: str) -> None:
    console.print(text, markup=False, soft_wrap=True)


@contextlib.contextmanager
def _waiting(console: Console, quiet: bool, text: str) -> Iterator[None]:
    if quiet or not console.is_terminal:
        yield
    else:
        with console.status(text):
            yield


def _track(
    console: Console, quiet: bool
) -> Callable[[str, int, int], contextlib.AbstractContextManager[Advance]]:
    """Progress on a terminal as a bar with the time left, elsewhere as a line for each cell."""

    @contextlib.contextmanager
    def phase(name: str, total: int, done: int) -> Iterator[Advance]:
        if done and not quiet:
            _note(console, f"{name}: {done} of {total} cells need no measuring again")
        if done == total:
            yield lambda label, reason: None
            return
        with _bar(console, quiet) as bar:
            task = bar.add_task(name, total=total - done)
            left = total - done

            def advance(label: str, reason: str | None) -> None:
                nonlocal left
                left -= 1
                bar.advance(task)
                if reason is not None:
                    _note(bar.console, f"failed: {label}: {reason}")
                elif not (quiet or console.is_terminal):
                    _note(console, f"{name}: {label} ({left} to go)")

            yield advance

    return phase


def _bar(console: Console, quiet: bool) -> Progress:
    return Progress(
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("cells"),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        console=console,
        disable=quiet or not console.is_terminal,
        # Drawing takes a core now and then; the latency of frames must not feel it.
        refresh_per_second=2,
    )
