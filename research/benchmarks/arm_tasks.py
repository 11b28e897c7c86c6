"""The study's tasks with the hand on an arm: the arm moves the wrist, then the fingers do the task.

    python research/benchmarks/arm_tasks.py                     # every arm, every task
    python research/benchmarks/arm_tasks.py --arm panda --hand mimic_p050 --worlds 10

The arm starts in its home pose. Its controller follows a straight way of the wrist to the place
where the task's fixture would hold the hand, and stays there; then the fingers repeat the
demonstration, while the servos of the arm carry the weight. Prints the score of each trial, the
same trial with the hand on the fixture, and how far the wrist was off while the fingers moved.
"""

from __future__ import annotations

import argparse

import numpy as np

from smooth_operator import poses
from smooth_operator.errors import SmoothOperatorError
from smooth_operator.simulation.arms.arm import CarriedHand, inverse, pose_of, rigid
from smooth_operator.simulation.arms.catalogue import ARMS
from smooth_operator.simulation.scenes import ScenePhysics, scene_for
from smooth_operator.simulation.tasks.catalogue import FIXED_WRIST, TASKS
from smooth_operator.teleop.arm.controller import build_arms
from smooth_operator.teleop.arm.settings import ArmSettings
from smooth_operator_research.demonstrations.demonstration import PERIOD_S, load_demonstration
from smooth_operator_research.demonstrations.perturbation import draw_perturbation
from smooth_operator_research.demonstrations.trial_loop import perform

APPROACH_S, SETTLE_S, STAYS_S = 5.0, 1.0, 2.0


def trial(task: str, hand_name: str, arm: str | None, number: int, seed: int) -> dict[str, float]:
    """Runs one trial; on the fixture if ``arm`` is None."""
    demonstration = load_demonstration(task, hand_name)
    hand = demonstration.robot
    side = hand.spec.side
    world = draw_perturbation(number, seed)
    scene = world.scene(scene_for(task, hand))
    built = None if arm is None else build_arms(ArmSettings(arm, no_table=True), {side: hand})[side]
    physics = ScenePhysics(hand, scene, carried=None if built is None else built.carried)
    world.prepare(physics)
    lead = 0.0 if built is None else APPROACH_S + SETTLE_S
    errors: list[float] = []
    if built is not None:
        assert isinstance(physics.carried, CarriedHand)
        position, rotation = scene.mount.palm
        palm = rigid(rotation, position)
        goal = pose_of(inverse(physics.carried.base) @ palm @ built.carried.mount.palm_to_wrist)
        start = built.controller.pose.copy()

    def commands(time: float, state: object, physics: ScenePhysics) -> np.ndarray:
        fingers = hand.full_configuration(demonstration.pose(max(time, 0.0) + PERIOD_S))
        if built is not None:
            share = float(np.clip((time + lead) / APPROACH_S, 0.0, 1.0))
            share = share * share * (3 - 2 * share)
            turn = poses.multiply(goal[3:], poses.conjugate(start[3:]))
            target = np.concatenate(
                [
                    start[:3] + share * (goal[:3] - start[:3]),
                    poses.multiply(
                        poses.from_rotation_vectors(share * poses.rotation_vectors(turn)), start[3:]
                    ),
                ]
            )
            sent = built.controller.step(target, PERIOD_S, fingers)
            physics.command_arm(sent.positions)
            if time >= 0.0 and physics.arm_positions is not None:
                at = built.controller.wrist_at(physics.arm_positions)
                errors.append(float(np.linalg.norm(at[:3] - goal[:3])))
        return fingers

    score, ended = 0.0, "timeout"
    seconds = float(demonstration.times[-1]) + STAYS_S
    for moment in perform(physics, TASKS[task], commands, seconds=seconds, lead_s=lead):
        outcome = moment.run.outcome
        score = moment.run.assessment.score if outcome is None else outcome.score
        ended = "finished" if outcome is None else outcome.reason
    worst = 1e3 * max(errors) if errors else 0.0
    return {"score": score, "off_mm": worst, "ended": ended}  # type: ignore[dict-item]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--arm", choices=list(ARMS), action="append", help="default: all of them")
    parser.add_argument("--task", choices=FIXED_WRIST, action="append", help="default: all of them")
    parser.add_argument("--hand", default="mimic_p050", help="hand with demonstrations")
    parser.add_argument(
        "--worlds", type=int, default=0, help="number of perturbed worlds after the first"
    )
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    print(f"{'arm':10} {'task':12} {'score':>6} {'fixture':>8} {'wrist off, most [mm]':>21}  ended")
    for task in options.task or FIXED_WRIST:
        numbers = range(options.worlds + 1)
        fixed = [trial(task, options.hand, None, n, options.seed)["score"] for n in numbers]
        for arm in options.arm or list(ARMS):
            try:
                done = [trial(task, options.hand, arm, n, options.seed) for n in numbers]
            except SmoothOperatorError as error:
                print(f"{arm:10} {task:12} {error}")
                continue
            print(
                f"{arm:10} {task:12} {np.mean([d['score'] for d in done]):6.2f} "
                f"{np.mean(fixed):8.2f} {max(d['off_mm'] for d in done):21.1f}  {done[0]['ended']}"
            )


if __name__ == "__main__":
    main()
