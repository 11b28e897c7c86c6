"""Reports on a teleoperation to the user, in a terminal or through logging."""

from __future__ import annotations

import contextlib
import json
import logging
from collections.abc import Iterator, Mapping
from typing import Any

from smooth_operator.io.jsonable import to_json
from smooth_operator.reporter import Reporter
from smooth_operator.teleop.runtime.loop import TeleopLoop

_LOG = logging.getLogger("smooth_operator.teleop")


class LoggingReporter(Reporter):
    """Writes lines to the logger ``smooth_operator.teleop``; important ones are warnings."""

    def note(self, text: str, *, matters: bool = False) -> None:
        """Logs a line."""
        _LOG.log(logging.WARNING if matters else logging.INFO, "%s", text)

    @contextlib.contextmanager
    def waiting(self, text: str) -> Iterator[None]:
        """Logs a message at the start of the block."""
        self.note(text)
        yield


def summarise(
    loop: TeleopLoop, seconds: float, reporter: Reporter, more: Mapping[str, Any]
) -> dict[str, Any]:
    """Makes the summary of a loop that has ended.

    Args:
        loop: the loop.
        seconds: length of the run [s].
        reporter: shows notes to a person.
        more: further entries.

    Returns:
        JSON values, as ``teleoperate`` documents them.
    """
    sinks, health = loop.sinks.report(), loop.source.health()
    summary: dict[str, Any] = {
        "duration_s": seconds,
        **loop.statistics.summary(),
        "frames_received": loop.mailbox.received,
        "frames_overwritten": loop.mailbox.overwritten,
        "frames_refused": {
            side: pipeline.supervisor.refused for side, pipeline in loop.pipelines.items()
        },
        "fingertips_filled": {side: dict(hand.filled) for side, hand in loop.pipelines.items()},
        "source": health,
        "sinks": sinks,
        **more,
    }
    for sink in sinks:
        if sink.failed:
            reporter.note(f"{sink.label}: failed {sink.failed} times: {sink.detail}", matters=True)
    if health.state == "failed":
        reporter.note(f"{loop.source.label}: {health.detail}", matters=True)
    for side, reasons in summary["frames_refused"].items():
        if reasons:
            reporter.note(f"{side}: frames refused: {_counted(reasons)}", matters=True)
    for side, fingers in summary["fingertips_filled"].items():
        if fingers:
            reporter.note(f"{side}: frames without a fingertip: {_counted(fingers)}", matters=True)
    if summary["frames_unusable"]:
        why = _counted(summary["frames_unusable_by_reason"])
        reporter.note(f"unusable frames: {why}", matters=True)
    added = summary["added_latency_ms"]
    if added:
        reporter.note(
            f"{summary['frames_answered']} frames in {seconds:.1f} s, commands at "
            f"{summary['rate_hz']:.0f} Hz; delay from frame to command: p50 "
            f"{added['p50']:.2f} ms, p99 {added['p99']:.2f} ms; "
            f"{100 * summary['deadlines_missed_share']:.2f} % late"
        )
    elif loop.mailbox.received:
        others = loop.mailbox.received_of
        if loop.pipelines.keys().isdisjoint(others):
            reason = (
                f"all frames show a {' and a '.join(others)} hand, but the robot has a "
                f"{' and a '.join(loop.pipelines)} hand: choose another --side, or mirror "
                "the source"
            )
        else:
            reason = "either the run ended before a method was compiled, or the robot was held"
        reporter.note(
            f"no command was sent for {loop.mailbox.received} frames in {seconds:.1f} s; {reason}",
            matters=True,
        )
    else:
        reporter.note(
            f"no frame arrived from {loop.source.label} in {seconds:.1f} s; {health.detail}",
            matters=True,
        )
    for side, delay in summary["motion_delay_ms"].items():
        if delay is not None:
            reporter.note(f"{side}: {delay:.0f} ms from command to measured motion")
    for sink in sinks:
        if delay := sink.figures.get("feedback_delay_ms"):
            reporter.note(
                f"{sink.label}: {sink.figures['rate_hz']:.0f} messages per second for each hand; "
                f"delay from contact to message: p50 {delay['p50']:.1f} ms, "
                f"p99 {delay['p99']:.1f} ms"
            )
    plain: dict[str, Any] = json.loads(to_json(summary))
    return plain


def _counted(reasons: Mapping[str, int]) -> str:
    """Reasons with their counts, the most frequent first."""
    ranked = sorted(reasons.items(), key=lambda item: -item[1])
    return "; ".join(f"{count} x {reason}" for reason, count in ranked)
