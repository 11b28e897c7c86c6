"""Writes the table of built-in hands into docs/reference/hands.md; run it as a script."""

import re
from pathlib import Path

from smooth_operator.hand_discovery.checks import Samples
from smooth_operator.hand_discovery.hand_validation import TOUCH_GAP, closest_pinch
from smooth_operator.hand_discovery.joints import palm_tilt_deg
from smooth_operator.hands.registry import known_hands, load_hand

PAGE = Path(__file__).parent / "reference" / "hands.md"
_HEADER = """\
| hand, right and left | fingers | actuated | all joints | palm tilt | thumb touches | left hand |
|---|---:|---:|---:|---:|---|---|
"""


def thumb_touches(name: str) -> str:
    """Number of fingertips that the thumb's tip can touch, and the largest gap if it misses one."""
    samples = Samples(load_hand(name))
    gaps = [closest_pinch(samples, finger) for finger in samples.hand.fingers[1:]]
    text = f"{sum(gap <= TOUCH_GAP for gap in gaps)} of {len(gaps)}"
    return text if max(gaps) <= TOUCH_GAP else f"{text}, largest gap {1e3 * max(gaps):.0f} mm"


def row(name: str, touches: str) -> str:
    """One line of the table."""
    hand = load_hand(name)
    left = "mirrored" if "left" in known_hands()[name].mirrored else "published"
    tilt = f"{round(palm_tilt_deg(hand))}°".replace("-", "−")
    cells = (
        f"`{name}`",
        len(hand.fingers),
        len(hand.actuated),
        len(hand.joint_names),
        "–" if hand.spec.gripper else tilt,
        touches,
        "same" if hand.spec.gripper else left,
    )
    return f"| {' | '.join(map(str, cells))} |\n"


def main() -> None:
    """Replaces the table of the page."""
    names = [name for name, entry in known_hands().items() if entry.builtin]
    table = _HEADER + "".join(row(name, thumb_touches(name)) for name in sorted(names))
    page = PAGE.read_text(encoding="utf-8")
    text, count = re.subn(r"(?m)(?<=^## Built-in hands\n\n)(^\|.*\n)+", lambda _: table, page)
    if count != 1:
        raise SystemExit(f"{PAGE}: expected one table after the heading 'Built-in hands'")
    PAGE.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
