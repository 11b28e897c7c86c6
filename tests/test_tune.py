"""Tuning: settings by name, preset files, recordings that are held out, the search, its journal."""

import json
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

from smooth_operator import HandRecording, Retargeter
from smooth_operator.cli import main
from smooth_operator.errors import ConfigError, OutputError, UnknownNameError
from smooth_operator.formats.setting_paths import (
    PresetFile,
    find_setting,
    numeric_settings,
    read_preset_file,
    with_settings,
)
from smooth_operator.lab.benchmark.recordings import Source, load_sources, parse_request
from smooth_operator.lab.tuning import TuningSettings, plan_tuning, tune
from smooth_operator.lab.tuning.search_plan import Bound, Scoring, check_held_out, parse_variable
from smooth_operator.lab.tuning.tune import TracedRun, write_preset_file
from smooth_operator.methods.presets import PRESETS, method_config
from smooth_operator.methods.sbr import SBR_REALTIME, SbrConfig
from smooth_operator.objective import LeastSquaresTerm
from smooth_operator.solvers.newton import NewtonConfig
from smooth_operator.solvers.sampling import SamplingConfig
from smooth_operator.synthetic import SyntheticOperator

pytest.importorskip("optuna", reason="needs optuna: in the clone, pip install '.[tune]'")

TINY = SbrConfig(
    sampling=SamplingConfig(samples=32, elites=8, cycles=2, draws="quasi"),
    polish=NewtonConfig(iterations=2, damping=(0.0, 1.0)),
    settle_rounds=4,
)


def test_settings_are_found_by_the_end_of_their_path():
    assert find_setting(SBR_REALTIME, "pose_weight") == "objective.pose_weight"
    assert find_setting(SBR_REALTIME, "targets.blend") == "objective.targets.blend"
    with pytest.raises(ConfigError, match=r"polish\.iterations.*approach|several"):
        find_setting(PRESETS["sbr"]["offline"], "iterations")
    with pytest.raises(UnknownNameError, match="pose_weight"):
        find_setting(SBR_REALTIME, "pose_wieght")


def test_settings_are_replaced_and_checked():
    changed = with_settings(SBR_REALTIME, {"objective.pose_weight": 0.5, "sampling.samples": 99.6})
    assert changed.objective.pose_weight == 0.5
    assert changed.sampling.samples == 100
    assert SBR_REALTIME.objective.pose_weight == 0.049
    assert replace(changed, objective=SBR_REALTIME.objective, sampling=SBR_REALTIME.sampling) == (
        SBR_REALTIME
    )
    with pytest.raises(ConfigError, match="pose_weight"):
        with_settings(SBR_REALTIME, {"objective.pose_weight": -1.0})
    assert "future.acceleration_weight" in numeric_settings(PRESETS["sbr"]["offline"])


@dataclass(frozen=True)
class TipDistance(LeastSquaresTerm):
    """A term that a user adds: two fingertips are kept apart."""

    weight: float = 20_000.0
    distance: float = 0.04

    def points(self) -> tuple[str, ...]:
        return ("index_tip", "middle_tip")

    def residuals(self, points: Any, goal: Any) -> Any:
        gap = jnp.linalg.norm(points[0] - points[1])
        return jnp.sqrt(self.weight) * jnp.maximum(self.distance - gap, 0.0)[None]


WITH_TERM = replace(TINY, objective=replace(TINY.objective, terms=(TipDistance(),)))


def test_settings_of_an_added_term_have_a_path():
    assert find_setting(WITH_TERM, "distance") == "objective.terms.0.distance"
    variable = parse_variable("terms.0.weight=1e3:1e5:log", WITH_TERM)
    assert (variable.path, variable.start) == ("objective.terms.0.weight", 20_000.0)
    changed = with_settings(WITH_TERM, {variable.path: 5e3, "objective.pose_weight": 0.5})
    assert changed.objective.terms == (TipDistance(weight=5e3),)
    assert changed.objective.pose_weight == 0.5
    with pytest.raises(UnknownNameError, match="distance"):
        with_settings(WITH_TERM, {"objective.terms.1.distance": 0.1})


