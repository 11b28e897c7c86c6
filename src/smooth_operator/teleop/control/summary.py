"""Summary of a teleoperation: plain values for a program, lines for a person."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from smooth_operator.formats.jsonable import to_json
from smooth_operator.teleop.control.reporter import Reporter
from smooth_operator.teleop.runtime.loop import TeleopLoop


def summarise(
    loop: TeleopLoop, seconds: float, said: Reporter, more: Mapping[str, Any]
) -> dict[str, Any]:
    """Summary of a loop that has ended.

    Args:
        loop: the loop.
        seconds: how long it ran [s].
        said: takes what a person should know.
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
        "source": health,
        "sinks": sinks,
        **more,
    }
    for sink in sinks:
        if sink.failed:
            said.note(f"{sink.label}: failed {sink.failed} times: {sink.detail}", matters=True)
    if health.state == "failed":
        said.note(f"{loop.source.label}: {health.detail}", matters=True)
    for side, reasons in summary["frames_refused"].items():
        if reasons:
            said.note(f"{side}: frames refused: {_counted(reasons)}", matters=True)
    if summary["frames_unusable"]:
        why = _counted(summary["frames_unusable_by_reason"])
        said.note(f"frames of no use: {why}", matters=True)
    added = summary["added_latency_ms"]
    if added:
        said.note(
            f"{summary['frames_answered']} frames in {seconds:.1f} s, commands at "
            f"{summary['rate_hz']:.0f} Hz; received to sent p50 {added['p50']:.2f} ms, "
            f"p99 {added['p99']:.2f} ms; {100 * summary['deadlines_missed_share']:.2f} % late"
        )
    else:
        said.note(
            f"no frame came from {loop.source.label} in {seconds:.1f} s; {health.detail}",
            matters=True,
        )
    for side, delay in summary["motion_delay_ms"].items():
        if delay is not None:
            said.note(f"{side}: from command to measured motion {delay:.0f} ms")
    plain: dict[str, Any] = json.loads(to_json(summary))
    return plain


def _counted(reasons: Mapping[str, int]) -> str:
    """Reasons with their counts, the most frequent first."""
    ranked = sorted(reasons.items(), key=lambda item: -item[1])
    return "; ".join(f"{count} x {reason}" for reason, count in ranked)
