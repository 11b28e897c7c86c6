"""The console of a study without a browser: what was acknowledged is stored, and stored once."""

import contextlib
import http
import json
import re
import signal
import sys
import threading
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import replace
from datetime import timedelta
from importlib import resources
from pathlib import Path
from typing import Any

import pytest
from fake_teleop import FakeSimulation, FakeTeleop
from study_console import (
    PATIENCE_S,
    ConsoleProcess,
    Tab,
    command,
    console_plan,
    due_command,
    eventually,
    fetch,
    give,
    ratings,
    served,
    walk,
)

from smooth_operator.cli import main
from smooth_operator.errors import RemoteRefusedError, StudyError, UnknownNameError
from smooth_operator_study.console.server import ConsoleAuth, auth_for, qr_code
from smooth_operator_study.console.session_service import (
    SessionService,
    StoreFailedError,
    command_of,
)
from smooth_operator_study.console.switching import HIDDEN
from smooth_operator_study.design.plan import Plan
from smooth_operator_study.design.plan_file import read_plan, write_plan_files
from smooth_operator_study.store.events import Noted, TrialScored
from smooth_operator_study.store.study_store import Clock, StudyStore, open_study


@pytest.fixture
def store(tmp_path: Path) -> Iterator[StudyStore]:
    with open_study(tmp_path, console_plan()) as made:
        yield made


@pytest.fixture
def service(store: StudyStore) -> SessionService:
    """A session of the first operator."""
    return SessionService(store, operator="P01")


def kinds(store: StudyStore, operator: str = "P01") -> list[str]:
    return [record.event.kind for record in store.records(operator)]


def test_every_command_that_is_sent_twice_is_done_once(service, store):
    sent = []
    while (asked := due_command(store.progress("P01"))) is not None:
        numbers = {service.carry_out(asked, "experimenter") for _ in range(2)}
        assert len(numbers) == 1
        sent.append(asked)
    for asked in sent:  # long after, from a page that was asleep
        service.carry_out(asked, "experimenter")
    counted = Counter(kinds(store))
    assert counted["trial_scored"] == counted["trial_started"] == 6
    assert counted["questionnaire_answered"] == 6
    assert len(store.records("P01")) == len(sent)
    assert store.progress("P01").step.what == "done"


def test_a_token_of_another_command_is_refused(service, store):
    first = command(store.progress("P01"), "calibrated")
    service.carry_out(first, "experimenter")
    thief = command(store.progress("P01"), "start_block", token=first.token)
    with pytest.raises(StudyError, match="belongs to another"):
        service.carry_out(thief, "experimenter")
    assert kinds(store) == ["calibrated"]


def test_of_two_tabs_that_do_the_same_one_is_refused(tmp_path):
    with open_study(tmp_path, console_plan(resets=2)) as store:
        service = SessionService(store, operator="P01")
        walk(service, "start_trial")
        for do, other in (("start_trial", "start_trial"), ("reset", "reset"), ("score", "void")):
            fields = {"score": {"line": "done"}, "void": {"reason": "x"}}
            seen = store.progress("P01")
            service.carry_out(command(seen, do, **fields.get(do, {})), "experimenter")
            with pytest.raises(StudyError, match="another page"):
                service.carry_out(command(seen, other, **fields.get(other, {})), "experimenter")
        (trial,) = store.progress("P01").trials
        assert (trial.line, trial.resets, trial.void) == ("done", 1, None)


def test_a_note_never_stands_in_the_way(service, store):
    seen = store.progress("P01")
    service.carry_out(command(seen, "note", text="left hand is cold"), "experimenter")
    service.carry_out(command(seen, "calibrated"), "experimenter")
    service.carry_out(command(seen, "note", text="warm now"), "experimenter")
    assert kinds(store) == ["noted", "calibrated", "noted"]


def test_a_command_for_somebody_who_is_not_on_is_refused(store):
    service = SessionService(store, operator="P02")
    with pytest.raises(StudyError, match="for operator P01, but operator P02 is selected"):
        service.carry_out(command(store.progress("P01"), "calibrated"), "experimenter")
    assert kinds(store) == []


