"""Consoles of a study for tests: in a thread, or as the command in a process that can be killed."""

import asyncio
import contextlib
import http.client
import json
import os
import secrets
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from live_time import PATIENCE_S

from smooth_operator.web.listening import listen
from smooth_operator_study.console.server import Console, ConsoleAuth
from smooth_operator_study.console.session_service import Command, SessionService
from smooth_operator_study.design.plan import Plan, make_plan
from smooth_operator_study.design.protocol import Condition, Protocol, RubricLine, Task
from smooth_operator_study.store.nasa_tlx import SCALE_NAMES
from smooth_operator_study.store.progress import Progress
from smooth_operator_study.store.study_store import StudyStore, open_study

PATIENCE_MS = 1e3 * PATIENCE_S


def console_plan(trials: int = 3, *, seconds: float = 0.0, resets: int = 1) -> Plan:
    """Two operators, two conditions whose names are found wherever they leak, one task."""
    conditions = (Condition("secretone", "sbr", "realtime"), Condition("secrettwo", "dexpilot"))
    rubric = (
        RubricLine("done", 1.0, "as told"),
        RubricLine("nearly", 0.5, "after all"),
        RubricLine("failed", 0.0, "dropped"),
    )
    task = Task("card", trials=trials, title="Card pickup", rubric=rubric, time_limit_s=60.0)
    return make_plan(
        Protocol(
            "console",
            conditions,
            (task,),
            "secrettwo",
            2,
            familiarisation_s=seconds,
            resets=resets,
        )
    )


def command(
    progress: Progress,
    do: str,
    *,
    waited_s: float = 0.0,
    token: str | None = None,
    after: int | None = -1,
    **fields: Any,
) -> Command:
    """What a page that has seen all would send; its place is filled in."""
    step = progress.step
    place: dict[str, Any] = {}
    placeless = ("note", "undo", "start_break", "end_break", "amend", "withdraw", "form", "choose")
    if step.block is not None and do not in placeless:
        place = {"task": step.block.task.name}
        if do not in ("calibrated", "recalibrate"):
            place["block"] = step.block.number
        if do in ("start_trial", "reset", "score", "void", "pause", "resume"):
            place["trial"] = step.trial
        if do == "answer":
            place["point"] = step.point
    seen = progress.number if after == -1 else after
    token = token or secrets.token_hex(16)
    return Command(token, do, progress.operator, seen, {**place, **fields}, waited_s)


def give(service: SessionService, do: str, *, role: str = "experimenter", **fields: Any) -> int:
    """Carries out a command for the selected operator, from a page that has seen everything."""
    asked = command(service._store.progress(service.operator), do, **fields)
    return service.carry_out(asked, role)


def ratings(k: int) -> dict[str, int]:
    return {name: 5 * ((k + i) % 21) for i, name in enumerate(SCALE_NAMES)}


def due_command(progress: Progress, line: str = "done") -> Command | None:
    """The next command of the protocol; None where all is done or something else is awaited."""
    words = {
        "calibrate": "calibrated",
        "start_block": "start_block",
        "start_trial": "start_trial",
        "start_familiarisation": "start_familiarisation",
        "familiarise": "end_familiarisation",
        "break": "end_break",
    }
    what = progress.step.what
    if what in words:
        return command(progress, words[what])
    if what == "trial":
        return command(progress, "score", line=line)
    if what == "questionnaire":
        return command(progress, "answer", ratings=ratings(progress.number))
    return None


def walk(service: SessionService, until: str, task: str | None = None) -> None:
    """Carries out due commands of the selected operator until a step (of a task) is due."""
    for _ in range(200):
        progress = service._store.progress(service.operator)
        step = progress.step
        if step.what == until and task in (None, step.block and step.block.task.name):
            return
        asked = due_command(progress)
        service.carry_out(asked, "operator" if asked.do == "answer" else "experimenter")
    raise AssertionError("no end")


def eventually(check: Callable[[], Any], what: str = "it") -> Any:
    end = time.monotonic() + PATIENCE_S
    while not (value := check()):
        assert time.monotonic() < end, f"{what} did not come about"
        time.sleep(0.02)
    return value


@contextlib.contextmanager
def served(service: SessionService, auth: ConsoleAuth | None = None) -> Iterator[int]:
    """A console in a thread; its port."""
    listening = listen("127.0.0.1", 0)
    port = int(listening.getsockname()[1])
    auth = auth or ConsoleAuth(None)
    console = Console(service, auth, auth.links("127.0.0.1", port), local=auth.tokens is None)
    service._changed = console.changed
    ready, ends = threading.Event(), threading.Event()
    failed: list[BaseException] = []

    async def serve() -> None:
        stop = asyncio.Event()
        waiting = asyncio.create_task(console.serve(listening, stop, ready.set))
        while not ends.is_set() and not waiting.done():
            await asyncio.sleep(0.02)
        stop.set()
        await waiting

    def run() -> None:
        try:
            asyncio.run(serve())
        except BaseException as error:
            failed.append(error)

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    try:
        assert ready.wait(PATIENCE_S), failed
        yield port
    finally:
        ends.set()
        thread.join(PATIENCE_S)
        listening.close()
    assert not failed


