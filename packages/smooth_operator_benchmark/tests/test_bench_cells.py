"""Metrics of single fingers, the order of cells, and what makes a stored cell stale."""

from types import SimpleNamespace
from typing import Any

import pytest
from test_metrics_fingers import HANDS, played_back

from smooth_operator import load_hand, result_cache
from smooth_operator.metrics import evaluate
from smooth_operator.retargeting.preset_files import method_config
from smooth_operator.retargeting.sbr.method import SbrConfig
from smooth_operator_benchmark.cells import Cell, Settings, fingerprint
from smooth_operator_benchmark.quality import PER_FINGER, finger_metrics
from smooth_operator_benchmark.suite import longest_first


@pytest.mark.parametrize(("name", "fingers"), HANDS)
def test_figures_finger_by_finger(name, fingers):
    hand = load_hand(name, fingers=fingers)
    trace = played_back(hand, off=0.1)
    table = finger_metrics(trace, evaluate(trace))
    assert tuple(table) == hand.fingers
    wrong = [finger for finger, row in table.items() if row["tip_error_mm"] > 1]
    assert len(wrong) == 1  # the last joint moves one finger
    for finger, row in table.items():
        assert set(row) == {metric.name for metric in PER_FINGER}
        assert (row["reach_cosine"] < 1 - 1e-7) == (finger in wrong), (finger, row)
        assert (row["thumb_cosine"] is None) == (finger == "thumb")


def test_long_recordings_come_first():
    jobs: list[Any] = [SimpleNamespace(effort=frames) for frames in (2, 5, 3)]
    assert [job.effort for job in longest_first(jobs)] == [5, 3, 2]


def test_a_cell_is_measured_again_when_the_code_of_its_plugin_changes(monkeypatch, tmp_path):
    file = tmp_path / "own_method.py"
    file.write_text(
        "from dataclasses import dataclass\n"
        "from smooth_operator.retargeting.sbr.method import SbrConfig\n"
        "@dataclass(frozen=True)\n"
        "class OwnConfig(SbrConfig):\n    pass\n"
        "CONFIG = OwnConfig()\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    source: Any = SimpleNamespace(side="right", digest="frames")
    settings = Settings(output=tmp_path, methods=("own_method:CONFIG",))
    own, built_in = (
        Cell(source, "mimic_p050", "x", "default", config)
        for config in (method_config("own_method:CONFIG"), SbrConfig())
    )
    before = fingerprint(own, settings), fingerprint(built_in, settings)
    file.write_text(file.read_text() + "# another\n")
    result_cache._package_digest.cache_clear()
    after = fingerprint(own, settings), fingerprint(built_in, settings)
    assert after[0] != before[0]
    assert after[1] == before[1]
