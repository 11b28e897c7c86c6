"""How much the experiments on libraries and methods compute, at each size."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

from smooth_operator_research.paper.experiment import ExperimentContext


@dataclass(frozen=True)
class MoreSize:
    """How much is computed.

    Attributes:
        fk_batches: sizes of the batch.
        fk_rounds: of timing.
        table_frames: of each recording, for the table.
        latency_frames: of them, for latency.
        frames: of each recording, for ``noise``.
        noises: standard deviations of a coordinate of a landmark [m].
        losses: shares of frames that never arrive.
        seeds: of the tracker's noise and losses on each recording.
        rates: [Hz].
        seconds: of each recording, for ``rate`` [s].
    """

    fk_batches: tuple[int, ...]
    fk_rounds: int
    table_frames: int
    latency_frames: int
    frames: int
    noises: tuple[float, ...]
    losses: tuple[float, ...]
    seeds: int
    rates: tuple[float, ...]
    seconds: float


QUICK: Final = MoreSize(
    fk_batches=(1, 64, 1024),
    fk_rounds=3,
    table_frames=60,
    latency_frames=20,
    frames=40,
    noises=(0.0, 2e-3),
    losses=(0.0, 0.2),
    seeds=1,
    rates=(30.0, 100.0),
    seconds=1.0,
)

DEFAULT: Final = MoreSize(
    fk_batches=(1, 4, 16, 64, 256, 1024, 4096, 16384, 65536),
    fk_rounds=7,
    table_frames=300,
    latency_frames=100,
    frames=80,
    noises=(0.0, 0.5e-3, 1e-3, 5e-3),
    losses=(0.0, 0.2),
    seeds=1,
    rates=(15.0, 30.0, 100.0),
    seconds=2.0,
)

PUBLISHED: Final = replace(
    DEFAULT,
    table_frames=500,
    frames=200,
    noises=(0.0, 0.5e-3, 1e-3, 2e-3, 5e-3),
    losses=(0.0, 0.05, 0.1, 0.2),
    rates=(15.0, 30.0, 60.0, 100.0, 200.0),
    seconds=5.0,
)

_SIZES: Final = {"quick": QUICK, "default": DEFAULT, "published": PUBLISHED}


def more_size(context: ExperimentContext) -> MoreSize:
    """How much is computed at a size; as by default where it has its own name."""
    return _SIZES.get(context.size.name, DEFAULT)
