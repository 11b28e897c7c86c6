"""Settings of a benchmark and its cells; a cell combines a recording, a hand and a method with a
preset."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any, Final

from smooth_operator.atomic_files import file_name
from smooth_operator.calibration.operator_file import OperatorProfile
from smooth_operator.errors import ConfigError, SmoothOperatorError, UnknownNameError
from smooth_operator.hands.registry import hand_names, known_hands, load_hand
from smooth_operator.metrics.table import Definition, plugin_metrics
from smooth_operator.planning import CODE_OF_COMMANDS, Plan, content_of
from smooth_operator.plugins import is_target
from smooth_operator.reporting.drawing import method_label
from smooth_operator.result_cache import code_digest, content_digest, key_digest, outside_code
from smooth_operator.retargeting.method import MethodConfig
from smooth_operator.retargeting.preset_files import method_config
from smooth_operator.retargeting.presets import PRESETS, loadable_presets
from smooth_operator.retargeting.registry import METHODS
from smooth_operator.types import Side
from smooth_operator_benchmark.recordings import Source

ALL: Final = "all"
LATENCY_FRAMES: Final = 500
"""Number of frames of each recording over which latency is measured, after the warm-up."""


@dataclass(frozen=True, kw_only=True)
class Settings:
    """Settings of a benchmark.

    Attributes:
        output: folder of the results.
        recordings: files, folders, or ``synthetic``; see ``smooth_operator_benchmark.recordings``.
        hands: names of robot hands.
        methods: names of methods, as for ``select_methods``.
        frames: range of frames ``A:B``, for recordings without their own range.
        rate: frame rate of recordings without timestamps [Hz].
        layout: order of the landmarks in plain arrays; None for this project's order.
        side: side of recordings that do not state their side.
        seed: seed of the methods' random numbers.
        definition: definition of the metrics.
        metrics: ``package.module:attribute`` of further metrics, besides those of plugins.
        latency_frames: number of frames for the latency measurement; 0 skips it.
        workers: number of processes that measure quality; None for one per core, 0 to use none.
        cluster: address of a Ray cluster instead of processes on this machine.
        fingers: robot finger -> human finger that drives it; None for all fingers of each hand.
        operator: the calibrated operator of the recordings; None if there is no calibration.

    Raises:
        ConfigError: a number is negative.
        UnknownNameError: there is no such hand, method, preset or metric.
    """

    output: Path
    recordings: tuple[str, ...] = ("synthetic",)
    hands: tuple[str, ...] = ("mimic_p050",)
    methods: tuple[str, ...] = (ALL,)
    frames: str | None = None
    rate: float | None = None
    layout: str | None = None
    side: Side | None = None
    seed: int = 0
    definition: Definition = "sound"
    metrics: tuple[str, ...] = ()
    latency_frames: int = LATENCY_FRAMES
    workers: int | None = None
    cluster: str | None = None
    fingers: Mapping[str, str] | None = None
    operator: OperatorProfile | None = None

    def __post_init__(self) -> None:
        for name in ("latency_frames", "workers"):
            value = getattr(self, name)
            if value is not None and value < 0:
                raise ConfigError(f"{name} must be 0 or more, not {value}")
        object.__setattr__(self, "hands", select_hands(self.hands))
        select_methods(self.methods)


def only_side(hands: tuple[str, ...]) -> Side | None:
    """Returns ``left`` if all these hands exist only as left hands, otherwise None.

    Args:
        hands: names; unknown names are reported by ``select_hands``.
    """
    catalogue = known_hands()
    sides = {catalogue[name].default_side for name in select_hands(hands) if name in catalogue}
    return "left" if sides == {"left"} else None


def select_hands(names: tuple[str, ...]) -> tuple[str, ...]:
    """Returns the names of hands, with ``all`` expanded and without duplicates.

    Raises:
        UnknownNameError: there is no such hand.
        ConfigError: no name was given.
    """
    chosen: dict[str, None] = {}
    for name in names:
        if name == ALL:
            chosen |= dict.fromkeys(hand_names())
            continue
        try:
            load_hand(name)
        except UnknownNameError:
            raise
        except SmoothOperatorError:
            pass  # a hand of the other side only, or a damaged one: its cells have the reason
        chosen[name] = None
    if not chosen:
        raise ConfigError(f"name at least one hand: {', '.join(hand_names())}, or all")
    return tuple(chosen)


@dataclass(frozen=True)
class Choice:
    """A method to measure, with its preset.

    Attributes:
        method: its name.
        preset: name of its preset, or of a file with its model.
        config: its configuration.
    """

    method: str
    preset: str
    config: MethodConfig


def select_methods(names: tuple[str, ...]) -> list[Choice]:
    """Finds methods and presets by name.

    Args:
        names: ``all`` for every method with its default preset, ``METHOD`` for one method with its
            default preset, ``METHOD:PRESET`` for a preset, ``METHOD:all`` for all presets of a
            method, and ``METHOD:FILE`` for a trained model, if the method uses one.

    Returns:
        The methods in the requested order, without duplicates.

    Raises:
        UnknownNameError: there is no such method or preset.
        ConfigError: no name was given.
    """
    chosen: dict[tuple[str, str], MethodConfig] = {}
    for name in names:
        method, preset = METHODS.split(name)
        if name == ALL:
            for each, presets in loadable_presets().items():
                default = next(iter(presets))
                chosen[each, default] = presets[default]
            continue
        if method not in METHODS and not is_target(method):
            raise UnknownNameError("method", method, (*METHODS, ALL))
        presets = PRESETS[method]
        default = next(iter(presets))
        if preset == ALL:
            chosen |= {(method, each): config for each, config in presets.items()}
        elif name == method:
            chosen[method, default] = presets[default]
        else:
            chosen[method, preset] = method_config(method, preset)
    if not chosen:
        raise ConfigError(f"name at least one method: {', '.join(PRESETS)}, or all")
    return [Choice(method, preset, config) for (method, preset), config in chosen.items()]


@dataclass(frozen=True, eq=False)
class Cell:
    """One combination to measure: a recording, a hand and a method with a preset.

    Attributes:
        source: the recording.
        hand: name of the robot hand.
        method: name of the method.
        preset: name of its preset.
        config: the method's configuration.
        fingers: robot finger -> human finger that drives it; None for all.
        pinch_gaps: known gaps of tracker and operator, as for ``Retargeter``.
    """

    source: Source
    hand: str
    method: str
    preset: str
    config: MethodConfig
    fingers: Mapping[str, str] | None = None
    pinch_gaps: Mapping[str, float] = field(default_factory=dict)

    @property
    def side(self) -> Side:
        """Side of the human hand and the robot hand."""
        return self.source.side

    @property
    def key(self) -> tuple[str, str, str, str, str]:
        """Recording, hand, side, method and preset, which identify a row of the results."""
        return (self.source.name, self.hand, self.side, self.method, self.preset)

    @property
    def label(self) -> str:
        """Human-readable name of the cell."""
        method = method_label(self.method, self.preset)
        return f"{self.source.name} on {self.hand} {self.side}, {method}"

    @property
    def slug(self) -> str:
        """Name of the cell's files: readable, valid on every system, and unique."""
        path = self.source.request.path
        place = "" if path is None else str(path.absolute())
        return file_name("-".join(self.key), (place, *self.key))

    def plan(self, seed: int) -> Plan:
        """Returns the plan that retargets the cell's recording, which must exist;
        SmoothOperatorError if there is no such hand."""
        recording = self.source.recording
        assert recording is not None  # a cell without one is not begun
        hand = load_hand(self.hand, self.side, fingers=self.fingers)
        return Plan(
            recording=recording,
            hand=hand,
            method=self.method,
            preset=self.preset,
            config=self.config,
            seed=seed,
            fingers=self.fingers,
            pinch_gaps=self.pinch_gaps,
        )


