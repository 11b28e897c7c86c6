"""Forms on the operator's page, and NASA-TLX in its published words or another language's."""

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from study_console import console_pages, console_plan, give, walk
from test_study_console import kinds

from smooth_operator.errors import SmoothOperatorError, StudyError
from smooth_operator_study.console.session_service import SessionService
from smooth_operator_study.design.forms import DEFAULT_FORMS, Form, FormField
from smooth_operator_study.design.plan import Plan
from smooth_operator_study.design.plan_file import plan_of, plan_table
from smooth_operator_study.store.nasa_tlx import ENGLISH, read_words
from smooth_operator_study.store.study_store import StudyStore, open_study

SURVEY = Form(
    "survey",
    "after",
    (
        FormField("liked", "Did you like it?", "scale", low="no", high="yes", steps=5),
        FormField("ranking", "Which was best?", "ranking", required=True),
        FormField("said", 'Say "more"'),
    ),
)


def form_plan(*forms: Form, **more: Any) -> Plan:
    plan = console_plan(**more)
    return replace(plan, protocol=replace(plan.protocol, forms=forms))


@pytest.fixture
def store(tmp_path: Path) -> Iterator[StudyStore]:
    with open_study(tmp_path, form_plan(*DEFAULT_FORMS[:2], SURVEY)) as made:
        yield made


def answer(service: SessionService, form: str, **answers: object) -> None:
    give(service, "form", form=form, answers=answers, role="operator")


def test_forms_come_before_and_after_and_a_plan_keeps_them(store):
    assert plan_of(plan_table(store.plan), "x") == store.plan
    service = SessionService(store, operator="P01")
    assert store.progress("P01").step.form == "consent"
    answer(service, "consent", agreed=True, recordings=False)
    answer(service, "about-you", age=31, writes_with="left")
    walk(service, "form")
    progress = store.progress("P01")
    assert progress.step.form == "survey"
    assert not progress.over
    labels = [condition.label for condition in store.plan.protocol.conditions]
    answer(service, "survey", ranking=labels[::-1], liked=4)
    progress = store.progress("P01")
    assert progress.step.what == "done"
    assert progress.ranking() == ("secrettwo", "secretone")
    assert progress.forms["about-you"][1] == {"age": 31, "writes_with": "left"}


def test_nothing_starts_without_consent_and_a_slip_is_undone(store):
    service = SessionService(store, operator="P01")
    answer(service, "consent", agreed=False, recordings=True)
    assert store.progress("P01").step.what == "refused"
    for do in ("calibrated", "start_break", "form"):
        fields = {"task": "card", "detail": ""} if do == "calibrated" else {}
        fields = {"form": "about-you", "answers": {}} if do == "form" else fields
        with pytest.raises(StudyError, match="refused"):
            give(service, do, **fields)
    give(service, "undo", number=1)
    assert store.progress("P01").step.form == "consent"


@pytest.mark.parametrize(
    ("answers", "why"),
    [
        ({"ranking": ["Oak"]}, "each of these once"),
        ({"ranking": [], "liked": 6}, "from 1 to 5"),
        ({"ranking": [], "liked": "4"}, "from 1 to 5"),
        ({"ranking": [], "said": 3}, "expected a text"),
        ({"ranking": [], "other": 3}, "no field 'other'"),
    ],
)
def test_what_does_not_answer_a_form_is_refused(answers, why):
    with pytest.raises(StudyError, match="'ranking' is not answered"):
        SURVEY.check({}, ["Oak", "Elm"])
    SURVEY.check({}, ["Oak"])  # nothing to rank
    with pytest.raises(StudyError, match=why):
        SURVEY.check(answers, [])


@pytest.mark.parametrize(
    ("made", "why"),
    [
        ({"kind": "choice"}, "at least two choices"),
        ({"kind": "text", "choices": ("a", "b")}, "other kinds have none"),
        ({"label": " "}, "needs a label"),
        ({"kind": "number", "least": 2, "most": 1}, "least is 2, most 1"),
    ],
)
def test_what_is_no_field_is_refused(made, why):
    with pytest.raises(StudyError, match=why):
        FormField(**{"name": "x", "label": "y", **made})


# NASA-TLX.


def test_the_words_are_the_published_ones() -> None:
    by = {scale.name: scale for scale in ENGLISH.scales}
    effort = "How hard did you have to work to accomplish your level of performance?"
    assert by["effort"].question == effort
    done = "How successful were you in accomplishing what you were asked to do?"
    assert by["performance"].question == done
    assert (by["performance"].low, by["performance"].high) == ("Perfect", "Failure")
    felt = "How insecure, discouraged, irritated, stressed, and annoyed were you?"
    assert by["frustration"].question == felt


