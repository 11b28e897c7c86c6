"""``smooth-operator doctor``: the machine, the start, a frame's time, and what to change."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from smooth_operator.cli.console import Progressing, output_console, plain_table
from smooth_operator.cli.doctor_options import Doctor
from smooth_operator.compilation.diagnosis import (
    FrameTimes,
    StartTimes,
    environment,
    frame_times,
    start_times,
)
from smooth_operator.errors import ConfigError
from smooth_operator.formats.jsonable import to_json
from smooth_operator.hands.registry import load_hand
from smooth_operator.methods.presets import method_config
from smooth_operator.teleop.runtime.priority import going_first

_BUDGET_MS: Final = 10.0
"""A frame of a loop at 100 Hz [ms]."""

_START_S: Final = 2.0
"""A start that takes longer is worth a word [s]."""


def doctor(options: Doctor) -> None:
    """Prints what was found and measured, as tables or JSON, and what to change."""
    if options.frames < 10:
        raise ConfigError(f"--frames must be at least 10, not {options.frames}")
    hand = load_hand(options.hand, options.side)  # whatever is wrong is said now
    method_config(options.method, options.preset).build(hand)
    progress = Progressing(options.quiet)
    chosen = (options.hand, options.side, options.method, options.preset)
    with going_first() as priority:
        pass
    report = environment() | {"priority": priority}
    with progress.waiting("a fresh process, twice: the first may compile"):
        starts = [start_times(*chosen) for _ in range(2)]
    with progress.waiting("frames"):
        frames = frame_times(*chosen, options.frames)
    advice = _advice(report, starts, frames)
    if options.json:
        print(
            to_json(
                {
                    "environment": report,
                    "starts": starts,
                    "frames": frames,
                    "advice": advice,
                },
                indent=2,
            )
        )
        return
    _print(options, report, starts, frames, advice)


def _advice(
    report: Mapping[str, object], starts: list[StartTimes], frames: FrameTimes
) -> list[str]:
    """What to change; empty if nothing."""
    advice = []
    if str(report["programs"]).startswith("not kept"):
        advice.append(
            f"compiled programs are {report['programs']}, so each start compiles; give "
            "SMOOTH_OPERATOR_CACHE a folder that only you can write, or unset it"
        )
    elif starts[1].total > _START_S and starts[1].first_frame > starts[1].total / 2:
        advice.append(
            "the second start did not find the program of the first: see the log of "
            "smooth_operator.programs"
        )
    load, cores = report["load"], report["cores"]
    if isinstance(load, float) and isinstance(cores, int) and load > cores:
        advice.append(
            f"the load is {load:.1f} on {cores} cores: what else runs here takes the loop's time, "
            "and these figures are of a busy machine"
        )
    if cores == 1:
        advice.append("one core serves loop, page and tracker: give the process two")
    if report["priority"] != "real-time" and report["system"] == "Linux":
        advice.append(
            "real-time priority is not granted, so `teleop --priority high` has no effect: add "
            "'USER - rtprio 20' to /etc/security/limits.conf and log in again"
        )
    if report["governor"] == "powersave":
        advice.append("the processor saves power: sudo cpupower frequency-set -g performance")
    if "," in str(report["opencv"]):
        advice.append(
            f"{report['opencv']} are in one folder, where the last one installed overwrites the "
            "others: keep one, see docs/how-to/webcam.md, Problems"
        )
    if report["device"] not in ("cpu", None):
        advice.append(
            f"frames run on {report['device']}, which suits many hands; for one, try "
            "JAX_PLATFORMS=cpu"
        )
    if frames.p99_ms > _BUDGET_MS:
        advice.append(
            f"a frame takes {frames.p99_ms:.1f} ms (p99), more than 100 Hz leaves: try another "
            "preset or method"
        )
    return advice


def _print(
    options: Doctor,
    report: Mapping[str, object],
    starts: list[StartTimes],
    frames: FrameTimes,
    advice: list[str],
) -> None:
    console = output_console()
    rows = ((n.replace("_", " "), "-" if v is None else str(v)) for n, v in report.items())
    console.print(plain_table("Machine", ("", "found"), rows))
    times = (
        (name.replace("_", " "), *(f"{getattr(each, name):.2f}" for each in starts))
        for name in starts[0].__dataclass_fields__
    )
    title = f"{options.hand}, {options.method}: a fresh process to its first command"
    console.print(plain_table(title, ("[s]", "first", "second"), times, left=1))
    console.print(
        f"A frame: {frames.p50_ms:.2f} ms (p50), {frames.p99_ms:.2f} ms (p99), "
        f"{frames.worst_ms:.2f} ms (worst of {frames.count}).",
        markup=False,
    )
    for line in advice or ["Nothing to change."]:
        console.print(f"{'! ' if advice else ''}{line}", markup=False, soft_wrap=True)
