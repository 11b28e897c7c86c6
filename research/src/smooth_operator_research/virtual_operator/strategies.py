"""Strategies of people for the tasks: steps for the fingertips that depend on the seen object.

A strategy is a generator. It yields the next step and receives what the person sees when the step
is over, so strokes are repeated until the goal is reached, and an object that slipped is taken
again. Strategies follow the instructions of the tasks: the card is pressed, drawn over the edge and
pinched from below; the cube is gripped, turned as far as the fingers reach, released and gripped
again; the screwdriver is taken between thumb and fingers, and the grip loosened until it hangs. The
positions of the fingertips on the object follow from the hand's kinematics, so they suit any hand.
"""

from __future__ import annotations

from collections.abc import Callable, Generator
from dataclasses import dataclass, replace
from typing import Any, Final, TypeAlias

import numpy as np
from jaxtyping import Float

from smooth_operator.simulation.scenes.scene import SceneState
from smooth_operator.simulation.scenes.task_scenes import (
    CARD,
    CUBE,
    HANDLE,
    CardScene,
    CubeScene,
    ScrewdriverScene,
)
from smooth_operator.simulation.tasks.task import (
    CLOSE,
    DOWN,
    GOAL,
    CardScorer,
    ScrewdriverScorer,
    rotation,
)
from smooth_operator_research.virtual_operator.hand_model import GripReach

THUMB: Final = 0
PAD_M: Final = 0.004
"""Distance from a fingertip's landmark to the surface of its pad [m]."""

PRESS_M: Final = 0.002
"""Depth beyond the object's surface to which a person presses in the first attempt [m]; our
choice."""

OPEN_M: Final = 0.010
"""Distance of open fingers from a surface [m]; people open 10 to 20 mm wider than the object when
they reach for it (Jeannerod 1984)."""

CLOSING_S: Final = 1.0
"""Duration of closing a grip [s]; slow, to limit the overshoot within the visual delay."""

_SEEK_M: Final = 0.006  # so far beyond the place where contact is expected fingers look for it [m]

STROKE_S: Final = 1.0
"""Shortest duration of a movement with the object [s]; our choice."""

Aims: TypeAlias = dict[int, Float[np.ndarray, "3"]]
"""Finger -> goal of its tip in the world [m]; other fingers relax."""


@dataclass(frozen=True, eq=False)
class Observation:
    """The scene as a person sees it at one moment.

    Attributes:
        state: state of the object.
        scorer: scorer of the task, with its progress.
        tips: (f, 3) the robot's fingertips in the world [m], thumb first.
        sent: (f, 3) positions to which the person had sent them [m].
    """

    state: SceneState
    scorer: Any
    tips: Float[np.ndarray, "f 3"]
    sent: Float[np.ndarray, "f 3"]

    def touches(self, *fingers: int) -> bool:
        """True if all of these fingers touch the object."""
        return bool((self.state.force[list(fingers)] > 0.0).all())


@dataclass(frozen=True, eq=False)
class Step:
    """Next movement of a person.

    Attributes:
        aims: fraction of the movement from 0 to 1, and what is seen -> goals of the fingertips.
        until: condition that ends the step once it is seen; None: the fingertips are in place.
        presses: fingers that press on the object; their position is not corrected.
        longest_s: longest wait for ``until`` or for fingertips that do not arrive [s].
        seconds: shortest duration of the movement [s].
        via: True for a point on the way, where the person neither waits nor corrects.
        path: True if the goals move from start to end with the fraction; otherwise the person
            moves straight to them.
        attempt: True if a new attempt begins with the step.
        reset: True to ask for the object to be put back when the step begins.
    """

    aims: Callable[[float, Observation], Aims]
    until: Callable[[Observation], bool] | None = None
    presses: tuple[int, ...] = ()
    longest_s: float = 2.0
    seconds: float = 0.0
    via: bool = False
    path: bool = False
    attempt: bool = False
    reset: bool = False


Strategy: TypeAlias = Generator[Step, Observation, None]
"""Generator of a person's steps; it ends when the person gives up."""


def still(aims: Aims) -> Callable[[float, Observation], Aims]:
    """Aims that do not change."""
    return lambda share, obs: aims


