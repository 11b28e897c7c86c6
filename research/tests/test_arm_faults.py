"""The fault run of ``research/benchmarks/arm_faults.py``, once around and short."""

import importlib.util
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.weekly

pytest.importorskip("mink", reason="the extra arm is not installed")
pytest.importorskip("daqp", reason="the extra arm is not installed")

PROGRAM = Path(__file__).resolve().parents[1] / "benchmarks" / "arm_faults.py"


def test_no_fault_passes_a_limit_and_no_return_jumps(monkeypatch):
    spec = importlib.util.spec_from_file_location("arm_faults", PROGRAM)
    program = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, "arm_faults", program)
    spec.loader.exec_module(program)
    assert len(program.KINDS) >= 20
    report = program.run("ur5e", "leap_hand", rounds=1, seed=1, short=True)
    assert program.failures(report) == [], report
    assert report["returns"] >= 15
