"""A LEAP hand's sink at 100 Hz for half an hour, on servos that speak the real protocol.

    python research/benchmarks/hardware_soak.py                       # 30 minutes
    python research/benchmarks/hardware_soak.py --minutes 3 --every 20

The servos are those of ``tests/dynamixel_bank.py``, in a process of their own on a pseudo-terminal.
Every ``--every`` seconds there is a fault: wrong checksums, a silent servo, a pulled cable, a slow
bus, a bus that hangs, an emergency stop, silence of the loop, an outage of 0.3 s. Prints, and
checks: how long ``send`` takes in the loop's thread, the time of a cycle, goals beyond the table's
ends, the largest first step after each return, and how often the device was lost and found again.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tests"))

FAULTS = ("corrupt", "silent", "unplug", "slow", "hang", "stop", "silence", "outage")
OUTAGE_S = 0.3
"""Shorter than the time after which a device counts as lost [s]."""
STEP = 2 * np.pi / 4096


def serve(link: str, pipe: Any) -> None:
    """The servos, in a process of their own; faults come through the pipe."""
    from dynamixel_bank import ServoBank

    bank = ServoBank(list(range(16)))
    bank.unplug()
    bank.plug(link)
    low = high = 2048
    pipe.send("ready")
    largest, last, hung = 0.0, 0.0, -9.0
    while True:
        while bank.goals:
            at, goals, ahead = bank.goals.pop(0)
            low, high = min(low, *goals.values()), max(high, *goals.values())
            # Goals that lie in the cable of a bus that hangs are old ones, and no return.
            if at - last > 0.25 and at - hung > 5.0:
                largest = max(largest, ahead)
            last = at
        if not pipe.poll(0.002):
            continue
        what, on = pipe.recv()
        if what == "end":
            pipe.send({"low": low, "high": high, "first_step": largest * STEP, "bad": bank.bad})
            return
        if what == "corrupt":
            bank.corrupt = 20 if on else 0
        elif what == "silent":
            bank.silent = {7} if on else set()
        elif what == "slow":
            bank.delay = 0.004 if on else 0.0
        elif what == "hang":
            bank.delay, hung = 3.0 if on else 0.0, time.perf_counter()
        elif what == "outage" and on:
            bank.deaf = True
            time.sleep(OUTAGE_S)
            bank.deaf = False
        elif what == "unplug":
            if on:
                bank.unplug()
            else:
                bank.plug(link)


def percentiles(values: list[float]) -> dict[str, float]:
    """p50, p99 and the largest [ms]."""
    p50, p99 = np.percentile(values, (50, 99))
    return {"p50": float(p50), "p99": float(p99), "max": max(values)}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--minutes", type=float, default=30.0)
    parser.add_argument("--every", type=float, default=30.0, help="seconds between faults")
    parser.add_argument("--rate", type=float, default=100.0, help="commands a second")
    options = parser.parse_args()

    from ticks import make_tick

    from smooth_operator.hands.registry import load_hand
    from smooth_operator.teleop.hardware.drivers.dynamixel import LeapSink
    from smooth_operator.teleop.runtime.priority import low_jitter
    from smooth_operator.teleop.sinks.runner import SinkRunner
    from smooth_operator.teleop.sinks.tick import Mode
    from smooth_operator.types import JointCommand

    link = str(Path(tempfile.mkdtemp()) / "ttyUSB")
    ours, theirs = multiprocessing.Pipe()
    context = multiprocessing.get_context("spawn")
    bank = context.Process(target=serve, args=(link, theirs), daemon=True)
    bank.start()
    assert ours.recv() == "ready"
    hand = load_hand("leap_hand")
    sink = LeapSink(port=link, baud=57600, rate=options.rate)
    runner = SinkRunner([sink])
    runner.open({"right": hand}, {})
    base, (low, high) = make_tick(hand), hand.limits.T
    start, period = time.perf_counter(), 1.0 / options.rate
    times: dict[str, list[float]] = {}
    fault, until, number, faults = "none", 0.0, 0, 0
    error: list[float] = []
    with low_jitter():
        while (now := time.perf_counter() - start) < 60 * options.minutes:
            if fault != "none" and now > until:
                ours.send((fault, False))
                fault = "none"
            if now > (faults + 1) * options.every and fault == "none":
                fault, until = FAULTS[faults % len(FAULTS)], now + 3.0
                faults += 1
                ours.send((fault, True))
            q = low + (high - low) * (0.5 + 0.45 * np.sin(0.6 * now + np.arange(16)))
            tick = replace(
                base,
                command=JointCommand(hand.full_configuration(q), hand.joint_names),
                mode=Mode.STOPPED if fault == "stop" else Mode.TRACKING,
                time=start + now,
                number=number,
            )
            if fault != "silence":
                before = time.perf_counter()
                runner.send(tick)
                times.setdefault(fault, []).append(1e3 * (time.perf_counter() - before))
            state = sink.state("right")
            if (
                state is not None
                and fault == "none"
                and not sink.note.startswith(("approaches", "waits"))
            ):
                error.append(float(np.abs(state.positions - tick.command.positions).max()))
            number += 1
            time.sleep(max(0.0, start + number * period - time.perf_counter()))
    figures = dict(sink.figures)
    runner.close()
    ours.send(("end", True))
    answer = ours.recv()
    table = sink.actuators("right")
    ends = np.array([actuator.ends for actuator in table.actuators]) / STEP
    beyond = max(0.0, ends[:, 0].min() - answer["low"], answer["high"] - ends[:, 1].max())
    every = [value for values in times.values() for value in values]
    result = {
        "minutes": options.minutes,
        "commands": number,
        "faults": faults,
        "send_ms": percentiles(every),
        "send_ms_by_fault": {name: percentiles(values) for name, values in times.items()},
        "tracking_error_rad": {
            "p50": float(np.median(error)),
            "p99": float(np.percentile(error, 99)),
        },
        "steps_beyond_ends": beyond,
        "first_step_after_return_rad": answer["first_step"],
        "instructions_with_wrong_checksum": answer["bad"],
        **figures,
    }
    print(json.dumps(result, indent=1))
    # A command from just before an outage may arrive after it, on a machine under load.
    good = beyond <= 1.0 and answer["first_step"] <= 0.05 and result["send_ms"]["p99"] <= 0.5
    print("ok" if good else "NOT OK")
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
