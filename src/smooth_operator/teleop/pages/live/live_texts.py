"""Texts of the live page as HTML: modes, figures, health, the trial of a task."""

from __future__ import annotations

import html
from collections.abc import Mapping, Sequence
from pathlib import PurePath
from typing import Any, Final

from smooth_operator.teleop.pages.hand_view import PALM, SIMULATED, css, finger_colors

# Okabe and Ito's colours; the sign and the word say the same to who can't distinguish them.
_MODES: Final[dict[str, tuple[str, str, str]]] = {
    "waiting": ("◌", "waiting for the tracker", "#999999"),
    "tracking": ("▶", "tracking", "#009e73"),
    "blending": ("⇢", "going over to the operator", "#56b4e9"),
    "holding": ("❚❚", "holding: the tracker is late", "#e69f00"),
    "easing": ("↩", "tracker lost: easing to the safe pose", "#e69f00"),
    "paused": ("❚❚", "paused", "#cc79a7"),
    "stopped": ("■", "STOPPED", "#ff2a2a"),
}
_STATES: Final = {
    "running": "✓",
    "open": "✓",
    "waiting": "◌",
    "ended": "■",
    "closed": "■",
    "failed": "⚠",
}
_ARM_STATES: Final = {
    "following": "follows",
    "holding": "holds",
    "braking": "brakes, too near to something",
    "stopped": "stopped",
}
_STARTS: Final = "◌ getting ready: the hand and its method are read"
_OFF: Final = 0.01  # a wrist that is farther off is worth a word [m]
_NEAR: Final = 0.03  # [m]
_SLOW_S: Final = 0.25
_BOX: Final = "padding:0.35em 0.8em;font-size:0.875em;font-variant-numeric:tabular-nums"
_SMALL: Final = "padding:0.2em 0.8em;font-size:0.8em;font-variant-numeric:tabular-nums"
_CELL: Final = "padding:0 0.9em 0 0;text-align:right"


def modes(hands: Mapping[str, Mapping[str, Any]]) -> str:
    """Mode of each hand; latched fingers where the method has latches."""
    rows = []
    for side, state in hands.items():
        sign, words, color = _MODES[state["mode"]]
        latched = state["latched"]
        rows.append(
            f'<div data-side="{html.escape(side)}" data-mode="{state["mode"]}" style="'
            f'border-left:0.5em solid {color};padding-left:0.6em;margin:0.25em 0">'
            f"<b>{sign} {side}: {words}</b>"
            + ("" if latched is None else "<br><span data-latched>pinch latches: "
               f"{html.escape(', '.join(latched) or 'none')}</span>")
            + ("" if (seconds := state.get("compiling")) is None else
               "<br><span data-compiling>the robot holds until the method is compiled: "
               f"{seconds:.0f} s (a first start takes up to a minute)</span>")
            + f"<br><span data-wrist>wrist: {_wrist(state)}</span>"
            + ("" if state.get("arm") is None else
               f"<br><span data-arm>{_arm(state['arm'])}</span>")
            + "</div>"
        )  # fmt: skip
    return f'<div id="live-modes" role="status" style="{_BOX}">{"".join(rows) or _STARTS}</div>'


def _wrist(state: Mapping[str, Any]) -> str:
    """State of the operator's wrist, or the reason why the robot's is held."""
    wrist, mode = state.get("wrist"), state["mode"]
    if wrist is None:
        return "not tracked"
    if wrist["engaged"]:
        return "tracked, no arm here" if state.get("arm") is None else "moves the arm"
    if mode in ("stopped", "paused"):
        return f"held ({mode})"
    if wrist["released"]:
        return "held (released; C engages)"
    return "held" if wrist["tracked"] else "held (the tracker lost it)"


def _arm(arm: Mapping[str, Any]) -> str:
    """State of an arm, the error of its wrist, and its clearance."""
    facts = [_ARM_STATES.get(arm["state"], html.escape(arm["state"]))]
    error, clearance = arm["position_error"], arm["clearance"]
    if error is not None and error > _OFF:  # False for NaN
        facts.append(f"the wrist is {1e3 * error:.0f} mm off")
    if clearance is not None and clearance < _NEAR:
        facts.append(f"{1e3 * clearance:.0f} mm from touching something")
    return f"arm: {', '.join(facts)}"


