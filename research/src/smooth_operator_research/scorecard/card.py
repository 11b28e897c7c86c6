"""The scorecard of a hand: all its measurements."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from jaxtyping import Float
from scipy.spatial import ConvexHull

from smooth_operator.errors import HandModelError
from smooth_operator.hand_discovery.hand_validation import Track
from smooth_operator.hands.hand import Hand
from smooth_operator.metrics.assemble import sample_reach
from smooth_operator_research.scorecard.grasp_sizes import object_size, pinch, power
from smooth_operator_research.scorecard.kapandji import (
    Touch,
    highest_stage,
    kapandji_touches,
)
from smooth_operator_research.scorecard.postures import (
    grasp_postures,
    posture_faults,
    standard_postures,
)

_POSES: Final = 10_000  # random poses for the workspaces


@dataclass(frozen=True)
class Scorecard:
    """Measurements of a hand on its model, without gravity, forces and friction.

    Attributes:
        hand: name of the hand.
        side: side of the hand.
        free: Kapandji's test, in which the touched finger bends, too.
        straight: Kapandji's test with straight fingers.
        gaps: finger -> diameter of the smallest object between its tip and the thumb's [m], None
            if the hand can't hold any.
        sizes: grasp -> diameter of the smallest and of the largest object [m], or None.
        reach: finger -> largest distance of its tip from the wrist [m], and volume of the convex
            hull of its tip's positions [m^3].
        postures: number of standard postures.
        posture_faults: standard posture that the hand can't take -> its fault.
        grasps: number of postures of the GRASP taxonomy.
        grasp_faults: grasp that the hand can't take -> its fault.
    """

    hand: str
    side: str
    free: Sequence[Touch]
    straight: Sequence[Touch]
    gaps: Mapping[str, float | None]
    sizes: Mapping[str, tuple[float | None, float | None]]
    reach: Mapping[str, tuple[float, float]]
    postures: int
    posture_faults: Mapping[str, str]
    grasps: int
    grasp_faults: Mapping[str, str]

    def rows(self) -> Iterator[tuple[str, str]]:
        """Each line of the card: what was measured, and the result."""
        for name, touches in (("free", self.free), ("straight", self.straight)):
            stage = highest_stage(touches)
            missed = ", ".join(
                f"{touch.stage} by {1e3 * touch.distance:.0f} mm"
                for touch in touches
                if not touch.touched
            )
            yield (
                f"Kapandji, fingers {name}",
                f"{sum(touch.touched for touch in touches)} of {len(touches)} places, "
                + ("stage 0 missed" if stage is None else f"all up to stage {stage}")
                + (f"; misses {missed}" if missed else ""),
            )
        gaps = (f"{finger} {_mm(gap)}" for finger, gap in self.gaps.items())
        yield "pinch gaps", f"{', '.join(gaps)} mm"
        for grasp, (small, large) in self.sizes.items():
            yield f"object in a {grasp}", f"{_mm(small)} to {_mm(large)} mm"
        for finger, (far, volume) in self.reach.items():
            yield f"reach of the {finger}", f"{1e3 * far:.0f} mm, {1e6 * volume:.0f} cm³"
        for name, count, faults in (
            ("standard postures", self.postures, self.posture_faults),
            ("GRASP postures", self.grasps, self.grasp_faults),
        ):
            missed = "; ".join(f"{posture}: {fault}" for posture, fault in faults.items())
            yield name, f"{count - len(faults)} of {count}" + (f"; not {missed}" if missed else "")

    def to_json(self) -> dict[str, Any]:
        """The card as one object of plain lists, numbers and strings."""
        tests = {
            name: {
                "touched": [touch.stage for touch in touches if touch.touched],
                "places": len(touches),
                "highest_stage": highest_stage(touches),
                "distances_mm": {
                    str(touch.stage): round(1e3 * touch.distance, 1) for touch in touches
                },
            }
            for name, touches in (("free", self.free), ("straight", self.straight))
        }
        return {
            "hand": self.hand,
            "side": self.side,
            "kapandji": tests,
            "gaps_mm": {
                finger: None if gap is None else round(1e3 * gap, 1)
                for finger, gap in self.gaps.items()
            },
            "sizes_mm": {
                grasp: [None if size is None else round(1e3 * size, 1) for size in sizes]
                for grasp, sizes in self.sizes.items()
            },
            "reach": {
                finger: {"mm": round(1e3 * far, 1), "cm3": round(1e6 * volume, 1)}
                for finger, (far, volume) in self.reach.items()
            },
            "postures": {"count": self.postures, "faults": dict(self.posture_faults)},
            "grasps": {"count": self.grasps, "faults": dict(self.grasp_faults)},
        }


def hand_scorecard(hand: Hand, track: Track | None = None) -> Scorecard:
    """Measures a hand; the same hand gives the same card in each run.

    Args:
        track: function of a progress bar.

    Raises:
        HandModelError: the hand is a gripper.
    """
    if hand.spec.gripper:
        raise HandModelError(
            f"hand {hand.name!r} is a gripper of two jaws: a scorecard is for hands with a thumb "
            "and fingers; run hands check without --scorecard"
        )

    def each(what: str, steps: list[Any]) -> Iterable[Any]:
        return steps if track is None else (steps[i] for i in track(what, range(len(steps))))

    free, straight = kapandji_touches(hand, lambda places: each("Kapandji", places))
    first, second = hand.fingers[1:3]
    gaps = {
        finger: object_size(hand, pinch(hand, finger), largest=False)
        for finger in each("pinches", list(hand.fingers[1:]))
    }
    grasps = {
        "pinch": pinch(hand, first),
        "tripod grasp": pinch(hand, first, second),
        "power grasp": power(hand, first, second),
    }
    sizes = {
        name: (
            gaps[first] if name == "pinch" else object_size(hand, grasps[name], largest=False),
            object_size(hand, grasps[name], largest=True),
        )
        for name in each("objects", list(grasps))
    }
    tips = np.swapaxes(sample_reach(hand, _POSES) - hand.wrist, 0, 1)
    reach = {finger: _reach(own) for finger, own in zip(hand.fingers, tips, strict=True)}
    standard, taxonomy = standard_postures(), grasp_postures()
    (faults,) = (posture_faults(hand, every) for every in each("postures", [standard | taxonomy]))
    return Scorecard(
        hand.name,
        hand.spec.side,
        free,
        straight,
        gaps,
        sizes,
        reach,
        len(standard),
        {name: fault for name, fault in faults.items() if name in standard},
        len(taxonomy),
        {name: fault for name, fault in faults.items() if name in taxonomy},
    )


def _reach(tips: Float[np.ndarray, "S 3"]) -> tuple[float, float]:
    """Largest distance from the wrist [m], and volume of the convex hull [m^3]."""
    hull = ConvexHull(tips, qhull_options="QJ")  # a finger of one motor stays on a curve
    return float(np.linalg.norm(tips, axis=1).max()), float(hull.volume)


def _mm(size: float | None) -> str:
    return "–" if size is None else f"{1e3 * size:.0f}"
