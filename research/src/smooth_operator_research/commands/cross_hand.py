"""``smooth-operator cross-hand``: one human demonstration on many robot hands."""

from __future__ import annotations

from smooth_operator.atomic_files import atomic_write, claimed
from smooth_operator.cli.console import Progressing
from smooth_operator.cli.outputs import folder_for, stopped
from smooth_operator.errors import ConfigError
from smooth_operator.reporting.drawing import styled
from smooth_operator.retargeting.start import start_jax
from smooth_operator_benchmark.command import SOME_FAILED, comma_words
from smooth_operator_research.commands.cross_hand_options import (
    DrawStrip,
    ReportMatrix,
    RunMatrix,
)
from smooth_operator_research.cross_hand.matrix import (
    HANDS,
    METHODS,
    TASKS,
    MatrixSettings,
    run_matrix,
)
from smooth_operator_research.cross_hand.pictures import draw_strip, plot_success
from smooth_operator_research.cross_hand.results import MatrixResults
from smooth_operator_research.cross_hand.tables import SCALED_TABLES, TABLES, Outcomes
from smooth_operator_research.paper.docs_tables import BLOCK, block, replaced

PLOT = "cross-hand.svg"
PICTURES = {".png": "PNG", ".webp": "WEBP"}


def run(options: RunMatrix) -> None:
    """Runs the missing trials."""
    progress = Progressing(options.quiet)
    start_jax()
    settings = MatrixSettings(
        tasks=TASKS if options.tasks == "all" else comma_words(options.tasks),
        hands=comma_words(options.hands) or HANDS,
        methods=comma_words(options.methods) or METHODS,
        trackers=comma_words(options.trackers),
        worlds=options.worlds,
        workers=options.workers,
        keep_older=options.keep_older,
        scaled=options.scaled,
    )
    folder = options.results.parent
    with folder_for(folder), claimed(folder):
        try:
            failures = run_matrix(settings, options.results, progress)
        except KeyboardInterrupt:
            raise stopped(options.results) from None
    if failures:
        progress.note(f"{len(failures)} blocks of trials failed", matters=True)
        raise SystemExit(SOME_FAILED)
    progress.note(f"wrote {options.results}")


def report(options: ReportMatrix) -> None:
    """Prints the tables, or replaces them in a page."""
    results = _results(options)
    outcomes, scaled = Outcomes(results), Outcomes(results, scaled=True)
    tables = TABLES | SCALED_TABLES
    text = "" if options.docs is None else options.docs.read_text(encoding="utf-8")
    for name in [match[1] for match in BLOCK.finditer(text)] if text else tables:
        selected = scaled if name in SCALED_TABLES else outcomes
        if not selected.trials:
            continue
        content = block(name, tables[name](selected))
        if options.docs is None:
            print(content, end="\n\n")
        text = replaced(text, name, content)
    if options.docs is not None:
        with atomic_write(options.docs) as file:
            file.write(text.encode())
    if options.plots is not None:
        with folder_for(options.plots), styled():
            plot_success(outcomes).savefig(options.plots / PLOT)


def _results(options: ReportMatrix) -> MatrixResults:
    results = MatrixResults(options.results)
    if not results.rows:
        raise ConfigError(
            f"{options.results} has no results yet: run `smooth-operator cross-hand run`"
        )
    return results


def strip(options: DrawStrip) -> None:
    """Draws the trials."""
    if (kind := options.output.suffix.lower()) not in PICTURES:
        raise ConfigError(f"--output must end in {' or '.join(PICTURES)}, not {kind!r}")
    start_jax()
    picture = draw_strip(
        options.task, comma_words(options.hands), options.method, options.world, options.pictures
    )
    with atomic_write(options.output) as file:
        picture.save(file, PICTURES[kind])
