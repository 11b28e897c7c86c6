"""The study's three tasks in simulation: rubric, score, trial, record."""

from smooth_operator.simulation.tasks.scorer import Scorer, Standing
from smooth_operator.simulation.tasks.task_registry import TASKS, SimulatedTask, task_named
from smooth_operator.simulation.tasks.task_session import TaskSession
from smooth_operator.simulation.tasks.trial import Outcome, Phase, TaskRun, rescore
from smooth_operator.simulation.tasks.trial_record import TrialRecord, read_trial, write_trial

__all__ = [
    "TASKS",
    "Outcome",
    "Phase",
    "Scorer",
    "SimulatedTask",
    "Standing",
    "TaskRun",
    "TaskSession",
    "TrialRecord",
    "read_trial",
    "rescore",
    "task_named",
    "write_trial",
]
