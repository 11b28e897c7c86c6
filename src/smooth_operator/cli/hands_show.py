"""``smooth-operator hands show`` and ``render``: show one hand in tables, on a page or in a
picture."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

from tyro.conf import Positional, arg

from smooth_operator.cli.common_options import Common, HandSide, Meshes, Page
from smooth_operator.terminal import printable

if TYPE_CHECKING:
    from smooth_operator.hands.hand import Hand
    from smooth_operator.hands.spec import Point


@dataclass(frozen=True, kw_only=True)
class _OneHand(Common, Meshes):
    """Options of the subcommands that show one hand."""

    hand: Annotated[Positional[str], arg(metavar="NAME")]
    """Name of a hand, or path of a spec file (.toml)."""

    side: Annotated[HandSide | None, arg(metavar="right|left")] = None
    """Hand side. Default: right, or the side of the spec file."""


@dataclass(frozen=True, kw_only=True)
class Show(_OneHand, Page):
    """Print the joints, limits and couplings of a hand, and show it in the browser with a slider
    for each joint."""

    work: ClassVar[str] = "smooth_operator.cli.hands_show:show_hand"
    details: ClassVar[str] = """Examples:
  smooth-operator hands show shadow_hand
  smooth-operator hands show ability_hand --side left --no-view
  smooth-operator hands show shadow_hand --model menagerie
  smooth-operator hands show my-hand.right.toml --json"""

    no_view: bool = False
    """Print only the tables; do not serve a page."""

    json: bool = False
    """Print one JSON object on standard output; do not serve a page."""


@dataclass(frozen=True, kw_only=True)
class Render(_OneHand):
    """Draw a picture of a hand: shape, landmarks, palm frame, joint ranges. Needs no display."""

    work: ClassVar[str] = "smooth_operator.cli.hands_show:render_hand"
    details: ClassVar[str] = """Example:
  smooth-operator hands render leap_hand --output leap.png"""

    output: Annotated[Path | None, arg(metavar="PNG")] = None
    """Picture file to write. Default: NAME_SIDE.png in the current folder."""


def show_hand(options: Show) -> None:
    """Prints a hand's tables and serves its page until Ctrl-C."""
    from smooth_operator.cli.page import hand_to_draw
    from smooth_operator.hands.registry import load_hand

    hand = load_hand(options.hand, options.side)
    drawn = hand_to_draw(hand, options)
    shown = drawn if drawn is not None and options.model is not None else hand
    if options.json:
        print(json.dumps(describe(shown)))
        return
    _print_tables(shown)
    if not options.no_view:
        from smooth_operator.teleop.pages.hand_page import serve_hand

        serve_hand(
            hand,
            drawn=drawn,
            host=options.host,
            port=options.port,
            open_browser=not options.no_browser,
        )


def render_hand(options: Render) -> None:
    """Draws a hand and writes the picture."""
    from smooth_operator.cli.page import hand_to_draw
    from smooth_operator.hands.registry import load_hand
    from smooth_operator.teleop.pages.hand_picture import save_hand_picture

    hand = load_hand(options.hand, options.side)
    drawn = hand_to_draw(hand, options)
    output = options.output or Path(f"{hand.name}_{hand.spec.side}.png")
    save_hand_picture(drawn or hand, output, simple=drawn is None)
    print(printable(str(output)))


def describe(hand: Hand) -> dict[str, Any]:
    """Properties of a hand as plain values, for ``--json``."""
    import numpy as np

    from smooth_operator.hands.spec_file import POINTS
    from smooth_operator.hands.wrist_joints import with_wrist_joints
    from smooth_operator.teleop.joint_rows import joint_rows

    spec, followed = hand.spec, {c.joint: c for c in hand.couplings}
    whole = with_wrist_joints(hand)
    joints = []
    torques = _torques(whole)
    for row in joint_rows(whole):
        joint: dict[str, Any] = {
            "name": row.name,
            "limits": [row.low, row.high] if np.isfinite([row.low, row.high]).all() else None,
            "neutral": row.neutral,
            "actuated": row.actuated,
        }
        if np.isfinite(torques.get(row.name, np.nan)):
            joint["torque"] = torques[row.name]
        if (coupling := followed.get(row.name)) is not None:
            joint |= {
                "follows": coupling.follows,
                "multiplier": coupling.multiplier,
                "offset": coupling.offset,
                "higher": list(coupling.higher),
            }
        joints.append(joint)
    return {
        "name": hand.name,
        "side": spec.side,
        "mirrored": spec.mirror,
        "source": spec.source,
        "model": str(spec.model),
        "palm": spec.palm,
        "wrist": _point(spec.wrist),
        "wrist_joints": list(spec.wrist_joints),
        "align": list(spec.align),
        "fingers": {
            finger.name: {
                name: _point(point)
                for name, point in zip(POINTS[finger.name], finger.points, strict=True)
                if point is not None
            }
            for finger in spec.fingers
        },
        "joints": joints,
        "actuated": list(hand.actuated_names),
        "landmarks_m": dict(
            zip(hand.tree.names, hand.landmark_positions(hand.neutral).tolist(), strict=True)
        ),
    }


def _torques(hand: Hand) -> dict[str, float]:
    return dict(zip(hand.actuated_names, hand.torques.tolist(), strict=True))


def _point(point: Point) -> dict[str, Any]:
    return {"body": point.body, "offset_m": list(point.offset)}


def _print_tables(hand: Hand) -> None:
    import numpy as np
    from rich.text import Text

    from smooth_operator.cli.console import output_console, plain_table
    from smooth_operator.hands.wrist_joints import with_wrist_joints
    from smooth_operator.teleop.joint_rows import joint_rows

    spec = hand.spec
    console = output_console()

    def say(text: str) -> None:
        console.print(text, markup=False, soft_wrap=True)

    mirrored = ", a mirror image of the published hand" if spec.mirror else ""
    say(f"{hand.name}: {spec.side} hand{mirrored}")
    if spec.source:
        say(spec.source)
    say(
        f"{len(hand.fingers)} fingers; {len(hand.actuated)} of {len(hand.joint_names)} joints "
        f"actuated; aligned by {', '.join(spec.align)}"
    )

    if spec.wrist_joints:
        say(f"wrist joints: {', '.join(spec.wrist_joints)}")

    say("\njoints, in the order of the model, with wrist joints last")
    whole = with_wrist_joints(hand)
    joints, torques = plain_table(), _torques(whole)
    headers = ("joint", "lower [rad]", "upper [rad]", "neutral [rad]", "torque [N m]", "follows")
    for header in headers:
        justify: Literal["left", "right"] = "right" if "[" in header else "left"
        joints.add_column(Text(header), justify=justify, no_wrap=True)
    for row in joint_rows(whole):
        joints.add_row(
            Text(row.name),
            f"{row.low:.4f}",
            f"{row.high:.4f}",
            f"{row.neutral:.3f}",
            f"{torques[row.name]:.2f}" if np.isfinite(torques.get(row.name, np.nan)) else "",
            Text(row.follows),
        )
    console.print(joints)

    say("landmarks in the palm frame, in the neutral pose [mm]")
    points = zip(hand.tree.names, hand.landmark_positions(hand.neutral), strict=True)
    rows = ((name, *(f"{1e3 * value + 0.0:.1f}" for value in at)) for name, at in points)
    console.print(plain_table(None, ("landmark", "x", "y", "z"), rows, left=1))
