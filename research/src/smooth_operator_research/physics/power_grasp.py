"""Measure: grasps with the whole hand in recordings, tried on objects in physics."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from jaxtyping import Float

from smooth_operator.types import HandRecording
from smooth_operator_research.physics.grasp_physics import POWER_GRASP_OBJECTS, PowerGraspPhysics
from smooth_operator_research.physics.grasp_trial import (
    Commanded,
    GraspMeasure,
    GraspResult,
    RobotGrasp,
    grasp_figures,
    try_power_grasp,
)
from smooth_operator_research.physics.human_closings import HumanClosing, find_closings
from smooth_operator_research.physics.measure import Case
from smooth_operator_research.physics.results import Figure


class PowerGrasp(GraspMeasure):
    """The measure; ``research/docs/physics-measures.md`` defines it."""

    name: Final = "grasp"
    title: Final = "Whole-hand grasp"
    definition: Final = (
        "Wherever a recording closes the whole hand, a handle or a ball of 30 to 65 mm lies in the "
        "robot's palm: is it held for a second under gravity and a push of 0.3 N, kept while the "
        "human holds, and let go within 150 ms of the human's opening?"
    )
    page: Final = "docs/physics-measures.md#whole-hand-grasp"
    figures: Final = grasp_figures(
        "closings", "the hand", POWER_GRASP_OBJECTS,
        Figure("force_n", "N", "", "Force of the grasp while the object is held.", short="force"),
    )  # fmt: skip
    things = POWER_GRASP_OBJECTS
    quick_things = ("handle 30",)
    grasps = "closings"
    absent = (
        "the hand closes nowhere in {}: expected all of index to pinky bent until their tips are "
        "nearer to their bases than 0.65 of their length, for 0.1 s"
    )
    drawn = 3
    physics = PowerGraspPhysics

    def find(self, recording: HandRecording) -> Sequence[HumanClosing]:
        """See ``GraspMeasure``."""
        return find_closings(recording)

    def commanded(
        self, case: Case, grasp: HumanClosing, stamps: Float[np.ndarray, " P"],
        commands: Float[np.ndarray, "P n"], moments: Float[np.ndarray, " T"],
    ) -> tuple[Commanded, dict[str, float]]:  # fmt: skip
        """See ``GraspMeasure``."""
        robot = RobotGrasp(
            stamps=stamps, commands=commands, tight=float(moments[grasp.tight]),
            shut=float(moments[grasp.shut]),
            opened=None if grasp.opened is None else float(moments[grasp.opened]),
        )  # fmt: skip
        return lambda thing: robot, {}

    def attempt(self, physics: PowerGraspPhysics, grasp: RobotGrasp) -> GraspResult:
        """See ``GraspMeasure``."""
        return try_power_grasp(physics, grasp)
