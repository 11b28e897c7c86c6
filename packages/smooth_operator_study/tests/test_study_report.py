"""``smooth-operator study analyze``: what it writes and prints, and how it refuses."""

import contextlib
import csv
import html
import io
import json
import math
import random
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import pytest
from study_cases import Row, simulate, write_rows
from study_writers import small_plan, walk

from smooth_operator.cli import main
from smooth_operator_study.analysis import analyze_study
from smooth_operator_study.analysis.methods_text import CITATIONS
from smooth_operator_study.analysis.report.tables import (
    conclusion,
    number,
    p_equation,
    ratio_rows,
    signed,
    with_minus,
)
from smooth_operator_study.data import read_study
from smooth_operator_study.design.protocol import Condition, Protocol, Task
from smooth_operator_study.store.study_store import open_study

FIGURES = ("success", "time", "tlx-items", "learning", "residuals", "correlations")
NOT_CITED = {"Schulz2010", "Williams1949", "Firth1993", "Heinze2002", "Morel2003"}
"""Works for what this study does not have: a plan, a log, a retargeter that never succeeds."""


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("data")
    simulate(3, operators=range(6)).write(folder)
    metrics: list[Row] = [
        {"operator": f"P{i:02d}", "retargeter": name, "<b>odd & $ö": i - j}
        for i in range(6)
        for j, name in enumerate(("dexpilot", "geort", "hybrid", "sbr"))
    ]
    write_rows(folder / "sim_metrics.csv", metrics)
    return folder


@pytest.fixture(scope="module")
def printed(data: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str, str]:
    """Folder of an analysis, and what the command prints."""
    folder = tmp_path_factory.mktemp("out") / "new" / "folder"
    files = [str(data / "tlx.csv"), str(data / "trials.csv")]
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        assert main(["study", "analyze", *files, "--output", str(folder)]) == 0
    return folder, out.getvalue(), err.getvalue()


@pytest.fixture(scope="module")
def output(printed: tuple[Path, str, str]) -> Path:
    return printed[0]


class Tags(HTMLParser):
    """Whether tags close, and what is loaded from elsewhere."""

    VOID = frozenset({"meta", "br", "path", "use", "image", "rect", "line", "stop", "img"})

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.loaded: list[str] = []
        self.ids: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag not in self.VOID:
            self.open.append(tag)
        for name, value in attrs:
            if name in ("src", "href") and value and not value.startswith(("#", "data:")):
                self.loaded.append(value)
            if name == "id" and value:
                self.ids.append(value)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.handle_starttag(tag, attrs)
        if tag not in self.VOID:
            self.open.pop()

    def handle_endtag(self, tag: str) -> None:
        if tag not in self.VOID:
            assert self.open.pop() == tag


def test_the_page_is_whole_and_needs_nothing_else(output):
    text = (output / "report.html").read_text(encoding="utf-8")
    page = Tags()
    page.feed(text)
    assert page.open == []
    assert page.loaded == []
    assert len(page.ids) == len(set(page.ids))
    assert text.count("<figure") == len(FIGURES)
    assert "&lt;b&gt;odd &amp; $ö" in text  # the name of a metric is text, never markup
    assert "<b>odd" not in text
    assert {c.key for c in CITATIONS if f"[{c.key}]" not in text} == NOT_CITED
    for word in ("small-sample", "paper", "Dunnett", "operators took part", "only 6 operators"):
        assert word in text
    for stem in FIGURES:
        assert (output / "figures" / f"{stem}.png").stat().st_size > 5000
        assert (output / "figures" / f"{stem}.svg").stat().st_size > 2000


def test_tables_hold_the_numbers_of_the_results(output):
    results = json.loads((output / "results.json").read_text(encoding="utf-8"))
    for family in ("coefficients", "emm", "dunnett", "pairs"):
        with (output / f"{family}.csv").open(encoding="utf-8", newline="") as file:
            rows = list(csv.DictReader(file))
        label = {"coefficients": "name", "pairs": "pair"}.get(family, "retargeter")
        count = 0
        for row in rows:
            entry = results[row["mode"]][row["outcome"]][row["scope"]][family][row[label]]
            assert float(row["se"]) == entry["se"]
            count += 1
        expected = sum(
            len(scope[family])
            for mode in ("paper", "small-sample")
            for outcome in results[mode].values()
            for scope in outcome.values()
        )
        assert count == expected > 0
    with (output / "spearman.csv").open(encoding="utf-8", newline="") as file:
        (first, *_) = csv.DictReader(file)
    assert first["metric"] == "<b>odd & $ö"
    assert -1 <= float(first["rho"]) <= 1
    with (output / "learning.csv").open(encoding="utf-8", newline="") as file:
        indices = {row["index"] for row in csv.DictReader(file)}
    assert indices == {"trial_global", "trial_in_block", "tlx_index", "in_block"}
    methods = (output / "methods.txt").read_text(encoding="utf-8")
    assert methods.startswith("6 operators took part")


