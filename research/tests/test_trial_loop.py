"""A trial in physics from a source of human landmarks."""

import numpy as np
import pytest

from smooth_operator import Retargeter, load_hand
from smooth_operator.errors import ConfigError
from smooth_operator.simulation.scenes import ScenePhysics, SceneState, scene_for
from smooth_operator.simulation.tasks import TASKS
from smooth_operator_research.demonstrations.demonstration import (
    DemonstrationLandmarks,
    load_demonstration,
)
from smooth_operator_research.demonstrations.trial_loop import TrialResult, run_trial

pytestmark = [pytest.mark.weekly, pytest.mark.usefixtures("elsewhere")]

HAND = load_hand("mimic_p050")
AKO = Retargeter(HAND, method="ako")
"""The method that follows the robot's own landmarks to within 0.5 mm, but in one pinch."""


class Gaps(DemonstrationLandmarks):
    """Drops the frames of some times, and keeps what it was asked."""

    def __init__(self, task: str, gaps: tuple[tuple[float, float], ...] = ()) -> None:
        super().__init__(load_demonstration(task))
        self.gaps = gaps
        self.asked: list[tuple[float, float, float]] = []

    def landmarks(self, time: float, state: SceneState, physics: ScenePhysics) -> np.ndarray | None:
        self.asked.append((time, state.time, physics.time))
        return None if any(a <= time < b for a, b in self.gaps) else self.at(time)


def trial(task: str, source: DemonstrationLandmarks, **options: object) -> TrialResult:
    options = {"seconds": source.seconds, **options}
    return run_trial(AKO, scene_for(task, HAND), TASKS[task], source, **options)


@pytest.mark.parametrize("task", ["cube", "screwdriver"])
def test_a_retargeter_that_follows_exactly_does_what_the_demonstration_does(task):
    result = trial(task, Gaps(task))
    assert (result.score, result.line, result.ended) == (1.0, "done", "success")
    assert (result.dropped, result.diverged, result.trace) == (0, 0, None)
    assert result.frames == round(100 * result.seconds)


def test_the_trace_is_what_happened_and_the_loop_is_causal():
    source = Gaps("cube", ((0.2, 0.3), (1.0, 1.05)))
    result = trial("cube", source, trace=True)
    trace = result.trace
    assert result.dropped == 15
    assert result.frames == len(trace.times) - 15
    held = np.isnan(trace.landmarks[:, 0, 0])
    np.testing.assert_array_equal(
        held,
        (trace.times >= 0.2) & (trace.times < 0.3) | (trace.times >= 1.0) & (trace.times < 1.05),
    )
    before = np.flatnonzero(held) - 1
    np.testing.assert_array_equal(trace.commands[held], trace.commands[before])
    assert len(trace.states) == len(trace.commands) == len(trace.positions)
    for time, seen, now in source.asked:
        assert seen == pytest.approx(time, abs=1e-9)
        assert now == pytest.approx(time, abs=1e-9)
    again = trial("cube", Gaps("cube", source.gaps), trace=True).trace
    np.testing.assert_array_equal(again.positions, trace.positions)


def test_the_lead_in_comes_before_go():
    """The hand is in the first pose, the object at its start, and no frame of it is counted."""
    source = Gaps("cube")
    result = trial("cube", source, lead_s=0.2, seconds=0.1, trace=True)
    times = [time for time, _, _ in source.asked]
    np.testing.assert_allclose(times, 0.01 * np.arange(-20, 10), atol=1e-9)
    assert (result.ended, result.frames) == ("finished", 10)
    assert result.seconds == pytest.approx(0.1)


@pytest.mark.parametrize("options", [{"rate_hz": 0.0}, {"rate_hz": 1000.0}, {"lead_s": -1.0}])
def test_what_can_not_be_is_refused(options):
    with pytest.raises(ConfigError, match="up to 500 Hz"):
        trial("cube", Gaps("cube"), **options)