@pytest.mark.parametrize(
    ("said", "why"),
    [
        ({"do": "note"}, "token"),
        ({"token": "x" * 7, "do": "note"}, "token"),
        ({"token": "x" * 16, "do": "drop tables"}, "no such command"),
        ({"token": "x" * 16, "do": "note", "fields": []}, "fields"),
        ({"token": "x" * 16, "do": "note", "after": True}, "after"),
        ({"token": "x" * 16, "do": "note", "waited_s": -1}, "waited_s"),
        ({"token": "x" * 16, "do": "note", "waited_s": float("nan")}, "waited_s"),
    ],
)
def test_what_is_no_command_is_refused(said, why):
    with pytest.raises(StudyError, match=why):
        command_of(said, "experimenter")


def test_the_operators_page_answers_and_nothing_else(store):
    for role, commands in (
        ("operator", ("start_trial", "undo", "choose", "note")),
        ("experimenter", ("answer", "form")),
    ):
        for do in commands:
            with pytest.raises(StudyError, match=f"the {role}'s page is not allowed to do"):
                command_of({"token": "x" * 16, "do": do, "operator": "P01"}, role)
    service = SessionService(store, operator="P01")
    walk(service, "questionnaire")
    give(service, "answer", ratings=ratings(1), role="operator")
    assert store.records("P01")[-1].author == "operator"


@pytest.mark.parametrize(
    ("step", "waited_s", "time_s"),
    [(-600.0, 0.0, 12.5), (0.0, 2.5, 10.0), (3600.0, 3600.0, 0.0)],  # at most the whole trial
)
def test_a_trial_ends_when_its_clock_was_stopped_whatever_the_machines_says(
    store, step, waited_s, time_s
):
    day, steady = 1_700_000_000.0, 5_000.0
    store.clock = Clock(lambda: day, lambda: steady)
    service = SessionService(store, operator="P01")
    walk(service, "trial")
    day, steady = day + 12.5 + step, steady + 12.5
    give(service, "score", line="done", waited_s=waited_s)
    progress = store.progress("P01")
    assert progress.trials[-1].time_s == time_s
    assert progress.records[-1].at - progress.trials[-1].started == timedelta(seconds=12.5)


def test_a_score_that_is_undone_keeps_its_time(service, store):
    walk(service, "trial")
    give(service, "score", line="failed")
    first = store.records("P01")[-1]
    assert isinstance(first.event, TrialScored)
    give(service, "undo", number=first.number, reason="wrong key")
    give(service, "score", line="nearly")
    again = store.records("P01")[-1].event
    assert isinstance(again, TrialScored)
    assert (again.time_s, again.score) == (first.event.time_s, 0.5)
    log = service.look()[0]["log"]
    assert [entry["undone"] for entry in log[:3]] == [False, False, True]
    assert "wrong key" in log[1]["text"]


def test_after_a_reset_lines_above_the_cap_are_off(service):
    walk(service, "trial")
    assert [line["possible"] for line in service.look()[0]["now"]["rubric"]] == [True] * 3
    give(service, "reset")
    now = service.look()[0]["now"]
    assert [line["possible"] for line in now["rubric"]] == [False, True, True]
    assert now["resets_left"] == 0


def test_the_time_left_is_of_the_work_that_is_left(tmp_path):
    """It neither rises from step to step nor falls while everybody waits for ten minutes."""
    steady = 0.0
    with open_study(tmp_path, console_plan(seconds=120.0)) as store:
        store.clock = Clock(lambda: 1.7e9, lambda: steady)
        service, shown = SessionService(store, operator="P01"), []
        while True:
            shown.append(service.look()[0]["now"]["minutes_left"])
            if (asked := due_command(store.progress("P01"))) is None:
                break
            steady += 600.0 if asked.do in ("start_block", "start_familiarisation") else 20.0
            service.carry_out(asked, "operator" if asked.do == "answer" else "experimenter")
    assert shown == sorted(shown, reverse=True)
    assert (shown[0], shown[-1]) == (18, 0)  # 2 x (180 s, 3 trials, 3 questionnaires), a break


def test_free_movement_ends_by_itself_and_once(tmp_path):
    with open_study(tmp_path, console_plan(seconds=0.3)) as store:
        service = SessionService(store, operator="P01")
        walk(service, "familiarise")
        assert eventually(service.tick, "the end of free movement")
        with open_study(tmp_path) as other:  # as after a restart
            assert not SessionService(other, operator="P01").tick()
        last = store.records("P01")[-1]
        assert (last.event.kind, last.author) == ("familiarisation_ended", "system")
        give(service, "undo", number=last.number)
        assert not service.tick()  # whoever undoes it wants it to go on
        assert store.progress("P01").step.what == "familiarise"


