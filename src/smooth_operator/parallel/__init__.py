"""Runs tasks in parallel, in processes of this machine or on a Ray cluster.

The package is independent of hands: a task is any value that can be pickled.
"""

from smooth_operator.parallel.pool import PersistentPool as PersistentPool
from smooth_operator.parallel.pool import run_tasks as run_tasks
from smooth_operator.parallel.pool import usable_cores as usable_cores
from smooth_operator.parallel.tasks import TaskResult as TaskResult
