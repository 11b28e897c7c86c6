"""Hand of a person that follows fingertip goals by inverse kinematics within its joint ranges.

There are two hands. ``human`` has published human anatomy with the person's bone lengths and human
joint ranges. ``matched`` has the kinematics and joint ranges of the robot hand at human size, with
each bone at most 10 % longer or shorter. The demonstrations of the tasks use fingertip positions
that a human thumb, aligned by the palm, does not reach (``research/docs/study.md`` has the
figures), so trials are simulated with the matched hand.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Final, Literal, TypeAlias

import mujoco
import numpy as np
from jaxtyping import Float

from smooth_operator.hands.hand import Hand, landmark_points
from smooth_operator.landmarks import BASES, FINGERS, LANDMARKS, TIPS
from smooth_operator.retargeting.retargeter import Retargeter
from smooth_operator.simulation.physics import FURNISHED
from smooth_operator.simulation.scenes.physics import ScenePhysics
from smooth_operator.simulation.scenes.scene import Scene
from smooth_operator.synthetic.gestures import RELAXED
from smooth_operator.synthetic.hand_anatomy import FREE, LOWER, UPPER, couple, mirror, pose_hand
from smooth_operator.synthetic.robot_landmarks import human_landmarks
from smooth_operator.synthetic.tracker import TrackerModel, TrackerStream
from smooth_operator.types import HandFrame, Side
from smooth_operator_research.virtual_operator.person import Person


class SeenTips:
    """The fingertips of a hand in a scene."""

    def __init__(self, physics: ScenePhysics) -> None:
        hand, model = physics.hand, physics.model
        places = landmark_points(hand.model, hand.spec)
        self._physics, self._palm = physics, model.body(FURNISHED + hand.spec.palm).id
        named = [places[name] for name in hand.tip_names]
        self._bodies = [model.body(FURNISHED + hand.model.body(b).name).id for b, _ in named]
        self._offsets = np.array([offset for _, offset in named])

    def read(self) -> Float[np.ndarray, "f 3"]:
        """Current fingertips (f, 3) in the palm frame [m], thumb first."""
        data = self._physics.data
        turns = data.xmat[self._bodies].reshape(-1, 3, 3)
        world = data.xpos[self._bodies] + np.einsum("fij,fj->fi", turns, self._offsets)
        return np.asarray((world - data.xpos[self._palm]) @ data.xmat[self._palm].reshape(3, 3))


class HandPoints:
    """Landmarks of a robot hand in a pose, and their derivatives."""

    def __init__(self, hand: Hand, names: Sequence[str]) -> None:
        places = landmark_points(hand.model, hand.spec)
        self._hand, self._model, self._data = hand, hand.model, mujoco.MjData(hand.model)
        self._named = [places[name] for name in names]
        self._palm = hand.model.body(hand.spec.palm).id
        self._dofs = [int(hand.model.joint(name).dofadr[0]) for name in hand.joint_names]

    def at(
        self, q: Float[np.ndarray, " m"]
    ) -> tuple[Float[np.ndarray, "k 3"], Float[np.ndarray, "k 3 m"]]:
        """Positions (k, 3) in the palm frame [m] and derivatives (k, 3, m) [m/rad].

        Args:
            q: (m,) actuated joint positions [rad].
        """
        model, data, hand = self._model, self._data, self._hand
        data.qpos[:] = hand.qpos(hand.full_configuration(q))
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        palm, turn = data.xpos[self._palm], data.xmat[self._palm].reshape(3, 3)
        points = np.empty((len(self._named), 3))
        jacobian = np.empty((len(self._named), 3, len(q)))
        rows = np.zeros((3, model.nv))
        for k, (body, offset) in enumerate(self._named):
            world = data.xpos[body] + data.xmat[body].reshape(3, 3) @ offset
            mujoco.mj_jac(model, data, rows, None, world, body)
            points[k] = (world - palm) @ turn
            jacobian[k] = turn.T @ rows[:, self._dofs] @ hand.transmission.slopes(q)
        return points, jacobian


Body: TypeAlias = Literal["matched", "human"]
"""Kinematics of a person's hand."""

