"""Tables of the cross-hand matrix, with intervals over worlds.

The hands are fixed: an interval says what other worlds would change, not what other hands would.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from statistics import median
from typing import Final

import numpy as np
from jaxtyping import Float

from smooth_operator.reporting.drawing import method_label
from smooth_operator.simulation.tasks import TASKS as SIMULATED_TASKS
from smooth_operator_research.cross_hand.matrix import HANDS, METHODS, TASKS, TRACKERS, trial_code
from smooth_operator_research.cross_hand.plans import PLANS
from smooth_operator_research.cross_hand.results import CONTACTS, MatrixResults, Trial
from smooth_operator_research.cross_hand.scenes import SCALED
from smooth_operator_research.cross_hand.trials import CEILING
from smooth_operator_research.paper.experiment import Table
from smooth_operator_research.physics.results import wilson
from smooth_operator_study.analysis.dunnett import holm

DRAWS: Final = 10_000
"""Number of resamples of a bootstrap."""

OLDER: Final = "†"
"""Mark of a cell with trials by older code."""

CANNOT: Final = "can't"
"""Text of a cell whose scene can't be built around the hand."""

Place = tuple[str, str, str]
"""Task, hand and method."""


class Outcomes:
    """All trials of a file, by task, hand and method.

    Args:
        scaled: True for the trials with scaled objects, False for the others.

    Attributes:
        tasks, hands, methods: names in the order of the tables; methods without the ceiling.
        trials: place -> world and tracker -> trial.
        obstacles: place -> reason why the hand can't do the task.
        older: places with trials by older code.
    """

    def __init__(self, results: MatrixResults, *, scaled: bool = False) -> None:
        self.trials: dict[Place, dict[tuple[int, str], Trial]] = {}
        self.obstacles: dict[Place, str] = {}
        self.older: set[Place] = set()
        for (cell, code), row in results.rows.items():
            if cell.task.endswith(SCALED) != scaled:
                continue
            place = (cell.task.removesuffix(SCALED), cell.hand, cell.method)
            if row.obstacle:
                self.obstacles[place] = row.obstacle
            if row.trials:
                own = self.trials.setdefault(place, {})
                own |= {(world, cell.tracker): trial for world, trial in row.trials.items()}
            if code != trial_code(cell.task, cell.hand, cell.method):
                self.older.add(place)
        places = [*self.trials, *self.obstacles]
        self.tasks = _ordered((place[0] for place in places), TASKS)
        self.hands = _ordered((place[1] for place in places), HANDS)
        methods = (place[2] for place in places if place[2] != CEILING)
        self.methods = _ordered(methods, METHODS)

    def of(
        self, task: str | None = None, hand: str | None = None, method: str | None = None
    ) -> Iterator[tuple[int, str, Trial]]:
        """World, tracker and trial of a part of the matrix; None for all."""
        for place, trials in self.trials.items():
            if all(
                part in (None, own) for part, own in zip((task, hand, method), place, strict=True)
            ):
                yield from ((world, tracker, trial) for (world, tracker), trial in trials.items())

    def successes(
        self, task: str, method: str, tracker: str | None = None
    ) -> Float[np.ndarray, "h w"]:
        """(h, w) share of trials with score 1 of each hand in each world; NaN without a trial."""
        worlds = sorted({w for w, own, _ in self.of(task) if tracker in (None, own)})
        shares = np.full((len(self.hands), len(worlds)), np.nan)
        for row, hand in enumerate(self.hands):
            groups: dict[int, list[bool]] = {}
            for world, own, trial in self.of(task, hand, method):
                if tracker in (None, own):
                    groups.setdefault(world, []).append(trial.score == 1.0)
            for world, values in groups.items():
                shares[row, worlds.index(world)] = float(np.mean(values))
        return shares


def _ordered(names: Iterator[str], first: Sequence[str]) -> list[str]:
    """Different names, those of a sequence first and in its order."""
    present = dict.fromkeys(names)
    return [*(n for n in first if n in present), *sorted(n for n in present if n not in first)]


