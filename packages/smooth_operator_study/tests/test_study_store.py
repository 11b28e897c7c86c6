"""The store: nothing acknowledged is lost, nothing is in it that could not have happened."""

import csv
import io
import json
import os
import random
import sqlite3
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest
from processes import python
from study_writers import due, notes, small_plan, walk

from smooth_operator.errors import StudyError, UnknownNameError
from smooth_operator_study.data import read_study
from smooth_operator_study.store.events import (
    BreakEnded,
    BreakStarted,
    Calibrated,
    Noted,
    QuestionnaireAnswered,
    TrialReset,
    TrialScored,
    TrialStarted,
    TrialVoided,
    Undone,
    event_of,
)
from smooth_operator_study.store.export import export_study, study_json
from smooth_operator_study.store.nasa_tlx import SCALE_NAMES
from smooth_operator_study.store.progress import replay
from smooth_operator_study.store.study_store import StudyStore, open_study

WRITERS = Path(__file__).with_name("study_writers.py")
forks = pytest.mark.skipif(not hasattr(os, "fork"), reason="writers are forked")


@pytest.fixture
def store(tmp_path: Path) -> Iterator[StudyStore]:
    with open_study(tmp_path, small_plan(2)) as made:
        yield made


def score(store: StudyStore, operator: str, line: str, seconds: float = 9.5) -> TrialScored:
    progress = store.progress(operator)
    trial = progress.running
    place = (trial.block.task.name, trial.block.number, trial.number)
    return TrialScored(*place, line, progress.capped(line), seconds)


def test_an_operator_goes_through_the_protocol(store):
    walk(store, "P01")
    progress = store.progress("P01")
    blocks = store.plan.blocks("P01")
    assert [t.block for t in progress.trials] == [b for b in blocks for _ in range(3)]
    assert [t.number for t in progress.trials] == [1, 2, 3] * len(blocks)
    answered = progress.events(QuestionnaireAnswered)
    asked = [(event.task, event.block, event.point) for _, event in answered]
    assert asked == [
        (b.task.name, b.number, p) for b in blocks for p in ("initial", "midpoint", "final")
    ]
    kinds = [record.event.kind for record in progress.records]
    assert kinds.count("block_started") == len(blocks) == 6
    assert kinds.count("calibrated") == 2
    first = blocks[0]
    assert [k for k in kinds if k != "trial_reset"][:8] == [
        "calibrated",
        "block_started",
        "familiarisation_started",
        "familiarisation_ended",
        "trial_started",
        "trial_scored",
        "questionnaire_answered",
        "trial_started",
    ]
    assert first.questionnaires == {1: "initial", 2: "midpoint", 3: "final"}


def test_what_is_read_back_is_what_was_there(store, tmp_path):
    walk(store, "P01", "questionnaire")
    walk(store, "P01", "trial")
    running = store.progress("P01").running
    store.append("P01", TrialReset(*running.block.place, running.number))
    store.append("P01", Noted("glove slipped; 50 % \"quotes\" 手 'n' \n all"))
    with open_study(tmp_path) as again:  # as after a restart
        assert again.plan == store.plan
        assert again.progress("P01").step == store.progress("P01").step
        assert again.records("P01") == store.records("P01")
        assert again.progress("P01").trials == store.progress("P01").trials
        assert again.progress("P01").running.resets == 1
        walk(again, "P01")
    assert store.progress("P01").step.what == "done"  # the other one sees it, too


def test_a_reset_caps_the_score_and_there_is_one(store):
    walk(store, "P01", "start_trial")
    block = store.progress("P01").step.block
    place = (block.task.name, block.number, 1)
    store.append("P01", TrialStarted(*place))
    assert store.progress("P01").capped("done") == 1.0
    store.append("P01", TrialReset(*place))
    with pytest.raises(StudyError, match="may have 1 reset"):
        store.append("P01", TrialReset(*place))
    with pytest.raises(StudyError, match=r"'done' of the rubric scores 0.5 in this trial, not 1"):
        store.append("P01", TrialScored(*place, "done", 1.0, 12.0))
    with pytest.raises(UnknownNameError, match="Did you mean 'failed'"):
        store.append("P01", TrialScored(*place, "fialed", 0.0, 12.0))
    store.append("P01", TrialScored(*place, "done", 0.5, 12.0))
    assert store.progress("P01").trials[-1].score == 0.5


