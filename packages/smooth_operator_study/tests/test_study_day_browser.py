"""A day that does not go by the plan, in a real browser."""

from typing import Any

import pytest
from study_console import command, console_pages, mark, walk

from smooth_operator_study.store.nasa_tlx import SCALE_NAMES


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
def test_pause_stray_click_amend_withdraw_and_enrol(chromium, tmp_path):
    with console_pages(chromium, tmp_path) as (store, service, pages):
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
        page.get_by_text("of operator P01 is in progress; end it, or void the trial").wait_for()
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
        page.get_by_text("its rows are free for the next operator to enrol").wait_for()
        page.locator("#enrol").click()
        fill(page, "Enrol", code="P09")
        page.locator("#who", has_text="P09").wait_for()
        progress = store.progress("P01")
        assert not progress.withdrawn.keep
        assert store.plan.enrolment("P09").rows == store.plan.enrolment("P01").rows


@pytest.mark.browser
def test_an_answer_goes_to_the_operator_of_its_question(chromium, tmp_path):
    with console_pages(chromium, tmp_path) as (store, service, pages):
        walk(service, "start_block")
        page = pages.experimenter
        page.bring_to_front()
        # While the question whether to take back is open, another page does something.
        page.get_by_text("Undo cancels #1: Calibrated for card").wait_for()
        page.keyboard.press("u")
        page.get_by_role("heading", name="Undo event 1?").wait_for()
        page.locator("#ask-no").click()
        page.get_by_role("button", name="Withdraw").click()
        other = command(store.progress("P02"), "choose", after=None)
        service.carry_out(other, "experimenter")
        page.locator("#who", has_text="P02").wait_for()
        page.locator("#ask-yes").click()
        page.get_by_text("it is for operator P01, but operator P02 is selected").wait_for()
        assert store.progress("P02").withdrawn is None
