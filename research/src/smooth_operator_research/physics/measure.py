"""Interface of a measure of ``bench --physics``, and its cases.

A measure is a class without arguments, listed in ``physics.suite``. The framework makes the
cases (each hand, method, condition and independent unit), runs them in workers, stores the results,
and makes tables, files and the report.
"""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Protocol

import numpy as np
from jaxtyping import Float

from smooth_operator.errors import ConfigError
from smooth_operator.execution import built_for, execute
from smooth_operator.hands.hand import Hand
from smooth_operator.hands.registry import load_hand
from smooth_operator.planning import Plan
from smooth_operator.reporting.drawing import method_label
from smooth_operator.retargeting.alignment import reference_landmarks
from smooth_operator.retargeting.known_gaps import known_gaps
from smooth_operator.retargeting.method import MethodConfig
from smooth_operator.retargeting.retargeter import Retargeter
from smooth_operator.retargeting.trajectory import TrajectoryMethodConfig
from smooth_operator.synthetic.tracker import TRACKERS, tracker_model
from smooth_operator.types import CommandTrajectory, HandRecording, Side
from smooth_operator_benchmark.cells import ALL, select_hands, select_methods
from smooth_operator_research.physics.results import Figure, MeasureResults, Row


@dataclass(frozen=True, kw_only=True)
class PhysicsSettings:
    """Settings of a run of measures.

    Attributes:
        output: folder of the results.
        measures: names of measures; see ``physics.suite``.
        hands: names of robot hands.
        methods: names, in the form for ``benchmark.settings.select_methods``.
        side: side of the hand in measures without recordings.
        recordings: files, folders, or ``synthetic``, for measures that need recordings; empty for
            the defaults of each measure.
        frames: range ``A:B`` for each recording that has no range of its own.
        rate: frame rate of recordings without timestamps [Hz].
        layout: order of the landmarks in plain arrays; None for the project's own.
        trackers: kinds of trackers of measures whose human is simulated.
        units: number of independent units (seeds, worlds, operators) of each measure; None for
            the measure's default.
        quick: True for fewer and shorter cases, to try the measures.
        seed: seed of the units and of the methods' random numbers.
        workers: number of processes; None for one per core, 0 for none.
        cluster: address of a Ray cluster instead of processes on this machine.
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
    trackers: tuple[str, ...] = tuple(TRACKERS)
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
        for tracker in self.trackers:
            tracker_model(tracker)

    def count(self, default: int, quick: int) -> int:
        """Number of units of a measure.

        Args:
            default: number without another setting.
            quick: number in a quick run.
        """
        if self.units is not None:
            return self.units
        return quick if self.quick else default


if TYPE_CHECKING:
    from matplotlib.figure import Figure as Plot


@dataclass(frozen=True, eq=False)
class Unit:
    """An independent repetition: a seed, a recording, a world, an operator.

    Attributes:
        name: name in the rows.
        key: JSON value of everything it depends on, for the key of a stored result; if empty, the
            name.
        data: data that a case needs; it can be pickled.
        effort: approximate duration; only the proportions matter.
    """

    name: str
    key: Any = None
    data: Any = None
    effort: float = 1.0


@dataclass(frozen=True, eq=False)
class Case:
    """One run: a unit in a condition, a hand, a method.

    Attributes:
        measure: name of the measure.
        hand_name: name of the robot hand.
        side: side of both hands.
        method: name of the method.
        preset: name of its preset.
        config: its configuration.
        condition: one of ``Measure.conditions``.
        unit: the independent unit.
        seed: seed of the method's random numbers.
        quick: True for a shorter case.
        clip: True to record a clip.
    """

    measure: str
    hand_name: str
    side: Side
    method: str
    preset: str
    config: MethodConfig
    condition: str
    unit: Unit
    seed: int = 0
    quick: bool = False
    clip: bool = False

    @property
    def key(self) -> tuple[str, ...]:
        """Key of the case among all cases."""
        return (
            self.measure,
            self.hand_name,
            self.side,
            self.method,
            self.preset,
            self.condition,
            self.unit.name,
        )

    @property
    def method_label(self) -> str:
        """Name of the method in tables."""
        return method_label(self.method, self.preset)

    @property
    def label(self) -> str:
        """Human-readable label."""
        condition = f", {self.condition}" if self.condition else ""
        where = f"{self.hand_name} {self.side}, {self.method_label}{condition}"
        return f"{where}, {self.unit.name}"

    @cached_property
    def hand(self) -> Hand:
        """The robot hand, loaded."""
        return load_hand(self.hand_name, self.side)

    def commands(self, recording: HandRecording) -> CommandTrajectory:
        """Commands of the method for a recording, from a fresh state.

        The compiled program is kept in the process for the next case of this hand and method.
        """
        todo = self._plan(recording)
        return execute(todo, built_for(todo)).commands

    def retargeter(self, tracker: str | None = None) -> Retargeter:
        """Compiled method for a loop that calls it frame by frame; cached in the process.

        Args:
            tracker: kind of tracker in the loop, whose pinch gaps are known.
        """
        if isinstance(self.config, TrajectoryMethodConfig):
            return Retargeter(self.hand, config=self.config, seed=self.seed)  # says why not
        nothing = HandRecording(reference_landmarks(self.hand)[None], np.zeros(1), self.side)
        # which does not look at the recording
        runner, _ = built_for(replace(self._plan(nothing), pinch_gaps=known_gaps(tracker)))
        assert isinstance(runner, Retargeter)
        return runner

    def _plan(self, recording: HandRecording) -> Plan:
        return Plan(
            recording=recording,
            hand=self.hand,
            method=self.method,
            preset=self.preset,
            config=self.config,
            seed=self.seed,
        )


@dataclass(frozen=True, eq=False)
class Clip:
    """Motion of a case, for a player; positions in the palm frame [m].

    Attributes:
        stamps: (T,) times [s].
        human: (T, 21, 3) the human's landmarks, aligned.
        joints: (T, n) positions of all joints of the robot [rad].
        objects: (T, p, 3) points of objects; None without objects.
        edges: pairs of these points that are joined by a line.
    """

    stamps: Float[np.ndarray, " T"]
    human: Float[np.ndarray, "T 21 3"]
    joints: Float[np.ndarray, "T n"]
    objects: Float[np.ndarray, "T p 3"] | None = None
    edges: Sequence[tuple[int, int]] = ()


@dataclass(frozen=True, eq=False)
class Measured:
    """Result of a case.

    Attributes:
        row: numbers and short texts.
        clip: recorded motion; None unless requested.
    """

    row: Row
    clip: Clip | None = None


@dataclass(frozen=True, eq=False)
class Drawing:
    """A plot of a measure.

    Attributes:
        name: name of its files, ``NAME.png`` and ``NAME.svg``.
        caption: text that explains the plot.
        plot: matplotlib's figure.
    """

    name: str
    caption: str
    plot: Plot = field(repr=False)


class Measure(Protocol):
    """A measure of what a hand achieves.

    Attributes:
        name: name on the command line.
        title: heading of its section.
        definition: definition in one sentence.
        page: its page of the documentation, with the anchor of its section.
        unit: kind of independent unit: "seed", "recording", "world", "operator".
        figures: columns that are figures, the most important first.
    """

    name: str
    title: str
    definition: str
    page: str
    unit: str
    figures: tuple[Figure, ...]

    def conditions(self, settings: PhysicsSettings) -> Sequence[str]:
        """Values of the varied quantity, such as tracker noise or task; each has a table."""

    def units(self, settings: PhysicsSettings) -> Sequence[Unit]:
        """The independent units, shared by all hands, methods and conditions."""

    def run(self, case: Case) -> Measured:
        """Runs one case. Deterministic: the same case gives the same row."""

    def draw(self, results: MeasureResults, colors: Mapping[str, str]) -> Sequence[Drawing]:
        """The plots of the report.

        Args:
            results: all rows and their summaries.
            colors: name of a method in tables -> its colour.
        """


RATE_HZ: Final = 30.0
_SCALES: Final = {"human": 1e-4, "joints": 1e-4, "objects": 1e-4}  # [m] or [rad]
_ABSENT: Final = -(2**31)


def clip_record(clip: Clip) -> dict[str, Any]:
    """Converts a clip to JSON values, at 30 frames per second."""
    stamps = clip.stamps
    count = min(len(stamps), max(2, int((stamps[-1] - stamps[0]) * RATE_HZ) + 1))
    times = np.linspace(stamps[0], stamps[-1], count)
    chosen = np.unique(np.searchsorted(stamps, times).clip(0, len(stamps) - 1))
    arrays = {name: getattr(clip, name) for name in _SCALES}
    return {
        "stamps": [round(float(t), 4) for t in stamps[chosen]],
        "edges": [list(edge) for edge in clip.edges],
        **{
            name: None if array is None else _packed(array[chosen], _SCALES[name])
            for name, array in arrays.items()
        },
    }


def clip_of_record(record: dict[str, Any]) -> Clip:
    """Restores a clip from the result of ``clip_record``, with fewer frames than the original."""
    arrays = {
        name: None if record[name] is None else _unpacked(record[name], scale)
        for name, scale in _SCALES.items()
    }
    human, joints = arrays["human"], arrays["joints"]
    assert human is not None
    assert joints is not None
    edges = [(int(a), int(b)) for a, b in record["edges"]]
    return Clip(np.asarray(record["stamps"], float), human, joints, arrays["objects"], edges)


def _packed(array: np.ndarray, scale: float) -> dict[str, Any]:
    finite = np.isfinite(array)
    whole = np.where(finite, np.rint(np.where(finite, array, 0.0) / scale), _ABSENT)
    text = base64.b64encode(whole.astype("<i4").tobytes()).decode()
    return {"shape": list(array.shape), "values": text}


def _unpacked(record: dict[str, Any], scale: float) -> np.ndarray:
    whole = np.frombuffer(base64.b64decode(record["values"]), "<i4").reshape(record["shape"])
    return np.where(whole == _ABSENT, np.nan, whole * scale)
