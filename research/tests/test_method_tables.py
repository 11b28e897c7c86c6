"""The program that makes the tables of the appendix on ``smooth``, on a few synthetic frames."""

from __future__ import annotations

import json
import re
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from smooth_operator.formats.setting_paths import with_settings
from smooth_operator.lab.benchmark.recordings import load_sources, parse_request
from smooth_operator.lab.tuning.pareto import (
    COLLISION,
    FLATNESS,
    VELOCITY,
    TradeOff,
    save_trade_offs,
)
from smooth_operator.lab.tuning.score import figure
from smooth_operator.lab.tuning.trial import run_trial
from smooth_operator.methods.method import TrajectoryMethodConfig
from smooth_operator.methods.presets import PRESETS, method_config
from smooth_operator.reporting.drawing import name_points
from smooth_operator_research.judging import method_tables

pytestmark = [pytest.mark.usefixtures("few_optimisations"), pytest.mark.weekly]

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "explanation" / "smooth.md"
APPENDIX = ROOT / "research" / "docs" / "smooth-appendix.md"
HAND = "shadow_dexee"
"""Three fingers, which are compiled soonest."""
MOMENT = "synthetic:5@:40"


@pytest.fixture(scope="module")
def programs() -> Any:
    return method_tables, method_tables


@pytest.fixture(scope="module")
def tiny(programs: Any) -> Any:
    """The method, made to compile sooner."""
    program, _ = programs
    changes = {"sampling.samples": 32, "sampling.elites": 8, "sampling.cycles": 1,
               "polish.iterations": 2, "settle_rounds": 1}  # fmt: skip
    config = with_settings(method_config(program.METHOD), changes)
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(PRESETS[program.METHOD], "tiny", config)
        yield config


@pytest.fixture(scope="module")
def made(programs: Any, tiny: Any, tmp_path_factory: pytest.TempPathFactory) -> Any:
    """A run with a few rows: its settings."""
    program, _ = programs
    folder = tmp_path_factory.mktemp("method")
    settings = program.Settings(
        ("without", "alone", "fronts"), recordings=(MOMENT,), preset="tiny", workers=0,
        rows=("velocity term", "self-collision cost", "lag 8 ms"), hand=HAND,
        others=("joint_angle",), cache=folder / "cache", output=folder / "method.json",
    )  # fmt: skip
    program.main(settings)
    return settings


def test_tables_and_picture(programs: Any, made: Any):
    table = made.output.with_suffix(".md").read_text()
    lines = [line for line in table.splitlines() if line.startswith("|")]
    assert lines[:2] == [
        "| | cos thumb | cos all | motion | flatness [m²] | vel. corr. | collision | pinch [mm] |",
        "|---|---:|---:|---:|---:|---:|---:|---:|",
    ]
    names = [line.split(" | ")[0].removeprefix("| ") for line in lines]
    assert [name for name in names if not name.startswith("|")] == [
        "**all of it**", "without self-collision cost", "without velocity term",
        "**none of it**", "only self-collision cost", "only velocity term", "lag 8 ms, jump 0.1",
    ]  # fmt: skip
    figures = json.loads(made.output.read_text())["figures"]
    whole = {k.split("/")[-1]: v for k, v in figures.items() if "/all of it/" in k}
    late = {k.split("/")[-1]: v for k, v in figures.items() if "/lag 8 ms, jump 0.1/" in k}
    assert whole["cosine_similarity"] > 0.8
    assert late["cosine_similarity_all"] < whole["cosine_similarity_all"]
    picture = made.output.with_name("method-fronts.png")
    assert picture.read_bytes().startswith(b"\x89PNG")


def test_what_was_measured_is_kept(programs: Any, made: Any, monkeypatch: Any):
    program, variants = programs
    before = json.loads(made.output.read_text())["figures"]
    monkeypatch.setattr(variants, "run_tasks", lambda *a, **k: pytest.fail("it measured again"))
    # fewer rows, and so other settings among those that any row changes
    program.main(replace(made, parts=("without",), rows=("self-collision cost",)))
    after = json.loads(made.output.read_text())["figures"]
    assert len(after) > 6
    assert after == {name: before[name] for name in after}


def test_a_zero_is_an_argument_where_that_is_the_same(programs: Any, made: Any, tiny: Any):
    program, variants = programs
    config = method_config(program.METHOD, "tiny")
    source = load_sources([parse_request(MOMENT)])[0]
    todo = variants.Variants(config, (source,), HAND, program.LIKE_ANY_VALUE, 0, 0, made.cache)
    rows = program.rows_of(made)
    full = variants.full_values(config, rows)
    values = dict(full["without", program.WHOLE])
    # pose weight apart: nothing else holds a joint that no fingertip feels
    zeros = (values.keys() & todo.like_any_value) - {"objective.pose_weight"}
    assert len(zeros) > 5
    values |= dict.fromkeys(zeros, 0.0)
    traced = todo.task(values)  # of the program that the rows were measured by
    assert traced.values.keys() == values.keys()
    constant = replace(traced, config=with_settings(config, values), values={})
    (one,), (other,) = run_trial(traced), run_trial(constant)
    for name in ("cosine_similarity", "motion_preservation", "flatness", "self_collision.share"):
        assert figure(one, name) == pytest.approx(figure(other, name), rel=0.01, abs=1e-9)
    off = todo.task(
        values | {"landmarks.jump_threshold": 0.0}
    )  # which leaves jumps in; 0 m would not
    assert "landmarks.jump_threshold" not in off.values
    assert off.config.landmarks.jump_threshold == 0