_NUDGE: Final = 1e-5  # of an angle, for derivatives [rad]
_TIP_M: Final = 0.002  # a fingertip's error counts in units of this [m]
_POSTURE: Final = 3.0  # an angle's distance from the relaxed hand counts in units of this [rad]
_MOTION: Final = 0.5  # and that from the last angle in units of this [rad]
_FASTEST: Final = 15.0
"""Highest speed of a finger joint [rad/s]; our choice, similar to the fastest movements."""


class HandModel(ABC):
    """Kinematics of a hand.

    Attributes:
        lower: (m,) smallest angles [rad].
        upper: (m,) largest angles [rad].
        relaxed: (m,) angles of the relaxed hand [rad].
    """

    lower: Float[np.ndarray, " m"]
    upper: Float[np.ndarray, " m"]
    relaxed: Float[np.ndarray, " m"]

    @abstractmethod
    def landmarks(
        self, angles: Float[np.ndarray, " m"]
    ) -> tuple[Float[np.ndarray, "21 3"], Float[np.ndarray, "5 3 m"]]:
        """Landmarks [m] and the derivatives of the tips [m/rad].

        Args:
            angles: (m,) joint angles [rad].
        """


def hand_model(person: Person, hand: Hand, body: Body = "matched") -> HandModel:
    """Makes the hand of a person who drives a robot hand."""
    return HumanHand(person, hand.spec.side) if body == "human" else MatchedHand(person, hand)


class HumanHand(HandModel):
    """Published anatomy with a person's bones."""

    def __init__(self, person: Person, side: Side) -> None:
        self.lower, self.upper, self.relaxed = LOWER[list(FREE)], UPPER[list(FREE)], RELAXED
        self._anatomy, self._side = person.anatomy, side
        self._nudges = np.concatenate([np.zeros((1, len(FREE))), _NUDGE * np.eye(len(FREE))])

    def landmarks(
        self, angles: Float[np.ndarray, "16"]
    ) -> tuple[Float[np.ndarray, "21 3"], Float[np.ndarray, "5 3 16"]]:
        """See ``HandModel``."""
        poses = pose_hand(self._anatomy, couple(angles + self._nudges))
        points = (poses if self._side == "right" else mirror(poses)).landmarks
        return points[0], np.moveaxis(
            points[1:, list(TIPS)] - points[0, list(TIPS)], 0, -1
        ) / _NUDGE


class MatchedHand(HandModel):
    """The robot hand's kinematics at the size of a person, with the person's bones."""

    def __init__(self, person: Person, hand: Hand) -> None:
        self.lower, self.upper = hand.limits.T
        self.relaxed = hand.neutral
        self._points = HandPoints(hand, hand.tree.names)
        indices = [LANDMARKS.index(name) for name in hand.tree.names]
        # All landmarks are the known ones, or lie between two of them, or stand still.
        still = human_landmarks(hand, hand.neutral[None])[0]
        share = np.zeros((len(LANDMARKS), len(indices)))
        share[indices, range(len(indices))] = 1.0
        for name in hand.fingers:
            first = BASES[FINGERS.index(name)]
            own = [i for i in range(first, first + 4) if i in indices]
            for i in set(range(first, first + 4)) - set(own):
                below, above = max(k for k in own if k < i), min(k for k in own if k > i)
                part = (i - below) / (above - below)
                share[i] = (1 - part) * share[below] + part * share[above]
        rest = still * ~share.any(axis=1, keepdims=True)
        bones = np.eye(len(LANDMARKS))
        for row in (FINGERS.index(name) for name in hand.fingers):
            for k in range(3):
                i = BASES[row] + k
                factor = person.bone_factors[row, k]
                bones[i + 1] = bones[i] + factor * (np.eye(21)[i + 1] - np.eye(21)[i])
        size = person.anatomy.hand_length / _length(hand, still)
        self._share, self._rest = size * bones @ share, size * bones @ rest

    def landmarks(
        self, angles: Float[np.ndarray, " m"]
    ) -> tuple[Float[np.ndarray, "21 3"], Float[np.ndarray, "5 3 m"]]:
        """See ``HandModel``."""
        points, jacobian = self._points.at(angles)
        tips = np.einsum("tk,kim->tim", self._share[list(TIPS)], jacobian)
        return self._share @ points + self._rest, tips


