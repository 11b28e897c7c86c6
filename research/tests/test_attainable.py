"""What any method could reach on a frame: the limits hold, and the search finds what there is."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from smooth_operator.hands.collision import penetration_depths
from smooth_operator.hands.registry import load_hand
from smooth_operator.metrics.accuracy import cosines
from smooth_operator.metrics.trace import keyvectors
from smooth_operator_research.attainable import bounds, pose_search
from smooth_operator_research.attainable import search as attain

pytestmark = pytest.mark.weekly

HAND = "mimic_p050"
TIGHT, LOOSE = 0.002, float("inf")


@pytest.fixture(scope="module")
def programs() -> Any:
    return bounds, attain, pose_search


@pytest.fixture(scope="module")
def search(programs: Any) -> Any:
    return programs[1].search_for(HAND, "right")


def robot_vectors(q: np.ndarray) -> np.ndarray:
    """(T, K, 3) keyvectors of poses of the actuated joints [m]."""
    hand = load_hand(HAND)
    return keyvectors(
        hand.tips(hand.full_configuration(q)), np.broadcast_to(hand.wrist, (len(q), 3))
    )


@pytest.fixture(scope="module")
def human(search: Any) -> np.ndarray:
    """A hand that the robot can copy; then one whose thumb and index are 4 mm apart, along an axis
    that the robot's soft tips can't follow closely."""
    vectors = robot_vectors(np.tile(search.hand.neutral, (2, 1)))
    vectors[1, search.thumb.start] = 0.004 * np.array([0.0, 0.0, -1.0])
    return vectors


@pytest.fixture(scope="module")
def task(programs: Any, human: np.ndarray, search: Any) -> Any:
    none = np.empty((2, 0, search.low.size))
    return programs[1].Frames(HAND, "right", human, none, (TIGHT, LOOSE), starts=8, finish=2)


@pytest.fixture(scope="module")
def found(programs: Any, task: Any) -> Any:
    return programs[1].attain(task)["thumb"]


def test_what_the_robot_can_copy_is_attained(found: Any):
    assert found.value[:, 0] == pytest.approx([1.0, 1.0], abs=1e-3)
    assert (found.excess[:, 0] == 0).all()
    np.testing.assert_array_equal(found.poses[0, 0], found.poses[1, 0])  # no pinch, no limit


def test_answers_keep_every_limit(programs: Any, found: Any, human: np.ndarray, search: Any):
    tolerance, thumb = programs[1].TOLERANCE, search.thumb
    for g, gap in enumerate((TIGHT, LOOSE)):
        poses = found.poses[g]
        assert (poses >= search.low).all()
        assert (poses <= search.high).all()
        depth = penetration_depths(search.hand, search.hand.full_configuration(poses))
        assert depth is not None
        assert depth.max() <= 0.002 + tolerance
        robot = robot_vectors(poses)
        wide = np.linalg.norm(robot[1, thumb.start]) - 0.004 - gap
        assert max(wide, 0.0) == pytest.approx(found.excess[g, 1], abs=1e-9)
        mean = cosines(human, robot)[:, thumb].mean(axis=1)
        np.testing.assert_allclose(found.value[g], mean, atol=1e-12)


def test_a_looser_limit_is_no_worse(found: Any, task: Any, programs: Any):
    tight, loose = found.value[:, 1]
    assert found.excess[1, 1] == 0
    assert loose >= tight - 1e-9
    assert loose > 0.9
    assert np.linalg.norm(robot_vectors(found.poses[1])[1, 5]) > 0.006  # it took the room


def test_a_pinch_through_the_hand_is_not_called_solved(programs: Any, task: Any, search: Any):
    """Tips in one place: they have a thickness, and depth is never traded for a gap."""
    human = task.human[1:].copy()
    human[0, search.thumb.start] *= 1e-3
    asked = replace(task, human=human, known=task.known[1:], gaps=(0.0, LOOSE))
    got = programs[1].attain(asked)["thumb"]
    assert got.excess[0, 0] > programs[1].TOLERANCE
    depth = penetration_depths(search.hand, search.hand.full_configuration(got.poses[0]))
    assert depth is not None
    assert depth.max() <= 0.002 + programs[1].TOLERANCE
    assert got.excess[1, 0] == 0


def test_derivatives_are_those_of_the_values(search: Any, human: np.ndarray):
    rng = np.random.default_rng(3)
    q = search.low + rng.uniform(0.2, 0.8, search.low.size) * (search.high - search.low)
    step, weights = 1e-2, np.asarray(search.priced("all"))

    def at(pose: np.ndarray) -> np.ndarray:
        return np.asarray(
            search._local(pose.astype(np.float32), human[1].astype(np.float32), weights), float
        )

    slopes = at(q)[:, 1:]
    for j in range(len(q)):
        ahead, behind = q.copy(), q.copy()
        ahead[j] += step
        behind[j] -= step
        numeric = (at(ahead)[:, 0] - at(behind)[:, 0]) / (2 * step)
        assert np.median(abs(numeric - slopes[:, j])) < 1e-4
        np.testing.assert_allclose(numeric, slopes[:, j], atol=3e-3)


def test_the_program_writes_figures_tables_and_a_picture(
    programs: Any, tmp_path: Path, capsys: Any
):
    program = programs[0]
    settings = program.Settings(
        ("synthetic:11@440:500",), methods=("joint_angle",), gaps=(2.0,), frames=3,
        aims=("thumb",), starts=(2, 4), finish=1, rounds=1, workers=0,
        output=tmp_path / "attainable.json",
    )  # fmt: skip
    program.main(settings)
    capsys.readouterr()
    figures = json.loads(settings.output.read_text())["figures"]
    name = "synthetic-right-11[440:500]"
    for frames in ("all frames", "pinching frames"):
        cosine = {k: figures[f"{name}/{frames}/{k}/thumb_cosine"] for k in ("no limit", "+2 mm")}
        assert cosine["no limit"] >= cosine["+2 mm"] - 1e-3
        assert figures[f"{name}/{frames}/joint_angle/too_deep_share"] > 0  # so it may be above
    assert settings.output.with_suffix(".png").read_bytes().startswith(b"\x89PNG")
    table = settings.output.with_suffix(".md").read_text()
    for word in ("no limit", "convergence", "joint_angle", "25-40", "lower estimate"):
        assert word in table
    with pytest.raises(SystemExit, match="gaps"):
        program.main(replace(settings, gaps=(-1.0,)))
