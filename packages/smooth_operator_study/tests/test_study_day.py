"""What departs from the plan on a day: corrections, pauses, withdrawals, stray clicks."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from fake_teleop import FakeSimulation, FakeTeleop
from study_console import command, console_plan, due_command, give, walk

from smooth_operator.errors import StudyError, UnknownNameError
from smooth_operator_study.console.session_service import Command, SessionService
from smooth_operator_study.design.plan import make_plan
from smooth_operator_study.design.protocol import RubricLine
from smooth_operator_study.store.events import Amended, TrialScored, Withdrawn
from smooth_operator_study.store.export import study_json
from smooth_operator_study.store.study_store import Clock, StudyStore, open_study


@pytest.fixture
def store(tmp_path: Path) -> Iterator[StudyStore]:
    with open_study(tmp_path, console_plan()) as made:
        yield made


@pytest.fixture
def service(store: StudyStore) -> SessionService:
    """A session of the first operator."""
    return SessionService(store, operator="P01")


def choose(service: SessionService, operator: str) -> None:
    asked = Command(f"choose-{operator}", "choose", operator, None, {})
    service.carry_out(asked, "experimenter")


class Hours:
    """A machine whose clocks are moved by hand."""

    def __init__(self) -> None:
        self.at = 1000.0

    def clock(self) -> Clock:
        return Clock(lambda: self.at, lambda: self.at)


def test_a_score_is_amended_in_a_later_trial_and_nothing_else_changes(service, store):
    walk(service, "questionnaire")
    walk(service, "trial")  # the second one; the questionnaire is answered
    before = store.progress("P01")
    place = {"task": "card", "block": 1, "trial": 1}
    give(service, "amend", **place, line="nearly", reason="saw the film", who="AB")
    progress = store.progress("P01")
    first = progress.trials[0]
    assert (first.line, first.score, first.time_s) == ("nearly", 0.5, before.trials[0].time_s)
    assert first.amended
    assert not progress.trials[1].amended
    assert progress.step == before.step
    assert progress.answered == before.answered
    ((record, amended, scoring),) = progress.amendments
    assert isinstance(record.event, Amended)
    assert (amended, scoring[:2]) == (first, ("done", 1.0))
    assert (record.event.line, record.event.score) == ("nearly", 0.5)
    assert (record.event.reason, record.event.who) == ("saw the film", "AB")
    scored = [r.event for r in progress.records if isinstance(r.event, TrialScored)]
    assert [event.line for event in scored] == ["done"]  # the log keeps what was given first
    give(service, "amend", **place, time_s=4.25, reason="stopped too late")
    assert store.progress("P01").trials[0].time_s == 4.25
    assert store.progress("P01").trials[0].line == "nearly"
    last = store.progress("P01").undoable
    give(service, "undo", number=last.number)
    assert store.progress("P01").trials[0].time_s == before.trials[0].time_s
    assert store.progress("P01").running is not None


def test_a_finished_operator_is_amended_within_the_rubric_and_the_cap(service, store):
    walk(service, "trial")
    give(service, "reset")
    walk(service, "done")
    place = {"task": "card", "block": 1, "trial": 1}
    give(service, "amend", **place, line="failed", reason="it fell")
    give(service, "amend", **place, line="done", reason="it did not")
    assert store.progress("P01").trials[0].score == 0.5  # there was a reset
    for fields, why in (
        ({**place, "line": "done", "reason": "again"}, "already"),
        ({**place, "line": "failed", "reason": " "}, "state the reason"),
        ({**place, "line": "faild", "reason": "x"}, "failed"),
        ({**place, "trial": 9, "line": "failed", "reason": "x"}, "was not scored"),
        ({**place, "time_s": -1.0, "reason": "x"}, "0 or more"),
    ):
        with pytest.raises((StudyError, UnknownNameError), match=why):
            give(service, "amend", **fields)
    assert len(store.progress("P01").amendments) == 2


def test_no_trial_is_amended_to_a_reset_that_it_did_not_have(tmp_path):
    plan = console_plan()
    line = RubricLine("done-after-reset", 0.5, "after all")
    task = replace(plan.protocol.tasks[0], rubric=(*plan.protocol.tasks[0].rubric, line))
    with open_study(tmp_path, make_plan(replace(plan.protocol, tasks=(task,)))) as store:
        service = SessionService(store, operator="P01")
        walk(service, "questionnaire")
        place = {"task": "card", "block": 1, "trial": 1, "reason": "x"}
        with pytest.raises(StudyError, match="needs a reset"):
            give(service, "amend", **place, line=line.name)


def test_a_page_that_has_not_seen_an_amendment_still_scores(service, store):
    walk(service, "start_trial")
    walk(service, "questionnaire")
    walk(service, "trial")
    old = store.progress("P01")
    give(service, "amend", task="card", block=1, trial=1, line="failed", reason="x")
    service.carry_out(command(old, "score", line="done"), "experimenter")
    stale = command(old, "amend", task="card", block=1, trial=1, line="nearly", reason="y")
    with pytest.raises(StudyError, match="in the meantime"):
        service.carry_out(stale, "experimenter")


def test_a_pause_does_not_count_in_the_time_of_a_trial(tmp_path):
    hours = Hours()
    with open_study(tmp_path, console_plan()) as store:
        store.clock = hours.clock()
        service = SessionService(store, operator="P01")
        walk(service, "trial")
        hours.at += 5
        give(service, "pause", reason="the robot tripped")
        assert store.progress("P01").step.what == "paused"
        with pytest.raises(StudyError, match="paused"):
            give(service, "score", line="done")
        hours.at += 100
        with open_study(tmp_path) as again:  # the console is killed and started meanwhile
            again.clock = hours.clock()
            restarted = SessionService(again)
            give(restarted, "resume")
            hours.at += 2
            give(restarted, "score", line="done")
        trial = store.progress("P01").trials[0]
        assert trial.time_s == 7.0
        assert [(length, why) for _, length, why in trial.pauses] == [(100.0, "the robot tripped")]


def test_a_simulation_stands_still_in_a_pause(tmp_path):
    hours, simulation = Hours(), FakeSimulation()

    def stands() -> bool:
        return bool(simulation.trial["paused"])

    with open_study(tmp_path, console_plan()) as store:
        store.clock = hours.clock()
        service = SessionService(store, operator="P01", teleop=simulation)
        walk(service, "trial")
        hours.at += 5
        give(service, "pause", reason="the glove slipped")
        assert stands()
        undoable = store.progress("P01").undoable
        give(service, "undo", number=undoable.number)  # the pause was a slip
        assert not stands()
        give(service, "pause", reason="now it did")
        assert stands()
        hours.at += 100
        again = SessionService(store, operator="P01", teleop=simulation)  # the console, restarted
        again.watch()
        give(again, "resume")
        assert not stands()
        simulation.done("not-done", 0.0, 30.0)
        again.watch()
        give(again, "score", line="failed")
        assert store.progress("P01").trials[0].time_s == 30.0  # its clock had stood, too


def test_a_block_that_ends_early_leaves_the_next_one_due(service, store):
    walk(service, "trial")
    with pytest.raises(StudyError, match="score or void"):
        give(service, "end_block", reason="no time")
    walk(service, "questionnaire")
    with pytest.raises(StudyError, match="state the reason"):
        give(service, "end_block", reason="")
    give(service, "end_block", reason="the glove broke")
    progress = store.progress("P01")
    assert progress.step.block == progress.blocks[1]
    (ended,) = study_json(store)["operators"][0]["ended_early"]
    assert (ended["block"], ended["reason"]) == (1, "the glove broke")
    blocks = service.look()[0]["overview"][0]["blocks"]
    assert [block["state"] for block in blocks] == ["left", "on"]
    last = progress.undoable
    give(service, "undo", number=last.number)
    assert store.progress("P01").step.what == "questionnaire"


def test_the_hand_is_calibrated_again_between_trials_only(store, tmp_path):
    teleop = FakeTeleop()
    service = SessionService(store, operator="P01", teleop=teleop)
    walk(service, "trial")
    with pytest.raises(StudyError, match="trial 1"):
        give(service, "recalibrate", detail="new.json")
    walk(service, "questionnaire")
    file = tmp_path / "new.json"
    file.write_text("{}")
    give(service, "recalibrate", detail=str(file))
    asked = [fields for do, fields in teleop.asked if do == "calibration"]
    assert asked == [{"path": str(file)}]
    (again,) = study_json(store)["operators"][0]["recalibrations"]
    assert (again["task"], again["detail"]) == ("card", str(file))
    assert store.progress("P01").step.what == "questionnaire"


def test_who_withdraws_ends_whatever_was_on_and_can_be_replaced(store):
    kept = []
    service = SessionService(store, operator="P01", enrolled=kept.append)
    walk(service, "questionnaire")
    walk(service, "trial")
    give(service, "withdraw", keep=False, reason="felt dizzy")
    shown, tablet = service.look()
    assert [block["state"] for block in shown["overview"][0]["blocks"]] == ["next", "next"]
    assert tablet["what"] == "done"
    progress = store.progress("P01")
    assert (progress.step.what, progress.busy, progress.begun) == ("withdrawn", False, None)
    assert (progress.withdrawn.keep, progress.withdrawn.reason) == (False, "felt dizzy")
    assert [trial.void is not None for trial in progress.trials] == [False, True]
    with pytest.raises(StudyError, match="already"):
        give(service, "withdraw", keep=True, reason="")
    service.carry_out(Command("enrol-P09", "enrol", "P09", None, {}), "experimenter")
    assert service.operator == "P09"
    assert store.plan.enrolment("P09").rows == store.plan.enrolment("P01").rows
    assert kept[-1] == store.plan
    walk(service, "done")


def test_a_withdrawal_is_undone_with_the_trial_that_ran(service, store):
    walk(service, "trial")
    give(service, "withdraw", keep=True, reason="")
    last = store.progress("P01").undoable
    give(service, "undo", number=last.number)
    assert store.progress("P01").step.what == "trial"


def test_who_comes_later_gets_the_row_of_who_was_left_out(store):
    for code in ("P03", "P04", "P05"):
        service = SessionService(store, operator="P01")
        service.carry_out(Command(f"enrol-{code}", "enrol", code, None, {}), "experimenter")
    rows = {code: dict(store.plan.enrolment(code).rows) for code in store.plan.codes}
    other = next(code for code in rows if rows[code] != rows["P05"])
    for gone in (other, next(c for c in rows if c != other and rows[c] == rows[other])):
        store.append(gone, Withdrawn(False))
    for code in ("P06", "P07", "P08"):
        service.carry_out(Command(f"enrol-{code}", "enrol", code, None, {}), "experimenter")
        assert store.plan.enrolment(code).rows == rows[other]


def test_no_other_operator_is_chosen_during_a_trial_or_free_movement(tmp_path):
    teleop = FakeTeleop()
    with open_study(tmp_path, console_plan(seconds=60.0)) as store:
        service = SessionService(store, operator="P01", teleop=teleop)
        for step in ("familiarise", "trial"):
            walk(service, step)
            switched = len(teleop.switched)
            with pytest.raises(
                StudyError, match="card, block 1 of operator P01 is in progress; end it"
            ):
                choose(service, "P02")
            enrol = Command(f"enrol-{step}", "enrol", f"P-{step}", None, {})
            service.carry_out(enrol, "experimenter")
            assert store.plan.codes[-1] == f"P-{step}"
            service.watch()
            assert service.operator == "P01"
            assert len(teleop.switched) == switched
        choose(service, "P01")  # which changes nothing
        assert SessionService(store).operator == "P01"  # a console that was started again
        give(service, "score", line="done")
        choose(service, "P02")
        walk(service, "start_familiarisation")
        assert SessionService(store).operator == "P02"


def test_the_workload_is_not_shown_before_its_block_is_over(service, store):
    walk(service, "questionnaire")
    walk(service, "trial")
    view, _ = service.look()
    assert [e["text"] for e in view["log"] if e["kind"] == "questionnaire_answered"] == [
        "Questionnaire (initial) answered"
    ]
    while store.progress("P01").step.block == store.progress("P01").blocks[0]:
        asked = due_command(store.progress("P01"))
        service.carry_out(asked, "experimenter")
    view, _ = service.look()
    texts = [e["text"] for e in view["log"] if e["kind"] == "questionnaire_answered"]
    assert all("workload" in text for text in texts)
    assert "workload" in view["now"]["undoable"]["text"]


def test_a_block_keeps_what_the_hand_said_it_runs(store):
    teleop = FakeTeleop()
    service = SessionService(store, operator="P01", teleop=teleop)
    walk(service, "trial")
    assert store.progress("P01").begun_with == (teleop.method, teleop.preset)


def test_a_restarted_console_knows_what_the_hand_answered(store):
    """Also where the plan leaves the preset to the method, and the hand calls it otherwise."""
    first = {code: store.plan.blocks(code)[0].condition for code in store.plan.codes}
    operator = next(code for code, condition in first.items() if condition.preset is None)

    class Renamed(FakeTeleop):
        def request(self, do: str, **fields: Any) -> dict[str, Any]:
            answer = super().request(do, **fields)
            if do == "method" and "preset" not in fields:
                self.preset = "house"
            return {**answer, "preset": self.preset}

    teleop = Renamed()
    walk(SessionService(store, operator=operator, teleop=teleop), "trial")
    switched, written = len(teleop.switched), store.progress(operator).number
    restarted = SessionService(store, teleop=teleop)
    restarted.watch()
    assert len(teleop.switched) == switched
    assert store.progress(operator).number == written
    walk(restarted, "questionnaire")
    walk(restarted, "trial")
    assert len(teleop.switched) == switched


def test_what_the_simulation_proposed_stays_when_it_is_overruled(store):
    simulation = FakeSimulation()
    service = SessionService(store, operator="P01", teleop=simulation)
    walk(service, "trial")
    simulation.done("done", 1.0, 12.25)
    service.watch()
    give(service, "score", line="failed")
    event = store.records("P01")[-1].event
    assert isinstance(event, TrialScored)
    assert (event.line, event.score) == ("failed", 0.0)
    assert (event.proposed_line, event.proposed_score) == ("done", 1.0)


def test_undone_events_are_counted_by_condition(service, store):
    walk(service, "questionnaire")
    for _ in range(2):
        last = store.progress("P01").undoable
        give(service, "undo", number=last.number)
    condition = store.progress("P01").blocks[0].condition.name
    assert store.progress("P01").undone() == {condition: 2}