def label(method: str) -> str:
    """Name of a method in tables."""
    return method if method == CEILING else method_label(*method.split(":", 1))


def bootstrap(values: Float[np.ndarray, "h w"], seed: int) -> Float[np.ndarray, " b"]:
    """(b,) resampled means over hands of the means over worlds. Worlds are resampled together for
    all hands, because all hands had the same ones.

    Args:
        values: (h, w) a value for each hand and world; NaN without one.
    """
    count = values.shape[1]
    rng = np.random.default_rng(seed)
    weights = rng.multinomial(count, np.full(count, 1.0 / count), size=DRAWS).astype(float)
    finite = np.isfinite(values)
    with np.errstate(invalid="ignore"):
        means = (weights @ np.nan_to_num(values).T) / (weights @ finite.T)
    return np.asarray(np.nanmean(means[:, finite.any(axis=1)], axis=1))


def mean_over_hands(values: Float[np.ndarray, "h w"]) -> float:
    """Mean over hands of the means over worlds, without hands that have no trial."""
    own = values[np.isfinite(values).any(axis=1)]
    return float(np.nanmean(own, axis=1).mean())


def success_table(outcomes: Outcomes, task: str) -> Table:
    """Share of trials with score 1 by hand and method, with Wilson's interval."""
    ceiling = any(place[0] == task and place[2] == CEILING for place in outcomes.trials)
    methods = [*outcomes.methods, *([CEILING] if ceiling else [])]
    rows = [
        [f"`{hand}`", *(_share(outcomes, (task, hand, method)) for method in methods)]
        for hand in outcomes.hands
    ]
    return Table(task, ["hand", *map(label, methods)], rows)


def _share(outcomes: Outcomes, place: Place) -> str:
    if place in outcomes.obstacles:
        return CANNOT
    trials = outcomes.trials.get(place)
    if not trials:
        return "–"
    good = sum(trial.score == 1.0 for trial in trials.values())
    low, high = wilson(good, len(trials))
    mark = f" {OLDER}" if place in outcomes.older else ""
    return f"{good / len(trials):.2f} [{low:.2f}, {high:.2f}]{mark}"


def means_table(outcomes: Outcomes) -> Table:
    """Mean success over the hands that can do a task, with bootstrap intervals over worlds."""
    rows = [
        [
            name,
            str(_able(outcomes, tasks)),
            *(_success(outcomes, tasks, method) for method in outcomes.methods),
        ]
        for name, tasks in _groups(outcomes)
    ]
    return Table("means", ["task", "hands", *map(label, outcomes.methods)], rows)


def _groups(outcomes: Outcomes) -> list[tuple[str, list[str]]]:
    """Name and tasks of each row of a table: each task alone, then all tasks."""
    return [*((task, [task]) for task in outcomes.tasks), ("all tasks", outcomes.tasks)]


def _success(
    outcomes: Outcomes, tasks: Sequence[str], method: str, tracker: str | None = None
) -> str:
    """Mean success of a method over hands and tasks, with its interval."""
    parts = [outcomes.successes(task, method, tracker) for task in tasks]
    parts = [part for part in parts if np.isfinite(part).any()]
    return _estimate(parts, _draws(parts)) if parts else "–"


def _able(outcomes: Outcomes, tasks: Sequence[str]) -> int:
    """Number of hands with trials in all of some tasks."""
    able = [{hand for own, hand, _ in outcomes.trials if own == task} for task in tasks]
    return len(set.intersection(*able)) if able else 0


def _draws(parts: Sequence[Float[np.ndarray, "h w"]]) -> Float[np.ndarray, " b"]:
    """Resampled means of several tasks."""
    return np.asarray(np.mean([bootstrap(part, seed) for seed, part in enumerate(parts)], axis=0))


def _estimate(
    parts: Sequence[Float[np.ndarray, "h w"]], draws: Float[np.ndarray, " b"], sign: str = ""
) -> str:
    """Mean of several tasks, with its bootstrap interval."""
    low, high = np.percentile(draws, [2.5, 97.5])
    value = np.mean([mean_over_hands(part) for part in parts])
    return f"{value:{sign}.2f} [{low:{sign}.2f}, {high:{sign}.2f}]".replace("-", "−")