def test_settings_can_be_arguments_of_a_program():
    """Of the method and of an added term, as constants give them."""
    recording = SyntheticOperator(seed=2).record(0.3)
    paths = ("objective.terms.0.weight", "objective.terms.0.distance", "objective.pose_weight")
    traced = TracedRun(Retargeter("shadow_dexee", config=WITH_TERM), paths)
    near, far = (dict(zip(paths, (20_000.0, gap, 0.2), strict=True)) for gap in (0.02, 0.09))
    constant = Retargeter("shadow_dexee", config=with_settings(WITH_TERM, far))
    commands = traced.run(recording, far)
    expected, _ = constant.run(recording)
    np.testing.assert_allclose(commands.joint_positions, expected.joint_positions, atol=2e-3)
    np.testing.assert_array_equal(commands.status, expected.status)
    moved = commands.joint_positions - traced.run(recording, near).joint_positions
    assert np.abs(moved).max() > 0.05


def test_variables():
    v = parse_variable("pose_weight=0.01:1:log", SBR_REALTIME)
    assert (v.path, v.log, v.whole) == ("objective.pose_weight", True, False)
    assert v.rounded(0.123456789) == 0.123457
    assert v.rounded(0.0099999999) == 0.01  # within the bounds
    whole = parse_variable("samples=10:20", SBR_REALTIME)
    assert whole.rounded(12) == 12
    assert parse_variable("pose_weight=0.1:1", SBR_REALTIME).start == 0.1  # not beyond the bounds


@pytest.mark.parametrize(
    "text", ["pose_weight", "pose_weight=1", "pose_weight=2:1", "pose_weight=a:b",
             "pose_weight=0:1:log", "pose_weight=0:1:lin", "samples=1.2:1.8"],
)  # fmt: skip
def test_what_is_no_variable_is_refused(text):
    with pytest.raises(ConfigError):
        parse_variable(text, SBR_REALTIME)


def test_a_preset_file_stands_for_a_preset(tmp_path):
    path = tmp_path / "mine.toml"
    made = {"by": 'a "test"', "score": -0.5, "tuned_on": ["glove", "ünïcode"], "more": {"a": 1}}
    write_preset_file(path, PresetFile("sbr", "realtime", {"objective.pose_weight": 1e-05}, made))
    assert read_preset_file(path).made == made
    expected = with_settings(SBR_REALTIME, {"objective.pose_weight": 1e-5})
    assert method_config("sbr", str(path)) == expected
    with pytest.raises(ConfigError, match="method 'sbr', not of 'ako'"):
        method_config("ako", str(path))


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("format = 2", "format: expected 1, not 2"),
        ("format = 1\nmethod = 3\nbase = 'x'", "method: expected a text, not 3"),
        (
            "format = 1\nmethod = 'sbr'\nbase = 'realtime'\n[settings]\na = 'b'",
            "settings.a: expected a finite",
        ),
        (
            "format = 1\nmethod = 'sbr'\nbase = 'realtime'\n[settings]\na = nan",
            "settings.a: expected a finite",
        ),
        ("format = 1\nmethod = 'sbr'\nbase = 'realtime'\n[settings]\nnone = 1.0", "'none'"),
        ("format = 1\nmethod = 'sbr'\nbase = 'other.toml'", "name of a preset"),
        ("format = 1\nmethod = 'sbr'\nbase = 'realtime'\nmore = 1", "more: no such entry"),
        ("{", "TOML"),
    ],
)
def test_a_preset_file_that_is_none_is_refused(tmp_path, text, reason):
    path = tmp_path / "mine.toml"
    path.write_text(text)
    with pytest.raises((ConfigError, UnknownNameError), match=reason):
        method_config("sbr", str(path))


def test_a_preset_file_that_is_not_there(tmp_path):
    with pytest.raises(ConfigError, match="no preset file"):
        method_config("sbr", str(tmp_path / "none.toml"))


def named(recording: HandRecording, name: str) -> Source:
    return replace(
        load_sources([parse_request("synthetic:1@:2")])[0], recording=recording, name=name
    )


