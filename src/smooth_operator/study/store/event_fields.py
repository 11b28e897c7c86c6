"""Events as plain values, and back: every field is checked by its name and type."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Mapping
from dataclasses import fields
from typing import Any, Final, get_args, get_type_hints

from smooth_operator.errors import StudyError
from smooth_operator.study.store.events import EVENTS, Event
from smooth_operator.study.store.nasa_tlx import check_ratings, check_winners

_LONGEST_TEXT: Final = 20_000


def payload(event: Event) -> dict[str, Any]:
    """An event's fields as plain values."""
    return {
        name: list(value) if isinstance(value, tuple) else value
        for name, value in dataclasses.asdict(event).items()
    }


def event_of(kind: str, values: Mapping[str, Any]) -> Event:
    """An event from its kind and fields, checked as far as it can be without the plan.

    Raises:
        StudyError: no such kind, or a field is missing, unknown or of the wrong type.
    """
    if kind not in EVENTS:
        raise StudyError(f"no event is called {kind!r}; expected one of {', '.join(EVENTS)}")
    made = EVENTS[kind]
    hints = get_type_hints(made)
    known = [f.name for f in fields(made)]
    needed = {f.name for f in fields(made) if f.default is dataclasses.MISSING}
    missing, unknown = sorted(needed - set(values)), sorted(set(values) - set(known))
    if missing or unknown:
        raise StudyError(
            f"event {kind!r} has the fields {', '.join(known) or '(none)'}"
            + (f"; missing: {', '.join(missing)}" if missing else "")
            + (f"; unknown: {', '.join(unknown)}" if unknown else "")
        )
    return made(**{name: _checked(kind, name, v, hints[name]) for name, v in values.items()})


def _checked(kind: str, name: str, value: Any, hint: Any) -> Any:
    where = f"event {kind!r}: {name}"
    if name == "ratings":
        if not isinstance(value, Mapping):
            raise StudyError(f"{where} must be a table of the six scales, not {value!r}")
        check_ratings(value)
        return dict(value)
    if name == "winners":
        if not isinstance(value, list | tuple):
            raise StudyError(f"{where} must be a list of scales, not {value!r}")
        check_winners(value)
        return tuple(value)
    if name == "answers":
        return _answers(where, value)
    if name == "shown":
        listed = isinstance(value, list | tuple) and all(isinstance(v, str) for v in value)
        if not listed:
            raise StudyError(f"{where} must be a list of pairs of scales, not {value!r}")
        return tuple(value)
    if value is None and type(None) in get_args(hint):
        return None
    if hint is bool:
        if not isinstance(value, bool):
            raise StudyError(f"{where} must be true or false, not {value!r}")
        return value
    if hint is int:
        if isinstance(value, bool) or not isinstance(value, int):
            raise StudyError(f"{where} must be a whole number, not {value!r}")
        return value
    if hint in (float, float | None):
        right = isinstance(value, int | float) and not isinstance(value, bool)
        if not right or not math.isfinite(value) or value < 0:
            raise StudyError(f"{where} must be a number of 0 or more, not {value!r}")
        return float(value)
    if not isinstance(value, str) or len(value) > _LONGEST_TEXT or "\x00" in value:
        raise StudyError(f"{where} must be a text of up to {_LONGEST_TEXT} characters")
    return value


def _answers(where: str, value: Any) -> dict[str, Any]:
    if not isinstance(value, Mapping) or len(json.dumps(dict(value))) > _LONGEST_TEXT:
        raise StudyError(f"{where} must be a table of fields, not {str(value)[:80]!r}")
    for name, one in value.items():
        plain = isinstance(one, str | bool | int | float)
        listed = isinstance(one, list | tuple) and all(isinstance(part, str) for part in one)
        if not isinstance(name, str) or not (plain or listed):
            raise StudyError(f"{where}: {name!r} must be a text, a number, yes or no, or a list")
        if isinstance(one, float) and not math.isfinite(one):
            raise StudyError(f"{where}: {name!r} must be a finite number")
    return {name: list(v) if isinstance(v, tuple) else v for name, v in value.items()}
