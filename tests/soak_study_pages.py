"""The two pages of a study in headless Chromium, read and used as people do: by sight and keys.

A page is waited for by what it shows, never by a fixed time. What the scripts mean to do goes into
``Ledger.intended``, so that a page that asks for something else is found out.
"""

from __future__ import annotations

import json
import random
import re
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from playwright.sync_api import sync_playwright
from soak_study_ledger import Ledger

FLAGS = (
    "--no-sandbox", "--disable-gpu", "--disable-background-networking", "--disable-sync",
    "--disable-component-update", "--disable-renderer-backgrounding",
    "--disable-background-timer-throttling", "--disable-backgrounding-occluded-windows",
)  # fmt: skip
PATIENCE_MS = 120_000.0
SEE = Path(__file__).with_suffix(".js").read_text(encoding="utf-8")
UNTIL = """async ([name, given]) => {
    const see = SEE;
    const end = performance.now() + 120000;
    while (performance.now() < end) {
        const found = see[name](given);
        if (found) return found;
        await new Promise((go) => setTimeout(go, 8));
    }
    throw new Error(`${name} did not come about`);
}""".replace("SEE", SEE)


def see(page: Any, what: str, given: Any = None) -> Any:
    """What a function of ``soak_study_pages.js`` sees on a page, once it sees something."""
    return page.evaluate(UNTIL, [what, given])


@dataclass(frozen=True)
class Shown:
    """What the experimenter's page shows."""

    what: str
    where: str
    heading: str
    link: str
    who: str
    dialog: str
    refused: str
    gone: str
    stopped: bool
    lines: list[list[str]]
    keys: list[str]
    buttons: list[str]
    log: str

    @property
    def operator(self) -> str:
        found = re.match(r"(?:Operator )?(\S+)", self.where)
        return found[1] if found else ""

    @property
    def place(self) -> dict[str, Any]:
        """Task, block and trial, as far as they can be read."""
        found = re.search(r"Task (\S+)\s+block (\d+) of", self.where)
        trial = re.match(r"Trial (\d+) of", self.heading)
        place: dict[str, Any] = {} if found is None else {"task": found[1], "block": int(found[2])}
        return place if trial is None else {**place, "trial": int(trial[1])}

    @property
    def step(self) -> tuple[str, ...]:
        """Changes with what is due."""
        return self.what, self.where, self.heading


class Browser:
    """Headless Chromium, with a window for each page."""

    def __init__(self, ledger: Ledger) -> None:
        names = ("chromium", "chromium-browser", "google-chrome")
        path = next(found for name in names if (found := shutil.which(name)))
        self.ledger = ledger
        self._driver = sync_playwright().start()
        self._browser = self._driver.chromium.launch(executable_path=path, args=list(FLAGS))
        self.problems: list[str] = []

    def page(self, url: str, other: Any = None, *, tall: bool = False) -> Any:
        """A page that is open and connected.

        Args:
            url: its address.
            other: a page, with whose storage it is opened, as a second tab is.
            tall: as a tablet.
        """
        size = {"width": 820, "height": 1180} if tall else {"width": 1280, "height": 900}
        context = other.context if other else self._browser.new_context(viewport=size)
        page = context.new_page()
        page.set_default_timeout(PATIENCE_MS)
        page.on("pageerror", lambda error: self.problems.append(str(error)))
        page.on("websocket", self._listen)
        page.goto(url)
        page.locator("#link", has_text="connected").wait_for()
        return page

    def close(self) -> None:
        self._browser.close()
        self._driver.stop()

    def _listen(self, socket: Any) -> None:
        socket.on("framesent", lambda text: self.ledger.asked(_said(text)))
        socket.on("framereceived", lambda text: self._hear(_said(text)))

    def _hear(self, said: dict[str, Any]) -> None:
        if said.get("type") in ("done", "refused"):
            self.ledger.heard(said)


