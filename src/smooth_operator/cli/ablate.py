"""``smooth-operator ablate`` and ``smooth-operator paper``: the paper's experiments, re-run."""

from __future__ import annotations

import contextlib
import itertools
from collections.abc import Callable, Iterator, Sequence

from rich import box
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.table import Table

from smooth_operator.cli.ablate_options import Ablate, Experimenting, Paper
from smooth_operator.cli.outputs import folder_for
from smooth_operator.compilation.compile_cache import enable_cache, healing
from smooth_operator.compilation.dispatch import dispatch_here
from smooth_operator.errors import ConfigError
from smooth_operator.hands.catalogue import load_hand
from smooth_operator.lab.offline.finished import claimed
from smooth_operator.lab.paper.catalogue import EXPERIMENTS
from smooth_operator.lab.paper.experiment import Outcome
from smooth_operator.lab.paper.report import REPORT, verdict_lines
from smooth_operator.lab.paper.sizes import trial_note
from smooth_operator.lab.paper.store import check_folder
from smooth_operator.lab.paper.study import Advance, Track
from smooth_operator.lab.paper.suite import Settings, load_recordings, run_experiments
from smooth_operator.terminal import open_console

_WIDTH_OF_A_FILE = 160


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
    console = open_console(stderr=True)
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
        healing(enable_cache()),
    ):
        try:
            outcomes = run_experiments(
                settings,
                sources,
                _track(console, options.quiet),
                _told(console, options.quiet, len(names)),
                lambda text: _note(console, text),
            )
        except KeyboardInterrupt:
            _note(console, f"stopped; the same command goes on with what is in {options.output}")
            raise
    if not options.quiet:
        _print_verdicts(outcomes, trial_note(settings.how_much))
        _note(console, f"wrote {options.output}: {', '.join(names)}, {REPORT}")


def _note(console: Console, text: str) -> None:
    console.print(text, markup=False, soft_wrap=True)


def _told(console: Console, quiet: bool, count: int) -> Callable[[str, Outcome], None]:
    """Says what came of an experiment, and how many of them are done."""
    places = itertools.count(1)

    def done(name: str, outcome: Outcome) -> None:
        if not quiet:
            held = sum(verdict.held == "held" for verdict in outcome.verdicts)
            _note(
                console,
                f"{next(places)} of {count} experiments done; {name}: {held} of "
                f"{len(outcome.verdicts)} claims held",
            )

    return done


def _track(console: Console, quiet: bool) -> Track:
    """A phase as a bar with the time left, elsewhere as a line for each cell."""

    @contextlib.contextmanager
    def phase(name: str, work: float) -> Iterator[Advance]:
        bar = Progress(
            TextColumn("{task.description}", markup=False),
            BarColumn(),
            TimeElapsedColumn(),
            TextColumn("left"),
            TimeRemainingColumn(),
            TextColumn("{task.fields[cell]}", style="dim", markup=False),
            console=console,
            disable=quiet or not console.is_terminal,
            refresh_per_second=2,  # drawing takes a core now and then, and frames are timed
        )
        told = ""

        def advance(label: str, done: float) -> None:
            nonlocal told
            bar.update(task, advance=done, cell=label)
            if label != told and not (quiet or console.is_terminal):
                _note(console, f"{name}: {label}")
            told = label

        with bar:
            task = bar.add_task(name, total=work, cell="")
            yield advance

    return phase


def _print_verdicts(outcomes: Sequence[tuple[str, Outcome]], warning: str) -> None:
    console = open_console()
    if not console.is_terminal:  # a pipe or file has no width
        console.width = _WIDTH_OF_A_FILE
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for header in ("experiment", "claim", "paper", "here", "verdict"):
        table.add_column(header, no_wrap=header in ("experiment", "verdict"))
    for line in verdict_lines(outcomes):
        table.add_row(*line)
    console.print(table)
    if warning:
        console.print(warning.strip(), markup=False, style="bold yellow")
