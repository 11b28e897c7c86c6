"""Faults of an arm with a hand: checks that no limit is exceeded and no return jumps.

    python research/benchmarks/arm_faults.py                          # four arms, 10 rounds each
    python research/benchmarks/arm_faults.py --arms ur5e --rounds 100 --seed 3

The loop's own pipeline (method, clutch, limiter, arm controller) runs on a simulated clock, with
arm and hand in MuJoCo. A round has every kind of fault once, in random order, each for some
tenths of a second, and normal operation between them. Checked at every command: joint positions,
velocities and accelerations of the arm, joint positions of the hand, the workspace of the wrist,
the distances that the controller keeps, and that the working sink gets every command; after every
return of the operator: how far joints and wrist go in the first command.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections import Counter
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from smooth_operator import Retargeter, load_hand, poses
from smooth_operator.simulation.scenes.physics import ArmPhysics
from smooth_operator.synthetic import SyntheticOperator
from smooth_operator.synthetic.tracker import WristMotion
from smooth_operator.teleop.arm.controller import build_arms
from smooth_operator.teleop.arm.settings import ArmSettings
from smooth_operator.teleop.runtime.pipeline import HandPipeline
from smooth_operator.teleop.runtime.settings import LoopConfig
from smooth_operator.teleop.sinks.sink import Sink, SinkRunner
from smooth_operator.teleop.sinks.tick import Tick
from smooth_operator.teleop.sources.live import Arrival

KINDS = (
    "drop-out",
    "long drop-out",
    "wrist lost",
    "wrist untracked",
    "landmarks lost",
    "frame of NaN",
    "wrist teleports",
    "wrist turns over",
    "quaternion changes sign",
    "noise of 2 cm",
    "clutch pumped",
    "pause",
    "emergency stop",
    "late frames",
    "stamps go back",
    "stamps repeat",
    "tracker starts again",
    "world changes",
    "method switched",
    "actuator stuck",
    "bus errors",
    "loop stalls",
    "uneven steps",
    "arm not measured",
    "out of reach",
    "into the table",
    "fingers opened and closed",
)
"""Faults: of the tracker, the operator, the loop, the arm and its bus."""

PERIOD = 0.01
LENGTHS = {"long drop-out": 250, "out of reach": 120, "into the table": 120}
"""Length of a fault in commands, if it is not 25."""
FIRST_RAD, FIRST_M = 0.02, 0.002


@dataclass(frozen=True)
class Counting(Sink):
    """Takes every command; raises while its bus is down."""

    name: str
    seen: list[int] = field(default_factory=list)
    down: list[bool] = field(default_factory=list)

    @property
    def label(self) -> str:
        return self.name

    def open(self, hands: Any, config: Any) -> None:
        if self.down:
            raise OSError("the bus is down")

    def send(self, tick: Tick) -> None:
        if self.down:
            raise OSError("the bus is down")
        self.seen.append(tick.number)

    def close(self) -> None:
        pass


class Run:
    """One arm with one hand on a simulated clock.

    Args:
        arm: name of the arm.
        hand: name of the hand.
    """

    def __init__(self, arm: str, hand: str, seed: int) -> None:
        self.rng = np.random.default_rng(seed)
        robot = load_hand(hand)
        rig = build_arms(ArmSettings(arm), {"right": robot})["right"]  # type: ignore[arg-type]
        self.controller, self.hand = rig.controller, robot
        self.physics = ArmPhysics(robot, rig.carried)
        self.now = 0.0
        self.retargeter = Retargeter(robot, method="joint_angle")
        self.config = LoopConfig()
        self.pipeline = HandPipeline(
            self.retargeter, self.config, clock=lambda: self.now, arm=self.controller
        )
        self.measured = True
        self.stuck: float | None = None
        self.pipeline.clutch.measured = self._measured
        frames = SyntheticOperator(seed=seed, rate_hz=100.0).frames(8.0)
        self.frames = list(frames)
        self.wrist = WristMotion(0.05, 0.2, seed)
        self.good, self.bad = Counting("good"), Counting("bad")
        self.sinks = SinkRunner([self.bad, self.good], retry_s=0.05)
        self.count, self.session, self.sent = 0, 0, 0
        self.last: Tick | None = None
        self.q = self.controller.q
        self.velocity, self.dt_before = np.zeros_like(self.q), math.inf
        self.worst: dict[str, float] = Counter()
        self.returns: list[tuple[float, float]] = []
        self.fingers: list[float] = []

    def round(self, short: bool = False) -> None:
        """Runs every kind of fault once; ``short`` halves their length."""
        self._normal(60)
        for kind in self.rng.permutation(KINDS):
            length = LENGTHS.get(str(kind), 25) // (2 if short else 1)
            for step in range(length):
                self._faulty(str(kind), step, length)
            self._normal(int(self.rng.integers(12, 24) if short else self.rng.integers(45, 90)))

    def _normal(self, steps: int) -> None:
        for _ in range(steps):
            self._step(self._frame())

    def _frame(self, **changes: Any) -> Any:
        """The operator's next frame."""
        source = self.frames[self.count % len(self.frames)]
        self.count += 1
        pose = self.wrist.pose_at(self.now)
        frame = replace(source, stamp=self.now, T_world_wrist=pose, world="room")
        return replace(frame, **changes) if changes else frame

    def _faulty(self, kind: str, step: int, length: int) -> None:
        rng, clutch, supervisor = self.rng, self.pipeline.clutch, self.pipeline.supervisor
        frame, first, last = self._frame(), step == 0, step == length - 1
        wrist = np.array(frame.T_world_wrist)
        share = math.sin(math.pi * step / length)
        lost = np.full(7, np.nan)
        if kind in ("drop-out", "long drop-out"):
            frame = None
        elif kind == "wrist lost":
            frame = replace(frame, T_world_wrist=lost)
        elif kind == "wrist untracked":
            frame = replace(frame, T_world_wrist=None, world=None)
        elif kind == "landmarks lost":
            frame = replace(frame, landmarks=np.full((21, 3), np.nan), valid=np.zeros(21, bool))
        elif kind == "frame of NaN":
            nothing = {"landmarks": np.full((21, 3), np.nan), "T_world_wrist": lost}
            frame = replace(frame, valid=np.zeros(21, bool), **nothing)
        elif kind == "wrist teleports":
            wrist[:3] += rng.uniform(-1.0, 1.0, 3) if step % 5 == 0 else 0.0
            frame = replace(frame, T_world_wrist=wrist)
        elif kind == "wrist turns over":
            over = np.array([0.0, 0, 0, 0, 1, 0, 0]) if step % 8 < 4 else poses.IDENTITY
            frame = replace(frame, T_world_wrist=poses.compose(wrist, over))
        elif kind == "quaternion changes sign":
            frame = replace(frame, T_world_wrist=wrist * np.array([1, 1, 1, *[(-1.0) ** step] * 4]))
        elif kind == "noise of 2 cm":
            wrist[:3] += rng.normal(0.0, 0.02, 3)
            frame = replace(frame, T_world_wrist=wrist)
        elif kind == "clutch pumped":
            clutch.released = not last and step % 6 < 3
        elif kind == "pause":
            supervisor.resume() if last else supervisor.pause()
        elif kind == "emergency stop":
            supervisor.release() if last else supervisor.stop()
        elif kind == "stamps go back":
            frame = replace(frame, stamp=self.now - (0.5 if step % 2 else 5.0))
        elif kind == "stamps repeat":
            frame = replace(frame, stamp=self.now - self.now % 0.1)
        elif kind == "tracker starts again" and step % 8 == 0:
            self.session += 1
        elif kind == "world changes":
            frame = replace(frame, world="another room" if step % 10 < 5 else "room")
        elif kind == "method switched" and step % 10 == 0:
            self.pipeline.switch(self.retargeter)
        elif kind == "actuator stuck":
            self.stuck = None if last else self.stuck or float(self.physics.arm_positions[1])
        elif kind == "bus errors":
            if first:
                self.bad.down.append(True)
            if last:
                self.bad.down.clear()
        elif kind == "arm not measured":
            self.measured = last
        elif kind == "out of reach":
            wrist[:3] += share * np.array([1.5, 0.5, 0.4])
            frame = replace(frame, T_world_wrist=wrist)
        elif kind == "into the table":
            wrist[2] -= share * 0.8
            frame = replace(frame, T_world_wrist=wrist)
        elif kind == "fingers opened and closed":
            frame = replace(
                frame, landmarks=self.frames[int(rng.integers(len(self.frames)))].landmarks
            )
        dt = PERIOD
        if kind == "loop stalls" and step % 12 == 0:
            dt = 0.35
        elif kind == "uneven steps":
            dt = float(rng.choice([0.001, 0.003, 0.02, 0.06]))
        self._step(frame, dt, received=self.now - 0.2 if kind == "late frames" else None)

    def _step(self, frame: Any, dt: float = PERIOD, received: float | None = None) -> None:
        self.now += dt
        arrival = None
        if frame is not None:
            arrival = Arrival(frame, self.now if received is None else received, self.session)
        tick = self.pipeline.step(self.now, arrival)
        self.sinks.send(tick)
        self.sent += 1
        self.physics.command(tick.command.joint_positions)
        assert tick.arm is not None
        self.physics.command_arm(tick.arm.positions)
        self.physics.advance(dt)
        self._check(tick, dt)
        self.last = tick

    def _measured(self) -> np.ndarray | None:
        if not self.measured:
            return None
        q = self.physics.arm_positions
        assert q is not None
        if self.stuck is not None:
            q[1] = self.stuck
        return self.controller.wrist_at(q)

    def _check(self, tick: Tick, dt: float) -> None:
        assert tick.arm is not None
        arm, spec, last = tick.arm, self.controller.arm, self.last
        low, high = spec.limits.T
        moved = (arm.positions - self.q) / dt
        change = spec.acceleration * min(dt, (self.dt_before + dt) / 2)
        hand = tick.command.joint_positions[list(self.hand.actuated)]
        within = self.hand.limits
        poses = {
            "arm position [rad]": np.maximum(low - arm.positions, arm.positions - high).max(),
            "arm velocity [rad/s]": (np.abs(moved) - spec.velocity).max(),
            "arm acceleration [rad/s^2 s]": (np.abs(moved - self.velocity) - change).max(),
            "hand position [rad]": np.maximum(within[:, 0] - hand, hand - within[:, 1]).max(),
            "clearance [m]": -arm.clearance,
        }
        if tick.wrist is not None:
            place, config = tick.wrist.pose[:3], self.config.wrist
            beyond = np.maximum(np.array(config.low) - place, place - np.array(config.high))
            poses["workspace [m]"] = beyond.max()
        for name, value in poses.items():
            self.worst[name] = max(self.worst.get(name, -math.inf), float(value))
        if last is not None and last.arm is not None and dt <= 2 * PERIOD:
            back = tick.mode.moves and not last.mode.moves
            engaged = bool(tick.wrist and tick.wrist.engaged)
            lost = engaged and not (last.wrist and last.wrist.engaged)
            if back:  # the fingers follow the mode, the arm the clutch, too
                step = np.abs(tick.command.joint_positions - last.command.joint_positions).max()
                self.fingers.append(float(step))
            if back or lost:
                step = np.abs(arm.positions - last.arm.positions).max()
                way = np.linalg.norm(arm.pose[:3] - last.arm.pose[:3])
                self.returns.append((float(step), float(way)))
        self.q, self.velocity, self.dt_before = arm.positions, moved, dt

    def report(self) -> dict[str, Any]:
        """Summary of the run; a positive value is the distance by which a limit was passed."""
        returns = np.array(self.returns).reshape(-1, 2)
        largest = returns.max(axis=0, initial=0.0)
        return {
            "commands": self.sent,
            "sent_to_the_good_sink": len(self.good.seen),
            "errors_of_the_bad_sink": self.sinks.report()[0].failed,
            "worst": {name: round(value, 6) for name, value in sorted(self.worst.items())},
            "returns": len(returns),
            "first_step_arm_rad": float(largest[0]),
            "first_step_hand_rad": max(self.fingers, default=0.0),
            "first_step_wrist_m": float(largest[1]),
            "physics_resets": self.physics.resets,
        }


