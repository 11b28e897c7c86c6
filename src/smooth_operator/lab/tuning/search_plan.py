"""Plan of a search: variables with bounds, recordings and those held out, and the score of a trial.

Held-out recordings are recognised by their content. Each frame has a word: the distances between
wrist and fingertips, rounded to 0.01 mm and digested. That does not change when a recording is
renamed, cut, thinned out, moved, turned, mirrored or written in another format.

A score is relative to the start configuration. On each recording, each term is
``weight * log((error + floor) / (error of the start + floor))``; a score is their sum over the
terms, averaged over the recordings, so the start has 0 if it breaks no bound, and 0.1 less is 10 %
less of an error of weight 1. Bounds add ``PENALTY`` times the relative excess on each recording: a
tenth beyond one is as bad as an error of weight 1 that is 2.7 times as large.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np

from smooth_operator.errors import ConfigError, RecordingError, UnknownNameError, require
from smooth_operator.formats.setting_paths import (
    SUFFIX,
    find_setting,
    numeric_settings,
    read_preset_file,
    with_settings,
)
from smooth_operator.hands.registry import load_hand
from smooth_operator.lab.benchmark.cells import hand_identity
from smooth_operator.lab.benchmark.recordings import Source, load_sources, parse_request
from smooth_operator.lab.benchmark.suite import check_folder, value_of
from smooth_operator.lab.offline.trajectory_retargeter import check_method
from smooth_operator.landmarks import TIPS, WRIST
from smooth_operator.methods.method import MethodConfig
from smooth_operator.methods.presets import default_preset, method_config
from smooth_operator.metrics.table import REGISTRY, find_metric
from smooth_operator.types import HandRecording

MANY: Final = 10
"""So many frames of a held-out recording, or all of a shorter one, are no coincidence."""

_UNIT: Final = 1e-5  # [m]


def frame_words(recording: HandRecording) -> set[bytes]:
    """Words of the frames whose wrist and fingertips are valid."""
    points = recording.landmarks[:, [WRIST, *TIPS]]
    assert recording.valid is not None  # filled in on construction
    valid = recording.valid[:, [WRIST, *TIPS]].all(axis=1)
    first, second = np.triu_indices(points.shape[1], 1)
    lengths = np.linalg.norm(points[:, first] - points[:, second], axis=-1)[valid]
    # A word for either rounding, so that the last bit of a float32 does not make another frame.
    units = lengths / _UNIT
    rounded = (np.floor(units).astype("<i8"), np.floor(units + 0.5).astype("<i8"))
    return {hashlib.sha256(row.tobytes()).digest()[:12] for rows in rounded for row in rows}


def check_held_out(sources: Sequence[Source], held_out: Iterable[Source]) -> None:
    """Refuses to tune on what is held out.

    Raises:
        ConfigError: a recording holds frames of one that is held out.
    """
    words_held_out = [
        (source, frame_words(source.recording)) for source in held_out if source.recording
    ]
    for source in sources:
        if source.recording is None:
            continue
        words = frame_words(source.recording)
        for other, theirs in words_held_out:
            shared = len(words & theirs)
            if shared >= min(MANY, len(words), len(theirs)) and shared:
                raise ConfigError(
                    f"{source.name} holds frames of {other.name}, which is held out for judging: "
                    "what is tuned on it could no longer be judged; tune on other frames, or "
                    "take it off the list of those held out"
                )


PENALTY: Final = 10.0

_STEP_RATE: Final = 115.0


@dataclass(frozen=True)
class Term:
    """A part of the score.

    Attributes:
        name: name of the term.
        error: from figures to what should be small; None where it was not measured.
        floor: an error that is as good as none.
        weight: in the sum, unless said otherwise.
    """

    name: str
    error: Callable[[Mapping[str, Any]], float | None]
    floor: float
    weight: float


def figure(metrics: Mapping[str, Any], name: str) -> float | None:
    """A figure by the name of a metric, or one of two more:
    ``lag_frames``, and ``joint_step``, the largest one at 115 Hz [rad]."""
    if name == "lag_frames":
        lag, rate = figure(metrics, "lag_ms"), figure(metrics, "rate_hz")
        return None if lag is None or rate is None else lag * 1e-3 * rate
    if name == "joint_step":
        step, rate = figure(metrics, "max_joint_step"), figure(metrics, "rate_hz")
        return None if step is None or rate is None else step * rate / _STEP_RATE
    return value_of({"metrics": metrics}, find_metric(name))


def _from_one(name: str) -> Callable[[Mapping[str, Any]], float | None]:
    def error(metrics: Mapping[str, Any]) -> float | None:
        value = figure(metrics, name)
        return None if value is None else abs(1.0 - value)

    return error


def _itself(name: str) -> Callable[[Mapping[str, Any]], float | None]:
    return lambda metrics: figure(metrics, name)


def _pinch(metrics: Mapping[str, Any]) -> float | None:
    """Share of the human's pinches in which the robot's surfaces do not touch, or are too deep."""
    touching, deep = (figure(metrics, f"pinch_{name}_share") for name in ("touch", "deep"))
    return None if touching is None or deep is None else 1.0 - touching + deep


TERMS: Final = (
    Term("cosine", _from_one("cosine_similarity"), 1e-4, 1.0),
    Term("cosine_all", _from_one("cosine_similarity_all"), 1e-4, 0.5),
    Term("scale", _from_one("scale_ratio"), 0.02, 0.25),
    Term("motion", _from_one("motion_preservation"), 1e-3, 1.0),
    Term("velocity", _from_one("velocity_correlation"), 1e-3, 1.0),
    Term("flatness", _itself("flatness"), 1e-9, 1.0),
    Term("collision", _itself("self_collision.share"), 0.02, 0.5),
    Term("pinch", _pinch, 0.02, 0.5),
)


@dataclass(frozen=True)
class Bound:
    """Lower or upper bound of a figure.

    Attributes:
        name: name of the figure, see ``figure``.
        limit: its bound.
        lower: True for a lower bound.
    """

    name: str
    limit: float
    lower: bool = False

    def excess(self, metrics: Mapping[str, Any]) -> float:
        """Excess over the bound, relative to it; 0 within, or where it was not measured."""
        value = figure(metrics, self.name)
        if value is None:
            return 0.0
        beyond = self.limit - value if self.lower else value - self.limit
        return max(beyond, 0.0) / max(abs(self.limit), 0.05)


BOUNDS: Final = (
    Bound("lag_frames", 1.0),
    Bound("joint_step", 0.25),
    Bound("frozen_share", 0.0),
)
"""Held unless another bound of the same figure is given."""


@dataclass(frozen=True)
class Scoring:
    """Scoring of trials.

    Attributes:
        weights: name of a term -> its weight; the terms' own for the rest.
        bounds: in place of those of ``BOUNDS`` with the same name.

    Raises:
        UnknownNameError: there is no such term or figure.
        ConfigError: a weight is negative.
    """

    weights: Mapping[str, float]
    bounds: tuple[Bound, ...]

    def __post_init__(self) -> None:
        names = [term.name for term in TERMS]
        for name, weight in self.weights.items():
            if name not in names:
                raise UnknownNameError("term of the score", name, names)
            if not (weight >= 0 and math.isfinite(weight)):
                raise ConfigError(f"the weight of {name} must be 0 or more, not {weight}")
        for bound in self.bounds:
            metrics = [*REGISTRY, "lag_frames", "joint_step"]
            if bound.name not in metrics:
                raise UnknownNameError("figure", bound.name, metrics)
        bounded = {bound.name for bound in self.bounds}
        others = tuple(bound for bound in BOUNDS if bound.name not in bounded)
        object.__setattr__(self, "bounds", (*others, *self.bounds))

    def score(
        self, metrics: Sequence[Mapping[str, Any]], start: Sequence[Mapping[str, Any]]
    ) -> float:
        """The score of a trial; less is better.

        Args:
            metrics: metrics of the trial, one for each recording.
            start: metrics of the configuration that the search began at.
        """
        pairs = list(zip(metrics, start, strict=True))
        return sum(self._one(own, first) for own, first in pairs) / len(pairs)

    def _one(self, own: Mapping[str, Any], first: Mapping[str, Any]) -> float:
        total = 0.0
        for term in TERMS:
            weight = self.weights.get(term.name, term.weight)
            now, before = term.error(own), term.error(first)
            if weight and now is not None and before is not None:
                total += weight * math.log((now + term.floor) / (before + term.floor))
        return total + PENALTY * sum(bound.excess(own) for bound in self.bounds)


COMMAND: Final = "tune"
TRIALS: Final = 120


@dataclass(frozen=True, kw_only=True)
class TuningSettings:
    """Settings of a search.

    Attributes:
        output: folder of the results.
        method: name of the method.
        preset: name of the preset, or preset file, that the search begins at; None for the default.
        recordings: to tune on, named as in ``smooth_operator.lab.benchmark.recordings``.
        held_out: not to be tuned on, named alike.
        vary: ``NAME=LOW:HIGH[:log]`` each.
        fix: setting -> another value for it, constant.
        hand: name of the robot hand.
        rate: frames a second of recordings without stamps [Hz].
        trials: largest number of trials.
        seed: seed of the search and of the method's random numbers.
        weights: term of the score -> weight.
        bounds: bounds of figures.
        workers: processes; None for one per core, 0 for none.
    """

    output: Path
    method: str
    preset: str | None = None
    recordings: tuple[str, ...]
    held_out: tuple[str, ...] = ()
    vary: tuple[str, ...]
    fix: Mapping[str, float] = field(default_factory=dict)
    hand: str = "mimic_p050"
    rate: float | None = None
    trials: int = TRIALS
    seed: int = 0
    weights: Mapping[str, float] = field(default_factory=dict)
    bounds: tuple[Bound, ...] = ()
    workers: int | None = None


@dataclass(frozen=True, eq=False)
class Tuning:
    """A search, ready to begin.

    Attributes:
        settings: settings of the search.
        base: name of the preset that the result changes.
        changed: path -> value that the preset file asked for, or ``fix`` did, and is not varied.
        config: where the search begins.
        variables: settings that the search varies.
        sources: the recordings to tune on.
        held_out: those that are kept for judging.
        scoring: scoring of the trials.
    """

    settings: TuningSettings
    base: str
    changed: Mapping[str, float | int]
    config: MethodConfig
    variables: tuple[Variable, ...]
    sources: tuple[Source, ...]
    held_out: tuple[Source, ...]
    scoring: Scoring

    @property
    def key(self) -> dict[str, Any]:
        """Key of a trial's inputs, without its values and the code."""
        return {
            "method": self.settings.method,
            "config": self.config,
            "hand": [
                hand_identity(self.settings.hand, side, ())
                for side in sorted({source.side for source in self.sources})
            ],
            "frames": [source.digest for source in self.sources],
            "seed": self.settings.seed,
        }


