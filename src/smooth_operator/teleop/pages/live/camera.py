"""The camera's picture for the page: small, a few times a second, with the tracked hands."""

from __future__ import annotations

import base64
import html
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final

import numpy as np

from smooth_operator.landmarks import BONES, WRIST
from smooth_operator.teleop.pages.palette import FINGER_COLORS, PALM, css
from smooth_operator.teleop.sources.live import LiveSource
from smooth_operator.teleop.sources.webcam.seen_picture import SeenPicture

_WIDTH: Final = 320  # of what is sent, at most [pixels]
_EVERY_S: Final = 0.1
OLD_S: Final = 1.0
"""A picture that stands for so long is marked [s]."""
_LINE: Final = 0.008  # thickness of a bone, as a share of the width
_FOUND, _MISSING = "#009e73", "#e69f00"


class CameraFeed:
    """Takes the newest picture of a source, where it has any.

    A picture is made small and encoded only when it is asked for, on the asking thread, and at most
    ten times a second; the source's thread does no more than keep it.

    Args:
        source: of the running loop.
    """

    def __init__(self, source: LiveSource) -> None:
        # sources without a camera need not know of pictures
        self._newest: Callable[[], SeenPicture | None] = getattr(source, "picture", lambda: None)
        self._last: tuple[int, float] | None = None
        self._sent = -np.inf

    def look(self, known: int, now: float) -> dict[str, Any] | None:
        """The newest picture, as JSON has it; None where there is no camera.

        Args:
            known: number of the picture that the page has.
            now: time of the loop's clock [s].

        Returns:
            ``number`` of the picture; ``age_s`` since it was first looked at; and, if it is new and
            due: ``jpeg`` in base64, ``aspect`` height over width, ``hands``: side -> [x, y] of each
            landmark, as ``SeenPicture.hands``.
        """
        picture = self._newest()
        if picture is None:
            return None
        if self._last is None or self._last[0] != picture.number:
            self._last = picture.number, now
        shown: dict[str, Any] = {"number": known, "age_s": round(now - self._last[1], 2)}
        if picture.number == known or now - self._sent < _EVERY_S:
            return shown
        self._sent = now
        height, width = picture.pixels.shape[:2]
        return {
            **shown,
            "number": picture.number,
            "jpeg": base64.b64encode(picture.jpeg(_WIDTH)).decode(),
            "aspect": round(height / width, 4),
            "hands": {side: np.round(at, 4).tolist() for side, at in picture.hands.items()},
        }


def camera(seen: Mapping[str, Any]) -> str:
    """A picture with its hands' skeletons, as HTML.

    Args:
        seen: what ``CameraFeed.look`` gave when it had a picture.
    """
    hands = seen["hands"]
    words = " and ".join(f"{side} hand" for side in sorted(hands)) or "no hand in the picture"
    sign, color = ("✓", _FOUND) if hands else ("⚠", _MISSING)
    if seen["age_s"] > OLD_S:
        sign, color, words = "⚠", _MISSING, f"no new picture for {seen['age_s']:.0f} s"
    aspect = float(seen["aspect"])
    skeletons = "".join(_skeleton(points) for points in hands.values())
    return (
        f'<div id="live-camera" data-hands="{html.escape(" ".join(sorted(hands)))}" '
        f'style="border:3px solid {color}">'
        '<div style="position:relative;line-height:0">'
        f'<img alt="camera" decoding="sync" style="width:100%" '
        f'src="data:image/jpeg;base64,{html.escape(seen["jpeg"])}">'
        f'<svg viewBox="0 0 1 {aspect:g}" style="position:absolute;inset:0;width:100%;height:100%">'
        f"{skeletons}</svg></div>"
        f'<div style="padding:0.1em 0.4em;font-size:0.75em;background:{color};color:#000">'
        f"{sign} {words}</div></div>"
    )


def _skeleton(points: Sequence[Sequence[float]]) -> str:
    """Bones and joints of a hand, in the colours of the fingers."""
    colors = [css(PALM)] * len(points)
    for finger, color in enumerate(FINGER_COLORS):
        for landmark in range(1 + 4 * finger, 5 + 4 * finger):
            colors[landmark] = css(color)
    bones = "".join(
        f'<line x1="{points[a][0]:g}" y1="{points[a][1]:g}" x2="{points[b][0]:g}" '
        f'y2="{points[b][1]:g}" stroke="{css(PALM) if a == WRIST else colors[b]}" '
        f'stroke-width="{_LINE}" stroke-linecap="round"/>'
        for a, b in BONES
    )
    joints = "".join(
        f'<circle cx="{x:g}" cy="{y:g}" r="{_LINE}" fill="{color}" stroke="#000" '
        f'stroke-width="{_LINE / 5:g}"/>'
        for (x, y), color in zip(points, colors, strict=True)
    )
    return bones + joints
