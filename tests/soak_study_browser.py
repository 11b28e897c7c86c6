"""A block of a study in headless Chromium, by keys and clicks, for the soak."""

from __future__ import annotations

import contextlib
import json
import random
import shutil
from collections.abc import Callable
from typing import Any

from playwright.sync_api import Error, sync_playwright
from soak_study_ledger import Ledger
from soak_study_parts import StandIn

FLAGS = ("--no-sandbox", "--disable-gpu", "--disable-background-networking")
PATIENCE_MS, SHORT_MS = 60_000.0, 3_000.0
SCALES = 6


class BrowserPages:
    """Both pages, whose words on their WebSockets go into the ledger.

    Args:
        ledger: of the soak.
        draw: what is chosen at random.
    """

    def __init__(self, ledger: Ledger, draw: random.Random) -> None:
        names = ("chromium", "chromium-browser", "google-chrome")
        path = next(found for name in names if (found := shutil.which(name)))
        self._ledger, self._draw = ledger, draw
        self._driver = sync_playwright().start()
        self._browser = self._driver.chromium.launch(executable_path=path, args=list(FLAGS))
        self._state: dict[str, Any] = {}

    def close(self) -> None:
        self._browser.close()
        self._driver.stop()

    def block(
        self,
        port: int,
        code: str,
        here: tuple[str, int],
        teleop: StandIn,
        in_trial: Callable[[], None],
    ) -> int:
        """Does a block, or what is left of it; returns how many trials it had here.

        Args:
            port: of the console.
            code: the operator who is on.
            here: task and number of the block.
            teleop: the stand-in, whose trials end now and then.
            in_trial: called once in each trial, for what is to disturb it.
        """
        self._state, trials = {}, 0
        context = self._browser.new_context(viewport={"width": 1280, "height": 900})
        pages = {}
        for role, path in (("experimenter", "/"), ("operator", "/operator")):
            page = pages[role] = context.new_page()
            page.set_default_timeout(PATIENCE_MS)
            page.on("websocket", lambda socket, role=role: self._listen(socket, role))
            page.goto(f"http://127.0.0.1:{port}{path}")
            page.locator("#link", has_text="connected").wait_for()
            page.set_default_timeout(SHORT_MS)
        page, asked = pages["experimenter"], pages["operator"]
        disturbed = ""
        for _ in range(2000):
            page.wait_for_timeout(15)  # hears
            now = self._state.get("now") or {}
            if now.get("operator") != code or (now.get("task"), now.get("block")) != here:
                if now:
                    break
                continue
            if now["what"] == "form":
                break
            trial = f"{now['trial']}"
            if now["what"] == "trial" and disturbed != trial:
                disturbed, trials = trial, trials + 1
                in_trial()
                continue
            with contextlib.suppress(Error):  # it was drawn again meanwhile: look once more
                self._step(now, page, asked, teleop)
        else:
            raise AssertionError(f"no end in the browser: {self._state.get('now')}")
        context.close()
        return trials

    def _step(self, now: dict[str, Any], page: Any, asked: Any, teleop: StandIn) -> None:
        what = now["what"]
        if page.locator("dialog[open]").count():
            page.locator("#ask-yes").click()
        elif what == "calibrate":
            self._press(page, "[data-key=main]:enabled")
        elif what in ("start_block", "start_familiarisation", "start_trial", "break", "paused"):
            self._press(page, "[data-press=space]:enabled", " ")
        elif what == "familiarise":
            self._press(page, "[data-press=e]:enabled", "e")
        elif what == "trial":
            possible = [k for k, line in enumerate(now["rubric"], 1) if line["possible"]]
            if self._draw.random() < 0.3:
                teleop.simulation.done("done", 1.0, self._draw.uniform(1.0, 50.0))
            self._press(page, "[data-press=space]:enabled", " ")
            number = str(self._draw.choice(possible))
            self._press(page, f'[data-press="{number}"]:enabled', number)
        elif what == "questionnaire":
            sliders = asked.locator("input[type=range]:enabled")
            if sliders.count() == SCALES:
                for k in range(SCALES):
                    sliders.nth(k).fill(str(5 * self._draw.randrange(21)))
                self._press(asked, "button[data-key=submit]:enabled")

    def _press(self, page: Any, where: str, key: str | None = None) -> None:
        """A key or a click, if the button is there now."""
        button = page.locator(where).first
        if not button.count():
            return
        if key is None:
            button.click()
        else:
            page.keyboard.press(key)

    def _listen(self, socket: Any, role: str) -> None:
        socket.on("framesent", lambda text: self._ledger.asked(_said(text)))
        socket.on("framereceived", lambda text: self._hear(_said(text), role))

    def _hear(self, said: dict[str, Any], role: str) -> None:
        if said.get("type") in ("done", "refused"):
            self._ledger.heard(said)
        elif said.get("type") == "state" and role == "experimenter":
            self._state = said


def _said(text: Any) -> dict[str, Any]:
    try:
        said = json.loads(text)
    except (TypeError, ValueError):
        return {}
    return said if isinstance(said, dict) else {}