@pytest.fixture(scope="module")
def held() -> Source:
    return load_sources([parse_request("synthetic:1@:200")])[0]


def moved(recording: HandRecording) -> np.ndarray:
    turn = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
    return recording.landmarks @ turn.T + 0.3


@pytest.mark.parametrize(
    "change",
    [
        lambda r: r,
        lambda r: r[40:60],
        lambda r: r[::5],
        lambda r: replace(r, landmarks=r.landmarks.astype(np.float32).astype(float)),
        lambda r: replace(r, landmarks=r.landmarks * [-1, 1, 1]),
        lambda r: replace(r, landmarks=moved(r)),
        lambda r: replace(r, stamps=r.stamps * 3),
    ],
    ids=["whole", "slice", "thinned", "float32", "mirrored", "moved", "other stamps"],
)
def test_what_is_held_out_is_known_again(held, change):
    with pytest.raises(ConfigError, match="held out for judging"):
        check_held_out([named(change(held.recording), "innocent")], [held])


def test_other_frames_of_the_same_operator_are_not_held_out(held):
    others = load_sources([parse_request(t) for t in ("synthetic:1@300:600", "synthetic:2@:200")])
    check_held_out(others, [held])


def test_the_command_refuses_what_is_held_out(tmp_path, capsys):
    words = ["tune", "sbr", "synthetic:1@50:90", "--held-out", "synthetic:1@:100", "--vary",
             "pose_weight=0.01:0.1", "--output", str(tmp_path / "out")]  # fmt: skip
    assert main(words) == 2
    assert "held out" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


START = {"cosine_similarity": 0.9, "flatness": 1e-6, "rate_hz": 115.0, "lag_ms": 0.0,
         "max_joint_step": 0.1, "frozen_share": 0.0, "motion_preservation": None}  # fmt: skip


def test_the_score_is_relative_to_the_start():
    scoring = Scoring({"flatness": 2.0}, ())
    assert scoring.score([START, START], [START, START]) == 0.0
    flatter = START | {"flatness": 0.5e-6}
    assert scoring.score([flatter], [START]) == pytest.approx(2 * np.log(0.5), abs=1e-2)
    assert scoring.score([flatter, START], [START, START]) == pytest.approx(np.log(0.5), abs=1e-2)
    assert Scoring({"flatness": 0.0}, ()).score([flatter], [START]) == 0.0


def test_what_breaks_a_bound_is_worse_than_what_does_not():
    late = START | {"lag_ms": 2e3 / 115, "flatness": 1e-8}
    assert Scoring({}, ()).score([late], [START]) > 0
    assert Scoring({}, (Bound("lag_frames", 2.1),)).score([late], [START]) < 0
    below = Scoring({}, (Bound("cosine_similarity", 0.95, True),))
    assert below.score([START], [START]) > 0
    with pytest.raises(UnknownNameError, match="flatness"):
        Scoring({"flattness": 1.0}, ())
    with pytest.raises(UnknownNameError):
        Scoring({}, (Bound("lag", 1.0),))


def settings(folder: Path, **changes: Any) -> TuningSettings:
    made: dict[str, Any] = {
        "output": folder, "method": "sbr", "preset": "tiny", "recordings": ("synthetic:4@:40",),
        "vary": ("pose_weight=0.005:0.2:log", "velocity_weight=0.02:0.5:log"), "trials": 7,
        "workers": 0,
    }  # fmt: skip
    return TuningSettings(**made | changes)


@pytest.fixture(scope="module")
def tuned(tmp_path_factory) -> Any:
    folder = tmp_path_factory.mktemp("tuned") / "out"
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(PRESETS["sbr"], "tiny", TINY)
        yield folder, tune(plan_tuning(settings(folder)))


def test_a_search_leaves_a_preset_that_can_be_used(tuned):
    folder, found = tuned
    assert (found.trials, found.fresh) == (7, 7)
    assert found.score < Scoring({}, ()).score(found.start, found.start)
    config = method_config("sbr", str(folder / "preset.toml"))
    assert config == with_settings(TINY, found.values)
    assert read_preset_file(folder / "preset.toml").made["tuned_on"] == ["synthetic-right-4[0:40]"]
    result = json.loads((folder / "result.json").read_text())
    figures = result["recordings"]["synthetic-right-4[0:40]"]
    assert figures["best"]["cosine_similarity"] == found.best[0]["cosine_similarity"]