class Closing:
    """Fingers close on an object; each stops where it is seen to touch, and presses from there.

    Args:
        inward: finger -> direction in which it closes.
        press: depth to which fingers press beyond the point of contact [m].
        opened: initial distance of the fingers from the surface [m].
    """

    def __init__(self, wide: Aims, inward: Aims, press: float, opened: float = OPEN_M) -> None:
        self._opened = opened
        self._wide, self._inward, self._press = wide, inward, press
        self.contact: Aims = {}

    def __call__(self, share: float, obs: Observation) -> Aims:
        """Aims of the step; remembers which fingers were seen to touch."""
        for finger in self._wide:
            if finger not in self.contact and obs.touches(finger):
                self.contact[finger] = obs.tips[finger].copy()
        touches = self.pressed(self._press)
        return touches | {
            finger: place + share * (self._opened + _SEEK_M) * self._inward[finger]
            for finger, place in self._wide.items()
            if finger not in self.contact
        }

    @property
    def complete(self) -> bool:
        """True if all fingers have touched."""
        return len(self.contact) == len(self._wide)

    def pressed(self, press: float) -> Aims:
        """Goals of fingers that press to a depth beyond the seen or expected contact [m]."""
        expected = {f: p + self._opened * self._inward[f] for f, p in self._wide.items()}
        return {f: p + press * self._inward[f] for f, p in (expected | self.contact).items()}

    def step(self) -> Step:
        """Step with a slow movement until all fingers have been seen to touch."""
        return Step(
            self,
            lambda obs: self.complete,
            presses=tuple(self._wide),
            longest_s=0.5,
            seconds=CLOSING_S,
            path=True,
        )


def along(start: Aims, end: Aims) -> Callable[[float, Observation], Aims]:
    """Straight path of fingertips, for steps with ``path``."""
    return lambda share, obs: {f: place + share * (end[f] - place) for f, place in start.items()}


def turned(aims: Aims, centre: Float[np.ndarray, "3"], angle: float) -> Aims:
    """Rotates fingertips about the vertical axis through a point."""
    cosine, sine = np.cos(angle), np.sin(angle)
    turn = np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])
    return {finger: centre + turn @ (place - centre) for finger, place in aims.items()}


def moved(aims: Aims, by: Float[np.ndarray, "3"]) -> Aims:
    """Translates the aims [m]."""
    return {finger: place + by for finger, place in aims.items()}


def again(obs: Observation, reset: bool = False) -> Generator[Step, Observation, Observation]:
    """Opens the hand after an attempt, and requests a reset if the object can't be reached."""
    reset = reset or bool(obs.scorer.assessment.stuck)
    return (yield Step(lambda share, s: {}, longest_s=0.5, attempt=True, reset=reset))


_Place: TypeAlias = Float[np.ndarray, "3"]

_PULL: Final = np.array([-0.027, 0.0, 0.006])  # way of the pinched card off the table [m],
_LIFT: Final = np.array([0.0, 0.0, 0.024])  # and up
_PINCH_M: Final = 0.010
_SQUEEZE_M: Final = 0.003  # a pinch that is to hold is closed so much further [m]
_BESIDE_M: Final = 0.015  # the card is pressed on so far to the side of the pinch [m]
_STICKS_OUT: Final = 0.025  # of the card over the edge, before it is pinched [m]


