"""A page in a headless browser: its errors are collected, and its picture can be compared."""

import io
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from live_time import PATIENCE_S

NO_DRAWING = """
  for (const name of Object.getOwnPropertyNames(WebGL2RenderingContext.prototype))
    if (/^draw(Arrays|Elements|RangeElements)/.test(name))
      WebGL2RenderingContext.prototype[name] = () => {};
"""


def new_page(
    chromium: Any, width: int = 800, height: int = 600, drawn: bool = True
) -> tuple[Any, list[str]]:
    """A page, and a list of its errors so far.

    A software renderer takes a quarter of the time for half of the resolution, and about a second
    of a core for each picture of a scene: a test of controls and texts does without (``drawn``).
    """
    size = {"width": width, "height": height}
    page = chromium.new_page(viewport=size, device_scale_factor=0.5)
    page.set_default_timeout(1e3 * PATIENCE_S)
    if not drawn:
        page.add_init_script(NO_DRAWING)
    problems: list[str] = []
    page.on("pageerror", lambda error: problems.append(str(error)))
    page.on("console", lambda m: problems.append(m.text) if m.type == "error" else None)
    return page, problems


def nameless(page: Any) -> list[str]:
    """The visible controls that have no name for a screen reader."""
    controls: list[str] = page.evaluate(
        """() => [...document.querySelectorAll(
             "button, select, textarea, input:not([type=hidden]), [role=slider]")]
           .filter((it) => it.checkVisibility() && !(it.ariaLabel || it.innerText?.trim() ||
             it.labels?.length || it.getAttribute("aria-labelledby")))
           .map((it) => it.outerHTML.slice(0, 200))"""
    )
    return controls


def picture(page: Any, width: int, height: int) -> np.ndarray:
    """(height, width, 3) the page's upper left part, where the hands are."""
    from PIL import Image

    clip = {"x": 0, "y": 0, "width": width, "height": height}
    shot = Image.open(io.BytesIO(page.screenshot(clip=clip))).convert("RGB")
    return np.asarray(shot.resize((width, height), Image.Resampling.NEAREST), float)


def settled(
    page: Any,
    width: int,
    height: int,
    shows: Callable[[np.ndarray], object] = lambda _: True,
    seconds: float = PATIENCE_S,
) -> np.ndarray:
    """The picture once two in a row are alike, it is not black, and it shows the expected content.

    Two alike may both be from before a change, since a busy browser draws seconds late: a test
    must not take a picture for the last one only because it has settled.
    """
    end = time.monotonic() + seconds
    last = picture(page, width, height)
    while time.monotonic() < end:
        page.wait_for_timeout(150)
        before, last = last, picture(page, width, height)
        if np.abs(last - before).max() < 8 and last.max() > 20.0 and shows(last):
            return last
    raise AssertionError("the page never came to show it and to rest")


def changed(picture: np.ndarray, other: np.ndarray) -> float:
    """The fraction of pixels that clearly differ."""
    return float((np.abs(picture - other).max(axis=-1) > 30).mean())