def verdict(folder: Path) -> list[str]:
    page = (folder / "report.html").read_text(encoding="utf-8")
    (head,) = re.findall(r'<div class="verdict">(.*?)</div>', page, re.DOTALL)
    assert page.index(head) < page.index("<h2>")
    return [html.unescape(line) for line in re.findall(r"<p>(.*?)</p>", head, re.DOTALL)]


def test_the_head_says_what_the_tables_hold(output):
    results = json.loads((output / "results.json").read_text(encoding="utf-8"))
    lines = verdict(output)
    assert len(lines) == 5
    assert all(line.endswith(".") for line in lines)
    assert "each is compared with dexpilot" in lines[0]
    assert "no primary outcome was planned" in lines[0]
    assert not re.search(r"\d (s|points|percentage)\b|[p=<] [=<\d]|[ [(]-\d", "".join(lines))
    for line, outcome, name in zip(
        lines[1:4],
        ("success", "time", "tlx"),
        ("Success", "Completion time", "Workload"),
        strict=True,
    ):
        before, _, part = line.partition(": ")
        assert before == f"{name} (exploratory)"
        shown, _, open_ = part.partition("not shown for " if "not shown for" in part else "(")
        scale, digits = (100, 1) if outcome == "success" else (1, 2)
        for retargeter, one in results["small-sample"][outcome]["pooled"]["dunnett"].items():
            ends = ", ".join(
                f"{scale * one[end]:+.{digits}f}".replace("-", "−") for end in ("lower", "upper")
            )
            where = shown if one["p_dunnett"] < 0.05 else open_
            assert re.search(rf"{retargeter} [+−].*?\[{re.escape(ends)}\]", where)
    assert (
        lines[4]
        .lower()
        .endswith("a difference that is not significant is not evidence of equality.")
    )


def test_the_primary_outcome_of_the_plan_comes_first(data):
    study = replace(
        read_study([data]),
        plan=Protocol(
            name="x",
            conditions=tuple(Condition(name) for name in ("sbr", "dexpilot", "geort", "hybrid")),
            baseline="dexpilot",
            tasks=tuple(Task(name, trials=6) for name in "ABC"),
            operators=6,
            primary="time/A",
            margins={"time": 60.0},
        ),
    )
    lines = conclusion(analyze_study(study))
    assert "the primary outcome is completion time, task A" in lines[0]
    assert [line.partition(":")[0] for line in lines[1:4]] == [
        "Completion time (primary)",
        "Success (exploratory)",
        "Workload (exploratory)",
    ]
    assert lines[4].startswith("Equivalent within the planned 60.00\N{NO-BREAK SPACE}s")


def test_the_page_has_plain_names_and_minus_signs(output):
    page = (output / "report.html").read_text(encoding="utf-8")
    text = re.sub(r"<(style|svg|script)\b.*?</\1>", "", page, flags=re.DOTALL)
    for raw in ("trial_global", "trial_in_block", "tlx_index", "retargetersbr", "taskB"):
        assert raw not in text
    assert "sbr instead of dexpilot" in text
    assert "completion time per trial of the block" in text
    assert not re.search(r"[>( \[]-\d", text)
    assert "p Holm, 24 slopes" in text
    entry = json.loads((output / "results.json").read_text(encoding="utf-8"))["learning"]["A"]
    success = entry["trial_global"]["success"]
    wider = success["ame_se"] * success["se_mancl_derouen"] / success["se"]
    (row,) = re.findall(r"task A: success per trial of the task.*?</tr>", text, re.DOTALL)
    assert f"<td>{100 * wider:.3f}</td>" in row  # the error that goes with the p-value
    main, _, appendix = text.partition('id="published"')
    assert "as published" in appendix
    assert "Do not report it" in appendix
    assert "mode paper" not in main.lower().replace("(mode paper)", "")


