"""A scripted human who does a task with a moving wrist once per world, whatever the robot hand.

The human sees the object but no robot. Each world has another person, with a hand of 190 mm and
bone lengths around published means. The hand closes along one of two synergies, from open to a
pinch of all fingers with the thumb or to a fist. How bent the fingers are in the pinch differs
between people, by as much as between six recordings of real hands
(``research/benchmarks/grasp_postures.py``). The hand comes from above, closes until thumb and
fingers would touch the object, and closes further, so that a robot hand that copies it presses.
Then the wrist carries the object. ``plans`` says what the plans and synergies were tuned on.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Final

import numpy as np
from jaxtyping import Float
from scipy.optimize import least_squares

from smooth_operator import poses
from smooth_operator.errors import UnknownNameError
from smooth_operator.hands.registry import load_hand
from smooth_operator.landmarks import TIPS
from smooth_operator.simulation.scenes import scene_for
from smooth_operator.simulation.scenes.physics import ObjectVariation, draw_wrist_variation
from smooth_operator.synthetic.gestures import FREE_LOWER, FREE_UPPER, pinch_postures
from smooth_operator.synthetic.hand_anatomy import couple, draw_anatomy, pose_hand
from smooth_operator.synthetic.tracker import TrackerStream, tracker_model
from smooth_operator.types import HandRecording
from smooth_operator_research.cross_hand.plans import FIST_GAPS, PLANS, Waypoint
from smooth_operator_research.cross_hand.scenes import HAND_LENGTH
from smooth_operator_research.demonstrations.demonstration import DEFAULT_HAND

_OPEN: Final = np.deg2rad(
    [-16, 22, 0, 0, 4, 12, 14, 0, 12, 14, -4, 12, 14, -8, 12, 14]
)  # free joint angles of the open hand
_FIST: Final = np.deg2rad(
    [
        [-20, 30, -10, -15, *(4 * [0, 25, 20])],
        [-20, 30, -10, -15, *(4 * [0, 60, 70])],
        [10, 25, 35, 30, *(4 * [0, 75, 95])],
    ]
)  # free joint angles of the hand that opens, has its fingers around a handle, and is a fist
_CURLS: Final = np.deg2rad([33.0, 67.0])  # flexion of the PIP joints in pinches of six recordings
_SPREADS: Final = np.deg2rad([10.0, 10.0, 14.0, 16.0, 30.0])  # of the thumb's joints and the MCPs
_CONTACT: Final = 0.0005  # distance that weighs as much as these angles [m]
_REST: Final = 0.75  # share of the way from thumb to fingers of the point that rests in a grip
_STEPS: Final = 400  # postures of the synergy, between which is interpolated


@dataclass(frozen=True, eq=False)
class HumanDemonstration:
    """What a tracker recorded of a human who did a task in a world.

    Attributes:
        task: name of the task.
        world: number of the world, and of the person.
        variation: the world's object.
        tracker: kind of tracker: ``glove``, ``headset`` or ``camera``.
        times: (t,) times of the frames [s].
        landmarks: (t, 21, 3) landmarks in the wrist frame [m].
        wrist: (t, 7) pose of the wrist frame in the frame of the object at its start: position [m]
            and quaternion wxyz.
        touch: time at which thumb and fingers reach the object's surface [s].
        centre: (3,) middle between thumb and fingers at that time, in the wrist frame [m]; before
            a fist closes, that of the open hand.
    """

    task: str
    world: int
    variation: ObjectVariation
    tracker: str
    times: Float[np.ndarray, " t"]
    landmarks: Float[np.ndarray, "t 21 3"]
    wrist: Float[np.ndarray, "t 7"]
    touch: float
    centre: Float[np.ndarray, "3"]

    @property
    def recording(self) -> HandRecording:
        """The landmarks as a recording, which every method takes."""
        name = f"{self.task}-{self.world}-{self.tracker}"
        return HandRecording(self.landmarks, self.times, name=name)


def world_variation(world: int) -> ObjectVariation:
    """Draws the object of a world: the same for every hand, method and tracker, and the same as in
    the environment ``smooth_hand`` with that seed."""
    return draw_wrist_variation(np.random.default_rng(world))


def curl_of(person: int) -> float:
    """Draws the flexion of a person's PIP joints when thumb and fingers meet [rad]."""
    return float(np.random.default_rng([person, 0xC0]).uniform(*_CURLS))


