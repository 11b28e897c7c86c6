"""Texts that would run if a page took them for markup or for a script, and a hand that has them."""

import html
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from browser_page import new_page

from smooth_operator.hand_files.spec_writer import write_hand_spec
from smooth_operator.hands.spec import FingerSpec, HandSpec, Point

ATTACK = "<img src=x onerror=window.__pwned=1>{globalThis.__pwned=2}<b id=bold>"
FINGERS = {"thumb": (0.035, -0.01, 0.03), "index": (0.03, 0.0, 0.1), "pinky": (-0.03, 0.0, 0.09)}


def hostile_hand(folder: Path) -> Path:
    """A hand whose model, bodies, joints, source and folder are named by an attacker."""
    bodies = ""
    for name, (x, y, z) in FINGERS.items():
        parts = ""
        for part in ("3", "2", "1"):
            label = html.escape(f"{ATTACK}{name}{part}", quote=True)
            at = f"{x} {y} {z}" if part == "1" else "0 0 0.03"
            parts = (
                f'<body name="{label}" pos="{at}"><joint name="j{label}" axis="1 0 0" '
                'range="0 1.6"/><geom type="capsule" fromto="0 0 0 0 0 0.03" size="0.008"/>'
                f"{parts}</body>"
            )
        bodies += parts
    palm = html.escape(ATTACK, quote=True)
    folder.mkdir()
    model = folder / f"{ATTACK}.xml"
    model.write_text(
        f'<mujoco model="{palm}"><worldbody><body name="{palm}"><geom type="box" '
        f'size="0.04 0.012 0.045" pos="0 0 0.05"/>{bodies}</body></worldbody></mujoco>'
    )
    spec = HandSpec(
        name="hostile",
        side="right",
        model=model,
        palm=ATTACK,
        wrist=Point(ATTACK),
        fingers=tuple(
            FingerSpec(
                name,
                (
                    Point(f"{ATTACK}{name}1"),
                    Point(f"{ATTACK}{name}2"),
                    Point(f"{ATTACK}{name}3"),
                    Point(f"{ATTACK}{name}3", (0.0, 0.0, 0.03)),
                ),
            )
            for name in FINGERS
        ),
        source=ATTACK,
    )
    write_hand_spec(spec, folder / "hand.toml")
    return folder / "hand.toml"


@contextmanager
def guarded_page(chromium: Any) -> Iterator[Any]:
    """A page on which nothing of the attack may have happened in the end."""
    page, problems = new_page(chromium, 1100, 900, drawn=False)
    yield page
    assert page.evaluate("window.__pwned") is None
    assert page.locator('img[src="x"], #bold').count() == 0
    assert not [each for each in problems if "favicon" not in each]
    page.close()