class Desk:
    """The experimenter's page."""

    def __init__(self, browser: Browser, url: str, other: Any = None) -> None:
        self.page, self.ledger = browser.page(url, other), browser.ledger

    def look(self) -> Shown:
        """What is there now."""
        return Shown(**see(self.page, "shown"))

    def settled(self) -> Shown:
        """What is there once nothing is under way, or a dialog is open."""
        return Shown(**see(self.page, "settled"))

    def after(self, seen: Shown) -> Shown:
        """What is there once another step is due."""
        before = json.dumps(list(seen.step), ensure_ascii=False, separators=(",", ":"))
        return Shown(**see(self.page, "settled", before))

    def press(self, key: str, do: str = "", **fields: Any) -> Shown:
        """A key; says in the ledger what it should ask for."""
        if do:
            self.mean(do, **fields)
        self.page.keyboard.press(key)
        return self.settled()

    def click(self, key: str, do: str = "", **fields: Any) -> Shown:
        """A button, by the name that the page has for it."""
        if do:
            self.mean(do, **fields)
        self.page.locator(f'[data-key="{key}"]:enabled').click()
        return self.settled()

    def answer(
        self,
        do: str = "",
        *,
        operator: str = "",
        given: dict[str, str] | None = None,
        **fields: Any,
    ) -> Shown:
        """Fills in the dialog that is open, and confirms it."""
        for name, value in (given or {}).items():
            field = self.page.locator(f"#ask-{name}")
            if field.evaluate("field => field.tagName") == "SELECT":
                field.select_option(value)
            else:
                field.fill(value)
        if do:
            self.mean(do, operator=operator, **fields)
        if given:
            self.page.locator("#ask-yes").click()
        else:
            self.page.keyboard.press("Enter")  # the button has the focus
        return self.settled()

    def cancel(self) -> Shown:
        """Leaves the dialog."""
        self.page.locator("#ask-no").click()
        return self.settled()

    def mean(self, do: str, *, operator: str = "", **fields: Any) -> None:
        """What is going to be asked for, of the operator who is on."""
        self.ledger.mean(do, operator or self.look().operator, fields)


class Tablet:
    """The operator's page."""

    def __init__(self, browser: Browser, url: str, draw: random.Random) -> None:
        self.page, self.ledger, self._draw = browser.page(url, tall=True), browser.ledger, draw

    def asked(self) -> dict[str, Any]:
        """What the page asks now, once it does."""
        found: dict[str, Any] = see(self.page, "asked")
        return found

    def mark(self, ratings: dict[str, int]) -> None:
        """Clicks on the scales, and sees to it that the marks are where they are meant to be."""
        names = list(ratings)
        for name in names:
            [box] = see(self.page, "sliders", [name])
            x = box["left"] + 8.0 + (box["width"] - 16.0) * ratings[name] / 100.0
            self.page.mouse.click(x, box["y"])
        for name, box in zip(names, see(self.page, "sliders", names), strict=True):
            off = ratings[name] - int(box["value"])
            for _ in range(abs(off) // 5):
                self.page.locator(f"#scale-{name}").press("ArrowRight" if off > 0 else "ArrowLeft")

    def fill(self, form: Any, answers: dict[str, Any]) -> None:
        fill_form(self.page.locator("#main"), form, answers)

    def send(self) -> None:
        self.page.locator('button[data-key="submit"]:enabled').click()


def fill_form(place: Any, form: Any, answers: dict[str, Any]) -> None:
    """Fills in a form of the plan, on either page."""
    for field in form.fields:
        if field.name not in answers:
            continue
        value = answers[field.name]
        if field.kind == "ranking":
            again = place.locator('[data-key="again"]')
            if again.count():
                again.click()
            for label in value:
                place.locator(f'[data-key="rank-{label}"]').click()
        elif field.kind in ("consent", "choice", "scale"):
            wanted = {True: "true", False: "false"}.get(value, str(value))
            place.locator(f'input[name="{field.name}"][value="{wanted}"]').check()
        else:
            place.locator(f"#field-{field.name}").fill(str(value))


def _said(text: Any) -> dict[str, Any]:
    try:
        said = json.loads(text)
    except (TypeError, ValueError):
        return {}
    return said if isinstance(said, dict) else {}
