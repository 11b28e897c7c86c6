"""A group of work at which a worker dies."""

import os
import signal
from typing import Any

from test_parallel import needs_signals

from smooth_hand_datasets.pipeline.groups import run_groups


def total(group: tuple[Any, ...]) -> int:
    if "die" in group:
        os.kill(os.getpid(), signal.SIGKILL)
    return len(group)


@needs_signals
def test_a_group_at_which_workers_die_is_split():
    groups = [("a", "b"), ("c", "die", "d"), ("e",)]
    results = run_groups(total, groups, lambda g: [(part,) for part in g], workers=2, retries=0)
    values = {group: (result.value, (result.error or "")[:10]) for group, result in results}
    assert values == {
        ("a", "b"): (2, ""),
        ("e",): (1, ""),
        ("c",): (1, ""),
        ("die",): (None, "WorkerDied"),
        ("d",): (1, ""),
    }
