"""Measure 2: the study's tasks in physics, from demonstrations, in perturbed worlds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Final

import numpy as np
from jaxtyping import Float

from smooth_operator.hands.hand import Hand
from smooth_operator.retargeting.aligned_recording import align_recording
from smooth_operator.retargeting.retargeter import Retargeter
from smooth_operator.simulation.scenes import Scene, ScenePart, ScenePhysics, scene_for
from smooth_operator.simulation.tasks.catalogue import FIXED_WRIST, TASKS
from smooth_operator.simulation.tasks.task import rotation
from smooth_operator.types import HandRecording, Side
from smooth_operator_research.demonstrations.demonstration import (
    PERIOD_S,
    Demonstration,
    DemonstrationLandmarks,
    load_demonstration,
    own_commands,
)
from smooth_operator_research.demonstrations.perturbation import (
    Perturbation,
    PerturbedLandmarks,
    draw_perturbation,
)
from smooth_operator_research.demonstrations.practice import practised
from smooth_operator_research.demonstrations.trial_loop import TrialTrace, perform, run_trial
from smooth_operator_research.physics.measure import (
    Case,
    Clip,
    Drawing,
    Measured,
    PhysicsSettings,
    Unit,
)
from smooth_operator_research.physics.page import interval_drawings
from smooth_operator_research.physics.results import Figure, MeasureResults, Row

WORLDS: Final = 100
"""Number of perturbed worlds of each task and tracker."""

QUICK_WORLDS: Final = 5
PRACTISED: Final = ("headset", "camera")
"""Trackers with which the operator has practised; with a glove, practice on mimic gains nothing."""

STAYS_S: Final = 2.0
"""Time for which the operator stays in the last pose [s]: a goal must be met for half a second, and
an object that hangs between two fingertips first swings for a while."""


@dataclass(frozen=True, eq=False)
class _Task:
    """Demonstration, scene and landmarks shared by all worlds of a task and hand."""

    demonstration: Demonstration
    scene: Scene
    landmarks: DemonstrationLandmarks

    @property
    def seconds(self) -> float:
        return self.landmarks.seconds + STAYS_S


class Demonstrations:
    """Measure with demonstrations; ``research/docs/physics-measures.md`` defines it."""

    name: Final = "demonstrations"
    title: Final = "Demonstrations"
    definition: Final = (
        "Share of perturbed worlds in which a task is done in physics by a demonstration, "
        "performed by an operator who does not watch and has practised with headset or camera."
    )
    page: Final = "docs/physics-measures.md#demonstrations"
    unit: Final = "world"
    figures: Final = (
        Figure(
            "unperturbed",
            "",
            "up",
            "Score in the unperturbed world: 0, 0.5 or 1.",
            short="unperturbed",
        ),
        Figure("success", "", "up", "Share of perturbed worlds with score 1.", share=True),
        Figure(
            "success_half",
            "",
            "up",
            "Share of perturbed worlds with a score of 0.5 or more.",
            short="0.5 or more",
            share=True,
        ),
        Figure(
            "success_s",
            "s",
            "down",
            "Time from 'go' to the end of the trials with score 1.",
            short="time",
        ),
        Figure(
            "ceiling",
            "",
            "",
            "Share of perturbed worlds in which the demonstration's own joint positions, as "
            "commands, score 1: the result without disturbances of operator and tracker.",
            share=True,
        ),
        Figure(
            "tip_error_mm",
            "mm",
            "down",
            "Mean distance of the commanded fingertips from the demonstration's; in perturbed "
            "worlds it includes the operator's other bones and the tracker's shake and delay.",
            short="tip error",
            main=False,
        ),
    )

    def conditions(self, settings: PhysicsSettings) -> Sequence[str]:
        """Each task with each tracker, as ``card headset``."""
        return tuple(f"{task} {tracker}" for task in FIXED_WRIST for tracker in settings.trackers)

    def units(self, settings: PhysicsSettings) -> Sequence[Unit]:
        """World 0, which is unperturbed, and the requested number of perturbed worlds."""
        count = settings.count(WORLDS, QUICK_WORLDS)
        return [
            Unit(f"world {number}", key=[settings.seed, number], data=(number, settings.seed))
            for number in range(count + 1)
        ]

    def run(self, case: Case) -> Measured:
        """Runs one trial."""
        name, tracker = case.condition.split()
        task = _task(name, case.hand_name, case.side, tracker)
        number, seed = case.unit.data
        world = draw_perturbation(number, seed, tracker=tracker)
        if not number:  # the tracker is perfect
            task = _task(name, case.hand_name, case.side)
        retargeter, shown = case.retargeter(tracker if number else None), task.landmarks
        if number and tracker in PRACTISED:
            shown = _practised(task, retargeter, tracker)
        result = run_trial(
            retargeter,
            world.scene(task.scene),
            TASKS[name],
            PerturbedLandmarks(shown, world),
            seconds=task.seconds,
            seed=case.seed,
            prepare=world.prepare,
            trace=True,
        )
        assert result.trace is not None
        perturbed = world.number > 0
        own = _own_score(name, case.hand_name, case.side, number, seed)
        row: Row = {
            "task": name,
            "tracker": tracker,
            "unperturbed": None if perturbed else result.score,
            "success": float(result.score == 1.0) if perturbed else None,
            "success_half": float(result.score >= 0.5) if perturbed else None,
            "success_s": result.seconds if result.score == 1.0 else None,
            "ceiling": float(own == 1.0) if perturbed else None,
            "tip_error_mm": _tip_error_mm(case.hand, task.demonstration, result.trace),
            "score": result.score,
            "line": result.line,
            "outcome": result.reason,
            "ended": result.ended,
            "seconds": result.seconds,
            "frames": result.frames,
            "dropped_frames": result.dropped,
            "diverged": result.diverged,
            **_quantities(world),
        }
        if not case.clip:
            return Measured(row)
        return Measured(row, _clip(case, world.scene(task.scene), result.trace))

    def draw(self, results: MeasureResults, colors: Mapping[str, str]) -> Sequence[Drawing]:
        """Draws success (a score of at least 0.5) and time of each method."""
        return interval_drawings(self.name, results, self.figures[1:4], colors)


@lru_cache(maxsize=16)
def _task(name: str, hand_name: str, side: Side, tracker: str | None = None) -> _Task:
    demonstration = replace(load_demonstration(name, hand_name, tracker), side=side)
    hand = demonstration.robot
    return _Task(demonstration, scene_for(name, hand), DemonstrationLandmarks(demonstration))


@lru_cache(maxsize=16)
def _practised(task: _Task, retargeter: Retargeter, tracker: str) -> DemonstrationLandmarks:
    """Motion of the operator after practice, cached in the process for the next world."""
    return DemonstrationLandmarks(practised(task.demonstration, retargeter, tracker))


@lru_cache(maxsize=512)
def _own_score(name: str, hand_name: str, side: Side, number: int, seed: int) -> float:
    """Score of the demonstration's own joint positions in a world; the same for all methods."""
    task, world = _task(name, hand_name, side), draw_perturbation(number, seed)
    physics = ScenePhysics(task.demonstration.robot, world.scene(task.scene))
    world.prepare(physics)
    score = 0.0
    commands = own_commands(task.demonstration)
    for moment in perform(physics, TASKS[name], commands, seconds=task.seconds):
        outcome = moment.run.outcome
        score = moment.run.assessment.score if outcome is None else outcome.score
    return score


