"""Success of policies by the retargeter of their demonstrations: record, train, evaluate.

    python research/benchmarks/policy_loop.py                                          # all of it
    python research/benchmarks/policy_loop.py --demonstrations 10 --steps 200 --worlds 5 --seeds 1

For each task and method demonstrations are recorded as a LeRobot data set until there are enough of
score 1: an operator performs one motion that was found by search, without looking, in perturbed
worlds (as ``bench --physics demonstrations``). LeRobot's ACT, small enough for a processor, is
trained on it by ``lerobot-train`` with several seeds. Each policy is evaluated in the same
worlds of the environment ``smooth_hand``, which begins an episode in the mean start pose of the
demonstrations. What is finished in the output folder is kept, so that a run that was stopped goes
on where it was; another size needs another folder.

Success is a score of 1. Intervals (95 %) are bootstraps, of worlds for the operator, of seeds and
worlds, crossed, for policies, and at least as wide as Wilson's for as many worlds. With one seed
they are of the worlds alone.
Needs ``lerobot[training,evaluation]`` and packages/lerobot_env_smooth_hand on Python 3.12 or later.
"""

from __future__ import annotations

import itertools
import json
import multiprocessing
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import tyro

from smooth_operator import load_hand
from smooth_operator.benchmark.cells import select_methods
from smooth_operator.hands.hand import Hand
from smooth_operator.retargeting.retargeter import Retargeter
from smooth_operator.simulation.scenes import scene_for
from smooth_operator.simulation.scenes.scene import object_pose
from smooth_operator.simulation.tasks import task_named
from smooth_operator_research.demonstrations.demonstration import (
    DemonstrationLandmarks,
    load_demonstration,
)
from smooth_operator_research.demonstrations.perturbation import (
    PerturbedLandmarks,
    draw_perturbation,
)
from smooth_operator_research.demonstrations.trial_loop import TrialTrace, run_trial
from smooth_operator_research.physics.demonstrations import STAYS_S
from smooth_operator_research.physics.results import wilson
from smooth_operator_research.run_report import BenchmarkError, Report
from smooth_operator_research.virtual_operator.trial import LOOKS_HZ

FPS = 25
"""Rate of tracker frames, commands and rows [Hz]; it divides the rate of looks at the scene."""
POLICY = {
    "type": "act",
    "dim_model": 128,
    "n_heads": 4,
    "dim_feedforward": 512,
    "n_encoder_layers": 2,
    "chunk_size": 25,
    "n_action_steps": 10,
    "use_vae": "true",
    "latent_dim": 8,
    "n_vae_encoder_layers": 2,
    "optimizer_lr": 3e-4,
    "device": "cpu",
    "push_to_hub": "false",
}
ALONE = {"HF_HUB_OFFLINE": "1", "OMP_NUM_THREADS": "1"}  # trainings run side by side
RESAMPLES = 5000


@dataclass(frozen=True)
class Settings:
    """Settings of a run.

    Attributes:
        tasks: card, cube, screwdriver.
        methods: METHOD or METHOD:PRESET; the others are compared with the first.
        hand: name of the robot hand.
        demonstrations: kept for each task and method.
        most_trials: after which a method's demonstrations are what there are.
        steps: steps of each training.
        batch: rows of each step.
        seeds: trainings of each data set.
        worlds: in which each policy is evaluated.
        seconds: longest episode of an evaluation [s].
        workers: processes.
        output: folder of data sets, policies and results.
    """

    tasks: tuple[str, ...] = ("card", "cube")
    methods: tuple[str, ...] = ("smooth", "sbr:paper", "dexpilot:published", "geort")
    hand: str = "mimic_p050"
    demonstrations: int = 100
    most_trials: int = 400
    steps: int = 3000
    batch: int = 32
    seeds: int = 3
    worlds: int = 100
    seconds: float = 15.0
    workers: int = 2
    output: Path = Path("build") / "policy_loop"


# --- demonstrations ------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Trial:
    """A trial of an operator.

    Attributes:
        success: score 1.
        seconds: from 'go' to its end [s].
        state: (t, m) measured positions of the actuated joints [rad].
        environment: (t, 7) position [m] and quaternion of the object.
        action: (t, m) positions commanded then [rad].
    """

    success: bool
    seconds: float
    state: np.ndarray
    environment: np.ndarray
    action: np.ndarray