def _length(hand: Hand, points: Float[np.ndarray, "21 3"]) -> float:
    """Length from wrist to middle fingertip, or to that of the second finger, along the bones
    [m]."""
    row = FINGERS.index(hand.fingers[min(2, len(hand.fingers) - 1)])
    chain = points[[0, *range(BASES[row], BASES[row] + 4)]]
    return float(np.linalg.norm(np.diff(chain, axis=0), axis=1).sum())


class ReachingHand:
    """A hand whose fingertips move to goals within the limits of joint positions and speeds.

    Attributes:
        angles: (m,) joint angles [rad].
    """

    def __init__(self, model: HandModel) -> None:
        self._model = model
        self.angles: Float[np.ndarray, " m"] = np.array(model.relaxed)

    @property
    def landmarks(self) -> Float[np.ndarray, "21 3"]:
        """Current landmarks (21, 3) of the hand [m]."""
        return self._model.landmarks(self.angles)[0]

    def reach(
        self, tips: Float[np.ndarray, "5 3"], seconds: float, rounds: int = 1
    ) -> Float[np.ndarray, "21 3"]:
        """Moves the fingertips towards goals.

        Args:
            tips: (5, 3) goals, thumb first [m]; NaN for a finger that stays relaxed.
            seconds: time since the last call [s]; infinite for no speed limit.
            rounds: number of Gauss-Newton steps from the last angles.

        Returns:
            (21, 3) landmarks [m].
        """
        model, start = self._model, self.angles
        finite = np.isfinite(tips).all(axis=1)
        goals = tips[finite]
        x = start
        for _ in range(rounds):
            points, derivatives = model.landmarks(x)
            jacobian = derivatives[finite].reshape(-1, len(x)) / _TIP_M
            error = (goals - points[list(TIPS)][finite]).ravel() / _TIP_M
            posture, motion = (model.relaxed - x) / _POSTURE**2, (start - x) / _MOTION**2
            pull = jacobian.T @ error + posture + motion
            # A joint at its limit that is wanted beyond it takes no part.
            stuck = ((x <= model.lower) & (pull < 0)) | ((x >= model.upper) & (pull > 0))
            jacobian = jacobian * ~stuck
            hessian = jacobian.T @ jacobian
            hessian += np.diag(1 / _POSTURE**2 + 1 / _MOTION**2 + 1e6 * stuck)
            x = np.clip(x + np.linalg.solve(hessian, pull * ~stuck), model.lower, model.upper)
        most = _FASTEST * seconds
        self.angles = start + np.clip(x - start, -most, most)
        return self.landmarks


_NEAR_M: Final = 0.004
"""Distance at which a fingertip counts as having reached a place [m]."""

_ROUNDS: Final = 40
_MOST: Final = np.radians(42.0)  # a grip is this far from a face's normal at most [rad]
_ASIDE: Final = np.radians(50.0)  # and from the line from the relaxed thumb to the finger [rad]
_AROUND: Final = np.radians(100.0)
"""Largest angle of the thumb around the object [rad]; beyond it, other links touch the object."""
_SHORTEST: Final = np.radians(5.0)
_STEP: Final = np.radians(5.0)