def record(task: str, world: int, tracker: str = "glove") -> HumanDemonstration:
    """Records a human who does a task once.

    Args:
        tracker: kind of tracker that sees the hand: ``glove``, ``headset`` or ``camera``.

    Raises:
        UnknownNameError: there is no such tracker, or no plan for such a task.
    """
    if task not in PLANS:
        raise UnknownNameError("task with a plan", task, PLANS)
    variation = world_variation(world)
    plan = PLANS[task](variation.scene(_scene(task)))
    ends = np.cumsum([waypoint.seconds for waypoint in plan.waypoints])
    model = tracker_model(tracker, seed=world)
    ticks = TrackerStream(model).next(int(ends[-1] * model.rate_hz))
    moments = np.maximum(ticks.stamps - model.delay, 0.0)  # a frame shows the past
    gaps, centres, turns = _moves(plan.waypoints, ends, moments)
    synergy_gaps, synergy = _fist(world) if plan.synergy == "fist" else _synergy(world)
    indices = np.arange(float(_STEPS))
    landmarks = _between(synergy, np.interp(gaps, synergy_gaps, indices))
    touching = _between(synergy, np.interp([plan.width], synergy_gaps, indices))
    centre = grip(touching[0])[0]
    # Until the touch, the middle between thumb and fingers stays; then the fingers rest on their
    # side of the object, and the thumb presses against them.
    opening = _between(synergy, np.interp(np.maximum(gaps, plan.width), synergy_gaps, indices))
    pressing = _between(synergy, np.interp(np.minimum(gaps, plan.width), synergy_gaps, indices))
    ahead = _along(opening, 0.5) + _along(pressing, _REST) - _along(touching, _REST)
    if plan.synergy == "fist":
        ahead[:] = centre
    wrist = np.concatenate([centres - poses.rotate(turns, ahead), turns], axis=1)
    touch = float(ticks.stamps[np.argmax(gaps <= plan.width)])
    seen = ticks.arrives
    return HumanDemonstration(
        task,
        world,
        variation,
        tracker,
        ticks.stamps[seen],
        ticks.shown(landmarks)[seen],
        wrist[seen],
        touch,
        centre,
    )


def _along(landmarks: Float[np.ndarray, "t 21 3"], share: float) -> Float[np.ndarray, "t 3"]:
    """Points (t, 3) on the way from the thumb's tip to those of the fingers [m]."""
    thumb, fingers = landmarks[:, TIPS[0]], landmarks[:, list(TIPS[1:3])].mean(axis=1)
    return np.asarray(thumb + share * (fingers - thumb))


def grip(landmarks: Float[np.ndarray, "21 3"]) -> tuple[Float[np.ndarray, "3"], float]:
    """Returns the (3,) middle between the tip of the thumb and those of index and middle finger
    [m], and their distance [m]."""
    thumb, fingers = landmarks[TIPS[0]], landmarks[list(TIPS[1:3])].mean(axis=0)
    return (thumb + fingers) / 2, float(np.linalg.norm(fingers - thumb))


@lru_cache
def _scene(task: str) -> Any:
    """Scene of a task; the places of object and target do not depend on the hand."""
    return scene_for(task, load_hand(DEFAULT_HAND))


