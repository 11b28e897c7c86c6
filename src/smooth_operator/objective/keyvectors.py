"""Keyvectors: the vectors between wrist and fingertips that human and robot are to share."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import combinations

from smooth_operator.geometry import AnyArray, AnyKind, namespace
from smooth_operator.landmarks import FINGERS, TIPS, WRIST


@dataclass(frozen=True)
class KeyvectorLayout:
    """Which keyvectors a hand has; built from its fingers, not listed.

    Order: wrist to each tip (F), thumb tip to each other tip (F - 1), then tip to tip among the
    other fingers; 15 for five fingers, 6 for three. Point 0 is the wrist, point i the i-th tip.

    Attributes:
        fingers: human finger names, thumb first.
    """

    fingers: tuple[str, ...]

    @cached_property
    def pairs(self) -> tuple[tuple[int, int], ...]:
        """(K,) (from, to) over the points wrist, tip 1 .. tip F."""
        count = len(self.fingers)
        return tuple((0, i) for i in range(1, count + 1)) + tuple(
            combinations(range(1, count + 1), 2)
        )

    @property
    def thumb(self) -> slice:
        """The thumb-to-finger keyvectors."""
        count = len(self.fingers)
        return slice(count, 2 * count - 1)

    @cached_property
    def between(self) -> tuple[tuple[int, int, int], ...]:
        """(keyvector, finger, finger) of the finger-to-finger ones; fingers count from 0 = index
        side, as in the thumb slice."""
        return tuple((k, i - 2, j - 2) for k, (i, j) in enumerate(self.pairs) if i >= 2)

    @property
    def landmarks(self) -> tuple[int, ...]:
        """Human landmarks that the points are: wrist, then tips."""
        return (WRIST, *(TIPS[FINGERS.index(finger)] for finger in self.fingers))

    def human(self, landmarks: AnyKind) -> AnyKind:
        """Human keyvectors.

        Args:
            landmarks: (..., 21, 3) aligned landmarks [m].

        Returns:
            (..., K, 3) [m].
        """
        return self.between_points(landmarks[..., list(self.landmarks), :])

    def robot(self, tips: AnyKind, wrist: AnyArray) -> AnyKind:
        """Robot keyvectors.

        Args:
            tips: (..., F, 3) fingertips [m].
            wrist: (3,) wrist [m].

        Returns:
            (..., K, 3) [m].
        """
        xp = namespace(tips)
        base = xp.broadcast_to(wrist, (*tips.shape[:-2], 1, 3))
        points: AnyKind = xp.concatenate([base, tips], axis=-2)
        return self.between_points(points)

    def between_points(self, points: AnyKind) -> AnyKind:
        """(..., F + 1, 3) points to (..., K, 3) vectors."""
        start, end = (list(side) for side in zip(*self.pairs, strict=True))
        vectors: AnyKind = points[..., end, :] - points[..., start, :]
        return vectors
