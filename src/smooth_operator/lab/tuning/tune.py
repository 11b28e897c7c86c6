"""The search itself: Optuna proposes values, workers try them, the best becomes a preset file."""

from __future__ import annotations

import contextlib
import json
import math
import os
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, Final, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np

from smooth_operator.atomic_files import atomic_write, output_error, write_json
from smooth_operator.compilation.compiled_program import compiled
from smooth_operator.compilation.start import dispatch_here
from smooth_operator.errors import ConfigError, DocumentError, OutputError, RecordingError
from smooth_operator.formats.environment import environment
from smooth_operator.formats.jsonable import to_json
from smooth_operator.formats.setting_paths import FORMAT, PresetFile, with_settings, with_unchecked
from smooth_operator.formats.toml_writer import toml_key, toml_value
from smooth_operator.hands.registry import load_hand
from smooth_operator.io.documents import parse_json
from smooth_operator.lab.benchmark.cells import benchmark_code
from smooth_operator.lab.benchmark.recordings import Request, load_sources
from smooth_operator.lab.offline import TrajectoryRetargeter
from smooth_operator.lab.tuning.search_plan import COMMAND, Tuning, figure
from smooth_operator.methods.frame import FrameState
from smooth_operator.methods.method import MethodConfig
from smooth_operator.methods.program import frame_step, ticks_of
from smooth_operator.methods.retargeter import Retargeter
from smooth_operator.metrics import evaluate
from smooth_operator.metrics.assemble import assemble_trace
from smooth_operator.parallel import PersistentPool
from smooth_operator.planning import PROGRAM
from smooth_operator.result_cache import key_digest
from smooth_operator.types import CommandTrajectory, HandRecording

CHUNK: Final = 256
"""Frames in a call."""


class TracedRun:
    """A method over recordings, for any values of some of its settings.

    Args:
        retargeter: retargeter of the configuration that the others are made from.
        paths: paths of the settings.
    """

    def __init__(self, retargeter: Retargeter, paths: Sequence[str]) -> None:
        self._retargeter, self._paths = retargeter, tuple(paths)
        config, served = retargeter.config, retargeter.shared.method.hand

        def chunk(values: jax.Array, state: FrameState, *frames: Any) -> Any:
            traced: MethodConfig = with_unchecked(
                config, {path: values[i] for i, path in enumerate(self._paths)}
            )
            method = traced.build(served)
            assert not method.on_host  # looked at by can_trace
            step = frame_step(method, traced.alignment)
            return jax.lax.scan(lambda carry, frame: step(carry, *frame), state, frames)

        self._chunk = compiled(chunk)

    def run(self, recording: HandRecording, values: Mapping[str, float | int]) -> CommandTrajectory:
        """The commands for a recording; latencies are NaN.

        Raises:
            TypeError, ValueError: the method looks at a value while it is compiled.
        """
        retargeter, hand = self._retargeter, self._retargeter.hand
        assert recording.valid is not None  # filled in on construction
        frames = [
            retargeter.program_landmarks(recording.landmarks),
            recording.valid,
            ticks_of(recording.stamps),
        ]
        # What is too much is invalid, so that every call is of one shape.
        count, lacking = len(recording), -len(recording) % CHUNK
        frames = [np.concatenate([each, np.repeat(each[-1:], lacking, 0)]) for each in frames]
        frames[1][count:] = False
        parameters = jnp.asarray([values[path] for path in self._paths], jnp.float32)
        state, poses, status = retargeter.init().trees, [], []
        for start in range(0, count, CHUNK):
            part = slice(start, start + CHUNK)
            state, answer = self._chunk(parameters, state, *(each[part] for each in frames))
            poses.append(np.asarray(answer.q, float))
            status.append(np.asarray(answer.status))
        q = np.clip(np.concatenate(poses)[:count], hand.limits[:, 0], hand.limits[:, 1])
        return CommandTrajectory(
            hand.full_configuration(q),
            hand.joint_names,
            recording.stamps,
            np.full(count, np.nan),
            np.concatenate(status)[:count].astype(np.int8),
        )


def can_trace(retargeter: Retargeter, values: Mapping[str, float | int]) -> bool:
    """True if tracing may work: fractions only, and a method that is one program."""
    fractions = all(isinstance(value, float) for value in values.values())
    return fractions and not retargeter.method.on_host


