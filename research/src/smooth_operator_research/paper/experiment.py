"""An experiment and its result."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Protocol

from smooth_operator_research.paper.experiment_context import ExperimentContext
from smooth_operator_research.paper.verdicts import Verdict

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, eq=False)
class Drawing:
    """A figure.

    Attributes:
        name: of its files, ``NAME.png`` and ``NAME.svg``.
        caption: what is seen.
        figure: matplotlib's.
    """

    name: str
    caption: str
    figure: Figure


@dataclass(frozen=True)
class Table:
    """A table of text; its first column names the rows.

    Attributes:
        title: above it.
        headers: of the columns.
        rows: cells.
        note: below it.
    """

    title: str
    headers: Sequence[str]
    rows: Sequence[Sequence[str]]
    note: str = ""


@dataclass(frozen=True, eq=False)
class Outcome:
    """The outcome of an experiment.

    Attributes:
        setup: one paragraph: what was done, on what, at which size.
        verdicts: claim by claim.
        tables: what was measured.
        drawings: the same, drawn.
        figures: all numbers, as JSON has them.
    """

    setup: str
    verdicts: Sequence[Verdict]
    tables: Sequence[Table]
    drawings: Sequence[Drawing]
    figures: Mapping[str, Any] = field(default_factory=dict)


class Experiment(Protocol):
    """One of the paper's experiments.

    A class without arguments, named in ``EXPERIMENTS``.
    """

    title: str
    """Heading of its section."""

    claim: str
    """The paper's claim, one line."""

    def run(self, context: ExperimentContext) -> Outcome:
        """Computes what is missing, and returns the outcome.

        Raises:
            SmoothOperatorError: it can't be done on these recordings.
            KeyboardInterrupt: stopped; finished cells are kept.
        """
