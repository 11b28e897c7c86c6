"""Texts of the live page as HTML: modes, figures, health, calibration."""

from __future__ import annotations

import html
from collections.abc import Mapping, Sequence
from typing import Any, Final

from smooth_operator.teleop.pages.palette import PALM, SIMULATED, css, finger_colors

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
_OFF: Final = 0.01  # a wrist that is farther off is worth a word [m]
_NEAR: Final = 0.03  # [m]
_SLOW_S: Final = 0.25
_BOX: Final = "padding:0.35em 0.8em;font-size:0.875em;font-variant-numeric:tabular-nums"
_SMALL: Final = "padding:0.2em 0.8em;font-size:0.8em;font-variant-numeric:tabular-nums"
_CELL: Final = "padding:0 0.9em 0 0;text-align:right"


def modes(hands: Mapping[str, Mapping[str, Any]]) -> str:
    """What the loop does with each hand; latched fingers where the method has latches."""
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
            + ("" if not state.get("compiling") else
               "<br><span data-compiling>the robot holds: the method is compiled</span>")
            + f"<br><span data-wrist>{_wrist(state.get('wrist'))}</span>"
            + ("" if state.get("arm") is None else
               f"<br><span data-arm>{_arm(state['arm'])}</span>")
            + "</div>"
        )  # fmt: skip
    return f'<div id="live-modes" role="status" style="{_BOX}">{"".join(rows) or "…"}</div>'


def _wrist(seen: Mapping[str, Any] | None) -> str:
    """Whether the tracker has a wrist, and whether that moves the robot's."""
    if seen is None:
        return "wrist: not tracked"
    what = (
        "moves the robot's"
        if seen["engaged"]
        else "released (C)"
        if seen["released"]
        else "lost: the robot's is held"
        if seen["operator"] is None
        else "the robot's is held"
    )
    return f"wrist in {html.escape(seen['world'])}: {what}"


def _arm(arm: Mapping[str, Any]) -> str:
    """What an arm does, how far its wrist is off, and how near it is to something."""
    said = [_ARM_STATES.get(arm["state"], html.escape(arm["state"]))]
    error, clearance = arm["position_error"], arm["clearance"]
    if error is not None and error > _OFF:  # False for NaN
        said.append(f"the wrist is {1e3 * error:.0f} mm off")
    if clearance is not None and clearance < _NEAR:
        said.append(f"{1e3 * clearance:.0f} mm from touching something")
    return f"arm: {', '.join(said)}"


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
        f'<td style="{_CELL}">{found["p50"]:.2f}</td><td style="{_CELL}">{found["p99"]:.2f}</td>'
        "</tr>"
        for name, found in _in_order(status["stages"])
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
        delay: how late it shows what it is sent [s].
    """
    if delay < _SLOW_S:
        return ""
    return (
        f'<div id="live-slow" role="status" style="{_SMALL}"><b>⚠ slow browser</b> (no graphics '
        f"card?): the hands are drawn up to {delay:.1f} s late</div>"
    )


def notice(controls: Mapping[str, Any]) -> str:
    """What is under way, and what went wrong."""
    parts = []
    if controls["building"]:
        parts.append(f"<b>⏳ {html.escape(controls['building'])}…</b>")
    if controls["recording"]:
        parts.append(f"<b>⏺ recording</b> {html.escape(controls['recording'])}")
    if controls["message"]:
        parts.append(f"<b>⚠</b> {html.escape(controls['message'])}")
    return f'<div id="live-notice" role="alert" style="{_BOX}">{"<br>".join(parts)}</div>'


def legend(fingers: Sequence[str], simulated: bool, task: bool) -> str:
    """What is drawn, each with its sign: the hands, and the colours of the fingers.

    Args:
        fingers: of the robot hand, thumb first.
        simulated: whether a simulated robot is drawn.
        task: whether it works on a task, and then it is the solid one.
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


def calibration(state: Mapping[str, Any]) -> str:
    """The prompt, large; or what was found."""
    phase = state["phase"]
    if phase in ("settle", "hold", "wait"):
        words = {
            "settle": f"get ready: {state['left_s']:.0f} s",
            "hold": f"hold it: {state['left_s']:.0f} s",
            "wait": "no hand is seen: waiting",
        }[phase]
        return (
            f'<div id="live-prompt" data-phase="{phase}" style="padding:0.5em 0.8em">'
            f"<div>{state['number']} of {state['count']}, {state['side']} hand</div>"
            f'<div style="font-size:1.5em;line-height:1.2;margin:0.3em 0">'
            f"<b>{html.escape(state['text'])}</b></div>"
            f'<div style="font-size:1.2em">{words}</div></div>'
        )
    if phase == "estimate":
        return f'<div id="live-prompt" data-phase="estimate" style="{_BOX}">estimating …</div>'
    if state["error"]:
        return (
            f'<div id="live-prompt" data-phase="failed" style="{_BOX}"><b>⚠</b> '
            f"{html.escape(state['error'])}</div>"
        )
    if state["figures"]:
        return _figures(state["figures"])
    return (
        f'<div id="live-prompt" data-phase="idle" style="{_BOX}">About a minute: one pose after '
        "another is shown here, and then what they say about your hand.</div>"
    )


def _figures(found: Mapping[str, Any]) -> str:
    latch = (
        "as the method has it"
        if found["project_mm"] is None
        else f"closes at {found['project_mm']:.1f} mm, opens at {found['escape_mm']:.1f} mm"
    )
    rows = "".join(
        f'<tr><td style="padding-right:0.9em">{html.escape(name)}</td>'
        f'<td style="{_CELL}">{finger["scale"]:.2f}</td>'
        f'<td style="{_CELL}">{_mm(finger["gap_mm"])}</td>'
        f'<td style="{_CELL}">{_mm(finger["corrected_mm"])}</td></tr>'
        for name, finger in found["fingers"].items()
    )
    missing = ", ".join(found["missing"])
    return (
        f'<div id="live-prompt" data-phase="done" style="{_SMALL}">'
        f"<b>{html.escape(found['hand'])} {found['side']}</b>: {found['frames_used']} frames; palm "
        f"{found['palm_width_mm']:.0f} mm wide, scale {found['palm_scale']:.3f}; latch {latch}"
        f"<table><tr><th></th><th style='{_CELL}'>scale</th><th style='{_CELL}'>pinch gap</th>"
        f"<th style='{_CELL}'>left, 90 % under [mm]</th></tr>{rows}</table>"
        + (f"⚠ not found: {html.escape(missing)}" if missing else "✓ all poses found")
        + "</div>"
    )


def _rates(rates: Mapping[str, float | None]) -> str:
    """Of each hand, the slow ones with a decimal."""
    words = ["–" if r is None else f"{r:.0f}" if r >= 10 or r == 0 else f"{r:.1f}"
             for r in rates.values()]  # fmt: skip
    return " / ".join(words if len(set(words)) > 1 else words[:1])


def _mm(value: float | None) -> str:
    return "–" if value is None else f"{value:.1f}"


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
