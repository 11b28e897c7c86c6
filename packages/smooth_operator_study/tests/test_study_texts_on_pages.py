"""Names and texts that others wrote, on the study's pages: shown letter by letter, never run."""

import sys

import pytest
from hostile_texts import ATTACK, guarded_page
from study_cases import simulate
from study_console import served

from smooth_operator.cli import main
from smooth_operator_study.console.session_service import SessionService
from smooth_operator_study.design.plan import make_plan
from smooth_operator_study.design.protocol import Condition, Protocol, RubricLine, Task
from smooth_operator_study.store.study_store import open_study

pytestmark = [
    pytest.mark.browser,
    pytest.mark.skipif(sys.platform == "win32", reason="names of files can't hold markup"),
]


def test_the_report_of_a_study(chromium, tmp_path):
    names = ["dexpilot", *(f"{ATTACK}{k}" for k in range(2))]
    simulate(3, operators=range(6), retargeters=names).write(tmp_path)
    files = [str(tmp_path / name) for name in ("tlx.csv", "trials.csv")]
    status = main(["study", "analyze", *files, "--output", str(tmp_path / "out"), "--quiet"])
    assert status in (0, 1)
    with guarded_page(chromium) as page:
        page.goto((tmp_path / "out" / "report.html").as_uri())
        assert page.get_by_text(names[1]).count() > 3


def test_the_console_of_a_study(chromium, tmp_path):
    rubric = (
        RubricLine("done", 1.0, f"{ATTACK} done"),
        RubricLine("failed", 0.0, f"{ATTACK} failed"),
    )
    task = Task("card", trials=3, title=f"{ATTACK} title", rubric=rubric, time_limit_s=60.0)
    conditions = (Condition("one", "sbr", "realtime"), Condition("two", "dexpilot"))
    plan = make_plan(Protocol("console", conditions, (task,), "two", 2, familiarisation_s=0.0))
    with open_study(tmp_path, plan) as store:
        service = SessionService(store)
        with served(service) as port, guarded_page(chromium) as page:
            page.goto(f"http://127.0.0.1:{port}/")
            page.get_by_role("button", name="P02").click()
            page.get_by_role("button", name="Calibrated").click()
            page.get_by_text(f"{ATTACK} title").first.wait_for()
            page.locator('[data-press="space"]:enabled').wait_for()
            page.keyboard.press(" ")
            page.get_by_role("heading", name="Trial 1 of 3", exact=True).wait_for()
            page.locator('[data-press="space"]:enabled').wait_for()
            page.keyboard.press(" ")
            page.get_by_text(f"{ATTACK} done").first.wait_for()