@lru_cache(maxsize=1)
def retargeter(hand: str, method: str) -> Retargeter:
    (choice,) = select_methods((method,))
    return Retargeter(load_hand(hand), config=choice.config)


def trial_in_world(task: str, hand: str, method: str, number: int) -> Trial:
    """Runs a searched motion through the retargeter in a perturbed world."""
    demonstration = load_demonstration(task, hand)
    landmarks = DemonstrationLandmarks(demonstration)
    world = draw_perturbation(number + 1)
    done = run_trial(
        retargeter(hand, method),
        world.scene(scene_for(task, demonstration.robot)),
        task_named(task),
        PerturbedLandmarks(landmarks, world),
        rate_hz=LOOKS_HZ,
        seconds=landmarks.seconds + STAYS_S,
        seed=0,
        prepare=world.prepare,
        trace=True,
    )
    success = done.score == 1.0 and done.diverged == 0
    return sampled(demonstration.robot, success, done.seconds, done.trace)


def sampled(hand: Hand, success: bool, seconds: float, trace: TrialTrace | None) -> Trial:
    """Samples a trial at ``FPS``: the measurement before each command, and the command."""
    assert trace is not None
    every, actuated = round(LOOKS_HZ / FPS), list(hand.actuated)
    rows = np.arange(every, len(trace.commands), every)
    start = trace.states[0].quaternion
    objects = [trace.states[k - 1] for k in rows]
    return Trial(
        success,
        seconds,
        trace.positions[rows - 1][:, actuated],
        np.array([object_pose(s.position, s.quaternion, start) for s in objects]),
        trace.commands[rows][:, actuated],
    )


def trials_in_worlds(
    settings: Settings, pool: ProcessPoolExecutor, task: str, method: str
) -> Iterator[Trial]:
    """Yields trials in consecutive worlds."""
    running: list[Future[Trial]] = []
    try:
        for number in itertools.count():
            running.append(pool.submit(trial_in_world, task, settings.hand, method, number))
            if len(running) == settings.workers:
                yield running.pop(0).result()
    finally:
        for future in running:
            future.cancel()


def record(settings: Settings, pool: ProcessPoolExecutor, task: str, method: str) -> dict[str, Any]:
    """Records demonstrations as a data set in ``FOLDER/data``; returns a summary of the trials."""
    from lerobot.datasets import LeRobotDataset
    from lerobot_env_smooth_hand.environment import OBJECT_NAMES

    folder = cell_folder(settings, task, method)
    summary = folder / "trials.json"
    if summary.exists():
        return dict(json.loads(summary.read_text()))
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    hand: Hand = load_hand(settings.hand)
    joints = [f"{name}.pos" for name in hand.actuated_names]

    def numbers(names: list[str]) -> dict[str, Any]:
        return {"dtype": "float32", "shape": (len(names),), "names": names}

    dataset = LeRobotDataset.create(
        f"policy_loop/{folder.name}",
        FPS,
        root=folder / "data",
        robot_type="smooth_hand",
        use_videos=False,
        features={
            "observation.state": numbers(joints),
            "observation.environment_state": numbers(list(OBJECT_NAMES)),
            "action": numbers(joints),
        },
    )
    instruction = task_named(task).task.instruction
    successes: list[int] = []
    lengths: list[int] = []
    starts: list[np.ndarray] = []
    for trial in trials_in_worlds(settings, pool, task, method):
        successes.append(int(trial.success))
        if trial.success:
            for state, environment, action in zip(
                trial.state, trial.environment, trial.action, strict=True
            ):
                dataset.add_frame(
                    {
                        "observation.state": state.astype(np.float32),
                        "observation.environment_state": environment.astype(np.float32),
                        "action": action.astype(np.float32),
                        "task": instruction,
                    }
                )
            dataset.save_episode()
            lengths.append(len(trial.action))
            starts.append(trial.state[0])
        tried = len(successes)
        if tried % 10 == 0:
            print(f"{task}, {method}: {tried} trials, {len(lengths)} successes", flush=True)
        if len(lengths) >= settings.demonstrations or tried >= settings.most_trials:
            break
    dataset.finalize()
    result = {
        "successes": successes,
        "frames": lengths,
        "start": np.mean(starts, axis=0).tolist() if starts else None,
    }
    summary.write_text(json.dumps(result))
    return result