def _tip_error_mm(hand: Hand, demonstration: Demonstration, trace: TrialTrace) -> float:
    """Mean distance of commanded and demonstrated fingertips over fingers and frames since the
    first command [mm]."""
    poses = np.stack([demonstration.pose(time + PERIOD_S) for time in trace.times])
    apart = hand.tips(trace.commands) - hand.tips(hand.full_configuration(poses))
    return 1e3 * float(np.nanmean(np.linalg.norm(apart, axis=-1)))


def _quantities(world: Perturbation) -> Row:
    """Perturbed quantities of a world, to find causes of failure."""
    return {
        "shift_x_mm": 1e3 * float(world.shift[0]),
        "shift_y_mm": 1e3 * float(world.shift[1]),
        "turn_deg": float(np.degrees(world.turn)),
        "friction": world.friction,
        "mass": world.mass,
        "palm": world.palm,
        **{f"bones_{k}": float(factor) for k, factor in enumerate(world.bones)},
    }


def _clip(case: Case, scene: Scene, trace: TrialTrace) -> Clip:
    """Clip of the human, the simulated hand and the outlines of objects."""
    parts = ScenePhysics(case.hand, scene).parts()
    at, turn = scene.mount.palm
    corners: list[Float[np.ndarray, "t 8 3"]] = []
    edges: list[tuple[int, int]] = []
    for part in parts:
        box = _box(part)
        edges += [(len(corners) * 8 + a, len(corners) * 8 + b) for a, b in _EDGES]
        world = [
            state.position + box @ rotation(state.quaternion).T if part.moves else box
            for state in trace.states
        ]
        corners.append((np.array(world) - at) @ turn)
    human = HandRecording(trace.landmarks, trace.times, case.side)
    aligned = align_recording(human, case.hand, case.config.alignment)
    return Clip(trace.times, aligned, trace.positions, np.concatenate(corners, axis=1), edges)


_CORNERS: Final = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)
_EDGES: Final = [(a, b) for a in range(8) for b in range(a + 1, 8) if (a ^ b).bit_count() == 1]


def _box(part: ScenePart) -> Float[np.ndarray, "8 3"]:
    """Corners (8, 3) of a shape's bounding box, in the frame of the shape's placement [m]."""
    if part.kind == "box":
        half = np.array(part.size)
    else:
        radius, length = part.size
        half = np.array([radius, radius, length + (radius if part.kind == "capsule" else 0.0)])
    return np.asarray(part.position + (_CORNERS * half) @ rotation(part.quaternion).T)