def test_numbers_have_a_minus_sign_and_no_negative_zero():
    assert number(-1.25, 1) == "−1.2"
    assert number(-0.0001) == "0.00"
    assert signed(0.001, 1) == "0.0"
    assert signed(2.0, 0) == "+2"
    assert (number(None), number(float("nan")), number(float("-inf"))) == ("–", "–", "−∞")
    assert with_minus("P-1 (-0.5), 1-2, a -3 b-4") == "P-1 (−0.5), 1-2, a −3 b-4"
    assert (p_equation(0.0001), p_equation(0.05)) == ("p < 0.001", "p = 0.050")


def test_the_conclusion_is_printed(printed):
    folder, out, err = printed
    for text in verdict(folder):
        assert text in out
    assert re.search("! success/pooled, .*: only 6 operators", out)
    assert "results.json" in err


def test_refused_parts_give_a_reason_and_status_1(data, tmp_path, capsys):
    case = simulate(3, operators=range(6))
    lost: list[Row] = [
        row | {"score": 0, "time_s": ""} if row["retargeter"] == "geort" else row
        for row in case.trials
    ]
    file = write_rows(tmp_path / "trials.csv", lost)
    out = tmp_path / "out"
    assert main(["study", "analyze", str(file), "--output", str(out)]) == 1
    printed = capsys.readouterr().out
    assert "no questionnaires were given" in printed
    assert "geort succeeded in none of" in " ".join(printed.split())
    text = (out / "report.html").read_text(encoding="utf-8")
    assert "at most 39.3 %" in text  # 1 - 0.05^(1 / 6)
    assert re.search(r"none of \d+ succeeded", text)
    assert (out / "separated.csv").read_text(encoding="utf-8").count("geort") == 4 * 2
    assert "no questionnaires were given" in text


def test_a_refused_model_is_not_replaced_by_figures_of_the_published_one(tmp_path, capsys):
    case = simulate(3, operators=range(2), retargeters=("dexpilot", "sbr"))
    case.write(tmp_path)
    out = tmp_path / "out"
    main(["study", "analyze", str(tmp_path), "--output", str(out), "--no-report"])
    results = json.loads((out / "results.json").read_text(encoding="utf-8"))
    refused = [
        scope
        for scope, result in results["small-sample"]["success"].items()
        if result["refused"] and not results["paper"]["success"][scope]["refused"]
    ]
    assert refused
    (success,) = re.findall("^Success.*$", capsys.readouterr().out, re.MULTILINE)
    assert "not tested" in success
    assert "±" not in success


def test_sentences_of_what_was_refused_have_minus_signs(tmp_path):
    two = ("dexpilot", "sbr")
    case = simulate(5, alternate=True, spread=0.0, effect=0.0, operators=range(6), retargeters=two)
    case.write(tmp_path)
    sentences = conclusion(analyze_study(read_study([tmp_path])))
    (success,) = [text for text in sentences if text.startswith("Success")]
    assert "working correlation −0." in success


@pytest.mark.parametrize("operators", [2, 4])
def test_a_summary_of_few_operators_has_no_test_and_no_word_for_a_size(operators, tmp_path):
    """However far the retargeters are apart: here 40 s and 30 points."""
    case = simulate(3, operators=range(operators), retargeters=("dexpilot", "sbr"), effect=8.0)
    case.write(tmp_path)
    sentences = conclusion(analyze_study(read_study([tmp_path])))
    assert f"with {operators} operators, only very large differences can be shown" in (
        sentences[-1].lower()
    )
    text = " ".join(sentences)
    assert "estimated sbr +" in text
    assert not re.search("negligible|small|medium|, large|p\\b.?[=<]", text)


def test_a_size_in_words_stands_only_where_a_difference_is_shown(output):
    """An estimate near zero with a wide interval is not negligible."""
    results = json.loads((output / "results.json").read_text(encoding="utf-8"))
    words = set()
    for outcome in ("success", "time", "tlx"):
        for result in results["small-sample"][outcome].values():
            for family, p in (("dunnett", "p_dunnett"), ("pairs", "p_holm")):
                for one in result[family].values():
                    assert (one["effect_words"] == "not shown") == (one[p] >= 0.05)
                    words.add(one["effect_words"])
    assert {"not shown", "large"} <= words
    assert "not shown (" not in (output / "report.html").read_text(encoding="utf-8")