class _RobotTips(HandModel):
    """The robot hand itself: its fingertips in the palm frame."""

    def __init__(self, hand: Hand) -> None:
        self.lower, self.upper = hand.limits.T
        self.relaxed = hand.neutral
        self._points = HandPoints(hand, hand.tip_names)
        self._rows = [FINGERS.index(name) for name in hand.fingers]

    def landmarks(
        self, angles: Float[np.ndarray, " m"]
    ) -> tuple[Float[np.ndarray, "21 3"], Float[np.ndarray, "5 3 m"]]:
        points, jacobian = self._points.at(angles)
        everything, derivatives = np.zeros((21, 3)), np.zeros((5, 3, len(angles)))
        everything[[TIPS[row] for row in self._rows]] = points
        derivatives[self._rows] = jacobian
        return everything, derivatives


class GripReach:
    """Reach of a hand's fingertips in a scene."""

    def __init__(self, hand: Hand, scene: Scene) -> None:
        self._hand, self._model = hand, _RobotTips(hand)
        self._at, self._turn = scene.mount.palm
        self._rows = [FINGERS.index(name) for name in hand.fingers]
        tips = hand.tips(hand.full_configuration(hand.neutral))
        self.relaxed = tips @ self._turn.T + self._at
        self._turns: dict[tuple[float, ...], dict[int, tuple[float, float]]] = {}

    def off(self, aims: dict[int, Float[np.ndarray, "3"]]) -> float:
        """Largest distance of a fingertip from its goal [m].

        Args:
            aims: finger -> goal in the world [m].
        """
        goals = np.full((5, 3), np.nan)
        for finger, place in aims.items():
            goals[self._rows[finger]] = (place - self._at) @ self._turn
        rows = [self._rows[finger] for finger in aims]
        points = ReachingHand(self._model).reach(goals, np.inf, rounds=_ROUNDS)
        return float(np.linalg.norm(points[list(TIPS)][rows] - goals[rows], axis=1).max())

    def edge_pinch(self, x: float, y: float, top: float, gap: float) -> tuple[int, float]:
        """Finger that can best pinch a card with the thumb, and the position along the edge.

        Args:
            x: position of the pinch [m].
            y: position of the card's centre [m].
            top: height of the table [m].
            gap: distance between the fingertips [m].
        """
        places = []
        for finger in (1, 2):
            for side in (0.0, 0.01, -0.01, 0.02, -0.02):
                low = np.array([x, y + side, top - gap / 2 + 0.001])
                off = self.off({0: low, finger: low + np.array([0.0, 0.0, gap])})
                places.append((off + 0.05 * abs(side), finger, y + side))
        _, finger, place = min(places)
        return finger, place

    def turn(
        self,
        centre: Float[np.ndarray, "3"],
        normals: Float[np.ndarray, " n"],
        sign: float,
        missing: float,
        width: float,
        wide: float,
    ) -> tuple[int, float, float] | None:
        """Finger, first and last angle of the best stroke that turns a block about the vertical.

        Args:
            centre: middle of the block [m].
            normals: (n,) directions of its faces [rad].
            sign: direction in which to turn it; 0 for either.
            missing: angle that is left to turn [rad].
            width: distance of fingertips from the centre [m].
            wide: distance of the open hand's fingertips from it [m].

        Returns:
            None if thumb and fingers can't turn it.
        """
        best: tuple[float, int, float, float] | None = None
        for finger, (low, high) in self._ranges(centre, width, wide).items():
            for normal in normals:
                middle = (low + high) / 2
                normal = middle + (normal - middle + np.pi) % (2 * np.pi) - np.pi
                for way in (1.0, -1.0) if not sign else (sign,):
                    start = float(np.clip(normal, low, high))
                    if way * (normal - start) < 0:  # begin as far back as the faces allow
                        start = float(np.clip(normal - way * 0.0, low, high))
                    if abs(start - normal) > _MOST:
                        continue
                    room = way * ((high if way > 0 else low) - start)
                    gain = min(room, missing)
                    if gain < min(_SHORTEST, missing):
                        continue
                    value = gain - 0.3 * abs(start - normal)
                    if best is None or value > best[0]:
                        best = value, finger, start, start + way * gain
        return None if best is None else best[1:]

    def _ranges(
        self, centre: Float[np.ndarray, "3"], width: float, wide: float
    ) -> dict[int, tuple[float, float]]:
        """Finger -> smallest and largest angle at which it and the thumb grip from both sides."""
        key = tuple(np.round(centre, 2))
        if key not in self._turns:
            angles = np.arange(-np.pi, np.pi, _STEP)
            ranges = {}
            for finger in (1, 2):
                away = self.relaxed[finger] - self.relaxed[0]
                nominal = np.arctan2(away[1], away[0])
                fits = []
                for angle in angles:
                    around = angle + np.pi - np.arctan2(*(self.relaxed[0] - centre)[1::-1])
                    if np.cos(angle - nominal) < np.cos(_ASIDE) or np.cos(around) < np.cos(_AROUND):
                        fits.append(False)
                        continue
                    n = np.array([np.cos(angle), np.sin(angle), 0.0])
                    fits.append(
                        all(
                            self.off({0: centre - w * n, finger: centre + w * n}) <= near
                            for w, near in ((width, _NEAR_M), (wide, 2 * _NEAR_M))
                        )
                    )
                span = _longest_run(np.array(fits))
                if span is not None:
                    ranges[finger] = (
                        float(angles[span[0]]),
                        float(angles[span[0]] + _STEP * (span[1] - span[0])),
                    )
            self._turns[key] = ranges
        return self._turns[key]

    def across(
        self, centre: Float[np.ndarray, "3"], axis: Float[np.ndarray, "3"]
    ) -> Float[np.ndarray, "3"]:
        """(3,) horizontal direction across a handle, towards the thumb's side."""
        direction = np.cross(axis, [0.0, 0.0, 1.0])
        direction /= np.linalg.norm(direction)
        side = (self.relaxed[0] - self.relaxed[1:3].mean(axis=0)) @ direction
        return np.asarray(direction * np.sign(side))

    def handle_fingers(
        self,
        centre: Float[np.ndarray, "3"],
        across: Float[np.ndarray, "3"],
        along: Float[np.ndarray, "3"],
        width: float,
    ) -> tuple[int, int, float]:
        """Finger opposite the thumb, the second finger, and its distance along the handle [m].

        Args:
            centre: middle of the grip [m].
            across: direction to the thumb.
            along: direction to the handle's end.
            width: distance of fingertips from the handle's axis [m].
        """
        fingers = []
        for pivot, second in ((1, 2), (2, 3), (2, 1)):
            if second >= len(self._rows):
                continue
            for apart in (0.018, 0.024, -0.018):
                off = self.off(
                    {
                        0: centre + width * across,
                        pivot: centre - width * across,
                        second: centre + apart * along - width * across,
                    }
                )
                fingers.append((off, pivot, second, apart))
        return min(fingers)[1:]


