"""Words of NASA-TLX and of the operator's page: published English, or a file in another language.

::

    [scales.mental]                # all six, each with all four
    title = "Geistige Anforderung"
    question = "Wie viel geistige Anstrengung war erforderlich?"
    low = "Gering"
    high = "Hoch"

    [texts]                        # optional, as each of them
    heading = "Wie war es?"
    send = "Absenden"
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Final

from smooth_operator.errors import DocumentError, StudyError
from smooth_operator.io.documents import read_json
from smooth_operator.io.entries import Entries, read_entries
from smooth_operator.study.design.draws import lot
from smooth_operator.study.store.nasa_tlx import PAIRS, SCALE_NAMES, SCALES, Scale

_MOST_BYTES: Final = 200_000

TEXTS: Final[Mapping[str, str]] = MappingProxyType(
    {
        "heading": "How was it?",
        "instruction": "Mark each of the six scales at the point that fits what you have just "
        "done. There is no right or wrong.",
        "initial": "You have done the first trial.",
        "midpoint": "You have done half of the trials.",
        "final": "You have done all trials of this block.",
        "missing": "Still to mark:",
        "complete": "All six are marked.",
        "send": "Send my answers",
        "sending": "Sending \u2026",
        "pairs_heading": "Which of the two contributed more to the workload of the task?",
        "pair": "Pair",
        "pairs_complete": "All pairs are chosen",
        "pairs_send": "Send my choices",
        "back": "Back",
        "form_missing": "Still to answer:",
        "form_complete": "Nothing is missing.",
        "yes": "Yes",
        "no": "No",
        "ranking": "Touch them in your order, the best one first.",
        "again": "Start again",
        "thanks": "Thank you",
        "saved": "Your answers are saved.",
        "done": "That was all",
        "done_text": "Thank you for taking part.",
        "break": "Break",
        "break_text": "Rest your hand. The experimenter goes on when you are ready.",
        "wait": "Please follow the experimenter",
        "wait_text": "The next questions appear here by themselves.",
    }
)
"""What else the operator's page says, in English."""


@dataclass(frozen=True)
class TlxWords:
    """What operators read.

    Attributes:
        scales: the six, in the order of ``SCALES``.
        texts: name -> text, of ``TEXTS``.
    """

    scales: tuple[Scale, ...] = SCALES
    texts: Mapping[str, str] = field(default_factory=lambda: TEXTS)


ENGLISH: Final = TlxWords()
"""As published."""


def read_words(path: Path) -> TlxWords:
    """Words in another language.

    Args:
        path: a TOML or JSON file.

    Raises:
        StudyError: it can't be read, or lacks a scale; the message names the entry.
    """
    if path.suffix.lower() == ".json":
        try:
            table = read_json(path, most_bytes=_MOST_BYTES)
        except FileNotFoundError:
            raise StudyError(f"no words of NASA-TLX at {path}") from None
        except (OSError, DocumentError) as error:
            raise StudyError(f"can't read the words of NASA-TLX {path}: {error}") from error
        if not isinstance(table, dict):
            raise StudyError(f"{path}: expected a table with scales and texts")
        entries = Entries(str(path), table, StudyError)
    else:
        entries = read_entries(path, "words of NASA-TLX", StudyError, most_bytes=_MOST_BYTES)
    entries.only("scales", "texts")
    scales = entries.table("scales")
    scales.only(*SCALE_NAMES)
    texts = entries.table("texts", {})
    texts.only(*TEXTS)
    given = {name: texts.text(name, empty=False) for name in texts.names}
    return TlxWords(tuple(_scale(scales.table(name), name) for name in SCALE_NAMES),
                    {**TEXTS, **given})  # fmt: skip


def _scale(entries: Entries, name: str) -> Scale:
    entries.only("title", "question", "low", "high")
    parts = (entries.text(part, empty=False) for part in ("title", "question", "low", "high"))
    return Scale(name, *parts)


def shown_pairs(seed: int, operator: str) -> tuple[tuple[str, str], ...]:
    """The fifteen pairs as an operator sees them: their order and sides are drawn for each person.

    Args:
        seed: of the study.
        operator: pseudonym.

    Returns:
        (left, right) of each pair, in the order in which they are shown.
    """
    ordered = sorted(PAIRS, key=lambda pair: lot(seed, "pair", operator, *pair))
    return tuple(
        (first, second) if lot(seed, "side", operator, first, second) < 0.5 else (second, first)
        for first, second in ordered
    )
