"""Words in names, as weak evidence: generic ones only, no product's."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from typing import Final

from smooth_operator.types import Side

_FINGER_WORDS: Final[dict[str, tuple[str, ...]]] = {
    "thumb": ("thumb", "th", "thb", "pollex"),
    "index": ("index", "ff", "fore", "forefinger", "pointer", "if"),
    "middle": ("middle", "mf", "mid"),
    "ring": ("ring", "rf"),
    "pinky": ("pinky", "little", "lf", "pinkie", "small", "pf"),
}
_PARTS: Final = "(j|a|tip|base|hub|knuckle|proximal|middle|medial|distal|metacarpal)"
_WRIST_WORDS: Final = ("wrist",)
_SIDE_WORDS: Final[dict[Side, tuple[str, ...]]] = {
    "right": ("right", "rh"),
    "left": ("left", "lh"),
}


def words(name: str) -> tuple[str, ...]:
    """Lower-case words of an identifier: ``rightIndexTip_2`` is right, index, tip."""
    spaced = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", " ", name)
    return tuple(re.findall(r"[a-z]+", spaced.lower()))


def says_tip(name: str) -> bool:
    """True if a name denotes a fingertip."""
    return any(word.endswith("tip") for word in words(name))


def says_wrist(name: str) -> bool:
    """True if a name denotes the wrist."""
    return any(word in _WRIST_WORDS for word in words(name))


def fingers_said(chains: Sequence[Iterable[str]]) -> list[str | None]:
    """The human finger that each chain's names speak of most.

    Args:
        chains: names of bodies and joints, chain by chain. A word that all chains have tells none
            from another and does not count: a middle link is not a middle finger.

    Returns:
        a human finger for each chain; None where nothing is said, or two things equally.
    """
    spoken = [{word for name in names for word in words(name)} for names in chains]
    common = set.intersection(*spoken) if len(spoken) > 1 else set()
    out: list[str | None] = []
    for own in spoken:
        votes = {
            finger: sum(_means(word, finger, len(chains) > 3) for word in own - common)
            for finger in _FINGER_WORDS
        }
        ranked = sorted(votes, key=lambda finger: votes[finger], reverse=True)
        out.append(ranked[0] if votes[ranked[0]] > votes[ranked[1]] else None)
    return out


def _means(word: str, finger: str, initials: bool) -> bool:
    """True if a word denotes a finger; initials may be a gripper's left and right finger."""
    return any(
        word == synonym
        or (len(synonym) > 3 and word.startswith(synonym))
        or (len(synonym) == 2 and re.fullmatch(synonym + _PARTS, word) is not None)
        for synonym in _FINGER_WORDS[finger]
        if initials or len(synonym) > 2
    )


def side_said(names: Iterable[str]) -> Side | None:
    """The side that names speak of; None if none or both."""
    votes: dict[Side, int] = {"right": 0, "left": 0}
    for name in names:
        parts = words(name)
        for side, synonyms in _SIDE_WORDS.items():
            # a letter counts by itself only: r_thumb, but not the L of thumb_L1
            letter = re.search(rf"(^|_){side[0]}(_|$)", name.lower())
            votes[side] += bool(letter) or any(word in synonyms for word in parts)
    if votes["right"] == votes["left"]:
        return None
    return "right" if votes["right"] > votes["left"] else "left"
