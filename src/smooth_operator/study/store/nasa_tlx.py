"""NASA-TLX: its six scales in the published words or another language, and its score.

The workload is the unweighted mean of the scales (raw TLX, Hart 2006).
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

STEP: Final = 5
HIGHEST: Final = 100


@dataclass(frozen=True)
class Scale:
    """One of the six scales.

    Attributes:
        name: column in data.
        title: heading on the page.
        question: question under the heading.
        low: label of the end at 0.
        high: label of the end at 100; more is always worse.
    """

    name: str
    title: str
    question: str
    low: str = "Very low"
    high: str = "Very high"


SCALES: Final = (
    Scale("mental", "Mental demand", "How mentally demanding was the task?"),
    Scale("physical", "Physical demand", "How physically demanding was the task?"),
    Scale("temporal", "Temporal demand", "How hurried or rushed was the pace of the task?"),
    Scale("performance", "Performance",
          "How successful were you in accomplishing what you were asked to do?",
          "Perfect", "Failure"),
    Scale("effort", "Effort",
          "How hard did you have to work to accomplish your level of performance?"),
    Scale("frustration", "Frustration",
          "How insecure, discouraged, irritated, stressed, and annoyed were you?"),
)  # fmt: skip
SCALE_NAMES: Final = tuple(scale.name for scale in SCALES)


def check_ratings(ratings: Mapping[str, int]) -> None:
    """Checks answers to the six scales.

    Raises:
        StudyError: a scale is missing or unknown, or a rating is no step of the scale.
    """
    if set(ratings) != set(SCALE_NAMES):
        missing = sorted(set(SCALE_NAMES) - set(ratings))
        extra = sorted(set(ratings) - set(SCALE_NAMES))
        raise StudyError(
            f"NASA-TLX has the scales {', '.join(SCALE_NAMES)}"
            + (f"; missing: {', '.join(missing)}" if missing else "")
            + (f"; unknown: {', '.join(extra)}" if extra else "")
        )
    for name, rating in ratings.items():
        whole = isinstance(rating, int) and not isinstance(rating, bool)
        if not whole or not 0 <= rating <= HIGHEST or rating % STEP:
            raise StudyError(
                f"NASA-TLX {name}: expected 0 to {HIGHEST} in steps of {STEP}, not {rating!r}"
            )


def raw_workload(ratings: Mapping[str, float]) -> float:
    """Mean of the six ratings."""
    return sum(ratings[name] for name in SCALE_NAMES) / len(SCALE_NAMES)


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
"""Name -> other texts of the operator's page, in English."""


@dataclass(frozen=True)
class TlxWords:
    """Words of the operator's page.

    Attributes:
        scales: the six scales, in the order of ``SCALES``.
        texts: name -> text, with the names of ``TEXTS``.
    """

    scales: tuple[Scale, ...] = SCALES
    texts: Mapping[str, str] = field(default_factory=lambda: TEXTS)


ENGLISH: Final = TlxWords()
"""The published wording."""


def read_words(path: Path) -> TlxWords:
    """Reads words in another language.

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
    by_name = {name: texts.text(name, empty=False) for name in texts.names}
    return TlxWords(tuple(_scale(scales.table(name), name) for name in SCALE_NAMES),
                    {**TEXTS, **by_name})  # fmt: skip


def _scale(entries: Entries, name: str) -> Scale:
    entries.only("title", "question", "low", "high")
    parts = (entries.text(part, empty=False) for part in ("title", "question", "low", "high"))
    return Scale(name, *parts)
