"""Runs experiments: checks the request, computes, and writes the results."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from smooth_operator.errors import RecordingError, UnknownNameError
from smooth_operator.reporting.drawing import styled
from smooth_operator.result_cache import Note, no_note
from smooth_operator_benchmark.recordings import Source, load_sources, parse_request
from smooth_operator_research.paper.experiment import (
    DEFAULT,
    PUBLISHED,
    QUICK,
    ExperimentContext,
    ExperimentFolder,
    Outcome,
    Size,
    Track,
    experiment,
    silent,
    trial_note,
)
from smooth_operator_research.paper.experiment_report import write_outcome, write_report

SIZES: Final = {size.name: size for size in (QUICK, DEFAULT, PUBLISHED)}


@dataclass(frozen=True, kw_only=True)
class Settings:
    """Settings of a run.

    Attributes:
        output: folder of the results.
        experiments: names of the experiments.
        recordings: recordings, in the form for ``smooth_operator_benchmark.recordings``; the
            built-in operator if there are none.
        hand: name of the robot hand.
        frames: range ``A:B`` for each recording that has no range of its own.
        size: quick, default or published.
    """

    output: Path
    experiments: tuple[str, ...]
    recordings: tuple[str, ...] = ()
    hand: str = "mimic_p050"
    frames: str | None = None
    size: str = "default"

    def __post_init__(self) -> None:
        for name in self.experiments:
            experiment(name)
        if self.size not in SIZES:
            raise UnknownNameError("size", self.size, SIZES)

    @property
    def how_much(self) -> Size:
        """Size of the experiments."""
        return SIZES[self.size]


def load_recordings(settings: Settings) -> list[Source]:
    """Reads the readable recordings."""
    words = settings.recordings
    if not words:
        words = settings.how_much.recordings
        if settings.frames is not None:  # a range that was asked for goes before our own
            words = tuple(word.partition("@")[0] for word in words)
    sources = load_sources([parse_request(word, frames=settings.frames) for word in words])
    for source in sources:
        if source.error is not None:
            raise RecordingError(f"{source.name}: {source.error}")
    return sources


def run_experiments(
    settings: Settings,
    sources: Sequence[Source],
    track: Track = silent,
    done: Callable[[str, Outcome], None] = lambda name, outcome: None,
    note: Note = no_note,
) -> list[tuple[str, Outcome]]:
    """Runs the experiments one after another, and writes each result as soon as it is complete.

    Args:
        sources: result of ``load_recordings``.
        track: shows the progress.
        done: called after each experiment.
        note: called with a message about stored cells that can't be used.

    Raises:
        SmoothOperatorError: the hand is unknown, a recording unusable, or a file can't be written.
        KeyboardInterrupt: stopped; finished results are kept.
    """
    store = ExperimentFolder(
        settings.output,
        {
            "experiments": settings.experiments,
            "recordings": [source.facts for source in sources],
            "hand": settings.hand,
            "frames": settings.frames,
            "size": settings.how_much,
        },
        note,
    )
    context = ExperimentContext(sources, settings.hand, settings.how_much, store, track)
    outcomes = []
    for name in settings.experiments:
        one = experiment(name)
        with styled():
            outcome = one.run(context)
        write_outcome(store, name, one, outcome, trial_note(settings.how_much))
        outcomes.append((name, outcome))
        write_report(store)
        done(name, outcome)
    return outcomes
