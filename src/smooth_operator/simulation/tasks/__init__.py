"""The study's three tasks in simulation: rubrics, scorers, trials, records."""

from smooth_operator.simulation.tasks.task import (
    TASKS,
    Assessment,
    Scorer,
    SimulatedTask,
    task_named,
)
from smooth_operator.simulation.tasks.task_session import TaskSession
from smooth_operator.simulation.tasks.trial import (
    Outcome,
    Phase,
    TaskRun,
    TrialRecord,
    read_trial,
    rescore,
    write_trial,
)

__all__ = [
    "TASKS",
    "Assessment",
    "Outcome",
    "Phase",
    "Scorer",
    "SimulatedTask",
    "TaskRun",
    "TaskSession",
    "TrialRecord",
    "read_trial",
    "rescore",
    "task_named",
    "write_trial",
]
