"""Simulated tasks: their scoring rules (rubrics), scorers, trials and records."""

from smooth_operator.simulation.tasks.catalogue import FIXED_WRIST as FIXED_WRIST
from smooth_operator.simulation.tasks.catalogue import TASKS as TASKS
from smooth_operator.simulation.tasks.catalogue import task_named as task_named
from smooth_operator.simulation.tasks.task import Assessment as Assessment
from smooth_operator.simulation.tasks.task import Scorer as Scorer
from smooth_operator.simulation.tasks.task import SimulatedTask as SimulatedTask
from smooth_operator.simulation.tasks.task_session import TaskSession as TaskSession
from smooth_operator.simulation.tasks.trial import Outcome as Outcome
from smooth_operator.simulation.tasks.trial import Phase as Phase
from smooth_operator.simulation.tasks.trial import TaskRun as TaskRun
from smooth_operator.simulation.tasks.trial import TrialRecord as TrialRecord
from smooth_operator.simulation.tasks.trial import read_trial as read_trial
from smooth_operator.simulation.tasks.trial import rescore as rescore
from smooth_operator.simulation.tasks.trial import write_trial as write_trial
