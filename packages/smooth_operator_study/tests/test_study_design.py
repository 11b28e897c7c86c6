"""Plans of studies: orders are balanced, rows are dealt evenly, files read back as they were."""

import csv
import io
import itertools
import random
import re
from collections import Counter
from dataclasses import replace
from typing import Any

import pytest

from smooth_operator import __version__
from smooth_operator.cli import main
from smooth_operator.errors import SmoothOperatorError, StudyError
from smooth_operator.retargeting.presets import live_presets
from smooth_operator.simulation.tasks.task import PAPER_TASKS
from smooth_operator_study.design.forms import DEFAULT_FORMS
from smooth_operator_study.design.plan import (
    Plan,
    balanced_rows,
    imbalance,
    imbalances,
    make_plan,
    scaled,
    spread_of_rows,
)
from smooth_operator_study.design.plan_file import (
    plan_of,
    plan_table,
    preregistration,
    read_plan,
    write_plan,
    write_preregistration,
)
from smooth_operator_study.design.protocol import Condition, Protocol, RubricLine, Task

PAPERS = ("sbr=sbr:paper", "dexpilot=dexpilot:published", "geort", "hybrid=hybrid:published")
METHODS = ("sbr", "dexpilot", "geort", "hybrid")


def protocol(**changes: Any) -> Protocol:
    conditions = tuple(Condition(name) for name in METHODS)
    made = Protocol("four", conditions, PAPER_TASKS, "dexpilot", 18)
    return replace(made, **changes)