class Tab:
    """A page's end of the WebSocket, without a page."""

    def __init__(self, port: int, role: str = "experimenter") -> None:
        from websockets.sync.client import connect

        path = "/link" if role == "experimenter" else "/operator/link"
        self.socket = connect(f"ws://127.0.0.1:{port}{path}", open_timeout=PATIENCE_S, proxy=None)
        self.state: dict[str, Any] = {}

    def hear(self) -> dict[str, Any]:
        said = json.loads(self.socket.recv(timeout=PATIENCE_S))
        if said["type"] == "state":
            self.state = said
        return said

    def until(self, check: Callable[[dict[str, Any]], Any]) -> dict[str, Any]:
        """Hears until the state is as it should be."""
        end = time.monotonic() + PATIENCE_S
        while not (self.state and check(self.state)):
            assert time.monotonic() < end
            self.hear()
        return self.state

    def send(self, asked: Command) -> None:
        self.socket.send(
            json.dumps(
                {
                    "type": "command",
                    "token": asked.token,
                    "do": asked.do,
                    "after": asked.after,
                    "operator": asked.operator,
                    "fields": asked.fields,
                    "waited_s": asked.waited_s,
                }
            )
        )

    def ask(self, asked: Command) -> dict[str, Any]:
        self.send(asked)
        while (said := self.hear()).get("token") != asked.token:
            pass
        return said

    def close(self) -> None:
        self.socket.close()


class ConsoleProcess:
    """``smooth-operator study run`` on a port that stays."""

    def __init__(self, study: Path, *options: str) -> None:
        with listen("127.0.0.1", 0) as free:
            self.port = int(free.getsockname()[1])
        self.log = study.parent / f"console-{self.port}.log"
        self._command = [
            sys.executable,
            "-m",
            "smooth_operator",
            "study",
            "run",
            str(study),
            "--port",
            str(self.port),
            *options,
        ]
        self._process: subprocess.Popen[bytes] | None = None

    def start(self) -> None:
        with self.log.open("ab") as log:
            self._process = subprocess.Popen(self._command, stdout=log, stderr=log)
        eventually(self._answers, "the console")

    def kill(self) -> None:
        os.kill(self._process.pid, signal.SIGKILL)
        self._process.wait(PATIENCE_S)

    def end(self, how: int = signal.SIGINT) -> int:
        """As Ctrl-C does, or another signal."""
        if self._process.poll() is None:
            self._process.send_signal(how)
        return self._process.wait(PATIENCE_S)

    def _answers(self) -> bool:
        assert self._process.poll() is None, self.log.read_text()
        with contextlib.suppress(OSError, http.client.HTTPException):
            return fetch(self.port, "/link.js")[0] == 200
        return False


def fetch(port: int, path: str, **headers: str) -> tuple[int, dict[str, str], bytes]:
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=PATIENCE_S)
    try:
        connection.request("GET", path, headers=headers)
        response = connection.getresponse()
        body = response.read()
        return response.status, {n.lower(): v for n, v in response.getheaders()}, body
    finally:
        connection.close()


class Pages:
    """The experimenter's and the operator's page, and what they complained about."""

    def __init__(self, chromium: Any, port: int) -> None:
        self.problems: list[str] = []
        size = {"width": 1280, "height": 860}
        self.context = chromium.new_context(viewport=size, device_scale_factor=0.5)
        self.experimenter = self._page(f"http://127.0.0.1:{port}/")
        self.operator = self._page(f"http://127.0.0.1:{port}/operator", 820, 1180)

    def _page(self, url: str, width: int = 1280, height: int = 860) -> Any:
        page = self.context.new_page()
        page.set_viewport_size({"width": width, "height": height})
        page.set_default_timeout(PATIENCE_MS)
        page.on("pageerror", lambda error: self.problems.append(str(error)))
        page.on("console", lambda m: m.type == "error" and self.problems.append(m.text))
        page.goto(url)
        page.locator("#link", has_text="connected").wait_for()
        return page

    def step(self, heading: str) -> None:
        self.experimenter.get_by_role("heading", name=heading, exact=True).wait_for()

    def press(self, key: str, enabled: str) -> None:
        """A key, once the button that it stands on can be pressed."""
        self.experimenter.locator(f'[data-press="{enabled}"]:enabled').wait_for()
        self.experimenter.keyboard.press(key)

    def start_first_trial(self) -> None:
        """From the calibration to the running clock of the first trial."""
        self.experimenter.get_by_role("button", name="Calibrated").click()
        self.step("Block 1 of 2")
        self.press(" ", "space")
        self.step("Trial 1 of 3")
        self.press(" ", "space")

    def cut_off(self) -> None:
        for page in (self.experimenter, self.operator):
            page.locator("#lost").wait_for()

    def back(self) -> None:
        for page in (self.experimenter, self.operator):
            page.locator("#link", has_text="connected").wait_for()
            page.locator("#lost").wait_for(state="hidden")


@contextlib.contextmanager
def console_pages(
    chromium: Any,
    folder: Path,
    plan: Plan | None = None,
    *,
    operator: str = "P01",
    teleop: Any = None,
) -> Iterator[tuple[StudyStore, SessionService, Pages]]:
    """The pages of a console in a browser. At the end, they must have had no problem."""
    with open_study(folder, plan or console_plan()) as store:
        service = SessionService(store, operator=operator, teleop=teleop)
        with served(service, ConsoleAuth(None)) as port:
            pages = Pages(chromium, port)
            yield store, service, pages
            assert not pages.problems
            pages.context.close()


def mark(operator: Any, marks: dict[str, int]) -> None:
    for name, value in marks.items():
        operator.locator(f"#scale-{name}").fill(str(value))
