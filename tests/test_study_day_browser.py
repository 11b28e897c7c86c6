"""A day that does not go by the plan, in a real browser."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from study_console import command, console_plan, served
from test_study_console import walk
from test_study_console_browser import Pages, mark

from smooth_operator.study.console.session_service import SessionService
from smooth_operator.study.design.forms import DEFAULT_FORMS
from smooth_operator.study.store.nasa_tlx import PAIRS, SCALE_NAMES
from smooth_operator.study.store.study_store import open_study

pytest.importorskip("segno", reason="the extra study is not installed")


def fill(page: Any, button: str, **given: str) -> None:
    """Answers the dialog."""
    for name, value in given.items():
        field = page.locator(f"#ask-{name}")
        if field.evaluate("field => field.tagName") == "SELECT":
            field.select_option(value)
        else:
            field.fill(value)
    page.locator("#ask-yes", has_text=button).click()
    page.locator("#ask").wait_for(state="hidden")


@pytest.mark.browser
def test_pause_stray_click_amend_withdraw_and_replace(chromium: Any, tmp_path: Path) -> None:
    with open_study(tmp_path, console_plan()) as store:
        service = SessionService(store, operator="P01")
        with served(service) as port:
            pages = Pages(chromium, port)
            page = pages.experimenter
            page.bring_to_front()  # one behind is drawn once a second, and clicks wait for that
            pages.start_first_trial()
            pages.press(" ", "space")
            page.get_by_text("The clock is stopped.").wait_for()
            pages.press("p", "p")
            fill(page, "Pause", reason="the robot tripped")
            pages.step("Trial 1 of 3: paused")
            pages.press(" ", "space")
            pages.step("Trial 1 of 3")
            page.get_by_role("button", name="Stop the clock").wait_for()  # it runs again

            page.get_by_role("button", name="P02").click()
            page.get_by_role("heading", name="Put P02 on?").wait_for()
            page.locator("#ask-no").click()
            pages.press("1", "1")
            pages.step("Questionnaire")
            assert service.operator == "P01"
            mark(pages.operator, dict.fromkeys(SCALE_NAMES, 50))
            pages.operator.get_by_role("button", name="Send my answers").click()
            pages.step("Trial 2 of 3")

            page.locator('[data-key="amend-card-1-1"]').click()
            fill(page, "Amend", line="nearly", time="3.5", reason="saw the film", who="AB")
            page.locator(".amended").wait_for()
            trial = store.progress("P01").trials[0]
            assert (trial.line, trial.score, trial.time_s) == ("nearly", 0.5, 3.5)

            page.get_by_role("button", name="Withdraw").click()
            fill(page, "Withdraw", keep="leave", reason="felt dizzy")
            pages.step("Withdrawn")
            page.get_by_role("button", name="Replace").click()
            fill(page, "Enrol", code="P09")
            page.locator("#who", has_text="P09").wait_for()
            page.get_by_role("button", name="P01").click()
            page.get_by_text("P09 has the rows now.").wait_for()
            assert not pages.problems
            pages.context.close()
        progress = store.progress("P01")
        assert progress.withdrawn is not None
        assert not progress.withdrawn.keep
        assert store.progress("P09").replaces == "P01"
        assert store.plan.enrolment("P09").rows == store.plan.enrolment("P01").rows


@pytest.mark.browser
def test_forms_from_paper_and_what_a_question_was_asked_for(chromium: Any, tmp_path: Path) -> None:
    plan = console_plan()
    plan = replace(plan, protocol=replace(plan.protocol, forms=DEFAULT_FORMS[:2]))
    with open_study(tmp_path, plan) as store:
        service = SessionService(store, operator="P01")
        with served(service) as port:
            pages = Pages(chromium, port)
            page = pages.experimenter
            page.bring_to_front()
            pages.step("Form: consent")
            page.get_by_role("button", name="It is on paper").click()
            fill(page, "It is on paper", who="AB")
            pages.step("Form: about-you")
            page.locator("#forms", has_text="on paper (AB), to be typed in").wait_for()
            for title, answered in (("consent", "agreed"), ("about-you", "author")):
                page.locator(f'[data-key="form-{title}"]').click()
                paper = page.locator("#paper")
                paper.locator(f'input[name="{answered}"]').first.check()
                if title == "consent":
                    paper.locator('input[name="recordings"]').last.check()
                paper.locator("#paper-who").fill("CD")
                paper.get_by_role("button", name="Save").click()
            pages.step("Calibration")
            progress = store.progress("P01")
            assert progress.forms["consent"][1] == {"agreed": True, "recordings": False}
            assert progress.typed == {"consent": "CD", "about-you": "CD"}
            page.locator('[data-key="form-about-you"]').click()  # it can be read, and corrected
            assert page.locator('#paper input[name="author"]').first.is_checked()
            page.locator("#paper-close").click()

            # While the question whether to take back is open, another page does something.
            page.get_by_text("Undo takes back #3: Form about-you typed in by CD").wait_for()
            page.keyboard.press("u")
            page.get_by_role("heading", name="Take back event 3?").wait_for()
            page.locator("#ask-no").click()
            page.get_by_role("button", name="Withdraw").click()
            service.carry_out(command(progress, "choose", after=None), "experimenter")
            walk(service, store, "start_block")
            other = command(store.progress("P02"), "choose", after=None)
            service.carry_out(other, "experimenter")
            page.locator("#who", has_text="P02").wait_for()
            page.locator("#ask-yes").click()
            page.get_by_text("it is for operator P01, but operator P02 is on").wait_for()
            assert store.progress("P02").withdrawn is None
            assert not pages.problems
            pages.context.close()


@pytest.mark.browser
def test_a_tlx_that_was_filled_in_on_paper_is_typed_in(chromium: Any, tmp_path: Path) -> None:
    with open_study(tmp_path, console_plan(weights=True)) as store:
        service = SessionService(store, operator="P01")
        walk(service, store, "questionnaire")
        with served(service) as port:
            pages = Pages(chromium, port)
            page = pages.experimenter
            page.bring_to_front()
            paper = page.locator("#paper")
            save = paper.get_by_role("button", name="Save")
            pages.step("Questionnaire")
            page.locator('[data-key="from-paper"]').click()
            for k, name in enumerate(SCALE_NAMES):
                paper.locator(f"#field-{name}").fill(str(10 * k + 5))
            paper.locator("#field-effort").fill("42")  # between two marks
            paper.get_by_text("Still to answer: Effort").wait_for()
            assert save.is_disabled()
            paper.locator("#field-effort").fill("45")
            paper.get_by_text("Nothing is missing.").wait_for()
            paper.locator("#paper-who").fill("AB")
            save.click()
            pages.step("Trial 2 of 3")
            page.locator("#log", has_text="(initial) typed in from paper by AB").wait_for()
            assert "workload" not in page.locator("#log").inner_text()
            [filled] = store.progress("P01").questionnaires
            assert filled.ratings == {n: 10 * k + 5 for k, n in enumerate(SCALE_NAMES)}

            walk(service, store, "weights")
            pages.step("Pairs of scales")
            page.locator('[data-key="from-paper"]').click()
            for first, second in PAIRS:
                paper.locator(f'input[name="{first}-{second}"]').last.check()
            paper.locator("#paper-who").fill("CD")
            save.click()
            pages.step("Block 2 of 2")
            block = store.progress("P01").blocks[0]
            chosen = store.progress("P01").winners[block.task.name, block.number]
            assert chosen == tuple(second for _, second in PAIRS)
            assert not pages.problems
            pages.context.close()