def test_a_restarted_console_is_on_whoever_was(store):
    assert SessionService(store).operator is None
    walk(SessionService(store, operator="P01"), "trial")
    walk(SessionService(store, operator="P02"), "start_block")
    service = SessionService(store)
    assert service.operator == "P02"
    with pytest.raises(UnknownNameError):
        SessionService(store, operator="P99")


def test_enrolling_on_the_page_is_stored_and_kept(store):
    plans: list[Plan] = []
    service = SessionService(store, operator="P01", enrolled=plans.append)
    enrol = command_of(
        {"token": "x" * 16, "do": "enrol", "operator": "P03", "fields": {"tasks": ["card"]}},
        "experimenter",
    )
    service.carry_out(enrol, "experimenter")
    service.carry_out(enrol, "experimenter")
    assert store.plan.codes == ("P01", "P02", "P03")
    assert [plan.codes for plan in plans] == [("P01", "P02", "P03")]
    assert service.operator == "P03"


def test_each_block_switches_the_hand(store):
    teleop = FakeTeleop()
    service = SessionService(store, operator="P01", teleop=teleop)
    walk(service, "done")
    blocks = store.plan.blocks("P01")
    known = {"sbr": {"method": "sbr", "preset": "realtime"}, "dexpilot": {"method": "dexpilot"}}
    assert teleop.switched == [known[block.condition.method] for block in blocks]


def test_the_hand_goes_at_the_rate_of_the_plan(tmp_path):
    class Paced(FakeTeleop):
        rate = 100.0

        def request(self, do: str, **fields: Any) -> dict[str, Any]:
            if do == "rate":
                self.rate = fields["rate"]
            return {**super().request(do, **fields), "rate": self.rate}

    plan = console_plan()
    plan = replace(plan, protocol=replace(plan.protocol, rate_hz=30.0))
    with open_study(tmp_path, plan) as store:
        teleop = Paced()
        service = SessionService(store, operator="P01", teleop=teleop)
        walk(service, "trial")
        assert teleop.rate == 30.0
        assert [do for do, _ in teleop.asked].count("rate") == 1
        teleop.rate = 100.0  # it was started again
        service.watch()
        assert teleop.rate == 30.0
        assert service.look()[0]["study"]["rate_hz"] == 30.0


def test_no_block_starts_on_a_hand_that_was_not_switched(store):
    teleop, said = FakeTeleop(), []
    service = SessionService(store, operator="P01", teleop=teleop, blind=True, report=said.append)
    walk(service, "start_block")
    teleop.refusing = True
    start = command(store.progress("P01"), "start_block")
    with pytest.raises(StudyError, match=HIDDEN):
        service.carry_out(start, "experimenter")
    assert kinds(store) == ["calibrated"]
    assert said == ["teleop: dexpilot needs four fingers"]
    assert service.look()[0]["teleop"]["state"] == "refused"
    assert "dexpilot" not in json.dumps(service.look())
    teleop.refusing = False
    service.carry_out(start, "experimenter")
    assert kinds(store) == ["calibrated", "block_started"]
    assert service.look()[0]["teleop"]["state"] == "ready"


def test_a_hand_that_was_started_again_is_put_back_on_its_method(store):
    teleop = FakeTeleop()
    service = SessionService(store, operator="P01", teleop=teleop)
    walk(service, "trial")
    block = store.progress("P01").begun
    teleop.gone = True
    service.watch()
    assert service.look()[0]["teleop"]["state"] == "gone"
    assert kinds(store)[-1] == "trial_started"
    teleop.gone, teleop.method, teleop.preset = False, "geort", "default"
    service.watch()
    assert teleop.method == block.condition.method
    note = store.records("P01")[-1]
    assert isinstance(note.event, Noted)
    assert note.author == "system"
    count = len(teleop.switched)
    service.watch()
    assert len(teleop.switched) == count  # it runs what it should
    # A console that was killed does not know its preset.
    SessionService(store, teleop=teleop).watch()
    assert teleop.method == block.condition.method


def test_no_trial_starts_while_the_hand_is_gone(store):
    teleop = FakeTeleop()
    service = SessionService(store, operator="P01", teleop=teleop)
    walk(service, "start_trial")
    teleop.gone = True
    with pytest.raises(StudyError, match=r"the trial does not start: .*nobody answers"):
        give(service, "start_trial")
    assert store.progress("P01").step.what == "start_trial"