def _longest_run(fits: np.ndarray) -> tuple[int, int] | None:
    """First and last place of the longest run of true values on a circle."""
    if not fits.any():
        return None
    if fits.all():
        return 0, len(fits) - 1
    begin = int(np.argmin(fits))
    rolled = np.roll(fits, -begin)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], rolled.astype(int), [0]])))
    first, past = max(zip(edges[::2], edges[1::2], strict=True), key=lambda run: run[1] - run[0])
    return int(first + begin), int(past - 1 + begin)


POSTURES: Final = 48
"""Number of postures in free movement; movements of 0.7 s, with pauses, fill two minutes."""

_MOVE_S: Final = 0.5
_RATE_HZ: Final = 15.0  # of the frames that are remembered
_KERNEL_M: Final = 0.02  # movements this far off count 61 % in the local fit [m]
_RIDGE: Final = 0.05  # pulls the local fit to the fit over all, where movements were few


class InternalModel:
    """Maps goals of the robot's fingertips to the person's own fingertips, by locally weighted
    affine regression.

    Args:
        robot: (n, f, 3) robot fingertips that were seen, in the robot's palm frame [m].
        own: (n, f, 3) fingertips of the person at the same times [m].
        fingers: (f,) index of each finger in ``FINGERS``.
    """

    def __init__(
        self,
        robot: Float[np.ndarray, "n f 3"],
        own: Float[np.ndarray, "n f 3"],
        fingers: list[int],
    ) -> None:
        self._robot, self._own = np.swapaxes(robot, 0, 1), np.swapaxes(own, 0, 1)
        self._fingers = fingers
        ones = np.ones((*self._robot.shape[:2], 1))
        self._inputs = np.concatenate([self._robot, ones], axis=-1)
        self._global = np.stack(
            [
                np.linalg.lstsq(x, y, rcond=None)[0]
                for x, y in zip(self._inputs, self._own, strict=True)
            ]
        )
        self._rest = self._own - self._inputs @ self._global

    def own_tips(self, robot: Float[np.ndarray, "f 3"]) -> Float[np.ndarray, "5 3"]:
        """Fingertips (5, 3) in the frame of the person's landmarks [m]; NaN for fingers that the
        robot lacks."""
        away = ((self._robot - robot[:, None]) ** 2).sum(axis=-1)
        nearest = away.min(axis=1, keepdims=True)  # outside of what was tried, its border counts
        weight = np.exp(-0.5 * (away - nearest) / _KERNEL_M**2)
        inputs = np.concatenate([self._robot - robot[:, None], self._inputs[..., 3:]], axis=-1)
        weighted = np.swapaxes(inputs * weight[..., None], 1, 2)
        # About the wanted point, in units of the kernel, so that one ridge serves all terms.
        unit = np.array([_KERNEL_M, _KERNEL_M, _KERNEL_M, 1.0])
        gram = (weighted @ inputs) / np.outer(unit, unit)
        ridge = _RIDGE * weight.sum(axis=1)[:, None, None] * np.eye(4)
        solved = np.linalg.solve(gram + ridge, (weighted @ self._rest) / unit[:, None])
        here = np.concatenate([robot, np.ones((len(robot), 1))], axis=-1)
        out = np.full((len(FINGERS), 3), np.nan)
        out[self._fingers] = (here[:, None] @ self._global)[:, 0] + solved[:, 3]
        return out


