"""Texts of the live page as HTML, from the macros in ``live_texts.html.j2``, which escape
values."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import PurePath
from typing import Any, Final

from smooth_operator.errors import counted
from smooth_operator.teleop.cameras import LATE_S
from smooth_operator.teleop.pages.hand_view import HIGHLIGHT, PALM, SIMULATED, css, finger_colors
from smooth_operator.teleop.sinks.tick import Mode

_SLOW_S: Final = 0.25
_SHORTEST_S: Final = 0.05  # shortest hold that counts as a fault of a take [s]
_GO_S: Final = 1.5  # time of "Go" after the start of a trial [s]


@cache
def _macros() -> Any:
    from jinja2 import Environment, PackageLoader, StrictUndefined

    package = "smooth_operator.teleop.pages.live"
    loader = PackageLoader(package, ".")
    environment = Environment(loader=loader, autoescape=True, undefined=StrictUndefined)
    return environment.get_template("live_texts.html.j2").module


def modes(hands: Mapping[str, Mapping[str, Any]], notice: str = "") -> str:
    """Mode of each hand, from the state of ``LiveSession.look``; the notice if there are no
    hands."""
    return str(_macros().modes(hands, notice))


def summary(status: Mapping[str, Any]) -> str:
    """Rates of the tracker and of the commands, latency, and state of the source."""
    frames, commands = _rates(status["frame_rates"]), _rates(status["rates"])
    return str(_macros().summary(status, frames, commands))


def timing(status: Mapping[str, Any]) -> str:
    """Time of each stage, error counts, sinks, and the last events."""
    refused: Counter[str] = Counter()
    for reasons in status["refused"].values():
        refused.update(reasons)
    # The total comes last: it is the sum of the stages after the arrival.
    stages = sorted(status["stages"].items(), key=lambda item: item[0] == "total")
    return str(_macros().timing(status, stages, refused))


def is_late(camera: Mapping[str, Any]) -> bool:
    """True if a camera's picture is too old to work with; see ``Cameras.states``."""
    return not camera.get("age_s", LATE_S) < LATE_S


def picture(name: str, jpeg: str, late: bool) -> str:
    """Picture of a camera (JPEG in base64), dimmed if it is late; empty if there is no picture."""
    return str(_macros().picture(name, jpeg, late)) if jpeg else ""


def camera(state: Mapping[str, Any], late: bool) -> str:
    """Name and age of a camera's picture."""
    return str(_macros().camera(state, late))


def slow(delay: float) -> str:
    """Warning if a browser has a long delay [s]; otherwise empty."""
    return "" if delay < _SLOW_S else str(_macros().slow(delay))


def notice(building: str, message: str) -> str:
    """Work in progress and the last error; empty if there is nothing to report."""
    return str(_macros().notice(building, message)) if building or message else ""


def contact_level(hands: Mapping[str, Any]) -> str:
    """Hidden element with the strongest contact of any finger, for ``contact_sound.js``; 0 for
    hands that the operator does not move."""
    levels = [
        max(hand["contact"], default=0.0)
        for hand in hands.values()
        if hand["contact"] is not None and Mode(hand["mode"]).moves
    ]
    return f'<i hidden data-contact="{max(levels, default=0.0):.2f}"></i>'


def take(state: Mapping[str, Any], quality: Sequence[Any] | str) -> str:
    """The current recording (take), or the last one with its quality; empty before the first one.

    Args:
        state: result of ``Takes.state``.
        quality: ``TakeQuality`` of each file of the last take, or the reason why it is unknown.
    """
    if not (state["recording"] or state["last"]):
        return ""
    names = [PurePath(path).name for path in state["last"]]
    return str(_macros().take(state, names, quality, _facts))


def _facts(quality: Any) -> list[tuple[bool, str]]:
    """Facts about a take's quality, each with True if it is a fault."""
    if quality.collision is None:
        collision = "self-collision can't be measured"
    else:
        collision = f"self-collision in {100 * quality.collision:.0f} % of poses"
        collision += f", {quality.depth_mm:.1f} mm deep" if quality.collision else ""
    held = (("stopped", quality.stopped_s), ("paused", quality.paused_s))
    return [
        *[(True, f"{words} {s:.1f} s") for words, s in held if s >= _SHORTEST_S],
        (quality.lost_s >= _SHORTEST_S, f"{quality.lost_s:.1f} s without the tracker"),
        (quality.unused > 0, counted(quality.unused, "unusable frame")),
        (quality.jumps > 0, counted(quality.jumps, "jump")),
        (bool(quality.collision), collision),
    ]


def legend(fingers: Sequence[str], simulated: bool, task: bool) -> str:
    """Legend of the picture's colours and marks.

    Args:
        fingers: fingers of the robot hand, thumb first.
        simulated: True if there is a simulated robot.
        task: True if the simulated robot works on a task and is therefore drawn solid.
    """
    solid, other = "robot command", "simulated or measured robot, if it differs"
    if task:
        solid, other = "simulated robot", "robot command, if it differs"
    hands = [("●", css(PALM), "human hand, as tracked"), ("■", css(PALM), solid)]
    if simulated:
        hands.append(("■", css(SIMULATED), other))
    marks = [
        ("●", css(HIGHLIGHT), "fingertip and line of a finger that pinches"),
        ("•", css(PALM), "small ball: the method's fingertip target"),
    ]
    colors = map(css, finger_colors(len(fingers)))
    chips = [("⬤", color, name) for name, color in zip(fingers, colors, strict=True)]
    return str(_macros().legend((hands, marks, chips)))


def _rates(rates: Mapping[str, float | None]) -> str:
    """Rates of the hands; rates below 10 Hz have one decimal."""
    words = [
        "–" if r is None else f"{r:.0f}" if r >= 10 or r == 0 else f"{r:.1f}"
        for r in rates.values()
    ]
    return " / ".join(words if len(set(words)) > 1 else words[:1])


def trial(state: Mapping[str, Any] | None) -> str:
    """Task, number, clock and signal of the trial, from ``TaskTrials.shown``; empty without a
    task."""
    return "" if state is None else str(_macros().trial(state, *_phase(state)))


def _phase(state: Mapping[str, Any]) -> tuple[str, str]:
    phase, elapsed, limit = state["phase"], state["elapsed_s"], state["limit_s"]
    if state.get("paused"):
        return "paused", "Paused: keep your hand still"
    if phase == "waiting":
        return phase, "Move the hand away from the object"
    if phase == "running":
        if elapsed < _GO_S:
            return "go", "Go"
        return phase, f"{_clock(elapsed)} of {_clock(limit)}"
    if phase == "done":
        return phase, f"Over: {_clock(elapsed)}"
    return phase, "Wait" if state["object"] else "Move freely"


def _clock(seconds: float) -> str:
    return f"{int(seconds) // 60}:{int(seconds) % 60:02d}"
