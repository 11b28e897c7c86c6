"""What reading a pickle as data rests on: its limits, and what stands for functions and objects."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

import numpy as np

from smooth_operator.errors import RecordingError

FREE_BYTES: Final = 64 << 20
"""What any pickle may build, however short it is [bytes]."""
RATIO: Final = 16
"""What it may build as a multiple of its own length, in addition."""
MOST_BUILT: Final = 2 << 30
"""What it may build in any case [bytes]."""
MOST_STEPS: Final = 20_000_000
"""Instructions of one file; they take about 10 s."""


class NotDataError(RecordingError):
    """A pickle asks for what is no data, or is damaged, or too large."""


class Budget:
    """What may still be built for one file [bytes], and how many instructions may be followed."""

    def __init__(self, size: int) -> None:
        self.bytes = min(FREE_BYTES + RATIO * size, MOST_BUILT)
        self.steps = MOST_STEPS

    def take(self, count: int) -> None:
        """Counts bytes before they are built.

        Raises:
            NotDataError: that would be more than is allowed.
        """
        self.bytes -= count
        if count < 0 or self.bytes < 0:
            raise NotDataError("it would take more memory than a file of this size may")


class Maker:
    """Stands for a function or a class.

    Attributes:
        make: ``make(budget, *arguments)`` gives what takes the place of the call's result. Raises
            TypeError or ValueError where the arguments are not those that it knows.
    """

    def __init__(self, make: Callable[..., Any]) -> None:
        self.make = make


class Instance:
    """Stands for an object whose state follows it."""

    def build(self, budget: Budget, state: Any) -> None:
        """Takes the state. Raises TypeError or ValueError where it is not one that is known."""
        raise NotImplementedError


class Numeric:
    """Stands for an object that holds numbers."""

    def array(self) -> np.ndarray:
        """Its numbers.

        Raises:
            NotDataError: it is damaged, or holds none that are known.
        """
        raise NotImplementedError


def is_plain_key(key: Any) -> bool:
    """Whether a table may have such a key: a text, a number of 64 bits, or up to eight of them.

    Others may take for ever to compare: tuples of tuples, whole numbers made to collide.
    """
    if type(key) is tuple:
        return len(key) <= 8 and all(type(k) is not tuple and is_plain_key(k) for k in key)
    if type(key) is int:
        return -(1 << 63) <= key < 1 << 64
    return key is None or type(key) in (str, bytes, bool, float)
