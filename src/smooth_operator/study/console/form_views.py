"""Forms as the pages show them, as plain values for JSON."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from smooth_operator.study.design.forms import Form, FormField
from smooth_operator.study.store.progress import Progress


def form_view(progress: Progress, form: Form) -> dict[str, Any]:
    """A form with its fields, for an operator."""
    return {
        "form": form.name,
        "title": form.title or form.name,
        "text": form.text,
        "fields": [_field(field, progress) for field in form.fields],
    }


def forms_view(progress: Progress) -> list[dict[str, Any]]:
    """The forms of an operator as the experimenter sees them: which are filled in, and by whom.

    ``state`` is ``filled``, ``paper`` (to be typed in), ``due`` or ``later``; ``can`` is whether it
    may be typed in now.
    """
    found = []
    for form in progress.plan.protocol.forms:
        at, answers = progress.forms.get(form.name, (None, None))
        who = progress.typed.get(form.name, "")
        state = "filled"
        if answers is None and form.name in progress.on_paper:
            state = "paper"
            at, who = progress.on_paper[form.name]
        elif answers is None:
            state = "due" if progress.step.form == form.name else "later"
        found.append(
            {
                **form_view(progress, form),
                "state": state,
                "at": None if at is None else 1e3 * at.timestamp(),
                "who": who,
                "answers": answers,
                "can": progress.can_type(form),
            }
        )
    return found


def _field(field: FormField, progress: Progress) -> dict[str, Any]:
    made = asdict(field)
    if field.kind == "ranking":
        made["ranked"] = [
            {"label": label, "where": _met(label, progress)} for label in progress.ranked_labels()
        ]
    return made


def _met(label: str, progress: Progress) -> str:
    """In which blocks an operator has met a label: what they remember it by."""
    blocks = {(t.block.task.name, t.block.number): t.block for t in progress.trials}
    return ", ".join(
        f"{block.task.title or block.task.name}, block {block.number}"
        for block in blocks.values()
        if block.condition.label == label
    )
