"""Results of the cross-hand matrix in one small text file, which a later run continues.

A line of the file is a JSON object with a cell (``task``, ``hand``, ``method``, ``tracker``), the
digest of the ``code`` that computed it, and its trials as columns:

- ``worlds``, ``seconds`` and ``mechanism`` (absent if all are 0): a list with a number per trial;
- ``scores`` (twice the score), ``ends`` (``ENDS``) and ``contacts`` (``CONTACTS``): a string with a
  character per trial;
- ``reason``: a string with a letter per trial, ``a`` for the first one of the list ``reasons``.

A hand that can't do the task has an ``obstacle`` instead. 40,000 trials take 1 MB.
"""

from __future__ import annotations

import json
import string
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, NamedTuple

from smooth_operator.atomic_files import atomic_write
from smooth_operator.errors import DocumentError, SmoothOperatorError
from smooth_operator.io.documents import parse_json

CONTACTS: Final = {
    "n": "no finger touched the object",
    "t": "only the thumb touched it",
    "f": "only other fingers touched it",
    "s": "thumb and fingers touched it, never at the same time",
    "b": "thumb and a finger touched it at the same time",
}
"""Letter of a trial -> contacts of the object during the trial."""

ENDS: Final = {"s": "success", "d": "drop", "t": "timeout", "f": "finished"}
"""Letter of a trial -> way in which it ended."""

_LETTERS: Final = string.ascii_lowercase + string.ascii_uppercase


class Cell(NamedTuple):
    """One condition of the matrix.

    Attributes:
        task: name of the task.
        hand: name of the right robot hand.
        method: method and preset, such as ``sbr:paper``.
        tracker: kind of tracker; "" for a hand's own demonstration, which no tracker sees.
    """

    task: str
    hand: str
    method: str
    tracker: str


class Trial(NamedTuple):
    """Result of one trial.

    Attributes:
        score: 0, 0.5 or 1.
        reason: line of the task's rubric and the reason for it, with ``#`` for numbers with a unit.
        end: a letter of ``ENDS``.
        contact: a letter of ``CONTACTS``.
        seconds: time from the start to the end [s].
        mechanism: largest position of the scene's moving part, such as a nail [m or rad]; 0 without
            one.
    """

    score: float
    reason: str
    end: str
    contact: str
    seconds: float
    mechanism: float = 0.0


@dataclass(eq=False)
class Row:
    """Trials of a cell by one state of the code.

    Attributes:
        trials: world number -> trial.
        obstacle: reason why the hand can't do the task, such as its size; "" if it can.
    """

    trials: dict[int, Trial] = field(default_factory=dict)
    obstacle: str = ""


class MatrixResults:
    """Results by cell and code digest, read from a file and written to it.

    Args:
        path: the file; created by ``write``.

    Raises:
        DocumentError: the file is not a file of results.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.rows: dict[tuple[Cell, str], Row] = {}
        for number, line in enumerate(path.read_bytes().splitlines() if path.exists() else [], 1):
            try:
                cell, code, row = _row(parse_json(line))
            except (SmoothOperatorError, KeyError, TypeError, ValueError, IndexError) as error:
                raise DocumentError(
                    f"line {number} of {path} is not a cell of the cross-hand matrix ({error!r}); "
                    "restore the file, or choose another one"
                ) from error
            self.rows[cell, code] = row

    def add(self, cell: Cell, code: str, row: Row) -> None:
        """Adds trials, which replace those of the same worlds by other code; an obstacle replaces
        everything by other code."""
        own = self.rows.setdefault((cell, code), Row())
        own.trials |= row.trials
        own.obstacle = row.obstacle
        for digest, other in self.of(cell).items():
            if digest == code:
                continue
            other.trials = {w: t for w, t in other.trials.items() if w not in own.trials}
            if own.obstacle or not other.trials:
                del self.rows[cell, digest]

    def write(self) -> None:
        """Replaces the file atomically; OutputError if it can't be written."""
        lines = [
            _line(cell, code, row)
            for (cell, code), row in sorted(self.rows.items(), key=lambda item: item[0])
        ]
        with atomic_write(self.path) as file:
            file.write("".join(lines).encode())

    def missing(self, cell: Cell, code: str, worlds: list[int], *, keep_older: bool) -> list[int]:
        """Worlds of a cell that have no result.

        Args:
            keep_older: True if results by other code count.
        """
        rows = [row for digest, row in self.of(cell).items() if digest == code or keep_older]
        if any(row.obstacle for row in rows):
            return []
        present = {world for row in rows for world in row.trials}
        return [world for world in worlds if world not in present]

    def of(self, cell: Cell) -> dict[str, Row]:
        """Rows of a cell, by code digest."""
        return {code: row for (own, code), row in self.rows.items() if own == cell}


def _line(cell: Cell, code: str, row: Row) -> str:
    content: dict[str, Any] = {**cell._asdict(), "code": code}
    if row.obstacle:
        content["obstacle"] = row.obstacle
    if row.trials:
        worlds = sorted(row.trials)
        trials = [row.trials[world] for world in worlds]
        reasons = sorted({trial.reason for trial in trials})
        content |= {
            "worlds": worlds,
            "scores": "".join(f"{2 * trial.score:.0f}" for trial in trials),
            "ends": "".join(trial.end for trial in trials),
            "contacts": "".join(trial.contact for trial in trials),
            "reasons": reasons,
            "reason": "".join(_LETTERS[reasons.index(trial.reason)] for trial in trials),
            "seconds": [round(trial.seconds, 2) for trial in trials],
        }
        if any(trial.mechanism for trial in trials):
            content["mechanism"] = [round(trial.mechanism, 4) for trial in trials]
    return json.dumps(content, ensure_ascii=False, separators=(",", ":")) + "\n"


def _row(content: Mapping[str, Any]) -> tuple[Cell, str, Row]:
    cell = Cell(*(str(content[name]) for name in Cell._fields))
    row = Row(obstacle=str(content.get("obstacle", "")))
    worlds = content.get("worlds", [])
    mechanism = content.get("mechanism", [0.0] * len(worlds))
    for k, world in enumerate(worlds):
        trial = Trial(
            int(content["scores"][k]) / 2,
            content["reasons"][_LETTERS.index(content["reason"][k])],
            content["ends"][k],
            content["contacts"][k],
            float(content["seconds"][k]),
            float(mechanism[k]),
        )
        if trial.end not in ENDS or trial.contact not in CONTACTS:
            raise ValueError(
                f"trial {k} ends with {trial.end!r} and has contacts {trial.contact!r}"
            )
        row.trials[int(world)] = trial
    return cell, str(content["code"]), row
