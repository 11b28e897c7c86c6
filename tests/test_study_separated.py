"""Retargeters that never or always succeed: exact tests against all swaps, and bounds."""

from itertools import product

import numpy as np
import pytest

from smooth_operator.study.analysis.frame import Frame, make_frame
from smooth_operator.study.analysis.outcomes import separated_in_words, split


def study(wins: dict[str, list[int]], trials: int = 4, tasks: int = 1) -> Frame:
    """How often each operator succeeded with each retargeter in each task."""
    rows = [
        (float(k < count), name, f"T{task}", f"P{i}", k + 1)
        for name, counts in wins.items()
        for i, count in enumerate(counts)
        for task in range(tasks)
        for k in range(trials)
    ]
    columns = [np.array(column) for column in zip(*rows, strict=True)]
    return make_frame(columns[0].astype(float), *columns[1:], baseline="base")


def test_p_is_that_of_all_swaps():
    wins = {"base": [1, 3, 0, 2, 4, 1], "never": [0] * 6, "other": [0, 0, 1, 0, 0, 0]}
    frame = study(wins)
    _, found = split(frame)
    assert list(found) == ["never"]
    for other in ("base", "other"):
        apart = np.array(wins["never"], float) - np.array(wins[other])
        sums = [abs(np.dot(signs, apart)) for signs in product((1, -1), repeat=6)]
        expected = np.mean([s >= abs(apart.sum()) - 1e-12 for s in sums])
        test = found["never"].against[other]
        assert test.p_raw == pytest.approx(expected)
        assert test.difference == pytest.approx(apart.mean() / 4)
    assert found["never"].against["base"].p_dunnett == pytest.approx(2 * 2.0**-4)
    assert found["never"].against["base"].p_holm == pytest.approx(3 * 2.0**-4)
    assert found["never"].against["other"].p_raw == 1.0


def test_the_bound_holds_where_trials_of_an_operator_are_one_and_the_same():
    """Operators always or never succeed: with the true rate at the bound, 5 % of studies show
    none. The bound for independent trials is broken by far more."""
    _, found = split(study({"base": [1] * 10, "never": [0] * 10}, trials=10))
    bound, naive = found["never"].bound, found["never"].bound_if_independent
    assert (1 - bound) ** 10 == pytest.approx(0.05)
    assert (1 - naive) ** 10 > 0.7
    assert naive == pytest.approx(1 - 0.05 ** (1 / 100))


def test_who_lacks_a_task_with_one_of_them_is_compared_where_there_are_both():
    frame = study({"base": [1, 2], "always": [4, 4], "never": [0, 0]}, tasks=2)
    kept = ~((frame.task == 1) & (frame.group == 0) & (frame.retargeter == 0))
    names, operators = np.array(frame.retargeters), np.array(frame.operators)
    part = make_frame(
        frame.outcome[kept], names[frame.retargeter[kept]], np.array(frame.tasks)[frame.task[kept]],
        operators[frame.group[kept]], frame.index[kept], "base",
    )  # fmt: skip
    rest, found = split(part)
    assert rest.retargeters == ("base",)
    assert found["always"].against["base"].difference == pytest.approx((3 / 4 + 2 / 4) / 2)
    assert found["always"].against["never"].difference == 1.0
    assert found["never"].against["always"].p_dunnett is None
    assert "succeeded in all of 16 trials of 2 operators" in separated_in_words(
        "always", found["always"]
    )
    assert "at least 22.4 %" in separated_in_words("always", found["always"])


def test_nothing_is_separated_where_nothing_varies():
    frame = study({"base": [0, 0], "never": [0, 0]})
    assert split(frame) == (frame, {})
