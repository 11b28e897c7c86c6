"""The constants on the pages about ``smooth`` are those of its presets."""

import ast
import hashlib
import io
import re
import tokenize
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from smooth_operator.retargeting.preset_files import method_config

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "explanation" / "smooth.md"
APPENDIX = ROOT / "research" / "docs" / "smooth-appendix.md"


def rows(header: str, page: Path = PAGE) -> list[list[str]]:
    """The cells of the table of a page that begins so."""
    lines = page.read_text(encoding="utf-8").split(header, 1)[1].splitlines()[2:]
    return [[c.strip() for c in line.strip("|").split("|")] for line in lines[: lines.index("")]]


def numbers(cell: str) -> list[float]:
    found = re.findall(r"(?<![\d.])−?[\d.]+(?:e-?\d+)?", cell)
    return [float(text.replace("−", "-")) for text in found]


def flat(values: dict[str, Any], path: str = "") -> dict[str, Any]:
    out: dict[str, Any] = {}
    for name, value in values.items():
        nested = isinstance(value, dict)
        out |= flat(value, f"{path}{name}.") if nested else {f"{path}{name}": value}
    return out


def test_the_constants_of_the_page_are_the_presets():
    settings = flat(asdict(method_config("smooth")))
    seen = set()
    for names, shown, _ in rows("| setting | value | meaning |"):
        first, *others = re.findall(r"`([\w.]+)`", names)
        parent = first[: first.rfind(".") + 1]
        paths = [first, *(parent + name for name in others)]
        values = np.concatenate([np.ravel(settings[path]) for path in paths])
        # lengths and times are shown in mm and ms
        thousandth = np.where(" m" in shown, np.abs(values) < np.abs(numbers(shown)) / 100, False)
        np.testing.assert_allclose(np.where(thousandth, 1e3, 1.0) * values, numbers(shown))
        seen |= set(paths)
    left_out = {"alignment"}
    rest = {path for path in settings if path not in seen and path.split(".")[0] not in left_out}
    added = "objective.terms"  # of a user, and empty without one
    assert settings[added] == ()
    none = {added}
    assert rest - left_out == none


def test_smooth_has_at_most_35_settings():
    """Numbers, switches and tuples of numbers, nested ones too."""
    settings = flat(asdict(method_config("smooth")))
    counted = [
        path for path, value in settings.items() if isinstance(value, (bool, int, float, tuple))
    ]
    assert len(counted) <= 35, counted


MOST_LINES = 1195
"""2,160 on 2026-11-27, 1,591 and 1,318 on 2026-11-29, 1,199 on 2026-11-30."""

A_FRAME = (
    "retargeting/program",
    "retargeting/alignment",
    "retargeting/smooth",
    "retargeting/pinch_gaps",
    "retargeting/fingertip_filter",
    "retargeting/correspondence",
    "retargeting/targets",
    "retargeting/smooth_terms",
    "retargeting/objective",
    "retargeting/levenberg",
    "hands/differential",
    "hands/pose_table",
)
"""Modules that a frame of ``smooth`` passes from landmarks to command."""


def lines_of_code(text: str) -> int:
    """Lines without blank ones, comments, docstrings and imports."""
    idle = (tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT)
    lines: set[int] = set()
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type not in (*idle, tokenize.ENDMARKER):
            lines |= set(range(token.start[0], token.end[0] + 1))
    for node in ast.walk(ast.parse(text)):
        said = isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
        if isinstance(node, ast.Import | ast.ImportFrom) or (
            said and isinstance(node.value.value, str)
        ):
            lines -= set(range(node.lineno, (node.end_lineno or node.lineno) + 1))
    return len(lines)


def test_a_frame_takes_no_more_code_than_it_did():
    source = ROOT / "src" / "smooth_operator"
    count = {name: lines_of_code((source / f"{name}.py").read_text("utf-8")) for name in A_FRAME}
    assert sum(count.values()) <= MOST_LINES, count


def test_the_equations_take_at_most_60_lines():
    text = (
        PAGE.read_text(encoding="utf-8")
        .split("## Equations", 1)[1]
        .split("**Why these terms", 1)[0]
    )
    lines = [line for line in text.splitlines() if line]
    assert len(lines) <= 60
    assert max(map(len, lines)) <= 280


@pytest.mark.parametrize("method", ["smooth", "sbr"])
def test_the_constants_of_the_offline_presets_are_the_pages(method):
    config = method_config(method, "offline")
    values = {
        "$w_a$": [config.future.acceleration_weight],
        "$w_m$": [config.future.motion_weight],
        "$v_0$": [config.future.motion_speed],
        r"$\ell$": [config.jump, config.noise] if config.noise else [config.jump],
        r"$v_\mathrm{max}$": [config.future.speed_limit],
        "`bridge`": [config.bridge],
    }
    for row in rows("| | | `smooth` | `sbr` |", APPENDIX):
        assert numbers(row[2 if method == "smooth" else 3]) == values.pop(row[0])
    assert not values


MARKED = ("docs/reference/benchmarks.md", "research/docs/looks.md")
"""Pages with figures of today's default; a mark stands above each table."""


@pytest.mark.parametrize("name", MARKED)
def test_figures_of_the_default_are_of_todays(name):
    """Who changes its settings measures again, or names the commit in place of the mark."""
    settings = repr(sorted(flat(asdict(method_config("smooth"))).items()))
    today = hashlib.sha256(settings.encode()).hexdigest()[:8]
    marks = re.findall(r"<!-- figures of smooth: (\w+) -->", (ROOT / name).read_text("utf-8"))
    assert marks
    assert set(marks) == {today}, "measure the figures of smooth beside these marks again"


@pytest.mark.parametrize("page", ["README.md", "docs/reference/benchmarks.md"])
def test_the_table_of_methods_is_that_of_looks(page):
    looks = (ROOT / "research/docs/looks.md").read_text("utf-8").partition("<!-- /headline -->")[0]
    table = re.search(r"^\| method \|.*\n(?:\|.*\n)+", looks, re.MULTILINE)
    assert table is not None
    assert table[0] in (ROOT / page).read_text("utf-8")
