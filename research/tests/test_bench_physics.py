"""The framework of ``bench --physics``: intervals, kept results, files, report, command line."""

import csv
import json
import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from smooth_operator.cli import main
from smooth_operator.errors import ConfigError, UnknownNameError
from smooth_operator.hands.registry import load_hand
from smooth_operator_research.physics import suite
from smooth_operator_research.physics.measure import (
    Case,
    Clip,
    Drawing,
    Measured,
    PhysicsSettings,
    Unit,
    clip_of_record,
    clip_record,
)
from smooth_operator_research.physics.page import interval_drawings
from smooth_operator_research.physics.results import (
    Figure,
    MeasureResults,
    best_of,
    summarise,
    wilson,
)
from smooth_operator_research.physics.suite import (
    find_measure,
    measure_names,
    plan_cases,
    run_cases,
)

PROJECT = Path(__file__).resolve().parents[2]
ERROR = Figure("error_mm", "mm", "down", "How far off.", short="error")
HELD = Figure("held", "", "up", "Share of objects held.", share=True, trials="objects")


class Counting:
    """A measure whose figures follow from the unit; it counts its runs, and may stop or fail."""

    name = "reachable"
    title = "Counting"
    definition = "Counts."
    page = "explanation/physics-measures.md"
    unit = "world"
    figures = (ERROR, HELD)
    runs: list[str]
    stop_at: int | None = None

    def conditions(self, settings: PhysicsSettings) -> Sequence[str]:
        return ("dry", "wet")

    def units(self, settings: PhysicsSettings) -> Sequence[Unit]:
        return [Unit(f"world {k}", data=k) for k in range(settings.count(3, 2))]

    def run(self, case: Case) -> Measured:
        if self.stop_at is not None and len(self.runs) >= self.stop_at:
            raise KeyboardInterrupt
        self.runs.append(case.label)
        k = case.unit.data
        if k == 1 and case.method == "ako" and case.condition == "wet":
            raise ConfigError("the object <fell>")
        row = {"error_mm": 1.0 + k, "held": min(8 + k, 10), "objects": 10, "why": "slip"}
        if not case.clip:
            return Measured(row)
        hand, stamps = case.hand, np.arange(60) / 60
        joints = np.tile(hand.full_configuration(hand.neutral), (60, 1))
        corners = np.full((60, 2, 3), 0.01)
        return Measured(row, Clip(stamps, np.zeros((60, 21, 3)), joints, corners, [(0, 1)]))

    def draw(self, results: MeasureResults, colors: Mapping[str, str]) -> Sequence[Drawing]:
        return interval_drawings(self.name, results, self.figures, colors)


@pytest.fixture
def counting(monkeypatch) -> Counting:
    measure = Counting()
    measure.runs = []
    monkeypatch.setattr(suite, "find_measure", lambda name: measure)
    # Other work in this checkout must not look like a change of code between two runs.
    monkeypatch.setattr(suite, "benchmark_code", lambda: "fixed")
    return measure


def arguments(folder: Path, *more: str) -> list[str]:
    words = ["bench", "--physics", "reachable", "--methods", "smooth,ako", "--workers", "0"]
    return [*words, "--output", str(folder), *more]


def test_wilson_is_the_published_interval():
    # Newcombe 1998, table I: 81 of 263, 15 of 148, 0 of 20, 1 of 29, by Wilson's score method.
    assert wilson(81, 263) == pytest.approx((0.2553, 0.3662), abs=5e-5)
    assert wilson(15, 148) == pytest.approx((0.0624, 0.1605), abs=5e-5)
    assert wilson(0, 20) == pytest.approx((0.0, 0.1611), abs=5e-5)
    assert wilson(1, 29) == pytest.approx((0.0061, 0.1718), abs=5e-5)
    assert wilson(20, 20)[1] == 1.0
    with pytest.raises(ValueError, match="no interval"):
        wilson(0, 0)


def test_means_have_students_interval_and_average_rows_of_one_unit():
    rows = [
        {"unit": "a", "error_mm": 1.0},
        {"unit": "a", "error_mm": 3.0},
        {"unit": "b", "error_mm": 4.0},
        {"unit": "c", "error_mm": None},
    ]
    found = summarise(ERROR, rows)
    assert (found.value, found.count) == (3.0, 2)
    half = 12.706204736 * math.sqrt(2) / math.sqrt(2)  # t of one degree of freedom
    assert (found.low, found.high) == pytest.approx((3 - half, 3 + half))
    assert summarise(ERROR, rows[:1]).low is None
    assert summarise(ERROR, []).text() == "–"