def test_a_calibration_is_loaded_and_loaded_again(store, tmp_path):
    class Calibrated(FakeTeleop):
        source = None

        def request(self, do: str, **fields: Any) -> dict[str, Any]:
            if do == "calibration" and not Path(fields["path"]).is_file():
                self.asked.append((do, fields))
                raise RemoteRefusedError("no such file")
            self.source = fields["path"] if do == "calibration" else self.source
            return {**super().request(do, **fields), "operators": {"right": self.source}}

    teleop = Calibrated()
    service = SessionService(store, operator="P01", teleop=teleop)
    missing = command(store.progress("P01"), "calibrated", detail="nobody.json")
    with pytest.raises(StudyError, match="not loaded into the hand: no such file"):
        service.carry_out(missing, "experimenter")
    assert kinds(store) == []
    file = tmp_path / "P01.json"
    file.touch()
    give(service, "calibrated", detail=str(file))
    walk(service, "trial")
    assert [do for do, _ in teleop.asked].count("calibration") == 2  # one of them in vain
    teleop.method, teleop.source = "geort", None  # it was started again
    service.watch()
    assert teleop.source == str(file)


def test_trials_of_a_simulation_go_with_those_of_the_protocol(store):
    simulation = FakeSimulation()
    service = SessionService(store, operator="P01", teleop=simulation, blind=True)

    def proposed() -> dict[str, Any]:
        service.watch()
        return service.look()[0]["teleop"]["trial"]

    walk(service, "start_trial")
    assert simulation.task == "card"  # the scene of the block's task
    walk(service, "trial")
    assert proposed()["phase"] == "running"
    about = next(fields["about"] for do, fields in simulation.asked if fields.get("begin"))
    assert (about["operator"], about["trial"]) == ("P01", 1)
    give(service, "reset")
    simulation.done("done-after-reset", 0.5, 12.25)
    assert (proposed()["score"], proposed()["time_s"]) == (0.5, 12.25)
    give(service, "score", line="nearly")
    assert store.progress("P01").trials[-1].time_s == 12.25  # by the scene's clock
    walk(service, "trial")
    give(service, "void", reason="tracker lost")
    assert simulation.trial["phase"] == "ready"
    walk(service, "trial")
    first = service.look()[0]["now"]["undoable"]["number"]
    give(service, "undo", number=first)
    walk(service, "trial")  # that of the simulation still ran
    give(service, "score", line="failed")
    assert simulation.trial["phase"] == "done"  # the experimenter has the last word
    assert store.progress("P01").trials[-1].time_s != 30.0


def test_a_simulated_trial_is_not_taken_for_another(store):
    simulation = FakeSimulation()
    # The console had no teleoperation then.
    walk(SessionService(store, operator="P01"), "trial")
    simulation.task = "card"
    simulation.done("done", 1.0, 3.0)
    service = SessionService(store, operator="P01", teleop=simulation)
    service.watch()
    assert service.look()[0]["teleop"]["trial"] is None
    give(service, "score", line="done")
    assert store.progress("P01").trials[-1].time_s != 3.0


def test_no_page_that_is_blind_knows_a_condition(store):
    service = SessionService(store, operator="P01", blind=True, teleop=FakeTeleop())
    for _ in range(100):
        experimenter, operator = (json.dumps(view) for view in service.look())
        assert not re.search("secret|sbr|dexpilot|realtime", experimenter + operator)
        labels = [c.label for c in store.plan.protocol.conditions]
        assert not any(label in operator for label in labels)
        asked = due_command(store.progress("P01"))
        if asked is None:
            break
        service.carry_out(asked, "experimenter")
    assert store.progress("P01").step.what == "done"
    assert "secret" in json.dumps(SessionService(store, operator="P01").look()[0])
    assert "secret" not in json.dumps(SessionService(store, operator="P01").look()[1])


def test_the_pages_need_nothing_from_elsewhere():
    folder = resources.files("smooth_operator_study.console") / "page"
    texts = {f.name: f.read_text("utf-8") for f in folder.iterdir()}
    for name, text in texts.items():
        assert not re.findall(r"https?://|//[a-z]+\.|@import|innerHTML|eval\(", text), name
        assert len(text.splitlines()) <= 400, name
    for name in ("experimenter.html", "operator.html"):
        assert not re.findall(
            r"<script(?! type=\"module\" src=)|<style|style=|onclick=", texts[name]
        )