def test_a_row_that_cannot_be(programs: Any, monkeypatch: Any):
    program, variants = programs
    config = method_config(program.METHOD)
    for values, reason in (
        ({"self_collision.wieght": 0.0}, r"'new part' of 'alone'.*self_collision\.weight"),
        ({"self_collision.weight": -1.0}, r"'new part' of 'alone'.*negative"),
    ):
        with pytest.raises(SystemExit, match=reason):
            variants.full_values(config, {("alone", "new part"): values})
    monkeypatch.setitem(program.WITHOUT, "new part", {"none_such": 0.0})
    with pytest.raises(SystemExit, match=r"'without new part' of 'without'.*none_such"):
        program.main(program.Settings(("without",)))


def test_parts_are_those_of_the_preset(programs: Any):
    program, variants = programs
    rows = program.rows_of(program.Settings())
    full = variants.full_values(method_config(program.METHOD), rows)
    whole, nothing = full["without", program.WHOLE], full["alone", program.NOTHING]
    assert all(path in whole for path in program.LIKE_ANY_VALUE)
    for name, parts in program.ALONE.items():
        own = {path for part in parts for path in program.WITHOUT[part]}
        alone = full["alone", f"only {name}"]
        assert alone == nothing | {path: whole[path] for path in own}
        assert alone != nothing
    for part, values in program.WITHOUT.items():
        changed = full["without", f"without {part}"]
        assert {path for path in whole if whole[path] != changed[path]} <= set(values)
        assert changed != whole


def test_other_hands(programs: Any, tmp_path: Path, monkeypatch: Any, capsys: Any):
    program, _ = programs
    monkeypatch.setattr(program, "SBR", "joint_angle")  # neither has to be compiled for long
    monkeypatch.setattr(program, "METHOD", "joint_angle")
    settings = program.Settings(
        ("hands",), recordings=(MOMENT,), hands=(HAND,), workers=0, cache=tmp_path / "cache",
        output=tmp_path / "method.json",
    )  # fmt: skip
    program.main(settings)
    out = capsys.readouterr().out
    assert "| hand | recording | | cos thumb |" in out
    assert "|---|---|---|---:|" in out
    figures = json.loads(settings.output.read_text())["figures"]
    judged = {k.split("/")[-2]: v for k, v in figures.items() if "/better/" in k}
    assert judged["thumb cosine"] == 0  # no method is better than itself
    assert f"| `{HAND}` | {MOMENT} | thumb cosine |" in out
    assert f"{sum(v == 0 for v in judged.values())} of {len(judged)} lines" in out


def test_figures_are_written_as_in_the_document(programs: Any):
    _, variants = programs
    names = [column.metric for column in variants.COLUMNS]
    rows = [
        (0.99823, 0.98, 0.9646, 2.26e-6, 1.0, 0.0, None),
        (0.9, 0.5, 0.5, 6.9e-12, 0.5, 0.02, 7.64),
    ]
    figures = [dict(zip(names, row, strict=True)) for row in rows]
    assert variants.cells_of(figures) == [
        ".9982 / .9000", ".9800 / .5000", ".965 / .500", "2.3e-6 / 6.9e-12", "1.000 / .500",
        "0 / 2 %", "7.6",
    ]  # fmt: skip
    assert variants.cells_of(figures[:1]) == [
        "0.9982", "0.9800", "0.965", "2.3e-6", "1.000", "0 %", "–",
    ]  # fmt: skip


def test_what_was_not_measured_is_no_point(tmp_path: Path):
    nothing = {"flatness": None, "velocity_correlation": 0.9}
    assert np.isnan(FLATNESS.of(nothing))
    assert np.isnan(FLATNESS.of({"flatness": 0.0}))  # has no place on a logarithmic axis
    assert VELOCITY.of(nothing) == pytest.approx(0.1)
    assert COLLISION.of({"self_collision": {"share": 0.0}}) == 0
    for tried in ([nothing], [nothing, {"flatness": 1e-6, "velocity_correlation": 0.8}]):
        panel = TradeOff("x", FLATNESS, VELOCITY, tried, {"chosen": nothing}, {"other": nothing})
        save_trade_offs(tmp_path / "x.png", [[panel]])
        assert (tmp_path / "x.png").read_bytes().startswith(b"\x89PNG")


def test_names_of_points_cover_nothing():
    from matplotlib.figure import Figure
    from matplotlib.text import Text

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


# The constants


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


def test_the_constants_of_the_page_are_the_presets() -> None:
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
    left_out = {"alignment", "sampling", "objective.loss", "objective.transition"}
    rest = {path for path in settings if path not in seen and path.split(".")[0] not in left_out}
    calibrated = "objective.targets.pinch_gaps"  # of the operator, and empty without one
    added = "objective.terms"  # of a user, and empty without one
    assert (settings[calibrated], settings[added]) == ((), ())
    none = {"objective.pose_centre", "objective.velocity_loss", calibrated, added}
    assert rest - left_out == none


@pytest.mark.parametrize("method", ["smooth", "sbr"])
def test_the_constants_of_the_offline_presets_are_the_pages(method: str) -> None:
    config = method_config(method, "offline")
    assert isinstance(config, TrajectoryMethodConfig)
    values = {
        "w_a": [config.future.acceleration_weight],
        "w_m": [config.future.motion_weight],
        "v_0": [config.future.motion_speed],
        "ℓ": [config.jump, config.noise] if config.noise else [config.jump],
        "v_max": [config.future.speed_limit],
        "bridge": [config.bridge],
    }
    assert config.future.velocity_weight == config.future.jerk_weight == 0.0  # "0 here"
    for row in rows("| | | `smooth` | `sbr` |", APPENDIX):
        assert numbers(row[2 if method == "smooth" else 3]) == values.pop(row[0])
    assert not values