def german(folder: Path, name: str, scales: dict[str, Any]) -> Path:
    path = folder / name
    if name.endswith(".json"):
        path.write_text(json.dumps({"scales": scales, "texts": {"send": "Absenden"}}))
    else:
        lines = ["[texts]", 'send = "Absenden"']
        for scale, parts in scales.items():
            lines += [f"[scales.{scale}]", *(f"{n} = {json.dumps(v)}" for n, v in parts.items())]
        path.write_text("\n".join(lines))
    return path


@pytest.mark.parametrize("name", ["tlx-de.toml", "tlx-de.json"])
def test_another_language_is_read_from_a_file(tmp_path, name):
    part = {"title": "T", "question": "F?", "low": "gering", "high": "hoch"}
    scales = {scale.name: {**part, "title": scale.name.upper()} for scale in ENGLISH.scales}
    words = read_words(german(tmp_path, name, scales))
    assert [scale.title for scale in words.scales] == [s.name.upper() for s in ENGLISH.scales]
    assert (words.texts["send"], words.texts["yes"]) == ("Absenden", "Yes")
    plan = console_plan()
    with open_study(tmp_path, plan) as store:
        service = SessionService(store, operator="P01", words=words)
        walk(service, "questionnaire")
        assert service.look()[1]["scales"][0]["low"] == "gering"
    del scales["effort"]
    with pytest.raises(StudyError, match=r"scales\.effort: is missing"):
        read_words(german(tmp_path, name, scales))
    scales["effort"] = {**part, "low": ""}
    with pytest.raises(StudyError, match=r"scales\.effort\.low: expected a string"):
        read_words(german(tmp_path, name, scales))
    with pytest.raises(SmoothOperatorError, match="no wording of NASA-TLX at"):
        read_words(tmp_path / name.replace("de", "fr"))


@pytest.mark.browser
def test_a_number_out_of_range_is_named_and_marked(chromium, tmp_path):
    """And a question that need not be answered, a consent too, does not keep a form back."""
    consent = FormField("kept", "May it be kept?", "consent", required=False)
    height = FormField("height", "Height [cm]", "number", least=100.0)
    form = Form("who", "before", (consent, DEFAULT_FORMS[1].fields[0], height))
    with console_pages(chromium, tmp_path, form_plan(form)) as (store, _, pages):
        operator = pages.operator
        send = operator.get_by_role("button", name="Send my answers")
        said = operator.locator(".send [role=status]")
        age = operator.get_by_label("Age [years]: 16 – 120")
        age.wait_for()
        assert said.inner_text() == "Nothing is missing."
        assert send.is_enabled()
        age.fill("180")
        assert said.inner_text() == "Out of range: Age [years] (16 – 120)."
        assert age.get_attribute("aria-invalid") == "true"
        border = age.evaluate("field => getComputedStyle(field).borderTopWidth")
        assert border == "2px"
        assert send.is_disabled()
        operator.get_by_label("Height [cm]: ≥ 100").fill("20")
        assert said.inner_text() == "Out of range: Age [years] (16 – 120), Height [cm] (≥ 100)."
        age.fill("80")
        assert age.get_attribute("aria-invalid") == "false"
        operator.get_by_label("Height").fill("180")
        send.click()
        pages.step("Calibration")
        assert store.progress("P01").forms["who"][1] == {"age": 80, "height": 180}


@pytest.mark.browser
def test_an_operator_fills_in_forms_and_ranks(chromium, tmp_path):
    forms = (DEFAULT_FORMS[0], SURVEY)
    with console_pages(chromium, tmp_path, form_plan(*forms)) as (store, service, pages):
        page, operator = pages.experimenter, pages.operator
        pages.step("Form: Consent")
        send = operator.get_by_role("button", name="Send my answers")
        operator.get_by_role("heading", name="Consent").wait_for()
        assert send.is_disabled()
        for question in operator.locator("fieldset").all():
            question.get_by_label("Yes").check()
        send.click()
        pages.step("Calibration")
        walk(service, "form")
        pages.step("Form: survey")
        labels = [condition.label for condition in store.plan.protocol.conditions]
        for label in labels[::-1]:
            assert send.is_disabled()
            operator.locator(f'[data-key="rank-{label}"]').click()
        operator.get_by_label('Say "more"').fill("<b>fine</b>")
        send.click()
        pages.step("Done")
        assert "secret" not in operator.content()
        assert page is not None
        progress = store.progress("P01")
        assert progress.ranking() == ("secrettwo", "secretone")
        assert progress.forms["survey"][1]["said"] == "<b>fine</b>"
        assert kinds(store)[0] == "form_answered"
