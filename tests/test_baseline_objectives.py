"""What each baseline minimises, written out again in NumPy: its answer must be that minimum."""

from collections.abc import Callable
from itertools import combinations
from typing import TypeAlias

import numpy as np
import pytest
from scipy.optimize import minimize

from smooth_operator import LANDMARKS, Hand, Retargeter

TIPS = (4, 8, 12, 16, 20)
Cost: TypeAlias = Callable[[np.ndarray], float]
"""(m,) joint positions to the cost."""


def robot_points(hand: Hand, q: np.ndarray) -> np.ndarray:
    at = dict(zip(hand.tree.names, hand.landmark_positions(q), strict=True))
    return np.stack([at.get(name, hand.wrist) for name in LANDMARKS])


def human_pinch(hand: Hand) -> np.ndarray:
    """A hand that pinches index and middle at once, both 15 mm from the thumb: the robot's own
    points, but for the two fingertips."""
    points = robot_points(hand, hand.neutral)
    thumb = points[4]
    for tip, away in ((8, [0.0, 1.0, 0.3]), (12, [0.3, 1.0, -0.3])):
        direction = np.array(away) / np.linalg.norm(away)
        points[tip] = thumb + 0.015 * direction
    return points


def smooth_l1(x: np.ndarray) -> np.ndarray:
    size = np.abs(x)
    return np.where(size < 0.02, size**2 / 0.04, size - 0.01)


def fifteen(points: np.ndarray) -> np.ndarray:
    tips = points[list(TIPS)]
    between = [tips[j] - tips[i] for i, j in combinations(range(5), 2)]
    return np.concatenate([tips - points[0], between])


def keyvector_cost(hand: Hand, human: np.ndarray, previous: np.ndarray) -> Cost:
    """The squared length of the error of wrist to tips, and nothing else."""
    target = fifteen(human)[:5]

    def cost(q: np.ndarray) -> float:
        error = fifteen(robot_points(hand, q))[:5] - target
        return float((error**2).sum())

    return cost


def dexpilot_cost(hand: Hand, human: np.ndarray, previous: np.ndarray) -> Cost:
    """Handa et al. 2019: S1 aims at 5 mm with 200, S2 at 30 mm with 400, all others with 1."""
    target, weights = fifteen(human), np.ones(15)
    for k, length, weight in ((5, 0.005, 200.0), (6, 0.005, 200.0), (9, 0.03, 400.0)):
        target[k] *= length / np.linalg.norm(target[k])
        weights[k] = weight

    def cost(q: np.ndarray) -> float:
        error = fifteen(robot_points(hand, q)) - target
        tracking = (weights * smooth_l1(error).sum(axis=1)).sum()
        return float(tracking + 2.5e-3 * (q**2).sum())

    return cost


def ako_cost(hand: Hand, human: np.ndarray, previous: np.ndarray) -> Cost:
    """Xin et al. 2025: smooth-L1 of weight times length, 0.1 on the change of each joint."""

    def vectors(points: np.ndarray) -> np.ndarray:
        tips = points[list(TIPS)]
        last = points[[tip - 1 for tip in TIPS]]
        return np.concatenate([tips - points[0], tips[1:] - tips[0], tips - last])

    target = vectors(human)
    gaps = np.linalg.norm(target[5:9], axis=1)
    wide = 1 / (1 + np.exp(-10 * (gaps.min() - 0.02)))
    length = np.where(gaps > 0.02, gaps, 2 * np.maximum(gaps - 0.01, 0))
    target[5:9] *= (length / gaps)[:, None]
    near = 1 - 1 / (1 + np.exp(-10 * (gaps - 0.02)))
    weights = np.concatenate([wide * np.array([10, 1, 1, 1, 1]), 10 * near, np.full(5, 10.0)])

    def cost(q: np.ndarray) -> float:
        size = np.linalg.norm(vectors(robot_points(hand, q)) - target, axis=1)
        return float(smooth_l1(weights * size).sum() + smooth_l1(0.1 * (q - previous)).sum())

    return cost


def steepest(cost: Cost, q: np.ndarray, limits: np.ndarray) -> float:
    """The largest component of the gradient that the limits leave free."""
    step = 1e-5
    gradient = np.array(
        [(cost(q + step * axis) - cost(q - step * axis)) / (2 * step) for axis in np.eye(len(q))]
    )
    return float(np.abs(np.clip(q - gradient, *limits.T) - q).max())


@pytest.mark.parametrize(
    ("method", "expected"),
    [
        ("keyvector", keyvector_cost),
        ("hybrid", keyvector_cost),
        ("dexpilot", dexpilot_cost),
        ("ako", ako_cost),
    ],
)
def test_the_answer_minimises_the_methods_own_cost(hand, method, expected):
    human = human_pinch(hand)
    retargeter = Retargeter(hand, method=method, preset="fast", rate=30)
    state = retargeter.init()
    columns = [hand.joint_names.index(name) for name in hand.actuated_names]
    q = hand.neutral
    for _ in range(3):
        previous = q
        state, result = retargeter.step(state, human)
        q = result.command.joint_positions[columns].astype(float)
    cost = expected(hand, human, previous)
    # The weights of dexpilot are up to 400, and its solver stops by the cost, wherever the rounding
    # of the processor lets it.
    slope = {"dexpilot": 4e-2, "ako": 2e-3}.get(method, 2e-5)
    assert steepest(cost, q, hand.limits) < slope
    least = minimize(cost, q, method="L-BFGS-B", bounds=hand.limits).fun
    assert cost(q) == pytest.approx(least, rel=3e-5)
    pulls = {"dexpilot": 2.5e-3 * (q**2).sum(), "ako": smooth_l1(0.1 * (q - previous)).sum()}
    # of the vectors alone, without the pull
    assert result.tracking_loss == pytest.approx(cost(q) - pulls.get(method, 0.0), rel=1e-3)