def test_undo_is_one_more_event(store):
    walk(store, "P01", "trial")
    running = store.progress("P01").step
    store.append("P01", score(store, "P01", "failed", 31.25))
    scored = store.records("P01")[-1]
    store.append("P01", Noted("wrong key"))
    assert store.progress("P01").undoable == scored
    with pytest.raises(StudyError, match=rf"event {scored.number} \(trial_scored\) can"):
        store.append("P01", Undone(scored.number - 1))
    store.append("P01", Undone(scored.number, "wrong key"))
    progress = store.progress("P01")
    assert progress.step == running
    assert progress.running.undone_time_s == 31.25
    assert notes(progress) == ["wrong key"]
    store.append("P01", score(store, "P01", "marginal", 31.25))
    kinds = [r.event.kind for r in store.records("P01")[-4:]]
    assert kinds == ["trial_scored", "noted", "undone", "trial_scored"]  # the trail
    assert store.records("P01")[-4] == scored
    assert [t.score for t in store.progress("P01").trials] == [0.5]


def test_everything_can_be_undone_back_to_the_beginning(store):
    walk(store, "P01", "questionnaire")
    store.append("P01", Noted("a remark"))
    while (last := store.progress("P01").undoable) is not None:
        store.append("P01", Undone(last.number))
    progress = store.progress("P01")
    assert progress.step.what == "calibrate"
    assert (progress.trials, progress.answered) == ([], set())
    walk(store, "P01")
    assert len(store.progress("P01").trials) == 18


def test_a_void_trial_is_done_again(store, tmp_path):
    walk(store, "P01", "trial")
    trial = store.progress("P01").running
    place = (trial.block.task.name, trial.block.number, 1)
    store.append("P01", TrialVoided(*place, "tracker lost"))
    step = store.progress("P01").step
    assert (step.what, step.trial) == ("start_trial", 1)
    walk(store, "P01")
    assert len(study_json(store)["trials"]) == 18
    assert study_json(store)["operators"][0]["voided"][0]["reason"] == "tracker lost"


def test_breaks_are_between_trials(store):
    walk(store, "P01", "trial")
    with pytest.raises(StudyError, match="a break can't begin: trial 1 in block 1"):
        store.append("P01", BreakStarted())
    store.append("P01", score(store, "P01", "done"))
    store.append("P01", BreakStarted())
    too_early = due(replay(store.plan, "P01", store.records("P01")[:-1]), random.Random(0))
    with pytest.raises(StudyError, match="not due; break in block 1"):
        store.append("P01", too_early)
    store.append("P01", BreakEnded())
    assert store.progress("P01").breaks[0][1] is not None


def test_a_page_left_open_changes_nothing(store):
    walk(store, "P01", "trial")
    stale = score(store, "P01", "done")
    store.append("P01", stale)
    walk(store, "P01", "trial")
    before = store.records("P01")
    with pytest.raises(StudyError, match="is for trial 1, but trial 2 is current; reload the page"):
        store.append("P01", stale)
    with pytest.raises(StudyError, match="not due; trial 2"):
        store.append("P01", Calibrated(stale.task))
    assert store.records("P01") == before


def test_the_same_event_sent_twice_is_written_once(store):
    task = store.plan.blocks("P01")[0].task.name
    first = store.append("P01", Calibrated(task), token="a1")
    assert store.append("P01", Calibrated(task), token="a1") == first
    assert len(store.records("P01")) == 1
    with pytest.raises(StudyError, match="belongs to another event"):
        store.append("P02", Calibrated(task), token="a1")


@pytest.mark.parametrize(
    ("kind", "values", "says"),
    [
        ("trial_scored", {"task": "A"}, "block: is missing; expected a whole number"),
        ("noted", {"text": "a", "colour": "red"}, "colour: no such entry"),
        ("danced", {}, "no event is called 'danced'"),
        ("undone", {"number": True}, "expected a whole number"),
        ("noted", {"text": "a\x00b"}, "expected a string"),
    ],
)
def test_what_is_no_event_is_refused(kind, values, says):
    with pytest.raises(StudyError, match=says):
        event_of(kind, values)


@pytest.mark.parametrize(
    ("ratings", "says"),
    [
        (dict.fromkeys(SCALE_NAMES, 52), "steps of 5, not 52"),
        (dict.fromkeys(SCALE_NAMES, 105), "0 to 100"),
        (dict.fromkeys(SCALE_NAMES[:5], 50), "missing: frustration"),
        (dict.fromkeys((*SCALE_NAMES, "boredom"), 50), "unknown: boredom"),
        (dict.fromkeys(SCALE_NAMES, 50.0), "not 50.0"),
    ],
)
def test_what_is_no_answer_is_refused(store, ratings, says):
    walk(store, "P01", "questionnaire")
    block = store.progress("P01").step.block
    with pytest.raises(StudyError, match=says):
        store.append(
            "P01", QuestionnaireAnswered(block.task.name, block.number, "initial", ratings)
        )


