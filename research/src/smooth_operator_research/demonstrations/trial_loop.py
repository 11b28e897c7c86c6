"""A trial in physics: a source of human landmarks, a retargeter, a hand, an object, a score.

The loop is causal: a command depends only on the frames up to its time. The only clock is that of
the simulation, so the same inputs give the same trial on any machine.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Final, Literal, NamedTuple, Protocol

import numpy as np
from jaxtyping import Float

from smooth_operator.errors import ConfigError
from smooth_operator.retargeting.retargeter import Retargeter
from smooth_operator.simulation.scenes.physics import ScenePhysics
from smooth_operator.simulation.scenes.scene import Scene, SceneState
from smooth_operator.simulation.tasks.task import SimulatedTask
from smooth_operator.simulation.tasks.trial import Phase, TaskRun
from smooth_operator.types import HandFrame

RATE_HZ: Final = 100.0
"""Rate of frames, commands and looks at the scene [Hz], unless stated otherwise."""

_FASTEST_HZ: Final = 500.0


class LandmarkSource(Protocol):
    """Gives the landmarks of a human hand during a trial: a recording, a model of a person."""

    def landmarks(
        self, time: float, state: SceneState, physics: ScenePhysics
    ) -> Float[np.ndarray, "21 3"] | None:
        """Hand frame at a moment.

        Args:
            time: time since 'go' [s]; negative in the lead-in.
            physics: the hand and its scene, which must not be changed.

        Returns:
            (21, 3) landmarks [m] in any right-handed frame; None for a dropped frame.
        """
        ...


Commands = Callable[[float, SceneState, ScenePhysics], Float[np.ndarray, " n"] | None]
"""(time since 'go' [s], scene, physics) -> (n,) positions of all joints [rad]; None holds."""

Interventions = Callable[[], Literal["reset", "finish"] | None]
"""Request of the operator at this moment: reset the object, or end the trial."""


class Moment(NamedTuple):
    """State of a trial after one period.

    Attributes:
        state: state of the scene.
        run: the trial.
        command: (n,) last command [rad]; NaN before the first one.
    """

    state: SceneState
    run: TaskRun
    command: Float[np.ndarray, " n"]


@dataclass(frozen=True, eq=False)
class TrialTrace:
    """Record of a trial, frame by frame; the lead-in is left out.

    Attributes:
        times: (t,) arrival time of each frame, since 'go' [s].
        landmarks: (t, 21, 3) landmarks of the human [m]; NaN for dropped frames.
        commands: (t, n) positions that were sent for the frame [rad].
        positions: (t, n) joint positions one period later [rad].
        states: state of the scene one period later.
    """

    times: Float[np.ndarray, " t"]
    landmarks: Float[np.ndarray, "t 21 3"]
    commands: Float[np.ndarray, "t n"]
    positions: Float[np.ndarray, "t n"]
    states: tuple[SceneState, ...]


@dataclass(frozen=True, eq=False)
class TrialResult:
    """Result of a trial.

    Attributes:
        score: 0, 0.5 or 1.
        line: line of the task's rubric.
        reason: short reason for the score.
        seconds: time from 'go' to the end [s].
        ended: ``success``, ``drop``, ``timeout`` (the task's limit), or ``finished`` (the end of
            the source).
        frames: number of frames that the retargeter received since 'go'.
        dropped: number of periods without a frame: it was lost, or the tracker is slower.
        diverged: number of times that the physics diverged and was reset; such a trial is void.
        resets: number of times that the object was put back.
        trace: record of the trial; None unless requested.
    """

    score: float
    line: str
    reason: str
    seconds: float
    ended: str
    frames: int
    dropped: int
    diverged: int
    resets: int
    trace: TrialTrace | None = None


def perform(
    physics: ScenePhysics,
    task: SimulatedTask,
    commands: Commands,
    *,
    seconds: float | None = None,
    rate_hz: float = RATE_HZ,
    lead_s: float = 0.0,
    interventions: Interventions = lambda: None,
) -> Iterator[Moment]:
    """Runs a trial with a source of joint commands.

    In each period, the source sees the scene and gives a command, the physics advances by a period,
    and the scorer sees the scene. Without a lead-in, 'go' is now, with the scene as it is. With a
    lead-in, commands begin ``lead_s`` before 'go', and the object is put at its start at 'go'.

    Args:
        seconds: time after which a running trial is left [s]; None for the task's own limit.
        rate_hz: periods per second [Hz].
        lead_s: duration of the commands before 'go' [s].
        interventions: request of the operator after each command since 'go'; only one reset is
            granted.

    Yields:
        the moment after each period since 'go', until the trial is done or the time is over.
    """
    limit = task.seconds if seconds is None else seconds
    if not (0.0 < rate_hz <= _FASTEST_HZ and limit >= 0.0 and lead_s >= 0.0):
        raise ConfigError(
            f"trial: expected a rate up to {_FASTEST_HZ:g} Hz and times of 0 s or more, not "
            f"{rate_hz} Hz, {limit} s and a lead-in of {lead_s} s"
        )
    period = 1.0 / rate_hz
    lead = round(lead_s * rate_hz)
    last = np.full(len(physics.hand.joint_names), np.nan)
    state = physics.observe()
    run = TaskRun(task, physics.scene)
    for k in range(-lead, int(np.ceil(limit * rate_hz - 1e-6))):
        if k == 0:
            if lead:
                physics.reset_object()
                state = physics.observe()
            run = run.go(physics.time)
        command = commands(k * period, state, physics)
        if command is not None:
            last = command
            physics.command(command)
        wish = interventions() if k >= 0 else None
        if wish == "reset" and run.resets == 0:
            run = run.reset()
            physics.reset_object()
        elif wish == "finish":
            run = run.finish(physics.time)
            yield Moment(state, run, last)
            return
        physics.advance(period)
        state = physics.observe()
        run = run.observe(state)
        if k >= 0:
            yield Moment(state, run, last)
            if run.phase is Phase.DONE:
                return


def retargeted_commands(
    retargeter: Retargeter, source: LandmarkSource, seed: int | None = None
) -> Commands:
    """Commands of a retargeter that follows a source of landmarks, for one trial.

    Args:
        seed: seed of the method's random numbers; None for the retargeter's own.
    """
    state = retargeter.init(seed)

    def commands(
        time: float, scene_state: SceneState, physics: ScenePhysics
    ) -> Float[np.ndarray, " n"] | None:
        nonlocal state
        points = source.landmarks(time, scene_state, physics)
        if points is None:
            return None
        frame = HandFrame(points, time, retargeter.hand.spec.side)
        state, result = retargeter.step(state, frame)
        return result.command.joint_positions

    return commands


def run_trial(
    retargeter: Retargeter,
    scene: Scene,
    task: SimulatedTask,
    source: LandmarkSource,
    *,
    rate_hz: float = RATE_HZ,
    seconds: float | None = None,
    lead_s: float = 0.0,
    seed: int | None = None,
    prepare: Callable[[ScenePhysics], None] | None = None,
    interventions: Interventions = lambda: None,
    trace: bool = False,
) -> TrialResult:
    """Runs a trial with a retargeter and a source of human landmarks.

    A dropped frame repeats the last command. Frames arrive and are retargeted without delay.
    Commands are sent unchanged; the servos keep them within the joints' limits.

    Args:
        rate_hz: rate of frames, commands and looks of the scorer [Hz].
        seconds: end of the source [s], at which the trial is finished as it is; None for the
            task's own limit.
        lead_s: time for which the operator holds the hand before 'go' [s]; frames have negative
            times.
        seed: seed of the method's random numbers; None for the retargeter's own.
        prepare: changes the scene before the trial, such as its friction.
        interventions: requests of the operator; see ``perform``.
        trace: True to record the trial.
    """
    physics = ScenePhysics(retargeter.hand, scene)
    if prepare is not None:
        prepare(physics)
    times: list[float] = []
    landmarks: list[Float[np.ndarray, "21 3"]] = []

    class Seen(LandmarkSource):
        def landmarks(
            self, time: float, state: SceneState, physics: ScenePhysics
        ) -> Float[np.ndarray, "21 3"] | None:
            points = source.landmarks(time, state, physics)
            if time >= 0.0:
                times.append(time)
                landmarks.append(np.full((21, 3), np.nan) if points is None else points)
            return points

    commands = retargeted_commands(retargeter, Seen(), seed)
    positions, moments = [], []
    run = TaskRun(task, scene)
    for moment in perform(
        physics,
        task,
        commands,
        seconds=seconds,
        rate_hz=rate_hz,
        lead_s=lead_s,
        interventions=interventions,
    ):
        run = moment.run
        if trace:
            moments.append(moment)
            positions.append(physics.positions)
    if run.phase is Phase.READY:
        run = run.go(physics.time)
    if run.phase is Phase.RUNNING:
        run = run.finish(physics.time)
    outcome = run.outcome
    assert outcome is not None  # it is done
    dropped = int(np.isnan([points[0, 0] for points in landmarks]).sum())
    result = TrialResult(
        outcome.score,
        outcome.line,
        outcome.reason,
        outcome.seconds,
        outcome.ended,
        len(times) - dropped,
        dropped,
        physics.resets,
        outcome.resets,
    )
    if not trace:
        return result
    joints = len(retargeter.hand.joint_names)
    return replace(
        result,
        trace=TrialTrace(
            np.array(times),
            np.array(landmarks).reshape(-1, 21, 3),
            np.array([moment.command for moment in moments]).reshape(-1, joints),
            np.array(positions).reshape(-1, joints),
            tuple(moment.state for moment in moments),
        ),
    )
