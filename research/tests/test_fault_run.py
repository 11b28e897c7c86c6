"""The fault run of ``research/benchmarks/teleop.py``."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.weekly

BENCHMARKS = Path(__file__).resolve().parents[1] / "benchmarks"


@pytest.mark.skipif(sys.platform == "win32", reason="ends processes by POSIX signals")
def test_nothing_bad_happens_when_everything_goes_wrong(tmp_path):
    output = tmp_path / "faults.json"
    program = [sys.executable, "teleop.py", "--faults", "--seconds", "12"]
    done = subprocess.run(
        [*program, "--method", "joint_angle", "--output", str(output)],
        cwd=BENCHMARKS,
        capture_output=True,
        text=True,
        timeout=1200,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr  # every check on the recording held
    figures = json.loads(output.read_text())["figures"]
    assert figures["run/glove_starts"] >= 2
    assert figures["run/robot_starts"] >= 2
