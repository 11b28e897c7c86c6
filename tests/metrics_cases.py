"""Synthetic runs for the tests of metrics and plots."""

import numpy as np

from smooth_operator.landmarks import FINGERS, TIPS
from smooth_operator.metrics import Trace

WRIST = np.array([0.01, -0.02, 0.12])
RATE = 100.0


def human_motion(frames: int, seed: int = 0, amplitude: float = 0.02) -> np.ndarray:
    """(T, 21, 3): a hand whose landmarks wander smoothly and never rest; the wrist stays put."""
    rng = np.random.default_rng(seed)
    base = rng.uniform(0.03, 0.1, (21, 3)) * rng.choice([-1, 1], (21, 3))
    t = np.arange(frames)[:, None, None] / RATE
    phase = rng.uniform(0, 2 * np.pi, (3, 21, 3))
    waves = sum(np.sin(2 * np.pi * f * t + phase[i]) / f for i, f in enumerate((1.1, 2.3, 3.7)))
    human = WRIST + base + amplitude * waves
    human[:, 0] = WRIST
    return human


def make_trace(
    human: np.ndarray,
    robot_tips: np.ndarray | None = None,
    fingers: tuple[str, ...] = FINGERS,
    joints: np.ndarray | None = None,
    **changes: object,
) -> Trace:
    """A trace whose robot copies the human unless told otherwise."""
    frames = len(human)
    tips = human[:, [TIPS[FINGERS.index(f)] for f in fingers]] if robot_tips is None else robot_tips
    if joints is None:
        joints = 0.3 * np.sin(np.arange(frames)[:, None] / 7 + np.arange(4))
    values: dict[str, object] = {
        "human": human,
        "robot_tips": tips,
        "robot_wrist": WRIST,
        "fingers": fingers,
        "joint_positions": joints,
        "joint_limits": np.tile([-1.0, 1.0], (joints.shape[1], 1)),
        "stamps": 5.0 + np.arange(frames) / RATE,
        "status": np.zeros(frames, int),
        "latency_ms": np.arange(1.0, frames + 1),
    }
    return Trace(**values | changes)


def tip_gap_mm(trace: Trace, distance: float = 0.015) -> float:
    """Mean distance of the robot's thumb tip and fingertip while the human's are nearer [mm]."""
    human, robot = (
        np.linalg.norm(v[:, trace.thumb_vectors], axis=-1)
        for v in (trace.human_keyvectors, trace.robot_keyvectors)
    )
    return float(1e3 * robot[human < distance].mean())


def rotation(axis: np.ndarray, angle: float) -> np.ndarray:
    k = np.cross(np.eye(3), axis / np.linalg.norm(axis))
    return np.eye(3) - np.sin(angle) * k + (1 - np.cos(angle)) * k @ k