@lru_cache
def _synergy(person: int) -> tuple[Float[np.ndarray, " s"], Float[np.ndarray, "s 21 3"]]:
    """Gaps, increasing [m], and landmarks in the wrist frame [m] of a person's closing hand."""
    pinches = pinch_postures(person)
    closed = np.array(pinches[1])
    closed[4::3], closed[6::3] = 0.0, curl_of(person)
    moving = [*range(4), *range(5, 16, 3)]
    start = np.r_[pinches[:2, :4].mean(axis=0), closed[8]]

    def posture(x: Float[np.ndarray, "5"]) -> Float[np.ndarray, "16"]:
        closed[moving] = [*x, *(3 * [x[4]])]
        return closed

    def residual(x: Float[np.ndarray, "5"]) -> Float[np.ndarray, "8"]:
        points = _landmarks(person, posture(x)[None])[0]
        apart = points[TIPS[0]] - points[list(TIPS[1:3])].mean(axis=0)
        return np.concatenate([apart / _CONTACT, (x - start) / _SPREADS])

    bounds = (np.r_[FREE_LOWER[:4], FREE_LOWER[5]], np.r_[FREE_UPPER[:4], FREE_UPPER[5]])
    solution = least_squares(residual, np.clip(start, *bounds), bounds=bounds).x
    share = np.linspace(1.0, 0.0, _STEPS)[:, None]
    landmarks = _landmarks(person, _OPEN + share * (posture(solution) - _OPEN))
    return np.array([grip(one)[1] for one in landmarks]), landmarks


@lru_cache
def _fist(person: int) -> tuple[Float[np.ndarray, " s"], Float[np.ndarray, "s 21 3"]]:
    """Gaps and landmarks, as in ``_synergy``, of a person's hand that closes to a fist, the thumb
    last. Each of ``FIST_GAPS`` stands for one posture: the real gap grows again at the end, so it
    can't tell how far the fist is closed."""
    share = np.linspace(2.0, 0.0, _STEPS)
    angles = np.stack([np.interp(share, (0, 1, 2), angle) for angle in _FIST.T], axis=1)
    return np.interp(share, (0, 1, 2), FIST_GAPS), _landmarks(person, angles)


def _landmarks(person: int, free: Float[np.ndarray, "s 16"]) -> Float[np.ndarray, "s 21 3"]:
    """Landmarks of a person in the wrist frame [m] for free joint angles [rad]."""
    points = pose_hand(draw_anatomy(HAND_LENGTH, person), couple(free)).landmarks
    return np.stack([points[..., 2], points[..., 1], -points[..., 0]], axis=-1)


def _between(rows: Float[np.ndarray, "s 21 3"], at: Float[np.ndarray, " t"]) -> np.ndarray:
    low = np.minimum(at.astype(int), len(rows) - 2)
    part = (at - low)[:, None, None]
    return np.asarray((1 - part) * rows[low] + part * rows[low + 1])


def _moves(
    waypoints: Sequence[Waypoint], ends: Float[np.ndarray, " w"], times: Float[np.ndarray, " t"]
) -> tuple[Float[np.ndarray, " t"], Float[np.ndarray, "t 3"], Float[np.ndarray, "t 4"]]:
    """Gaps, centres and turns at each time, with minimum-jerk moves between the waypoints."""
    after = np.minimum(np.searchsorted(ends, times), len(waypoints) - 1)
    before = np.maximum(after - 1, 0)
    seconds = np.array([waypoint.seconds for waypoint in waypoints])
    u = np.clip(1.0 - (ends[after] - times) / seconds[after], 0.0, 1.0)
    u = (u**3 * (10 - 15 * u + 6 * u**2))[:, None]
    values = np.array([[*one.centre, one.gap] for one in waypoints])
    moved = values[before] + u * (values[after] - values[before])
    turns = np.array([one.turn for one in waypoints])
    vectors = poses.rotation_vectors(poses.multiply(turns[after], poses.conjugate(turns[before])))
    turned = poses.multiply(poses.from_rotation_vectors(u * vectors), turns[before])
    return moved[:, 3], moved[:, :3], turned
