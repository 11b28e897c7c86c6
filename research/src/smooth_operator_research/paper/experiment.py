"""An experiment and its result."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, field, replace
from functools import cached_property
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Final, Protocol, TypeAlias

import numpy as np

from smooth_operator.atomic_files import atomic_write, output_error, write_json
from smooth_operator.baselines.slsqp_method import DEXPILOT
from smooth_operator.cli.outputs import check_folder as check_benchmark_folder
from smooth_operator.errors import DocumentError, UnknownNameError, counted
from smooth_operator.formats.environment import environment
from smooth_operator.io.plain_files import check_plain_file
from smooth_operator.parallel import TaskResult
from smooth_operator.planning import PROGRAM
from smooth_operator.result_cache import (
    Job,
    Note,
    ResultCache,
    compute_results,
    find_results,
    key_digest,
    no_note,
)
from smooth_operator.retargeting.sbr.published import ObjectiveConfig
from smooth_operator_benchmark.recordings import Source, load_sources, parse_request
from smooth_operator_research.code import research_digest
from smooth_operator_research.paper.compared_solvers import Solver
from smooth_operator_research.paper.runs import Problem, Run, make_problems, run_solver
from smooth_operator_research.paper.verdicts import Verdict


class ArrayCache(ResultCache):
    """Store of results as ``.npz`` files; each result is a mapping from names to arrays."""

    suffix: ClassVar[str] = ".npz"

    def _read(self, path: Path) -> tuple[Mapping[str, Any], dict[str, np.ndarray]]:
        check_plain_file(path)
        with np.load(path, allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
        if "key" not in arrays:
            raise DocumentError("it has no key")
        key = arrays.pop("key")
        return {"key": str(key), "code": str(arrays.pop("code"))}, arrays

    def _write(
        self, path: Path, record: Mapping[str, str], value: Mapping[str, np.ndarray]
    ) -> None:
        content: dict[str, Any] = {**value, **{k: np.array(v) for k, v in record.items()}}
        with atomic_write(path) as file:
            np.savez(file, **content)


@dataclass(frozen=True)
class Size:
    """Size of an experiment: amount of computing.

    Attributes:
        name: name of the size.
        recordings: requests for the built-in operator, if no recordings are given.
        frames: largest number of frames of each recording, for the solvers.
        seeds: runs of each random solver on each recording.
        samples: N of Algorithm 1.
        cycles: L of Algorithm 1.
        rmsprop_starts, slsqp_starts, newton_starts: N of the batched forms.
        steps: candidate learning rates for the tuning of RMSProp [rad].
        finals: candidate ratios of its last learning rate to the first.
        sigmas: candidate initial deviations for the tuning of Algorithm 1 [rad].
        tuning_frames: number of frames of another operator that are used for tuning.
        grid_samples: N of the grid N x L.
        grid_cycles: L of the grid.
        grid_budget: cells with a larger N x L are left out.
        grid_frames: largest number of frames of each recording, for the grid.
        fk_batches: batch sizes of forward kinematics.
        fk_rounds: rounds of its timing.
        table_frames: largest number of frames of each recording, for the table.
        latency_frames: number of these frames on which latency is measured.
        noise_frames: largest number of frames of each recording, for ``noise``.
        noises: standard deviations of a coordinate of a landmark [m].
        losses: fractions of the frames that never arrive.
        tracker_seeds: seeds of the tracker's noise and losses on each recording.
        rates: frame rates [Hz].
        rate_seconds: longest part of each recording, for ``rate`` [s].
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
    fk_batches: tuple[int, ...]
    fk_rounds: int
    table_frames: int
    latency_frames: int
    noise_frames: int
    noises: tuple[float, ...]
    losses: tuple[float, ...]
    tracker_seeds: int
    rates: tuple[float, ...]
    rate_seconds: float


def trial_note(size: Size) -> str:
    """Warning before the results of a size that is too small for conclusions."""
    return "" if size.name != "quick" else _TRIAL


_TRIAL: Final = "A trial run, far below the published sizes: do not use it to judge a claim."

PUBLISHED_STARTS: Final = 32768
"""N of the paper's batched forms."""

