"""A page in a headless browser: opened so that its complaints are heard, and looked at."""

from __future__ import annotations

import io
from typing import Any

import numpy as np


def new_page(chromium: Any, width: int = 800, height: int = 600) -> tuple[Any, list[str]]:
    """A page, and what it has complained about so far."""
    page = chromium.new_page(viewport={"width": width, "height": height})
    page.set_default_timeout(60_000)  # software rendering on a busy machine
    problems: list[str] = []
    page.on("pageerror", lambda error: problems.append(str(error)))
    page.on("console", lambda m: problems.append(m.text) if m.type == "error" else None)
    return page, problems


def picture(page: Any, width: int, height: int) -> np.ndarray:
    """(height, width, 3) the page's upper left part, where the hands are."""
    from PIL import Image

    clip = {"x": 0, "y": 0, "width": width, "height": height}
    return np.asarray(Image.open(io.BytesIO(page.screenshot(clip=clip))).convert("RGB"), float)


def settled(page: Any, width: int, height: int, bare: float = 20.0) -> np.ndarray:
    """The picture once two in a row are alike and there is something on it."""
    last = picture(page, width, height)

    def still() -> np.ndarray | None:
        nonlocal last
        page.wait_for_timeout(150)
        before, last = last, picture(page, width, height)
        return last if np.abs(last - before).max() < 8 and last.max() > bare else None

    for _ in range(60):
        if (found := still()) is not None:
            return found
    raise AssertionError("the picture never came to rest")
