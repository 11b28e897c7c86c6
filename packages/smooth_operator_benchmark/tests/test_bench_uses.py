"""The benchmark's answer to "which method?", its columns, and the page's sorting and hovering."""

import re
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.text import Text

from smooth_operator.metrics import METRICS
from smooth_operator.reporting.drawing import colors_of, series, styled, write_figure
from smooth_operator.reporting.run_plots import latency_figure
from smooth_operator_benchmark import ranking
from smooth_operator_benchmark.cells import Settings
from smooth_operator_benchmark.figures import name_points
from smooth_operator_benchmark.page.report import macros, summary_text
from smooth_operator_benchmark.ranking import (
    COLUMNS,
    HEADLINES,
    Line,
    best,
    by_tracker,
    overall,
)
from smooth_operator_benchmark.suite import Row

METRIC = {metric.name: metric for metric in METRICS}
COLUMN_NAMES = [metric.name for metric in COLUMNS]
NAMES = (
    "cosine_similarity",
    "scale_ratio",
    "motion_preservation",
    "flatness",
    "pinch_touch_share",
    "self_collision.share",
    "workspace_utilisation",
    "latency_ms.p50",
)


def line(method: str, *values: float | None, of: int = 1, extension: float | None = None) -> Line:
    """A method with the values of ``NAMES``."""
    figures = dict.fromkeys(COLUMN_NAMES) | dict(zip(NAMES, values, strict=True))
    return Line(method, figures | {"finger_extension_error": extension}, count=1, of=of)


SAFE = line("safe", 0.98, 1.1, 0.95, 3e-6, 0.7, 0.01, 0.10, 0.5)
CLOSE = line("close", 0.99, 1.2, 0.92, 2e-6, 0.9, 0.60, 0.12, 0.6)
STILL = line("still", 0.90, 1.3, 0.40, 1e-7, 0.1, 0.00, 0.02, 0.1)
LINES = [SAFE, CLOSE, STILL]


def test_posture_and_collision_stand_among_the_papers_columns():
    assert set(HEADLINES) < set(COLUMNS)
    assert {"finger_extension_error", "pinch_touch_share", "jumps_per_1000"} < {
        m.name for m in set(COLUMNS) - set(HEADLINES)
    }
    page = macros().headline(LINES, colors_of(["safe", "close", "still"]))
    assert "60.0 %" in page
    (groups,) = re.findall('<tr class="groups">(.*?)</tr>', page)
    assert re.sub("<.*?>", "", groups) == "alllooksgraspingmotionspeedthe paper&#39;s"


def test_a_method_that_collides_or_stands_still_is_not_named():
    chosen = {use.name: use.methods for use in ranking.find_uses(LINES)}
    assert chosen["pinching and grasping"] == ("safe",)  # close touches more often, and collides
    assert chosen["pointing as the human does"] == ("close",)
    assert chosen["calm motion without lag"] == ("close",)  # still does not keep up
    assert chosen["speed"] == ("still",)


def test_where_no_method_serves_a_use_the_reason_is_said():
    colliding = [
        line(name, 0.9, 1.0, 0.5, 1e-6, gap, 0.4, 0.1, 1.0)
        for name, gap in (("a", 0.8), ("b", 0.7))
    ]
    sentence = ranking.verdict(colliding)
    assert "for pinching and grasping none (every method has more than 5 %" in sentence
    assert "no method reaches a motion preservation of 0.9" in sentence
    lines = [line(n, c, 1.0, 0.95, 1e-6, None, 0.0, 0.1, 1.0) for n, c in (("a", 0.9), ("b", 0.8))]
    grasping = ranking.find_uses(lines)[1]
    assert grasping.methods == ()
    assert grasping.figures == "no fraction of pinches that touch was measured"


