"""``smooth-operator ablate`` and ``smooth-operator paper``: the paper's experiments, re-run."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence

from smooth_operator.atomic_files import claimed
from smooth_operator.cli.console import Progressing, output_console, plain_table
from smooth_operator.cli.outputs import folder_for, stopped
from smooth_operator.errors import ConfigError
from smooth_operator.hands.registry import load_hand
from smooth_operator.retargeting.start import start_jax
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
    """Checks the request, runs the experiments, writes and prints the results."""
    progress = Progressing(options.quiet)
    start_jax()  # before anything else does
    if options.quick and options.published:
        raise ConfigError("--quick and --published set different sizes; use only one of them")
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
    outcomes: list[tuple[str, Outcome]] = []
    trial = trial_note(settings.how_much)

    def done(name: str, outcome: Outcome) -> None:
        outcomes.append((name, outcome))
        held = sum(verdict.held == "held" for verdict in outcome.verdicts)
        judged = "" if trial else f"; {name}: {held} of {len(outcome.verdicts)} claims held"
        progress.note(f"{len(outcomes)} of {len(names)} experiments done{judged}")

    with folder_for(options.output), claimed(options.output):
        try:
            run_experiments(
                settings,
                sources,
                _track(progress),
                done,
                lambda text: progress.note(text, matters=True),
            )
        except KeyboardInterrupt:
            raise stopped(options.output) from None
    if options.quiet:
        return
    console, table = output_console(), plain_table()
    headers = ("experiment", "claim", "paper", "here", *([] if trial else ["verdict"]))
    for header in headers:
        table.add_column(header, no_wrap=header in ("experiment", "verdict"))
    for line in verdict_lines(outcomes):
        table.add_row(*line[: len(headers)])
    console.print(table)
    if trial:
        console.print(trial, markup=False, style="bold yellow")
    progress.note(f"wrote {options.output}: {', '.join(names)}, {REPORT}")


def _track(progress: Progressing) -> Track:
    """Progress of a phase: a bar with the remaining time on a terminal, otherwise one line per
    cell."""

    @contextlib.contextmanager
    def phase(name: str, work: float) -> Iterator[Advance]:
        bar = progress.counter(extra="{task.fields[cell]}")
        last = ""

        def advance(label: str, done: float) -> None:
            nonlocal last
            bar.update(task, advance=done, cell=label)
            if label != last and progress.lines:
                progress.note(f"{name}: {label}")
            last = label

        with bar:
            task = bar.add_task(name, total=work, cell="")
            yield advance

    return phase