def full(store: StudyStore, pages: int) -> None:
    """As a disk that has no room left."""
    with store.reading() as connection:
        connection.execute(f"PRAGMA max_page_count={pages}")


def test_on_a_full_disk_nothing_is_acknowledged(service, store):
    walk(service, "trial")
    full(store, 1)
    note = command(store.progress("P01"), "note", text="long " * 3000)
    with pytest.raises(StoreFailedError, match="full"):
        service.carry_out(note, "experimenter")
    assert "noted" not in kinds(store)
    full(store, 10_000)
    assert service.carry_out(note, "experimenter") == len(store.records("P01"))
    assert kinds(store).count("noted") == 1


def test_a_database_that_is_gone_is_told(service, store, tmp_path):
    asked = command(store.progress("P01"), "calibrated")
    (tmp_path / "study.db").rename(tmp_path / "elsewhere.db")
    with pytest.raises(StoreFailedError):
        service.carry_out(asked, "experimenter")
    (tmp_path / "study.db").write_bytes((tmp_path / "elsewhere.db").read_bytes())
    with pytest.raises(StoreFailedError, match="replaced"):  # SQLite would not notice
        service.carry_out(asked, "experimenter")
    with pytest.raises(StoreFailedError):
        service.look()


def test_pages_say_that_the_store_fails_and_come_back(service, store, tmp_path):
    with served(service) as port:
        tab = Tab(port)
        tab.until(lambda s: s["now"])
        asked = command(store.progress("P01"), "calibrated")
        away = tmp_path / "elsewhere.db"
        (tmp_path / "study.db").rename(away)
        answer = tab.ask(asked)
        assert (answer["type"], answer["again"]) == ("refused", True)
        assert tab.until(lambda s: s["trouble"])["now"]["what"] == "calibrate"
        away.rename(tmp_path / "study.db")
        assert tab.ask(asked)["type"] == "done"
        tab.until(lambda s: not s["trouble"] and s["now"]["what"] == "start_block")
        tab.close()
    assert kinds(store) == ["calibrated"]


def test_two_tabs_and_a_tablet_see_what_happens(store):
    with served(SessionService(store, operator="P01")) as port:
        one, other, tablet = Tab(port), Tab(port), Tab(port, "operator")
        one.until(lambda s: s["pages"] == {"experimenter": 2, "operator": 1})
        other.until(lambda s: s["now"])
        while (asked := due_command(store.progress("P01"))).do != "answer":
            assert one.ask(asked)["type"] == "done"
            # With "done" comes the state after it: a page never shows less than it was told.
            assert one.state["now"]["after"] == store.progress("P01").number
        tablet.until(lambda s: s["what"] == "questionnaire")
        refused = tablet.ask(command(store.progress("P01"), "undo", number=1))
        assert "is not allowed to" in refused["error"]
        assert tablet.ask(asked)["type"] == "done"
        other.until(lambda s: s["now"]["what"] == "start_trial")
        stale = command(store.progress("P01"), "start_trial", after=1)
        assert "another page" in other.ask(stale)["error"]
        one.close()
        again = Tab(port, "operator")
        assert again.ask(asked)["type"] == "done"  # whose answer got lost
        assert kinds(store).count("questionnaire_answered") == 1
        for tab in (other, tablet, again):
            tab.close()


def test_what_another_program_writes_is_shown(store, tmp_path):
    with served(SessionService(store, operator="P01")) as port:
        tab = Tab(port)
        tab.until(lambda s: s["now"]["what"] == "calibrate")
        with open_study(tmp_path) as other:
            walk(SessionService(other, operator="P01"), "start_block")
        tab.until(lambda s: s["now"]["what"] == "start_block")
        tab.close()


def test_nonsense_on_the_socket_does_no_harm(store):
    with served(SessionService(store, operator="P01")) as port:
        tab = Tab(port)
        for text in ("", "[]", "{", "[" * 100_000, json.dumps({"type": "hello", "operator": 5})):
            tab.socket.send(text)
        tab.socket.send(b"\0\1")
        tab.socket.send(json.dumps({"type": "command", "token": "x" * 16, "do": ["note"]}))
        while (said := tab.hear())["type"] != "refused":
            pass
        assert "this is not a command" in said["error"]
        assert tab.ask(command(store.progress("P01"), "calibrated"))["type"] == "done"
        tab.close()


