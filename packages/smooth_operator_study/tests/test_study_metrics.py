"""Simulation metrics of a study from its own takes."""

import csv
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from study_console import command, console_plan, due_command
from ticks import make_tick

from smooth_operator.cli import main
from smooth_operator.hands.registry import load_hand
from smooth_operator.teleop.sinks.record import RecordSink
from smooth_operator_study.console.session_service import SessionService
from smooth_operator_study.data import read_study
from smooth_operator_study.design.plan_file import write_plan_files
from smooth_operator_study.store.study_store import open_study

SECONDS = 1.0


@pytest.fixture
def study(tmp_path: Path) -> Path:
    """A study with two trials, of which the first has 1 s, and the second is void."""
    folder = tmp_path / "study"
    folder.mkdir()
    plan = console_plan(3)
    write_plan_files(plan, folder)
    with open_study(folder, plan) as store:
        service = SessionService(store, operator="P01")
        while store.progress("P01").step.what != "questionnaire":
            asked = due_command(store.progress("P01"))
            service.carry_out(asked, "experimenter")
        place = {"task": "card", "block": 1, "trial": 1}
        fields = {**place, "time_s": SECONDS, "reason": "as in the film"}
        service.carry_out(command(store.progress("P01"), "amend", **fields), "experimenter")
    return folder


def record(folder: Path, hand_name: str = "mimic_p050", begin: float = -1.0) -> None:
    """Three seconds from a moment on [s from now]; the hand opens and closes."""
    hand = load_hand("mimic_p050")
    sink = RecordSink(folder)
    sink.open({"right": hand}, {"hand": hand_name, "fingers": None})
    now = time.perf_counter() + begin
    for i in range(300):
        tick = make_tick(hand, i, at=now + 0.01 * i, frame=True)
        tick = replace(
            tick,
            command=replace(
                tick.command,
                joint_positions=hand.full_configuration(hand.neutral + 0.1 * np.sin(0.05 * i)),
            ),
        )
        sink.send(tick)
    sink.close()


def refused(capsys: pytest.CaptureFixture[str], *words: str) -> str:
    assert main(["study", "metrics", *words]) == 2
    return capsys.readouterr().err


def test_takes_are_cut_to_trials_and_measured(study, capsys):
    record(study / "takes")
    main(["study", "metrics", str(study)])
    assert "1 rows from 1 trials" in capsys.readouterr().err
    (row,) = csv.DictReader((study / "sim_metrics.csv").open(encoding="utf-8"))
    with open_study(study) as store:
        block = store.plan.blocks("P01")[0]
    assert (row["operator"], row["retargeter"]) == ("P01", block.condition.name)
    values = {name: float(row[name]) for name in list(row)[2:] if row[name]}
    assert len(row) == 8
    assert -1.0 <= values["cosine_similarity"] <= 1.0
    assert values["scale_ratio"] > 0.0
    assert 0.0 < values["workspace_utilisation"] < 1.0
    metrics = read_study([study]).metrics  # as study analyze STUDY
    assert metrics is not None
    assert metrics.retargeter.tolist() == [row["retargeter"]]


def test_what_can_not_be_measured_is_said(study, capsys):
    assert "no takes in" in refused(capsys, str(study))
    record(study / "late", begin=500.0)
    assert "recorded at other times" in refused(capsys, str(study), "--takes", str(study / "late"))
    record(study / "odd", hand_name="mimic_p051")
    said = refused(capsys, str(study), "--takes", str(study / "odd"))
    assert "take-001.mcap" in said
    assert "mimic_p051" in said
