"""A trial in simulation on disk: what the scene showed, what was told, what it came to.

One ``.npz`` for each trial, which opens without unpickling and scores again the same
(:func:`~smooth_operator.study.tasks.run.rescore`).
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np
from jaxtyping import Float

from smooth_operator.errors import StudyError
from smooth_operator.recording.atomic import atomic_write, output_error
from smooth_operator.sinks.scenes.state import SceneState
from smooth_operator.study.tasks.run import Outcome

_STATE: Final = (
    "time", "position", "quaternion", "velocity", "spin", "force", "touch", "palm", "support",
    "placed", "fixed", "starts",
)  # fmt: skip


@dataclass(eq=False)
class TrialRecord:
    """A trial, as it goes on.

    Attributes:
        task: its name.
        hand: the robot hand's name.
        side: its side.
        joint_names: (n,) of :attr:`positions`.
        states: what the scene showed, in order.
        positions: (n,) where the hand's joints were at each of them [rad].
        events: (time, ``go``, ``reset`` or ``finish``), by the scene's clock [s].
        outcome: what it came to.
        about: what else is to stand beside it: operator, condition, number.
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
        """One more moment."""
        self.states.append(state)
        self.positions.append(positions)


def write_trial(path: str | Path, record: TrialRecord) -> None:
    """Write a trial, whole or not at all.

    Raises:
        OutputError: the file can't be written.
    """
    columns = {name: np.array([getattr(state, name) for state in record.states]) for name in _STATE}
    head = {
        "task": record.task, "hand": record.hand, "side": record.side, "about": record.about,
        "outcome": None if record.outcome is None else asdict(record.outcome),
    }  # fmt: skip
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
    """Read a trial back.

    Raises:
        StudyError: the file is not a trial.
    """
    try:
        with np.load(path, allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
        head = json.loads(str(arrays["trial"]))
        states = list(_states(arrays))
        outcome = None if head["outcome"] is None else Outcome(**head["outcome"])
        return TrialRecord(
            head["task"], head["hand"], head["side"],
            tuple(str(name) for name in arrays["joint_names"]), states,
            list(arrays["joint_positions"]),
            [(float(t), str(w)) for t, w in
             zip(arrays["event_times"], arrays["event_words"], strict=True)],
            outcome, head["about"],
        )  # fmt: skip
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise StudyError(
            f"{str(path)!r} can't be read as a trial in simulation: {error}; "
            "expected an .npz that a task's session wrote"
        ) from error


def _states(arrays: dict[str, np.ndarray]) -> Iterator[SceneState]:
    rows: Sequence[np.ndarray] = [arrays[name] for name in _STATE]
    scalars = {
        "time": float,
        "palm": float,
        "support": float,
        "placed": bool,
        "fixed": bool,
        "starts": int,
    }
    for row in zip(*rows, strict=True):
        values = {
            name: scalars[name](value) if name in scalars else np.asarray(value)
            for name, value in zip(_STATE, row, strict=True)
        }
        yield SceneState(**values)  # type: ignore[arg-type]
