"""``smooth-operator hands check NAME --scorecard``: prints a hand's scorecard or writes a page."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from smooth_operator.cli.console import output_console, plain_table
from smooth_operator.hands.hand import Hand
from smooth_operator.hands.registry import load_hand
from smooth_operator_research.scorecard.card import Scorecard, hand_scorecard
from smooth_operator_research.scorecard.grasp_sizes import ANTIPODAL
from smooth_operator_research.scorecard.kapandji import PATCH, PLACES, TOUCHED, Touch
from smooth_operator_research.scorecard.pose_search import OVERLAP
from smooth_operator_research.scorecard.postures import (
    LARGEST_ANGLE,
    LARGEST_BEND,
    LARGEST_GAP,
)

if TYPE_CHECKING:
    from PIL.Image import Image

    from smooth_operator.cli.hands_check import Check
    from smooth_operator.hand_discovery.hand_validation import Track

RULES: Final = (
    "Kinematics of the model only, within joint limits and couplings, without gravity, force and "
    "friction; a search may miss what the hand can do. Kapandji: a place is "
    f"touched if the thumb's tip is within {1e3 * TOUCHED:.0f} mm of a patch of "
    f"{2e3 * PATCH:.0f} mm and no other parts overlap by more than {1e3 * OVERLAP:.0f} mm; on a "
    "hand without a little finger, its last finger stands in for stages 7 to 10. Objects: a ball "
    "between thumb and finger (pinch) or thumb, index and middle finger (tripod), a cylinder "
    "between palm and the tips of index and middle finger (power); contacts are antipodal within "
    f"{np.rad2deg(ANTIPODAL):.0f}°. Reach: largest distance from the wrist, and volume of the "
    "convex hull of the tip's positions. Postures: a synthetic human, retargeted with the default "
    f"method; taken if every finger points within {LARGEST_ANGLE:.0f}° of the human's and is as "
    f"extended within {LARGEST_BEND:g} of its length, and tips that touch are within "
    f"{1e3 * LARGEST_GAP:.0f} mm. GRASP: 33 grasps of Feix et al. 2016, whose angles were set by "
    "eye."
)
"""How the card was measured."""
CELL: Final = 180
"""Width and height of a picture of a pose [px]."""
_HALF: Final = 0.06  # half the width of a picture [m]
_MARK: Final = 0.004  # radius of the mark at a place [m]
_INK: Final = (40, 46, 52)


def print_scorecard(options: Check, track: Track) -> None:
    """Measures a hand, prints its card, and writes a page with pictures if a path is given."""
    hand = load_hand(options.hand, options.side)
    card = hand_scorecard(hand, track)
    if options.json:
        print(json.dumps(card.to_json(), indent=2))
    else:
        console = output_console()
        title = f"{card.hand}, {card.side} hand"
        console.print(plain_table(title, ("measurement", "result"), card.rows()))
        console.print(RULES, markup=False)
    if options.out is not None:
        _write_page(hand, card, options.out)


def kapandji_picture(hand: Hand, touches: Sequence[Touch], columns: int, size: int = CELL) -> Image:
    """Draws the pose at each place, seen from the palm and across the place, which is red.

    Args:
        columns: number of places in a row.
        size: width and height of each of the two views [px].
    """
    from PIL import Image as pillow
    from PIL import ImageDraw

    from smooth_operator_benchmark.hand_surface import Surface, paint, rod
    from smooth_operator_benchmark.model_shape import ModelShape

    shape = ModelShape(hand)
    rows = -(-len(touches) // columns)
    sheet = pillow.new("RGB", (2 * size * columns, size * rows), "white")
    pen = ImageDraw.Draw(sheet)
    for k, touch in enumerate(touches):
        posed = shape.surface(hand.full_configuration(touch.pose))
        mark = rod(touch.point, touch.point, _MARK)
        red = np.tile(np.array((225, 30, 30), np.uint8), (len(mark), 1))
        near = (np.abs(posed.triangles - touch.point).max(axis=-1) < 2 * _HALF).any(axis=-1)
        drawn = Surface(
            np.concatenate([posed.triangles[near], mark]),
            np.concatenate([posed.colors[near], red]),
        )
        across = np.cross(touch.normal, shape.view[1])
        across /= max(float(np.linalg.norm(across)), 1e-9)
        across *= 1.0 if across @ shape.view[0] > 0 else -1.0
        side = np.stack([np.cross(shape.view[1], across), shape.view[1], across])
        left, top = 2 * size * (k % columns), size * (k // columns)
        for i, view in enumerate((shape.view, side)):
            picture = paint(drawn, view, view[:2] @ touch.point, _HALF, size)
            sheet.paste(pillow.fromarray(picture), (left + i * size, top))
        text = (
            f"{touch.stage}" if touch.touched else f"{touch.stage}: {1e3 * touch.distance:.0f} mm"
        )
        pen.text((left + 5, top + 4), text, fill=_INK)
    return sheet


def _write_page(hand: Hand, card: Scorecard, path: Path) -> None:
    from smooth_operator.reporting.report_page import (
        Html,
        Plots,
        element,
        escape,
        join,
        paragraph,
        write_report_page,
    )

    title = f"Scorecard of {card.hand}, {card.side} hand"
    cells = (
        element("tr", Html(element("th", escape(a)) + element("td", escape(b))))
        for a, b in card.rows()
    )
    table = element("div", element("table", join(cells), class_="words"), class_="scroll")
    plots = Plots(path.with_name(f"{path.stem}-figures"))
    caption = "Pose at each place (red), from the palm and across. " + "; ".join(
        f"{touch.stage}: {PLACES[touch.stage]}" for touch in card.free
    )
    picture = plots.picture(kapandji_picture(hand, card.free, 3), "kapandji", caption)
    sections = [
        ("Card", "card", join([table, paragraph(RULES)])),
        ("Kapandji, fingers free", "kapandji", picture),
    ]
    write_report_page(
        path, title, element("h1", escape(title)), sections, "smooth-operator hands check"
    )
