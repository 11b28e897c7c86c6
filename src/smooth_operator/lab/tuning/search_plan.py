"""Plan of a search: variables with bounds, recordings and held-out recordings, names checked."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from smooth_operator.errors import ConfigError, RecordingError, require
from smooth_operator.formats.preset_file import SUFFIX, read_preset_file
from smooth_operator.formats.setting_paths import find_setting, numeric_settings, with_settings
from smooth_operator.hands.registry import load_hand
from smooth_operator.lab.benchmark.benchmark_folder import check_folder
from smooth_operator.lab.benchmark.cells import hand_identity
from smooth_operator.lab.benchmark.recordings import Source, load_sources, parse_request
from smooth_operator.lab.offline.trajectory_retargeter import check_method
from smooth_operator.lab.tuning.held_out import check_held_out
from smooth_operator.lab.tuning.score import Bound, Scoring
from smooth_operator.methods.method import MethodConfig
from smooth_operator.methods.presets import default_preset, method_config

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