def plan_tuning(settings: TuningSettings) -> Tuning:
    """Looks everything up; writes nothing.

    Raises:
        UnknownNameError: there is no such method, preset, setting, hand, term or figure.
        ConfigError: the settings can't be met, or name a held-out recording.
        RecordingError: a recording can't be read.
        OutputError: the folder holds something else.
    """
    require("a search of settings", "tune", "optuna")
    check_folder(settings.output, COMMAND, "an earlier search")
    if settings.trials < 2:
        raise ConfigError(f"a search needs 2 trials or more, not {settings.trials}")
    base, changed = settings.preset or default_preset(settings.method), {}
    if base.endswith(SUFFIX):
        file = read_preset_file(Path(base))
        method_config(settings.method, base)  # of this method? else it is refused here
        base, changed = file.base, dict(file.settings)
    config = with_settings(method_config(settings.method, base), changed)
    fixed = {find_setting(config, name): value for name, value in settings.fix.items()}
    config, changed = with_settings(config, fixed), changed | fixed
    if not settings.vary:
        raise ConfigError("name what to vary, as in --vary pose_weight=0.01:0.1:log")
    variables = tuple(parse_variable(text, config) for text in settings.vary)
    paths = [variable.path for variable in variables]
    for path in paths:
        if paths.count(path) > 1 or path in fixed:
            raise ConfigError(f"{path} is named twice")
    sources = _loaded(settings.recordings, settings.rate, "tune on")
    held_out = _loaded(settings.held_out, settings.rate, "hold out") if settings.held_out else ()
    check_held_out(sources, held_out)
    for side in {source.side for source in sources}:
        check_method(config, load_hand(settings.hand, side))
    scoring = Scoring(settings.weights, settings.bounds)
    rest = {path: value for path, value in changed.items() if path not in paths}
    return Tuning(settings, base, rest, config, variables, sources, held_out, scoring)