def test_shares_count_trials():
    rows = [{"unit": "a", "held": 9, "objects": 10}, {"unit": "b", "held": True, "objects": 1}]
    found = summarise(HELD, rows)
    assert found.value == pytest.approx(10 / 11)
    assert (found.low, found.high) == pytest.approx(wilson(10, 11))
    assert found.count == 11


def test_a_clip_survives_packing():
    hand = load_hand("mimic_p050", "right")
    rng = np.random.default_rng(0)
    human = rng.normal(0, 0.1, (101, 21, 3))
    human[5:] = np.nan
    joints = rng.uniform(-1, 1, (101, len(hand.joint_names)))
    stamps = np.arange(101) / 100
    clip = Clip(stamps, human, joints, objects=human[:, :2], edges=[(0, 1)])
    found = clip_of_record(json.loads(json.dumps(clip_record(clip))))
    assert len(found.stamps) == 31
    chosen = np.searchsorted(stamps, found.stamps - 1e-6)
    np.testing.assert_allclose(found.human, human[chosen], atol=5.1e-5)
    np.testing.assert_allclose(found.joints, joints[chosen], atol=5.1e-5)
    assert found.objects is not None
    assert found.edges == [(0, 1)]


def test_a_stopped_run_goes_on_where_it_was(counting, tmp_path):
    counting.stop_at = 5
    assert main(arguments(tmp_path / "out", "--no-report")) == 130
    assert len(counting.runs) == 5
    counting.stop_at = None
    assert main(arguments(tmp_path / "out", "--no-report")) == 1
    # 2 methods x 2 conditions x 3 worlds; the failed one counts, and is tried again each time.
    assert len(counting.runs) == 12
    assert len(set(counting.runs)) == 12
    assert main(arguments(tmp_path / "out", "--no-report")) == 1
    assert len(counting.runs) == 13


def test_changed_code_and_more_units_are_run(counting, tmp_path, monkeypatch):
    words = arguments(tmp_path, "--no-report", "--methods", "smooth")
    assert main(words) == 0
    assert main([*words, "--units", "4"]) == 0
    assert len(counting.runs) == 6 + 2
    monkeypatch.setattr(suite, "benchmark_code", lambda: "changed")
    assert main(words) == 0
    assert len(counting.runs) == 6 + 2 + 6


