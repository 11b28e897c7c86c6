"""The search itself: trials in workers, the best of them as a preset file, all of them in a log."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, TypeAlias

import numpy as np

from smooth_operator.atomic_files import atomic_write, write_json
from smooth_operator.errors import ConfigError, DocumentError
from smooth_operator.formats.environment import environment
from smooth_operator.formats.preset_file import FORMAT, PresetFile
from smooth_operator.formats.toml_writer import toml_key, toml_value
from smooth_operator.lab.benchmark.cells import benchmark_code
from smooth_operator.lab.tuning.pareto import save_pareto
from smooth_operator.lab.tuning.score import figure
from smooth_operator.lab.tuning.search import search
from smooth_operator.lab.tuning.search_plan import COMMAND, Tuning
from smooth_operator.lab.tuning.trial import TrialTask, run_trial
from smooth_operator.lab.tuning.trial_log import Trial, TrialLog
from smooth_operator.lab.tuning.variables import values_at
from smooth_operator.parallel import PersistentPool
from smooth_operator.planning import PROGRAM
from smooth_operator.result_cache import Note, no_note

CONFIG: Final = "config.json"
LOG: Final = "trials.jsonl"
PRESET: Final = "preset.toml"
RESULT: Final = "result.json"
PARETO: Final = "pareto.png"

Progress: TypeAlias = Callable[[int, float, str | None], None]
"""Called after each trial: how many there were, the best score before this batch, why this one
failed or None."""

KEPT: Final = (
    "cosine_similarity", "cosine_similarity_all", "scale_ratio", "motion_preservation",
    "velocity_correlation", "lag_frames", "flatness", "self_collision.share", "pinch_error_mm",
    "joint_step", "frozen_share",
)  # fmt: skip
"""Figures in the result, of the start and of the best."""


@dataclass(frozen=True, eq=False)
class Tuned:
    """Result of a search.

    Attributes:
        values: path -> value of the best trial.
        score: of it; 0 is the start's, less is better.
        start: figures of the start, one for each recording.
        best: figures of the best trial.
        trials: how many there were, those known before included.
        fresh: how many were done now.
        preset: the preset file.
    """

    values: Mapping[str, float | int]
    score: float
    start: Sequence[Mapping[str, Any]]
    best: Sequence[Mapping[str, Any]]
    trials: int
    fresh: int
    preset: Path


def tune(
    todo: Tuning,
    progress: Progress = lambda count, best, reason: None,
    note: Note = no_note,
) -> Tuned:
    """Searches, and writes what is found into the folder of the search.

    Trials that an earlier run has left in the log are taken from it. A search that is stopped has
    lost the trials only that it was at.

    Args:
        todo: of ``plan_tuning``.
        progress: called after each trial that is made now.
        note: called with trials of the log that can't be used.

    Raises:
        ConfigError: the configuration that the search begins at can't be measured.
        OutputError: results can't be written.
        KeyboardInterrupt: stopped; the best so far is written.
    """
    settings, folder = todo.settings, todo.settings.output
    folder.mkdir(parents=True, exist_ok=True)
    config = {"program": PROGRAM, "command": COMMAND, "settings": settings}
    write_json(folder / CONFIG, config | environment(), indent=2)
    log = TrialLog(folder / LOG, todo.key, benchmark_code(), note)
    run = _Run(todo, log, progress)
    points = search(
        np.array([v.share(v.start) for v in todo.variables]), settings.trials, settings.seed
    )
    try:
        with PersistentPool(run_trial, settings.workers) as pool:
            batch = next(points)
            while True:
                batch = points.send(run.scores(pool, batch))
    except StopIteration:
        pass
    except KeyboardInterrupt:
        if run.best is not None:
            _write(todo, run)
        raise
    return _write(todo, run)


class _Run:
    """Trials of a search so far, and their scores."""

    def __init__(self, todo: Tuning, log: TrialLog, progress: Progress) -> None:
        self.todo, self.log, self.progress = todo, log, progress
        self.trials: list[tuple[float, Trial]] = []
        self.start: Sequence[Mapping[str, Any]] = ()
        self.done = self.fresh = 0

    @property
    def best(self) -> tuple[float, Trial] | None:
        good = [one for one in self.trials if math.isfinite(one[0])]
        return min(good, key=lambda one: one[0]) if good else None

    def scores(
        self, pool: PersistentPool[TrialTask, Any], batch: Sequence[np.ndarray]
    ) -> list[float]:
        """Scores of some points; infinity for those that fail."""
        todo = self.todo
        every = [values_at(todo.variables, point) for point in batch]
        if not self.trials:  # to the last digit where the search begins
            every[0] = {v.path: int(v.start) if v.whole else v.start for v in todo.variables}
        once = [values for i, values in enumerate(every) if values not in every[:i]]
        self.done += len(every) - len(once)
        trials: list[Trial | None] = [None] * len(once)
        tasks = [(values, self._task(values)) for values in once]
        for i, trial, fresh in self.log.run(tasks, pool.run):
            trials[i] = trial
            self.done, self.fresh = self.done + 1, self.fresh + fresh
            if fresh:
                best = self.best
                self.progress(self.done, math.inf if best is None else best[0], trial.reason)
        complete = [trial for trial in trials if trial is not None]  # all of them
        return [self._scored(complete[once.index(values)]) for values in every]

    def _scored(self, trial: Trial) -> float:
        if not self.trials:
            if trial.metrics is None:
                raise ConfigError(
                    f"the configuration that the search begins at can't be measured: {trial.reason}"
                )
            self.start = trial.metrics
        score = (
            math.inf
            if trial.metrics is None
            else self.todo.scoring.score(trial.metrics, self.start)
        )
        self.trials.append((score, trial))
        return score

    def _task(self, values: Mapping[str, float | int]) -> TrialTask:
        todo = self.todo
        return TrialTask(
            tuple(source.request for source in todo.sources),
            tuple(source.digest for source in todo.sources),
            todo.settings.hand,
            todo.config,
            values,
            todo.settings.seed,
        )


def _write(todo: Tuning, run: _Run) -> Tuned:
    assert run.best is not None  # the start was measured, or this is not reached
    score, trial = run.best
    assert trial.metrics is not None  # its score is finite
    folder = todo.settings.output
    made = {
        "by": f"{PROGRAM} {COMMAND}",
        "hand": todo.settings.hand,
        "trials": len(run.trials),
        "score": score,
        "tuned_on": [source.name for source in todo.sources],
        "tuned_on_frames": [source.digest for source in todo.sources],
        "held_out": [source.name for source in todo.held_out],
    }
    preset = PresetFile(todo.settings.method, todo.base, {**todo.changed, **trial.values}, made)
    write_preset_file(folder / PRESET, preset)
    names = [source.name for source in todo.sources]
    result = {
        "score": score,
        "values": trial.values,
        "varied": todo.variables,
        "scoring": {"weights": todo.scoring.weights, "bounds": todo.scoring.bounds},
        "recordings": {
            name: {"start": _kept(first), "best": _kept(last)}
            for name, first, last in zip(names, run.start, trial.metrics, strict=True)
        },
        "made": made,
    }
    write_json(folder / RESULT, result, indent=1)
    save_pareto(folder / PARETO, [t for _, t in run.trials], run.start, trial, names)
    return Tuned(
        trial.values, score, run.start, trial.metrics, len(run.trials), run.fresh, folder / PRESET
    )


def _kept(metrics: Mapping[str, Any]) -> dict[str, float | None]:
    return {name: figure(metrics, name) for name in KEPT}


def write_preset_file(path: Path, preset: PresetFile) -> None:
    """Writes a preset file, whole or not at all.

    Raises:
        OutputError: it can't be written.
        ConfigError: ``made`` holds what TOML can't.
    """
    top = {"format": FORMAT, "method": preset.method, "base": preset.base}
    try:
        lines = [*_rows(top), "", "[settings]", *_rows(preset.settings)]
        if preset.made:
            lines += ["", "[made]", *_rows(preset.made)]
    except DocumentError as error:
        raise ConfigError(f"{path}: {error}") from error
    with atomic_write(path) as file:
        file.write("\n".join([*lines, ""]).encode())


def _rows(table: Mapping[str, Any]) -> Iterator[str]:
    return (f"{toml_key(name)} = {toml_value(value)}" for name, value in table.items())
