"""Who is analysed and why, what a study stores of it, and what the plan decides."""

import csv
import json
from pathlib import Path

import pytest
from study_cases import simulate, write_rows
from study_writers import walk

from smooth_operator.cli import main
from smooth_operator.errors import SmoothOperatorError, StudyError
from smooth_operator.version import __version__
from smooth_operator_study.analysis import analyze_study
from smooth_operator_study.analysis.methods_text import methods_paragraph
from smooth_operator_study.analysis.operators import flow_rows, flow_text, leave_out
from smooth_operator_study.data import StudyData, read_study
from smooth_operator_study.design.plan import make_plan
from smooth_operator_study.design.plan_file import plan_table, write_plan_files
from smooth_operator_study.design.protocol import Condition, Protocol, Task
from smooth_operator_study.store.events import Amended, Recalibrated, TrialVoided, Undone, Withdrawn
from smooth_operator_study.store.export import export_study
from smooth_operator_study.store.study_store import open_study

CODES = ("P01", "P02", "P03", "P04", "P05")


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """P01 has a bad day, P02 and P03 leave, P04 and P05 finish."""
    folder = tmp_path_factory.mktemp("flow") / "study"
    folder.mkdir()
    plan = make_plan(
        Protocol(
            "flow",
            (Condition("sbr"), Condition("dexpilot")),
            (Task("A", trials=2),),
            "sbr",  # not the paper's, which is there, too
            5,
            questionnaires=("final",),
            primary="time/A",
        )
    )
    write_plan_files(plan, folder)
    with open_study(folder, plan) as store:
        walk(store, "P01", "trial")
        store.append("P01", TrialVoided("A", 1, 1, "the robot tripped"))
        walk(store, "P01", "trial")
        store.append("P01", Undone(store.progress("P01").number))
        store.append("P01", Recalibrated("A"))
        walk(store, "P01", "done")
        trial = store.progress("P01").trials[1]
        store.append("P01", Amended("A", 1, trial.number, "failed", 0.0, 9.0, "from film", "AB"))
        walk(store, "P02", "trial")
        walk(store, "P02", "questionnaire")
        store.append("P02", Withdrawn(False, "ill"))
        walk(store, "P03", "questionnaire")
        store.append("P03", Withdrawn(True))
        walk(store, "P04", "done")
        walk(store, "P05", "done")
    return folder


@pytest.fixture(scope="module")
def exported(study: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("export")
    with open_study(study) as store:
        export_study(store, folder)
    return folder


def first_condition(folder: Path) -> str:
    content = json.loads((folder / "study.json").read_text(encoding="utf-8"))
    return str(content["operators"][0]["voided"][0]["retargeter"])


def test_study_json_has_what_departs_from_the_plan(exported):
    content = json.loads((exported / "study.json").read_text(encoding="utf-8"))
    one, two, *_ = content["operators"]
    assert (one["voided"][0]["reason"], one["withdrawn"]) == ("the robot tripped", None)
    assert one["undone"] == {one["voided"][0]["retargeter"]: 1}
    assert one["recalibrations"][0]["task"] == "A"
    (amended,) = one["amendments"]
    assert (amended["after"]["score"], amended["reason"], amended["who"]) == (0, "from film", "AB")
    assert (two["withdrawn"]["keep"], two["withdrawn"]["reason"]) == (False, "ill")


def test_the_tables_of_an_export_bring_the_plan_with_them(exported):
    with (exported / "trials.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    amended = [row for row in rows if row["amended"] == "1"]
    assert [(row["score"], row["duration_s"], row["line"]) for row in amended] == [
        ("0", "9", "failed")
    ]
    assert {row["place"] for row in rows if row["operator"] == "P04"} == {"1", "2"}
    for paths in ([exported], [exported / "trials.csv", exported / "tlx.csv"]):
        data = read_study(paths)
        assert (data.plan.baseline, data.plan.primary) == ("sbr", "time/A")
        assert data.flow.withdrawn["P02"].reason == "ill"
        assert len(data.orders) == 2
    alone = read_study([exported / "study.json"])
    assert alone.flow == data.flow
    assert alone.trials.score.tolist() == data.trials.score.tolist()


def test_who_withdrew_and_wants_to_be_left_out_is_left_out(exported):
    data = leave_out(read_study([exported]), {"P05": "an author"})
    assert set(data.trials.operator) == {"P01", "P03", "P04"}
    assert set(data.questionnaires.operator) <= {"P01", "P03", "P04"}
    flow = data.flow
    assert (flow.enrolled, flow.started) == (CODES, CODES)
    assert (flow.completed, flow.analysed) == (("P01", "P04", "P05"), ("P01", "P03", "P04"))
    where = first_condition(exported)
    other = {"sbr": "dexpilot", "dexpilot": "sbr"}[where]
    for counts in (flow.voids, flow.undone, flow.amended):
        assert counts == {where: 1, other: 0}
    assert flow.recalibrations == 1
    text = flow_text(flow)
    for part in (
        "5 operators enrolled, 5 started, 3 completed",
        "P02 withdrew (ill, data excluded)",
        "P03 withdrew (data kept)",
        "P05 was excluded (an author)",
        "3 were analysed",
    ):
        assert part in text
    rows = {(row["step"], row["retargeter"]): row for row in flow_rows(flow)}
    assert rows["excluded", ""]["reason"] == "an author"
    assert rows["void trials", where]["count"] == 1
    assert leave_out(data).flow == flow


def test_exclusions_that_cannot_be(exported):
    data = read_study([exported])
    for exclude, said in (
        ({"P06": "x"}, "unknown operator to exclude: 'P06'.*Available: P01, P02, P03, P04, P05.$"),
        ({"P05": " "}, "without a reason"),
        (dict.fromkeys(CODES, "all"), "no operators are left"),
    ):
        with pytest.raises(SmoothOperatorError, match=said):
            leave_out(data, exclude)


def test_tables_alone_have_a_flow_of_those_who_are_there(tmp_path):
    data = leave_out(load(tmp_path), {"P01": "pilot"})
    assert (len(data.flow.enrolled), len(data.flow.analysed), data.flow.logged) == (4, 3, False)
    assert flow_text(data.flow) == "P01 was excluded (pilot); 3 were analysed."
    assert {row["step"] for row in flow_rows(data.flow)} == {
        "enrolled",
        "started",
        "excluded",
        "analysed",
    }


def test_the_plan_of_virtual_operators_comes_with_their_tables(tmp_path):
    load(tmp_path)
    conditions = (Condition("sbr"), Condition("dexpilot"))
    plan = make_plan(Protocol("virtual", conditions, (Task("A"),), "sbr", 4))
    about = {"simulated": True, "plan": plan_table(plan)}
    (tmp_path / "simulation.json").write_text(json.dumps(about), encoding="utf-8")
    data = read_study([tmp_path])
    assert data.plan == plan.protocol
    assert not data.flow.logged


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ({"study": {"conditions": {}}}, "study.json, study"),
        ({"operators": [3]}, "'operators' must be a list of objects"),
        ({"operators": [{"withdrawn": {"at": "x"}}]}, "participants are not as study export"),
    ],
)
def test_a_damaged_study_json_next_to_the_tables(content, said, tmp_path):
    load(tmp_path)
    conditions = (Condition("sbr"), Condition("dexpilot"))
    plan = make_plan(Protocol("damaged", conditions, (Task("A"),), "sbr", 4))
    whole = {"study": plan_table(plan), **content}
    (tmp_path / "study.json").write_text(json.dumps(whole), encoding="utf-8")
    with pytest.raises(StudyError, match=said):
        read_study([tmp_path])


