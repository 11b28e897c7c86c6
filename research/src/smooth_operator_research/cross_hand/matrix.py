"""The cross-hand matrix: tasks, hands and methods over worlds, from one human demonstration each.

The demonstration of a world is the same for every hand and method. It is retargeted to each hand,
replayed open loop in physics, and scored by the task's rubric.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Final

from smooth_operator.errors import ConfigError, UnknownNameError
from smooth_operator.parallel import run_tasks
from smooth_operator.reporter import Reporter
from smooth_operator.result_cache import key_digest
from smooth_operator.simulation.scenes import SCENES
from smooth_operator.simulation.tasks import FIXED_WRIST
from smooth_operator.simulation.tasks import TASKS as SIMULATED_TASKS
from smooth_operator.source_digest import HOME
from smooth_operator.synthetic.tracker import tracker_model
from smooth_operator_benchmark.cells import hand_identity, select_hands, select_methods
from smooth_operator_research.code import research_digest
from smooth_operator_research.cross_hand.plans import PLANS
from smooth_operator_research.cross_hand.results import Cell, MatrixResults
from smooth_operator_research.cross_hand.scenes import SCALED
from smooth_operator_research.cross_hand.trials import CEILING, Block, method_of, run_block
from smooth_operator_research.demonstrations.demonstration import (
    DEFAULT_HAND,
    demonstrated_hands,
)

TASKS: Final = (*FIXED_WRIST, *PLANS)
"""Tasks of the matrix; those with a moving wrist can also be scaled."""

HANDS: Final = (
    "ability_hand",
    "allegro_hand",
    "brainco_revo2",
    "inspire_hand",
    "leap_hand",
    "linker_l20",
    "mimic_p050",
    "orca_v2",
    "schunk_svh",
    "shadow_dexee",
    "shadow_hand",
    "sharpa_wave",
    "tesollo_dg5f",
    "unitree_dex3",
    "unitree_dex5",
    "wuji_hand",
    "xhand1",
)
"""Default hands: one or two of each maker, with three to five fingers and 6 to 22 motors."""

METHODS: Final = ("smooth:teleop", "sbr:paper", "dexpilot:published", "ako:published")
"""Default methods; the first one is compared with the others."""

TRACKERS: Final = ("glove", "headset", "camera")
"""Default trackers, which take turns: world n is seen by tracker n modulo 3."""

_BLOCK: Final = 24
"""Largest number of trials that a worker does between two updates of the file."""


@dataclass(frozen=True, kw_only=True)
class MatrixSettings:
    """Size of a run.

    Attributes:
        tasks: names of tasks.
        scaled: True to scale the tasks with a moving wrist by the length of each robot hand, and
            to leave out the other tasks.
        hands: names of hands; ``all`` for all built-in hands.
        methods: methods in the form for ``select_methods``, then as ``METHOD:PRESET``.
        trackers: kinds of trackers, which take turns over the worlds.
        worlds: number of worlds, from world 0.
        workers: number of processes; None for one per core, 0 to work in this process.
        keep_older: True to keep results by other code instead of repeating these trials.
    """

    tasks: tuple[str, ...] = TASKS
    hands: tuple[str, ...] = HANDS
    methods: tuple[str, ...] = METHODS
    trackers: tuple[str, ...] = TRACKERS
    worlds: int = 12
    workers: int | None = None
    keep_older: bool = False
    scaled: bool = False

    def __post_init__(self) -> None:
        for task in self.tasks:
            if task not in TASKS:
                raise UnknownNameError("task of the matrix", task, TASKS)
        if self.scaled:
            scaled = tuple(f"{task}{SCALED}" for task in self.tasks if task in PLANS)
            if not scaled:
                raise ConfigError(f"only these tasks can be scaled: {', '.join(PLANS)}")
            object.__setattr__(self, "tasks", scaled)
        if not self.tasks or not self.trackers:
            raise ConfigError("name at least one task and one tracker")
        if self.worlds < 1:
            raise ConfigError(f"the number of worlds must be 1 or more, not {self.worlds}")
        for tracker in self.trackers:
            tracker_model(tracker)
        methods = tuple(f"{one.method}:{one.preset}" for one in select_methods(self.methods))
        object.__setattr__(self, "hands", select_hands(self.hands))
        object.__setattr__(self, "methods", methods)


def tracker_of(world: int, trackers: Sequence[str] = TRACKERS) -> str:
    """Tracker that sees the human of a world."""
    return trackers[world % len(trackers)]


def plan_blocks(settings: MatrixSettings, results: MatrixResults) -> list[Block]:
    """Plans the trials that have no valid result yet, world by world within each block."""
    blocks = []
    for hand in settings.hands:
        for method in (CEILING, *settings.methods):
            for task in settings.tasks:
                demonstrated = demonstrated_hands(task) if task in FIXED_WRIST else ()
                if method == CEILING and hand not in demonstrated:
                    continue
                todo = []
                for tracker in [""] if method == CEILING else dict.fromkeys(settings.trackers):
                    cell = Cell(task, hand, method, tracker)
                    worlds = [
                        world
                        for world in range(settings.worlds)
                        if not tracker or tracker_of(world, settings.trackers) == tracker
                    ]
                    code = trial_code(task, hand, method)
                    left = results.missing(cell, code, worlds, keep_older=settings.keep_older)
                    todo += [(world, tracker) for world in left]
                todo.sort()
                blocks += [
                    Block(task, hand, method, tuple(todo[k : k + _BLOCK]))
                    for k in range(0, len(todo), _BLOCK)
                ]
    return blocks


def run_matrix(settings: MatrixSettings, path: Path, reporter: Reporter | None = None) -> list[str]:
    """Runs the missing trials, and writes the file after each block.

    A stopped run loses only the blocks that were running.

    Args:
        path: file of the results.

    Returns:
        a line for each block that failed, with the reason.

    Raises:
        DocumentError, OutputError: the file can't be read or written.
    """
    reporter = Reporter() if reporter is None else reporter
    results = MatrixResults(path)
    blocks = plan_blocks(settings, results)
    failures = []
    total = sum(len(block.worlds) for block in blocks)
    with reporter.counting("cross-hand", total, "trials") as advance:
        for outcome in run_tasks(run_block, blocks, workers=settings.workers):
            block = blocks[outcome.index]
            label = f"{block.hand}, {block.task}, {block.method}"
            if outcome.value is None:
                failures.append(f"{label}: {outcome.error}")
            else:
                code = trial_code(block.task, block.hand, block.method)
                for tracker, row in outcome.value.items():
                    results.add(block.cell(tracker), code, row)
                results.write()
            advance(len(block.worlds), label=label, reason=outcome.error)
    return failures


_TRIAL_CODE: Final = (
    *("cross_hand/trials.py", "cross_hand/fixed_wrist.py", "demonstrations/trial_loop.py"),
    *("demonstrations/demonstration.py", "demonstrations/perturbation.py"),
    *("simulation/physics.py", "simulation/scenes/scene.py", "simulation/scenes/physics.py"),
    *("simulation/tasks/task.py", "simulation/tasks/trial.py"),
    *("synthetic/tracker.py", "synthetic/robot_landmarks.py"),
    *("geometry.py", "landmarks.py", "poses.py", "types.py"),
)
"""Files of every trial, here or in ``smooth_operator``."""

_MOVING_WRIST_CODE: Final = (
    *(
        "cross_hand/human.py",
        "cross_hand/plans.py",
        "cross_hand/replay.py",
        "cross_hand/scenes.py",
        "simulation/scenes/table_scene.py",
    ),
    *("simulation/arms/free_wrist.py", "simulation/arms/arm.py"),
    *("simulation/tasks/relocate.py", "synthetic/gestures.py", "synthetic/hand_anatomy.py"),
)
"""Files of a trial with a moving wrist, besides those of every trial."""


_RETARGETING: Final = HOME / "retargeting"

_SMOOTH_CODE: Final = {
    f"retargeting/{name}.py"
    for name in ("smooth", "smooth_terms", "correspondence", "fingertip_filter")
}
"""Files that only ``smooth`` uses."""


@cache
def trial_code(task: str, hand: str, method: str) -> str:
    """Digest of the code and data on which the trials of a cell depend: the simulation, the task,
    the description of the hand, the method with its settings, the demonstration.

    Other hands, tasks and methods are not in it, so that their changes leave a result valid.
    Versions of libraries are not in it either, so that another machine can continue a file.
    """
    name = task.removesuffix(SCALED)
    names = {*_TRIAL_CODE, _file_of(SCENES[name]), _file_of(SIMULATED_TASKS[name].scorer)}
    if task not in FIXED_WRIST:
        names |= {*_MOVING_WRIST_CODE, _file_of(PLANS[name])}
    names |= {f"hands/{path.name}" for path in (HOME / "hands").glob("*.py")}
    names.add(f"demonstrations/data/{hand if method == CEILING else DEFAULT_HAND}")
    config = None if method == CEILING else method_of(method)
    if config is not None:
        files = {
            f"retargeting/{path.relative_to(_RETARGETING).as_posix()}"
            for path in _RETARGETING.rglob("*.py")
        }
        names |= files if method.startswith("smooth:") else files - _SMOOTH_CODE
        if ".baselines." in type(config).__module__:
            names.add("baselines")
    code = research_digest(*sorted(names))
    return key_digest([code, hand_identity(hand, "right", ()), config])[:12]


def _file_of(part: Callable[..., Any]) -> str:
    """File of a function or class of either package, relative to the package."""
    return part.__module__.partition(".")[2].replace(".", "/") + ".py"
