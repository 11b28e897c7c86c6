"""Forms on the operator's page, and NASA-TLX in its published words or another language's."""

from __future__ import annotations

import json
import secrets
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from study_console import command, console_plan, due_command, ratings, served
from test_study_console import kinds, walk
from test_study_console_browser import Pages

from smooth_operator.cli import main
from smooth_operator.errors import SmoothOperatorError, StudyError
from smooth_operator.study.console.commands import command_of
from smooth_operator.study.console.session_service import SessionService
from smooth_operator.study.design.forms import DEFAULT_FORMS, Form, FormField
from smooth_operator.study.design.plan import Plan
from smooth_operator.study.design.plan_file import plan_of, plan_table, read_plan
from smooth_operator.study.store.events import WeightsAnswered
from smooth_operator.study.store.export import study_json
from smooth_operator.study.store.nasa_tlx import PAIRS, SCALES, read_words, shown_pairs
from smooth_operator.study.store.study_store import StudyStore, open_study

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


def answer(service: SessionService, store: StudyStore, form: str, **answers: object) -> None:
    asked = command(store.progress("P01"), "form", form=form, answers=answers)
    service.carry_out(asked, "operator")


def test_forms_come_before_and_after_and_a_plan_keeps_them(store: StudyStore) -> None:
    assert plan_of(plan_table(store.plan), "x") == store.plan
    service = SessionService(store, operator="P01")
    assert store.progress("P01").step.form == "consent"
    answer(service, store, "consent", agreed=True, recordings=False)
    answer(service, store, "about-you", age=31, writes_with="left")
    walk(service, store, "form")
    progress = store.progress("P01")
    assert progress.step.form == "survey"
    assert not progress.over
    labels = [condition.label for condition in store.plan.protocol.conditions]
    answer(service, store, "survey", ranking=labels[::-1], liked=4)
    progress = store.progress("P01")
    assert progress.step.what == "done"
    assert progress.ranking() == ("secrettwo", "secretone")
    assert progress.forms["about-you"][1] == {"age": 31, "writes_with": "left"}


def test_nothing_starts_without_consent_and_a_slip_is_undone(store: StudyStore) -> None:
    service = SessionService(store, operator="P01")
    answer(service, store, "consent", agreed=False, recordings=True)
    assert store.progress("P01").step.what == "refused"
    for do in ("calibrated", "start_break", "form"):
        fields = {"task": "card", "detail": ""} if do == "calibrated" else {}
        fields = {"form": "about-you", "answers": {}} if do == "form" else fields
        with pytest.raises(StudyError, match="refused"):
            service.carry_out(command(store.progress("P01"), do, **fields), "experimenter")
    service.carry_out(command(store.progress("P01"), "undo", number=1), "experimenter")
    assert store.progress("P01").step.form == "consent"


def typed(store: StudyStore, form: str, **fields: Any) -> None:
    """A form from paper, on the experimenter's page."""
    said = {"token": secrets.token_hex(16), "do": "form", "operator": "P01",
            "fields": {"form": form, "who": "AB", **fields}}  # fmt: skip
    SessionService(store, operator="P01").carry_out(
        command_of(said, "experimenter"), "experimenter"
    )


def test_forms_on_paper_are_typed_in_at_any_later_time(store: StudyStore) -> None:
    service = SessionService(store, operator="P01")
    with pytest.raises(StudyError, match="give initials"):
        service.carry_out(command(store.progress("P01"), "paper", form="consent", who=" "),
                          "experimenter")  # fmt: skip
    for form in ("consent", "about-you"):
        now = store.progress("P01")
        service.carry_out(command(now, "paper", form=form, who="AB"), "experimenter")
    assert store.progress("P01").step.what == "calibrate"
    with pytest.raises(StudyError, match="not due yet"):
        typed(store, "survey", answers={"ranking": []})
    walk(service, store, "trial")
    typed(store, "about-you", answers={"age": 31})  # the trial goes on
    assert store.progress("P01").step.what == "trial"
    with pytest.raises(StudyError, match="withdraw the operator"):
        typed(store, "consent", answers={"agreed": False})
    typed(store, "consent", answers={"agreed": True})
    with pytest.raises(StudyError, match="state why"):
        typed(store, "about-you", answers={"age": 32})
    typed(store, "about-you", answers={"age": 32}, reason="misread")
    progress = store.progress("P01")
    assert progress.forms["about-you"][1] == {"age": 32}
    assert (progress.typed, progress.on_paper) == ({"about-you": "AB", "consent": "AB"}, {})
    states = {one["form"]: one["state"] for one in service.look()[0]["now"]["forms"]}
    assert states == {"consent": "filled", "about-you": "filled", "survey": "later"}
    texts = [entry["text"] for entry in service.look()[0]["log"]]
    assert texts[0] == "Form about-you typed in by AB: misread"
    assert "Form about-you is on paper (AB)" in texts
    made = study_json(store)["operators"][0]
    assert made["forms"]["about-you"]["typed_by"] == "AB"


