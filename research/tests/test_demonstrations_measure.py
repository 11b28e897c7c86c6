"""Measure 2 of bench --physics: demonstrations in perturbed worlds."""

from pathlib import Path

import numpy as np
import pytest

from smooth_operator import Retargeter, load_hand, method_config
from smooth_operator.errors import StudyError, UnknownNameError
from smooth_operator.retargeting.known_gaps import MEDIAPIPE
from smooth_operator.simulation.tasks import FIXED_WRIST
from smooth_operator.synthetic.tracker import TRACKERS
from smooth_operator_research.demonstrations.demonstration import load_demonstration
from smooth_operator_research.demonstrations.practice import (
    BEYOND,
    _commands,
    _without_noise,
    practised,
)
from smooth_operator_research.physics.demonstrations import Demonstrations
from smooth_operator_research.physics.measure import Case, Measured, PhysicsSettings
from smooth_operator_research.physics.results import MeasureResults, Row

pytestmark = [pytest.mark.weekly, pytest.mark.usefixtures("elsewhere")]

MEASURE = Demonstrations()
SETTINGS = PhysicsSettings(output=Path("results"), units=2, methods=("ako",))


def measured(task: str, number: int, hand: str = "mimic_p050", clip: bool = False) -> Measured:
    unit = MEASURE.units(SETTINGS)[number]
    config = method_config("ako")
    return MEASURE.run(
        Case("demonstrations", hand, "right", "ako", "default", config, task, unit, clip=clip)
    )


def test_worlds_are_the_unperturbed_one_and_those_asked_for():
    assert [unit.name for unit in MEASURE.units(SETTINGS)] == ["world 0", "world 1", "world 2"]
    assert len(MEASURE.units(PhysicsSettings(output=Path("results")))) == 101
    conditions = MEASURE.conditions(PhysicsSettings(output=Path("results"), trackers=("headset",)))
    assert conditions == tuple(f"{task} headset" for task in FIXED_WRIST)
    with pytest.raises(UnknownNameError, match="tracker 'sonar'"):
        PhysicsSettings(output=Path("results"), trackers=("sonar",))


def test_a_method_without_bias_does_a_task_unperturbed_and_the_row_says_so():
    """And the clip shows it: the cube starts where it is and ends turned by a right angle."""
    result = measured("cube glove", 0, clip=True)
    row, clip = result.row, result.clip
    assert (row["unperturbed"], row["line"], row["ended"]) == (1.0, "done", "success")
    assert row["success"] is None
    assert row["ceiling"] is None
    assert isinstance(row["tip_error_mm"], float)
    assert row["tip_error_mm"] < 0.5
    assert row["success_s"] == row["seconds"]
    assert {figure.name for figure in MEASURE.figures} <= row.keys()
    hand = load_hand("mimic_p050")
    assert clip.joints.shape == (len(clip.stamps), len(hand.joint_names))
    assert clip.human.shape == (len(clip.stamps), 21, 3)
    assert max(max(edge) for edge in clip.edges) == clip.objects.shape[1] - 1
    first, last = clip.objects[0], clip.objects[-1]
    lengths = [
        [np.linalg.norm(points[a] - points[b]) for a, b in clip.edges] for points in (first, last)
    ]
    np.testing.assert_allclose(*lengths, atol=1e-9)
    moved = np.linalg.norm(last - first, axis=-1) > 1e-4
    assert moved.sum() == 6 * 8  # the cube's corners and its coloured faces', not the pedestal's
    edges = [points[moved][4] - points[moved][0] for points in (first, last)]
    assert np.linalg.norm(edges[0]) == pytest.approx(0.04, abs=1e-6)
    assert abs(edges[0] @ edges[1]) < np.sin(np.radians(15.0)) * 0.04**2


def test_a_perturbed_world_is_the_same_every_time_and_says_what_differs():
    row, again = (measured("cube headset", 1).row for _ in range(2))
    assert row == again
    assert (row["task"], row["tracker"]) == ("cube", "headset")
    assert row["unperturbed"] is None
    assert row["success"] in (0.0, 1.0)
    assert row["ceiling"] == 1.0
    # 30 of 100 periods have a frame
    assert row["frames"] == pytest.approx(0.3 * (row["frames"] + row["dropped_frames"]), rel=0.02)


def test_the_pinch_gaps_of_a_webcam_are_known_of_a_camera():
    """They are another person's than the simulated ones."""
    unit = MEASURE.units(SETTINGS)[1]
    case = Case(
        "demonstrations",
        "mimic_p050",
        "right",
        "smooth",
        "teleop",
        method_config("smooth"),
        "card camera",
        unit,
    )
    found = {kind: case.retargeter(kind).known_gaps for kind in ("camera", "headset")}
    assert found == {"camera": MEDIAPIPE, "headset": {}}
    assert tuple(MEDIAPIPE.values()) != TRACKERS["camera"].pinch_gaps


def test_an_operator_who_has_practised_is_followed_to_the_demonstration():
    """Behind a camera: the commands are nearer to the key poses, and the first pose stays."""
    demonstration, retargeter = load_demonstration("cube"), Retargeter(pinch_gaps=MEDIAPIPE)
    shown = practised(demonstration, retargeter, "camera")
    np.testing.assert_array_equal(shown.times, demonstration.times)
    np.testing.assert_array_equal(shown.poses[0], demonstration.poses[0])
    low, high = demonstration.robot.limits.T
    assert ((shown.poses >= low - BEYOND) & (shown.poses <= high + BEYOND)).all()
    person = _without_noise(9, "camera")  # none of those who practise
    off = [
        np.abs(_commands(motion, retargeter, person) - demonstration.poses)[1:].mean()
        for motion in (demonstration, shown)
    ]
    assert off[1] < 0.85 * off[0]


def test_a_hand_without_a_demonstration_says_so():
    with pytest.raises(StudyError, match="no demonstration of task 'cube'"):
        measured("cube glove", 0, "schunk_svh")


def test_the_plots_show_every_task():
    rows: list[Row] = [
        {
            "measure": "demonstrations",
            "hand": "mimic_p050",
            "side": "right",
            "method": "ako",
            "preset": "default",
            "condition": task,
            "unit": f"world {k}",
            "status": "ok",
            "reason": "",
            "unperturbed": None,
            "success": float(k % 2),
            "success_half": 1.0,
            "success_s": 4.0 if k % 2 else None,
            "ceiling": 1.0,
            "tip_error_mm": 0.3,
        }
        for task in FIXED_WRIST
        for k in range(1, 4)
    ]
    drawings = MEASURE.draw(MeasureResults(MEASURE.figures, rows), {"ako": "#000000"})
    assert [drawing.name for drawing in drawings] == [
        f"demonstrations-{task}" for task in FIXED_WRIST
    ]
