"""Success of methods in the tasks with a moving wrist, in worlds outside the cross-hand matrix.

    python research/benchmarks/grasps.py smooth smooth:FILE.toml --worlds 1000:1009
    python research/benchmarks/grasps.py smooth --worlds 1001:1026:3 --no-gaps

Settings are chosen in these worlds, and the matrix shows what they give in its own. ``--no-gaps``
leaves out the pinch gaps of a camera, which the methods otherwise know.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from typing import Final, NamedTuple

from smooth_operator.hands.registry import load_hand
from smooth_operator.parallel import run_tasks
from smooth_operator_research.cross_hand.human import record
from smooth_operator_research.cross_hand.matrix import tracker_of
from smooth_operator_research.cross_hand.plans import PLANS
from smooth_operator_research.cross_hand.replay import replay
from smooth_operator_research.cross_hand.trials import retarget
from smooth_operator_research.run_report import markdown

HANDS: Final = (
    *("wuji_hand", "allegro_hand", "leap_hand", "mimic_p050"),
    *("orca_v2", "sharpa_wave", "tesollo_dg5f", "unitree_dex5"),
)
"""Hands with which settings of ``smooth`` were chosen."""


class Work(NamedTuple):
    """Trials of one process: a method on a hand in all tasks and worlds."""

    method: str
    hand: str
    worlds: Sequence[int]
    gaps: bool


def successes(work: Work) -> dict[str, int]:
    """Number of trials with score 1 in each task."""
    hand = load_hand(work.hand, "right")
    counts = dict.fromkeys(PLANS, 0)
    for tracker in dict.fromkeys(map(tracker_of, work.worlds)):
        worlds = [world for world in work.worlds if tracker_of(world) == tracker]
        demonstrations = [record(task, world, tracker) for task in PLANS for world in worlds]
        # the pinch gaps of a headset are unknown
        known = tracker if work.gaps else "headset"
        retargeted = retarget(hand, work.method, demonstrations, known)
        for one, commands in zip(demonstrations, retargeted, strict=True):
            counts[one.task] += replay(hand, one, commands.joint_positions).score == 1.0
    return counts


def main(arguments: Sequence[str] | None = None) -> None:
    """Prints a row for each method, and one for each of its hands."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("methods", nargs="+", metavar="METHOD", help="as for bench --methods")
    parser.add_argument("--worlds", default="1000:1009", help="FIRST:END or FIRST:END:STEP")
    parser.add_argument("--hands", default=",".join(HANDS), help="names of right hands")
    parser.add_argument("--no-gaps", action="store_true", help="no known pinch gaps of a camera")
    options = parser.parse_args(arguments)
    worlds = range(*map(int, options.worlds.split(":")))
    hands = options.hands.split(",")
    work = [
        Work(method, hand, worlds, not options.no_gaps)
        for method in options.methods
        for hand in hands
    ]
    counts: dict[Work, dict[str, int]] = {}
    for result in run_tasks(successes, work):
        if result.value is None:
            raise SystemExit(f"{work[result.index]}: {result.error}")
        counts[work[result.index]] = result.value
    rows = []
    for method in options.methods:
        own = [counts[each] for each in work if each.method == method]
        shares = [sum(one[task] for one in own) / (len(worlds) * len(own)) for task in PLANS]
        rows.append((method, "mean", *(f"{share:.2f}" for share in shares)))
        rows += [("", hand, *one.values()) for hand, one in zip(hands, own, strict=True)]
    print(f"{len(worlds)} worlds per hand; a mean is a share, the other rows are numbers of trials")
    print(markdown(("method", "hand", *PLANS), rows))


if __name__ == "__main__":
    main()