def summary(status: Mapping[str, Any]) -> str:
    """The tracker's rate, the commands' rate, the latency, and how the source is."""
    total = status["stages"].get("total", {})
    latency = (
        f"<br>received to sent <b>{total['p50']:.1f}</b> ms p50, <b>{total['p99']:.1f}</b> ms p99"
        if total
        else ""
        if status["blind"]
        else "<br>no frame answered yet"
    )
    delays = [delay for delay in status.get("motion_delay", {}).values() if delay is not None]
    if delays:
        words = " / ".join(f"{1e3 * delay:.0f}" for delay in delays)
        latency += f"<br><span data-delay>command to motion <b>{words}</b> ms</span>"
    source = status["source"]
    return (
        f'<div id="live-summary" style="{_BOX}"><span data-rate="frames">tracker '
        f"<b>{_rates(status['frame_rates'])}</b> frames/s</span> · "
        f'<span data-rate="commands">commands <b>{_rates(status["rates"])}</b> Hz</span>'
        f"{latency}<br>{_sign(source['state'])} {html.escape(source['label'])}: {source['state']}"
        f"{_detail(source['detail'])}</div>"
    )


def timing(status: Mapping[str, Any]) -> str:
    """Every stage, counts of what went wrong, sinks, and what happened last."""
    head = "".join(f'<th style="{_CELL}">{w}</th>' for w in ("", "p50 [ms]", "p99 [ms]"))
    rows = "".join(
        f'<tr><td style="padding-right:0.9em">{html.escape(name)}</td>'
        f'<td style="{_CELL}">{figures["p50"]:.2f}</td>'
        f'<td style="{_CELL}">{figures["p99"]:.2f}</td></tr>'
        for name, figures in _in_order(status["stages"])
    )
    refused: dict[str, int] = {}
    for reasons in status["refused"].values():
        for reason, count in reasons.items():
            refused[reason] = refused.get(reason, 0) + count
    words = "; ".join(f"{n} × {html.escape(reason)}" for reason, n in refused.items()) or "none"
    events = "".join(
        f"<li>{html.escape(what)} <i>({at:.0f} s ago)</i></li>"
        for at, what in reversed(status["events"])
    )
    return (
        f'<div id="live-timing" style="{_SMALL}"><table><tr>{head}</tr>{rows}</table>'
        f"late commands: {100 * status['missed_share']:.2f} %<br>"
        f"frames refused: {words}<br>frames of no use: {status['unusable']}</div>"
        f'<div id="live-sinks" style="{_SMALL}"><b>Sinks</b><br>{_sinks(status["sinks"])}</div>'
        f'<div style="{_SMALL}"><b>Events</b><ul style="margin:0;padding-left:1.2em">{events}'
        "</ul></div>"
    )


def slow(delay: float) -> str:
    """A warning that the browser draws slowly; nothing where it keeps up.

    Args:
        delay: delay of the browser [s].
    """
    if delay < _SLOW_S:
        return ""
    return (
        f'<div id="live-slow" role="status" style="{_SMALL}"><b>⚠ slow browser</b> (no graphics '
        f"card?): the hands are drawn up to {delay:.1f} s late</div>"
    )


def notice(controls: Mapping[str, Any]) -> str:
    """Work under way, and the last error."""
    parts = []
    if controls["building"]:
        parts.append(f"<b>⏳ {html.escape(controls['building'])}…</b>")
    if controls["message"]:
        parts.append(f"<b>⚠</b> {html.escape(controls['message'])}")
    return f'<div id="live-notice" role="alert" style="{_BOX}">{"<br>".join(parts)}</div>'


def take(state: Mapping[str, Any], quality: Sequence[Any] | str) -> str:
    """The take that is recorded, or the last one with its quality; empty before the first.

    Args:
        state: result of ``Takes.state``.
        quality: ``TakeQuality`` of each file of the last take, or why there is none.
    """
    count = f"takes kept: {state['kept']}"
    if state["recording"]:
        head = f"⏺ recording {html.escape(state['recording'])}"
        return _take(f'<b style="color:#ff5a5a">{head}</b><br>{state["seconds"]:.1f} s · {count}')
    if not state["last"]:
        return ""
    names = ", ".join(PurePath(path).name for path in state["last"])
    if isinstance(quality, str):
        figures = html.escape(quality)
    else:
        figures = "<br>".join(_quality(each) for each in quality)
    return _take(f"<b>{html.escape(names)}</b> · {count}<br>{figures}")


def _take(content: str) -> str:
    return f'<div id="live-take" role="status" style="{_BOX}">{content}</div>'