def load(folder: Path) -> StudyData:
    case = simulate(3, operators=range(4), retargeters=("dexpilot", "sbr"))
    return read_study([write_rows(folder / "trials.csv", case.trials)])


def test_the_plans_baseline_is_the_analysis_baseline(study, tmp_path, capsys):
    arguments = ["study", "analyze", str(study), "--no-report", "--output"]
    assert main([*arguments, str(tmp_path / "a"), "--exclude", "P05=an author"]) in (0, 1)
    printed = capsys.readouterr().out
    assert "baseline: sbr, as planned. primary endpoint: time/A" in printed
    assert "P05 was excluded (an author)" in printed
    assert "Completion time (primary): " in printed
    results = json.loads((tmp_path / "a" / "results.json").read_text(encoding="utf-8"))
    assert results["study"]["baseline"] == results["study"]["planned_baseline"] == "sbr"
    small = results["small-sample"]
    assert small["time"]["A"]["role"] == "primary"
    assert small["time"]["pooled"]["role"] == small["success"]["A"]["role"] == "exploratory"
    assert results["flow"]["analysed"] == ["P01", "P03", "P04"]
    with (tmp_path / "a" / "flow.csv").open(encoding="utf-8") as file:
        assert {row["step"]: row["count"] for row in csv.DictReader(file)}["analysed"] == "3"
    assert main([*arguments, str(tmp_path / "b"), "--baseline", "dexpilot"]) in (0, 1)
    other = json.loads((tmp_path / "b" / "results.json").read_text(encoding="utf-8"))
    assert (other["study"]["baseline"], other["study"]["planned_baseline"]) == ("dexpilot", "sbr")
    assert (
        "the baseline dexpilot was requested, but that of the plan is sbr"
        in capsys.readouterr().err
    )


def test_without_a_plan_nothing_is_primary(tmp_path):
    found = analyze_study(load(tmp_path))
    assert (found.baseline, found.primary, found.role("success", "pooled")) == (
        "dexpilot",
        None,
        "",
    )


@pytest.mark.parametrize("word", ["P03", "P03=", "=author"])
def test_an_exclusion_needs_a_reason(word, exported, tmp_path, capsys):
    out = tmp_path / "out"
    words = ["study", "analyze", str(exported), "--output", str(out), "--exclude", word]
    assert main(words) == 2
    assert "expected OPERATOR=REASON" in capsys.readouterr().err
    assert not out.exists()


def test_the_methods_paragraph_is_of_the_plan_and_of_the_data(exported):
    found = analyze_study(read_study([exported]), exclude={"P05": "an author"})
    text = methods_paragraph(found)
    for part in (
        "3 operators took part",
        "P02 withdrew (ill, data excluded)",
        "P05 was excluded (an author); 3 were analysed [Schulz2010].",
        "1 trials were void and repeated (",
        "1 trials were corrected afterwards",
        "one of the 2 rows of a Williams square [Williams1949]",
        "120 s of free movement and then trials (A 2)",
        "named in the plan, was completion time (task A); all else is exploratory",
        f"smooth-operator {__version__}",
    ):
        assert part in text, part
    assert "departs from the plan" not in text
    other = methods_paragraph(analyze_study(read_study([exported]), "dexpilot"))
    assert "The planned baseline was sbr; this analysis departs from the plan." in other
