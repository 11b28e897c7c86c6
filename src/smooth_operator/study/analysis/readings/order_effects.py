"""Reading: period and carry-over. Does the place of a block matter, or the retargeter before it?

The Williams square balances both; here they are estimated, and what was realised is counted.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Float

from smooth_operator.errors import StudyError
from smooth_operator.study.analysis.frame import Frame
from smooth_operator.study.analysis.readings.clusters import WaldTest
from smooth_operator.study.analysis.readings.fits import fit_with
from smooth_operator.study.analysis.readings.parts import Estimate, Refused, found_or_refused
from smooth_operator.study.analysis.results import Outcome
from smooth_operator.study.data.rows import Trials

FIRST = ""
"""The retargeter before an operator's first block of a task."""


@dataclass(frozen=True)
class Balance:
    """How many blocks each retargeter had in each place, and after each other.

    Attributes:
        places: retargeter -> place of the block in the operator's task, from 1 -> blocks.
        after: retargeter -> the one before (none: "") -> blocks.
    """

    places: Mapping[str, Mapping[str, int]]
    after: Mapping[str, Mapping[str, int]]


@dataclass(frozen=True)
class OrderEffects:
    """Differences from the baseline without and with terms of the order.

    Attributes:
        without: as in the results, one by one (no Dunnett).
        with_period: with the block number as a factor, and the trial within the block.
        with_carry_over: with the retargeter of the block before as well.
        period: joint test of the block numbers.
        carry_over: joint test of the retargeters before.
    """

    without: Mapping[str, Estimate]
    with_period: Mapping[str, Estimate]
    with_carry_over: Mapping[str, Estimate] | Refused
    period: WaldTest | Refused
    carry_over: WaldTest | Refused


Blocks = Mapping[tuple[str, str, int], str]
"""(operator, task, block) -> retargeter."""


def blocks_of(trials: Trials) -> Blocks:
    """Which retargeter each block had."""
    keys = zip(trials.operator, trials.task, trials.block, trials.retargeter, strict=True)
    return {(str(who), str(task), int(block)): str(name) for who, task, block, name in keys}


def balance(blocks: Blocks, retargeters: tuple[str, ...]) -> Balance:
    """Counts the blocks.

    Args:
        blocks: of the study.
        retargeters: in the order of the tables.
    """
    last = max((block for _, _, block in blocks), default=0)
    places = {name: {str(k): 0 for k in range(1, last + 1)} for name in retargeters}
    after = {name: dict.fromkeys((FIRST, *retargeters), 0) for name in retargeters}
    for (who, task, block), name in blocks.items():
        places[name][str(block)] += 1
        after[name][blocks.get((who, task, block - 1), FIRST)] += 1
    return Balance(places, after)


def order_effects(
    outcome: Outcome,
    frame: Frame,
    block: np.ndarray,
    before: np.ndarray,
    within: Float[np.ndarray, " n"],
) -> OrderEffects | Refused:
    """Fits without and with the terms.

    Args:
        outcome: decides on the model.
        frame: rows of all tasks or one, the baseline among them.
        block: number of each row's block (n,).
        before: retargeter of the block before, ``FIRST`` where there is none (n,).
        within: trial or questionnaire within the block (n,).
    """
    return found_or_refused(lambda: _effects(outcome, frame, block, before, within))


def _effects(
    outcome: Outcome, frame: Frame, block: np.ndarray, before: np.ndarray, within: np.ndarray
) -> OrderEffects:
    if frame.retargeters[:1] != (frame.baseline,):
        raise StudyError(f"no rows of the baseline, {frame.baseline}")
    without = fit_with(outcome, frame)
    # The index over all blocks is next to a sum of both: within the block takes its place.
    inside = replace(frame, index=np.asarray(within, float))
    numbers = _dummies(block, list(np.unique(block)))
    if not numbers.shape[1]:
        raise StudyError("every operator has one block a task: there is no order")
    period = fit_with(outcome, inside, numbers)
    count = numbers.shape[1]

    def carried() -> tuple[dict[str, Estimate], WaldTest | Refused]:
        previous = _dummies(before, [name for name in frame.retargeters if name in before])
        previous = previous * (before != FIRST)[:, None]
        if not previous.shape[1]:
            raise StudyError("no two retargeters came before others")
        fit = fit_with(outcome, inside, np.column_stack([numbers, previous]))
        last = slice(-previous.shape[1], None)
        return fit.differences(), found_or_refused(lambda: fit.joint(last))

    carry = found_or_refused(carried)
    refused = carry if isinstance(carry, Refused) else None
    return OrderEffects(
        without=without.differences(),
        with_period=period.differences(),
        with_carry_over=refused or carry[0],  # type: ignore[index]
        period=found_or_refused(lambda: period.joint(slice(-count, None))),
        carry_over=refused or carry[1],  # type: ignore[index]
    )


def _dummies(values: np.ndarray, levels: Sequence[Any]) -> Float[np.ndarray, "n q"]:
    """Centred columns of all levels but the first."""
    columns = [(values == level).astype(float) for level in levels[1:]]
    if not columns:
        return np.zeros((len(values), 0))
    found = np.column_stack(columns)
    return np.asarray(found - found.mean(axis=0))
