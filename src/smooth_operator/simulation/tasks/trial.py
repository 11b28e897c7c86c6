"""A trial of a task, as an immutable value, and its record on disk.

A trial lasts from 'go' to success, a lost object or the time limit. Its only clock is that of the
scene's states, so scoring a recorded trial again gives the same score (``rescore``). A record is
one ``.npz`` file, which can be read without unpickling.
"""

from __future__ import annotations

import enum
import json
import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, Final, Self

import numpy as np
from jaxtyping import Float

from smooth_operator.atomic_files import atomic_write, output_error
from smooth_operator.errors import SmoothOperatorError, StudyError, brief, listed
from smooth_operator.formats.arrays import StoredArrays, open_arrays
from smooth_operator.io.documents import parse_json
from smooth_operator.simulation.scenes.scene import Scene, SceneState
from smooth_operator.simulation.tasks.task import NOT_DONE, Assessment, Scorer, SimulatedTask
from smooth_operator.types import as_side

RESET_CAP: Final = 0.5
"""Highest score of a trial with a reset."""


class Phase(enum.Enum):
    """Phase of a trial, from its start to its end."""

    READY = "ready"
    RUNNING = "running"
    DONE = "done"


@dataclass(frozen=True)
class Outcome:
    """Result of a trial that has ended.

    Attributes:
        score: 0, 0.5 or 1.
        line: line of the task's rubric that gave the score.
        seconds: time from 'go' to the end [s].
        ended: ``success``, ``drop``, ``timeout`` or ``finished`` (by the operator).
        reason: the reason in a few words.
        resets: number of resets of the object.
    """

    score: float
    line: str
    seconds: float
    ended: str
    reason: str
    resets: int


@dataclass(frozen=True, eq=False)
class TaskRun:
    """A trial of a task, as an immutable value.

    Attributes:
        task: the task.
        scene: the scene.
        phase: ready, running or done.
        started: time of its start [s]; NaN before the start.
        resets: number of resets of the object; one is allowed.
        was_stuck: True if only the reset could help.
        scorer: scorer since 'go', or since the reset.
        outcome: result; None until it is done.
    """

    task: SimulatedTask
    scene: Scene
    phase: Phase = Phase.READY
    started: float = float("nan")
    resets: int = 0
    was_stuck: bool = False
    scorer: Scorer | None = None
    outcome: Outcome | None = None

    @property
    def assessment(self) -> Assessment:
        """Score of the trial if it ended now; after a reset, it is at most the cap."""
        if self.scorer is None:
            return Assessment(0.0, NOT_DONE, "ready")
        now = self.scorer.assessment
        if not self.resets or now.score <= RESET_CAP:
            return now
        after = self.task.after_stuck if self.was_stuck else self.task.after_reset
        return replace(now, score=RESET_CAP, line=after)

    def go(self, time: float) -> Self:
        """Returns the trial after its start ('go'); the object must be at its start position.
        StudyError if the trial has started already."""
        if self.phase is not Phase.READY:
            raise StudyError(f"the trial is {self.phase.value}; start a new one")
        scorer = self.task.scorer(self.scene)
        return replace(self, phase=Phase.RUNNING, started=time, scorer=scorer)

    def reset(self) -> Self:
        """Returns the trial after the one reset that it allows; the clock continues. StudyError if
        the trial is not running, or its reset was already used."""
        if self.phase is not Phase.RUNNING:
            raise StudyError(f"the trial is {self.phase.value}; only a running trial can be reset")
        if self.resets:
            raise StudyError("a trial has only one reset, which was already used; finish the trial")
        return replace(
            self,
            resets=1,
            was_stuck=self.assessment.stuck,
            scorer=self.task.scorer(self.scene),
        )

    def observe(self, state: SceneState) -> Self:
        """Returns the trial after a new state of the scene; it ends when complete, lost or out of
        time."""
        if self.phase is not Phase.RUNNING or self.scorer is None:
            return self
        # While the object waits for the hand to leave its place nothing can happen to it.
        run = replace(self, scorer=self.scorer.observe(state)) if state.placed else self
        assessment = run.assessment
        if assessment.complete:
            return run._done(state.time, "success", assessment)
        if assessment.dropped:
            return run._done(state.time, "drop", assessment)
        if state.time - self.started >= self.task.seconds:
            return run._done(state.time, "timeout", assessment)
        return run

    def finish(self, time: float) -> Self:
        """Returns the trial after the operator ended it; StudyError if the trial is not running."""
        if self.phase is not Phase.RUNNING:
            raise StudyError(f"the trial is {self.phase.value}; it can't be finished")
        return self._done(time, "finished", self.assessment)

    def _done(self, time: float, ended: str, assessment: Assessment) -> Self:
        outcome = Outcome(
            assessment.score,
            assessment.line,
            time - self.started,
            ended,
            assessment.reason,
            self.resets,
        )
        return replace(self, phase=Phase.DONE, outcome=outcome)