@pytest.mark.parametrize("count", range(2, 10))
def test_squares_are_balanced_for_place_and_carry_over(count):
    """Counted by hand, not by the code under test."""
    rows = balanced_rows(count)
    assert len(rows) == (count if count % 2 == 0 else 2 * count)
    assert all(sorted(row) == list(range(count)) for row in rows)
    for place in range(count):
        assert set(Counter(row[place] for row in rows).values()) == {len(rows) // count}
    follows = Counter(pair for row in rows for pair in itertools.pairwise(row))
    assert set(follows) == set(itertools.permutations(range(count), 2))
    # Each after each other: once in an even square, twice in the two squares of an odd number.
    assert set(follows.values()) == {1 if count % 2 == 0 else 2}


def test_the_papers_study():
    plan = make_plan(protocol())
    assert Counter(task for one in plan.enrolled for task in one.rows) == {"A": 12, "B": 8, "C": 6}
    assert Counter(len(one.rows) for one in plan.enrolled) == {1: 10, 2: 8}
    for task in ("A", "B"):  # 12 and 8 are multiples of four rows: wholly balanced
        orders = [plan.orders[one.rows[task]] for one in plan.enrolled if task in one.rows]
        assert imbalance(orders, plan.protocol.condition_names) == (0, 0)
    assert spread_of_rows(plan.enrolled, "C", 4) == 1  # 6 are not
    assert [note[:6] for note in imbalances(plan)] == ["task C"]
    for one in plan.enrolled:
        assert len(set(one.rows.values())) == len(one.rows)
    blocks = plan.blocks("P01")
    assert [b.number for b in blocks] == [1, 2, 3, 4] * 2
    c = next(b for b in plan.schedule() if b.task.name == "C" and b.number == 3)
    assert (c.trial_global(1), c.trial_global(20)) == (41, 60)
    assert c.questionnaires == {1: "initial", 10: "midpoint", 20: "final"}


@pytest.mark.parametrize("seed", range(12))
def test_uneven_enrolment_is_as_balanced_as_its_numbers_allow(seed):
    rng = random.Random(seed)
    count, operators = rng.randint(2, 7), rng.randint(4, 36)
    tasks = tuple(
        Task(name, operators=rng.randint(operators // 2, operators))
        for name in "ABC"[: seed % 3 + 1]
    )
    tasks = (*tasks, Task("Z"))
    conditions = tuple(Condition(f"c{k}") for k in range(count))
    plan = make_plan(Protocol("any", conditions, tasks, "c0", operators, seed=seed))
    rows = len(plan.orders)
    for task in tasks:
        assert spread_of_rows(plan.enrolled, task.name, rows) <= 1
    if len(tasks) <= rows:
        assert all(len(set(one.rows.values())) == len(one.rows) for one in plan.enrolled)


def test_prefixes_of_a_study_are_balanced_too():
    """Where a study stops early, what was done is as even as it can be."""
    plan = make_plan(protocol(tasks=(Task("A"),), operators=40))
    for stop in range(1, 41):
        assert spread_of_rows(plan.enrolled[:stop], "A", 4) <= 1
    odd = tuple(Condition(name) for name in ("a", "b", "c"))
    six = make_plan(Protocol("odd", odd, (Task("A"),), "a", 12))
    for stop in range(1, 13):
        orders = [six.orders[one.rows["A"]] for one in six.enrolled[:stop]]
        most = 0 if stop % 6 == 0 else 2
        assert max(imbalance(orders, "abc")) <= most


def test_those_who_come_later_get_the_least_used_row():
    plan = make_plan(protocol())
    later = plan.enrol("X1", ["C"]).enrol("X2", ["C"])
    assert spread_of_rows(later.enrolled, "C", 4) == 0
    assert later.enrolled[:18] == plan.enrolled
    done = later.enrol("P09", ["B"])  # a further task for one who has begun
    rows = done.enrolment("P09").rows
    assert list(rows) == [*plan.enrolment("P09").rows, "B"]
    assert len(set(rows.values())) == len(rows)
    left = done.withdraw("X1")
    gap = {one.rows["C"] for one in later.enrolled if one.code == "X1"}
    assert {left.enrol("X3", ["C"]).enrolment("X3").rows["C"]} == gap
    with pytest.raises(StudyError, match="does B already"):
        done.enrol("P09", ["B"])


def test_more_tasks_than_rows_share_rows_evenly():
    two = (Condition("a"), Condition("b"))
    tasks = tuple(Task(name) for name in "ABCDE")
    plan = make_plan(Protocol("two", two, tasks, "a", 8))
    for task in tasks:
        assert spread_of_rows(plan.enrolled, task.name, 2) <= 1
    assert all(set(one.rows.values()) == {0, 1} for one in plan.enrolled)


def test_tasks_come_in_balanced_orders_or_as_listed():
    tasks = tuple(Task(name) for name in "ABC")
    plan = make_plan(protocol(tasks=tasks, operators=12))
    orders = Counter(tuple(one.rows) for one in plan.enrolled)
    assert len(orders) == 6
    assert set(orders.values()) == {2}
    listed = make_plan(protocol(tasks=tasks, operators=12, task_order="listed"))
    assert {tuple(one.rows) for one in listed.enrolled} == {("A", "B", "C")}


def test_the_seed_decides_and_nothing_else():
    assert make_plan(protocol()) == make_plan(protocol())
    others = {make_plan(protocol(seed=seed)).orders for seed in range(8)}
    assert len(others) > 4
    # Fixed for all time: a study that has begun must not be dealt anew by a later version.
    plan = make_plan(protocol())
    assert plan.orders[0] == ("hybrid", "sbr", "geort", "dexpilot")
    assert dict(plan.enrolment("P01").rows) == {"B": 3, "A": 1}
    assert [c.label for c in plan.protocol.conditions] == ["Pine", "Oak", "Holly", "Maple"]


def test_labels_tell_nothing():
    many = tuple(Condition(f"m{k}") for k in range(25))
    plan = make_plan(Protocol("many", many, (Task("A"),), "m0", 4))
    labels = [c.label for c in plan.protocol.conditions]
    assert len(set(labels)) == 25
    assert labels != sorted(labels)
    own = make_plan(protocol(conditions=(Condition("sbr", label="Oak"), Condition("dexpilot"))))
    assert own.protocol.condition("sbr").label == "Oak"
    assert own.protocol.condition("dexpilot").label not in ("", "Oak")


@pytest.mark.parametrize("operators", [1, 3, 5, 7, 11, 29, 90])
def test_a_design_is_scaled_in_its_shares(operators):
    halves = protocol(tasks=(Task("A", operators=9), Task("B", operators=9)))
    for design in (protocol(), halves):
        made = scaled(design, operators)
        make_plan(made)
        for task, was in zip(made.tasks, design.tasks, strict=True):
            assert abs(made.planned(task) - design.planned(was) * operators / 18) <= 1


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"conditions": (Condition("sbr"),)}, "at least two conditions; it has 1"),
        ({"conditions": (Condition("dexpilot"),) * 2}, "'dexpilot' occurs twice"),
        ({"baseline": "dexpilo"}, "Did you mean 'dexpilot'"),
        ({"tasks": ()}, "needs at least one task"),
        ({"operators": 5}, "for 12 operators, but the study has 5"),
        ({"operators": 90}, "the tasks take only 26"),
        ({"operators": True}, "whole number"),
        ({"familiarisation_s": float("nan")}, "familiarisation must be 0 to 86400 s"),
        ({"reset_cap": 0.7}, "must be 0, 0.5 or 1"),
        ({"name": " "}, "needs a name"),
        ({"seed": -1}, "0 or more"),
        ({"tasks": (Task("A", trials=2),)}, "would both follow trial 1"),
    ],
)
def test_protocols_that_can_not_be(changes, says):
    with pytest.raises(SmoothOperatorError, match=says):
        protocol(**changes)


