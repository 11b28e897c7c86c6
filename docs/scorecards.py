"""Measures the scorecards of all built-in hands and writes the table and the pictures of
docs/reference/scorecards.md; run it as a script. Hands that are in build/scorecards already are not
measured again: delete that folder after a change of the code."""

import json
import re
from concurrent.futures import ProcessPoolExecutor
from datetime import UTC, datetime
from multiprocessing import get_context
from pathlib import Path
from subprocess import check_output

from PIL import Image, ImageDraw

from smooth_operator.hands.registry import known_hands, load_hand
from smooth_operator_research.scorecard.card import hand_scorecard
from smooth_operator_research.scorecard.command import kapandji_picture

HOME = Path(__file__).parent
PAGE = HOME / "reference" / "scorecards.md"
PICTURE = HOME / "img" / "scorecards.webp"
FOLDER = HOME.parent / "build" / "scorecards"
SIZE = 62
"""Width and height of a view in the picture [px]."""
_NAME = 110  # width of the column of names [px]
_HEADERS = (
    "hand",
    "Kapandji, fingers free",
    "places missed",
    "fingers straight",
    "pinch gaps [mm]",
    "pinch [mm]",
    "tripod [mm]",
    "power [mm]",
    "reach [mm]",
    "GRASP postures",
    "standard postures",
    "standard postures not taken",
)
_STAGES = range(11)


def measure(name: str) -> str:
    """Writes the card and the pictures of a hand; returns its name."""
    card = FOLDER / f"{name}.json"
    if not card.exists():
        hand = load_hand(name)
        scorecard = hand_scorecard(hand)
        strip = Image.new("RGB", (2 * SIZE * len(_STAGES), SIZE), "white")
        for touch in scorecard.free:
            picture = kapandji_picture(hand, [touch], 1, SIZE)
            strip.paste(picture, (2 * SIZE * touch.stage, 0))
        strip.save(card.with_suffix(".png"))
        card.write_text(json.dumps(scorecard.to_json()), encoding="utf-8")
    return name


def row(name: str) -> str:
    """One line of the table."""
    card = json.loads((FOLDER / f"{name}.json").read_text(encoding="utf-8"))
    sizes, tests = card["sizes_mm"], card["kapandji"]
    free, straight = tests["free"], tests["straight"]
    missed = [s for s in map(int, free["distances_mm"]) if s not in free["touched"]]
    reach = max(way["mm"] for way in card["reach"].values())
    postures, grasps = card["postures"], card["grasps"]
    cells = (
        f"`{name}`",
        f"**{len(free['touched'])}** of {free['places']}",
        ", ".join(map(str, missed)) or "–",
        str(len(straight["touched"])),
        " ".join("–" if gap is None else f"{gap:.0f}" for gap in card["gaps_mm"].values()),
        _range(sizes["pinch"]),
        _range(sizes["tripod grasp"]),
        _range(sizes["power grasp"]),
        f"{reach:.0f}",
        f"{grasps['count'] - len(grasps['faults'])} of {grasps['count']}",
        f"{postures['count'] - len(postures['faults'])} of {postures['count']}",
        ", ".join(postures["faults"]) or "–",
    )
    return f"| {' | '.join(cells)} |\n"


def _range(sizes: list[float | None]) -> str:
    low, high = sizes
    return "–" if low is None or high is None else f"{low:.0f} to {high:.0f}"


def sheet(names: list[str]) -> Image.Image:
    """The pictures of all hands, one row per hand."""
    strips = [Image.open(FOLDER / f"{name}.png") for name in names]
    whole = Image.new("RGB", (_NAME + strips[0].width, SIZE * (len(names) + 1)), "white")
    pen = ImageDraw.Draw(whole)
    for stage in _STAGES:
        pen.text((_NAME + (2 * stage + 1) * SIZE, SIZE - 14), str(stage), fill="black", anchor="ma")
    for k, (name, strip) in enumerate(zip(names, strips, strict=True), start=1):
        pen.text((4, SIZE * k + SIZE // 2), name, fill="black", anchor="lm")
        whole.paste(strip, (_NAME, SIZE * k))
    return whole


def main() -> None:
    """Measures the hands, two at a time, and writes the page's table and picture."""
    FOLDER.mkdir(parents=True, exist_ok=True)
    builtin = sorted(name for name, entry in known_hands().items() if entry.builtin)
    names = [name for name in builtin if not load_hand(name).spec.gripper]
    with ProcessPoolExecutor(2, get_context("spawn")) as pool:
        for done, name in enumerate(pool.map(measure, names), start=1):
            print(f"{done} of {len(names)}: {name}", flush=True)
    commit = check_output(["git", "rev-parse", "--short", "HEAD"], cwd=HOME, text=True).strip()
    table = f"| {' | '.join(_HEADERS)} |\n|---|{'---:|' * (len(_HEADERS) - 2)}---|\n"
    table += "".join(map(row, names))
    stated = f"`python docs/scorecards.py`, {datetime.now(UTC):%Y-%m-%d}, commit {commit}.\n"
    page = PAGE.read_text(encoding="utf-8")
    text, count = re.subn(
        r"(?m)(^\|.*\n)+\n`python docs/scorecards\.py`.*\n", lambda _: f"{table}\n{stated}", page
    )
    if count != 1:
        raise SystemExit(f"{PAGE}: expected one table, followed by the line of this script")
    PAGE.write_text(text, encoding="utf-8")
    sheet(names).save(PICTURE, quality=60, method=6)


if __name__ == "__main__":
    main()