def rescore(
    task: SimulatedTask,
    scene: Scene,
    states: Iterable[SceneState],
    events: Iterable[tuple[float, str]],
) -> TaskRun:
    """Computes the score of a recorded trial again.

    Args:
        states: recorded states of the scene, in order.
        events: (time, ``go``, ``reset`` or ``finish``) in order. An event applies after the state
            of the same time.
    """
    run, pending = TaskRun(task, scene), list(events)
    for state in states:
        while pending and pending[0][0] < state.time:
            run = _after_event(run, *pending.pop(0))
        run = run.observe(state)
    for time, word in pending:
        run = _after_event(run, time, word)
    return run


def _after_event(run: TaskRun, time: float, word: str) -> TaskRun:
    if word == "go":
        return run.go(time)
    if word == "reset":
        return run.reset()
    if word == "finish":
        return run.finish(time)
    raise StudyError(f"an event of a trial is go, reset or finish, not {word!r}")


_STATE: Final[dict[str, tuple[tuple[int | None, ...], str, Callable[[Any], Any]]]] = {
    "time": ((), "f", float),
    "position": ((3,), "f", np.asarray),
    "quaternion": ((4,), "f", np.asarray),
    "velocity": ((3,), "f", np.asarray),
    "spin": ((3,), "f", np.asarray),
    "force": ((None,), "f", np.asarray),
    "touch": ((None, 3), "f", np.asarray),
    "palm": ((), "f", float),
    "support": ((), "f", float),
    "placed": ((), "b", bool),
    "fixed": ((), "b", bool),
    "starts": ((), "iu", int),
    "mechanism": ((), "f", float),
}
"""Field of a state -> its shape (None for the number of fingers), the kinds of its array, a
conversion.
"""


@dataclass(eq=False)
class TrialRecord:
    """A trial and its record so far.

    Attributes:
        task: name of the task.
        hand: name of the robot hand.
        side: side of the hand.
        joint_names: (n,) names of the joints in ``positions``.
        states: states of the scene, in order.
        positions: (n,) joint positions of the hand at each state [rad].
        events: (time, ``go``, ``reset`` or ``finish``), on the scene's clock [s].
        outcome: result of the trial.
        about: further entries: operator, condition, number.
    """

    task: str
    hand: str
    side: str
    joint_names: tuple[str, ...]
    states: list[SceneState] = field(default_factory=list)
    positions: list[Float[np.ndarray, " n"]] = field(default_factory=list)
    events: list[tuple[float, str]] = field(default_factory=list)
    outcome: Outcome | None = None
    about: dict[str, Any] = field(default_factory=dict)

    def add(self, state: SceneState, positions: Float[np.ndarray, " n"]) -> None:
        """Appends a state of the scene and the joint positions."""
        self.states.append(state)
        self.positions.append(positions)