@pytest.mark.parametrize("name", ["", "a b", "ä", "../x", "-x", "x" * 65, "a,b"])
def test_names_that_can_not_be(name):
    for made in (Condition, Task):
        with pytest.raises(StudyError, match="letters, digits"):
            made(name)


def test_rubrics_need_failure_and_success():
    with pytest.raises(StudyError, match="a line that scores 0"):
        Task("A", rubric=(RubricLine("done", 1.0, "done"),))
    with pytest.raises(StudyError, match=r"0, 0.5 or 1, not 0.7"):
        RubricLine("nearly", 0.7, "nearly")


def test_a_plan_reads_back_as_it_was(tmp_path):
    odd = Task("T-1.x", trials=7, time_limit_s=90.0, title='Say "hm" \\ 手', instruction="n")
    made = protocol(
        tasks=(odd, *PAPER_TASKS),
        name='quoted "x"',
        break_s=0.0,
        primary="tlx/B",
        margins={"success": 0.1, "time": 5},
    )
    plan = make_plan(made).enrol("late_1", ["A"])
    assert read_plan(write_plan(plan, tmp_path)) == plan
    assert read_plan(tmp_path) == plan
    assert plan_of(plan_table(plan), "x") == plan


def test_a_short_file_is_enough(tmp_path):
    file = tmp_path / "draft.toml"
    file.write_text(
        'format = 1\nname = "short"\nbaseline = "a"\noperators = 4\n'
        "[conditions.a]\n[conditions.b]\nmethod = 'sbr'\npreset = 'paper'\n[tasks.T]\ntrials = 5\n"
    )
    plan = read_plan(file)
    assert len(plan.enrolled) == 4
    assert plan.protocol.condition("b").preset == "paper"
    assert plan.protocol.familiarisation_s == 120.0


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (("format = 1", "format = 2"), "from a newer version"),
        (("operators = 18", 'operators = "18"'), "operators: expected a whole number, not '18'"),
        (("seed = 0", "sead = 0"), "sead: no such entry. Did you mean 'seed'"),
        (("trials = 10", "trials = 0"), "from 1 to 1000, not 0"),
        (("score = 1.0", "score = 0.9"), "must be 0, 0.5 or 1"),
        (('["hybrid", "sbr"', '["hybrid", "hybrid"'), "row 1 of the orders must hold each"),
        (("P01 = { B = 4", "P01 = { B = 9"), "there is no row 9; the plan has rows 1 to 4"),
        (("P01 = { B = 4", "P01 = { D = 4"), "unknown task 'D'"),
        (('baseline = "dexpilot"', 'baseline = "pilot"'), "unknown baseline 'pilot'"),
        (("[orders]", "[order]"), "order: no such entry"),
        (('"midpoint", "final"', '"lunch"'), "expected some of initial, midpoint, final"),
        (('task_order = "balanced"', 'task_order = "any"'), "'balanced' or 'listed', not 'any'"),
        (("familiarisation_s = 120.0", "familiarisation_s = inf"), "finite number"),
        (("format = 1", "format = = 1"), "not well-formed TOML"),
    ],
)
def test_what_is_wrong_in_a_file_is_named(tmp_path, change, says):
    file = write_plan(make_plan(protocol()), tmp_path)
    text = file.read_text()
    assert change[0] in text
    file.write_text(text.replace(*change, 1))
    with pytest.raises(SmoothOperatorError, match=says) as refused:
        read_plan(file)
    assert "study.toml" in str(refused.value)