def run(arm: str, hand: str, rounds: int, seed: int, short: bool = False) -> dict[str, Any]:
    """Runs some rounds of all faults on one arm."""
    trial = Run(arm, hand, seed)
    trial.sinks.open({"right": trial.hand}, {})
    try:
        for _ in range(rounds):
            trial.round(short)
    finally:
        trial.sinks.close()
    return trial.report()


def failures(report: dict[str, Any]) -> list[str]:
    """Failed checks."""
    allowed = {"arm acceleration [rad/s^2 s]": 1e-6, "clearance [m]": 0.005}
    faults = [
        f"{name} passed by {value}"
        for name, value in report["worst"].items()
        if value > allowed.get(name, 1e-9)
    ]
    if report["sent_to_the_good_sink"] != report["commands"]:
        faults.append("a sink missed commands because another sink failed")
    if report["errors_of_the_bad_sink"] == 0 or report["returns"] < 10:
        faults.append("the faults did not happen")
    if report["first_step_arm_rad"] > FIRST_RAD or report["first_step_hand_rad"] > FIRST_RAD:
        faults.append(f"a first step of more than {FIRST_RAD} rad")
    if report["first_step_wrist_m"] > FIRST_M:
        faults.append(f"a first step of more than {1e3 * FIRST_M} mm")
    return faults


def main() -> None:
    """Runs the faults, prints the results, and exits with 1 if a check failed."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--arms", nargs="+", default=["panda", "ur5e", "xarm7", "iiwa14"])
    parser.add_argument("--hand", default="leap_hand")
    parser.add_argument("--rounds", type=int, default=10)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    wrong = 0
    print(f"{len(KINDS)} kinds of fault, {options.rounds} rounds")
    for arm in options.arms:
        report = run(arm, options.hand, options.rounds, options.seed)
        print(arm, json.dumps(report, indent=2))
        for text in failures(report):
            print("FAILED:", text)
            wrong += 1
    sys.exit(1 if wrong else 0)


if __name__ == "__main__":
    main()
