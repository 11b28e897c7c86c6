"""Files of version 0.1.0, written here without the package's writers, are still read.

Recordings, MCAP logs, HDF5 files and LeRobot datasets of that version are in ``test_recording`` and
``test_convert``.
"""

from __future__ import annotations

import json
import sqlite3
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from smooth_operator import Status, load_hand, method_config, read_commands
from smooth_operator.calibration.operator_file import read_operator
from smooth_operator.formats.setting_paths import find_setting, with_settings
from smooth_operator.lab.benchmark import read_results
from smooth_operator.methods.method import TrajectoryMethodConfig
from smooth_operator.study.design.plan_file import read_plan
from smooth_operator.study.store.study_store import open_study


def test_commands(tmp_path: Path) -> None:
    names = load_hand("mimic_p050").joint_names
    positions = np.linspace(0, 1, 60).reshape(3, 20)
    np.savez(
        tmp_path / "out.npz",
        joint_positions=positions,
        joint_names=np.array(names),
        timestamps=np.array([0.0, 0.02, 0.04]),
        latency_ms=np.array([3.0, 0.5, 0.5]),
        status=np.array([0, 1, 0], np.int8),
        status_names=np.array(["OK", "INVALID_LANDMARKS", "DEGENERATE_PALM", "SOLVER_FAILED"]),
    )
    commands = read_commands(tmp_path / "out.npz")
    assert commands.joint_names == names
    assert np.array_equal(commands.joint_positions, positions)
    assert commands.status.tolist() == [Status.OK, Status.INVALID_LANDMARKS, Status.OK]


PRESET = """
format = 1
method = "sbr"
base = "realtime"

[settings]
"objective.pose_weight" = 0.031
"objective.targets.w_thumb" = 1.3

[made]
by = "smooth-operator tune"
hand = "mimic_p050"
trials = 2
score = 0.0
tuned_on = ["hand[0:60]"]
tuned_on_frames = ["89fe9665fba2525317716294f906a8c7566eb4fb02823c0e98d1afbdc6aa4c2b"]
held_out = []
"""


def test_a_preset(tmp_path: Path) -> None:
    path = tmp_path / "preset.toml"
    path.write_text(PRESET, encoding="utf-8")
    config: Any = method_config("sbr", str(path))
    assert (config.objective.pose_weight, config.objective.targets.w_thumb) == (0.031, 1.3)
    assert config.sampling == method_config("sbr", "realtime").sampling  # type: ignore[attr-defined]


SMOOTH = """
format = 1
method = "smooth"
base = "teleop"

[settings]
"clearance.weight" = 6000.0
"polar.length" = 100.0
"landmarks.lag" = 0.002
"motion_weight" = 1200.0
"""


def test_a_preset_of_smooth_with_its_old_settings(tmp_path: Path) -> None:
    path = tmp_path / "preset.toml"
    path.write_text(SMOOTH, encoding="utf-8")
    config: Any = method_config("smooth", str(path))
    assert (config.self_collision.weight, config.direction_length.length) == (6000.0, 100.0)
    assert (config.landmarks.time_constant, config.motion_weight) == (0.002, 1200.0)


def finger(name: str) -> dict[str, Any]:
    thumb = name == "thumb"
    return {
        "robot": f"{name}_dp",
        "bones": [0.0437, 0.0242, 0.0209],
        "reach": 0.0885,
        "robot_reach": 0.0965,
        "scale": 1.0911,
        "tip_along": -0.0005,
        "tip_pad": -0.0002,
        "pinch_gap": None if thumb else 0.0015,
        "pinch_gap_after": None if thumb else 0.0001,
    }


@pytest.mark.parametrize("method", ["smooth", "sbr"])
def test_the_former_name_of_a_setting_of_the_offline_presets(method: str) -> None:
    config = method_config(method, "offline")
    assert find_setting(config, "leap") == "jump"
    changed = with_settings(config, {"leap": 0.07})
    assert isinstance(changed, TrajectoryMethodConfig)
    assert changed.jump == 0.07
    # In a causal preset the name is that of a setting of the landmark filter, as it was.
    assert find_setting(method_config("smooth"), "leap") == "landmarks.jump_threshold"


def test_an_operator(tmp_path: Path) -> None:
    written = {
        "format": "smooth-operator operator",
        "version": 1,
        "hand": "mimic_p050",
        "side": "right",
        "scale": 0.789,
        "palm_width": 0.0653,
        "palm_length": 0.0913,
        "palm_rotation": [1.0, 0.0, 0.0, 0.0],
        "fingers": {name: finger(name) for name in ("thumb", "index", "middle", "ring", "pinky")},
        "project": 0.01,
        "escape": 0.015,
        "apply": ["scale", "pinch"],
        "source": "hand",
    }
    path = tmp_path / "operator.json"
    path.write_text(json.dumps(written), encoding="utf-8")
    operator = read_operator(path)
    assert operator.scale == 0.789
    assert operator.has("pinch")


