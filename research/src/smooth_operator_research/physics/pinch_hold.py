"""Measure 3: pinches of recordings, tried on objects in physics."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from jaxtyping import Float

from smooth_operator.errors import RecordingError
from smooth_operator.human.alignment import calibrate_scale
from smooth_operator.types import HandRecording
from smooth_operator_research.physics.grasp_physics import GRASP_OBJECTS, GraspObject, PinchPhysics
from smooth_operator_research.physics.grasp_trial import (
    GRACE_S,
    HYSTERESIS,
    Commanded,
    GraspMeasure,
    GraspResult,
    RobotPinch,
    grasp_figures,
    physics_with,
    try_pinch,
)
from smooth_operator_research.physics.human_pinches import HumanPinch, find_pinches
from smooth_operator_research.physics.measure import Case
from smooth_operator_research.physics.results import Figure


class PinchHold(GraspMeasure):
    """The measure; ``research/docs/physics-measures.md`` defines it."""

    name: Final = "pinch"
    title: Final = "Pinch and hold"
    definition: Final = (
        "At every pinch of a recording a card, pen, sphere or cube of 2 to 30 mm appears between "
        "the robot's pads: is it held for a second under gravity and a push of 0.3 N, kept while "
        "the human holds, and let go within 150 ms of the human's opening?"
    )
    page: Final = "docs/physics-measures.md#pinch-and-hold"
    figures: Final = grasp_figures(
        "pinches", "thumb and finger", GRASP_OBJECTS,
        Figure("overlap_mm", "mm", "", "How far the pads would be inside each other at the "
               "command of the tightest moment, without an object; negative: how far apart.",
               short="commanded overlap"),
        Figure("force_n", "N", "", "Force of the pinch while the object is held.", short="force"),
    )  # fmt: skip
    things = GRASP_OBJECTS
    quick_things = ("card 2", "sphere 20")
    grasps = "pinches"
    absent = "no pinch in {}: expected thumb and finger tips nearer than 15 mm for 0.1 s"
    drawn = 4
    physics = PinchPhysics

    def find(self, recording: HandRecording) -> Sequence[HumanPinch]:
        """See ``GraspMeasure``."""
        return find_pinches(recording)

    def usable(self, case: Case, recording: HandRecording) -> Sequence[HumanPinch]:
        """See ``GraspMeasure``: with fingers that the hand has, at the robot's size."""
        pinches = [p for p in find_pinches(recording) if p.finger in case.hand.fingers]
        if not pinches:
            raise RecordingError(
                f"{case.unit.name}: no pinch with a finger that {case.hand_name} has"
            )
        scale = calibrate_scale(recording, case.hand)
        return [pinch.of_size(scale) for pinch in pinches]

    def commanded(
        self, case: Case, grasp: HumanPinch, stamps: Float[np.ndarray, " P"],
        commands: Float[np.ndarray, "P n"], moments: Float[np.ndarray, " T"],
    ) -> tuple[Commanded, dict[str, float]]:  # fmt: skip
        """See ``GraspMeasure``."""
        finger, tight = case.hand.fingers.index(grasp.finger), float(moments[grasp.tight])
        pads = physics_with(PinchPhysics, case.hand_name, case.side, GRASP_OBJECTS[0])
        assert isinstance(pads, PinchPhysics)
        settled = int(np.searchsorted(stamps, tight + GRACE_S))
        overlap = -1e3 * pads.gap_at(finger, commands[settled])
        gaps = np.array([pads.gap_at(finger, command) for command in commands])

        def opening(width: float) -> float | None:
            frame = grasp.opening(width)
            return None if frame is None else float(moments[frame])

        def pinch(thing: GraspObject) -> RobotPinch | None:
            if grasp.opening_before < thing.width + HYSTERESIS:
                return None
            wider = stamps[(gaps > thing.width) & (stamps <= tight)]
            return RobotPinch(
                finger=finger, stamps=stamps, commands=commands, tight=tight,
                closing=float(wider[-1]) if len(wider) else None, shut=opening(thing.width),
                opened=opening(thing.width + HYSTERESIS),
            )  # fmt: skip

        return pinch, {"overlap_mm": overlap}

    def attempt(self, physics: PinchPhysics, grasp: RobotPinch) -> GraspResult:
        """See ``GraspMeasure``."""
        return try_pinch(physics, grasp)