def card_strategy(scene: CardScene, reach: GripReach, obs: Observation) -> Strategy:
    """Presses on the card, draws it over the edge, pinches it and pulls it off.

    Args:
        obs: at the start.
    """
    edge, top = scene.edge, scene.top
    above = top + CARD[2] + PAD_M
    finger, y = reach.edge_pinch(
        edge - _PINCH_M, float(obs.state.position[1]), top, CARD[2] + 2 * PAD_M
    )
    press = PRESS_M
    both = (THUMB, finger)
    lift, down = np.array([0.0, 0.0, OPEN_M]), np.array([0.0, 0.0, -1.0])
    x = edge - _PINCH_M
    below = np.array([edge - 0.016, y, top - 0.022])
    while True:
        far = min(scene.reach - 0.012, float(obs.state.position[0]) + CARD[0] / 2 - 0.012)
        aside = float(np.clip(obs.state.position[1] - y, -_BESIDE_M, _BESIDE_M))
        over = np.array([far, y + aside, above]) + lift
        obs = yield Step(still({THUMB: below, finger: over}))
        for _ in range(4):
            if _protrudes(obs) >= _STICKS_OUT:
                break
            touch = Closing({finger: over}, {finger: down}, press)
            obs = yield _with_thumb(touch.step(), below)
            start = touch.pressed(press).get(finger, over - lift)
            end = np.array([edge + 0.001, y, start[2]])

            def drawn(
                share: float, s: Observation, a: _Place = start, b: _Place = end, p: float = press
            ) -> Aims:
                place = a + share * (b - a)
                if s.touches(finger):  # the pad rolls: press as far beyond where it is seen
                    place = np.array([place[0], place[1], s.tips[finger][2] - p])
                return {THUMB: below, finger: place}

            obs = yield Step(
                drawn,
                lambda s: _protrudes(s) >= _STICKS_OUT,
                presses=(finger,),
                longest_s=0.4,
                path=True,
            )
            obs = yield Step(still({THUMB: below, finger: obs.tips[finger] + lift}), via=True)
            if _protrudes(obs) < _STICKS_OUT:  # another stroke
                obs = yield Step(still({THUMB: below, finger: over}))
        # The finger goes over the part that sticks out, the thumb below it, and both close.
        wide = {THUMB: np.array([x, y, top - PAD_M]) - lift, finger: np.array([x, y, above]) + lift}
        obs = yield Step(still(wide))
        pinch = Closing(wide, {THUMB: -down, finger: down}, press)
        obs = yield pinch.step()
        if pinch.complete:
            firm = pinch.pressed(press + _SQUEEZE_M)
            closed, off = pinch.pressed(press), moved(firm, _PULL)
            obs = yield Step(
                along(closed, off),
                presses=both,
                longest_s=0.2,
                seconds=STROKE_S,
                path=True,
            )
            obs = yield Step(
                along(off, moved(off, _LIFT)),
                lambda s: _clear(s, 0.2) or not s.touches(*both),
                presses=both,
                longest_s=1.0,
                seconds=STROKE_S,
                path=True,
            )
            held = {f: obs.sent[f] for f in both}
            while obs.touches(*both) and _clear(obs, 0.0):
                obs = yield Step(still(held), presses=both, longest_s=0.5)
            if obs.touches(*both):  # it does not come off: put it back
                obs = yield Step(
                    along(held, closed),
                    presses=both,
                    longest_s=0.2,
                    seconds=STROKE_S,
                    path=True,
                )
        obs = yield from again(obs)
        press = min(press * 1.5, 3 * PRESS_M)


def _with_thumb(step: Step, place: Float[np.ndarray, "3"]) -> Step:
    """The step, with the thumb at a place."""
    aims = step.aims
    return replace(step, aims=lambda share, obs: {THUMB: place, **aims(share, obs)})


def _clear(obs: Observation, seconds: float) -> bool:
    """True if only the pinch has held the card for the required time."""
    since = obs.scorer.pinched
    return since is not None and obs.state.time - since >= seconds


def _protrudes(obs: Observation) -> float:
    scorer: CardScorer = obs.scorer
    return scorer.protrusion


_PRESS_M: Final = 0.003  # in the first stroke [m]; ours
_OPEN_M: Final = 0.015  # fingers are wider open, since a cube's corners stand out [m]
_HIGH_M: Final = 0.010  # of the grip above the cube's centre: fingers come from above [m]
_ABOVE: Final = np.array([0.0, 0.0, 0.045])  # where fingers go over the cube [m]
_NEARLY: Final = np.radians(10.0)  # a cube that is so near its goal is let be [rad]
_STOPS: Final = np.radians(3.0)  # a stroke ends so long before the goal [rad]


def cube_strategy(scene: CubeScene, reach: GripReach, obs: Observation) -> Strategy:
    """Grips the cube, turns it as far as the fingers reach and releases it, until it is turned.

    Args:
        obs: at the start.
    """
    sign, press, above = 0.0, _PRESS_M, True
    near = CUBE / 2 + PAD_M
    out = near + _OPEN_M
    while True:
        missing = GOAL - sign * obs.scorer.turned
        if sign and abs(missing) < _NEARLY:  # let it be, and look
            obs = yield Step(lambda share, s: {}, lambda s: False, longest_s=0.5)
            above = True
            continue
        centre = obs.state.position + np.array([0.0, 0.0, _HIGH_M])
        way = sign * float(np.sign(missing))
        stroke = reach.turn(centre, _normals(obs), way, abs(missing), near, out)
        if stroke is None:  # it stands where the fingers can't turn it
            starts = obs.state.starts
            obs = yield from again(obs, reset=True)
            if obs.state.starts == starts:
                return
            sign, above = 0.0, True
            continue
        finger, start, end = stroke
        sign = sign or float(np.sign(end - start))
        n = np.array([np.cos(start), np.sin(start), 0.0])
        wide = {THUMB: centre - out * n, finger: centre + out * n}
        if above:
            obs = yield Step(still(moved(wide, _ABOVE)), via=True)
        obs = yield Step(still(wide))
        touch = Closing(wide, {THUMB: n, finger: -n}, press, _OPEN_M)
        obs = yield touch.step()
        before = obs.scorer.turned
        if touch.complete:
            closed = touch.pressed(press)
            obs = yield Step(still(closed), presses=(THUMB, finger), longest_s=0.3)
            obs = yield Step(
                _around(closed, centre, end - start),
                _has_turned(obs, abs(missing) - _STOPS),
                presses=(THUMB, finger),
                longest_s=0.4,
                path=True,
                seconds=STROKE_S,
            )
        at = _angle(obs, centre, finger)
        m = np.array([np.cos(at), np.sin(at), 0.0])
        back = {THUMB: centre - out * m, finger: centre + out * m}
        obs = yield Step(still(back), via=True)
        if obs.scorer.assessment.stuck:
            obs = yield from again(obs)
            sign, above = 0.0, True
            continue
        if abs(obs.scorer.turned - before) < np.radians(5.0):
            press = min(press * 1.5, 3 * _PRESS_M)
        above = False


