"""Forms of a study: their fields, checks of answers, and the default ones."""

from __future__ import annotations

import dataclasses
import math
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files
from typing import Any, Final, Literal, TypeAlias, get_args

from smooth_operator.errors import StudyError
from smooth_operator.io.entries import Entries
from smooth_operator.simulation.tasks.task import check_name, distinct, whole
from smooth_operator_study.records import record

When: TypeAlias = Literal["before", "after"]
Kind: TypeAlias = Literal["text", "number", "choice", "scale", "consent", "ranking"]
KINDS: Final[tuple[Kind, ...]] = get_args(Kind)
_LONGEST: Final = 4000


@dataclass(frozen=True)
class FormField:
    """A question of a form.

    Attributes:
        name: name in the data.
        label: text of the question, in any language.
        kind: ``text``; ``number``; ``choice``, one of ``choices``; ``scale``, 1 to ``steps``;
            ``consent``, yes or no; ``ranking``, the blind labels from the best to the worst.
        required: whether an answer is required; without a required consent nothing starts. None
            requires consents only.
        choices: options of a choice.
        low: label of the low end of a scale.
        high: label of the high end of a scale.
        steps: number of steps of a scale.
        least: smallest number; None for no bound.
        most: largest number; None for no bound.
    """

    name: str
    label: str
    kind: Kind = "text"
    required: bool | None = None
    choices: tuple[str, ...] = ()
    low: str = ""
    high: str = ""
    steps: int = 7
    least: float | None = None
    most: float | None = None

    def __post_init__(self) -> None:
        if self.required is None:
            object.__setattr__(self, "required", self.kind == "consent")
        check_name(self.name, "field of a form")
        if not self.label.strip():
            raise StudyError(f"field {self.name!r} of a form needs a label")
        if (self.kind == "choice") != bool(self.choices) or len(self.choices) == 1:
            raise StudyError(
                f"field {self.name!r}: a field of kind choice needs at least two choices, "
                "and other kinds have none"
            )
        distinct(list(self.choices), f"choices of {self.name!r}")
        if self.least is not None and self.most is not None and self.least > self.most:
            raise StudyError(f"field {self.name!r}: least is {self.least:g}, most {self.most:g}")
        whole(self.steps, 2, 101, f"field {self.name!r}: steps of a scale")


@dataclass(frozen=True)
class Form:
    """A page of questions.

    Attributes:
        name: name in the data.
        when: ``before`` the first block or ``after`` the last one.
        fields: one question or more.
        title: title on the page.
        text: text above the questions.
    """

    name: str
    when: When
    fields: tuple[FormField, ...]
    title: str = ""
    text: str = dataclasses.field(default="", metadata={"lines": True})

    @property
    def heading(self) -> str:
        """Title on the page; the form's name if it has no title."""
        return self.title or self.name

    def __post_init__(self) -> None:
        check_name(self.name, "form")
        if not self.fields:
            raise StudyError(f"form {self.name!r} needs a field")
        distinct([field.name for field in self.fields], f"fields of form {self.name!r}")
        for field in self.fields:
            if field.kind == "ranking" and self.when == "before":
                raise StudyError(f"form {self.name!r}: a ranking is only possible after the blocks")

    def check(self, answers: Mapping[str, Any], ranked: Sequence[str]) -> None:
        """Checks the answers to this form.

        Args:
            answers: field -> answer; answers that are not required may be missing.
            ranked: labels that a ranking must hold.
        """
        by_name = {field.name: field for field in self.fields}
        for name in answers:
            if name not in by_name:
                raise StudyError(f"form {self.name!r} has no field {name!r}")
        for field in self.fields:
            if field.name in answers:
                expected = _expected(field, answers[field.name], ranked)
                if expected:
                    raise StudyError(
                        f"form {self.name!r}, field {field.name!r}: expected {expected}"
                    )
            elif field.required and (field.kind != "ranking" or len(ranked) > 1):
                raise StudyError(f"form {self.name!r}: field {field.name!r} is not answered")

    def refused(self, answers: Mapping[str, Any]) -> bool:
        """True if a required consent was refused."""
        return any(
            field.kind == "consent" and field.required and answers.get(field.name) is not True
            for field in self.fields
        )


def _expected(field: FormField, value: Any, ranked: Sequence[str]) -> str:
    """Describes the valid answers of a field; empty if the value is valid."""
    number = isinstance(value, int | float) and not isinstance(value, bool)
    match field.kind:
        case "text":
            right = isinstance(value, str) and len(value) <= _LONGEST
            return "" if right and (value.strip() or not field.required) else "a text"
        case "number":
            least = -math.inf if field.least is None else field.least
            most = math.inf if field.most is None else field.most
            right = number and math.isfinite(value) and least <= value <= most
            return "" if right else f"a number from {least:g} to {most:g}"
        case "choice":
            return "" if value in field.choices else f"one of {', '.join(field.choices)}"
        case "scale":
            right = number and value == int(value) and 1 <= value <= field.steps
            return "" if right else f"a whole number from 1 to {field.steps}"
        case "consent":
            return "" if isinstance(value, bool) else "true or false"
    listed = isinstance(value, list | tuple) and all(isinstance(v, str) for v in value)
    right = listed and sorted(value) == sorted(ranked)
    return "" if right else f"each of these once: {', '.join(ranked)}"


_DEFAULT: Final = tomllib.loads((files(__package__) / "forms.toml").read_text("utf-8"))
DEFAULT_FORMS: Final = tuple(
    record(Form, entries) for entries in Entries("forms.toml", _DEFAULT, StudyError).tables("forms")
)
"""Default forms of a study, in their order."""
