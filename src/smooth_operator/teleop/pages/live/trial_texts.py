"""The trial of a task on the live page, for the operator: what to do, and when to go."""

from __future__ import annotations

import html
from collections.abc import Mapping
from typing import Any, Final

_GO_S: Final = 1.5
"""So long "Go" stays after the start [s]."""

STYLE: Final = """<style>
#live-trial {position: fixed; top: 12px; left: 12px; z-index: 6; pointer-events: none;
  max-width: min(30em, 60vw); padding: 0.5em 0.9em; border-radius: 8px; color: #fff;
  background: rgba(20, 22, 26, 0.8); font-size: 1rem; line-height: 1.3}
#live-trial b {display: block; font-size: 2.2em; line-height: 1.15;
  font-variant-numeric: tabular-nums}
#live-trial[data-phase="waiting"] b, #live-trial[data-phase="paused"] b {color: #e69f00}
#live-trial[data-phase="go"] b {color: #00d79b; font-size: 4em}
</style>"""


def trial(seen: Mapping[str, Any] | None) -> str:
    """Task, number, clock and sign of a trial, as HTML; empty without a task.

    Args:
        seen: what ``TaskTrials.shown`` gave.
    """
    if seen is None:
        return ""
    phase, sign = _sign(seen)
    number, count = seen["number"], seen["count"]
    which = "" if not number else f"trial {number}" + (f" of {count}" if count else "")
    head = " · ".join(filter(None, (seen["title"], which)))
    return (
        f'<div id="live-trial" role="status" data-phase="{phase}">{html.escape(head)}'
        f"<b>{html.escape(sign)}</b>{html.escape(seen['instruction'])}</div>"
    )


def _sign(seen: Mapping[str, Any]) -> tuple[str, str]:
    phase, elapsed, limit = seen["phase"], seen["elapsed_s"], seen["limit_s"]
    if seen.get("paused"):
        return "paused", "Paused: keep your hand as it is"
    if phase == "waiting":
        return phase, "Hand away from the object"
    if phase == "running":
        if elapsed < _GO_S:
            return "go", "Go"
        return phase, f"{_clock(elapsed)} of {_clock(limit)}"
    if phase == "done":
        return phase, f"Over: {_clock(elapsed)}"
    return phase, "Wait" if seen["object"] else "Move freely"


def _clock(seconds: float) -> str:
    return f"{int(seconds) // 60}:{int(seconds) % 60:02d}"