UNTRACEABLE = (
    jax.errors.ConcretizationTypeError,
    jax.errors.TracerArrayConversionError,
    jax.errors.TracerBoolConversionError,
    jax.errors.TracerIntegerConversionError,
)
"""What JAX raises where a method looks at a value that is traced."""


@dataclass(frozen=True, eq=False)
class TrialTask:
    """Values to be tried.

    Attributes:
        requests: the recordings; a worker reads them once.
        digests: digests of their frames, by which a change of the file is noticed.
        hand: name of the robot hand.
        config: configuration that takes the values.
        values: path of a setting -> value.
        seed: seed of the method's random numbers.
    """

    requests: tuple[Request, ...]
    digests: tuple[str, ...]
    hand: str
    config: MethodConfig
    values: Mapping[str, float | int]
    seed: int


def run_trial(task: TrialTask) -> list[dict[str, Any]]:
    """Metrics, one for each recording; workspace utilisation is left out.

    Raises:
        ConfigError: the values can't be, alone or together.
        RecordingError: a recording has changed since the search began.
    """
    dispatch_here()
    config = with_settings(task.config, task.values)
    results = []
    for recording in _recordings(task.requests, task.digests):
        hand = load_hand(task.hand, recording.side)
        commands = _commands(task, config, recording)
        trace = assemble_trace(recording, commands, hand, config.alignment, reach_samples=0)
        results.append(dict(evaluate(trace)))
    return results


@lru_cache(maxsize=4)
def _recordings(
    requests: tuple[Request, ...], digests: tuple[str, ...]
) -> tuple[HandRecording, ...]:
    sources = load_sources(requests)
    if tuple(source.digest for source in sources) != digests:
        raise RecordingError(
            "a recording has changed since the search began; begin the search again"
        )
    return tuple(source.recording for source in sources if source.recording is not None)


_traced: dict[tuple[Any, ...], TracedRun | None] = {}
"""Programs of this process; None where a method's values can't be traced."""


_whole: dict[tuple[Any, ...], TrajectoryRetargeter] = {}
"""The last one for whole recordings; its costs need no compiling."""


def _commands(task: TrialTask, config: MethodConfig, recording: HandRecording) -> CommandTrajectory:
    if (whole := config.trajectory) is not None:
        cell = (task.hand, recording.side, whole.causal, task.seed)
        if cell not in _whole:
            _whole.clear()
            _whole[cell] = TrajectoryRetargeter(
                load_hand(task.hand, recording.side), whole, task.seed
            )
        return _whole[cell].priced(whole).run(recording)[0]
    key = (task.hand, recording.side, task.config, tuple(task.values), task.seed)
    if key not in _traced:
        base = Retargeter(task.hand, side=recording.side, config=task.config, seed=task.seed)
        _traced[key] = TracedRun(base, tuple(task.values)) if can_trace(base, task.values) else None
    traced = _traced[key]
    if traced is not None:
        try:
            return traced.run(recording, task.values)
        except UNTRACEABLE:
            _traced[key] = None
    return _compiled(task, config, recording)


def _compiled(task: TrialTask, config: MethodConfig, recording: HandRecording) -> CommandTrajectory:
    """Compiled for these values."""
    retargeter = Retargeter(task.hand, side=recording.side, config=config, seed=task.seed)
    if retargeter.method.on_host:
        return retargeter.run(recording)[0]
    return TracedRun(retargeter, ()).run(recording, {})


CONFIG: Final = "config.json"
LOG: Final = "trials.jsonl"
PRESET: Final = "preset.toml"
RESULT: Final = "result.json"

SPREAD: Final = 0.5
"""Share of the trials that is spread over the box, by a scrambled Sobol sequence."""
BATCH: Final = 8
"""Trials after those that are proposed together, whatever the number of workers."""

Progress: TypeAlias = Callable[[int, float, str | None], None]
"""Called after each trial: number of trials, best score, and the reason if this one failed."""

FIGURES: Final = (
    "cosine_similarity", "cosine_similarity_all", "scale_ratio", "motion_preservation",
    "velocity_correlation", "lag_frames", "flatness", "self_collision.share",
    "pinch_touch_share", "pinch_deep_share", "joint_step", "frozen_share",
)  # fmt: skip
"""Figures in the result, of the start and of the best."""


@dataclass(frozen=True, eq=False)
class Tuned:
    """The result of a search.

    Attributes:
        values: path -> value of the best trial.
        score: the best one; 0 is the start's, less is better.
        start: figures of the start, one for each recording.
        best: figures of the best trial, one for each recording.
        trials: number of trials, those of earlier runs included.
        fresh: number of trials of this run.
        preset: the preset file.
    """

    values: Mapping[str, float | int]
    score: float
    start: Sequence[Mapping[str, Any]]
    best: Sequence[Mapping[str, Any]]
    trials: int
    fresh: int
    preset: Path