def test_files_that_are_none(tmp_path):
    with pytest.raises(StudyError, match="study new"):
        read_plan(tmp_path)
    (tmp_path / "study.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(StudyError, match="not text in UTF-8"):
        read_plan(tmp_path)


def test_unbalanced_orders_of_a_file_are_pointed_out():
    plan = make_plan(protocol())
    lame = Plan(plan.protocol, plan.orders[:3])
    assert any("not a balanced Latin square" in note for note in imbalances(lame))


def run(*arguments: str) -> int:
    return main(["study", *arguments])


def test_study_new_writes_plan_and_schedule(tmp_path, capsys):
    folder = tmp_path / "mine"
    conditions = ("--conditions", "mine=sbr:paper", "dexpilot", "ako=ako")
    others = "--tasks pinch:12 A:8:5 --operators 7 --primary tlx/A --margin tlx=8 --no-forms"
    assert run("new", str(folder), *conditions, *others.split()) == 0
    shown = capsys.readouterr().out
    assert "labels for operators" in shown
    plan = read_plan(folder)
    mine, *others = sorted(plan.protocol.conditions, key=lambda one: one.name != "mine")
    assert (mine.method, mine.preset) == ("sbr", "paper")
    assert {(one.name, one.method, one.preset) for one in others} == {
        ("dexpilot", "dexpilot", None),
        ("ako", "ako", None),
    }
    assert (plan.protocol.primary, plan.protocol.margins) == ("tlx/A", {"tlx": 8.0})
    assert plan.protocol.forms == ()
    assert [plan.protocol.planned(task) for task in plan.protocol.tasks] == [7, 5]
    rows = list(csv.DictReader(io.StringIO((folder / "schedule.csv").read_text())))
    assert len(rows) == (7 + 5) * 3
    assert {row["condition"] for row in rows} == {"mine", "dexpilot", "ako"}
    assert run("enrol", str(folder), "P08", "--tasks", "A") == 0
    assert read_plan(folder).codes[-1] == "P08"
    assert run("new", str(folder)) == 2
    assert "already" in capsys.readouterr().err
    assert run("new", str(tmp_path / "again"), "--from", str(folder / "study.toml")) == 0
    assert read_plan(tmp_path / "again") == read_plan(folder)


def test_study_new_alone_is_the_papers(tmp_path):
    assert run("new", str(tmp_path / "p")) == 0
    plan = read_plan(tmp_path / "p")
    conditions = tuple(map(Condition.of, PAPERS))
    margins = {"success": 0.1, "time": 5.0, "tlx": 10.0}
    assert plan == make_plan(
        protocol(
            name="p", conditions=conditions, rate_hz=30.0, margins=margins, forms=DEFAULT_FORMS
        )
    )
    assert plan.protocol.primary == "success/pooled"
    for condition in plan.protocol.conditions:  # they exist, and are not our own defaults
        published = {"paper", "published"} & set(live_presets()[condition.method])
        assert condition.method == "geort" or condition.preset in published


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["--tasks", "A:many"], "NAME:TRIALS:OPERATORS"),
        (["--conditions", "sbr"], "two conditions"),
        (["--questionnaires", "none", "final"], "can't be combined with others"),
        (["--baseline", "ako"], "unknown baseline"),
        (["--primary", "success"], "OUTCOME/SCOPE"),
        (["--primary", "speed/pooled"], "unknown outcome of the primary endpoint"),
        (["--primary", "time/Z"], "unknown scope of the primary endpoint"),
        (["--primary", "tlx/A", "--questionnaires", "none"], "needs questionnaires"),
        (["--margin", "success"], "OUTCOME=DIFFERENCE"),
        (["--margin", "success=10"], "10 percentage points"),
        (["--margin", "time=0"], "above 0"),
        (["--margin", "speed=1"], "unknown outcome of a margin"),
        (["--margin", "time=3", "--margin", "time=4"], "occurs twice"),
    ],
)
def test_study_new_refuses(tmp_path, arguments, says, capsys):
    assert run("new", str(tmp_path / "p"), *arguments) == 2
    assert says in capsys.readouterr().err
    assert not (tmp_path / "p").exists()


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (["--tasks", "A:10", "--operators", "6"], r"that this design can reach is \de-\d+ in all"),
        (
            ["--tasks", "A:10", "B:10", "--operators", "8"],
            "in all tasks, .* in task A, .* in task",
        ),
        (["--tasks", "A:3", "--operators", "2"], "can't become significant in all"),
    ],
)
def test_study_new_says_the_least_p_of_the_design(tmp_path, options, says, capsys):
    options = ["--conditions", "sbr", "dexpilot", "hybrid", *options]
    assert main(["study", "new", str(tmp_path / "study"), *options]) == 0
    assert re.search(says, capsys.readouterr().out)


# What a plan commits to.


def two_tasks(**changes: Any) -> Protocol:
    conditions = tuple(Condition(name) for name in ("sbr", "dexpilot"))
    tasks = (Task("A", trials=3), Task("B", trials=3))
    return replace(Protocol("two", conditions, tasks, "sbr", 4), **changes)


def test_a_drawn_plan_without_primary_endpoint_had_none():
    table = plan_table(make_plan(two_tasks()))
    assert table.pop("primary") == "success/pooled"
    assert plan_of(table, "study.toml").protocol.primary == ""
    draft = {key: value for key, value in table.items() if key not in ("orders", "enrolled")}
    assert plan_of(draft, "draft.toml").protocol.primary == "success/pooled"


def test_the_preregistration_says_what_the_plan_commits_to(tmp_path):
    plan = make_plan(two_tasks(primary="time/B", margins={"success": 0.1}))
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
    alone = two_tasks(tasks=(Task("A", trials=3),), questionnaires=(), primary="")
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