def test_the_sentence_names_what_the_table_marks():
    """On random figures: who serves a use is the best of its column, or the better one is named."""
    for seed in range(100):
        rng = np.random.default_rng(seed)
        lines = [
            line(
                name,
                *rng.uniform(0.2, 1.2, 2),
                rng.uniform(0.8, 1),
                *rng.uniform(0, 1, 2),
                rng.choice([0.0, 0.04, 0.3]),
                *rng.uniform(0.1, 1, 2),
                extension=rng.uniform(0, 0.2),
            )
            for name in "abcd"
        ]
        ranks = ranking.mean_ranks(lines)
        first = min(ranks, key=lambda name: ranks[name])
        assert ranking.verdict(lines).startswith(first)
        judged = ("finger_extension_error", "pinch_touch_share", "cosine_similarity")
        judged += ("flatness", "latency_ms.p50")
        for use, name in zip(ranking.find_uses(lines), judged, strict=True):
            marked = {lines[i].method for i in best(lines, METRIC[name])}
            excused = re.findall(r"; (\w) is excluded", use.figures)
            assert not use.methods or set(use.methods) == marked or set(excused) <= marked, seed
            assert bool(excused) == (bool(use.methods) and not set(use.methods) & marked), seed


def test_figures_that_look_the_same_share_a_rank():
    one = line("one", 0.99991, 1.0, 0.95, 1e-6, 2.0, 0.0, 0.1, 0.5)
    two = line("two", 0.99992, 1.0, 0.95, 1e-6, 2.0, 0.0, 0.1, 0.5)
    assert ranking.mean_ranks([one, two]) == {"one": 1.5, "two": 1.5}
    assert ranking.verdict([one, two]).startswith("one and two share the best mean rank")


def row(method: str, tracker: str, file: str, part: str, error: float) -> Row:
    return {
        "recording": f"{file}[{part}]",
        "hand": "h",
        "side": "right",
        "method": method,
        "preset": "p",
        "status": "ok",
        "reason": None,
        "date": "2026-11-26T10:00:00",
        "source": {"tracker": tracker, "unit": file},
        "metrics": {"finger_extension_error": error, "cosine_similarity": 1 - error},
    }


def test_the_mean_is_over_parts_then_recordings_then_trackers():
    """Three parts of one glove file, another glove, a headset: the means disagree on who is best,
    and sentence, table and Markdown go by the same one."""
    measured = {
        "a": {"g1": (0.1, 0.1, 0.1), "g2": (0.2,), "h": (0.9,)},
        "b": {"g1": (0.3, 0.3, 0.3), "g2": (0.5,), "h": (0.1,)},
    }
    rows = [
        row(method, "headset" if file == "h" else "glove", file, f"{i}", error)
        for method, files in measured.items()
        for file, errors in files.items()
        for i, error in enumerate(errors)
    ]
    pooled = {m: np.mean([e for es in f.values() for e in es]) for m, f in measured.items()}
    assert pooled["a"] < pooled["b"]
    lines = overall(rows)
    values = {one.method: one.values["finger_extension_error"] for one in lines}
    assert values == pytest.approx({"a:p": (0.15 + 0.9) / 2, "b:p": (0.4 + 0.1) / 2})
    assert list(by_tracker(rows)) == ["glove", "headset"]
    assert best(lines, METRIC["finger_extension_error"]) == {1}
    assert ranking.verdict(lines).startswith("b:p has the best mean rank")
    assert "for looks b:p (extension error 0.25" in ranking.verdict(lines)
    text = summary_text(rows, Settings(output=Path("out"), recordings=("/x/g1.npz@:5",)))
    assert "| `b:p` | **0.25** |" in text
    assert "n = 3 recordings in 5 parts: 2 glove, 1 headset" in text
    assert "smooth-operator bench g1.npz@:5 --methods all --hands mimic_p050" in text


def test_mean_ranks_and_who_competes():
    better = line("better", 1.0, 1.0, 1.0, 1e-7, 0.9, 0.0, 0.5, 0.1)
    worse = line("worse", 0.9, 0.8, 0.9, 1e-6, 0.4, 0.1, 0.4, 0.2)
    partly = line("partly", 1.0, 1.0, 1.0, 1e-8, 0.5, 0.0, 0.9, 0.01, of=2)
    assert ranking.mean_ranks([worse, better, partly]) == {"better": 1.0, "worse": 2.0}
    assert ranking.verdict([worse, better, partly]).startswith("better has the best mean rank")
    assert ranking.verdict([better]) == ""
    gap = line("gap", 1.0, 1.0, 1.0, 1e-7, None, 0.0, 0.5, 0.1)
    assert ranking.mean_ranks([gap, better])["gap"] > ranking.mean_ranks([gap, better])["better"]


