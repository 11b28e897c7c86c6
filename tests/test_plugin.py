"""The example plugin in a Python environment of its own: each of its parts shows up and works."""

import json
import os
import re
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from plugin_environment import environment_with

from smooth_operator.synthetic import SyntheticOperator

PLUGIN = Path(__file__).resolve().parents[1] / "examples" / "plugin"
RATE = 50.0


@pytest.fixture(scope="module")
def python(tmp_path_factory) -> Path:
    """Python of an environment that has the plugin, and all that this one has."""
    return environment_with(tmp_path_factory.mktemp("plugin"), PLUGIN)


@pytest.fixture
def run(python, tmp_path) -> Callable[..., str]:
    """Runs commands in one process of that environment; gives what they print."""

    def run(*commands: str) -> str:
        main = f"""
from smooth_operator.cli import main
for command in {[command.split() for command in commands]!r}:
    assert main(command) == 0, command
"""
        done = subprocess.run(
            [python, "-c", main],
            cwd=tmp_path,
            env={**os.environ, "COLUMNS": "200"},
            capture_output=True,
            encoding="utf-8",
        )
        assert done.returncode == 0, done.stderr
        return done.stdout + done.stderr

    return run


def test_the_parts_of_a_plugin_show_up_and_work(run, tmp_path):
    recording = SyntheticOperator(seed=4, rate_hz=RATE).record(1.0)
    np.savetxt(tmp_path / "hand.csv", recording.landmarks.reshape(-1, 63), delimiter=",")
    choice = "--hand toy_gripper --method toy_descent"
    done = run(
        "hands list",
        f"retarget hand.csv --rate {RATE} {choice} --all --output out.npz",
        f"bench hand.csv --rate {RATE} --hands toy_gripper --methods toy_descent:all"
        " --latency-frames 0 --workers 0 --output bench",
        f"teleop {choice} --source wave:2,duration=1.5 --sink csv:out.csv mujoco"
        " --feedback lines:felt.txt --no-view --duration 1",
        *("--help", "teleop --help", "retarget --help", "joint-ranges toy_gripper"),
    )
    assert "joint-ranges" in done
    for name in ("wave", "csv"):
        assert re.search(rf"\b{name} +from toy-retargeting", done)
    assert "geort, toy_descent; or package.module:NAME" in done
    assert "toy_descent: from toy-retargeting" in done
    assert "t1 2.300\nt2 2.300\ni1 2.300\ni2 2.300\n" in done
    assert "toy_gripper" in done.partition("metric")[0]
    figures = json.loads((tmp_path / "bench" / "results.json").read_text())
    assert [row["preset"] for row in figures] == ["default", "quick"]
    for row in figures:
        assert row["status"] == "ok"
        assert 0.01 < row["metrics"]["joint_travel"] < 50.0
    assert "travel" in (tmp_path / "bench" / "report.html").read_text(encoding="utf-8")
    assert re.search(r"cosine +scale .* travel *$", done, re.MULTILINE)  # the table of bench
    assert re.search(r"joint_travel +[0-9.]+ +rad/s +↓", done)  # and in that of retarget
    with np.load(tmp_path / "out.npz") as commands:
        assert commands["joint_positions"].shape == (50, 4)
        assert np.ptp(commands["joint_positions"], axis=0).max() > 0.05
    assert (tmp_path / "felt.txt").read_text().splitlines()[-1] == "right 0.00 0.00"  # of silence
    rows = (tmp_path / "out.csv").read_text().splitlines()
    assert rows[0] == "side,number,positions"
    positions = np.array([row.split(",")[2].split() for row in rows[1:]], float)
    assert len(positions) > 10
    assert np.ptp(positions, axis=0).max() > 0.05


def test_a_layout_and_a_format_of_data_sets(python, tmp_path):
    for side in ("right", "left"):
        recording = SyntheticOperator(seed=4, side=side, rate_hz=RATE).record(0.2)
        (tmp_path / "take").mkdir(exist_ok=True)
        points = recording.landmarks.reshape(-1, 63)
        np.savetxt(tmp_path / "take" / f"{side}.csv", points, delimiter=",")
    code = f"""
from pathlib import Path
from smooth_operator.formats.registry import READERS
from smooth_operator.formats.clip import ReadingOptions
path = Path({str(tmp_path / "take")!r})
layout, = (name for name in READERS if READERS.load(name).matches(path))
ref, = READERS.load(layout).clips(path)
clip = READERS.load(layout).read(ref, ReadingOptions(rate={RATE}))
print(layout, READERS[layout].summary, len(clip), *clip.hands)

import numpy as np
from smooth_operator.types import CommandTrajectory
from smooth_hand_datasets.pipeline.clip import RobotClip
from smooth_hand_datasets.pipeline.writers.registry import WRITERS, WritingOptions
joints = np.arange(20.0).reshape(10, 2)
commands = CommandTrajectory(joints, ("a", "b"), clip.stamps, np.zeros(10), np.zeros(10, int))
with WRITERS.load("csv").open(Path({str(tmp_path / "tables")!r}), WritingOptions()) as writer:
    writer.write(RobotClip(clip, {{"left": commands}}, {{}}, {{}}, {{}}, key="one"))
"""
    done = subprocess.run([python, "-c", code], capture_output=True, encoding="utf-8")
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == "two_csv from toy-retargeting 10 right left"
    header, *rows = (tmp_path / "tables" / "one.csv").read_text().splitlines()
    assert header == "stamp,left.a,left.b"
    table = np.array([row.split(",") for row in rows], float)
    np.testing.assert_array_equal(table[:, 1:], np.arange(20.0).reshape(10, 2))
