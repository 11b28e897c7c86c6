"""Measure: grasps with the whole hand in recordings, tried on objects in physics."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Final

import numpy as np

from smooth_operator.errors import RecordingError
from smooth_operator.hands.registry import load_hand
from smooth_operator.human.aligned_recording import align_recording
from smooth_operator.types import Side
from smooth_operator_research.physics.grasp_physics import (
    POWER_GRASP_OBJECTS,
    GraspObject,
    PowerGraspPhysics,
)
from smooth_operator_research.physics.grasp_trial import (
    AT_LIMIT,
    LET_GO,
    REST_S,
    GraspResult,
    RobotGrasp,
    grasp_row,
    named_recordings,
    object_figures,
    of_side,
    recording_units,
    try_power_grasp,
)
from smooth_operator_research.physics.human_closings import find_closings
from smooth_operator_research.physics.human_pinches import with_holds
from smooth_operator_research.physics.measure import (
    Case,
    Clip,
    Drawing,
    Measured,
    PhysicsSettings,
    Unit,
)
from smooth_operator_research.physics.page import interval_drawings
from smooth_operator_research.physics.results import Figure, MeasureResults

_QUICK_OBJECTS: Final = ("handle 30",)


class PowerGrasp:
    """The measure; ``research/docs/physics-measures.md`` defines it."""

    name: Final = "grasp"
    title: Final = "Whole-hand grasp"
    definition: Final = (
        "Wherever a recording closes the whole hand, a handle or a ball of 30 to 65 mm lies in the "
        "robot's palm: is it held for a second under gravity and a push of 0.3 N, kept while the "
        "human holds, and let go within 150 ms of the human's opening?"
    )
    page: Final = "docs/physics-measures.md#whole-hand-grasp"
    unit: Final = "recording"
    figures: Final = (
        Figure("held", "", "up", "Share of closings and objects in which the object was held for "
               "1 s under gravity and pushes of 0.3 N."),
        LET_GO,
        Figure("dropped", "", "down", "Share of closings and objects in which the hand had the "
               "object and lost it while the human still held."),
        Figure("force_n", "N", "", "Force of the grasp while the object is held.", short="force"),
        AT_LIMIT,
        *object_figures(POWER_GRASP_OBJECTS),
    )  # fmt: skip

    def conditions(self, settings: PhysicsSettings) -> Sequence[str]:
        """Nothing is varied."""
        return ("",)

    def units(self, settings: PhysicsSettings) -> Sequence[Unit]:
        """The recordings in which the hand closes; where none is named, built-in operators.

        Raises:
            RecordingError: no recording can be read, or the hand closes in none of them.
        """
        units = recording_units(settings, find_closings)
        if not units:
            raise RecordingError(
                f"the hand closes nowhere in {', '.join(named_recordings(settings))}: expected all "
                "of index to pinky bent until their tips are nearer to their bases than 0.65 of "
                "their length, for 0.1 s"
            )
        return units

    def run(self, case: Case) -> Measured:
        """Tries all closings of a recording on all objects."""
        recording = of_side(case.unit.data, case.side)
        closings = find_closings(recording)
        longer, moments = with_holds(recording, closings, REST_S)
        commands = case.commands(longer).joint_positions
        things = [t for t in POWER_GRASP_OBJECTS if not case.quick or t.name in _QUICK_OBJECTS]
        tried: dict[str, list[GraspResult]] = {thing.name: [] for thing in things}
        diverged = 0
        for closing in closings:
            begin, end = np.searchsorted(
                longer.stamps, [moments[closing.first], moments[closing.last]]
            )
            part = slice(int(begin), int(end) + 1)
            grasp = RobotGrasp(
                stamps=longer.stamps[part],
                commands=commands[part],
                tight=float(moments[closing.tight]),
                shut=float(moments[closing.shut]),
                opened=None if closing.opened is None else float(moments[closing.opened]),
            )
            for thing in things:
                physics = _physics(case.hand_name, case.side, thing)
                before = physics.resets
                tried[thing.name].append(try_power_grasp(physics, grasp))
                diverged += physics.resets > before
        row = grasp_row(tried)
        row["closings"] = len(closings)
        row["diverged"] = diverged  # trials in which the physics came apart; they measure nothing
        if not case.clip:
            return Measured(row)
        human = align_recording(longer, case.hand, case.config.alignment)
        return Measured(row, Clip(longer.stamps, human, commands))

    def draw(self, results: MeasureResults, colors: Mapping[str, str]) -> Sequence[Drawing]:
        """Held, let go and dropped of each method."""
        return interval_drawings(self.name, results, self.figures[:3], colors)


@lru_cache(maxsize=len(POWER_GRASP_OBJECTS))
def _physics(hand_name: str, side: Side, thing: GraspObject) -> PowerGraspPhysics:
    """The same for all recordings and methods."""
    return PowerGraspPhysics(load_hand(hand_name, side), thing)