def test_files_and_report(counting, tmp_path, capsys):
    assert main(arguments(tmp_path)) == 1
    with (tmp_path / "reachable.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 12
    assert [row["reason"] for row in rows if row["status"] == "error"] == [
        "ConfigError: the object <fell>"
    ]
    with (tmp_path / "summary.csv").open(encoding="utf-8") as file:
        summary = {
            (row["condition"], row["method"], row["figure"]): row for row in csv.DictReader(file)
        }
    dry = summary["dry", "smooth", "error_mm"]
    half = 4.302652730 * 1.0 / math.sqrt(3)
    assert [float(dry[k]) for k in ("value", "low", "high")] == pytest.approx(
        [2, 2 - half, 2 + half]
    )
    with (tmp_path / "differences.csv").open(encoding="utf-8") as file:
        differences = list(csv.DictReader(file))
    assert {(row["method"], row["less"]) for row in differences} == {("smooth", "ako")}
    held = summary["wet", "ako", "held"]
    ends = [float(held[name]) for name in ("value", "low", "high")]
    assert ends == pytest.approx([0.9, *wilson(18, 20)])
    content = json.loads((tmp_path / "results.json").read_text(encoding="utf-8"))
    assert content["measures"][0]["rows"][0]["why"] == "slip"
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "the object &lt;fell&gt;" in page
    assert page.count('class="player"') == 2  # a clip for each condition, both methods in it
    assert page.count('"objectEdges":[[0,1]]') == 2
    assert {path.name for path in (tmp_path / "plots").iterdir()} == {
        f"reachable-{condition}.{kind}" for condition in ("dry", "wet") for kind in ("png", "svg")
    }
    printed = capsys.readouterr()
    assert "Counting: Counts." in printed.out
    assert "1 of 12 cases failed" in printed.err


def rows_of(method: str, values: Sequence[float | None]) -> list[Any]:
    """A row for each unit, with the error and one object of two held."""
    return [
        {
            "hand": "h",
            "side": "right",
            "condition": "",
            "method": method,
            "preset": "any",
            "unit": f"u{k}",
            "status": "ok",
            "reason": None,
            "error_mm": value,
            "held": k % 2,
            "objects": 2,
        }
        for k, value in enumerate(values)
    ]


def test_differences_are_taken_unit_by_unit():
    """The units differ by metres, the methods by millimetres."""
    one, other = (
        rows_of("sbr", [1e3, 2e3, 3e3, None]),
        rows_of("ako", [1e3 + 1, 2e3 + 2, 3e3 + 3, 7]),
    )
    results = MeasureResults([ERROR, HELD], [*one, *other])
    found = results.differences(("h", "right", ""), "sbr:any")
    assert list(found) == ["ako:any"]
    error = found["ako:any"]["error_mm"]
    half = 4.302652730 * 1.0 / math.sqrt(3)
    assert (error.value, error.count) == (pytest.approx(2.0), 3)
    assert (error.low, error.high) == pytest.approx((2 - half, 2 + half))
    held = found["ako:any"]["held"]
    assert (held.value, held.low, held.high, held.count) == (0, 0, 0, 4)


def test_the_best_is_nearest_to_zero_where_less_is_better():
    values = {"smooth": -0.5, "sbr": 0.2, "ako": 3.0}
    rows = [row for method, value in values.items() for row in rows_of(method, [value])]
    results = MeasureResults([ERROR], rows)
    assert best_of(results.lines(("h", "right", "")), ERROR) == "sbr:any"


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["bench", "--physics", "reach", "--output", "x"], "reachable"),
        (["physics", "--measures", "reach", "--output", "x"], "reachable"),
        (["bench", "--units", "3", "--output", "x"], "--units"),
        (["bench", "--physics", "--units", "0", "--output", "x"], "one independent unit or more"),
        (["bench", "--physics", "--compare", "a", "--output", "x"], "--compare"),
        (["bench", "--physics", "--hands", "nope", "--output", "x"], "nope"),
    ],
)
def test_what_cannot_be_asked_for(words, said, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(words) == 2
    assert said in capsys.readouterr().err
    assert not (tmp_path / "x").exists()


def test_a_folder_of_another_benchmark_is_refused(tmp_path):
    (tmp_path / "config.json").write_text('{"program": "smooth-operator", "command": "bench"}')
    with pytest.raises(Exception, match="files that are not from an earlier bench --physics"):
        plan_cases(PhysicsSettings(output=tmp_path))


def test_an_unknown_measure_is_named():
    with pytest.raises(UnknownNameError, match="reachable"):
        find_measure("reachible")


@pytest.mark.parametrize("name", measure_names())
def test_each_measure_offers_what_is_needed(name):
    measure = find_measure(name)
    assert measure.name == name
    assert len(re.findall(r"[.?!](?:\s|$)", measure.definition)) == 1  # one sentence
    names = [figure.name for figure in measure.figures]
    assert len(set(names)) == len(names)
    assert all(figure.meaning for figure in measure.figures)
    page, _, anchor = measure.page.partition("#")
    text = (PROJECT / "research" / page).read_text(encoding="utf-8")
    headings = [line.lstrip("# ") for line in text.splitlines() if line.startswith("#")]
    assert anchor in {heading.lower().replace(" ", "-") for heading in headings}


@pytest.mark.weekly
def test_reachable_motion_runs_in_the_suite(tmp_path):
    """One real case for each condition, with the cheapest method."""
    settings = PhysicsSettings(
        output=tmp_path,
        measures=("reachable",),
        methods=("joint_angle",),
        hands=("inspire_hand",),
        trackers=("headset",),
        quick=True,
        units=1,
        workers=0,
    )
    tmp_path.mkdir(exist_ok=True)
    (outcome,) = run_cases(settings, plan_cases(settings))
    clean, noisy = outcome.results.rows
    assert [row["status"] for row in (clean, noisy)] == ["ok", "ok"]
    assert 0 < float(clean["tip_error_mm"] or 0) < 60
    assert float(clean["input_error_mm"] or 0) < 1e-9
    assert float(noisy["input_error_mm"] or 0) > 0.8
    shown = outcome.clips["inspire_hand", "right", "clean"]
    assert list(shown) == ["joint_angle"]
    (again,) = run_cases(settings, plan_cases(settings))
    assert again.results.rows == outcome.results.rows