# --- policies ------------------------------------------------------------------------------------


def train(settings: Settings, task: str, method: str, seed: int) -> Path:
    """Trains a policy with ``lerobot-train``; returns the folder of its weights."""
    folder = cell_folder(settings, task, method)
    run = folder / f"seed-{seed}"
    model = run / "checkpoints" / "last" / "pretrained_model"
    if model.exists():
        return model
    shutil.rmtree(run, ignore_errors=True)
    options = {
        "dataset.repo_id": f"policy_loop/{folder.name}",
        "dataset.root": folder / "data",
        "output_dir": run,
        "steps": settings.steps,
        "save_freq": settings.steps,
        "batch_size": settings.batch,
        "num_workers": 0,
        "seed": seed,
        "env_eval_freq": 0,
        "log_freq": max(1, settings.steps // 10),
        "wandb.enable": "false",
        **{f"policy.{name}": value for name, value in POLICY.items()},
    }
    with (folder / f"train-{seed}.log").open("w") as log:
        done = subprocess.run(
            [
                sys.executable,
                "-m",
                "lerobot.scripts.lerobot_train",
                *(f"--{name}={value}" for name, value in options.items()),
            ],
            stdout=log,
            stderr=subprocess.STDOUT,
            env={**os.environ, **ALONE},
        )
    if done.returncode:
        raise BenchmarkError(f"lerobot-train failed; its output is in {log.name}")
    return model


def evaluate(settings: Settings, task: str, model: Path, start: list[float]) -> list[float]:
    """Evaluates a policy in the worlds with LeRobot's own evaluation; returns the scores."""
    scores = model.parents[2] / "scores.json"
    if scores.exists():
        return list(json.loads(scores.read_text()))
    import torch
    from lerobot.configs import PreTrainedConfig
    from lerobot.envs.factory import make_env
    from lerobot.policies.factory import make_policy, make_pre_post_processors
    from lerobot.processor import PolicyProcessorPipeline
    from lerobot.scripts.lerobot_eval import eval_policy
    from lerobot_env_smooth_hand.config_smooth_hand import SmoothHandEnv

    torch.set_num_threads(1)
    env = SmoothHandEnv(
        task=task, hand=settings.hand, fps=FPS, seconds=settings.seconds, start=start
    )
    config = PreTrainedConfig.from_pretrained(model)
    config.pretrained_path = model
    policy = make_policy(config, env_cfg=env)
    before, after = make_pre_post_processors(config, pretrained_path=str(model))
    ((worlds,),) = (suite.values() for suite in make_env(env, n_envs=1).values())
    nothing: Any = PolicyProcessorPipeline(steps=[])
    with torch.no_grad():
        result = eval_policy(
            worlds, policy, nothing, nothing, before, after, settings.worlds, start_seed=0
        )
    worlds.close()
    rewards = [float(episode["sum_reward"]) for episode in result["per_episode"]]
    scores.write_text(json.dumps(rewards))
    return rewards


def policy_scores(
    settings: Settings, task: str, method: str, seed: int, start: list[float]
) -> list[float]:
    return evaluate(settings, task, train(settings, task, method, seed), start)


# --- tables --------------------------------------------------------------------------------------


def interval(draws: np.ndarray, share: float, units: int) -> tuple[float, float]:
    """Interval of a share: the wider ends of the bootstrap's and of Wilson's for the units.

    Where all units agree the bootstrap alone has no width.
    """
    low, high = wilson(share * units, units)
    return min(low, float(np.percentile(draws, 2.5))), max(high, float(np.percentile(draws, 97.5)))


def interval_of_difference(
    draws: np.ndarray, first: tuple[float, float, float], second: tuple[float, float, float]
) -> tuple[float, float]:
    """Interval of second minus first, each a share with its interval: likewise, with Newcombe's."""
    (p, p_low, p_high), (q, q_low, q_high) = first, second
    low = q - p - float(np.hypot(q - q_low, p_high - p))
    high = q - p + float(np.hypot(q_high - q, p - p_low))
    return min(low, float(np.percentile(draws, 2.5))), max(high, float(np.percentile(draws, 97.5)))


def share_of_worlds(successes: list[int]) -> tuple[float, float, float]:
    """Share of successful trials, with its interval over worlds."""
    draws, share = resampled(np.array([successes], float)), float(np.mean(successes))
    return share, *interval(draws, share, len(successes))


def resampled(success: np.ndarray) -> np.ndarray:
    """Bootstrap means (RESAMPLES,) over seeds and worlds; all methods share the drawn worlds."""
    rng = np.random.default_rng(0)
    seeds, worlds = success.shape
    rows = rng.integers(seeds, size=(RESAMPLES, seeds, 1))
    columns = rng.integers(worlds, size=(RESAMPLES, 1, worlds))
    return np.asarray(success[rows, columns].mean(axis=(1, 2)))


def percent(value: float, low: float, high: float, sign: str = "") -> str:
    return f"{100 * value:{sign}.0f} ({100 * low:{sign}.0f} to {100 * high:{sign}.0f})"


def cell_folder(settings: Settings, task: str, method: str) -> Path:
    return settings.output / f"{settings.hand}-{task}-{method.replace(':', '_')}"


def main(settings: Settings) -> None:
    if settings.demonstrations < 1 or settings.seeds < 1 or settings.worlds < 1:
        raise BenchmarkError("demonstrations, seeds and worlds must be 1 or more")
    report = Report("policy_loop", {**vars(settings), "output": str(settings.output)})
    times = dict.fromkeys(("record", "train and evaluate"), 0.0)
    rows: list[list[object]] = []
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(settings.workers, mp_context=context) as pool:
        for task in settings.tasks:
            first: tuple[np.ndarray, tuple[float, float, float]] | None = None
            for method in settings.methods:
                clock = time.perf_counter()
                trials = record(settings, pool, task, method)
                times["record"] += time.perf_counter() - clock
                frames, key = trials["frames"], f"{task}/{method}"
                operators = share_of_worlds(trials["successes"])
                report.add(key, {"operator_success": operators[0], "demonstrations": len(frames)})
                row: list[object] = [
                    task,
                    method,
                    len(trials["successes"]),
                    percent(*operators),
                    len(frames),
                    f"{np.median(frames) / FPS:.1f}" if frames else "",
                    "",
                    "",
                    "",
                ]
                rows.append(row)
                if not frames:
                    continue
                clock = time.perf_counter()
                futures = [
                    pool.submit(policy_scores, settings, task, method, seed, trials["start"])
                    for seed in range(settings.seeds)
                ]
                scores = np.array([future.result() for future in futures])
                times["train and evaluate"] += time.perf_counter() - clock
                success = (scores == 1.0).astype(float)
                draws, share = resampled(success), float(success.mean())
                whole = (share, *interval(draws, share, settings.worlds))
                row[6] = percent(*whole)
                row[7] = f"{scores.mean():.2f}"
                report.add(key, {"success": share, "score": scores.mean()})
                if method == settings.methods[0]:
                    first = draws, whole
                elif first is not None:
                    apart = interval_of_difference(draws - first[0], first[1], whole)
                    row[8] = percent(share - first[1][0], *apart, "+")
                print(f"{key}: success {row[6]} %", flush=True)
    report.table(
        "Policies by the retargeter of their demonstrations",
        (
            "task",
            "method",
            "trials",
            "operators' success [%]",
            "demonstrations",
            "median [s]",
            "policy's success [%]",
            "score",
            f"minus {settings.methods[0]} [%]",
        ),
        rows,
    )
    report.notes.append(
        f"ACT {POLICY['dim_model']} wide, {settings.steps} steps of {settings.batch}, "
        f"{settings.seeds} seeds, {settings.worlds} worlds, episodes of at most "
        f"{settings.seconds:g} s at {FPS} Hz; seconds spent: "
        + ", ".join(f"{name} {value:.0f}" for name, value in times.items())
    )
    report.finish(settings.output / "policy_loop.json", None)


if __name__ == "__main__":
    main(tyro.cli(Settings))
