"""Input of every experiment: the recordings, the size, and cells that are done already."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final, TypeAlias

import numpy as np

from smooth_operator.baselines.slsqp_presets import DEXPILOT_PUBLISHED
from smooth_operator.lab.benchmark.recordings import Source, load_sources, parse_request
from smooth_operator.objective.loss import ObjectiveConfig
from smooth_operator.parallel import TaskResult
from smooth_operator.result_cache import Job, compute_results, content_name, find_results
from smooth_operator_research.paper.compared_solvers import Solver
from smooth_operator_research.paper.experiment_folder import ExperimentFolder, experiment_code
from smooth_operator_research.paper.problems import Problem, make_problems
from smooth_operator_research.paper.runs import Run, run_solver
from smooth_operator_research.paper.sizes import Size

TUNING_OPERATOR: Final = 1001
"""Seed of the built-in operator whose frames are tuned on, and never judged."""

Advance: TypeAlias = Callable[[str, float], None]
"""Called with what is being done and how much of the work was done since the last call."""

Track: TypeAlias = Callable[[str, float], AbstractContextManager[Advance]]
"""Opens the display of a phase: its name, and how much work it is [ms, about]."""


def counted(count: int, noun: str) -> str:
    """A number with its noun."""
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"


def recordings_of(units: Sequence[str]) -> str:
    """How many recordings there are, and how many of them are independent."""
    alone = len(set(units))
    own = counted(len(units), "recording")
    return own if alone == len(units) else f"{own} ({alone} independent)"


@contextmanager
def silent(name: str, work: float) -> Iterator[Advance]:
    """A display that shows nothing."""
    yield lambda label, done: None


Compute: TypeAlias = Callable[[Callable[[float], None]], dict[str, np.ndarray]]
"""Makes the arrays of a cell; is given what it calls with the share that was done."""


def cell_job(
    label: str, key: Mapping[str, Any], effort: float, compute: Compute, code: str = ""
) -> Job[Compute]:
    """A cell to be computed, unless it is there already.

    Args:
        label: for a person.
        key: what its content depends on, but for code; its ``kind`` begins the name of the file.
        effort: about how long it takes [ms]; only the proportions matter.
        compute: makes it.
        code: digest of code that it depends on beyond ``experiment_code``.
    """
    name = content_name(key["kind"], key)
    return Job(name, key, f"{experiment_code()} {code}".strip(), compute, label, effort)


@dataclass(frozen=True, eq=False)
class ExperimentContext:
    """The recordings, the size, the store and the display.

    Attributes:
        sources: the recordings that are judged.
        hand: name of the robot hand.
        size: how much is computed.
        store: the folder.
        track: shows the progress.
    """

    sources: Sequence[Source]
    hand: str
    size: Size
    store: ExperimentFolder
    track: Track = silent

    @property
    def recordings(self) -> str:
        """How many recordings are judged, and how many of them are independent."""
        return recordings_of([source.request.unit for source in self.sources])

    @property
    def unit_of(self) -> dict[str, str]:
        """Name of a recording -> the independent unit that it belongs to."""
        return {source.name: source.request.unit for source in self.sources}

    def finish(self, phase: str, jobs: Sequence[Job[Compute]]) -> list[dict[str, np.ndarray]]:
        """Computes the cells that are missing, and keeps each as soon as it is whole.

        Raises:
            OutputError: a cell can't be written.
        """
        cache = self.store.cells
        once = {job.name: job for job in jobs}  # the same cell may be asked for twice
        found, missing = find_results(list(once.values()), cache)
        if missing:
            with self.track(phase, sum(job.effort for job in missing)) as advance:
                found += compute_results(missing, cache, lambda _: _computed(missing, advance))
        arrays: dict[str, Any] = {result.job.name: result.value for result in found}
        return [arrays[job.name] for job in jobs]

    def problems(self, config: ObjectiveConfig, frames: int) -> list[Problem]:
        """The recordings as problems.

        Raises:
            RecordingError: a recording has too few usable frames.
        """
        return make_problems(self.sources, self.hand, config, frames)

    @cached_property
    def judged(self) -> list[Problem]:
        """DexPilot's loss on the recordings, for the experiments that change the solver."""
        return self.problems(DEXPILOT_PUBLISHED.objective, self.size.frames)

    @cached_property
    def tuning(self) -> Problem:
        """DexPilot's loss on frames that are not judged."""
        taken = {source.digest for source in self.sources}
        side = self.sources[0].side
        for seed in range(TUNING_OPERATOR, TUNING_OPERATOR + 1 + len(taken)):
            # from the middle of the round: pinches, and open fingers
            frames = f"600:{600 + self.size.tuning_frames}"
            (source,) = load_sources([parse_request(f"synthetic:{seed}@{frames}", side=side)])
            if source.digest not in taken:
                break
        (problem,) = make_problems(
            [source], self.hand, DEXPILOT_PUBLISHED.objective, self.size.tuning_frames
        )
        return problem

    def run_job(
        self, problem: Problem, solver: Solver, velocity_weight: float, seed: int = 0
    ) -> Job[Compute]:
        """A solver on a problem, as a cell."""
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
        """Those cells as runs."""
        return [Run.of(cell) for cell in self.finish(phase, jobs)]


def _computed(
    jobs: Sequence[Job[Compute]], advance: Advance
) -> Iterator[TaskResult[dict[str, np.ndarray]]]:
    """The cells one after the other, in this process; what a job raises is not caught."""
    for index, job in enumerate(jobs):
        label = f"{index + 1} of {len(jobs)}: {job.label}"
        advance(label, 0.0)
        arrays = job.task(lambda share, job=job, label=label: advance(label, share * job.effort))  # type: ignore[misc]
        yield TaskResult(index, arrays, None, 0.0, 1)