def test_a_search_goes_on_where_it_was_stopped(tuned, tmp_path):
    folder, whole = tuned
    again = tune(plan_tuning(settings(folder)))
    assert (again.fresh, again.values, again.score) == (0, whole.values, whole.score)

    def stop(count: int, best: float, reason: str | None) -> None:
        if count == 4:
            raise KeyboardInterrupt

    todo = plan_tuning(settings(tmp_path / "stopped"))
    with pytest.raises(KeyboardInterrupt):
        tune(todo, stop)
    assert (tmp_path / "stopped" / "preset.toml").exists()
    with (tmp_path / "stopped" / "trials.jsonl").open("ab") as file:
        file.write(b'{"op_code": 5, "tri')  # as a killed process leaves it
    rest = tune(todo)
    assert (rest.fresh, rest.values, rest.score) == (3, whole.values, whole.score)
    (tmp_path / "stopped" / "trials.jsonl").write_text("no trial\n")
    with pytest.raises(OutputError, match="other than trials"):
        tune(todo)


def test_a_search_finds_a_minimum_and_repeats_itself(tmp_path, monkeypatch):
    goal = np.log([0.02, 0.5])  # one of them at its bound
    trials: list[tuple[float, ...]] = []

    def run_trial(task: Any) -> list[dict[str, Any]]:
        trials.append(tuple(task.values.values()))
        if len(trials) % 4 == 0:
            raise ConfigError("this one can't be")
        distance = (np.log(trials[-1]) - goal) / np.log([40.0, 25.0])  # shares of the box
        return [START | {"flatness": 1e-6 * float(distance @ distance)}]

    monkeypatch.setitem(PRESETS["sbr"], "tiny", TINY)
    module = sys.modules[tune.__module__]
    monkeypatch.setattr(module, "run_trial", run_trial)
    found = tune(plan_tuning(settings(tmp_path / "one", trials=100)))
    assert found.trials == found.fresh == len(trials) == 100
    best = np.log(list(found.values.values())) - goal
    assert np.abs(best / np.log([40.0, 25.0])).max() < 0.05
    assert (np.array(trials) >= [0.005, 0.02]).all()
    assert (np.array(trials) <= [0.2, 0.5]).all()
    tune(plan_tuning(settings(tmp_path / "two", trials=100)))
    assert trials[:100] == trials[100:]


def test_what_cannot_be_traced_is_compiled_and_what_cannot_be_is_left_out(tuned, tmp_path):
    # escape below project can't be, and targets look at their weights while they are compiled
    reasons: list[str | None] = []
    found = tune(
        plan_tuning(
            settings(
                tmp_path / "out",
                vary=("escape=0.001:0.05", "w_thumb=1:2"),
                trials=2,
                recordings=("synthetic:4@:10",),
            )
        ),
        lambda count, best, reason: reasons.append(reason),
    )
    assert found.trials == len(reasons) == 2
    assert reasons[0] is None
    assert all(reason is None or "project <= escape" in reason for reason in reasons)


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"vary": ()}, "what to vary"),
        ({"vary": ("pose_weight=0:1", "objective.pose_weight=0:2")}, "twice"),
        ({"fix": {"pose_weight": 0.1}}, "twice"),
        ({"trials": 1}, "2 trials"),
        ({"recordings": ()}, "recording"),
        ({"preset": "none"}, "none"),
        ({"hand": "no_hand"}, "no_hand"),
    ],
)
def test_what_cannot_be_is_said_before_anything_is_tried(tuned, tmp_path, changes, reason):
    with pytest.raises((ConfigError, UnknownNameError), match=reason):
        plan_tuning(settings(tmp_path / "out", **changes))
    assert not (tmp_path / "out").exists()


def test_a_folder_with_something_else_is_left_alone(tuned, tmp_path):
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(OutputError, match="something other"):
        plan_tuning(settings(tmp_path))
