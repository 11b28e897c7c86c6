"""Tasks of a study with their rubrics, and the scorers of the Smooth Operator paper's three tasks.

A scorer follows a scene and assesses the trial. Source of the rubrics: the task success rubric in
the paper's supplement, in our words.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any, Final, Protocol, Self

import numpy as np
from jaxtyping import Float

from smooth_operator.errors import StudyError, UnknownNameError
from smooth_operator.simulation.scenes.scene import Scene, SceneState
from smooth_operator.simulation.scenes.task_scenes import (
    CARD,
    CardScene,
    CubeScene,
    ScrewdriverScene,
)

HOLD_S: Final = 0.5
"""Time for which a goal must be met without a break [s]."""

NOT_DONE: Final = "not-done"
"""Line of every rubric for a trial that ended without success."""

PRESSES_N: Final = 0.02
"""Force above which a finger counts as touching [N]."""


@dataclass(frozen=True)
class Assessment:
    """Score that a trial would get if it ended now.

    Attributes:
        score: 0, 0.5 or 1, before the cap for a reset.
        line: line of the task's rubric that gives the score.
        reason: the reason in a few words.
        complete: True once the goal is met; the trial ends.
        dropped: True once the object is lost; the trial ends.
        stuck: True while only a reset can help.
    """

    score: float
    line: str
    reason: str
    complete: bool = False
    dropped: bool = False
    stuck: bool = False


class Scorer(Protocol):
    """State of a trial in progress, from which a task's rubric derives the score. It is
    immutable."""

    @property
    def assessment(self) -> Assessment:
        """Score of the trial if it ended now."""

    def observe(self, state: SceneState) -> Self:
        """Returns the scorer, updated with a later state of the scene."""


def held_since(since: float | None, meets: bool, time: float) -> float | None:
    """Time from which a condition has held without a break; None if it does not hold now."""
    if not meets:
        return None
    return time if since is None else since


def lasted(since: float | None, time: float, seconds: float = HOLD_S) -> bool:
    """True if a condition that has held since the time ``since`` has held for ``seconds`` or
    more."""
    return since is not None and time - since >= seconds - 1e-9


def outside(scene: Scene, state: SceneState) -> bool:
    """True if the object has left the workspace of the scene."""
    return bool(np.any(state.position < scene.lower) or np.any(state.position > scene.upper))


def held_by_hand(state: SceneState) -> bool:
    """True if the hand touches the object and nothing else supports it."""
    touched = state.palm > PRESSES_N or bool(np.any(state.force > PRESSES_N))
    return touched and not state.fixed and state.support == 0.0


def rotation(quaternion: Float[np.ndarray, "4"]) -> Float[np.ndarray, "3 3"]:
    """(3, 3) rotation matrix of a unit quaternion w x y z."""
    w, x, y, z = quaternion
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


OVER: Final = 0.005
"""Protrusion above which a card that lies on the table counts as over the edge [m]."""

_SIDEWAYS: Final = 0.07  # sideways distance from its start at which the card is out of reach [m]
_FACE: Final = 0.0003  # distance from the card's middle plane of a contact on a face [m]
_CORNERS: Final = np.array(list(product((-0.5, 0.5), repeat=3))) * CARD


@dataclass(frozen=True, eq=False)
class CardScorer:
    """Scores task A, card pickup.

    Attributes:
        scene: the scene of the trial.
        over: True once the card has lain over the edge.
        protrusion: distance that the card protrudes beyond the edge [m]; negative on the table.
        pinched: time since which it is pinched and clear of the table [s].
        beyond: True while it lies on the table where no finger can reach it.
        gone: True once it has left the workspace.
        done: True once it was pinched and clear for ``HOLD_S``.
    """

    scene: CardScene
    over: bool = False
    protrusion: float = float("-inf")
    pinched: float | None = None
    beyond: bool = False
    gone: bool = False
    done: bool = False

    @property
    def assessment(self) -> Assessment:
        """Score of the trial if it ended now."""
        if self.gone:
            return Assessment(0.0, "dropped", "the card fell", dropped=True)
        if self.done and self.over:
            return Assessment(1.0, "done", "slid over the edge and pinched", complete=True)
        if self.done:
            return Assessment(
                0.5, "no-edge", "pinched without having gone over the edge", complete=True
            )
        if self.beyond:
            return Assessment(0.0, NOT_DONE, "the card is out of reach", stuck=True)
        if self.pinched is not None:
            return Assessment(0.0, NOT_DONE, "pinched")
        return Assessment(0.0, NOT_DONE, "over the edge" if self.over else "on the table")

    def observe(self, state: SceneState) -> Self:
        """Returns the scorer, updated with a later state of the scene."""
        corners = state.position + _CORNERS @ rotation(state.quaternion).T
        near = float(corners[:, 0].min())
        lies = state.support > 0.0
        pinched = held_since(self.pinched, not lies and pinches(state), state.time)
        start = self.scene.start[0]
        return replace(
            self,
            over=self.over or (lies and near < self.scene.edge - OVER),
            protrusion=self.scene.edge - near,
            pinched=pinched,
            beyond=lies
            and (near > self.scene.reach or abs(float(state.position[1] - start[1])) > _SIDEWAYS),
            gone=self.gone or outside(self.scene, state),
            done=self.done or lasted(pinched, state.time),
        )


def pinches(state: SceneState) -> bool:
    """True if the thumb presses on one face of the card and a finger on the other face."""
    side = np.where(np.abs(state.touch[:, 2]) > _FACE, np.sign(state.touch[:, 2]), 0.0)
    side = np.where(state.force > PRESSES_N, side, 0.0)
    return bool(side[0] != 0 and np.any(side[1:] == -side[0]))


GOAL: Final = np.pi / 2
"""Angle by which the cube is to be turned [rad]."""

TOLERANCE: Final = np.radians(15.0)
"""Accepted deviation from ``GOAL`` [rad]."""

FLAT: Final = np.radians(10.0)
"""Tilt of a face up to which a cube stands flat [rad]."""

_FLIPPED: Final = np.cos(np.radians(45.0))
_CUBE_STILL: Final = 0.3  # largest spin of a cube at rest [rad/s]
_LEANING_S: Final = 1.0  # time after which a leaning cube won't fall flat by itself [s]


@dataclass(frozen=True, eq=False)
class CubeScorer:
    """Scores task B, vertical cube rotation.

    Attributes:
        scene: the scene of the trial.
        turned: rotation about the vertical since the start [rad], counter-clockwise from above.
        flipped: True once another face was up.
        settled: time since which it stands still and flat at the goal [s].
        leaning: time since which it stands still and not flat [s].
        stuck: True while it leans for longer than ``_LEANING_S``.
        gone: True once it has left the workspace.
        done: True once it was settled for ``HOLD_S``.
        last: (3, 3) its rotation at the last state; None before the first.
    """

    scene: CubeScene
    turned: float = 0.0
    flipped: bool = False
    settled: float | None = None
    leaning: float | None = None
    stuck: bool = False
    gone: bool = False
    done: bool = False
    last: Float[np.ndarray, "3 3"] | None = None

    @property
    def assessment(self) -> Assessment:
        """Score of the trial if it ended now."""
        if self.gone:
            return Assessment(0.0, "dropped", "the cube fell", dropped=True)
        if self.done and self.flipped:
            return Assessment(
                0.5, "flipped", "turned, but flipped onto another face", complete=True
            )
        if self.done:
            return Assessment(1.0, "done", "turned by a right angle", complete=True)
        degrees = f"turned by {np.degrees(self.turned):.0f}°"
        if self.stuck:
            return Assessment(0.0, NOT_DONE, f"{degrees}, leaning", stuck=True)
        return Assessment(0.0, NOT_DONE, f"{degrees}, flipped" if self.flipped else degrees)

    def observe(self, state: SceneState) -> Self:
        """Returns the scorer, updated with a later state of the scene."""
        now = rotation(state.quaternion)
        start = rotation(self.scene.start[1])
        upright = float((now @ start.T)[2, 2])
        flipped = self.flipped or upright < _FLIPPED
        before = start if self.last is None else self.last
        turned = self.turned + _about_vertical(now @ before.T)
        if not flipped:  # the heading is well defined and has no drift
            turned += _wrapped(_heading(now @ start.T) - turned)
        lies = state.support > 0.0 and bool(np.abs(now[2]).max() > np.cos(FLAT))
        still = float(np.linalg.norm(state.spin)) < _CUBE_STILL
        right = abs(abs(turned) - GOAL) <= TOLERANCE
        settled = held_since(self.settled, right and lies and still, state.time)
        leaning = held_since(self.leaning, still and not lies, state.time)
        return replace(
            self,
            turned=turned,
            flipped=flipped,
            settled=settled,
            leaning=leaning,
            stuck=lasted(leaning, state.time, _LEANING_S),
            gone=self.gone or outside(self.scene, state),
            done=self.done or lasted(settled, state.time),
            last=now,
        )


def _heading(turn: Float[np.ndarray, "3 3"]) -> float:
    """Twist of a rotation about the vertical axis [rad]."""
    return float(np.arctan2(turn[1, 0] - turn[0, 1], turn[0, 0] + turn[1, 1]))


def _about_vertical(turn: Float[np.ndarray, "3 3"]) -> float:
    """Vertical component of the rotation vector of a small rotation [rad]."""
    skew = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
    sine = float(np.linalg.norm(skew)) / 2
    angle = float(np.arctan2(sine, (np.trace(turn) - 1) / 2))
    return 0.0 if sine < 1e-12 else angle * float(skew[2]) / (2 * sine)


def _wrapped(angle: float) -> float:
    return float((angle + np.pi) % (2 * np.pi) - np.pi)


DOWN: Final = np.radians(10.0)
"""Angle to the vertical up to which the blade points down [rad]."""

CLOSE: Final = np.radians(30.0)
"""Angle to the vertical up to which a trial scores 0.5 [rad]."""

SCREWDRIVER_STILL: Final = 0.5
"""Largest spin of a screwdriver at rest [rad/s]."""


@dataclass(frozen=True, eq=False)
class ScrewdriverScorer:
    """Scores task C, screwdriver pivot.

    Attributes:
        scene: the scene of the trial.
        angle: angle between its blade and straight down [rad].
        held: True while the hand alone holds it.
        pointing: time since which it is held, still, and points down [s].
        gone: True once it fell.
        done: True once it pointed down for ``HOLD_S``.
    """

    scene: ScrewdriverScene
    angle: float = np.pi / 2
    held: bool = False
    pointing: float | None = None
    gone: bool = False
    done: bool = False

    @property
    def assessment(self) -> Assessment:
        """Score of the trial if it ended now."""
        if self.gone:
            return Assessment(0.0, "dropped", "the screwdriver fell", dropped=True)
        if self.done:
            return Assessment(1.0, "done", "points down", complete=True)
        degrees = f"{np.degrees(self.angle):.0f}° from down"
        if not self.held:
            return Assessment(0.0, NOT_DONE, f"{degrees}, not held by the hand alone")
        if self.angle <= CLOSE:
            return Assessment(0.5, "nearly", degrees)
        return Assessment(0.0, NOT_DONE, degrees)

    def observe(self, state: SceneState) -> Self:
        """Returns the scorer, updated with a later state of the scene."""
        blade = rotation(state.quaternion)[:, 2]
        angle = float(np.arctan2(np.hypot(blade[0], blade[1]), -blade[2]))
        held = held_by_hand(state)
        still = float(np.linalg.norm(state.spin)) < SCREWDRIVER_STILL
        pointing = held_since(self.pointing, held and still and angle <= DOWN, state.time)
        return replace(
            self,
            angle=angle,
            held=held,
            pointing=pointing,
            gone=self.gone or state.support > 0.0 or outside(self.scene, state),
            done=self.done or lasted(pointing, state.time),
        )


_MOST_TRIALS: Final = 1000
_SCORES: Final = (0.0, 0.5, 1.0)


_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]*")


def check_name(name: str, what: str) -> str:
    """Returns a name if it is valid in a table, a file name and a URL; StudyError if the name has
    other characters, or is too long."""
    if not _NAME.fullmatch(name) or len(name) > 64:
        raise StudyError(
            f"{what} {name!r}: use up to 64 letters, digits, '_', '.' and '-', starting with "
            "a letter or digit"
        )
    return name


def distinct(names: Sequence[str], what: str) -> None:
    """Raises StudyError if a name occurs twice."""
    for name in names:
        if names.count(name) > 1:
            raise StudyError(f"{what} need different names; {name!r} occurs twice")


def whole(value: int, least: int, most: int, what: str) -> None:
    """Raises StudyError unless the value is a whole number in a range."""
    if isinstance(value, bool) or not isinstance(value, int) or not least <= value <= most:
        raise StudyError(f"{what} must be a whole number from {least} to {most}, not {value!r}")


def seconds(value: float, what: str, least: float = 0.0) -> None:
    """Raises StudyError unless the value is a time of up to a day [s]."""
    if not math.isfinite(value) or not least <= value <= 86_400:
        raise StudyError(f"{what} must be {least:g} to 86400 s, not {value}")


@dataclass(frozen=True)
class RubricLine:
    """One possible result of a trial, with its score.

    Attributes:
        name: name of the line in the data.
        score: 0 failed, 0.5 marginal, 1 done.
        text: condition of the line, as the experimenter reads it.
    """

    name: str
    score: float
    text: str = ""

    def __post_init__(self) -> None:
        check_name(self.name, "line of a rubric")
        if self.score not in _SCORES:
            raise StudyError(
                f"line {self.name!r} of a rubric: its score must be 0, 0.5 or 1, not {self.score}"
            )

    def possible(self, resets: int, cap: float) -> bool:
        """True if this line can be the result of a trial.

        Args:
            resets: number of resets; a line whose name ends in ``after-reset`` needs one.
        """
        return self.score <= cap if resets else not self.name.endswith("after-reset")


GENERAL_RUBRIC: Final = (
    RubricLine("done", 1.0, "done as instructed, without a reset"),
    RubricLine("marginal", 0.5, "done, after a reset or with an undesired state on the way"),
    RubricLine("failed", 0.0, "the object was dropped, or the operator gave up"),
)
"""Rubric of a task that has none of its own."""


@dataclass(frozen=True)
class Task:
    """A task that an operator does with the robot hand.

    Attributes:
        name: short name in data and results.
        trials: number of trials in each block.
        operators: number of operators who do it; None for all operators of the study.
        title: title for people.
        instruction: text that is read to the operator.
        time_limit_s: time after which a trial counts as not done [s]; None for no limit.
        rubric: lines by which a trial is scored, at least one for failure and one for success.
    """

    name: str
    trials: int = 10
    operators: int | None = None
    title: str = ""
    instruction: str = ""
    time_limit_s: float | None = None
    rubric: tuple[RubricLine, ...] = GENERAL_RUBRIC

    def __post_init__(self) -> None:
        check_name(self.name, "task")
        whole(self.trials, 1, _MOST_TRIALS, f"task {self.name!r}: trials in a block")
        if self.operators is not None:
            whole(self.operators, 1, 10_000, f"task {self.name!r}: operators")
        if self.time_limit_s is not None:
            seconds(self.time_limit_s, f"task {self.name!r}: time limit", least=1.0)
        distinct([line.name for line in self.rubric], f"lines in the rubric of {self.name!r}")
        scores = {line.score for line in self.rubric}
        if 0.0 not in scores or not scores - {0.0}:
            raise StudyError(
                f"task {self.name!r}: the rubric needs a line that scores 0 and one that scores "
                f"more; it has {sorted(scores)}"
            )

    def line(self, name: str) -> RubricLine:
        """Returns the line of the rubric with this name; UnknownNameError if there is none."""
        lines = {line.name: line for line in self.rubric}
        if name not in lines:
            raise UnknownNameError(f"line in the rubric of task {self.name!r}:", name, lines)
        return lines[name]


DROPPED: Final = RubricLine("dropped", 0.0, "the object left the hand's workspace")
GAVE_UP: Final = RubricLine("not-done", 0.0, "the operator gave up, or the time ran out")
AFTER_RESET: Final = RubricLine("done-after-reset", 0.5, "done after the one allowed reset")

COMMON_ENDS: Final = (AFTER_RESET, DROPPED, GAVE_UP)
"""Last lines of the rubrics of most tasks."""

CARD_PICKUP: Final = Task(
    "A",
    title="Card pickup",
    instruction="Slide the flat card over the edge of the platform and pinch it.",
    trials=10,
    operators=12,
    rubric=(
        RubricLine("done", 1.0, "slid over the edge and held in a pinch, without a reset"),
        AFTER_RESET,
        RubricLine(
            "out-of-reach", 0.5, "out of reach or flicked across the top; pinched after a reset"
        ),
        RubricLine("no-edge", 0.5, "pinched and lifted without having gone over the edge"),
        DROPPED,
        GAVE_UP,
    ),
)

CUBE_ROTATION: Final = Task(
    "B",
    title="Vertical cube rotation",
    instruction="Turn the cube by 90 degrees about the vertical axis.",
    trials=10,
    operators=8,
    rubric=(
        RubricLine("done", 1.0, "turned by 90 degrees about the vertical, without a reset"),
        RubricLine(
            "misaligned", 0.5, "turned, after a reset because the faces were badly misaligned"
        ),
        RubricLine("flipped", 0.5, "turned, but the cube flipped onto another face on the way"),
        DROPPED,
        GAVE_UP,
    ),
)

SCREWDRIVER_PIVOT: Final = Task(
    "C",
    title="Screwdriver pivot",
    instruction="Hold the screwdriver in four fingers, loosen the grip until it points down.",
    trials=20,
    operators=6,
    rubric=(
        RubricLine("done", 1.0, "points straight down, still held, without a reset"),
        RubricLine(
            "nearly", 0.5, "points nearly straight down, and the hand can't adjust it further"
        ),
        *COMMON_ENDS,
    ),
)

PAPER_TASKS: Final = (CARD_PICKUP, CUBE_ROTATION, SCREWDRIVER_PIVOT)


@dataclass(frozen=True)
class SimulatedTask:
    """A task that the simulation can score.

    Attributes:
        name: name of its scene in ``SCENES``.
        task: the task of the protocol, with its rubric.
        seconds: time limit of a trial [s].
        scorer: makes the scorer of a trial from its scene.
        after_reset: line of the rubric for success after the reset.
        after_stuck: line of the rubric for success after a reset without which the trial could not
            go on.
        moves_wrist: True if the hand must be moved, by an arm or a free wrist.
    """

    name: str
    task: Task
    seconds: float
    scorer: Callable[[Any], Scorer]
    after_reset: str
    after_stuck: str
    moves_wrist: bool = False