def upgrade(**more: str) -> dict[str, str]:
    key = "dGhlIHNhbXBsZSBub25jZQ=="
    return {
        "Upgrade": "websocket",
        "Connection": "Upgrade",
        "Sec-WebSocket-Key": key,
        "Sec-WebSocket-Version": "13",
        **more,
    }


def test_the_operators_link_opens_the_operators_page_alone(store, tmp_path, monkeypatch):
    monkeypatch.setenv("SMOOTH_OPERATOR_CACHE", str(tmp_path / "cache"))
    auth = auth_for("0.0.0.0", "console")
    assert auth.tokens == auth_for("0.0.0.0", "console").tokens  # after a restart, too
    assert auth.tokens != auth_for("0.0.0.0", "another").tokens
    tokens = auth.tokens
    assert len(set(tokens.values())) == 2
    assert min(map(len, tokens.values())) >= 24
    ok, see, no = http.HTTPStatus.OK, http.HTTPStatus.SEE_OTHER, http.HTTPStatus.UNAUTHORIZED
    with served(SessionService(store, operator="P01"), auth) as port:

        def status(path: str, **headers: str) -> int:
            return fetch(port, path, **headers)[0]

        for path in ("/", "/operator", "/experimenter.js", "/operator.svg", "/?token=guess"):
            assert status(path) == no
        for path in ("/link", "/operator/link"):
            assert status(path, **upgrade()) == no
        given = fetch(port, f"/operator?token={tokens['operator']}")
        assert (given[0], given[1]["location"]) == (see, "/operator")
        cookie = given[1]["set-cookie"].split(";")[0]
        assert "HttpOnly" in given[1]["set-cookie"]
        wanted = ["/operator"]  # and all that it loads, one from the other
        for path in wanted:
            found, _, body = fetch(port, path, Cookie=cookie)
            assert found == ok, path
            named = re.findall(r"""(?:from '\.|src="|href=")(/[\w.]+)""", body.decode())
            wanted += [name for name in named if name not in wanted]
        assert {"/operator.js", "/tlx.js", "/link.js", "/console.css"} < set(wanted)
        for path in ("/", "/experimenter.js", "/operator.svg"):
            assert status(path, Cookie=cookie) == no
            assert status(f"{path}?token={tokens['operator']}") == no
        assert status("/operator/link", **upgrade(Cookie=cookie)) == 101
        assert status("/link", **upgrade(Cookie=cookie)) == no
        assert status(f"/link?token={tokens['operator']}", **upgrade()) == no
        given = fetch(port, f"/?token={tokens['experimenter']}")
        cookie = given[1]["set-cookie"].split(";")[0]
        for path in ("/", "/operator"):
            assert status(path, Cookie=cookie) == ok
        code = fetch(port, "/operator.svg", Cookie=cookie)  # that the tablet scans
        assert (code[0], code[2]) == (ok, qr_code(auth.links("127.0.0.1", port)["operator"]))
        assert status("/link", **upgrade(Cookie=cookie)) == 101
        elsewhere = {"Origin": "https://elsewhere.example"}
        assert status("/link", **upgrade(Cookie=cookie, **elsewhere)) == 403


def test_an_operators_link_takes_no_experimenters_place(store):
    auth = ConsoleAuth({"experimenter": "e" * 24, "operator": "o" * 24})
    with contextlib.ExitStack() as stack:
        port = stack.enter_context(served(SessionService(store, operator="P01"), auth))
        client = pytest.importorskip("websockets.sync.client")

        def connect(path: str, token: str) -> Any:
            url = f"ws://127.0.0.1:{port}{path}?token={token * 24}"
            # All is taken in: a link with a full queue waits long for its end.
            return stack.enter_context(client.connect(url, proxy=None, max_queue=None))

        full = pytest.importorskip("websockets.exceptions").InvalidStatus
        taken: list[Any] = []
        with contextlib.suppress(full):
            taken.extend(connect("/operator/link", "o") for _ in range(200))
        assert 32 <= len(taken) < 200
        assert fetch(port, "/operator/link?token=" + "o" * 24, **upgrade())[0] == 503
        for _ in range(8):
            connect("/link", "e").recv(timeout=PATIENCE_S)
        taken.pop().close()  # a place that is left is free again
        eventually(lambda: fetch(port, "/operator/link?token=" + "o" * 24, **upgrade())[0] == 101)