def _loaded(texts: tuple[str, ...], rate: float | None, what: str) -> tuple[Source, ...]:
    if not texts:
        raise ConfigError(f"name a recording to {what}")
    sources = load_sources([parse_request(text, rate=rate) for text in texts])
    for source in sources:
        if source.error is not None:
            raise RecordingError(source.error)
    return tuple(sources)


@dataclass(frozen=True)
class Variable:
    """One setting that is varied.

    Attributes:
        path: path of the setting in the configuration.
        low, high: bounds, both included.
        log: True if equal steps are equal ratios.
        whole: True for a whole number.
        start: value in the configuration that the search begins at, within the bounds.
    """

    path: str
    low: float
    high: float
    log: bool
    whole: bool
    start: float

    def rounded(self, value: float) -> float | int:
        """A value within the bounds, whole or of six digits.

        Six digits are more than any setting is known to, and make a preset that can be read.
        """
        if self.whole:
            return int(value)
        return min(max(float(f"{value:.6g}"), self.low), self.high)


def parse_variable(text: str, config: object) -> Variable:
    """A variable from ``NAME=LOW:HIGH`` or ``NAME=LOW:HIGH:log``.

    Args:
        text: the name is a path of a setting, or the end of one.
        config: whose setting it is, and where the search begins.

    Raises:
        UnknownNameError: there is no such setting.
        ConfigError: the text is something else, or the bounds can't be.
    """
    name, equals, bounds = text.partition("=")
    words = bounds.split(":")
    if not equals or len(words) not in (2, 3) or (len(words) == 3 and words[2] != "log"):
        raise ConfigError(
            f"{text!r}: expected NAME=LOW:HIGH or NAME=LOW:HIGH:log, as in pose_weight=0.01:0.1:log"
        )
    try:
        low, high = float(words[0]), float(words[1])
    except ValueError:
        raise ConfigError(f"{text!r}: the bounds must be numbers") from None
    if not (math.isfinite(low) and math.isfinite(high) and low < high):
        raise ConfigError(f"{text!r}: the bounds must be finite, the lower one first")
    log = len(words) == 3
    if log and low <= 0:
        raise ConfigError(f"{text!r}: with log, the bounds must be positive")
    path = find_setting(config, name.strip())
    now = numeric_settings(config)[path]
    whole = isinstance(now, int)
    if whole and math.ceil(low) >= math.floor(high):
        raise ConfigError(f"{text!r}: {path} is a whole number, and there are not two between")
    return Variable(path, low, high, log, whole, min(max(float(now), low), high))
