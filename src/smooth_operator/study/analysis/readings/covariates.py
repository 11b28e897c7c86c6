"""Reading: do differences stay with what operators said of themselves as further terms?"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from jaxtyping import Float

from smooth_operator.errors import StudyError
from smooth_operator.study.analysis.frame import Frame, keep_rows
from smooth_operator.study.analysis.readings.clusters import WaldTest
from smooth_operator.study.analysis.readings.fits import fit_with
from smooth_operator.study.analysis.readings.parts import Estimate, Refused, found_or_refused
from smooth_operator.study.analysis.results import Outcome
from smooth_operator.study.design.forms import Form

_MOST_LEVELS: Final = 4
_FEWEST: Final = 2
"""Operators that each answer of a choice needs."""


@dataclass(frozen=True)
class Covariate:
    """One field of a form as a further term.

    Attributes:
        without: differences from the baseline without it, of the same rows, one by one.
        adjusted: with it.
        slope: change of the outcome per unit of the answer (success: of the logit); None for a
            choice.
        test: of the term.
        operators: who answered.
    """

    without: Mapping[str, Estimate]
    adjusted: Mapping[str, Estimate]
    slope: Estimate | None
    test: WaldTest
    operators: int


def usable_fields(forms: Mapping[str, Mapping[str, Any]], plan: Sequence[Form] = ()) -> list[str]:
    """Fields that are numbers, or choices with few answers, and that differ between operators.

    Args:
        forms: operator -> field -> answer.
        plan: the forms of the plan. What operators are asked after the last block is an outcome and
            left out; texts, consents and rankings are no covariates.
    """
    names = dict.fromkeys(name for answers in forms.values() for name in answers)
    asked = {
        name
        for form in plan
        for field in form.fields
        for name in (field.name, f"{form.name}.{field.name}")
        if form.when == "before" and field.kind in ("number", "choice", "scale")
    }
    return [
        name
        for name in names
        if (name in asked or not plan) and field_answers(forms, name)[1] is not None
    ]


def covariate(
    outcome: Outcome, frame: Frame, forms: Mapping[str, Mapping[str, Any]], name: str
) -> Covariate | Refused:
    """Fits with one field of the forms.

    Args:
        outcome: decides on the model.
        frame: the rows.
        forms: operator -> field -> answer.
        name: of the field.
    """
    answers, kind = field_answers(forms, name)
    return found_or_refused(lambda: _covariate(outcome, frame, answers, number=kind == "number"))


def field_answers(
    forms: Mapping[str, Mapping[str, Any]], name: str
) -> tuple[dict[str, Any], str | None]:
    """Operator -> answer to a field, and whether it is a ``number`` or a ``choice``; else None.

    Args:
        forms: operator -> field -> answer.
        name: of the field.
    """
    given = {who: answers.get(name) for who, answers in forms.items()}
    found = {who: answer for who, answer in given.items() if answer not in (None, "")}
    return found, _kind(found)


def _number(answer: Any) -> float | None:
    if isinstance(answer, bool):
        return None
    try:
        value = float(answer)
    except (TypeError, ValueError):
        return None
    return value if np.isfinite(value) else None


def _kind(answers: Mapping[str, Any]) -> str | None:
    if len(set(map(str, answers.values()))) < 2 or any(
        isinstance(answer, (list, tuple)) for answer in answers.values()
    ):
        return None
    if all(_number(answer) is not None for answer in answers.values()):
        return "number"
    words, counts = np.unique(list(map(str, answers.values())), return_counts=True)
    return "choice" if len(words) <= _MOST_LEVELS and counts.min() >= _FEWEST else None


def _covariate(
    outcome: Outcome, frame: Frame, answers: Mapping[str, Any], *, number: bool
) -> Covariate:
    rows = np.array([frame.operators[g] in answers for g in frame.group], bool)
    kept = keep_rows(frame, rows)
    if kept.retargeters[:1] != (frame.baseline,):
        raise StudyError(f"no rows of the baseline, {frame.baseline}")
    of_rows = [answers[kept.operators[g]] for g in kept.group]
    columns = _columns(of_rows, number=number)
    fit = fit_with(outcome, kept, columns)
    last = slice(-columns.shape[1], None)
    return Covariate(
        without=fit_with(outcome, kept).differences(),
        adjusted=fit.differences(),
        slope=fit.coefficient(len(fit.beta) - 1) if number else None,
        test=fit.joint(last),
        operators=len(kept.operators),
    )


def _columns(answers: list[Any], *, number: bool) -> Float[np.ndarray, "n q"]:
    if number:
        columns = np.array(answers, float)[:, None]
    else:
        words = np.array(list(map(str, answers)))
        columns = (words[:, None] == np.unique(words)[1:]).astype(float)
    return np.asarray(columns - columns.mean(axis=0))
