"""The table and the picture of how much tracker noise is removed; measuring is a stand-in here."""

from __future__ import annotations

from pathlib import Path

import pytest

from smooth_operator_research.judging import noise_front
from smooth_operator_research.judging.targets import TruthFigures


def row(error: float, kept: float, real: float) -> noise_front.Row:
    truth = TruthFigures(kept, kept + 0.1, 0.0, 1.0)
    return noise_front.Row(error, 2.0 + error, truth, 1 - kept, {"glove": (real, 0.9)})


ROWS = {
    0.0: row(2.0, 0.35, 0.964), noise_front.FIT_ALONE: row(1.1, 0.5, 0.963),
    0.003: row(0.8, 0.7, 0.96), 0.001: row(0.75, 0.8, 0.95),
}  # fmt: skip


def test_the_loss_is_that_of_the_worst_recording():
    off = noise_front.Row(2.0, 2.0, ROWS[0.0].truth, 0.9, {"a": (0.96, 0.9), "b": (0.9, 0.8)})
    now = noise_front.Row(1.0, 2.0, ROWS[0.0].truth, 0.5, {"a": (0.95, 0.9), "b": (0.93, 0.7)})
    assert now.loss(off, 0) == pytest.approx(0.01)
    assert now.loss(off, 1) == pytest.approx(0.1)
    assert noise_front.Row(1.0, 2.0, ROWS[0.0].truth, 0.5, {}).loss(off, 0) is None


def test_table_and_picture(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(noise_front, "measure", lambda value, sources, settings: ROWS[value])
    noise_front.main(noise_front.Settings((0.003, 0.001), output=tmp_path / "noise.json"))
    table = (tmp_path / "noise.md").read_text(encoding="utf-8").splitlines()
    assert [line.split("|")[1].strip() for line in table[4:]] == [
        "off", "fit alone", "0.003 m/s²", "0.001 m/s²"
    ]  # fmt: skip
    picture = (tmp_path / "noise.svg").read_text(encoding="utf-8")
    assert picture.count(">0.003 m/s²<") == 3  # a panel each
    assert "against the tracked landmarks" in picture