def test_events_can_be_neither_changed_nor_deleted(store, tmp_path):
    walk(store, "P01", "trial")
    file = sqlite3.connect(tmp_path / "study.db")
    for statement in (
        "UPDATE events SET payload = '{}'",
        "DELETE FROM events",
        "DELETE FROM plans",
        "UPDATE plans SET plan = ''",
    ):
        with pytest.raises(sqlite3.IntegrityError, match="append-only"):
            file.execute(statement)
    assert file.execute("PRAGMA journal_mode").fetchone() == ("wal",)
    file.close()


def test_a_log_with_a_gap_is_refused(store):
    walk(store, "P01", "trial")
    records = store.records("P01")
    with pytest.raises(StudyError, match="events of the log are missing"):
        replay(store.plan, "P01", [records[0], replace(records[1], number=3)])


def test_a_participant_is_erased(store, tmp_path):
    walk(store, "P01", "questionnaire")
    walk(store, "P02", "questionnaire")
    store.append("P01", Noted("left-handed pianist"))
    kept = store.records("P02")
    assert store.erase("P01") == len(kept) + 1
    for rest in tmp_path.iterdir():
        assert b"pianist" not in rest.read_bytes(), rest
    assert store.erased == ("P01",)
    assert store.plan.codes == ("P02",)
    assert store.records("P02") == kept
    assert store.records("P01") == []
    with pytest.raises(StudyError, match="was deleted on"):
        store.append("P01", Noted("again"))
    with pytest.raises(StudyError, match="under another code"):
        store.revise(store.plan.enrol("P01"))
    made = study_json(store)
    assert {row["operator"] for row in made["trials"]} == {"P02"}
    assert made["erased"] == ["P01"]


def test_operators_join_and_those_who_began_keep_their_rows(store, tmp_path):
    walk(store, "P01", "trial")
    with open_study(tmp_path) as other:
        store.revise(store.plan.enrol("P03", ["B"]))
        walk(other, "P03", "trial")
    assert store.progress("P03").number > 0
    swapped = [
        replace(e, rows={t: (r + 1) % 6 for t, r in e.rows.items()}) if e.code == "P01" else e
        for e in store.plan.enrolled
    ]
    with pytest.raises(StudyError, match="operator P01 has begun"):
        store.revise(replace(store.plan, enrolled=tuple(swapped)))
    with pytest.raises(UnknownNameError, match="operator 'P09'"):
        store.append("P09", Noted("who?"))


def test_a_plan_is_mended_until_someone_has_begun(store, tmp_path):
    shorter = replace(store.plan.protocol, familiarisation_s=7.0)
    with open_study(tmp_path, replace(store.plan, protocol=shorter)) as again:
        assert again.plan.protocol.familiarisation_s == 7.0
        assert store.plan.protocol.familiarisation_s == 7.0  # who has it open sees it, too
        walk(again, "P01", "familiarise")
        assert again.progress("P01").plan.protocol.familiarisation_s == 7.0
    longer = replace(shorter, familiarisation_s=8.0)
    with pytest.raises(StudyError, match="once an operator has begun"):
        open_study(tmp_path, replace(store.plan, protocol=longer))


def test_what_is_exported_is_read_by_the_analysis(store, tmp_path):
    for operator in store.plan.codes:
        walk(store, operator, seed=int(operator[1:]))
    files = export_study(store, tmp_path / "out")
    assert [f.name for f in files] == ["trials.csv", "tlx.csv", "study.json"]
    from_tables = read_study([tmp_path / "out"])
    from_json = read_study([tmp_path / "out" / "study.json"])
    assert len(from_tables.trials) == len(from_json.trials) == 2 * 18
    assert list(from_tables.trials.score) == list(from_json.trials.score)
    assert len(from_tables.questionnaires) == 2 * 18
    scored = store.progress("P01").trials
    row = list(csv.DictReader(io.StringIO((tmp_path / "out/trials.csv").read_text())))[4]
    assert row["retargeter"] == scored[4].block.condition.name
    assert (row["block"], row["trial_in_block"], row["trial_global"]) == ("2", "2", "5")
    assert float(row["score"]) == scored[4].score
    everything = json.loads((tmp_path / "out/study.json").read_text())
    assert everything["format"] == 1


def writers(what: str, target: str, folder: Path, count: int, most: int) -> None:
    done = python(WRITERS, what, target, folder, count, most, check=True)
    assert "Error" not in done.stderr, done.stderr


