"""Measure 3: pinches of recordings, tried on objects in physics."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Final

import numpy as np
from jaxtyping import Float

from smooth_operator.errors import RecordingError
from smooth_operator.hands.hand import Hand
from smooth_operator.hands.registry import load_hand
from smooth_operator.human.aligned_recording import align_recording, calibrate_scale
from smooth_operator.types import Side
from smooth_operator_research.physics.grasp_physics import GRASP_OBJECTS, GraspObject, PinchPhysics
from smooth_operator_research.physics.grasp_trial import (
    AT_LIMIT,
    GRACE_S,
    HYSTERESIS,
    LET_GO,
    REST_S,
    GraspResult,
    RobotPinch,
    grasp_row,
    named_recordings,
    object_figures,
    of_side,
    recording_units,
    try_pinch,
)
from smooth_operator_research.physics.human_pinches import HumanPinch, find_pinches, with_holds
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

_QUICK_OBJECTS: Final = ("card 2", "sphere 20")


class PinchHold:
    """The measure; ``research/docs/physics-measures.md`` defines it."""

    name: Final = "pinch"
    title: Final = "Pinch and hold"
    definition: Final = (
        "At every pinch of a recording a card, pen, sphere or cube of 2 to 30 mm appears between "
        "the robot's pads: is it held for a second under gravity and a push of 0.3 N, kept while "
        "the human holds, and let go within 150 ms of the human's opening?"
    )
    page: Final = "docs/physics-measures.md#pinch-and-hold"
    unit: Final = "recording"
    figures: Final = (
        Figure("held", "", "up", "Share of pinches and objects in which the object was held for "
               "1 s under gravity and pushes of 0.3 N."),
        LET_GO,
        Figure("dropped", "", "down", "Share of pinches and objects in which thumb and finger had "
               "the object and lost it while the human still held."),
        Figure("overlap_mm", "mm", "", "How far the pads would be inside each other at the "
               "command of the tightest moment, without an object; negative: how far apart.",
               short="commanded overlap"),
        Figure("force_n", "N", "", "Force of the pinch while the object is held.", short="force"),
        AT_LIMIT,
        *object_figures(GRASP_OBJECTS),
    )  # fmt: skip

    def conditions(self, settings: PhysicsSettings) -> Sequence[str]:
        """Nothing is varied."""
        return ("",)

    def units(self, settings: PhysicsSettings) -> Sequence[Unit]:
        """The recordings with pinches; where none is named, built-in operators.

        Raises:
            RecordingError: no recording can be read, or none of them has a pinch.
        """
        units = recording_units(settings, find_pinches)
        if not units:
            raise RecordingError(
                f"no pinch in {', '.join(named_recordings(settings))}: expected thumb and finger "
                "tips nearer than 15 mm for 0.1 s"
            )
        return units

    def run(self, case: Case) -> Measured:
        """Tries all pinches of a recording on all objects."""
        recording = of_side(case.unit.data, case.side)
        pinches = [p for p in find_pinches(recording) if p.finger in case.hand.fingers]
        if not pinches:
            raise RecordingError(
                f"{case.unit.name}: no pinch with a finger that {case.hand_name} has"
            )
        scale = calibrate_scale(recording, case.hand)
        pinches = [pinch.of_size(scale) for pinch in pinches]
        longer, moments = with_holds(recording, pinches, REST_S)
        commands = case.commands(longer).joint_positions
        things = [t for t in GRASP_OBJECTS if not case.quick or t.name in _QUICK_OBJECTS]
        tried: dict[str, list[GraspResult]] = {thing.name: [] for thing in things}
        overlaps = []
        diverged = 0
        for pinch in pinches:
            finger = case.hand.fingers.index(pinch.finger)
            settled = int(np.searchsorted(longer.stamps, moments[pinch.tight] + GRACE_S))
            first = _physics(case.hand_name, case.side, things[0])
            overlaps.append(-1e3 * first.gap_at(finger, commands[settled]))
            part = _part(pinch, longer.stamps, moments)
            gaps = np.array([first.gap_at(finger, command) for command in commands[part]])
            for thing in things:
                if pinch.opening_before < thing.width + HYSTERESIS:
                    continue  # the human could not have taken it
                pinch_commands = robot_pinch(
                    case.hand, pinch, thing, longer.stamps, moments, commands, gaps
                )
                physics = _physics(case.hand_name, case.side, thing)
                before = physics.resets
                tried[thing.name].append(try_pinch(physics, pinch_commands))
                diverged += physics.resets > before
        row = grasp_row(tried)
        row["overlap_mm"] = float(np.mean(overlaps))
        row["pinches"] = len(pinches)
        row["diverged"] = diverged  # trials in which the physics came apart; they measure nothing
        if not case.clip:
            return Measured(row)
        human = align_recording(longer, case.hand, case.config.alignment)
        return Measured(row, Clip(longer.stamps, human, commands))

    def draw(self, results: MeasureResults, colors: Mapping[str, str]) -> Sequence[Drawing]:
        """Held, let go and dropped of each method, and the commanded overlap."""
        return interval_drawings(self.name, results, self.figures[:4], colors)


def robot_pinch(
    hand: Hand,
    pinch: HumanPinch,
    thing: GraspObject,
    stamps: Float[np.ndarray, " L"],
    moments: Float[np.ndarray, " T"],
    commands: Float[np.ndarray, "L n"],
    gaps: Float[np.ndarray, " P"],
) -> RobotPinch:
    """What a robot is commanded in a pinch, for an object.

    Args:
        hand: the robot hand.
        pinch: of the recording.
        thing: the object.
        stamps: (L,) of the recording with holds [s].
        moments: (T,) when the recording's own frames come in that [s].
        commands: (L, n) positions of all joints for it [rad].
        gaps: (P,) distance of the pads at the commands of the pinch [m].
    """
    part, tight = _part(pinch, stamps, moments), float(moments[pinch.tight])
    wider = stamps[part][(gaps > thing.width) & (stamps[part] <= tight)]

    def opening(width: float) -> float | None:
        frame = pinch.opening(width)
        return None if frame is None else float(moments[frame])

    return RobotPinch(
        finger=hand.fingers.index(pinch.finger), stamps=stamps[part], commands=commands[part],
        closing=float(wider[-1]) if len(wider) else None, tight=tight, shut=opening(thing.width),
        opened=opening(thing.width + HYSTERESIS),
    )  # fmt: skip


def _part(
    pinch: HumanPinch, stamps: Float[np.ndarray, " L"], moments: Float[np.ndarray, " T"]
) -> slice:
    """The frames of a pinch in the recording with holds."""
    begin, end = np.searchsorted(stamps, [moments[pinch.first], moments[pinch.last]])
    return slice(int(begin), int(end) + 1)


@lru_cache(maxsize=len(GRASP_OBJECTS))
def _physics(hand_name: str, side: Side, thing: GraspObject) -> PinchPhysics:
    """The same for all recordings and methods."""
    return PinchPhysics(load_hand(hand_name, side), thing)