def _quality(quality: Any) -> str:
    """One line: length, and of each fault how much of it there is."""
    facts = [
        (quality.lost_s >= 0.05, f"{quality.lost_s:.1f} s without the tracker"),
        (quality.unused > 0, f"{quality.unused} frames of no use"),
        (quality.jumps > 0, f"{quality.jumps} jumps"),
        (
            bool(quality.collision),
            "self-collision can't be measured"
            if quality.collision is None
            else f"self-collision {100 * quality.collision:.0f} % of poses"
            + (f", {quality.depth_mm:.1f} mm deep" if quality.collision else ""),
        ),
    ]
    marks = " · ".join(f"{'⚠' if bad else '✓'}&nbsp;{words}" for bad, words in facts)
    return f"{quality.seconds:.1f} s, {quality.frames} frames<br>{marks}"


def legend(fingers: Sequence[str], simulated: bool, task: bool) -> str:
    """Legend of the picture: the hands, and the colours of the fingers.

    Args:
        fingers: fingers of the robot hand, thumb first.
        simulated: True if a simulated robot is drawn.
        task: True if it works on a task, and then it is the solid one.
    """
    solid, other = "robot command", "simulated or measured robot, where it differs"
    if task:
        solid, other = "simulated robot", "robot command, where it differs"
    hands = [("●", css(PALM), "human hand, as tracked"), ("■", css(PALM), solid)]
    if simulated:
        hands.append(("■", css(SIMULATED), other))
    colors = [
        ("⬤", css(color), name)
        for name, color in zip(fingers, finger_colors(len(fingers)), strict=True)
    ]
    rows = "<br>".join(" ".join(_chip(*chip) for chip in row) for row in (hands, colors))
    return f'<div id="live-legend" style="padding:0 0.8em 0.5em;font-size:0.75em">{rows}</div>'


def _chip(sign: str, color: str, text: str) -> str:
    return (
        '<span data-chip style="white-space:nowrap;margin-right:0.7em">'
        f'<span style="color:{color}">{sign}</span> {html.escape(text)}</span>'
    )


def _rates(rates: Mapping[str, float | None]) -> str:
    """Rates of the hands, the slow ones with a decimal."""
    words = ["–" if r is None else f"{r:.0f}" if r >= 10 or r == 0 else f"{r:.1f}"
             for r in rates.values()]  # fmt: skip
    return " / ".join(words if len(set(words)) > 1 else words[:1])


def _in_order(stages: Mapping[str, Any]) -> list[tuple[str, Any]]:
    """The total last: it is the sum, but for what is before the arrival."""
    return sorted(stages.items(), key=lambda item: item[0] == "total")


def _sinks(sinks: Sequence[Mapping[str, Any]]) -> str:
    lines = [
        f"{_sign(sink['state'])} {html.escape(sink['label'])}: {sink['state']}, "
        f"{sink['sent']} sent" + (f", {sink['failed']} × failed" if sink["failed"] else "")
        + _detail(sink["detail"])
        for sink in sinks
    ]  # fmt: skip
    return "<br>".join(lines) or "none; the page alone shows the commands"


def _sign(state: str) -> str:
    return _STATES.get(state, "?")


def _detail(text: str) -> str:
    return f" – {html.escape(text)}" if text else ""


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


def trial(state: Mapping[str, Any] | None) -> str:
    """Task, number, clock and sign of a trial, as HTML; empty without a task.

    Args:
        state: result of ``TaskTrials.shown``.
    """
    if state is None:
        return ""
    phase, sign = _phase(state)
    number, count = state["number"], state["count"]
    which = "" if not number else f"trial {number}" + (f" of {count}" if count else "")
    head = " · ".join(filter(None, (state["title"], which)))
    return (
        f'<div id="live-trial" role="status" data-phase="{phase}">{html.escape(head)}'
        f"<b>{html.escape(sign)}</b>{html.escape(state['instruction'])}</div>"
    )


def _phase(state: Mapping[str, Any]) -> tuple[str, str]:
    phase, elapsed, limit = state["phase"], state["elapsed_s"], state["limit_s"]
    if state.get("paused"):
        return "paused", "Paused: keep your hand as it is"
    if phase == "waiting":
        return phase, "Hand away from the object"
    if phase == "running":
        if elapsed < _GO_S:
            return "go", "Go"
        return phase, f"{_clock(elapsed)} of {_clock(limit)}"
    if phase == "done":
        return phase, f"Over: {_clock(elapsed)}"
    return phase, "Wait" if state["object"] else "Move freely"


def _clock(seconds: float) -> str:
    return f"{int(seconds) // 60}:{int(seconds) % 60:02d}"
