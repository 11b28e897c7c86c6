"""What a study's plan says reaches its data and its analysis."""

from dataclasses import replace
from typing import Any

import pytest
from study_cases import write_rows

from smooth_operator import SmoothOperatorError, __version__
from smooth_operator.cli import main
from smooth_operator_study.data import read_study
from smooth_operator_study.design.plan import make_plan
from smooth_operator_study.design.plan_file import (
    plan_of,
    plan_table,
    preregistration,
    write_preregistration,
)
from smooth_operator_study.design.protocol import Condition, Protocol, Task


def protocol(**changes: Any) -> Protocol:
    conditions = tuple(Condition(name) for name in ("sbr", "dexpilot"))
    return replace(
        Protocol("two", conditions, (Task("A", trials=3), Task("B", trials=3)), "sbr", 4), **changes
    )


def test_primary_endpoint_and_margins_read_back():
    plan = make_plan(protocol(primary="tlx/B", margins={"success": 0.1, "time": 5}))
    table = plan_table(plan)
    assert table["primary"] == "tlx/B"
    assert plan_of(table, "study.toml") == plan


def test_a_drawn_plan_without_primary_endpoint_had_none():
    table = plan_table(make_plan(protocol()))
    assert table.pop("primary") == "success/pooled"
    assert plan_of(table, "study.toml").protocol.primary == ""
    draft = {key: value for key, value in table.items() if key not in ("orders", "enrolled")}
    assert plan_of(draft, "draft.toml").protocol.primary == "success/pooled"


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"primary": "success"}, "OUTCOME/SCOPE"),
        ({"primary": "speed/pooled"}, "unknown outcome of the primary endpoint"),
        ({"primary": "time/C"}, "unknown scope of the primary endpoint"),
        ({"primary": "tlx/A", "questionnaires": ()}, "needs questionnaires"),
        ({"margins": {"success": 10.0}}, "below 1"),
        ({"margins": {"time": 0.0}}, "above 0"),
        ({"margins": {"speed": 1.0}}, "unknown outcome of a margin"),
    ],
)
def test_endpoints_that_cannot_be(changes, said):
    with pytest.raises(SmoothOperatorError, match=said):
        protocol(**changes)


def rows(**more: Any) -> list[dict[str, object]]:
    return [
        {
            "operator": "P1",
            "task": "A",
            "retargeter": name,
            "block": block,
            "trial_in_block": trial,
            "trial_global": 2 * (block - 1) + trial,
            "score": 0,
            "time_s": "",
            **more,
        }
        for block, name in enumerate(("sbr", "ako", "sbr"), 1)
        for trial in (1, 2)
    ]


def test_further_columns_of_trials(tmp_path):
    more = {"duration_s": 12.5, "line": "dropped", "resets": 1, "started_at": "2026-01-02T03:04:05"}
    trials = read_study([write_rows(tmp_path / "t.csv", rows(**more, place=3, amended=1))]).trials
    assert len(trials) == 6


def test_the_preregistration_says_what_the_plan_commits_to(tmp_path):
    plan = make_plan(protocol(primary="time/B", margins={"success": 0.1}))
    assert write_preregistration(plan, tmp_path) is not None
    text = (tmp_path / "PREREGISTRATION.md").read_text(encoding="utf-8")
    for part in (
        "completion time of successful trials [s], in task B, differs between sbr (baseline) and "
        "dexpilot",
        "success 10 percentage points",
        "the 2 rows of a Williams square",
        f"1. {', '.join(plan.orders[0])}",
        "`success ~ retargeter + task + t`",
        "(1 | operator:retargeter)`, and `(1 | operator:retargeter:task)`",
        "Dunnett, within one outcome and one scope",
        "α = 0.05",
        "ends when 4 operators have completed",
        "1: done as instructed, without a reset",
        "smooth-operator " + __version__,
    ):
        assert part in text, part
    alone = protocol(tasks=(Task("A", trials=3),), questionnaires=(), primary="")
    text = preregistration(make_plan(alone))
    assert "all results are exploratory" in text
    assert "retargeter:task" not in text
    assert "NASA" not in text.split("## Models")[0]


def test_a_preregistration_that_was_completed_stays_beside_a_new_one(tmp_path):
    folder = tmp_path / "study"
    new = ["study", "new", str(folder), "--conditions", "sbr", "ako", "--tasks", "A:3"]
    assert main([*new, "--operators", "2"]) == 0
    file = folder / "PREREGISTRATION.md"
    completed = file.read_text(encoding="utf-8").replace("[Latest date.]", "Until May.")
    file.write_text(completed, encoding="utf-8")
    assert main([*new, "--operators", "2", "--primary", "tlx/A", "--overwrite"]) == 0
    assert "workload" in file.read_text(encoding="utf-8").split("## Design")[0]
    assert (folder / "PREREGISTRATION.before.md").read_text(encoding="utf-8") == completed
