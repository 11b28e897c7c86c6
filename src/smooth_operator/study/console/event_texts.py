"""Steps in words for people, and names of conditions."""

from __future__ import annotations

from smooth_operator.study.design.plan import Plan
from smooth_operator.study.store.events import Named
from smooth_operator.study.store.progress import Step


def naming(plan: Plan, blind: bool) -> Named:
    """From the name of a condition to what the experimenter sees."""
    labels = {c.name: c.label for c in plan.protocol.conditions}

    def named(name: str) -> str:
        label = labels.get(name, "")
        if blind:
            return label or "?"
        return f"{label} ({name})" if label else name

    return named


def step_in_words(step: Step) -> str:
    """What is due, short."""
    if step.block is None:
        plain = {
            "withdrawn": "withdrawn",
            "refused": "consent refused",
            "form": f"form {step.form}",
        }
        return plain.get(step.what, "done")
    where = f"{step.block.task.name}, block {step.block.number}"
    match step.what:
        case "calibrate":
            return f"calibration for {step.block.task.name}"
        case "start_block":
            return f"start of {where}"
        case "start_familiarisation" | "familiarise":
            return f"free movement, {where}"
        case "start_trial" | "trial" | "paused":
            return f"trial {step.trial}, {where}" + (" (paused)" if step.what == "paused" else "")
        case "questionnaire":
            return f"questionnaire ({step.point}), {where}"
        case "weights":
            return f"pairs of scales, {where}"
    return f"break, {where}"
