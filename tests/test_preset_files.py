"""Settings by name, and preset files."""

from dataclasses import dataclass, replace
from typing import Any

import jax.numpy as jnp
import pytest

from smooth_operator.errors import ConfigError, UnknownNameError
from smooth_operator.retargeting import LeastSquaresTerm
from smooth_operator.retargeting.preset_files import (
    method_config,
    numeric_settings,
    read_preset_file,
    with_settings,
)
from smooth_operator.retargeting.presets import PRESETS
from smooth_operator.retargeting.sbr.method import SBR_REALTIME


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


WITH_TERM = replace(SBR_REALTIME, objective=replace(SBR_REALTIME.objective, terms=(TipDistance(),)))


def test_settings_of_an_added_term_have_a_path():
    assert numeric_settings(WITH_TERM)["objective.terms.0.distance"] == 0.04
    weight = {"objective.terms.0.weight": 5e3}
    changed = with_settings(WITH_TERM, {**weight, "objective.pose_weight": 0.5})
    assert changed.objective.terms == (TipDistance(weight=5e3),)
    assert changed.objective.pose_weight == 0.5
    with pytest.raises(UnknownNameError, match="distance"):
        with_settings(WITH_TERM, {"objective.terms.1.distance": 0.1})


def test_a_preset_file_stands_for_a_preset(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text(
        'format = 1\nmethod = "sbr"\nbase = "realtime"\n'
        '[settings]\n"objective.pose_weight" = 1e-05\n[made]\nby = "ünïcode"\nmore = { a = 1 }\n',
        encoding="utf-8",
    )
    assert read_preset_file(path).made == {"by": "ünïcode", "more": {"a": 1}}
    expected = with_settings(SBR_REALTIME, {"objective.pose_weight": 1e-5})
    assert method_config("sbr", str(path)) == expected
    with pytest.raises(ConfigError, match="method 'sbr', not of 'ako'"):
        method_config("ako", str(path))


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("format = 2", "format: expected 1, not 2"),
        ("format = 1\nmethod = 3\nbase = 'x'", "method: expected a string, not 3"),
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