def differences_table(outcomes: Outcomes) -> Table:
    """First method minus each other one, paired by hand and world, with Holm's correction over the
    table."""
    groups = [(name, tasks, outcomes.hands) for name, tasks in _groups(outcomes)]
    return _differences("differences", "task", outcomes, groups)


def hands_table(outcomes: Outcomes) -> Table:
    """First method minus each other one on each hand, as mean over tasks, paired by world, with
    Holm's correction over the table."""
    groups = [(f"`{hand}`", outcomes.tasks, [hand]) for hand in outcomes.hands]
    return _differences("hands", "hand", outcomes, groups)


def _differences(
    title: str,
    head: str,
    outcomes: Outcomes,
    groups: Sequence[tuple[str, Sequence[str], Sequence[str]]],
) -> Table:
    """Table of the first method minus each other one, with a row for each name, tasks and hands."""
    first, *others = outcomes.methods
    differences = {
        (task, other): outcomes.successes(task, first) - outcomes.successes(task, other)
        for task in outcomes.tasks
        for other in others
    }
    texts: list[list[str]] = []
    chances: list[float] = []
    for name, tasks, hands in groups:
        chosen = [outcomes.hands.index(hand) for hand in hands]
        texts.append([name])
        for other in others:
            parts = [differences[task, other][chosen] for task in tasks]
            parts = [part for part in parts if np.isfinite(part).any()]
            if not parts:
                texts[-1].append("–")
                continue
            draws = _draws(parts)
            texts[-1].append(_estimate(parts, draws, "+"))
            chances.append(two_sided(draws))
    corrected = iter(holm(chances))
    rows = [
        [
            row[0],
            *(text if text == "–" else f"{text}, p {_chance(next(corrected))}" for text in row[1:]),
        ]
        for row in texts
    ]
    return Table(title, [head, *(f"minus {label(other)}" for other in others)], rows)


def two_sided(draws: Float[np.ndarray, " b"]) -> float:
    """Two-sided p-value of a bootstrap distribution for the hypothesis of no difference."""
    tail = min(int((draws <= 0).sum()), int((draws >= 0).sum()))
    return min(1.0, 2 * (tail + 1) / (len(draws) + 1))


def _chance(p: float) -> str:
    return "< 0.001" if p < 0.001 else f"= {p:.3f}"


def trackers_table(outcomes: Outcomes) -> Table:
    """Mean success over hands by task and tracker."""
    trackers = _ordered((own for _, own, _ in outcomes.of() if own), TRACKERS)
    rows = [
        [
            name,
            tracker,
            *(_success(outcomes, tasks, method, tracker) for method in outcomes.methods),
        ]
        for name, tasks in _groups(outcomes)
        for tracker in trackers
    ]
    return Table("trackers", ["task", "tracker", *map(label, outcomes.methods)], rows)


def _by_task(outcomes: Outcomes, title: str, text: Callable[[list[Trial]], str]) -> Table:
    """Table with a text for the trials of each task and method, over all hands."""
    rows = [
        [
            task,
            *(
                text([t for *_, t in outcomes.of(task, method=method)])
                for method in outcomes.methods
            ),
        ]
        for task in outcomes.tasks
    ]
    return Table(title, ["task", *map(label, outcomes.methods)], rows)


def times_table(outcomes: Outcomes) -> Table:
    """Median time of successful trials."""

    def text(trials: list[Trial]) -> str:
        times = [trial.seconds for trial in trials if trial.score == 1.0]
        return f"{median(times):.1f} ({len(times)})" if times else "–"

    return _by_task(outcomes, "times", text)


def half_table(outcomes: Outcomes) -> Table:
    """Share of trials with a score of 0.5 or 1."""
    return _by_task(outcomes, "half", _share_of(lambda trial: trial.score >= 0.5))


def preserved_table(outcomes: Outcomes) -> Table:
    """Share of trials whose object was not lost."""
    return _by_task(outcomes, "preserved", _share_of(lambda trial: trial.end != "d"))