def _around(
    aims: Aims, centre: Float[np.ndarray, "3"], angle: float
) -> Callable[[float, Observation], Aims]:
    return lambda share, obs: turned(aims, centre, share * angle)


def _has_turned(before: Observation, angle: float) -> Callable[[Observation], bool]:
    return lambda obs: abs(obs.scorer.turned - before.scorer.turned) >= angle


def _angle(obs: Observation, centre: Float[np.ndarray, "3"], finger: int) -> float:
    """Direction from the thumb to a finger about the vertical [rad]."""
    x, y, _ = obs.tips[finger] - obs.tips[THUMB]
    return float(np.arctan2(y, x))


def _normals(obs: Observation) -> Float[np.ndarray, "4"]:
    """Directions (4,) of the cube's vertical faces about the vertical [rad]."""
    turn = rotation(obs.state.quaternion)
    axes = [turn[:, k] for k in range(3) if abs(turn[2, k]) < 0.7]
    heading = float(np.arctan2(axes[0][1], axes[0][0]))
    return heading + np.pi / 2 * np.arange(4)


_LIGHT: Final = 0.3  # share of the first grip's press that is the least for a handle that hangs
_LOOSENS_M: Final = 0.0002  # by so much the grip is loosened between two looks [m]


def screwdriver_strategy(scene: ScrewdriverScene, reach: GripReach, obs: Observation) -> Strategy:
    """Takes the handle between thumb and fingers, loosens the grip until the blade hangs, and
    holds.

    Args:
        obs: at the start.
    """
    press = PRESS_M
    across = reach.across(obs.state.position, rotation(scene.start[1])[:, 2])
    along = -rotation(scene.start[1])[:, 2]  # towards the handle's end
    out = HANDLE[0] + PAD_M
    pivot, second, apart = reach.handle_fingers(obs.state.position, across, along, out)

    def grip(width: float, centre: Float[np.ndarray, "3"], other: float | None) -> Aims:
        aims = {THUMB: centre + width * across, pivot: centre - width * across}
        if other is not None:
            aims[second] = centre + apart * along - other * across
        return aims

    while True:
        centre = obs.state.position.copy()
        wide = grip(out + OPEN_M, centre, out + OPEN_M)
        obs = yield Step(still(wide))
        inward = {f: (-1.0 if f == THUMB else 1.0) * across for f in wide}
        touch = Closing(wide, inward, press)
        obs = yield touch.step()
        obs = yield Step(
            still(touch.pressed(press)),
            lambda s: not s.state.fixed,
            presses=tuple(wide),
            longest_s=1.5,
        )
        if obs.state.fixed:
            press = min(press * 1.5, 3 * PRESS_M)
            continue

        def held(press: float, t: Closing = touch, w: Aims = wide) -> Step:
            aims = t.pressed(press) | {second: w[second]}
            return Step(still(aims), presses=(THUMB, pivot), longest_s=0.1)

        obs = yield held(press)
        squeeze, high = press, float(obs.state.position[2])
        while True:
            scorer: ScrewdriverScorer = obs.scorer
            if scorer.angle <= DOWN or high - obs.state.position[2] > 0.004:
                squeeze = press
            elif np.linalg.norm(obs.state.spin) < 0.5:
                if scorer.angle <= CLOSE and squeeze <= _LIGHT * press:  # looser would drop it
                    return
                squeeze = max(squeeze - _LOOSENS_M, -PRESS_M)
            obs = yield held(squeeze)
            if obs.state.fixed:  # it was put back
                break


STRATEGIES: Final[dict[str, Callable[[Any, GripReach, Observation], Strategy]]] = {
    "card": card_strategy,
    "cube": cube_strategy,
    "screwdriver": screwdriver_strategy,
}
"""Task -> strategy."""
