"""NASA-TLX questionnaire: its six scales, in the published wording or another language, its score.

The workload is the unweighted mean of the scales (raw TLX, Hart 2006).
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Final

from smooth_operator.errors import DocumentError, StudyError
from smooth_operator.io.documents import read_json
from smooth_operator.io.entries import Entries, read_entries

STEP: Final = 5
HIGHEST: Final = 100
SCALE_NAMES: Final = (
    "mental",
    "physical",
    "temporal",
    "performance",
    "effort",
    "frustration",
)
"""Names of the scales in data; each is 0 to 100, and more is always worse."""


def check_ratings(ratings: Mapping[str, int]) -> None:
    """Checks answers to the six scales."""
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


@dataclass(frozen=True)
class Scale:
    """One of the six scales.

    Attributes:
        name: column in data.
        title: heading on the page.
        question: question under the heading.
        low: label of the end at 0.
        high: label of the end at 100.
    """

    name: str
    title: str
    question: str
    low: str
    high: str


@dataclass(frozen=True)
class TlxWords:
    """Texts of the NASA-TLX on the operator's page.

    Attributes:
        scales: the six scales, in the order of ``SCALE_NAMES``.
        texts: name -> another text of the page.
    """

    scales: tuple[Scale, ...]
    texts: Mapping[str, str]


_MOST_BYTES: Final = 200_000


def _words(entries: Entries, texts: Mapping[str, str]) -> TlxWords:
    """Reads a table of words; ``texts`` are those that it may leave out."""
    entries.only("scales", "texts")
    scales, others = entries.table("scales"), entries.table("texts", {})
    scales.only(*SCALE_NAMES)
    others.only(*(texts or others.names))
    return TlxWords(
        tuple(_scale(scales.table(name), name) for name in SCALE_NAMES),
        {**texts, **{name: others.text(name, empty=False) for name in others.names}},
    )


def _scale(entries: Entries, name: str) -> Scale:
    entries.only("title", "question", "low", "high")
    parts = (entries.text(part, empty=False) for part in ("title", "question", "low", "high"))
    return Scale(name, *parts)


_ENGLISH: Final = (files(__package__) / "tlx.toml").read_text("utf-8")
ENGLISH: Final = _words(Entries("tlx.toml", tomllib.loads(_ENGLISH), StudyError), {})
"""The published wording."""


def read_words(path: Path) -> TlxWords:
    """Reads words in another language.

    Args:
        path: a TOML or JSON file.
    """
    if path.suffix.lower() == ".json":
        try:
            table = read_json(path, most_bytes=_MOST_BYTES)
        except FileNotFoundError:
            raise StudyError(f"no wording of NASA-TLX at {path}") from None
        except (OSError, DocumentError) as error:
            raise StudyError(f"can't read the wording of NASA-TLX {path}: {error}") from error
        if not isinstance(table, dict):
            raise StudyError(f"{path}: expected a table with scales and texts")
        entries = Entries(str(path), table, StudyError)
    else:
        entries = read_entries(path, "wording of NASA-TLX", StudyError, most_bytes=_MOST_BYTES)
    return _words(entries, ENGLISH.texts)