@pytest.mark.parametrize("do", ["form", "answer", "weigh"])
@pytest.mark.parametrize(
    ("role", "who"),
    [("operator", {"who": "AB"}), ("experimenter", {}), ("experimenter", {"who": "  "})],
)
def test_who_types_in_is_said_by_the_experimenter_alone(do: str, role: Any, who: Any) -> None:
    said = {"token": "t" * 8, "do": do, "operator": "P01", "fields": {"form": "a", **who}}
    with pytest.raises(StudyError, match="initials"):
        command_of(said, role)


def test_the_tlx_is_typed_in_from_paper(tmp_path: Path) -> None:
    with open_study(tmp_path / "paper", console_plan(weights=True)) as store:
        service = SessionService(store, operator="P01")

        def from_paper(do: str, **fields: Any) -> None:
            asked = command(store.progress("P01"), do, who="AB", **fields)
            said = {"token": asked.token, "do": do, "operator": "P01", "after": asked.after,
                    "fields": asked.fields}  # fmt: skip
            service.carry_out(command_of(said, "experimenter"), "experimenter")

        walk(service, store, "questionnaire")
        asked = service.look()[0]["now"]["asked"]
        assert [scale["name"] for scale in asked["scales"]] == [scale.name for scale in SCALES]
        with pytest.raises(StudyError, match="steps of 5"):
            from_paper("answer", ratings=ratings(1) | {"effort": 42})
        from_paper("answer", ratings=ratings(1))
        with pytest.raises(StudyError, match="not due"):
            from_paper("answer", ratings=ratings(2), point="initial")
        [filled] = store.progress("P01").questionnaires
        assert (filled.ratings, filled.who) == (ratings(1), "AB")
        view = service.look()[0]
        assert view["log"][0]["text"] == "Questionnaire (initial) typed in from paper by AB"
        assert view["now"]["asked"] is None
        while store.progress("P01").step.what != "weights":
            walk(service, store, "questionnaire")
            from_paper("answer", ratings=ratings(2))
        assert "workload" not in json.dumps(service.look()[0]["log"])
        pairs = service.look()[0]["now"]["asked"]["pairs"]
        sides = [tuple(scale["name"] for scale in pair["scales"]) for pair in pairs]
        assert sides == list(PAIRS)
        from_paper("weigh", winners=[pair[1] for pair in PAIRS])
        log = [entry["text"] for entry in service.look()[0]["log"]]
        assert log[0] == "Pairs of scales typed in from paper by AB"
        assert log[1].startswith("Questionnaire (final): workload ")
        assert log[1].endswith(", typed in from paper by AB")
        weighed = store.progress("P01").records[-1].event
        assert isinstance(weighed, WeightsAnswered)
        assert (weighed.winners[0], weighed.shown, weighed.who) == ("physical", (), "AB")
        walk(service, store, "questionnaire")
        asked_again = command(store.progress("P01"), "answer", ratings=ratings(3))
        service.carry_out(asked_again, "operator")
        made = study_json(store)
        assert [one["typed_by"] for one in made["questionnaires"]] == ["AB", "AB", "AB", None]
    with open_study(tmp_path / "paper") as store:  # what was stored is read again
        assert [one.who for one in store.progress("P01").questionnaires] == ["AB"] * 3 + [""]


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
def test_what_does_not_answer_a_form_is_refused(answers: dict[str, Any], why: str) -> None:
    with pytest.raises(StudyError, match="'ranking' is not answered"):
        SURVEY.check({}, ["Oak", "Elm"])
    SURVEY.check({}, ["Oak"])  # nothing to rank
    with pytest.raises(StudyError, match=why):
        SURVEY.check(answers, [])


@pytest.mark.parametrize(
    ("made", "why"),
    [
        ({"kind": "choice"}, "two choices or more"),
        ({"kind": "text", "choices": ("a", "b")}, "nothing else"),
        ({"kind": "tick"}, "kind must be one of text"),
        ({"label": " "}, "needs a label"),
        ({"kind": "number", "least": 2, "most": 1}, "least is 2, most 1"),
    ],
)
def test_what_is_no_field_is_refused(made: dict[str, Any], why: str) -> None:
    with pytest.raises(StudyError, match=why):
        FormField(**{"name": "x", "label": "y", **made})


def test_study_new_writes_forms_unless_asked_not_to(tmp_path: Path) -> None:
    options = ["--conditions", "sbr", "dexpilot", "--tasks", "A:3", "--operators", "4"]
    assert main(["study", "new", str(tmp_path / "a"), *options]) == 0
    assert read_plan(tmp_path / "a").protocol.forms == DEFAULT_FORMS
    assert main(["study", "new", str(tmp_path / "b"), *options, "--no-forms"]) == 0
    assert read_plan(tmp_path / "b").protocol.forms == ()