def test_learning_is_in_the_conclusion(tmp_path):
    """Of studies with the same retargeters: one in which times fall by 1 s a trial."""
    for change, learns in ((0.0, False), (1.0, True)):
        two = ("dexpilot", "sbr")
        case = simulate(3, operators=range(6), effect=0.0, retargeters=two)
        for row in case.trials:
            if row["time_s"]:
                done = int(str(row["trial_global"]))
                row["time_s"] = f"{float(str(row['time_s'])) + change * (32 - done):.2f}"
        sentence = conclusion(
            analyze_study(read_study([write_rows(tmp_path / "x.csv", case.trials)]))
        )
        assert ("perators learn: completion time −" in sentence[-1]) == learns


def test_times_are_said_to_be_of_successes_only(output):
    (time,) = [line for line in verdict(output) if line.startswith("Completion time")]
    assert time.endswith("a retargeter that fails in hard trials looks faster.")
    assert "Times include only successful trials" in (
        (output / "methods.txt").read_text(encoding="utf-8")
    )


def test_skewed_times_have_a_model_of_ratios(tmp_path):
    """Log-normal times of which one retargeter's are 1.5 times the other's."""
    draw = random.Random(4)
    case = simulate(3, operators=range(8), retargeters=("dexpilot", "sbr"), effect=0.0)
    for row in case.trials:
        if row["time_s"]:
            scale = 30.0 if row["retargeter"] == "sbr" else 20.0
            row["time_s"] = f"{scale * math.exp(0.8 * draw.gauss(0, 1)):.3f}"
    analysis = analyze_study(read_study([write_rows(tmp_path / "trials.csv", case.trials)]))
    time = analysis.results["small-sample"]["time"]["pooled"]
    logs = analysis.readings.log_time["pooled"]
    assert time.diagnostics["skewness"] > 1 > abs(logs.diagnostics["skewness"])
    assert any("reading log_time" in text for text in time.warnings)
    (sentence,) = [s for s in conclusion(analysis) if "model of their logarithms" in s]
    assert "times are skewed" in sentence.lower()
    ratio = logs.dunnett["sbr"]
    assert math.exp(ratio.lower) < 1.5 < math.exp(ratio.upper)
    values = [math.log(float(str(row["time_s"]))) for row in case.trials if row["time_s"]]
    assert logs.n == len(values)
    assert ratio_rows(logs)[1][3] == f"{math.exp(ratio.difference):.2f}"


def test_bad_data_write_nothing_and_give_status_2(data, tmp_path, capsys):
    rows: list[Row] = [dict(row) for row in simulate(3, operators=range(6)).trials]
    rows[3]["score"] = 0.25
    file = write_rows(tmp_path / "trials.csv", rows)
    out = tmp_path / "out"
    assert main(["study", "analyze", str(file), "--output", str(out)]) == 2
    assert "row 5, column score: expected 0, 0.5 or 1, not '0.25'" in capsys.readouterr().err
    assert not out.exists()
    good = str(data / "trials.csv")
    assert main(["study", "analyze", good, "--baseline", "sbt", "--output", str(out)]) == 2
    assert "Did you mean 'sbr'?" in capsys.readouterr().err
    assert not out.exists()
    assert main(["study", "analyze", str(tmp_path / "none.db"), "--output", str(out)]) == 2
    assert "no such file" in capsys.readouterr().err


def test_a_study_that_was_run_is_analysed_from_its_store(tmp_path, capsys):
    with open_study(tmp_path / "study", small_plan(3)) as store:
        for seed, operator in enumerate(store.plan.codes):
            walk(store, operator, seed=seed)
    out = tmp_path / "out"
    arguments = ["study", "analyze", str(tmp_path / "study"), "--output", str(out), "--no-report"]
    assert main(arguments) in (0, 1)
    results = json.loads((out / "results.json").read_text(encoding="utf-8"))
    assert results["study"]["trials"] == 3 * 2 * 3 * 3
    assert results["study"]["questionnaires"] == 3 * 2 * 3 * 3
    assert results["study"]["retargeters"] == ["dexpilot", "hybrid", "sbr"]
    assert "only 3 operators" in capsys.readouterr().out
    assert not (out / "report.html").exists()
