"""Time of a step of the arm's controller, with and without the distances between parts.

    python research/benchmarks/arm_steps.py
    python research/benchmarks/arm_steps.py --hand shadow_hand --steps 5000

The wrist follows the built-in operator's. Time is the processor's for this thread, and by the wall
clock, which counts whatever else the machine does.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace

import numpy as np

from smooth_operator import load_hand, poses
from smooth_operator.synthetic.tracker import WristMotion
from smooth_operator.teleop.arm.controller import build_arms
from smooth_operator.teleop.arm.settings import ArmSettings


def steps(arm: str, hand: str, count: int, collisions: bool) -> np.ndarray:
    """(count, 4) time of the processor and of the wall [ms], error [m] and distance [m]."""
    robot = load_hand(hand)
    settings = replace(ArmSettings(arm), collisions=collisions)  # type: ignore[arg-type]
    controller = build_arms(settings, {"right": robot})["right"].controller
    home, motion = controller.wrist_at(controller.home), WristMotion(0.05, 0.2, 0)
    first, rows = motion.pose_at(0.0), []
    fingers = robot.full_configuration(robot.neutral)
    for number in range(count):
        now = motion.pose_at(0.01 * number)
        turn = poses.multiply(now[3:], poses.conjugate(first[3:]))
        target = np.concatenate([home[:3] + now[:3] - first[:3], poses.multiply(turn, home[3:])])
        wall, used = time.perf_counter(), time.thread_time()
        command = controller.step(target, 0.01, fingers)
        used, wall = time.thread_time() - used, time.perf_counter() - wall
        rows.append((1e3 * used, 1e3 * wall, command.position_error, command.clearance))
    return np.array(rows)


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--arms", nargs="+", default=["panda", "ur5e", "xarm7", "iiwa14"])
    parser.add_argument("--hand", default="mimic_p050")
    parser.add_argument("--steps", type=int, default=2000)
    options = parser.parse_args()
    print(
        "arm     collisions  processor p50 p95 p99 [ms]  wall p50 p95 p99 [ms]  error p50 p95 [mm]"
    )
    for arm in options.arms:
        for collisions in (True, False):
            rows = steps(arm, options.hand, options.steps, collisions)
            used = np.percentile(rows[:, 0], [50, 95, 99])
            wall = np.percentile(rows[:, 1], [50, 95, 99])
            error = 1e3 * np.percentile(rows[:, 2], [50, 95])
            texts = [" ".join(f"{value:6.2f}" for value in part) for part in (used, wall, error)]
            print(f"{arm:8}{'yes' if collisions else 'no':12}" + "   ".join(texts), flush=True)


if __name__ == "__main__":
    main()
