"""Measure 4: virtual operators, who watch and correct, do the tasks of the study."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

from smooth_operator.simulation.tasks.catalogue import FIXED_WRIST, task_named
from smooth_operator.synthetic.tracker import tracker_model
from smooth_operator_research.physics.measure import Case, Drawing, Measured, PhysicsSettings, Unit
from smooth_operator_research.physics.page import interval_drawings
from smooth_operator_research.physics.results import Figure, MeasureResults
from smooth_operator_research.virtual_operator import draw_person, make_familiar, simulate_trial

TRIALS: Final = 3
QUICK_SECONDS: Final = 10.0

_UNITS, _QUICK_UNITS = 6, 2


class VirtualOperators:
    """Measure with virtual operators; ``research/docs/physics-measures.md`` defines it."""

    name: Final = "operators"
    title: Final = "Virtual operators"
    definition: Final = (
        "Share and time of trials that a model of a person, who does not replace people, "
        "completes by watching hand and object with a delay, correcting and trying again."
    )
    page: Final = "docs/physics-measures.md#virtual-operators"
    unit: Final = "operator"
    figures: Final = (
        Figure(
            "success",
            "",
            "up",
            "Share of the trials with a score of 0.5 or 1.",
            share=True,
            trials="trials",
        ),
        Figure("score", "", "up", "Mean score of the trials."),
        Figure("time_s", "s", "down", "Mean time of the successful trials.", short="time"),
        Figure(
            "attempts", "", "down", "Mean number of attempts of a person in a trial.", main=False
        ),
    )

    def conditions(self, settings: PhysicsSettings) -> Sequence[str]:
        """Each task with each tracker, as ``card headset``."""
        return tuple(f"{task} {tracker}" for task in FIXED_WRIST for tracker in settings.trackers)

    def units(self, settings: PhysicsSettings) -> Sequence[Unit]:
        """Simulated persons."""
        count = settings.count(_UNITS, _QUICK_UNITS)
        return [
            Unit(f"operator {k + 1}", key=[settings.seed, k], data=(k, settings.seed))
            for k in range(count)
        ]

    def run(self, case: Case) -> Measured:
        """Runs some trials of one person, after free movement with the method."""
        number, seed = case.unit.data
        task, kind = case.condition.split()
        tracker = tracker_model(kind)
        person, retargeter = draw_person(number, seed), case.retargeter(kind)
        familiar = make_familiar(person, retargeter, tracker, seed=seed)
        done = [
            simulate_trial(
                familiar,
                task_named(task),
                tracker=tracker,
                practised=trial,
                practised_here=trial,
                seconds=QUICK_SECONDS if case.quick else None,
                seed=1000 * case.seed + trial,
            )
            for trial in range(1 if case.quick else TRIALS)
        ]
        outcomes = [trial.outcome for trial in done]
        times = [outcome.seconds for outcome in outcomes if outcome.score >= 0.5]
        return Measured(
            {
                "task": task,
                "tracker": kind,
                "success": len(times),
                "score": sum(outcome.score for outcome in outcomes) / len(done),
                "time_s": sum(times) / len(times) if times else None,
                "attempts": sum(trial.attempts for trial in done) / len(done),
                "trials": len(done),
            }
        )

    def draw(self, results: MeasureResults, colors: Mapping[str, str]) -> Sequence[Drawing]:
        """Draws success and time of each method and task."""
        return interval_drawings(self.name, results, self.figures[:3], colors)
