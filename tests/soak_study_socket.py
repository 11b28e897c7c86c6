"""A whole study over the WebSockets of the pages, without a browser, with disturbances."""

from __future__ import annotations

import contextlib
import json
import secrets
import time
from argparse import Namespace
from pathlib import Path
from typing import Any

from soak_study_parts import Page, SoakBase
from study_console import ConsoleProcess, ratings

from smooth_operator.study.console.commands import Command

KINDS = (
    "kill", "restart", "teleop", "wrong click", "undo", "amend", "void", "pause", "second page",
    "second console", "withdraw", "end block",
)  # fmt: skip


class SocketSoak(SoakBase):
    """The experimenter and all operators, at the pages' ends of the WebSocket."""

    def __init__(self, folder: Path, options: Namespace) -> None:
        super().__init__(folder, options, KINDS)
        self.pages: dict[str, Page] = {}

    def begin(self) -> None:
        self.console.start()

    # One command.

    @property
    def now(self) -> dict[str, Any]:
        now: dict[str, Any] = self.page().state["now"] or {}
        return now

    def page(self, role: str = "experimenter") -> Page:
        while role not in self.pages:
            try:
                page = Page(self.console.port, role, self.ledger)
                page.until(lambda state: state)
                self.pages[role] = page
            except AssertionError:
                raise
            except Exception:  # the console is not back yet
                time.sleep(0.05)
        return self.pages[role]

    def ask(self, do: str, *, role: str = "experimenter", after: int | None = -1,
            operator: str | None = None, kill: bool = False, **fields: Any) -> bool:  # fmt: skip
        """Sends until it is answered, as a page does; whether it was done."""
        now = self.now
        asked = Command(secrets.token_hex(16), do, operator or now.get("operator", ""),
                        now.get("after") if after == -1 else after, fields)  # fmt: skip
        while True:
            try:
                page = self.page(role)
                if kill:
                    kill = False
                    page.send(asked)
                    time.sleep(self.draw.choice((0.0, 0.002, 0.01, 0.03)))
                    self.restart(kill=True)
                    self.resent += 1
                    continue
                answer = page.ask(asked)
            except AssertionError:
                raise
            except Exception:  # cut off
                self.resent += 1
                self.drop()
                continue
            if answer["type"] == "done":
                self.look()
                return True
            if not answer.get("again"):
                self.look()
                return False
            time.sleep(0.1)

    def drop(self) -> None:
        for page in self.pages.values():
            with contextlib.suppress(Exception):
                page.close()
        self.pages = {}

    def restart(self, *, kill: bool) -> None:
        (self.console.kill if kill else self.console.end)()
        self.console.start()
        self.drop()

    def look(self) -> None:
        """Keeps what is sent to the experimenter's page meanwhile."""
        page = self.page()
        with contextlib.suppress(TimeoutError):
            while True:
                said = json.loads(page.socket.recv(timeout=0))
                if said["type"] == "state":
                    page.state = said

    def place(self, *names: str) -> dict[str, Any]:
        return {name: self.now[name] for name in names}

    # The study.

    def run(self) -> None:
        while self.waiting:
            code = self.waiting.pop(0)
            if not self.ask("choose", operator=code, after=None):
                raise AssertionError(f"{code} can't be chosen")
            self.operator(code)

    def operator(self, code: str) -> None:
        for _ in range(5000):
            now = self.now
            if now.get("operator") != code:
                self.ask("choose", operator=code, after=None, confirm=True)
                continue
            if now["what"] in ("done", "withdrawn") or now.get("withdrawn"):
                return
            self.step(now)
        raise AssertionError(f"no end for {code}: {self.now}")

    def step(self, now: dict[str, Any]) -> None:
        what = now["what"]
        plain = {
            "calibrate": ("calibrated", ("task",)),
            "start_block": ("start_block", ("task", "block")),
            "start_familiarisation": ("start_familiarisation", ("task", "block")),
            "familiarise": ("end_familiarisation", ("task", "block")), "break": ("end_break", ()),
            "start_trial": ("start_trial", ("task", "block", "trial")),
        }  # fmt: skip
        if what in plain:
            do, names = plain[what]
            if not self.ask(do, **self.place(*names)):
                time.sleep(0.1)  # a hand that is gone, for example
        elif what == "trial":
            self.trial(now)
        elif what == "questionnaire":
            given = ratings(self.draw.randrange(100))
            self.ask("answer", role="operator", ratings=given, point=now["point"],
                     **self.place("task", "block"))  # fmt: skip
        elif what == "form":
            form = next(f for f in self.plan.protocol.forms if f.name == now["form"])
            answers = {f.name: self.answer(f) for f in form.fields}
            self.ask("form", role="operator", form=form.name, answers=answers)
        else:
            raise AssertionError(f"unknown step {what}")

    def answer(self, asked: Any) -> Any:
        if asked.kind == "ranking":
            labels = [c.label for c in self.plan.protocol.conditions]
            return self.draw.sample(labels, len(labels))
        return {"consent": True, "number": 120, "choice": next(iter(asked.choices), "")}.get(
            asked.kind, "something"
        )

    def trial(self, now: dict[str, Any]) -> None:
        key = (now["operator"], now["task"], now["block"], now["trial"])
        if key not in self.seen:
            self.seen.add(key)
            kind = self.disturbances.get(self.count)
            self.count += 1
            if kind is not None:
                self.done[kind] += 1
                self.disturb(kind)
                return
        self.score()

    def score(self, **more: Any) -> bool:
        now = self.now
        if now["what"] != "trial":
            return False
        if self.draw.random() < 0.1 and now["resets_left"]:
            self.ask("reset", **self.place("task", "block", "trial"))
            now = self.now
        lines = [line["name"] for line in now["rubric"] if line["possible"]]
        if self.draw.random() < 0.5:
            self.teleop.simulation.done(lines[0], 1.0, self.draw.uniform(1.0, 50.0))
        line = self.draw.choice(lines)
        return self.ask("score", line=line, **self.place("task", "block", "trial"), **more)

    # Disturbances.

    def disturb(self, kind: str) -> None:
        {
            "kill": self.kill, "restart": lambda: self.restart(kill=False),
            "teleop": self.teleop.restart, "wrong click": self.wrong_click, "undo": self.undo,
            "amend": self.amend, "void": self.void, "pause": self.pause,
            "second page": self.second_page, "second console": self.second_console,
            "withdraw": self.withdraw, "end block": self.end_block,
        }[kind]()  # fmt: skip

    def kill(self) -> None:
        self.score(kill=True)

    def wrong_click(self) -> None:
        now = self.now
        place = self.place("task", "block", "trial")
        others = [code for code in self.plan.codes if code != now["operator"]]
        wrong = {**place, "trial": place["trial"] + 1}
        line = now["rubric"][0]["name"]
        assert not self.ask("choose", operator=self.draw.choice(others), after=None)
        assert not self.ask("score", line=line, **wrong)
        assert not self.ask("start_block", **self.place("task", "block"))
        assert not self.ask("score", line=line, after=now["after"] - 2, **place)
        assert not self.ask("score", line="no-such-line", **place)

    def undo(self) -> None:
        if self.score() and (last := self.now["undoable"]):
            self.ask("undo", number=last["number"], reason="slipped")
        if self.draw.random() < 0.5 and (last := self.now["undoable"]):  # and the start
            self.ask("undo", number=last["number"], reason="too early")

    def amend(self) -> None:
        if not self.now["scored"]:
            self.score()
        block = self.draw.choice(self.now["scored"])
        one = self.draw.choice(block["trials"])
        task = next(t for t in self.plan.protocol.tasks if t.name == block["task"])
        failed = next(line.name for line in reversed(task.rubric) if line.name != one["line"])
        done = self.ask("amend", task=task.name, block=block["block"], trial=one["trial"],
                        line=failed, reason="seen on the film", who="AB")  # fmt: skip
        assert done, "not amended"

    def void(self) -> None:
        self.ask("void", reason="the tracker was lost", **self.place("task", "block", "trial"))

    def pause(self) -> None:
        place = self.place("task", "block", "trial")
        self.ask("pause", reason="the robot tripped", **place)
        if self.draw.random() < 0.5:
            self.restart(kill=True)
        self.ask("resume", **place)

    def second_page(self) -> None:
        """Two pages of one console score the trial, neither waits for the other."""
        self._both(Page(self.console.port, "experimenter", self.ledger))

    def second_console(self) -> None:
        """The same from another console on the same study."""
        if self.other is None:
            self.other = ConsoleProcess(self.folder)
            self.other.start()
        page = Page(self.other.port, "experimenter", self.ledger)
        page.until(lambda state: state)
        page.ask(Command(secrets.token_hex(16), "choose", self.now["operator"], None,
                         {"confirm": True}))  # fmt: skip
        self._both(page)

    def _both(self, page: Page) -> None:
        now, place = self.now, self.place("task", "block", "trial")
        lines = [line["name"] for line in now["rubric"] if line["possible"]]
        asked = [
            Command(secrets.token_hex(16), "score", now["operator"], now["after"],
                    {**place, "line": line})
            for line in (lines[0], lines[-1])
        ]  # fmt: skip
        ends = (self.page(), page)
        for one, command in zip(ends, asked, strict=True):
            one.send(command)
        for one, command in zip(ends, asked, strict=True):
            while one.hear().get("token") != command.token:
                pass
        taken = sum(command.token in self.ledger.acknowledged for command in asked)
        assert taken == 1, f"{taken} of two scores of one trial were taken"
        page.close()
        self.look()

    def withdraw(self) -> None:
        code = self.now["operator"]
        assert self.ask("withdraw", keep=self.draw.random() < 0.5, reason="felt dizzy")
        self.replacements += 1
        new = f"R{self.replacements:02d}"
        assert self.ask("replace", operator=code, after=None, by=new)
        self.waiting.append(new)

    def end_block(self) -> None:
        self.score()
        while self.now["what"] != "start_trial":
            if self.now["what"] in ("start_block", "calibrate", "form", "done"):
                return  # it was the last trial
            self.step(self.now)
        self.ask("end_block", reason="the glove broke", **self.place("task", "block"))

    def close(self) -> None:
        self.drop()
        super().close()
