"""Finds pinches and closings of a human hand in a recording, and inserts time to hold objects."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final, Protocol

import numpy as np
from jaxtyping import Float, Int

from smooth_operator.landmarks import BASES, FINGERS, TIPS
from smooth_operator.types import HandRecording

CLOSED: Final = 0.015
"""Tip distance below which a pinch begins [m]; it ends above the next constant."""
OPENED: Final = 0.025
"""Tip distance above which a pinch ends [m]."""
LEAST_S: Final = 0.1
"""Shortest time for which a pinch is closed [s]."""
NEAR_MISS: Final = 0.005
"""Largest excess of a pinch's width over the recording's tightest pinch [m]."""
WIDE: Final = 0.06
"""A pinch's window starts at the last frame with this skin distance [m], otherwise at the widest
frame since an earlier pinch."""
BEFORE_S: Final = 1.5
"""Longest time of the window before the pinch closes [s]."""
AFTER_S: Final = 1.5
"""Time of the window after the pinch has opened [s]."""


class HumanGrasp(Protocol):
    """A grasp, with the frame in which the hand is closed most."""

    @property
    def tight(self) -> int:
        """Index of that frame in the recording."""


@dataclass(frozen=True, eq=False)
class HumanPinch:
    """One pinch; frames are indices of the recording.

    The landmarks of tips lie inside the fingers, so their distance is not 0 when the skins touch.
    Every pinch is assumed to close: the skins touch at its smallest distance, and at other times
    the width between the skins is the distance minus that smallest one.

    Attributes:
        finger: name of the finger that meets the thumb.
        first: first frame of its window.
        tight: frame of the smallest distance.
        opened: first frame in which it is no longer a pinch.
        last: last frame of its window.
        contact: smallest distance [m].
        width: (T,) distance of the skins in each frame of the recording [m]; NaN where a tip is
            unknown.
    """

    finger: str
    first: int
    tight: int
    opened: int
    last: int
    contact: float
    width: Float[np.ndarray, " T"]

    def of_size(self, scale: float) -> HumanPinch:
        """The same pinch of a scaled hand, with other ``contact`` and ``width``."""
        return replace(self, contact=scale * self.contact, width=scale * self.width)

    @property
    def opening_before(self) -> float:
        """Skin distance at the start of the window [m]: the largest width of an object to grasp."""
        return float(self.width[self.first])

    def opening(self, width: float) -> int | None:
        """First frame from which the skin distance exceeds a width [m]; None if it never does.

        While the pinch is closed, changes that do not open it count as tracking noise.
        """
        before = np.flatnonzero(~(self.width[self.tight : self.opened] > width))
        first = self.tight + int(before[-1]) + 1 if len(before) else self.tight
        wide = np.flatnonzero(self.width[first : self.last + 1] > width)
        return first + int(wide[0]) if len(wide) else None


def find_pinches(recording: HandRecording) -> list[HumanPinch]:
    """Finds all pinches of a recording, in order of time.

    A pinch closes and opens with hysteresis in the distance of the tips. If several fingers pinch
    at the same time, the tightest pinch counts.
    """
    pinches: list[HumanPinch] = []
    gaps = _tip_gaps(recording)
    for number, finger in enumerate(FINGERS[1:]):
        gap = gaps[:, number]
        for begin, end in _spans(gap):
            tight = begin + int(np.nanargmin(gap[begin:end]))
            if recording.stamps[end - 1] - recording.stamps[begin] >= LEAST_S:
                contact = float(gap[tight])
                after = np.flatnonzero(gap[end:] > OPENED)
                opened = end + int(after[0]) if len(after) else len(gap) - 1
                first, last = _window(recording.stamps, gap, contact, begin, opened)
                pinches.append(
                    HumanPinch(finger, first, tight, opened, last, contact, gap - contact)
                )
    if not pinches:
        return []
    nearest = min(pinch.contact for pinch in pinches)
    pinches = [pinch for pinch in pinches if pinch.contact <= nearest + NEAR_MISS]
    return sorted(_tightest(pinches, gaps), key=lambda pinch: pinch.tight)


def with_holds(
    recording: HandRecording, grasps: Sequence[HumanGrasp], seconds: float
) -> tuple[HandRecording, Float[np.ndarray, " T"]]:
    """Inserts a rest of the hand at each grasp's tightest moment.

    Args:
        seconds: duration of the rest; the frame is repeated at the recording's rate.

    Returns:
        The longer recording; and (T,) times in it of the original frames, before repeats [s].
    """
    period = float(np.median(np.diff(recording.stamps)))
    repeats = np.zeros(len(recording), int)
    repeats[[grasp.tight for grasp in grasps]] = round(seconds / period)
    index: Int[np.ndarray, " n"] = np.repeat(np.arange(len(recording)), repeats + 1)
    shift = np.concatenate([[0.0], np.cumsum(repeats)[:-1]]) * period
    moments = recording.stamps + shift
    start = np.cumsum(repeats + 1) - repeats - 1
    stamps = moments[index] + (np.arange(len(index)) - start[index]) * period

    def longer(values: np.ndarray | None) -> np.ndarray | None:
        return None if values is None else values[index]

    pinches = replace(
        recording,
        landmarks=recording.landmarks[index],
        stamps=stamps,
        valid=longer(recording.valid),
        metacarpals=longer(recording.metacarpals),
        orientations=longer(recording.orientations),
        T_world_wrist=longer(recording.T_world_wrist),
    )
    return pinches, moments


def _tip_gaps(recording: HandRecording) -> Float[np.ndarray, "T 4"]:
    assert recording.valid is not None  # filled in on construction
    tips = np.where(recording.valid[:, TIPS, None], recording.landmarks[:, TIPS], np.nan)
    gaps: np.ndarray = np.linalg.norm(tips[:, 1:] - tips[:, :1], axis=-1)
    return gaps


def _spans(gap: Float[np.ndarray, " T"]) -> list[tuple[int, int]]:
    """Spans of a small distance, by hysteresis: first frame, and the one after the last below."""
    spans: list[tuple[int, int]] = []
    begin: int | None = None
    below = 0
    for frame, value in enumerate(gap):
        if value < CLOSED:
            begin = frame if begin is None else begin
            below = frame + 1
        elif begin is not None and value > OPENED:
            spans.append((begin, below))
            begin = None
    return spans if begin is None else [*spans, (begin, below)]


def _window(
    stamps: Float[np.ndarray, " T"],
    gap: Float[np.ndarray, " T"],
    contact: float,
    begin: int,
    opened: int,
) -> tuple[int, int]:
    """First frame, the widest since an earlier pinch or the last that is wide, and last frame."""
    earliest = int(np.searchsorted(stamps, stamps[begin] - BEFORE_S))
    closed = np.flatnonzero(gap[earliest:begin] < CLOSED)
    earliest += int(closed[-1]) + 1 if len(closed) else 0
    latest = int(np.searchsorted(stamps, stamps[opened] + AFTER_S, side="right")) - 1
    before = np.nan_to_num(gap[earliest:begin] - contact, nan=-np.inf)
    if not len(before):
        return begin, latest
    wide = np.flatnonzero(before > WIDE)
    return earliest + int(wide[-1] if len(wide) else np.argmax(before)), latest


def _tightest(pinches: Sequence[HumanPinch], gaps: Float[np.ndarray, "T 4"]) -> list[HumanPinch]:
    """Removes pinches in which another finger is nearer to the thumb."""
    return [
        pinch
        for pinch in pinches
        if FINGERS.index(pinch.finger) - 1 == int(np.nanargmin(gaps[pinch.tight]))
    ]


BENT: Final = 0.65
"""Straightness of all fingers below which the hand is closed; it opens above the next constant."""
STRAIGHT: Final = 0.85
"""Straightness of all fingers above which the hand is open."""
LOOSER: Final = 0.1
"""Mean increase of straightness, from the most bent pose, at which the human releases the
object."""


@dataclass(frozen=True)
class HumanClosing:
    """One closing of the hand; frames are indices of the recording.

    Attributes:
        first: first frame of its window, with an open hand.
        tight: frame in which the fingers are bent most, on average.
        shut: frame until which the human holds the object.
        opened: first frame in which all fingers are straight again; None if the recording ends
            before, or the hand closes again.
        last: last frame of its window.
    """

    first: int
    tight: int
    shut: int
    opened: int | None
    last: int


def find_closings(recording: HandRecording) -> list[HumanClosing]:
    """Finds all closings of the hand in a recording, in order of time."""
    straight = finger_straightness(recording)
    bent, stamps = straight.mean(axis=1), recording.stamps
    spans = _closed_spans(straight)
    closings = []
    for begin, end in spans:
        closed = begin + np.flatnonzero(straight[begin:end].max(axis=1) < BENT)
        if stamps[closed[-1]] - stamps[closed[0]] < LEAST_S:
            continue
        tight = begin + int(np.nanargmin(bent[begin:end]))
        early = int(np.searchsorted(stamps, stamps[begin] - BEFORE_S))
        earlier = [previous for _, previous in spans if previous <= begin]
        early = max([early, *earlier])
        # Where a finger is lost the hand can't be said to be open.
        wide = np.nan_to_num(bent[early : begin + 1], nan=-1.0)
        first = early + int(np.argmax(wide))
        loose = np.flatnonzero(bent[tight:end] > bent[tight] + LOOSER)
        opened = end if end < len(stamps) else None
        late = stamps[-1] if opened is None else stamps[opened] + AFTER_S
        last = int(np.searchsorted(stamps, late, side="right")) - 1
        after = [following for following, _ in spans if following > begin]
        last = min([last, *after])
        shut = tight + int(loose[0]) if len(loose) else min(end, len(stamps) - 1)
        closings.append(HumanClosing(first, tight, shut, opened, last))
    return closings


def finger_straightness(recording: HandRecording) -> Float[np.ndarray, "T 4"]:
    """Distance from base to tip of index to pinky, divided by the length of their bones.

    Returns:
        (T, 4); 1 for a straight finger, NaN if one of its landmarks is unknown.
    """
    assert recording.valid is not None  # filled in on construction
    points = np.where(recording.valid[..., None], recording.landmarks, np.nan)
    chains = points[:, [range(base, base + 4) for base in BASES[1:]]]
    bones = np.linalg.norm(np.diff(chains, axis=2), axis=-1).sum(axis=-1)
    share: np.ndarray = np.linalg.norm(chains[:, :, -1] - chains[:, :, 0], axis=-1) / bones
    return share


def _closed_spans(straight: Float[np.ndarray, "T 4"]) -> list[tuple[int, int]]:
    """Spans from a frame with all fingers bent to the next with all fingers straight."""
    spans: list[tuple[int, int]] = []
    begin: int | None = None
    for frame, (least, most) in enumerate(
        zip(straight.min(axis=1), straight.max(axis=1), strict=True)
    ):
        if begin is None and most < BENT:  # False for NaN
            begin = frame
        elif begin is not None and least > STRAIGHT:
            spans.append((begin, frame))
            begin = None
    return spans if begin is None else [*spans, (begin, len(straight))]
