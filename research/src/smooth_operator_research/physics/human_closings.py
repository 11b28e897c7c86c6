"""Moments of a recording in which a human closes the whole hand, as around a handle or a ball."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Float

from smooth_operator.landmarks import BASES
from smooth_operator.types import HandRecording

CLOSED: Final = 0.65
"""The hand is closed where no finger is straighter than this..."""
OPENED: Final = 0.85
"""... until all are straighter than this."""
LEAST_S: Final = 0.1
"""It stays closed for at least so long [s]."""
LOOSER: Final = 0.1
"""The human holds the object until the fingers are straighter by this than they are at most bent,
on average."""
BEFORE_S: Final = 1.5
"""It is looked at from the moment when the hand is open widest, so long before it closes at most
[s]..."""
AFTER_S: Final = 1.5
"""... until so long after it has opened [s]."""


@dataclass(frozen=True)
class HumanClosing:
    """One closing of the hand; frames are indices of the recording.

    Attributes:
        first: frame from which it is looked at, the hand open.
        tight: frame in which the fingers are bent most, on average.
        shut: until this frame the human holds the object.
        opened: first frame in which all fingers are straight again; None if the recording ends
            before, or the hand closes again.
        last: frame until which it is looked at.
    """

    first: int
    tight: int
    shut: int
    opened: int | None
    last: int


def find_closings(recording: HandRecording) -> list[HumanClosing]:
    """Every closing of the hand in a recording, in order of time."""
    straight = finger_straightness(recording)
    bent, stamps = straight.mean(axis=1), recording.stamps
    spans = _spans(straight)
    closings = []
    for begin, end in spans:
        closed = begin + np.flatnonzero(straight[begin:end].max(axis=1) < CLOSED)
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
    """Distance from base to tip of index to pinky, as a share of the length of their bones.

    Returns:
        (T, 4); 1 for a straight finger, NaN where a landmark of it is not known.
    """
    assert recording.valid is not None  # filled in on construction
    points = np.where(recording.valid[..., None], recording.landmarks, np.nan)
    chains = points[:, [range(base, base + 4) for base in BASES[1:]]]
    bones = np.linalg.norm(np.diff(chains, axis=2), axis=-1).sum(axis=-1)
    share: np.ndarray = np.linalg.norm(chains[:, :, -1] - chains[:, :, 0], axis=-1) / bones
    return share


def _spans(straight: Float[np.ndarray, "T 4"]) -> list[tuple[int, int]]:
    """From the frame in which all fingers are bent to the one in which all are straight."""
    spans: list[tuple[int, int]] = []
    begin: int | None = None
    for frame, (least, most) in enumerate(
        zip(straight.min(axis=1), straight.max(axis=1), strict=True)
    ):
        if begin is None and most < CLOSED:  # False for NaN
            begin = frame
        elif begin is not None and least > OPENED:
            spans.append((begin, frame))
            begin = None
    return spans if begin is None else [*spans, (begin, len(straight))]
