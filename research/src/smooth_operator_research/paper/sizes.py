"""How much is computed: small for a test, by default for two cores, or as published."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final


@dataclass(frozen=True)
class Size:
    """How much is computed.

    Attributes:
        name: what it is called.
        recordings: of the built-in operator, where none are given.
        frames: of each recording, for the solvers.
        seeds: of each random solver on each recording.
        samples: N of Algorithm 1.
        cycles: L of Algorithm 1.
        rmsprop_starts, slsqp_starts, newton_starts: N of the batched forms.
        steps: learning rates that RMSProp is tuned over [rad].
        finals: shares of it that are left at the end, likewise.
        sigmas: initial deviations that Algorithm 1 is tuned over [rad].
        tuning_frames: frames that are tuned on, of another operator.
        grid_samples: N of the grid N x L.
        grid_cycles: L of the grid.
        grid_budget: cells with a larger N x L are left out.
        grid_frames: of each recording, for the grid.
    """

    name: str
    recordings: tuple[str, ...]
    frames: int
    seeds: int
    samples: int
    cycles: int
    rmsprop_starts: int
    slsqp_starts: int
    newton_starts: int
    steps: tuple[float, ...]
    finals: tuple[float, ...]
    sigmas: tuple[float, ...]
    tuning_frames: int
    grid_samples: tuple[int, ...]
    grid_cycles: tuple[int, ...]
    grid_budget: int
    grid_frames: int


def trial_note(size: Size) -> str:
    """What is said before the results of a size that is too small to judge by."""
    return "" if size.name != "quick" else _TRIAL


_TRIAL: Final = (
    "A trial run, far below the published sizes: its verdicts say little, whatever they are. "
)

PUBLISHED_STARTS: Final = 32768
"""N of the paper's batched forms."""

_SHARES: Final = (0.8192, 0.6710, 0.5497)
"""Shares that fill a cube evenly, whatever the count (Roberts's R sequence)."""


def synthetic_operators(count: int, frames: int) -> tuple[str, ...]:
    """Requests for some people of the built-in operator, who share neither hand nor motion.

    Each has its own seed (bone proportions, timing, amplitudes), a hand of 16 to 21 cm, a
    tempo
    of 0.8 to 1.3, and another part of the round of gestures.

    Args:
        count: how many.
        frames: of each.
    """
    found = []
    for seed in range(count):
        length, tempo, part = ((share * (seed + 1)) % 1.0 for share in _SHARES)
        first = 100 + 10 * round(part * (1900 - frames - 100) / 10)
        found.append(
            f"synthetic:{seed}@{16 + 5 * length:.1f}cm,{0.8 + 0.5 * tempo:.2f}x,"
            f"{first}:{first + frames}"
        )
    return tuple(found)


QUICK: Final = Size(
    name="quick",
    recordings=synthetic_operators(4, 100),
    frames=25,
    seeds=1,
    samples=1024,
    cycles=10,
    rmsprop_starts=16,
    slsqp_starts=2,
    newton_starts=8,
    steps=(0.003, 0.03),
    finals=(0.01,),
    sigmas=(0.1, 0.2),
    tuning_frames=20,
    grid_samples=(256, 1024, 4096),
    grid_cycles=(5, 20, 80),
    grid_budget=20480,
    grid_frames=20,
)
"""For a test that it runs; its figures mean little."""

DEFAULT: Final = Size(
    name="default",
    recordings=synthetic_operators(20, 300),
    frames=150,
    seeds=1,  # a seed's chance is in the spread among the operators
    samples=8192,
    cycles=20,
    rmsprop_starts=256,
    slsqp_starts=4,
    newton_starts=16,
    steps=(0.001, 0.003, 0.01, 0.03, 0.1),
    finals=(0.01, 1.0),
    sigmas=(0.05, 0.1, 0.2, 0.4),
    tuning_frames=60,
    grid_samples=(256, 512, 1024, 2048, 4096, 8192, 16384),
    grid_cycles=(5, 10, 20, 40, 80, 160),
    grid_budget=163_840,
    grid_frames=25,
)
"""For two cores: twenty independent operators, so that a direction that is there can be shown."""

PUBLISHED: Final = Size(
    name="published",
    recordings=synthetic_operators(20, 500),
    frames=500,
    seeds=1,
    samples=PUBLISHED_STARTS,
    cycles=20,
    rmsprop_starts=PUBLISHED_STARTS,
    slsqp_starts=64,  # NLopt runs one start after the other, whatever the machine
    newton_starts=PUBLISHED_STARTS // 32,
    steps=DEFAULT.steps,
    finals=DEFAULT.finals,
    sigmas=DEFAULT.sigmas,
    tuning_frames=100,
    grid_samples=(256, 512, 1024, 2048, 4096, 8192, 16384, 32768),
    grid_cycles=(5, 10, 20, 40, 80, 160, 320),
    grid_budget=655_360,
    grid_frames=500,
)
"""N as published for sampling and RMSProp, less for SLSQP and Newton; for an accelerator."""
