"""A process that compiles for another: what it is given, and what comes of it."""

from __future__ import annotations

import dataclasses
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from smooth_operator import Retargeter, SyntheticOperator, load_hand, method_config
from smooth_operator.compilation import helper_process, kept_program
from smooth_operator.compilation.building import build_for_running_loop
from smooth_operator.compilation.helper_process import compile_in_helper
from smooth_operator.compilation.job_text import as_plain, from_plain
from smooth_operator.errors import ConfigError
from smooth_operator.hands.registry import hand_names
from smooth_operator.methods import shared
from smooth_operator.methods.presets import PRESETS

pytestmark = pytest.mark.usefixtures("few_optimisations")


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("SMOOTH_OPERATOR_CACHE", str(tmp_path))
    monkeypatch.setattr(shared, "_known", type(shared._known)())
    return tmp_path / "programs"


def again(value: object) -> Any:
    return from_plain(json.loads(json.dumps(as_plain(value))))


def test_every_method_and_hand_is_data() -> None:
    for presets in PRESETS.values():
        for config in presets.values():
            if type(config).__module__.startswith("smooth_operator."):
                assert again(config) == config
    for name in hand_names():
        spec = load_hand(name).spec
        assert again(spec) == spec
    values = {"a": (1.5, float("inf"), None), "b": frozenset({2}), Path("x"): [True]}
    assert again(values) == values
    array = np.arange(6, dtype=np.float32).reshape(2, 3)
    assert again(array).dtype == array.dtype
    np.testing.assert_array_equal(again(array), array)


def test_classes_of_others_are_neither_written_nor_made() -> None:
    with pytest.raises(ConfigError, match="can't be given"):
        as_plain(print)
    with pytest.raises(ConfigError, match="not of this package"):
        from_plain({"of": "subprocess:Popen", "fields": {"args": ["true"]}})
    with pytest.raises(ConfigError, match="neither a dataclass nor an enum"):
        from_plain({"of": "smooth_operator.methods.retargeter:Retargeter", "fields": {}})


def test_a_method_for_a_running_loop_is_compiled_elsewhere_and_read(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    hand, config = load_hand("mimic_p050"), method_config("joint_angle")
    here: list[object] = []
    compile_it = kept_program._compiled_and_kept
    monkeypatch.setattr(
        kept_program, "_compiled_and_kept", lambda *a: (here.append(a), compile_it(*a))[1]
    )
    built = build_for_running_loop(hand, config, 0)
    assert not here
    assert len(list(folder.glob("*.executable"))) == 1
    recording = SyntheticOperator().record(0.3)
    shared._known.clear()
    plain, _ = Retargeter(hand, config=config, cache=False).run(recording)
    np.testing.assert_array_equal(built.run(recording)[0].joint_positions, plain.joint_positions)

    for file in folder.iterdir():
        file.unlink()
    shared._known.clear()
    monkeypatch.setattr(sys, "executable", "/usr/bin/my_robot_app")  # which embeds Python
    monkeypatch.setattr(subprocess, "Popen", None)
    build_for_running_loop(hand, config, 0)
    assert len(here) == 1


def test_a_hand_that_was_changed_since_it_was_loaded_is_not_compiled(folder: Path) -> None:
    hand = load_hand("mimic_p050")
    other = dataclasses.replace(hand, neutral=hand.neutral + 0.01)
    assert not compile_in_helper(other, method_config("joint_angle"))
    assert not list(folder.glob("*.executable"))


def test_the_helper_ends_with_who_started_it() -> None:
    process = subprocess.Popen(
        [sys.executable, "-c", helper_process._CODE], **helper_process._pipes()
    )
    assert process.stdin is not None
    hand, config = load_hand("mimic_p050"), method_config("smooth")
    process.stdin.write((json.dumps(helper_process._job(hand, config)) + "\n").encode())
    process.stdin.close()
    assert process.wait(60) == 1


def test_settings_of_jax_reach_the_helper() -> None:
    job = helper_process._job(load_hand("mimic_p050"), method_config("smooth"))
    assert job["settings"]["jax_disable_most_optimizations"] is True  # by the fixture
