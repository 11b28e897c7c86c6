"""A long run of real-hand drivers on their simulators, with faults.

In this folder, ``python soak_hand_drivers.py SECONDS RIG [RIG ...]`` prints a line of JSON for each
rig; the exit status is 1 if a limit was passed. Commands come at 100 Hz. Every ten seconds a fault
lasts half a second: no answers, late answers, wrong answers, or the device is gone. ``machine_ms``
are times of a notification that nobody waits for, just before each command: what the machine and
Python's lock cost without a hand.
"""

import itertools
import json
import math
import sys
import tempfile
import threading
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hand_rigs import RIGS, Rig
from ticks import make_tick

from smooth_operator.errors import SinkError
from smooth_operator.hands.registry import load_hand
from smooth_operator.types import JointCommand
from smooth_operator_devices.hands.actuator_map import BoundMap

PERIOD = 0.01
FAULT_EVERY_S, FAULT_S = 10.0, 0.5


def inject(rig: Rig, fault: str, on: bool) -> None:
    """Begin or end a fault."""
    if fault == "gone":
        (rig.lose if on else rig.back)()
    elif fault == "silent":
        rig.faults.silent = on
    elif fault == "late":
        rig.faults.delay_s = 0.05 if on else 0.0
    else:
        rig.faults.garbled = rig.wrong[0] if on else ""


def soak(name: str, seconds: float) -> dict[str, object]:
    """Drive a rig for so long [s]; returns figures."""
    with tempfile.TemporaryDirectory() as folder, pytest.MonkeyPatch.context() as patch:
        rig = RIGS[name](Path(folder), patch)
        sink = rig.build(approach=2.0, speed=15.0, lost_s=0.4)
        table = sink.actuators("right")
        hand = load_hand(table.hand, side="right")
        bound = BoundMap(table, hand)
        low, high = np.array([a.ends for a in table.actuators]).T
        sink.open({"right": hand}, {})
        tick = make_tick(hand)
        times, machine, errors, late, refused = [], [], [], 0, 0
        idle = threading.Condition()
        faults, fault, until = itertools.cycle(["silent", "late", "wrong", "gone"]), "", 0.0
        begin = due = time.perf_counter()
        next_fault, count = begin + FAULT_EVERY_S, 0
        try:
            while (now := time.perf_counter()) - begin < seconds:
                if not fault and now >= next_fault:
                    fault, until, count = next(faults), now + FAULT_S, count + 1
                    inject(rig, fault, True)
                elif fault and now >= until:
                    inject(rig, fault, False)
                    fault, next_fault = "", now + FAULT_EVERY_S
                share = 0.5 + 0.4 * math.sin(2 * math.pi * 0.25 * (now - begin))
                wanted = low + share * (high - low)
                joints = np.nan_to_num(bound.joints(wanted))
                tick = replace(tick, command=JointCommand(joints, hand.joint_names, now), time=now)
                start = time.perf_counter()
                with idle:
                    idle.notify()
                machine.append(time.perf_counter() - start)
                start = time.perf_counter()
                try:
                    sink.send(tick)
                except SinkError:
                    refused += 1
                times.append(time.perf_counter() - start)
                if not fault and now - until > 4.0 and (state := sink.state("right")) is not None:
                    measured = bound.commands(bound.angles(state.positions))
                    errors.append(float(np.max(np.abs(measured - wanted) / (high - low))))
                due += PERIOD
                late += due < time.perf_counter()
                time.sleep(max(due - time.perf_counter(), 0.0))
            if fault:
                inject(rig, fault, False)
        finally:
            figures = sink.figures
            sink.close()
            rig.close()
        ms = 1e3 * np.array(times)
        return {
            "rig": name,
            "seconds": round(time.perf_counter() - begin, 1),
            "commands": len(times),
            "late": late,
            "refused": refused,
            "faults": count,
            "send_ms": {
                "p50": float(np.median(ms)),
                "p99": float(np.percentile(ms, 99)),
                "max": float(ms.max()),
            },
            "machine_ms": {
                "p99": 1e3 * float(np.percentile(machine, 99)),
                "max": 1e3 * float(max(machine)),
            },
            "outside": rig.outside(),
            "largest_error_of_range": {
                "p50": float(np.median(errors)),
                "p99": float(np.percentile(errors, 99)),
            }
            if errors
            else None,
            **figures,
        }


if __name__ == "__main__":
    wrong = False
    for rig_name in sys.argv[2:]:
        result = soak(rig_name, float(sys.argv[1]))
        print(json.dumps(result), flush=True)
        wrong |= bool(result["outside"])
    sys.exit(wrong)
