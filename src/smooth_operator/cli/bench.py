"""``smooth-operator bench``: compares methods on recordings."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Sequence

from smooth_operator.atomic_files import write_json
from smooth_operator.calibration.operator_file import read_operator
from smooth_operator.cli.bench_options import Bench
from smooth_operator.cli.bench_tables import print_comparison, print_results
from smooth_operator.cli.console import Progressing
from smooth_operator.cli.outputs import folder_for
from smooth_operator.compilation.start import dispatch_here
from smooth_operator.errors import SmoothOperatorError, require
from smooth_operator.formats.checks import reading_notes
from smooth_operator.hands.finger_choice import parse_fingers
from smooth_operator.hands.penetration import collision_note
from smooth_operator.hands.registry import load_hand
from smooth_operator.lab.benchmark import (
    Settings,
    compare,
    make_rows,
    plan_cells,
    read_results,
    run_suite,
)
from smooth_operator.lab.benchmark.benchmark_folder import REPORT, RESULTS
from smooth_operator.lab.benchmark.cells import Cell
from smooth_operator.lab.benchmark.settings import only_side
from smooth_operator.lab.benchmark.suite import Advance
from smooth_operator.lab.offline.finished import claimed

SOME_FAILED = 1
"""Exit status where everything was done, but some cells have a reason in place of figures."""


def bench(options: Bench) -> None:
    """Looks everything up, measures, writes, prints."""
    if not options.no_report or options.sheet:
        require("the report (--no-report leaves it out)", "lab", "matplotlib")
    progress = Progressing(options.quiet)
    dispatch_here()  # before planning, which may start JAX
    # What a user can get wrong comes before what takes long.
    settings = Settings(
        output=options.output,
        recordings=options.recordings or ("synthetic",),
        hands=comma_words(options.hands),
        methods=comma_words(options.methods),
        frames=options.frames,
        rate=options.rate,
        layout=options.layout,
        side=options.side or only_side(comma_words(options.hands)),
        seed=options.seed,
        definition=options.definition,
        metrics=comma_words(options.metrics),
        latency_frames=0 if options.sheet else options.latency_frames,
        workers=options.workers,
        cluster=options.cluster,
        fingers=None if options.fingers is None else parse_fingers(options.fingers),
        operator=None if options.operator is None else read_operator(options.operator),
    )
    others = None if options.compare is None else read_results(options.compare)
    cells = plan_cells(settings)
    _say_what_is_odd(cells, progress)
    with folder_for(options.output), claimed(options.output):
        try:
            finished = run_suite(
                settings,
                cells,
                cell_progress(progress),
                lambda text: progress.note(text, matters=True),
            )
        except KeyboardInterrupt:
            progress.note(
                f"stopped; the same command goes on with what is in {options.output}", matters=True
            )
            raise
        rows = make_rows(finished, settings)
        comparison = None
        if others is not None:
            comparison = compare(rows, others, str(options.compare))
        write_json(options.output / RESULTS, rows, indent=1)
        written = [RESULTS]
        if options.sheet:
            from smooth_operator.cli.hand_shape import ModelShape
            from smooth_operator.lab.benchmark.contact_sheet import write_sheets

            with progress.waiting("drawing the hands"):
                written += [
                    path.name for path in write_sheets(finished, options.output, ModelShape)
                ]
        elif not options.no_report:
            from smooth_operator.cli.hand_shape import ModelShape
            from smooth_operator.lab.benchmark.page import write_report

            with progress.waiting("drawing the report"):
                write_report(finished, rows, settings, comparison, ModelShape)
            written.append(REPORT)
    if not options.quiet:
        print_results(rows)
        if comparison is not None:
            print_comparison(comparison)
        progress.note(f"wrote {options.output}: {' and '.join(written)}")
    failed = sum(row["status"] != "ok" for row in rows)
    if failed:
        where = "" if options.quiet else ", see above"
        progress.note(f"{failed} of {len(rows)} cells failed{where}", matters=True)
        raise SystemExit(SOME_FAILED)


def comma_words(text: str) -> tuple[str, ...]:
    """The words of a text with commas between them."""
    return tuple(word for word in (part.strip() for part in text.split(",")) if word)


def _say_what_is_odd(cells: Sequence[Cell], progress: Progressing) -> None:
    for source in dict.fromkeys(cell.source for cell in cells):
        if source.error is not None:
            progress.note(f"left out: {source.error}", matters=True)
        elif source.recording is not None:
            for note in reading_notes(source.recording, source.name):
                progress.note(note, matters=True)

    notes = set()
    for cell in cells:
        if cell.source.recording is None:
            continue
        try:
            hand = load_hand(cell.hand, cell.side, fingers=cell.fingers)
        except SmoothOperatorError:
            continue  # the cell says so itself
        notes |= {*cell.config.notes(hand), *filter(None, [collision_note(hand)])}
    for note in sorted(notes):
        progress.note(note, matters=True)


def cell_progress(
    progress: Progressing,
    what: str = "cells",
) -> Callable[[str, int, int], contextlib.AbstractContextManager[Advance]]:
    """Progress on a terminal as a bar with the time left, elsewhere as a line for each cell."""

    @contextlib.contextmanager
    def phase(name: str, total: int, done: int) -> Iterator[Advance]:
        if done:
            progress.note(f"{name}: {done} of {total} {what} need no measuring again")
        if done == total:
            yield lambda label, reason: None
            return
        with progress.counter(what) as bar:
            task = bar.add_task(name, total=total - done)
            left = total - done

            def advance(label: str, reason: str | None) -> None:
                nonlocal left
                left -= 1
                bar.advance(task)
                if reason is not None:
                    progress.note(f"failed: {label}: {reason}", matters=True)
                elif progress.lines:
                    progress.note(f"{name}: {label} ({left} to go)")

            yield advance

    return phase