def cells_of(
    sources: Iterable[Source], settings: Settings, methods: Sequence[Choice]
) -> list[Cell]:
    """Combines every recording with every hand and every method. Cells are sorted by recording,
    then hand, then method."""
    own = {} if settings.operator is None else settings.operator.pinch_gaps
    return [
        Cell(source, hand, choice.method, choice.preset, choice.config, settings.fingers, gaps)
        for source in sources
        for gaps in [{**source.pinch_gaps, **own}]
        for hand in settings.hands
        for choice in methods
    ]


def fingerprint(cell: Cell, settings: Settings) -> str:
    """Digest of a cell's inputs, without the code that it depends on.

    It covers frames, hand, configuration, seed and definitions. Cells with equal fingerprints need
    to be measured only once.
    """
    outside = outside_code(cell.config, *(metric.compute for metric in plugin_metrics()))
    return key_digest(
        {
            "frames": cell.source.digest,
            "hand": hand_identity(cell.hand, cell.side, tuple((cell.fingers or {}).items())),
            "method": cell.method,
            "preset": cell.preset,
            "config": cell.config,
            "pinch_gaps": dict(cell.pinch_gaps),
            "seed": settings.seed,
            "definition": settings.definition,
            "files": [content_digest(path) for path in files_of(cell.config)],
            **({"plugins": outside} if outside else {}),
            **({"metrics": sorted(settings.metrics)} if settings.metrics else {}),
        }
    )


def benchmark_code() -> str:
    """Digest of the code and the models on which commands and metrics depend.

    It does not cover pages, plots and the command line. If a method changes between two runs of a
    benchmark, its cells are measured again.
    """
    return code_digest(*CODE_OF_COMMANDS, "metrics")


@cache
def hand_identity(name: str, side: Side, fingers: tuple[tuple[str, str], ...]) -> str:
    """Identity of a hand: its description and the content of its model file, but not its folder."""
    try:
        spec = load_hand(name, side, fingers=dict(fingers) or None).spec
    except SmoothOperatorError as error:
        return f"{name} {side}: {error}"
    return key_digest(content_of(spec))


def files_of(config: Any) -> Iterator[Path]:
    """Files that a configuration names, such as trained models."""
    if isinstance(config, Path) and config.is_file():
        yield config
    elif dataclasses.is_dataclass(config):
        for field in dataclasses.fields(config):
            yield from files_of(getattr(config, field.name))
