"""Metrics of a run with their units and goals, and a plot of directions and joint positions."""

import matplotlib.pyplot as plt
import numpy as np

from smooth_operator import Retargeter, SyntheticOperator, assemble_trace, evaluate, load_hand
from smooth_operator.metrics import METRICS

hand = load_hand("mimic_p050")
recording = SyntheticOperator(seed=7, rate_hz=50).record(duration=3.0)
commands, _ = Retargeter(hand).run(recording)

# A trace has both hands in the robot's palm frame; metrics are pure functions of it.
trace = assemble_trace(recording, commands, hand)
values = evaluate(trace)
for metric in METRICS:
    value = metric.of(values)
    if isinstance(value, (int, float)):
        print(f"{metric.name:40} {value:12.4g} {metric.unit:8} {metric.goal:5} {metric.meaning}")
assert values["frames"] == len(recording)
assert values["limit_violation_share"] == 0.0

human, robot = trace.human_keyvectors, trace.robot_keyvectors
lengths = np.linalg.norm(human, axis=-1) * np.linalg.norm(robot, axis=-1)
cosines = np.sum(human * robot, axis=-1) / lengths

figure, (upper, lower) = plt.subplots(2, sharex=True, figsize=(8, 5), layout="constrained")
upper.plot(recording.stamps, cosines[:, trace.thumb_vectors])
upper.set_ylabel("cosine of the\nthumb-to-tip vectors")
lower.plot(recording.stamps, commands.joint_positions)
lower.set(xlabel="time [s]", ylabel="joint position [rad]")
figure.savefig("metrics.png")