def mechanism_table(outcomes: Outcomes) -> Table:
    """Median of the largest position of the moving part, of tasks that have one."""

    def text(trials: list[Trial]) -> str:
        return f"{1e3 * median(t.mechanism for t in trials):.0f}" if trials else "–"

    table = _by_task(outcomes, "mechanism", text)
    moving = {task for task in outcomes.tasks if any(t.mechanism for *_, t in outcomes.of(task))}
    return replace(table, rows=[row for row in table.rows if row[0] in moving])


def _share_of(holds: Callable[[Trial], bool]) -> Callable[[list[Trial]], str]:
    def text(trials: list[Trial]) -> str:
        return f"{np.mean([holds(trial) for trial in trials]):.2f}" if trials else "–"

    return text


def contacts_table(outcomes: Outcomes) -> Table:
    """Contacts in the failed trials of each hand with the first method, as shares."""
    method = outcomes.methods[0]
    rows = []
    for hand in outcomes.hands:
        failed = [t for *_, t in outcomes.of(hand=hand, method=method) if t.score < 1.0]
        counts = Counter(trial.contact for trial in failed)
        shares = [f"{counts[letter] / len(failed):.2f}" if failed else "–" for letter in CONTACTS]
        lost = f"{np.mean([t.end == 'd' for t in failed]):.2f}" if failed else "–"
        rows.append([f"`{hand}`", str(len(failed)), *shares, lost])
    headers = ["hand", "failed trials", "no contact", "thumb only", "fingers only"]
    return Table("contacts", [*headers, "never both", "both at once", "object lost"], rows)


def reasons_table(outcomes: Outcomes) -> Table:
    """Most frequent end of the failed trials of each hand with the first method, by task."""
    method = outcomes.methods[0]
    rows = []
    for hand in outcomes.hands:
        row = [f"`{hand}`"]
        for task in outcomes.tasks:
            obstacle = outcomes.obstacles.get((task, hand, method))
            failed = [t for *_, t in outcomes.of(task, hand, method) if t.score < 1.0]
            reasons = Counter(trial.reason.partition(": ")[2] for trial in failed)
            top = [
                f"{reason} ({count} of {len(failed)})" for reason, count in reasons.most_common(1)
            ]
            row.append(CANNOT if obstacle else top[0] if top else "–")
        rows.append(row)
    return Table("reasons", ["hand", *outcomes.tasks], rows)


def data_table(outcomes: Outcomes) -> Table:
    """Size and origin of the data."""
    trials = list(outcomes.of())
    worlds = {task: len({world for world, _, _ in outcomes.of(task)}) for task in outcomes.tasks}
    cannot = sorted({(task, hand) for task, hand, _ in outcomes.obstacles})
    rows = [
        ["trials", f"{len(trials):,}"],
        ["worlds", ", ".join(f"{task} {count}" for task, count in worlds.items())],
        ["hands", str(len(outcomes.hands))],
        ["methods", ", ".join(f"`{method}`" for method in outcomes.methods)],
        ["hands that can't do a task", ", ".join(f"`{h}` {t}" for t, h in cannot) or "none"],
        ["tasks, hands and methods by older code", f"{len(outcomes.older)}"],
    ]
    return Table("data", ["", ""], rows)


TABLES: Final[dict[str, Callable[[Outcomes], Table]]] = {
    "means": means_table,
    "differences": differences_table,
    "hands": hands_table,
    **{f"success-{task}": lambda o, t=task: success_table(o, t) for task in SIMULATED_TASKS},  # type: ignore[misc]
    "trackers": trackers_table,
    "times": times_table,
    "half": half_table,
    "preserved": preserved_table,
    "mechanism": mechanism_table,
    "contacts": contacts_table,
    "reasons": reasons_table,
    "data": data_table,
}
"""Name of a table in the page -> function that makes it."""

SCALED_TABLES: Final = {
    f"scaled-{name}": TABLES[name]
    for name in ("means", "differences", *(f"success-{task}" for task in PLANS))
}
"""The same for tables of the trials with scaled objects."""