def test_results_of_bench(tmp_path: Path) -> None:
    row = {
        "recording": "hand[0:150]",
        "hand": "mimic_p050",
        "side": "right",
        "method": "joint_angle",
        "preset": "default",
        "status": "ok",
        "reason": None,
        "metrics": {"cosine_similarity": 0.95, "latency_ms": {"p50": 0.03}},
    }
    path = tmp_path / "results.json"
    path.write_text(json.dumps([row]), encoding="utf-8")
    (read,) = read_results(path)
    assert read["metrics"]["cosine_similarity"] == 0.95


PLAN: dict[str, Any] = {
    "format": 1,
    "name": "two",
    "baseline": "dexpilot",
    "operators": 2,
    "familiarisation_s": 120.0,
    "break_s": 120.0,
    "questionnaires": ["initial", "midpoint", "final"],
    "weights": False,
    "resets": 1,
    "reset_cap": 0.5,
    "task_order": "balanced",
    "seed": 0,
    "conditions": {
        "sbr": {"method": "sbr", "preset": "paper", "label": "Maple"},
        "dexpilot": {"method": "dexpilot", "preset": "published", "label": "Oak"},
    },
    "tasks": {
        "A": {
            "trials": 4,
            "rubric": [
                {"name": "done", "score": 1.0, "text": "done as instructed"},
                {"name": "failed", "score": 0.0, "text": "the object was dropped"},
            ],
        }
    },
    "orders": {"1": ["sbr", "dexpilot"], "2": ["dexpilot", "sbr"]},
    "enrolled": {"P01": {"A": 2}, "P02": {"A": 1}},
}


def toml(value: Any) -> str:
    """A value in TOML, tables inline."""
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{key} = {toml(item)}" for key, item in value.items()) + " }"
    if isinstance(value, list):
        return f"[{', '.join(map(toml, value))}]"
    return json.dumps(value)


def test_a_plan_of_a_study(tmp_path: Path) -> None:
    path = tmp_path / "study.toml"
    path.write_text("\n".join(f"{key} = {toml(PLAN[key])}" for key in PLAN), encoding="utf-8")
    plan = read_plan(path)
    assert [block.condition.name for block in plan.blocks("P01")] == ["dexpilot", "sbr"]


SCHEMA = """
CREATE TABLE studies (id INTEGER NOT NULL PRIMARY KEY, name TEXT NOT NULL UNIQUE,
    format INTEGER NOT NULL, created_at TEXT NOT NULL);
CREATE TABLE plans (id INTEGER NOT NULL PRIMARY KEY, study_id INTEGER NOT NULL, at TEXT NOT NULL,
    plan TEXT NOT NULL, FOREIGN KEY(study_id) REFERENCES studies (id));
CREATE TABLE participants (id INTEGER NOT NULL PRIMARY KEY, study_id INTEGER NOT NULL,
    operator TEXT NOT NULL, created_at TEXT NOT NULL, erased_at TEXT,
    UNIQUE (study_id, operator), FOREIGN KEY(study_id) REFERENCES studies (id));
CREATE TABLE events (id INTEGER NOT NULL PRIMARY KEY, study_id INTEGER NOT NULL,
    operator TEXT NOT NULL, number INTEGER NOT NULL, kind TEXT NOT NULL, at TEXT NOT NULL,
    author TEXT NOT NULL, token TEXT, payload TEXT NOT NULL, UNIQUE (study_id, operator, number),
    UNIQUE (study_id, token), FOREIGN KEY(study_id) REFERENCES studies (id));
"""


def test_a_store_of_a_study(tmp_path: Path) -> None:
    at = "2026-11-22T15:21:55.678869+00:00"
    begun = [("calibrated", {"task": "A", "detail": ""})]
    begun += [("block_started", {"task": "A", "block": 1, "condition": "dexpilot"})]
    database = sqlite3.connect(tmp_path / "study.db")
    database.executescript(SCHEMA)
    database.execute("INSERT INTO studies VALUES (1, 'two', 1, ?)", (at,))
    database.execute("INSERT INTO plans VALUES (1, 1, ?, ?)", (at, json.dumps(PLAN)))
    database.execute("INSERT INTO participants VALUES (1, 1, 'P01', ?, NULL)", (at,))
    for number, (kind, payload) in enumerate(begun, 1):
        row = (number, number, kind, at, json.dumps(payload))
        database.execute(
            "INSERT INTO events VALUES (?, 1, 'P01', ?, ?, ?, 'experimenter', NULL, ?)", row
        )
    database.commit()
    database.close()
    with open_study(tmp_path) as store:
        assert store.progress("P01").step.what == "start_familiarisation"
