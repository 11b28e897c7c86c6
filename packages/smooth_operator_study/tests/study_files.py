"""Good files of a study, how each is damaged, and what reads it; as ``hostile_files``."""

import json
from pathlib import Path

import fuzzing
from hostile_files import Seeds

from smooth_operator_study.data.reading import read_study
from smooth_operator_study.design.plan import make_plan
from smooth_operator_study.design.plan_file import plan_text, read_plan
from smooth_operator_study.design.protocol import Condition, Protocol, Task


def plan(path: Path) -> None:
    plan_text(read_plan(path))


def study(path: Path) -> None:
    read_study([path])


TRIALS = "operator,task,retargeter,block,trial_in_block,trial_global,score,time_s\n" + "".join(
    f"P{o},A,{r},{b},{t},{2 * (b - 1) + t},{t % 2},{3.5 + t}\n"
    for o in range(3)
    for b, r in ((1, "sbr"), (2, "dexpilot"))
    for t in (1, 2)
)


def _study_json() -> bytes:
    lines = [line.split(",") for line in TRIALS.split()]
    rows = [dict(zip(lines[0], row, strict=True)) | {"block": int(row[3])} for row in lines[1:]]
    return json.dumps(
        {
            "trials": rows,
            "simulation_metrics": [{"operator": "P0", "retargeter": "sbr", "jitter": 0.5}],
        }
    ).encode()


def _plan() -> bytes:
    conditions = tuple(map(Condition, ("sbr", "dexpilot")))
    return plan_text(
        make_plan(Protocol("s", conditions, (Task("A", trials=3),), "sbr", 4))
    ).encode()


def seeds() -> Seeds:
    """Good files of the readers of this module."""
    return {
        "plan": [("study.toml", _plan(), fuzzing.damaged_table)],
        "study": [
            ("trials.csv", TRIALS.encode(), fuzzing.damaged_table),
            ("study.json", _study_json(), fuzzing.damaged_json),
        ],
    }
