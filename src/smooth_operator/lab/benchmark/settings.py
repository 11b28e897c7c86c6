"""Settings of a benchmark, and the methods that they name."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from smooth_operator.errors import ConfigError, SmoothOperatorError, UnknownNameError
from smooth_operator.hands.registry import hand_names, known_hands, load_hand
from smooth_operator.human.operator import OperatorProfile
from smooth_operator.methods.method import MethodConfig
from smooth_operator.methods.presets import PRESETS, loadable_presets, method_config
from smooth_operator.methods.registry import METHODS
from smooth_operator.metrics.evaluation import Definition
from smooth_operator.plugins import is_target
from smooth_operator.types import Side

ALL: Final = "all"
LATENCY_FRAMES: Final = 500
"""Frames of each recording that latency is measured over, after the warm-up."""


@dataclass(frozen=True, kw_only=True)
class Settings:
    """Settings of a benchmark.

    Attributes:
        output: folder of the results.
        recordings: files, folders, or ``synthetic``; see ``lab.benchmark.recordings``.
        hands: names of robot hands.
        methods: names as ``select_methods`` takes them.
        frames: ``A:B``, of each recording that brings no range.
        rate: frames a second of recordings without stamps [Hz].
        layout: order of the landmarks in plain arrays; None for the project's own.
        side: side of recordings that do not say theirs.
        seed: seed of the methods' random numbers.
        definition: definition of the metrics.
        metrics: ``package.module:attribute`` of further metrics, besides those of plugins.
        latency_frames: frames to measure latency over; 0 measures none.
        workers: processes for the quality of cells; None for one per core, 0 for none.
        cluster: address of a Ray cluster instead of processes on this machine.
        fingers: robot finger -> human finger that drives it; None for all fingers of each hand.
        operator: the calibrated operator of the recordings; None for none.

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
    """``left`` if all these hands are left ones only, None otherwise.

    Args:
        hands: names; of one that is not known, ``select_hands`` says so.
    """
    catalogue = known_hands()
    sides = {catalogue[name].default_side for name in select_hands(hands) if name in catalogue}
    return "left" if sides == {"left"} else None


def select_hands(names: tuple[str, ...]) -> tuple[str, ...]:
    """Names of hands, ``all`` spelt out and repeats left out.

    Raises:
        UnknownNameError: there is no such hand.
        ConfigError: there is no name at all.
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
            pass  # known, but of the other side only, or damaged: its cells say so
        chosen[name] = None
    if not chosen:
        raise ConfigError(f"name at least one hand: {', '.join(hand_names())}, or all")
    return tuple(chosen)


@dataclass(frozen=True)
class Choice:
    """A method to measure.

    Attributes:
        method: its name.
        preset: name of its preset, or of a file with its model.
        config: its configuration.
    """

    method: str
    preset: str
    config: MethodConfig


def select_methods(names: tuple[str, ...]) -> list[Choice]:
    """Methods and presets by name.

    Args:
        names: ``all`` for each method with its default preset, ``METHOD`` for one with its default,
            ``METHOD:PRESET`` for a preset, ``METHOD:all`` for all presets of a method, and
            ``METHOD:FILE`` for a trained model, where the method has one.

    Returns:
        The methods in the order asked for, repeats left out.

    Raises:
        UnknownNameError: there is no such method or preset.
        ConfigError: there is no name at all.
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


def method_label(method: str, preset: str) -> str:
    """Name of a method in tables: without the preset for its default."""
    try:
        default = next(iter(PRESETS[method]))
    except SmoothOperatorError:  # of older results, or of a plugin that is gone
        default = ""
    return method if preset == default else f"{method}:{preset}"