def test_on_this_machine_other_pages_are_kept_out(store):
    with served(SessionService(store, operator="P01"), ConsoleAuth(None)) as port:
        status, headers, body = fetch(port, "/")
        assert status == http.HTTPStatus.OK
        assert b"experimenter.js" in body
        assert "default-src 'none'" in headers["content-security-policy"]
        answers = [fetch(port, path)[1] for path in ("/", "/operator", "/no-such")]
        for headers in (*answers, fetch(port, "/", Host="elsewhere.example")[1]):
            assert headers["x-frame-options"] == "DENY"
            assert "frame-ancestors 'none'" in headers["content-security-policy"]
        assert fetch(port, "/no-such")[0] == http.HTTPStatus.NOT_FOUND
        assert fetch(port, "/", Host=f"elsewhere.example:{port}")[0] == 403
        assert fetch(port, "/link", **upgrade(Origin="https://elsewhere.example"))[0] == 403


@pytest.mark.parametrize("how", [pytest.param("SIGINT", marks=pytest.mark.weekly), "SIGHUP"])
@pytest.mark.skipif(sys.platform == "win32", reason="sends POSIX signals")
def test_the_command_serves_and_ends_on_a_signal(tmp_path, how):
    folder = tmp_path / "study"
    folder.mkdir()
    write_plan_files(console_plan(), folder)
    console = ConsoleProcess(folder, "--operator", "P02")
    console.start()
    tab = Tab(console.port)
    assert tab.until(lambda s: s["now"])["now"]["operator"] == "P02"
    enrol = command_of({"token": "y" * 16, "do": "enrol", "operator": "P07"}, "experimenter")
    assert tab.ask(enrol)["type"] == "done"
    assert console.end(getattr(signal, how)) == 0
    assert f"http://localhost:{console.port}/operator" in console.log.read_text()
    assert read_plan(folder).codes == ("P01", "P02", "P07")
    assert "P07" in (folder / "schedule.csv").read_text()


def test_what_can_not_be_run_is_told(tmp_path, capsys):
    complaint: Callable[[], str] = lambda: capsys.readouterr().err  # noqa: E731
    assert main(["study", "run", str(tmp_path), "--port", "0"]) == 2
    assert "study new" in complaint()
    write_plan_files(console_plan(), tmp_path)
    assert main(["study", "run", str(tmp_path), "--port", "0", "--operator", "P9"]) == 2
    assert "unknown operator" in complaint()
    assert main(["study", "run", str(tmp_path), "--host", "203.0.113.9"]) == 2
    assert "can't listen" in complaint()


def test_a_look_that_fails_takes_no_answer_with_it(service, store):
    """A page that never hears of its command would wait for it, with all buttons off."""
    look, broken = service.look, threading.Event()

    def failing() -> tuple[dict[str, Any], dict[str, Any]]:
        if broken.is_set():
            raise RuntimeError("a fault")
        return look()

    service.look = failing
    with served(service) as port:
        tab = Tab(port)
        tab.until(lambda state: state["now"])
        broken.set()
        service._changed()  # redrawn by itself, too
        tab.until(lambda state: "RuntimeError" in state["trouble"])
        assert tab.ask(command(store.progress("P01"), "calibrated"))["type"] == "done"
        broken.clear()
        service._changed()
        tab.until(lambda state: state["now"]["what"] == "start_block")
        tab.close()


def test_what_comes_late_does_not_replace_what_is_newer(service, store):
    """A page that went back to an earlier step would take keys for what is over."""
    look = service.look
    holding, held, gate = (threading.Event() for _ in range(3))

    def slow() -> tuple[dict[str, Any], dict[str, Any]]:
        found = look()
        if holding.is_set() and not held.is_set():
            held.set()
            assert gate.wait(PATIENCE_S)
        return found

    service.look = slow
    with served(service) as port:
        tab = Tab(port)
        tab.until(lambda state: state["now"])
        holding.set()
        service._changed()
        assert held.wait(PATIENCE_S)
        assert tab.ask(command(store.progress("P01"), "calibrated"))["type"] == "done"
        assert tab.state["now"]["what"] == "start_block"
        gate.set()
        while tab.hear()["type"] != "alive":  # nothing came for a second
            assert tab.state["now"]["what"] == "start_block"
        tab.close()