def test_the_latency_in_the_plot_is_that_of_the_table():
    short, long = np.full(10, 1.0), np.full(1000, 3.0)
    with styled():
        figure = latency_figure({"m": [short, long]}, {"m": "#000000"})
    words = [text.get_text() for text in figure.axes[0].texts]
    assert words == ["2"]  # the mean of the recordings' medians, not the pooled 3


def test_names_of_points_cover_nothing():
    drawing = Figure(figsize=(4, 3), dpi=100)
    ax = drawing.subplots()
    points = {f"method {i}": (0.9 + 0.01 * (i % 3), 0.5 + 0.002 * i) for i in range(8)}
    ax.set_xlim(0, 1)
    ax.set_ylim(0, 1)
    drawing.draw_without_rendering()
    name_points(ax, points, size=7.5)
    drawing.draw_without_rendering()
    boxes = [Text.get_window_extent(text) for text in ax.texts]  # without the lines to points
    assert len(boxes) == len(points)
    places = np.asarray(ax.transData.transform(list(points.values())))
    for i, box in enumerate(boxes):
        assert ax.bbox.x0 <= box.x0
        assert box.x1 <= ax.bbox.x1
        assert not any(box.overlaps(other) for other in boxes[:i])
        assert not any(box.contains(x, y) for x, y in places)


@pytest.mark.browser
def test_tables_sort_and_plots_answer_to_the_pointer(chromium, tmp_path):
    names = [one.method for one in LINES]
    with styled():
        figure = Figure()
        axes = figure.add_axes((0.1, 0.1, 0.8, 0.8))
        for i, name in enumerate(names):
            axes.plot([0, 1], [i, i], gid=series(name, f'{name} <b> "said"'))
        svg = write_figure(figure, tmp_path / "plot")
    script = (files("smooth_operator.reporting") / "interact.js").read_text(encoding="utf-8")
    page = chromium.new_page(viewport={"width": 900, "height": 900})
    table = macros().headline(LINES, colors_of(names))
    page.set_content(f"<!doctype html>{table}{svg}<script>{script}</script>")
    rows = page.locator("tbody tr th")
    assert rows.all_inner_texts() == names
    touch = page.locator("th[data-goal]", has_text="touch")
    touch.click()
    assert rows.all_inner_texts() == ["close", "safe", "still"]  # the most pinches first
    touch.focus()
    page.keyboard.press("Enter")
    assert rows.all_inner_texts() == ["still", "safe", "close"]
    touch.click()
    assert rows.all_inner_texts() == names
    assert page.locator("svg .series title").first.text_content() == 'safe <b> "said"'
    page.locator("tbody tr").nth(1).hover()
    dim = "all => all.map(one => one.classList.contains('dim'))"
    assert page.locator("svg .series").evaluate_all(dim) == [True, False, True]
    page.close()


def test_empty_cells_have_a_footnote():
    def row(recording: str, touch: float | None, share: float | None, status: str = "ok") -> Row:
        metrics = {"pinch_touch_share": touch, "self_collision": {"share": share}}
        names = {"recording": recording, "hand": "bare", "side": "left"}
        return names | {"status": status, "metrics": metrics}

    assert ranking.footnotes([row("a", 0.5, 0.0), row("a", None, 0.0)]) == []
    collision, pinches = ranking.footnotes(
        [row("a", 0.5, None), row("b", None, 0.0), row("c", None, None, "failed")]
    )
    assert "self-collision of bare left" in collision
    assert (
        "'touch' and 'deep' of b: not measured, because the human pinches in fewer than 10 frames"
        in pinches
    )
