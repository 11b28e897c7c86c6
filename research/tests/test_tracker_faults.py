"""Trackers whose palm bends, drifts or flickers: the removal of tracker noise leaves them alone."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

from smooth_operator.formats.readers import read_recording
from smooth_operator.hands.registry import load_hand
from smooth_operator.human.alignment import align_recording
from smooth_operator.human.landmark_filter import NoiseState, remove_noise
from smooth_operator.landmarks import TIPS, WRIST
from smooth_operator.methods.presets import method_config
from smooth_operator.types import HandRecording
from smooth_operator_research.judging import tracker_faults
from smooth_operator_research.judging.tracker_faults import (
    FAULTS,
    Fault,
    StepFigures,
    faulty,
    step_figures,
)

pytestmark = pytest.mark.weekly

HAND = "mimic_p050"
NEEDS = (WRIST, *TIPS)
SEED = 71  # nothing was set by it
SECONDS = 8.0
FRAMES = 480
CONFIG = method_config("smooth").tracker_noise  # type: ignore[attr-defined]


@lru_cache(maxsize=1)
def removal() -> Any:
    """The removal of noise alone, compiled, over ``FRAMES`` frames."""

    def frame(state: NoiseState, given: Any) -> Any:
        landmarks, dt, restart = given
        return remove_noise(state, landmarks, NEEDS, dt, CONFIG, restart)

    first = jnp.arange(FRAMES) == 0
    start = NoiseState.unseen(len(NEEDS))
    return jax.jit(lambda points, dt: lax.scan(frame, start, (points, dt, first))[1])


def removed(recording: HandRecording) -> tuple[np.ndarray, np.ndarray]:
    """(T, 6, 3) wrist and fingertips of the first frames: as tracked, and after the removal [m]."""
    aligned = align_recording(recording, load_hand(HAND))[:FRAMES].astype(np.float32)
    count = len(aligned)
    dt = np.full(FRAMES, np.diff(recording.stamps).mean(), np.float32)
    aligned = np.concatenate([aligned, np.repeat(aligned[-1:], FRAMES - count, axis=0)])
    return aligned[:count, NEEDS], np.asarray(removal()(aligned, dt))[:count]


def figures(tracked: np.ndarray, points: np.ndarray) -> StepFigures:
    return step_figures(*((tips[:, 1:] - tips[:, :1]).astype(float) for tips in (tracked, points)))


def check(recording: HandRecording, start: int = 0) -> None:
    motion, gain, lost, jumps = figures(*(path[start:] for path in removed(recording)))
    assert motion is not None
    assert motion > 0.99
    assert gain is None or gain > 0.9
    assert lost is None or lost <= 0.02
    assert jumps == 0


@pytest.mark.parametrize("rate", [30.0, 60.0])
@pytest.mark.parametrize("name", list(FAULTS))
def test_fingertips_move_as_they_were_tracked(name: str, rate: float):
    check(faulty(FAULTS[name], rate, SECONDS, SEED))


@pytest.mark.parametrize("name", [name for name in FAULTS if "bends" in name])
def test_a_palm_that_bends_shows_in_a_second_at_any_rate(name: str):
    check(faulty(FAULTS[name], 100.0, FRAMES / 100, SEED), start=100)


@pytest.mark.shared
@pytest.mark.parametrize(
    ("name", "rate"),
    [
        ("wilor_test_long_21x3.npz", 30.0), ("wilor_workspace_21x3.npz", 30.0),
        ("human_alex_21x3.npy", 30.0), ("manus_right_subject-000_run-010.npz", None),
    ],
)  # fmt: skip
def test_fingertips_of_real_recordings_stay_as_they_were_tracked(
    name: str, rate: float | None, shared: Path
):
    recording = read_recording(shared / "recordings" / name, rate=rate)
    np.testing.assert_array_equal(*removed(recording))


def test_the_robot_follows_a_camera_as_without_the_removal():
    """A palm that bends by 6 mm, with noise: half of the motion would be lost."""
    made = faulty(FAULTS["bends by 6 mm, 0.5 mm noise"], 60.0, 4.0, SEED)
    on, off = (tracker_faults.followed(made, HAND, off) for off in (False, True))
    assert on.motion > off.motion - 0.01
    assert on.gain > min(0.9, off.gain - 0.01)
    assert on.lost <= max(0.02, off.lost)
    assert on.jumps <= off.jumps


def test_noise_of_a_rigid_palm_is_still_removed():
    noisy, clean = (faulty(Fault(noise=noise), 100.0, FRAMES / 100, SEED) for noise in (5e-4, 0.0))
    raw, points = removed(noisy)
    truth = removed(clean)[0]
    before, after = (np.diff(path - truth, axis=0)[100:] for path in (raw, points))
    assert np.square(after).mean() < 0.05 * np.square(before).mean()


def test_figures_of_steps():
    human = np.zeros((5, 2, 3))
    human[:, :, 0] = 1e-3 * np.array([0, 4, 8, 12, 13])[:, None]
    robot = human.copy()
    robot[1:, 0] += [1e-3, 0, 0]  # 5 mm for 4
    robot[3:, 1] -= [3e-3, 0, 0]  # 1 mm for 4
    robot[4:, 1] += [0, 20e-3, 0]
    motion, gain, lost, jumps = step_figures(human, robot)
    assert gain == pytest.approx(1.0)
    assert lost == pytest.approx(1 / 6)
    assert jumps == pytest.approx(250)
    assert motion == pytest.approx((7 + 1 / np.sqrt(401)) / 8, abs=1e-3)