def familiarise(
    model: HandModel, retargeter: Retargeter, tracker: TrackerModel, seed: int = 0
) -> InternalModel:
    """Learns the model by free movement with a retargeter and a tracker."""
    hand, rng = retargeter.hand, np.random.default_rng([seed, 0xFA])
    reach = rng.uniform(0.02, 0.98, (POSTURES, len(model.relaxed)))
    postures = np.concatenate([[model.relaxed], model.lower + (model.upper - model.lower) * reach])
    share = np.arange(1, round(_MOVE_S * _RATE_HZ) + 1)[:, None] / round(_MOVE_S * _RATE_HZ)
    share = share * share * (3 - 2 * share)
    path = postures[:-1, None] + share * np.diff(postures, axis=0)[:, None]
    points = np.array([model.landmarks(q)[0] for q in path.reshape(-1, len(model.relaxed))])
    fingers = [FINGERS.index(name) for name in hand.fingers]
    state, robot = retargeter.init(seed), []
    shown = TrackerStream(tracker, _RATE_HZ).next(len(points)).shown(points)
    for k, landmarks in enumerate(shown):
        state, result = retargeter.step(state, HandFrame(landmarks, k / _RATE_HZ, hand.spec.side))
        robot.append(hand.tips(result.command.joint_positions))
    return InternalModel(np.array(robot), points[:, [TIPS[row] for row in fingers]], fingers)