_SHARES: Final = (0.8192, 0.6710, 0.5497)
"""Points that fill a cube evenly for any count (Roberts's R sequence)."""


def synthetic_operators(count: int, frames: int) -> tuple[str, ...]:
    """Requests for several built-in operators, with different hands and motions.

    Each has its own seed (bone proportions, timing, amplitudes), a hand of 16 to 21 cm, a
    tempo of 0.8 to 1.3, and a different part of the sequence of gestures.

    Args:
        frames: number of frames of each.
    """
    names = []
    for seed in range(count):
        length, tempo, part = ((share * (seed + 1)) % 1.0 for share in _SHARES)
        first = 100 + 10 * round(part * (1900 - frames - 100) / 10)
        names.append(
            f"synthetic:{seed}@{16 + 5 * length:.1f}cm,{0.8 + 0.5 * tempo:.2f}x,"
            f"{first}:{first + frames}"
        )
    return tuple(names)


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
    fk_batches=(1, 4, 16, 64, 256, 1024, 4096, 16384, 65536),
    fk_rounds=7,
    table_frames=300,
    latency_frames=100,
    noise_frames=80,
    noises=(0.0, 0.5e-3, 1e-3, 5e-3),
    losses=(0.0, 0.2),
    tracker_seeds=1,
    rates=(15.0, 30.0, 100.0),
    rate_seconds=2.0,
)
"""Size for two cores; twenty independent operators are enough to show an effect's direction."""

QUICK: Final = replace(
    DEFAULT,
    name="quick",
    recordings=synthetic_operators(4, 100),
    frames=25,
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
    fk_batches=(1, 64, 1024),
    fk_rounds=3,
    table_frames=60,
    latency_frames=20,
    noise_frames=40,
    noises=(0.0, 2e-3),
    rates=(30.0, 100.0),
    rate_seconds=1.0,
)
"""Size for a test run; its figures are not meaningful."""

PUBLISHED: Final = replace(
    DEFAULT,
    name="published",
    recordings=synthetic_operators(20, 500),
    frames=500,
    samples=PUBLISHED_STARTS,
    rmsprop_starts=PUBLISHED_STARTS,
    slsqp_starts=64,  # NLopt runs one start after the other, whatever the machine
    newton_starts=PUBLISHED_STARTS // 32,
    tuning_frames=100,
    grid_samples=(*DEFAULT.grid_samples, 32768),
    grid_cycles=(*DEFAULT.grid_cycles, 320),
    grid_budget=655_360,
    grid_frames=500,
    table_frames=500,
    noise_frames=200,
    noises=(0.0, 0.5e-3, 1e-3, 2e-3, 5e-3),
    losses=(0.0, 0.05, 0.1, 0.2),
    rates=(15.0, 30.0, 60.0, 100.0, 200.0),
    rate_seconds=5.0,
)
"""Size for an accelerator: published N for sampling and RMSProp, smaller N for SLSQP and Newton."""


COMMAND: Final = "ablate"
CELLS: Final = "cells"
CONFIG: Final = "config.json"
RESULTS: Final = "results.json"


def check_folder(folder: Path) -> None:
    """Checks that experiments can be written into a folder, without writing."""
    check_benchmark_folder(folder, COMMAND, "earlier experiments")


class ExperimentFolder:
    """Folder of the results of experiments.

    Args:
        folder: created if missing.
        note: called with a message about cells that can't be used.

    Attributes:
        cells: store of the computed cells.
        environment: versions and machine.
    """

    def __init__(self, folder: Path, settings: Mapping[str, Any], note: Note = no_note) -> None:
        self.folder = folder
        self.environment = environment()
        check_folder(folder)
        self.cells = ArrayCache(folder / CELLS, note)
        config = {"program": PROGRAM, "command": COMMAND, "settings": dict(settings)}
        write_json(
            folder / CONFIG, config | self.environment | {"code": experiment_code()}, indent=2
        )

    @property
    def machine(self) -> dict[str, Any]:
        """Facts that affect measured times: processor, cores and device."""
        return {key: self.environment[key] for key in ("cpu", "cpu_cores", "device")}

    def experiment_folder(self, name: str) -> Path:
        """Folder of an experiment's results; created if missing."""
        path = self.folder / name
        try:
            path.mkdir(exist_ok=True)
        except OSError as error:
            raise output_error(path, error) from error
        return path


