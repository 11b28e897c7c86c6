"""How long an operator's session will still take, roughly, and when a break is due."""

from __future__ import annotations

from collections import Counter
from typing import Final

from smooth_operator.study.store.progress import Progress

TRIAL_S: Final = 40.0
"""A trial whose length nobody knows yet [s]."""
BETWEEN_S: Final = 15.0
"""From the end of a trial to the start of the next [s]."""
QUESTIONNAIRE_S: Final = 60.0
"""Six scales, or the fifteen pairs [s]."""
BLOCK_S: Final = 60.0
"""Switching, explaining [s]."""


def time_left(progress: Progress) -> float:
    """What an operator's remaining blocks will take [s], by how long the trials took so far."""
    protocol = progress.plan.protocol
    scored = [trial for trial in progress.trials if trial.counts]
    times = [trial.time_s for trial in scored if trial.time_s is not None]
    done = Counter((trial.block.task.name, trial.block.number) for trial in scored)
    asked = Counter((q.block.task.name, q.block.number) for q in progress.questionnaires)
    left, blocks = 0.0, 0
    for block in progress.blocks:
        if progress.over or progress.finished(block):
            continue
        key = (block.task.name, block.number)
        limit = block.task.time_limit_s
        guess = TRIAL_S if limit is None else min(TRIAL_S, limit / 2)
        trial_s = sum(times) / len(times) if times else guess
        left += (block.task.trials - done[key]) * (trial_s + BETWEEN_S)
        left += (len(block.questionnaires) - asked[key]) * QUESTIONNAIRE_S
        left += QUESTIONNAIRE_S * (protocol.weights and bool(block.questionnaires))
        if not done[key]:
            left += protocol.familiarisation_s + BLOCK_S
            blocks += 1
    every = protocol.break_every
    return left + (protocol.break_s * (blocks // every) if every else 0.0)


def break_is_due(progress: Progress) -> bool:
    """Whether the plan offers a break now: between blocks, and there was none since the last."""
    every = progress.plan.protocol.break_every
    finished = sum(progress.finished(block) for block in progress.blocks)
    if progress.step.what not in ("calibrate", "start_block") or not every or not finished:
        return False
    last = progress.trials[-1].started if progress.trials else None
    rested = bool(progress.breaks) and (last is None or progress.breaks[-1][0] > last)
    return finished % every == 0 and not rested
