"""Retargeters that never or always succeed: exact bounds and exact tests in place of a model.

Their odds are zero or infinite, so they have no logistic model. Instead they have:

- A bound, with each operator as one observation, whatever the correlation of their trials. If none
  of G operators succeeds, the share of operators who do is at most 1 - 0.05^(1/G). So is the
  success rate, since an operator's rate is at most the probability of one success or more.
- A test. If two retargeters are equally good, swapping them in the trials of one operator is
  equally likely. For a retargeter that never succeeds, every swap with an effect makes the sum of
  the operators' differences less extreme. The exact two-sided p over all 2^G swaps is 2^(1-k),
  where k operators differ (sign test).
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from smooth_operator.study.analysis.frame import Frame, keep_rows
from smooth_operator.study.analysis.results import ExactTest, Separated

_TAIL: Final = 0.05


def split(frame: Frame) -> tuple[Frame | None, dict[str, Separated]]:
    """Splits off the retargeters that never or always succeed.

    Args:
        frame: frame whose outcome is the success of each trial, 0 or 1.

    Returns:
        The rows of the others, None if there are none; and the separated retargeters by name. If
        all trials have one outcome, none is separated.
    """
    count = len(frame.retargeters)
    trials = np.bincount(frame.retargeter, minlength=count)
    wins = np.bincount(frame.retargeter, frame.outcome, minlength=count)
    out = (wins == 0) | (wins == trials)
    if not out.any() or np.ptp(frame.outcome) == 0:
        return frame, {}
    separated = {
        name: _separated(frame, j, count) for j, name in enumerate(frame.retargeters) if out[j]
    }
    rest = ~out[frame.retargeter]
    if not rest.any():
        return None, separated
    return keep_rows(frame, rest), separated


def _separated(frame: Frame, which: int, count: int) -> Separated:
    rows = frame.retargeter == which
    trials, operators = int(rows.sum()), len(np.unique(frame.group[rows]))
    always = bool(frame.outcome[rows].all())

    def bound(units: int) -> float:
        edge = float(_TAIL ** (1 / units))
        return edge if always else 1 - edge

    against = {}
    others = [j for j in range(count) if j != which]
    for other in others:
        test = _swapped(frame, which, other)
        pairs = count * (count - 1) // 2
        name = frame.retargeters[other]
        with_baseline = frame.baseline in (name, frame.retargeters[which])
        against[name] = replace(
            test,
            p_holm=min(1.0, pairs * test.p_raw),
            p_dunnett=min(1.0, len(others) * test.p_raw) if with_baseline else None,
        )
    return Separated(
        rate=float(always),
        trials=trials,
        operators=operators,
        bound=bound(operators),
        bound_if_independent=bound(trials),
        against=against,
    )


def _swapped(frame: Frame, which: int, other: int) -> ExactTest:
    """Tests two retargeters by swaps within operators, over tasks that they did with both."""
    shape = (len(frame.operators), len(frame.tasks), len(frame.retargeters))
    trials, wins = np.zeros(shape), np.zeros(shape)
    np.add.at(trials, (frame.group, frame.task, frame.retargeter), 1)
    np.add.at(wins, (frame.group, frame.task, frame.retargeter), frame.outcome)
    both = (trials[:, :, which] > 0) & (trials[:, :, other] > 0)
    rates = wins / np.maximum(trials, 1)
    apart = np.where(both, rates[:, :, which] - rates[:, :, other], 0.0)
    tasks = both.sum(axis=1)
    of_operators = apart.sum(axis=1)[tasks > 0] / tasks[tasks > 0]
    differing = int(np.count_nonzero(of_operators))
    return ExactTest(
        difference=float(of_operators.mean()) if len(of_operators) else float("nan"),
        operators=len(of_operators),
        differing=differing,
        p_raw=min(1.0, 2.0 ** (1 - differing)),
    )


def in_words(name: str, result: Separated) -> str:
    """Describes a separated retargeter for the warnings."""
    share, side = ("all", "at least") if result.rate else ("none", "at most")
    return (
        f"{name} succeeded in {share} of {result.trials} trials of {result.operators} "
        "operators: it is left out of the model; its success rate is "
        f"{side} {100 * result.bound:.1f} % (exact 95 % bound with operators as units; "
        f"{100 * result.bound_if_independent:.1f} % if all "
        "trials were independent). It is compared by an exact test that swaps retargeters within "
        f"operators: {_tests(result)}"
    )


def _tests(result: Separated) -> str:
    return ", ".join(
        f"{other} p {'=' if test.p_holm >= 1e-4 else '<'} {max(test.p_holm, 1e-4):.2g}"
        for other, test in result.against.items()
    ) + " (times the number of all pairs)"  # fmt: skip