def tune(plan: Tuning, progress: Progress = lambda count, best, reason: None) -> Tuned:
    """Searches, and writes the result into the folder of the search.

    The first trial is the start; then come points of a Sobol sequence, then proposals of Optuna's
    tree-structured Parzen estimator. Trials of an earlier run are taken from the journal. A search
    that is stopped has lost only the trials that were in hand, and repeats them.

    Args:
        plan: plan of ``plan_tuning``.

    Raises:
        ConfigError: the configuration that the search begins at can't be measured.
        OutputError: results can't be written, or the journal is damaged.
        KeyboardInterrupt: stopped; the best so far is written.
    """
    settings, folder = plan.settings, plan.settings.output
    folder.mkdir(parents=True, exist_ok=True)
    config = {"program": PROGRAM, "command": COMMAND, "settings": settings}
    write_json(folder / CONFIG, config | environment(), indent=2)
    with _journal(folder / LOG) as storage:
        search = _Search(plan, storage)
        try:
            with PersistentPool(run_trial, settings.workers) as pool:
                search.run(pool, progress)
        except KeyboardInterrupt:
            if search.finished():
                _write(plan, search)
            raise
        return _write(plan, search)


@contextlib.contextmanager
def _journal(path: Path) -> Iterator[Any]:
    """Optuna's storage in a file of JSON lines.

    Raises:
        OutputError: it can't be read or written.
    """
    import optuna
    from optuna.storages.journal import JournalFileBackend, JournalFileOpenLock

    try:
        content = path.read_bytes() if path.exists() else b""
        whole = content.rfind(b"\n") + 1
        if whole < len(content):  # a killed process leaves half a line
            os.truncate(path, whole)
        if not all("op_code" in parse_json(line) for line in content[:whole].splitlines()):
            raise DocumentError("it is no journal of Optuna")
    except OSError as error:
        raise output_error(path, error) from error
    except (DocumentError, TypeError) as error:
        raise OutputError(
            f"{path} holds something other than trials: give another folder with --output, or "
            "remove the file"
        ) from error
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
        optuna.logging.set_verbosity(optuna.logging.ERROR)
        try:
            backend = JournalFileBackend(str(path), lock_obj=JournalFileOpenLock(str(path)))
            storage = optuna.storages.JournalStorage(backend)
        except OSError as error:
            raise output_error(path, error) from error
        yield storage


