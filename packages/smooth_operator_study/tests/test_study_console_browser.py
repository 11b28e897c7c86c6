"""A block in a real browser: experimenter and operator, while the server is killed twice."""

import re
from collections import Counter
from dataclasses import replace
from pathlib import Path
from urllib.parse import urlsplit

import pytest
from fake_teleop import FakeSimulation
from study_console import (
    ConsoleProcess,
    Pages,
    console_pages,
    console_plan,
    due_command,
    mark,
    ratings,
    served,
)

from smooth_operator.web.browser import leading_to
from smooth_operator_study.console.server import ConsoleAuth
from smooth_operator_study.console.session_service import SessionService
from smooth_operator_study.design.plan import Plan, make_plan
from smooth_operator_study.design.plan_file import write_plan_files
from smooth_operator_study.store.events import QuestionnaireAnswered
from smooth_operator_study.store.nasa_tlx import SCALE_NAMES
from smooth_operator_study.store.study_store import open_study

TRIALS, MIDDLE, RESET = 4, 2, 3
"""Trials of a block: all, the one at its middle, and the one that has a reset."""
LINES = ("done", "nearly", "failed")


def cube_plan() -> Plan:
    """The same with the paper's task B, of which there is a simulation."""
    made = console_plan()
    task = replace(made.protocol.tasks[0], name="B", title="Cube", time_limit_s=None)
    return make_plan(replace(made.protocol, tasks=(task,)))


@pytest.mark.browser
def test_a_block_while_the_server_is_killed(chromium, tmp_path):
    folder = tmp_path / "study"
    folder.mkdir()
    write_plan_files(console_plan(TRIALS, seconds=1.0), folder)
    console = ConsoleProcess(folder, "--blind")
    console.start()
    pages = Pages(chromium, console.port)
    page, operator = pages.experimenter, pages.operator
    try:
        page.get_by_role("button", name="P02").click()
        pages.step("Calibration")
        page.locator("#detail").fill("P02.json")
        page.get_by_role("button", name="Calibrated").click()
        pages.step("Block 1 of 2")
        pages.press(" ", "space")
        pages.step("Free movement")
        pages.press(" ", "space")  # ends by itself
        points = {1: "initial", MIDDLE: "midpoint", TRIALS: "final"}
        for trial in range(1, TRIALS + 1):
            pages.step(f"Trial {trial} of {TRIALS}")
            pages.press(" ", "space")
            page.locator('[data-key="stop"]:enabled').wait_for()
            assert "undefined" not in page.locator("#step").inner_text()
            if trial == RESET:
                pages.press("r", "r")
                page.get_by_role("button", name="done as told").and_(
                    page.locator(":disabled")
                ).wait_for()
            if trial == MIDDLE:  # killed while the trial runs; scored while there is no server
                console.kill()
                pages.cut_off()
                page.keyboard.press(" ")
                page.get_by_text("The clock is stopped").wait_for()
                page.keyboard.press(str(1 + trial % 3))
                page.get_by_text("What you entered is kept here").wait_for()
                page.goto("about:blank")  # and the page is gone, too, with what it has not sent
                console.start()
                page.goto(f"http://127.0.0.1:{console.port}/")
                pages.back()
            else:
                key = str(1 + trial % 3) if trial != RESET else "2"
                pages.press(key, key)
            if trial not in points:
                continue
            pages.step("Questionnaire")
            operator.get_by_role("heading", name="How was it?").wait_for()
            marks = ratings(trial)
            send = operator.get_by_role("button", name="Send my answers")
            if trial == MIDDLE:  # killed with the questionnaire half filled in
                mark(operator, dict(list(marks.items())[:3]))
                console.kill()
                pages.cut_off()
                mark(operator, dict(list(marks.items())[3:4]))
                operator.goto("about:blank")
                console.start()
                operator.goto(f"http://127.0.0.1:{console.port}/operator")
                pages.back()
                operator.get_by_text("Still to mark: Effort, Frustration").wait_for()
                marks = dict(list(marks.items())[4:])
            assert send.is_disabled()
            mark(operator, marks)
            send.click()
            # "Thank you" goes away by itself
            operator.get_by_role("heading", name=re.compile("Thank you|Please follow")).wait_for()
        pages.step("Block 2 of 2")
        assert "secret" not in page.content() + operator.content()  # blind
    finally:
        status = console.end()
    assert status == 0, console.log.read_text()
    assert not [p for p in pages.problems if "ERR_CONNECTION" not in p]
    check_store(folder)