def acknowledged(folder: Path, operator: str) -> dict[int, str]:
    lines = (folder / f"{operator}.txt").read_text().splitlines()
    return {int(n): kind for n, kind in (line.split() for line in lines)}


def check_together(target: str, folder: Path, events: int) -> None:
    with open_study(target, small_plan()) as store:
        writers("together", target, folder, 20, events)
        for operator in store.plan.codes:
            stored = {r.number: r.event.kind for r in store.records(operator)}
            assert stored == acknowledged(folder, operator)
            assert sorted(stored) == list(range(1, events + 1))
            replay(store.plan, operator, store.records(operator))  # each was its turn


@forks
def test_twenty_sessions_at_once_into_sqlite(tmp_path):
    check_together(str(tmp_path), tmp_path, 12)


@forks
def test_a_killed_writer_loses_nothing_acknowledged(tmp_path):
    """Killed at random moments and started again, the session ends as if nothing had been."""
    target = str(tmp_path)
    plan = small_plan()
    with open_study(target, plan) as store:
        before = len(store.records("P01"))
        kills = 12
        writers("killed", target, tmp_path, kills, 4)
        told, stored = acknowledged(tmp_path, "P01"), store.records("P01")
        assert len(told) >= kills
        kinds = {r.number: r.event.kind for r in stored}
        assert all(kinds[number] == kind for number, kind in told.items())
        # At most one event a kill was written and its answer lost.
        assert len(kinds) - before - len(told) <= kills
        walk(store, "P01")
        assert [t.score is None for t in store.progress("P01").trials] == [False] * 18
    whole = sqlite3.connect(tmp_path / "study.db").execute("PRAGMA integrity_check")
    assert whole.fetchone() == ("ok",)


@pytest.mark.parametrize("name", ["a?b", "a?mode=ro", "a#b", "100%25", "50%", "a b&c=d"])
def test_the_database_is_in_the_folder_whatever_its_name(tmp_path, name):
    folder = tmp_path / name
    folder.mkdir()
    with open_study(folder, small_plan(2)) as made:
        made.append("P01", Noted("here"))
    assert [path.name for path in tmp_path.iterdir()] == [name]
    with sqlite3.connect(folder / "study.db") as database:
        assert database.execute("SELECT count(*) FROM events").fetchone() == (1,)
    with open_study(folder) as again:
        assert notes(again.progress("P01")) == ["here"]


@pytest.mark.skipif(os.name != "posix", reason="rights of POSIX")
def test_the_database_is_for_its_owner_alone(tmp_path):
    before = os.umask(0o000)
    try:
        with open_study(tmp_path, small_plan(2)) as made:
            made.append("P01", Noted("private"))
            files = {path.name: path.stat().st_mode & 0o777 for path in tmp_path.iterdir()}
        assert set(files) >= {"study.db", "study.db-wal"}
        assert set(files.values()) == {0o600}
        (tmp_path / "study.db").chmod(0o660)  # given to a group on purpose
        open_study(tmp_path).close()
        assert (tmp_path / "study.db").stat().st_mode & 0o777 == 0o660
    finally:
        os.umask(before)


def test_stores_that_can_not_be_opened(tmp_path):
    (tmp_path / "text.db").write_text("no database" * 100)
    with pytest.raises(StudyError, match=r"can't open the store .*not a database"):
        open_study(tmp_path / "text.db")
    with pytest.raises(StudyError, match="no folder"):
        open_study(tmp_path / "nowhere" / "study.db")
    with pytest.raises(StudyError, match="no study is stored here"):
        open_study(tmp_path)
    with sqlite3.connect(tmp_path / "newer.db") as database:
        database.execute("CREATE TABLE events (id INTEGER)")
        database.execute("PRAGMA user_version = 9")
    with pytest.raises(
        StudyError, match="in format 9, but this program reads 1: update the program"
    ):
        open_study(tmp_path / "newer.db")


@pytest.mark.parametrize(
    ("statement", "what"),
    [
        ("UPDATE events SET payload = '{'", "the stored event 1 is damaged"),
        ("UPDATE plans SET plan = '{'", "the stored plan is damaged"),
    ],
)
def test_a_damaged_database_is_refused_by_name(tmp_path, statement, what):
    with open_study(tmp_path, small_plan(2)) as made:
        made.append("P01", Noted("hello"))
    with sqlite3.connect(tmp_path / "study.db") as database:
        names = database.execute("SELECT name FROM sqlite_master WHERE type = 'trigger'")
        for (name,) in names.fetchall():
            database.execute(f"DROP TRIGGER {name}")
        database.execute(statement)
    with pytest.raises(StudyError, match=what), open_study(tmp_path) as damaged:
        damaged.progress("P01")
