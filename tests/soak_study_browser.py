"""A whole study through headless Chromium, by keys and clicks, with disturbances."""

from __future__ import annotations

import time
from argparse import Namespace
from collections.abc import Callable
from pathlib import Path
from typing import Any

from soak_study_pages import Browser, Desk, Shown, Tablet, see
from soak_study_parts import SoakBase
from study_console import ConsoleProcess, ratings

SIMULATED = 0.3
"""Share of the trials that the simulation ends."""
KINDS = (
    "kill", "kill at start", "scored while cut off", "restart", "teleop", "wrong click", "undo",
    "amend", "void", "pause", "second page", "second console", "withdraw", "end block", "reload",
    "recalibrate", "kill at the questionnaire",
)  # fmt: skip


FORM_KINDS = (
    "", "", "consent refused", "reload", "kill", "kill before", "undo",
)  # fmt: skip
"""How a form is disturbed; drawn for each."""


class BrowserSoak(SoakBase):
    """The experimenter and all operators, at two windows of Chromium."""

    def __init__(self, folder: Path, options: Namespace) -> None:
        super().__init__(folder, options, KINDS)
        self.browser = Browser(self.ledger)
        self.times: dict[tuple[Any, ...], tuple[float, float]] = {}
        self.begun = 0.0
        self.tablet_disturbed = ""
        self.odd: list[str] = []
        self.disturbed = False

    def begin(self) -> None:
        """Starts the console and opens both pages, which stay open to the end."""
        self.console.start()
        self.desk = Desk(self.browser, f"http://127.0.0.1:{self.console.port}/")
        self.tablet = Tablet(
            self.browser, f"http://127.0.0.1:{self.console.port}/operator", self.draw
        )

    def wrong(self) -> list[str]:
        """Errors of the pages' scripts, and commands that were not meant."""
        return [*self.browser.problems, *self.odd, *self.ledger.surprises()]

    def close(self) -> None:
        self.browser.close()
        super().close()

    def run(self) -> None:
        while self.waiting:
            code = self.waiting.pop(0)
            begin = time.monotonic()
            self.choose(code)
            self.operator(code)
            took = time.monotonic() - begin
            print(f"{code}: {len(self.ledger.acknowledged)} acknowledged, {took:.0f} s", flush=True)

    def choose(self, code: str) -> Shown:
        shown = self.desk.settled()
        if shown.operator != code:
            shown = self.desk.click(f"person-{code}", "choose", operator=code)
        return shown

    def operator(self, code: str) -> None:
        """Does what is due until nothing is."""
        shown = self.desk.settled()
        for _ in range(5000):
            if shown.dialog:
                raise AssertionError(f"a question is open: {shown.dialog}")
            if shown.gone:  # waits for the hand
                self.desk.page.locator("#hand").wait_for(state="hidden")
                shown = self.desk.settled()
                continue
            if shown.refused:
                self.refusals[shown.refused[:90]] += 1
                shown = self.desk.press("Escape")
            if shown.operator != code:
                shown = self.choose(code)
                continue
            if shown.what in ("done", "withdrawn"):
                return
            shown = self.step(shown) or self.desk.settled()
        raise AssertionError(f"no end for {code}: {self.desk.look()}")

    # What the protocol wants.

    def step(self, shown: Shown) -> Shown | None:
        """Does it; what is shown then, if that is known."""
        who, what, place = shown.operator, shown.what, shown.place
        if what == "calibrate":
            self.desk.page.locator("#detail").fill(f"{who} by hand")
            return self.desk.click("main", "calibrated", operator=who, task=place["task"],
                                   detail=f"{who} by hand")  # fmt: skip
        elif what in ("start_block", "start_familiarisation"):
            return self.desk.press(" ", what, operator=who, **place)
        elif what == "familiarise":
            if self.desk.press("e").dialog:
                return self.desk.answer("end_familiarisation", operator=who, **place)
        elif what == "break":
            return self.desk.press(" ", "end_break", operator=who)
        elif what == "start_trial":
            return self.start_trial(shown)
        elif what == "trial":
            return self.score(shown)
        elif what == "questionnaire":
            return self.questionnaire(shown)
        elif what == "form":
            self.form(shown)
        else:
            raise AssertionError(f"unknown step {what}: {shown}")
        return None

    def start_trial(self, shown: Shown) -> Shown | None:
        if "b" in shown.keys and self.draw.random() < 0.01:
            return self.desk.press("b", "start_break", operator=shown.operator)
        if self.draw.random() < 0.01:
            self.note(shown, f"before {shown.heading}")
        self.disturbed = False
        kind = self.next_disturbance(shown)
        if kind == "kill at start":
            self.done[kind] += 1
            self.begun, self.disturbed = time.monotonic(), True
            self.desk.mean("start_trial", operator=shown.operator, **shown.place)
            self.desk.page.keyboard.press(" ")
            self.kill_soon()
            return None
        self.begun = time.monotonic()
        now = self.desk.press(" ", "start_trial", operator=shown.operator, **shown.place)
        if kind is not None and now.what == "trial":
            self.done[kind] += 1
            self.disturbed = True
            self.kinds[kind](now)
            return None
        return now

    def next_disturbance(self, shown: Shown) -> str | None:
        """How the trial that is due is to be disturbed; asked once for each."""
        key = (shown.operator, *shown.place.values())
        if key in self.seen:
            return None
        self.seen.add(key)
        self.count += 1
        return self.disturbances.get(self.count - 1)

    def score(self, shown: Shown) -> Shown:
        """Stops the clock and scores, as the simulation says or otherwise."""
        if not shown.lines:
            page = self.desk.page
            self.odd.append(f"can't be scored: {shown} {page.locator('main').inner_text()[:300]}")
            print(self.odd[-1], self.browser.problems, flush=True)
            page.locator(".rubric button:enabled").first.wait_for()
            shown = self.desk.settled()
        if "r" in shown.keys and self.draw.random() < 0.1:
            self.disturbed = True
            shown = self.desk.press("r", "reset", operator=shown.operator, **shown.place)
        simulated = None
        if self.draw.random() < SIMULATED:
            simulated = self.draw.uniform(1.0, 50.0)
            self.teleop.simulation.done(self.draw.choice(shown.lines)[1], 1.0, simulated)
        elif not shown.stopped:
            self.desk.page.keyboard.press(" ")
        stop = time.monotonic()
        number, line = self.draw.choice(shown.lines)
        after = self.desk.press(number, "score", operator=shown.operator, **shown.place, line=line)
        if after.dialog:  # the simulation says something else
            after = self.desk.answer()
        if simulated is None and not self.disturbed and not after.refused:
            key = (shown.operator, *shown.place.values())
            self.times[key] = (0.0, stop - self.begun + 0.2)
        return after

    def questionnaire(self, shown: Shown) -> Shown:
        asked = self.tablet.asked()
        assert asked["tlx"], asked
        marks = ratings(self.draw.randrange(100))
        names = list(marks)
        self.tablet.mark({name: marks[name] for name in names[:3]})
        disturbed, self.tablet_disturbed = self.tablet_disturbed, ""
        if disturbed:
            self.restart(kill=True)
            self.tablet.page.reload()  # what was marked is kept on the device
            assert self.tablet.asked()["tlx"]
        self.tablet.mark({name: marks[name] for name in names[3:]})
        self.ledger.mean("answer", shown.operator, {**shown.place, "ratings": marks})
        self.tablet.send()
        if disturbed:
            self.kill_soon()
        return self.desk.after(shown)

    def form(self, shown: Shown) -> None:
        """A form: as it should be, or refused and asked once more, or while pages come and go."""
        title = shown.heading.removeprefix("Form: ")
        form = next(f for f in self.plan.protocol.forms if title == (f.title or f.name))
        name = form.name
        while self.tablet.asked()["title"] != (form.title or form.name):
            pass
        answers = {one.name: self.answer(one, self.tablet.page) for one in form.fields}
        key = (shown.operator, name)
        kind = "" if key in self.seen else self.draw.choice(FORM_KINDS)
        self.seen.add(key)
        refused = kind == "consent refused" and form.refused({})
        self.done["form: " + kind] += bool(kind) and (kind != "consent refused" or refused)
        if refused:
            answers["agreed"] = False
        half = dict(list(answers.items())[: len(answers) // 2])
        if kind in ("reload", "kill before"):
            self.tablet.fill(form, half)
            if kind == "kill before":
                self.restart(kill=True)
            self.tablet.page.reload()
            self.tablet.asked()
            answers = {**half, **answers}
            self.tablet.fill(form, {k: v for k, v in answers.items() if k not in half})
        else:
            self.tablet.fill(form, answers)
        self.ledger.mean("form", shown.operator, {"form": name, "answers": answers})
        self.tablet.send()
        if kind == "kill":
            self.kill_soon()
        after = self.desk.after(shown)
        if refused:
            assert after.what == "refused", after
            self.take_back("a slip")
        elif kind == "undo":
            self.take_back("a wrong answer")

    def answer(self, asked: Any, page: Any) -> Any:
        if asked.kind == "ranking":
            if (again := page.locator('[data-key="again"]')).count():
                again.click()
            found = see(page, "labels")
            return self.draw.sample(found, len(found))
        return {"consent": True, "number": self.draw.randrange(100, 121),
                "choice": self.draw.choice(asked.choices or ("",))}.get(
            asked.kind, f"something {self.draw.randrange(1000)}"
        )  # fmt: skip

    def note(self, shown: Shown, text: str) -> None:
        self.desk.page.keyboard.press("n")
        self.desk.page.keyboard.type(text)
        self.desk.press("Enter", "note", operator=shown.operator, text=text)

    # Disturbances.

    @property
    def kinds(self) -> dict[str, Callable[[Shown], Any]]:
        """Kind -> what is done as a trial has begun."""
        return {
            "kill": self.kill, "scored while cut off": self.cut_off, "teleop": self.lose_hand,
            "restart": lambda shown: self.restart(kill=False), "wrong click": self.wrong_click,
            "undo": self.undo, "amend": self.amend, "void": self.void, "pause": self.pause,
            "second page": self.second_page, "second console": self.second_console,
            "withdraw": self.withdraw, "end block": self.end_block, "reload": self.reload,
            "recalibrate": self.recalibrate,
            "kill at the questionnaire": self.kill_later,
        }  # fmt: skip

    def restart(self, *, kill: bool) -> None:
        """Both pages stay open, and come back by themselves."""
        (self.console.kill if kill else self.console.end)()
        self.console.start()
        self.tablet.page.locator("#link", has_text="connected").wait_for()

    def kill_soon(self) -> None:
        time.sleep(self.draw.choice((0.0, 0.002, 0.01, 0.03)))
        self.restart(kill=True)

    def kill(self, shown: Shown) -> None:
        """The console dies as a score is on its way."""
        number, line = self.draw.choice(shown.lines)
        self.desk.mean("score", operator=shown.operator, **shown.place, line=line)
        self.desk.page.keyboard.press(number)
        if self.desk.look().dialog:
            self.desk.page.locator("#ask-yes").click()
        self.kill_soon()
        self.desk.after(shown)

    def cut_off(self, shown: Shown) -> None:
        """The trial is scored while there is no console, and the page is closed before it is."""
        self.console.kill()
        self.desk.page.locator("#lost").wait_for()
        self.desk.page.keyboard.press(" ")
        number, line = self.draw.choice(shown.lines)
        self.desk.mean("score", operator=shown.operator, **shown.place, line=line)
        self.desk.page.keyboard.press(number)
        if self.desk.look().dialog:
            self.desk.page.locator("#ask-yes").click()
        self.desk.page.goto("about:blank")
        self.console.start()
        self.desk.page.goto(f"http://127.0.0.1:{self.console.port}/")
        self.desk.after(shown)

    def lose_hand(self, shown: Shown) -> None:
        self.teleop.restart()

    def wrong_click(self, shown: Shown) -> None:
        """Presses keys without a meaning and keys twice, and clicks another operator."""
        others = [code for code in self.plan.codes if code != shown.operator]
        for key in ("9", "b", "e", "Enter", "x"):
            self.desk.press(key)
        self.desk.click(f"person-{self.draw.choice(others)}")
        shown = self.desk.press("Escape")  # it was refused
        number, line = self.draw.choice(shown.lines)
        self.desk.mean("score", operator=shown.operator, **shown.place, line=line)
        self.desk.page.keyboard.press(number)
        if self.desk.look().dialog:
            self.desk.page.locator("#ask-yes").dblclick()
        self.desk.page.keyboard.press(number)
        self.desk.after(shown)

    def take_back(self, reason: str) -> Shown:
        shown = self.desk.press("u")
        assert shown.dialog, shown
        return self.desk.answer("undo", operator=self.desk.look().operator,
                                given={"reason": reason}, reason=reason)  # fmt: skip

    def undo(self, shown: Shown) -> None:
        self.score(shown)
        self.take_back("slipped")
        if self.draw.random() < 0.5:
            self.take_back("too early")

    def amend(self, shown: Shown) -> None:
        """A scored trial of any block, the newest one if none is there yet."""
        if not any(key.startswith("amend-") for key in shown.buttons):
            self.score(shown)
            shown = self.desk.settled()
        key = self.draw.choice([key for key in shown.buttons if key.startswith("amend-")])
        _, task, block, trial = key.split("-")
        self.desk.click(key)
        lines = see(self.desk.page, "otherLines")
        given = {"line": self.draw.choice(lines), "reason": "seen on the film", "who": "AB"}
        time_s = {} if self.draw.random() < 0.5 else {"time_s": self.draw.randrange(10, 400) / 8}
        text = {"time": str(time_s["time_s"])} if time_s else {}
        self.desk.answer("amend", operator=shown.operator, given={**given, **text}, task=task,
                         block=int(block), trial=int(trial), **given, **time_s)  # fmt: skip
        if self.draw.random() < 0.3:  # it was right after all
            self.take_back("the other trial")

    def void(self, shown: Shown) -> None:
        self.desk.press("v")
        reason = "the tracker was lost"
        self.desk.answer("void", operator=shown.operator, given={"reason": reason}, reason=reason,
                         **shown.place)  # fmt: skip

    def pause(self, shown: Shown) -> None:
        self.desk.press("p")
        reason = "the robot tripped"
        paused = self.desk.answer("pause", operator=shown.operator, given={"reason": reason},
                                  reason=reason, **shown.place)  # fmt: skip
        assert paused.what == "paused", paused
        if self.draw.random() < 0.5:
            self.restart(kill=True)
        self.desk.settled()
        self.desk.press(" ", "resume", operator=shown.operator, **shown.place)

    def second_page(self, shown: Shown) -> None:
        """Two tabs score the trial, neither waits for the other."""
        url = f"http://127.0.0.1:{self.console.port}/"
        self.both(shown, Desk(self.browser, url, self.desk.page))

    def second_console(self, shown: Shown) -> None:
        """The same from another console on the same study."""
        if self.other is None:
            self.other = ConsoleProcess(self.folder)
            self.other.start()
        desk = Desk(self.browser, f"http://127.0.0.1:{self.other.port}/")
        there = desk.settled()
        if there.operator != shown.operator:
            desk.click(f"person-{shown.operator}", "choose", operator=shown.operator)
        self.both(shown, desk)

    def both(self, shown: Shown, other: Desk) -> None:
        """Both pages ask for a score before either hears of the other's."""
        before = len(self.ledger.scores())
        (first, line), (second, other_line) = shown.lines[0], shown.lines[-1]
        self.desk.mean("score", operator=shown.operator, **shown.place, line=line)
        self.desk.page.keyboard.press(first)
        asks = self.desk.look().dialog  # a question keeps the score back until it is answered
        if asks:
            other.mean("score", operator=shown.operator, **shown.place, line=other_line)
            other.page.keyboard.press(second)
            if other.look().dialog:
                other.page.keyboard.press("Enter")
            self.desk.page.keyboard.press("Enter")
        self.desk.after(shown)
        other.settled()
        self.desk.settled()
        taken = len(self.ledger.scores()) - before
        assert taken == 1, f"{taken} of two scores of one trial were taken"
        other.page.close()

    def withdraw(self, shown: Shown) -> None:
        keep = self.draw.random() < 0.5
        self.desk.click("withdraw")
        given = {"keep": "keep" if keep else "leave", "reason": "felt dizzy"}
        left = self.desk.answer("withdraw", operator=shown.operator, given=given, keep=keep,
                                reason="felt dizzy")  # fmt: skip
        assert left.what == "withdrawn", left
        self.replacements += 1
        new = f"R{self.replacements:02d}"
        self.desk.click("replace")
        now = self.desk.answer("replace", operator=shown.operator, given={"code": new}, by=new)
        assert now.operator == new, now
        self.waiting.append(new)
        self.choose(shown.operator)

    def end_block(self, shown: Shown) -> None:
        for _ in range(6):
            if shown.what == "start_trial":
                break
            if shown.what not in ("trial", "questionnaire"):
                return  # it was the last trial
            self.step(shown)
            shown = self.desk.settled()
        self.desk.click("end-block")
        given = {"reason": "the glove broke"}
        place = {name: shown.place[name] for name in ("task", "block")}
        self.desk.answer("end_block", operator=shown.operator, given=given, **given, **place)

    def reload(self, shown: Shown) -> None:
        self.desk.page.keyboard.press(" ")  # the stopped clock is kept on the device
        self.desk.page.reload()
        self.tablet.page.reload()
        assert self.desk.settled().stopped

    def recalibrate(self, shown: Shown) -> None:
        self.score(shown)
        shown = self.desk.settled()
        if "recalibrate" in shown.buttons:
            self.desk.click("recalibrate")
            detail = "after the break"
            self.desk.answer("recalibrate", operator=shown.operator, given={"detail": detail},
                             detail=detail, task=shown.place["task"])  # fmt: skip

    def kill_later(self, shown: Shown) -> None:
        self.tablet_disturbed = "kill"