class _Search:
    """A study of Optuna, with the figures of its trials.

    Args:
        plan: the search.
        storage: storage of Optuna.
    """

    def __init__(self, plan: Tuning, storage: Any) -> None:
        import optuna

        self._optuna, self._plan = optuna, plan
        key = [plan.key, plan.variables, plan.scoring.weights, plan.scoring.bounds]
        self._study = optuna.create_study(
            storage=storage, study_name=key_digest([*key, benchmark_code()]), load_if_exists=True
        )
        self.fresh = 0

    def run(self, pool: PersistentPool[TrialTask, Any], progress: Progress) -> None:
        """Asks for trials by the batch and tries them, until there are as many as planned."""
        total, states = self._plan.settings.trials, self._optuna.trial.TrialState
        while True:
            first = self._study.user_attrs.get("0")
            if first is not None and first["metrics"] is None:
                raise ConfigError(
                    "the configuration that the search begins at can't be measured: "
                    f"{first['reason']}"
                )
            trials = self._study.get_trials(deepcopy=False)
            count = sum(trial.state != states.WAITING for trial in trials)
            running = [trial.number for trial in trials if trial.state == states.RUNNING]
            # A batch that a stopped run had begun is finished before the next one is asked for.
            end = self._batch_end(min(running, default=count))
            if count >= total and not running:
                return
            if not trials:
                start = {v.path: int(v.start) if v.whole else v.start for v in self._plan.variables}
                self._study.enqueue_trial(start)
            self._try(
                [*running, *(self._ask(number) for number in range(count, end))], pool, progress
            )

    def finished(self) -> list[Any]:
        """Optuna's trials that have a score, in their order."""
        complete = (self._optuna.trial.TrialState.COMPLETE,)
        return list(self._study.get_trials(deepcopy=False, states=complete))

    def metrics(self, number: int) -> Sequence[Mapping[str, Any]]:
        """Figures of a trial, one mapping for each recording."""
        figures: Sequence[Mapping[str, Any]] = self._study.user_attrs[str(number)]["metrics"]
        return figures

    def values(self, trial: Any) -> dict[str, float | int]:
        """Path of a setting -> value of a trial."""
        if trial.number == 0:  # to the last digit where the search begins
            return dict(trial.params)
        return {v.path: v.rounded(trial.params[v.path]) for v in self._plan.variables}

    @property
    def count(self) -> int:
        """Trials with a result."""
        return sum(trial.state.is_finished() for trial in self._study.get_trials(deepcopy=False))

    def _batch_end(self, count: int) -> int:
        total = self._plan.settings.trials
        if count == 0:
            return 1
        spread = 1 + round(SPREAD * total)
        if count < spread:
            return min(spread, total)
        return min(spread + BATCH * ((count - spread) // BATCH + 1), total)

    def _ask(self, number: int) -> int:
        samplers, seed = self._optuna.samplers, self._plan.settings.seed
        if number <= round(SPREAD * self._plan.settings.trials):
            self._study.sampler = samplers.QMCSampler(scramble=True, seed=seed)
        else:  # a seed for each trial: a search that goes on proposes what one without a stop does
            self._study.sampler = samplers.TPESampler(
                n_startup_trials=0, multivariate=True, constant_liar=True, seed=seed + number
            )
        return int(
            self._study.ask({v.path: self._distribution(v) for v in self._plan.variables}).number
        )

    def _distribution(self, v: Any) -> Any:
        kinds = self._optuna.distributions
        if v.whole:
            return kinds.IntDistribution(math.ceil(v.low), math.floor(v.high), log=v.log)
        return kinds.FloatDistribution(v.low, v.high, log=v.log)

    def _try(
        self, numbers: Sequence[int], pool: PersistentPool[TrialTask, Any], progress: Progress
    ) -> None:
        trials = self._study.get_trials(deepcopy=False)
        tasks = [self._task(self.values(trials[number])) for number in numbers]
        for result in pool.run(tasks):
            number = numbers[result.index]
            outcome = {"metrics": result.value, "reason": result.error}
            self._study.set_user_attr(str(number), json.loads(to_json(outcome)))
            if result.value is None:
                self._study.tell(number, state=self._optuna.trial.TrialState.FAIL)
            else:
                start = result.value if number == 0 else self.metrics(0)
                self._study.tell(number, self._plan.scoring.score(result.value, start))
            self.fresh += 1
            scores = [trial.value for trial in self.finished()]
            progress(self.count, min(scores, default=math.inf), result.error)

    def _task(self, values: Mapping[str, float | int]) -> TrialTask:
        plan = self._plan
        return TrialTask(
            tuple(source.request for source in plan.sources),
            tuple(source.digest for source in plan.sources),
            plan.settings.hand,
            plan.config,
            values,
            plan.settings.seed,
        )


def _write(plan: Tuning, search: _Search) -> Tuned:
    """Writes the preset and the figures."""
    best = min(search.finished(), key=lambda trial: trial.value)
    values, score = search.values(best), float(best.value)
    start, figures = search.metrics(0), search.metrics(best.number)
    folder = plan.settings.output
    origin = {
        "by": f"{PROGRAM} {COMMAND}",
        "hand": plan.settings.hand,
        "trials": search.count,
        "score": score,
        "tuned_on": [source.name for source in plan.sources],
        "tuned_on_frames": [source.digest for source in plan.sources],
        "held_out": [source.name for source in plan.held_out],
    }
    preset = PresetFile(plan.settings.method, plan.base, {**plan.changed, **values}, origin)
    write_preset_file(folder / PRESET, preset)
    names = [source.name for source in plan.sources]
    result = {
        "score": score,
        "values": values,
        "varied": plan.variables,
        "scoring": {"weights": plan.scoring.weights, "bounds": plan.scoring.bounds},
        "recordings": {
            name: {"start": _figures(first), "best": _figures(last)}
            for name, first, last in zip(names, start, figures, strict=True)
        },
        "made": origin,
    }
    write_json(folder / RESULT, result, indent=1)
    return Tuned(values, score, start, figures, search.count, search.fresh, folder / PRESET)


def _figures(metrics: Mapping[str, Any]) -> dict[str, float | None]:
    return {name: figure(metrics, name) for name in FIGURES}


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