@pytest.mark.browser
def test_two_tabs_keep_what_both_could_not_send(chromium, tmp_path):
    folder = tmp_path / "study"
    folder.mkdir()
    write_plan_files(console_plan(), folder)
    console = ConsoleProcess(folder, "--operator", "P01")
    console.start()
    try:
        pages = Pages(chromium, console.port)
        page = pages.experimenter
        pages.start_first_trial()
        page.locator('[data-key="stop"]').wait_for()
        other = pages._page(f"http://127.0.0.1:{console.port}/")
        console.kill()
        for tab in (page, other):
            tab.locator("#lost").wait_for()
        page.bring_to_front()
        page.keyboard.press("1")
        page.get_by_text("What you entered is kept here").wait_for()
        assert page.locator(".rubric button:enabled").count() == 0  # it is scored once
        other.bring_to_front()
        other.locator("#note").fill("seen from the other tab")
        other.locator("#noting button").click()
        other.get_by_text("disconnected", exact=True).wait_for()
        for tab in (page, other):
            tab.goto("about:blank")
        console.start()
        page.bring_to_front()
        page.goto(f"http://127.0.0.1:{console.port}/")
        pages.step("Questionnaire")
        page.get_by_text("seen from the other tab").wait_for()
        page.get_by_text("connected", exact=True).wait_for()  # nothing is under way
        left = "Object.keys(localStorage).filter((name) => /[/]link[/]/.test(name))"
        assert page.evaluate(left) == []
    finally:
        console.end()


def check_store(folder: Path) -> None:
    with open_study(folder) as store:
        assert store.records("P01") == []
        progress = store.progress("P02")
        kinds = Counter(record.event.kind for record in progress.records)
        assert kinds == {
            "calibrated": 1,
            "block_started": 1,
            "familiarisation_started": 1,
            "familiarisation_ended": 1,
            "trial_started": TRIALS,
            "trial_reset": 1,
            "trial_scored": TRIALS,
            "questionnaire_answered": 3,
        }
        assert [t.number for t in progress.trials] == list(range(1, TRIALS + 1))
        lines = [LINES[k % 3] if k != RESET else "nearly" for k in range(1, TRIALS + 1)]
        assert [t.line for t in progress.trials] == lines
        assert all(t.time_s is not None and t.time_s > 0 for t in progress.trials)
        answered = progress.events(QuestionnaireAnswered)
        assert [(q.point, dict(q.ratings)) for _, q in answered] == [
            (point, ratings(trial))
            for trial, point in ((1, "initial"), (MIDDLE, "midpoint"), (TRIALS, "final"))
        ]
        assert set(ratings(1)) == set(SCALE_NAMES)
        # The trial ended when it was scored, not when the server was there again to hear of it.
        killed = progress.trials[MIDDLE - 1]
        scored = next(
            r
            for r in progress.records
            if r.event.kind == "trial_scored" and r.event.trial == MIDDLE
        )
        assert killed.time_s < (scored.at - killed.started).total_seconds()


@pytest.mark.browser
def test_the_clock_of_the_browser_may_be_set(chromium, tmp_path):
    with console_pages(chromium, tmp_path) as (store, _, pages):
        page = pages.experimenter
        pages.start_first_trial()
        pages.press(" ", "space")  # the clock is stopped
        page.get_by_text("The clock is stopped").wait_for()
        minutes, seconds = page.locator(".clock").inner_text().split(":")
        at_first = 60 * int(minutes) + float(seconds)
        page.evaluate("{ const day = Date.now; Date.now = () => day.call(Date) + 3600e3; }")
        page.wait_for_timeout(1500)  # messages come, by which the page compares clocks
        shown = page.locator(".clock").inner_text()
        pages.press("1", "1")
        pages.step("Questionnaire")
        minutes, seconds = shown.split(":")
        # A message that was faster tells better how the clocks differ: not the same to the tenth.
        time_s = store.progress("P01").trials[-1].time_s
        assert time_s == pytest.approx(60 * int(minutes) + float(seconds), abs=0.5)
        assert time_s == pytest.approx(at_first, abs=5.0)


