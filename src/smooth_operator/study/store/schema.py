"""JSON schema of ``study.json``: what another program may rely on."""

from __future__ import annotations

from typing import Any

from smooth_operator.study.data.checked_tables import WEIGHT_COLUMNS
from smooth_operator.study.store.export import FORMAT
from smooth_operator.study.store.nasa_tlx import SCALE_NAMES


def export_schema() -> dict[str, Any]:
    """JSON schema (draft 2020-12) of ``study.json``."""
    text, count = {"type": "string"}, {"type": "integer", "minimum": 1}
    moment = {"type": "string", "format": "date-time"}
    score = {"enum": [0, 0.5, 1]}
    seconds = {"type": "number", "minimum": 0}
    rating = {"type": "integer", "minimum": 0, "maximum": 100, "multipleOf": 5}
    times = {"type": "integer", "minimum": 0, "maximum": len(SCALE_NAMES) - 1}
    times_or_none = {**times, "type": ["integer", "null"]}
    workload = {"type": ["number", "null"], "minimum": 0, "maximum": 100}
    trial = {"task": text, "retargeter": text, "block": count, "trial_in_block": count}
    scoring = _object({"line": text, "score": score, "time_s": seconds})
    where = {"operator": text, "task": text, "retargeter": text, "block": count}

    def rows(**columns: Any) -> dict[str, Any]:
        return {"type": "array", "items": _object(columns)}

    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "A user study of retargeters: its plan, its data, its log",
        **_object(
            {
                "format": {"const": FORMAT},
                "study": {"type": "object", "required": ["name", "conditions", "tasks"]},
                "erased": {"type": "array", "items": text},
                "trials": rows(
                    **where,
                    trial_in_block=count,
                    trial_global=count,
                    score=score,
                    time_s={"type": ["number", "null"], "exclusiveMinimum": 0},
                    duration_s=seconds,
                    line=text,
                    resets={"type": "integer", "minimum": 0},
                    started_at=moment,
                    place=count,
                    amended={"enum": [0, 1]},
                ),
                "questionnaires": rows(
                    **where,
                    point={"enum": ["initial", "midpoint", "final"]},
                    **dict.fromkeys(SCALE_NAMES, rating),
                    **dict.fromkeys(WEIGHT_COLUMNS, times_or_none),
                    raw_workload=workload,
                    weighted_workload=workload,
                    answered_at=moment,
                    typed_by={"type": ["string", "null"]},
                ),
                "weights": rows(
                    **where,
                    **dict.fromkeys(SCALE_NAMES, times),
                ),
                "operators": rows(
                    operator=text,
                    done={"type": "boolean"},
                    notes=rows(at=moment, text=text),
                    breaks=rows(started_at=moment, ended_at={"type": ["string", "null"]}),
                    withdrawn={
                        **_object({"at": moment, "keep": {"type": "boolean"}, "reason": text}),
                        "type": ["object", "null"],
                    },
                    replaces={"type": ["string", "null"]},
                    forms=_by_name(
                        _object(
                            {
                                "at": moment,
                                "answers": {"type": "object"},
                                "typed_by": {"type": ["string", "null"]},
                            }
                        )
                    ),
                    forms_on_paper=_by_name(_object({"at": moment, "who": text})),
                    ranking={"type": "array", "items": text},
                    voided=rows(**trial, reason=text),
                    pauses=rows(
                        **trial,
                        at=moment,
                        length_s={"type": ["number", "null"], "minimum": 0},
                        reason=text,
                    ),
                    recalibrations=rows(at=moment, task=text, detail=text),
                    ended_early=rows(
                        task=text, retargeter=text, block=count, at=moment, reason=text
                    ),
                    amendments=rows(
                        **trial, at=moment, before=scoring, after=scoring, reason=text, who=text
                    ),
                    undone=_by_name(count),
                    events=rows(
                        number=count,
                        at=moment,
                        author={"enum": ["experimenter", "operator", "system"]},
                        kind=text,
                        fields={"type": "object"},
                    ),
                ),
            }
        ),
    }


def _by_name(values: dict[str, Any]) -> dict[str, Any]:
    return {"type": "object", "additionalProperties": values}


def _object(columns: dict[str, Any]) -> dict[str, Any]:
    return {
        "type": "object",
        "properties": columns,
        "required": list(columns),
        "additionalProperties": False,
    }