def experiment_code() -> str:
    """Digest of the code and the models that a cell depends on."""
    return research_digest(
        "hands",
        "retargeting",
        "baselines",
        "paper/compared_solvers.py",
        "paper/nlopt_slsqp.py",
        "paper/solver_grid.py",
        "paper/runs.py",
    )


if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, eq=False)
class Drawing:
    """A figure.

    Attributes:
        name: name of its files, ``NAME.png`` and ``NAME.svg``.
        caption: text that explains the figure.
        figure: matplotlib's figure.
    """

    name: str
    caption: str
    figure: Figure


@dataclass(frozen=True)
class Table:
    """Table of text; its first column has the names of the rows.

    Attributes:
        title: title above the table.
        headers: headings of the columns.
        rows: cells.
        note: text below the table.
    """

    title: str
    headers: Sequence[str]
    rows: Sequence[Sequence[str]]
    note: str = ""


@dataclass(frozen=True, eq=False)
class Outcome:
    """The outcome of an experiment.

    Attributes:
        setup: one paragraph on method, data and size.
        verdicts: one for each claim.
        tables: tables of the results.
        drawings: plots of the results.
        figures: all numbers, as JSON values.
    """

    setup: str
    verdicts: Sequence[Verdict]
    tables: Sequence[Table]
    drawings: Sequence[Drawing]
    figures: Mapping[str, Any] = field(default_factory=dict)


class Experiment(Protocol):
    """One of the paper's experiments.

    A class without arguments, named in ``EXPERIMENTS``.
    """

    title: str
    """Heading of its section."""

    claim: str
    """The paper's claim, in one line."""

    def run(self, context: ExperimentContext) -> Outcome:
        """Computes what is missing, and returns the outcome."""


EXPERIMENTS: Final[dict[str, tuple[str, str]]] = {
    "fk": ("fk", "FkLibraries"),
    "compute": ("compute", "Compute"),
    "solver": ("solver", "SolverSwap"),
    "velocity": ("solver", "VelocityTerm"),
    "hessian": ("hessian", "HessianDirections"),
    "table": ("table", "BenchmarkTable"),
    "noise": ("sweeps", "TrackerNoise"),
    "rate": ("sweeps", "FrameRate"),
}
"""Name -> module of this package and class in it, in the order of the report. A new experiment
needs a file and a line here."""


def experiment(name: str) -> Experiment:
    """Finds an experiment by its name."""
    if name not in EXPERIMENTS:
        raise UnknownNameError("experiment", name, EXPERIMENTS)
    module, kind = EXPERIMENTS[name]
    result: Experiment = getattr(import_module(f"smooth_operator_research.paper.{module}"), kind)()
    return result


TUNING_OPERATOR: Final = 1001
"""Seed of the built-in operator whose frames are used only for tuning."""

Advance: TypeAlias = Callable[[str, float], None]
"""Function of the current work and of the amount of work done since the last call."""

Track: TypeAlias = Callable[[str, float], AbstractContextManager[Advance]]
"""Opens the display of a phase from its name and its approximate amount of work [ms]."""


def recordings_of(units: Sequence[str]) -> str:
    """Number of recordings, and of independent ones among them."""
    alone = len(set(units))
    own = counted(len(units), "recording")
    return own if alone == len(units) else f"{own} ({alone} independent)"


@contextmanager
def silent(name: str, work: float) -> Iterator[Advance]:
    """A display that shows nothing."""
    yield lambda label, done: None


Compute: TypeAlias = Callable[[Callable[[float], None]], dict[str, np.ndarray]]
"""Computes the arrays of a cell; its argument is a function to call with the fraction done."""


def cell_job(
    label: str, key: Mapping[str, Any], effort: float, compute: Compute, code: str = ""
) -> Job[Compute]:
    """Job of a cell, unless the cell is stored already.

    Args:
        key: everything except code that the cell depends on; the file name begins with ``kind``.
        effort: approximate duration [ms]; only the proportions matter.
        compute: computes the cell.
        code: digest of code that it depends on in addition to ``experiment_code``.
    """
    name = f"{key['kind']}-{key_digest(key)[:20]}"
    return Job(name, key, f"{experiment_code()} {code}".strip(), compute, label, effort)