@pytest.mark.browser
def test_a_browser_is_led_to_the_page_by_a_file(chromium, tmp_path):
    auth = ConsoleAuth({"experimenter": "e" * 24, "operator": "o" * 24})
    with (
        open_study(tmp_path, console_plan()) as store,
        served(SessionService(store, operator="P01"), auth) as port,
    ):
        page = chromium.new_page()
        page.goto(leading_to(auth.links("127.0.0.1", port)["experimenter"]).as_uri())
        page.locator("#link", has_text="connected").wait_for()
        assert urlsplit(page.url)[2:] == ("/", "", "")  # without the token
        page.close()


@pytest.mark.browser
def test_a_score_that_contradicts_the_simulation_is_asked_about(chromium, tmp_path):
    teleop = FakeSimulation()
    with console_pages(chromium, tmp_path, cube_plan(), teleop=teleop) as (store, _, pages):
        page = pages.experimenter
        pages.start_first_trial()
        page.locator('[data-key="stop"]').wait_for()
        teleop.trial |= {"phase": "running", "reason": "turned by 0°"}
        page.get_by_text("turned by 0°").wait_for()
        page.get_by_text("Time limit 2 min, of the simulation.").wait_for()
        pages.press("1", "1")
        page.get_by_text("The simulation says so far: not-done, 0 (turned by 0°)").wait_for()
        assert store.progress("P01").running is not None
        page.keyboard.press("Escape")
        pages.press("1", "1")
        page.get_by_role("button", name="Score it anyway").click()
        pages.step("Questionnaire")
        assert store.progress("P01").trials[-1].score == 1.0


@pytest.mark.browser
def test_scales_and_send_are_in_sight_on_a_tablet(chromium, tmp_path):
    with (
        open_study(tmp_path, console_plan()) as store,
        served(SessionService(store, operator="P01"), ConsoleAuth(None)) as port,
    ):
        while store.progress("P01").step.what != "questionnaire":
            asked = due_command(store.progress("P01"))
            SessionService(store, operator="P01").carry_out(asked, "experimenter")
        page = chromium.new_page()
        page.goto(f"http://127.0.0.1:{port}/operator")
        for width, height, scales in ((1180, 820, 6), (820, 1180, 5), (390, 844, 2)):
            page.set_viewport_size({"width": width, "height": height})
            bar = page.locator(".send")
            bar.wait_for()
            box = bar.bounding_box()
            assert box["y"] + box["height"] <= height + 1
            assert page.get_by_role("button", name="Send my answers").is_visible()
            assert "Still to mark" in bar.inner_text()
            shown = [one.bounding_box() for one in page.locator(".scale").all()]
            seen = sum(one["y"] + one["height"] <= box["y"] + 1 for one in shown)
            assert seen >= scales, (width, height)
            assert page.evaluate("document.documentElement.scrollWidth") <= width
        page.close()


@pytest.mark.browser
def test_the_list_of_operators_shows_who_is_on(chromium, tmp_path):
    plan = make_plan(replace(console_plan().protocol, operators=24))
    with console_pages(chromium, tmp_path, plan, operator="P23") as (_, _, pages):
        page = pages.experimenter
        hidden = """key => {
            const list = document.querySelector('#people').getBoundingClientRect();
            const row = document.querySelector(`[data-key=person-${key}]`).getBoundingClientRect();
            return row.top < list.top - 1 || row.bottom > list.bottom + 1;
        }"""
        page.locator('[data-key="person-P23"][aria-pressed="true"]').wait_for()
        assert page.evaluate(hidden, "P01")
        assert not page.evaluate(hidden, "P23")
        assert page.evaluate("document.documentElement.scrollTop") == 0  # the page stays
        # What the experimenter scrolls to stays while the same operator is on.
        page.locator("#people").evaluate("list => { list.scrollTop = 0; }")
        pages.start_first_trial()
        pages.press("1", "1")
        pages.step("Questionnaire")
        assert page.locator("#people").evaluate("list => list.scrollTop") == 0
        page.get_by_role("button", name="P10").click()
        page.locator('[data-key="person-P10"][aria-pressed="true"]').wait_for()
        assert not page.evaluate(hidden, "P10")