def write_trial(path: str | Path, record: TrialRecord) -> None:
    """Writes a trial atomically; OutputError if the file can't be written."""
    columns = {name: np.array([getattr(state, name) for state in record.states]) for name in _STATE}
    head = {
        "task": record.task,
        "hand": record.hand,
        "side": record.side,
        "about": record.about,
        "outcome": None if record.outcome is None else asdict(record.outcome),
    }
    try:
        with atomic_write(path) as file:
            np.savez_compressed(
                file,
                **columns,  # type: ignore[arg-type]
                joint_positions=np.array(record.positions).reshape(-1, len(record.joint_names)),
                joint_names=np.array(record.joint_names, dtype=str),
                event_times=np.array([time for time, _ in record.events], float),
                event_words=np.array([word for _, word in record.events], dtype="U8"),
                trial=np.array(json.dumps(head)),
            )
    except OSError as error:
        raise output_error(path, error) from error


def read_trial(path: str | Path) -> TrialRecord:
    """Reads a trial that ``write_trial`` wrote; StudyError if the file is not a trial."""
    try:
        arrays = open_arrays(Path(path))
        head = parse_json(arrays["trial"].text())
        states = list(_states(arrays))
        names = tuple(arrays["joint_names"].texts())
        positions = arrays["joint_positions"].numbers()
        if positions.shape != (len(states), len(names)):
            raise ValueError(
                f"joint_positions must have shape {(len(states), len(names))}, not "
                f"{positions.shape}"
            )
        times, words = arrays["event_times"].numbers(), arrays["event_words"].texts()
        if times.shape != (len(words),) or not np.isfinite(times).all():
            raise ValueError(f"event_times must be {len(words)} finite times")
        return TrialRecord(
            _word(head, "task"),
            _word(head, "hand"),
            as_side(_word(head, "side")),
            names,
            states,
            list(positions),
            list(zip(times.tolist(), words, strict=True)),
            _outcome(head["outcome"]),
            _object(head["about"]),
        )
    except (OSError, SmoothOperatorError, ValueError, KeyError, TypeError) as error:
        what = f"it has no {error}" if isinstance(error, KeyError) else str(error)[:300]
        raise StudyError(
            f"{str(path)!r} can't be read as a simulated trial: {what}; expected an .npz "
            "that a task session wrote"
        ) from error


def _word(head: Any, name: str) -> str:
    if not isinstance(_object(head)[name], str):
        raise ValueError(f"{name} must be text, not {brief(head[name])}")
    return str(head[name])


def _object(value: Any) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise ValueError(f"expected an object, not {brief(value)}")
    return value


def _outcome(value: Any) -> Outcome | None:
    if value is None:
        return None
    kinds = {
        "score": float,
        "line": str,
        "seconds": float,
        "ended": str,
        "reason": str,
        "resets": int,
    }
    if _object(value).keys() != kinds.keys():
        raise ValueError(f"an outcome has {listed(kinds)}, not {listed(value)}")
    for name, kind in kinds.items():
        good = isinstance(value[name], (int, float) if kind is float else kind)
        if not good or isinstance(value[name], bool):
            raise ValueError(f"{name} of the outcome can't be {brief(value[name])}")
    return Outcome(**value)


def _states(arrays: StoredArrays) -> Iterator[SceneState]:
    count = math.prod(arrays["time"].shape)
    fingers = arrays["force"].shape[-1] if arrays["force"].shape else 0
    columns: list[Any] = []
    for name, (shape, kinds, _) in _STATE.items():
        item = arrays[name]
        shape_expected = (count, *(fingers if axis is None else axis for axis in shape))
        # Of a trial that has no moment yet, the arrays have one axis, and numbers of any kind.
        empty = not count and 0 in item.shape
        if not empty and (item.shape != shape_expected or item.dtype.kind not in kinds):
            raise ValueError(
                f"{name} must have shape {shape_expected}, not {item.shape} of {item.dtype}"
            )
        columns.append(item.load())
    for row in zip(*columns, strict=True):
        values = zip(_STATE.items(), row, strict=True)
        yield SceneState(**{name: make(value) for (name, (_, _, make)), value in values})
