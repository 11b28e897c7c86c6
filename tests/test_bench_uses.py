"""The benchmark's answer to "which method?", its columns, and the page's sorting and hovering."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from smooth_operator.lab.benchmark import uses
from smooth_operator.lab.benchmark.figures import latency_figure
from smooth_operator.lab.benchmark.page.tables import headline_table
from smooth_operator.lab.benchmark.ranking import COLUMNS, HEADLINES, Line
from smooth_operator.reporting.drawing import colors_of, styled, write_figure

NAMES = [metric.name for metric in COLUMNS]


def line(method: str, *values: float | None, of: int = 1) -> Line:
    """Cosine, scale, motion, flatness, pinch gap, collision, workspace, latency."""
    return Line(method, dict(zip(NAMES, values, strict=True)), count=1, of=of)


SAFE = line("safe", 0.98, 1.1, 0.95, 3e-6, 7.0, 0.01, 0.10, 0.5)
CLOSE = line("close", 0.99, 1.2, 0.92, 2e-6, 4.0, 0.60, 0.12, 0.6)
STILL = line("still", 0.90, 1.3, 0.40, 1e-7, 20.0, 0.00, 0.02, 0.1)
LINES = [SAFE, CLOSE, STILL]


def test_pinch_gap_and_collision_stand_among_the_papers_columns() -> None:
    assert set(HEADLINES) < set(COLUMNS)
    assert {"pinch_error_mm", "self_collision.share"} == {
        m.name for m in set(COLUMNS) - set(HEADLINES)
    }
    page = headline_table(LINES, colors_of(["safe", "close", "still"]))
    assert "pinch gap" in page
    assert "60.0 %" in page


def test_a_method_that_collides_is_not_named_for_grasping() -> None:
    chosen = {use.name: use.methods for use in uses.find_uses(LINES)}
    assert chosen["pinching and grasping"] == ("safe",)  # close has the smaller gap, and collides
    assert chosen["pointing as the human does"] == ("close",)
    assert chosen["speed"] == ("still",)


def test_a_method_that_stands_still_is_not_named_for_calm_motion() -> None:
    chosen = {use.name: use.methods for use in uses.find_uses(LINES)}
    assert chosen["calm motion that keeps up"] == ("close",)


def test_where_no_method_serves_a_use_the_reason_is_said() -> None:
    colliding = [
        line(name, 0.9, 1.0, 0.5, 1e-6, gap, 0.4, 0.1, 1.0) for name, gap in (("a", 1.0), ("b", 2))
    ]
    said = uses.verdict(colliding)
    assert "for pinching and grasping none (every method has over 5 %" in said
    assert "no method reaches a motion preservation of 0.9" in said


def test_without_a_pinch_no_method_is_named_for_it() -> None:
    lines = [line(n, c, 1.0, 0.95, 1e-6, None, 0.0, 0.1, 1.0) for n, c in (("a", 0.9), ("b", 0.8))]
    grasping = uses.find_uses(lines)[0]
    assert (grasping.methods, grasping.figures) == ((), "no pinch gap was measured")


def test_mean_ranks_and_who_competes() -> None:
    better = line("better", 1.0, 1.0, 1.0, 1e-7, 1.0, 0.0, 0.5, 0.1)
    worse = line("worse", 0.9, 0.8, 0.9, 1e-6, 2.0, 0.1, 0.4, 0.2)
    partly = line("partly", 1.0, 1.0, 1.0, 1e-8, 0.5, 0.0, 0.9, 0.01, of=2)
    assert uses.mean_ranks([worse, better, partly]) == {"better": 1.0, "worse": 2.0}
    assert uses.verdict([worse, better, partly]).startswith("better has the best mean rank")
    assert uses.verdict([better]) == ""
    gap = line("gap", 1.0, 1.0, 1.0, 1e-7, None, 0.0, 0.5, 0.1)
    assert uses.mean_ranks([gap, better])["gap"] > uses.mean_ranks([gap, better])["better"]


def test_the_latency_in_the_plot_is_that_of_the_table() -> None:
    short, long = np.full(10, 1.0), np.full(1000, 3.0)
    with styled():
        figure = latency_figure({"m": [short, long]}, {"m": "#000000"})
    assert figure is not None
    words = [text.get_text() for text in figure.axes[0].texts]
    assert words == ["2"]  # the mean of the recordings' medians, not the pooled 3


@pytest.mark.browser
def test_tables_sort_and_plots_answer_to_the_pointer(chromium: Any, tmp_path: Path) -> None:
    from matplotlib.figure import Figure

    from smooth_operator.reporting.drawing import series

    names = [one.method for one in LINES]
    with styled():
        figure = Figure()
        axes = figure.add_axes((0.1, 0.1, 0.8, 0.8))
        for i, name in enumerate(names):
            axes.plot([0, 1], [i, i], gid=series(name, f'{name} <b> "said"'))
        svg = write_figure(figure, tmp_path / "plot")
    script = (files("smooth_operator.reporting") / "interact.js").read_text(encoding="utf-8")
    page = chromium.new_page(viewport={"width": 900, "height": 900})
    table = headline_table(LINES, colors_of(names))
    page.set_content(f"<!doctype html>{table}{svg}<script>{script}</script>")
    rows = page.locator("tbody tr th")
    assert rows.all_inner_texts() == names
    gap = page.locator("th[data-goal]").nth(NAMES.index("pinch_error_mm"))
    gap.click()
    assert rows.all_inner_texts() == ["close", "safe", "still"]  # the smallest gap first
    gap.focus()
    page.keyboard.press("Enter")
    assert rows.all_inner_texts() == ["still", "safe", "close"]
    gap.click()
    assert rows.all_inner_texts() == names
    assert page.locator("svg .series title").first.text_content() == 'safe <b> "said"'
    page.locator("tbody tr").nth(1).hover()
    dim = "all => all.map(one => one.classList.contains('dim'))"
    assert page.locator("svg .series").evaluate_all(dim) == [True, False, True]
    page.close()
