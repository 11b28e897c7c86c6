"""A metric: how far the joints move in a second."""

import numpy as np

from smooth_operator.metrics import Metric


def joint_travel(trace):
    seconds = trace.stamps[-1] - trace.stamps[0]
    return np.abs(np.diff(trace.joint_positions, axis=0)).sum() / seconds if seconds else None


JOINT_TRAVEL = Metric(
    "joint_travel",
    "rad/s",
    "down",
    "way of all joints in a second",
    "smoothness",
    joint_travel,
    short="travel",
)
