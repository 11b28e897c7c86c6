"""``smooth-operator ablate`` and ``smooth-operator paper``: the paper's experiments, re-run."""

from __future__ import annotations

import contextlib
import itertools
from collections.abc import Callable, Iterator, Sequence

from smooth_operator.cli.console import Progressing, output_console, plain_table
from smooth_operator.cli.outputs import folder_for
from smooth_operator.compilation.cache import jax_cache
from smooth_operator.compilation.start import dispatch_here
from smooth_operator.errors import ConfigError
from smooth_operator.hands.registry import load_hand
from smooth_operator.lab.offline.finished import claimed
from smooth_operator_research.commands.options import Ablate, Experimenting, Paper
from smooth_operator_research.paper.experiment import (
    EXPERIMENTS,
    Advance,
    Outcome,
    Track,
    check_folder,
    trial_note,
)
from smooth_operator_research.paper.experiment_report import REPORT, verdict_lines
from smooth_operator_research.paper.suite import Settings, load_recordings, run_experiments


def ablate(options: Ablate) -> None:
    """Runs one experiment."""
    _run(options, (options.name,), options.recordings)


def paper(options: Paper) -> None:
    """Runs all experiments."""
    _run(options, tuple(EXPERIMENTS), options.recordings)


def _run(options: Experimenting, names: Sequence[str], recordings: Sequence[str]) -> None:
    """Looks everything up, computes, writes, prints.

    Raises:
        SmoothOperatorError: what was asked for can't be; nothing was computed then.
        KeyboardInterrupt: stopped; what is finished is kept.
    """
    progress = Progressing(options.quiet)
    dispatch_here()  # before anything starts JAX
    if options.quick and options.published:
        raise ConfigError("--quick and --published ask for different sizes: give one of them")
    settings = Settings(
        output=options.output,
        experiments=tuple(names),
        recordings=tuple(recordings),
        hand=options.hand,
        frames=options.frames,
        size="quick" if options.quick else "published" if options.published else "default",
    )
    check_folder(options.output)
    sources = load_recordings(settings)
    for side in {source.side for source in sources}:
        load_hand(options.hand, side)  # unknown, or not of this side: said before the long work
    with (
        folder_for(options.output),
        claimed(options.output),
        jax_cache(),
    ):
        try:
            outcomes = run_experiments(
                settings,
                sources,
                _track(progress),
                _told(progress, len(names)),
                lambda text: progress.note(text, matters=True),
            )
        except KeyboardInterrupt:
            progress.note(
                f"stopped; the same command goes on with what is in {options.output}", matters=True
            )
            raise
    if not options.quiet:
        _print_verdicts(outcomes, trial_note(settings.how_much))
        progress.note(f"wrote {options.output}: {', '.join(names)}, {REPORT}")


def _told(progress: Progressing, count: int) -> Callable[[str, Outcome], None]:
    """Prints the outcome of an experiment, and how many of them are done."""
    places = itertools.count(1)

    def done(name: str, outcome: Outcome) -> None:
        held = sum(verdict.held == "held" for verdict in outcome.verdicts)
        progress.note(
            f"{next(places)} of {count} experiments done; {name}: {held} of "
            f"{len(outcome.verdicts)} claims held"
        )

    return done


def _track(progress: Progressing) -> Track:
    """A phase as a bar with the time left, elsewhere as a line for each cell."""

    @contextlib.contextmanager
    def phase(name: str, work: float) -> Iterator[Advance]:
        bar = progress.counter(extra="{task.fields[cell]}")
        told = ""

        def advance(label: str, done: float) -> None:
            nonlocal told
            bar.update(task, advance=done, cell=label)
            if label != told and progress.lines:
                progress.note(f"{name}: {label}")
            told = label

        with bar:
            task = bar.add_task(name, total=work, cell="")
            yield advance

    return phase


def _print_verdicts(outcomes: Sequence[tuple[str, Outcome]], warning: str) -> None:
    console = output_console()
    table = plain_table()
    for header in ("experiment", "claim", "paper", "here", "verdict"):
        table.add_column(header, no_wrap=header in ("experiment", "verdict"))
    for line in verdict_lines(outcomes):
        table.add_row(*line)
    console.print(table)
    if warning:
        console.print(warning.strip(), markup=False, style="bold yellow")
