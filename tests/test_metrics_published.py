"""The published definitions of the metrics, and the fit that goes with them."""

from __future__ import annotations

import numpy as np
import pytest
from metrics_cases import WRIST, human_motion, make_trace, rotation

from smooth_operator.landmarks import TIPS
from smooth_operator.metrics import evaluate, published


def test_paper_headlines_are_medians() -> None:
    human = human_motion(50)
    tips = human[:, list(TIPS)].copy()
    tips[:20] = WRIST - 1.5 * (tips[:20] - WRIST)  # 40 % of the frames are upside down
    trace = make_trace(human, tips)
    assert evaluate(trace, "paper")["cosine_similarity"] == pytest.approx(1, abs=1e-4)
    assert evaluate(trace, "paper")["scale_ratio"] == pytest.approx(1, abs=1e-5)
    assert evaluate(trace, "sound")["cosine_similarity"] == pytest.approx(0.2, abs=1e-9)
    assert evaluate(trace, "sound")["scale_ratio"] == pytest.approx(1.2, abs=1e-9)


def test_paper_motion_preservation_of_a_perfect_copy_is_below_one() -> None:
    step = 1e-4  # as area, |dh| |dr| equals the published epsilon
    human = np.tile(human_motion(1), (30, 1, 1))
    human[:, 1:] += np.arange(30)[:, None, None] * np.array([step, 0, 0])
    assert evaluate(make_trace(human), "paper")["motion_preservation"] == pytest.approx(0.5)


def test_paper_fits_the_human_to_the_robots_pose() -> None:
    robot = human_motion(40, seed=1)
    rng = np.random.default_rng(2)
    human = np.empty_like(robot)
    for t in range(40):  # a different frame, size and place of the human hand every time
        turn = rotation(rng.normal(size=3), rng.uniform(0, 3))
        human[t] = 1.3 * robot[t] @ turn.T + rng.normal(size=3)
    missing = np.isin(np.arange(21), (3, 7, 11, 15, 19, 1, 2))  # 14 remain
    landmarks = np.where(missing[:, None], np.nan, robot)
    tips = robot[:, list(TIPS)]
    result = evaluate(make_trace(human, tips, robot_landmarks=landmarks), "paper")
    assert result["human_fit"] == "robot pose"
    assert result["cosine_similarity_all"] == pytest.approx(1, abs=1e-4)
    assert result["scale_ratio"] == pytest.approx(1, abs=1e-5)
    assert result["motion_preservation"] > 0.95  # type: ignore[operator]
    unfitted = evaluate(make_trace(human, tips), "paper")
    assert unfitted["human_fit"] == "palm"
    assert unfitted["cosine_similarity_all"] < 0.9  # type: ignore[operator]


def test_fit_is_a_rotation_and_refuses_degenerate_frames() -> None:
    human = human_motion(4)
    mirrored = human * np.array([-1.0, 1, 1])
    np.testing.assert_allclose(published.fit_to_robot(human, human), human, atol=1e-12)
    fitted = published.fit_to_robot(human, mirrored)
    assert np.abs(fitted - mirrored).max() > 0.02  # no reflection can explain it away
    before, after = (np.linalg.det(p[0, [4, 8, 12]] - p[0, 16]) for p in (human, fitted))
    assert before * after > 0  # the same handedness
    line = human.copy()
    line[1] = np.outer(np.arange(21), [1.0, 2, 3])  # collinear
    line[2, 2:] = np.nan  # two landmarks only
    with np.errstate(all="raise"):
        fitted = published.fit_to_robot(human, line)
    assert np.isfinite(fitted[[0, 3]]).all()
    assert np.isnan(fitted[[1, 2]]).all()