@dataclass(frozen=True, eq=False)
class ExperimentContext:
    """The recordings, the size, the store and the display.

    Attributes:
        sources: the recordings on which methods are judged.
        hand: name of the robot hand.
        size: amount of computing.
        store: folder of the results.
        track: shows the progress.
    """

    sources: Sequence[Source]
    hand: str
    size: Size
    store: ExperimentFolder
    track: Track = silent

    @property
    def recordings(self) -> str:
        """Number of judged recordings, and of independent ones among them."""
        return recordings_of([source.request.unit for source in self.sources])

    @property
    def unit_of(self) -> dict[str, str]:
        """Name of a recording -> its independent unit."""
        return {source.name: source.request.unit for source in self.sources}

    def finish(self, phase: str, jobs: Sequence[Job[Compute]]) -> list[dict[str, np.ndarray]]:
        """Computes the missing cells, and stores each as soon as it is complete."""
        cache = self.store.cells
        once = {job.name: job for job in jobs}  # the same cell may be asked for twice
        results, missing = find_results(list(once.values()), cache)
        if missing:
            with self.track(phase, sum(job.effort for job in missing)) as advance:
                results += compute_results(missing, cache, lambda _: _computed(missing, advance))
        arrays: dict[str, Any] = {result.job.name: result.value for result in results}
        return [arrays[job.name] for job in jobs]

    def problems(self, config: ObjectiveConfig, frames: int) -> list[Problem]:
        """The recordings as problems."""
        return make_problems(self.sources, self.hand, config, frames)

    @cached_property
    def judged(self) -> list[Problem]:
        """DexPilot's loss on the recordings, for the experiments that change the solver."""
        return self.problems(DEXPILOT.objective, self.size.frames)

    @cached_property
    def tuning(self) -> Problem:
        """DexPilot's loss on frames that are used only for tuning."""
        digests = {source.digest for source in self.sources}
        side = self.sources[0].side
        for seed in range(TUNING_OPERATOR, TUNING_OPERATOR + 1 + len(digests)):
            # from the middle of the round: pinches, and open fingers
            frames = f"600:{600 + self.size.tuning_frames}"
            (source,) = load_sources([parse_request(f"synthetic:{seed}@{frames}", side=side)])
            if source.digest not in digests:
                break
        (problem,) = make_problems([source], self.hand, DEXPILOT.objective, self.size.tuning_frames)
        return problem

    def run_job(
        self, problem: Problem, solver: Solver, velocity_weight: float, seed: int = 0
    ) -> Job[Compute]:
        """Job that runs a solver on a problem."""
        seed = seed if solver.random else 0

        def compute(advance: Callable[[float], None]) -> dict[str, np.ndarray]:
            return run_solver(problem, solver, velocity_weight, seed, advance).arrays()

        term = f", w_v {velocity_weight:g}" if velocity_weight else ""
        more = f", seed {seed}" if solver.random else ""
        return cell_job(
            f"{solver.label} on {problem.name}{term}{more}",
            {
                "kind": f"run-{solver.family}",
                "problem": problem.digest,
                "solver": [type(solver).__name__, solver],
                "velocity_weight": velocity_weight,
                "seed": seed,
            },
            solver.effort * len(problem) + 2000.0,
            compute,
        )

    def run_all(self, phase: str, jobs: Sequence[Job[Compute]]) -> list[Run]:
        """Runs the jobs; returns their runs."""
        return [Run.of(cell) for cell in self.finish(phase, jobs)]


def _computed(
    jobs: Sequence[Job[Compute]], advance: Advance
) -> Iterator[TaskResult[dict[str, np.ndarray]]]:
    """Computes the cells one after another in this process; errors of a job are not caught."""
    for index, job in enumerate(jobs):
        label = f"{index + 1} of {len(jobs)}: {job.label}"
        advance(label, 0.0)
        arrays = job.task(lambda share, job=job, label=label: advance(label, share * job.effort))  # type: ignore[misc]
        yield TaskResult(index, arrays, None, 0.0, 1)
