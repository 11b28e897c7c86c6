"""Simulated studies for tests: the same rows on every machine and with every version of NumPy."""

import csv
import random
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import NormalDist

ITEMS = ("mental", "physical", "temporal", "performance", "effort", "frustration")
POINTS = ("initial", "midpoint", "final")
FOUR = ("dexpilot", "geort", "hybrid", "sbr")

Row = dict[str, object]


@dataclass(frozen=True)
class Case:
    """Trials and questionnaires of a simulated study."""

    trials: list[Row]
    tlx: list[Row]

    def write(self, folder: Path) -> list[Path]:
        folder.mkdir(parents=True, exist_ok=True)
        return [
            write_rows(folder / "trials.csv", self.trials),
            write_rows(folder / "tlx.csv", self.tlx),
        ]


def write_rows(path: Path, rows: Sequence[Row]) -> Path:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
    return path


def simulate(
    seed: int = 0,
    *,
    effect: float = 0.3,
    operators: Sequence[int] = range(12),
    retargeters: Sequence[str] = FOUR,
    spread: float = 0.6,
    alternate: bool = False,
    own: float = 0.0,
    keep: Callable[[int, str, str, int], bool] = lambda operator, task, retargeter, trial: True,
) -> Case:
    """A study with two or three tasks for each operator.

    Args:
        seed: of everything.
        effect: of each further retargeter, on the logit of success, times and workload.
        operators: who takes part.
        retargeters: names.
        spread: of the operators; 0 makes their variance singular, more or less.
        alternate: half of each block's trials succeed, so that trials of an operator are less alike
            than chance has them.
        keep: which trials are there, by operator, task, retargeter and trial.
    """
    draw, tastes = random.Random(seed), random.Random(seed + 1000)

    def normal(source: random.Random = draw) -> float:
        return NormalDist().inv_cdf(min(max(source.random(), 1e-12), 1 - 1e-12))

    trials: list[Row] = []
    tlx: list[Row] = []
    for i in operators:
        skill = [spread * normal() for _ in range(3)]
        suits = {name: [own * normal(tastes) for _ in range(2)] for name in retargeters}
        for task in ("AB", "AC", "ABC")[i % 3]:
            order = sorted(retargeters, key=lambda name: draw.random())
            count = 8 if task == "C" else 6
            done = 0
            for block, name in enumerate(order, 1):
                step = effect * retargeters.index(name)
                common = {"operator": f"P{i:02d}", "task": task, "retargeter": name, "block": block}
                flips = sorted(range(count), key=lambda j: draw.random())
                for trial in range(1, count + 1):
                    done += 1
                    logit = 0.3 + step + skill[0] - 0.3 * (task == "B") - 0.5 * (task == "C")
                    chance = NormalDist().cdf(0.6 * (logit + 0.01 * done))
                    lucky, full, noise = draw.random() < chance, draw.random() < 0.6, normal()
                    won = flips[trial - 1] % 2 == 0 if alternate else lucky
                    liking = 6 * suits[name][0]
                    time = max(2.0, 25 + 5 * step + 6 * skill[1] + liking - 0.1 * done + 6 * noise)
                    if keep(i, task, name, trial):
                        trials.append(
                            common
                            | {
                                "trial_in_block": trial,
                                "trial_global": done,
                                "score": (1 if full else 0.5) if won else 0,
                                "time_s": f"{time:.2f}" if won else "",
                            }
                        )
                for point in POINTS:
                    base = 40 + 8 * step + 12 * skill[2] + 12 * suits[name][1] + 6 * normal()
                    values = [5 * round((base + 8 * normal()) / 5) for _ in ITEMS]
                    bounded = [min(max(value, 0), 100) for value in values]
                    if keep(i, task, name, 1):
                        answers = dict(zip(ITEMS, bounded, strict=True))
                        tlx.append(common | {"point": point} | answers)
    return Case(trials, tlx)


def holes(operator: int, task: str, retargeter: str, trial: int) -> bool:
    """A cell of the design is empty, two operators lack a retargeter, one stopped early."""
    if retargeter == "geort" and task == "B":
        return False
    if operator in (3, 7) and retargeter == "sbr":
        return False
    return not (operator == 5 and trial > 4)
