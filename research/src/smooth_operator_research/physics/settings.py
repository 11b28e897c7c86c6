"""What ``bench --physics`` is asked to do."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from smooth_operator.errors import ConfigError
from smooth_operator.lab.benchmark.settings import ALL, select_hands, select_methods
from smooth_operator.types import Side


@dataclass(frozen=True, kw_only=True)
class PhysicsSettings:
    """What to measure, and where to write it.

    Attributes:
        output: folder of the results.
        measures: names of measures; see ``lab.physics.registry``.
        hands: names of robot hands.
        methods: names as ``lab.benchmark.settings.select_methods`` takes them.
        side: which hand, of measures that need no recording.
        recordings: of measures that need some: files, folders, or ``synthetic``; empty for what a
            measure takes by itself.
        frames: ``A:B``, of each recording that brings no range of its own.
        rate: frames a second of recordings without stamps [Hz].
        layout: order of the landmarks in plain arrays; None for the project's own.
        units: how many independent units (seeds, worlds, operators) each measure takes; None for
            as many as it takes by itself.
        quick: take fewer and shorter cases, to try things out.
        seed: of the units and of the methods' random numbers.
        workers: processes; None for one per core, 0 for none.
        cluster: address of a Ray cluster instead of processes on this machine.

    Raises:
        ConfigError: a number is out of its range, or there is nothing to measure.
        UnknownNameError: there is no such hand, method or preset.
    """

    output: Path
    measures: tuple[str, ...] = ()
    hands: tuple[str, ...] = ("mimic_p050",)
    methods: tuple[str, ...] = (ALL,)
    side: Side = "right"
    recordings: tuple[str, ...] = ()
    frames: str | None = None
    rate: float | None = None
    layout: str | None = None
    units: int | None = None
    quick: bool = False
    seed: int = 0
    workers: int | None = None
    cluster: str | None = None

    def __post_init__(self) -> None:
        if self.units is not None and self.units < 1:
            raise ConfigError(f"a measure takes one independent unit or more, not {self.units}")
        if self.seed < 0:
            raise ConfigError(f"the seed must be 0 or more, not {self.seed}")
        object.__setattr__(self, "hands", select_hands(self.hands))
        select_methods(self.methods)

    def count(self, default: int, quick: int) -> int:
        """How many units a measure takes.

        Args:
            default: where nothing is said.
            quick: where a quick run is asked for.
        """
        if self.units is not None:
            return self.units
        return quick if self.quick else default
