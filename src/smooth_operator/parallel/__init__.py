"""Parallel tasks, on this machine or on a cluster; a task whose worker dies is tried again.

Knows nothing of hands: a task is a value, what is done with it a function.
"""

from smooth_operator.parallel.persistent_pool import PersistentPool as PersistentPool
from smooth_operator.parallel.results import TaskResult as TaskResult
from smooth_operator.parallel.run import run_tasks as run_tasks
from smooth_operator.parallel.run import usable_cores as usable_cores
