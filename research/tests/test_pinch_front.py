"""The table and the picture of what pinch damping buys; measuring is a stand-in but in one test."""

from dataclasses import replace

import pytest

from smooth_operator.retargeting.preset_files import method_config
from smooth_operator_research.judging import pinch_front
from smooth_operator_research.run_report import BenchmarkError


def stand_in(task: pinch_front.Task) -> dict[str, float | None]:
    held = 0.9 if task.method == "smooth" else 0.5
    return {
        "held": held,
        "dropped": 1 - held,
        "let_go": None,
        "cos thumb": 0.99,
        "motion": 0.9 - 1e-4 * float(task.config.pinch_damping if held > 0.5 else 1000),
        "vel. corr.": 0.95,
    }


def test_table_and_picture(tmp_path, monkeypatch):
    monkeypatch.setattr(pinch_front, "measure", stand_in)
    pinch_front.main(
        pinch_front.Settings(
            damping=(0.0, 300.0), methods=("sbr", "ako"), workers=0, output=tmp_path / "front.json"
        )
    )
    table = (tmp_path / "front.md").read_text(encoding="utf-8").splitlines()
    rows = [line.split("|")[1].strip() for line in table if line.startswith("|")]
    names = ["pinch_damping, or method", "---", "0", "300", "sbr", "ako"]
    assert rows == 2 * names  # the recording, and the mean
    picture = (tmp_path / "front.svg").read_text(encoding="utf-8")
    assert picture.count(">300<") == 2
    assert ">share dropped<" in picture


def test_rows_are_the_presets():
    rows = pinch_front.rows_of(pinch_front.Settings())
    assert rows["100"] == ("smooth", method_config("smooth"))
    assert rows["1000"] == ("smooth", replace(method_config("smooth"), pinch_damping=1000.0))
    assert set(rows) >= {"30", "1000", "sbr", "dexpilot"}


def test_a_recording_that_is_missing_ends_the_run(tmp_path):
    settings = pinch_front.Settings(
        damping=(0.0,), methods=(), data=tmp_path, workers=0, output=tmp_path / "front.json"
    )
    with pytest.raises(BenchmarkError, match=r"manus_right.*no such file"):
        pinch_front.main(settings)


@pytest.mark.weekly
def test_a_row_is_measured():
    found = pinch_front.measure(
        pinch_front.Task("sbr", "sbr", method_config("sbr"), "mimic_p050", "synthetic:1@:500")
    )
    assert set(found) == {*pinch_front.PINCH, *pinch_front.FOLLOWING}
    assert 0.0 <= (found["held"] or 0.0) <= 1.0
    assert (found["motion"] or 0.0) > 0.3