# NASA-TLX.


def test_the_words_are_the_published_ones() -> None:
    by = {scale.name: scale for scale in SCALES}
    effort = "How hard did you have to work to accomplish your level of performance?"
    assert by["effort"].question == effort
    done = "How successful were you in accomplishing what you were asked to do?"
    assert by["performance"].question == done
    assert (by["performance"].low, by["performance"].high) == ("Perfect", "Failure")
    felt = "How insecure, discouraged, irritated, stressed, and annoyed were you?"
    assert by["frustration"].question == felt


def test_order_and_side_of_the_pairs_are_drawn_for_each_person(tmp_path: Path) -> None:
    drawn = [shown_pairs(0, f"P{k:02d}") for k in range(40)]
    assert all({frozenset(pair) for pair in pairs} == set(map(frozenset, PAIRS)) for pairs in drawn)
    assert len({tuple(map(frozenset, pairs)) for pairs in drawn}) == 40
    turned = sum(pair not in PAIRS for pairs in drawn for pair in pairs) / 600
    assert 0.4 < turned < 0.6
    with open_study(tmp_path, console_plan(weights=True)) as store:
        service = SessionService(store, operator="P01")
        walk(service, store, "weights")
        asked = due_command(store.progress("P01"))
        assert asked is not None
        service.carry_out(asked, "operator")
        (event,) = [r.event for r in store.records("P01") if isinstance(r.event, WeightsAnswered)]
        assert event.shown == tuple("-".join(pair) for pair in shown_pairs(0, "P01"))


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
def test_another_language_is_read_from_a_file(tmp_path: Path, name: str) -> None:
    part = {"title": "T", "question": "F?", "low": "gering", "high": "hoch"}
    scales = {scale.name: {**part, "title": scale.name.upper()} for scale in SCALES}
    words = read_words(german(tmp_path, name, scales))
    assert [scale.title for scale in words.scales] == [s.name.upper() for s in SCALES]
    assert (words.texts["send"], words.texts["back"]) == ("Absenden", "Back")
    plan = console_plan()
    with open_study(tmp_path, plan) as store:
        service = SessionService(store, operator="P01", words=words)
        walk(service, store, "questionnaire")
        assert service.look()[1]["scales"][0]["low"] == "gering"
    del scales["effort"]
    with pytest.raises(StudyError, match=r"scales\.effort: is missing"):
        read_words(german(tmp_path, name, scales))
    scales["effort"] = {**part, "low": ""}
    with pytest.raises(StudyError, match=r"scales\.effort\.low: expected a text"):
        read_words(german(tmp_path, name, scales))
    with pytest.raises(SmoothOperatorError, match="no words of NASA-TLX at"):
        read_words(tmp_path / name.replace("de", "fr"))


@pytest.mark.browser
def test_an_operator_fills_in_forms_and_ranks(chromium: Any, tmp_path: Path) -> None:
    forms = (DEFAULT_FORMS[0], SURVEY)
    with open_study(tmp_path, form_plan(*forms, weights=True)) as store:
        service = SessionService(store, operator="P01")
        with served(service) as port:
            pages = Pages(chromium, port)
            page, operator = pages.experimenter, pages.operator
            pages.step("Form: consent")
            send = operator.get_by_role("button", name="Send my answers")
            operator.get_by_role("heading", name="Consent").wait_for()
            assert send.is_disabled()
            for question in operator.locator("fieldset").all():
                question.get_by_label("Yes").check()
            send.click()
            pages.step("Calibration")
            walk(service, store, "weights")
            pages.step("Pairs of scales")
            for left, _ in shown_pairs(0, "P01"):  # the left one of each pair
                title = next(scale.title for scale in SCALES if scale.name == left)
                operator.locator('[data-key="pair-0"]', has_text=title).click()
            operator.get_by_role("button", name="Send my choices").click()
            pages.step("Block 2 of 2")
            wanted = [next(a for a, b in shown_pairs(0, "P01") if {a, b} == {*p}) for p in PAIRS]
            assert store.progress("P01").winners["card", 1] == tuple(wanted)
            walk(service, store, "form")
            pages.step("Form: survey")
            labels = [condition.label for condition in store.plan.protocol.conditions]
            for label in labels[::-1]:
                assert send.is_disabled()
                operator.locator(f'[data-key="rank-{label}"]').click()
            operator.get_by_label('Say "more"').fill("<b>fine</b>")
            send.click()
            pages.step("Done")
            assert "secret" not in operator.content()
            assert not pages.problems
            pages.context.close()
            assert page is not None
        progress = store.progress("P01")
        assert progress.ranking() == ("secrettwo", "secretone")
        assert progress.forms["survey"][1]["said"] == "<b>fine</b>"
        assert kinds(store)[0] == "form_answered"
