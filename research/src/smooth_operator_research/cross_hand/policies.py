"""Success of policies whose demonstrations come from the same human recordings.

    python -m smooth_operator_research.cross_hand.policies --task relocate --output build/policies
    python -m smooth_operator_research.cross_hand.policies --task card --output build/policies \
        --docs research/docs/policies.md

A human is recorded once in each training world. For each condition, a robot hand and a retargeter,
the recordings are retargeted and played open loop in the environment ``smooth_hand`` in the same
worlds; the successes become a LeRobot data set. LeRobot's ACT, small enough for a processor, is
trained on it with several seeds, and each policy is evaluated in other worlds, the same ones for
all. Each finished data set and policy is kept in the output folder, so that the same command
continues a stopped run; another size needs another folder. ``--docs`` writes the table of the
finished results into a page.

Intervals (95 %) of one policy are Wilson's over its worlds. Intervals of a
condition are Student's t over its training seeds, and at least as wide as Wilson's for as many
worlds as one policy is evaluated in, because all seeds share these worlds.

It needs ``lerobot[core-scripts,training,evaluation]`` and ``packages/lerobot_env_smooth_hand`` on
Python 3.12 or later.
"""

from __future__ import annotations

import itertools
import json
import math
import shutil
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from jaxtyping import Float

from smooth_operator import poses
from smooth_operator.atomic_files import atomic_write
from smooth_operator.hands.registry import load_hand
from smooth_operator.retargeting.start import start_jax
from smooth_operator_research.cross_hand.human import HumanDemonstration
from smooth_operator_research.cross_hand.replay import STAYS_S, wrist_path
from smooth_operator_research.cross_hand.scenes import scene_of
from smooth_operator_research.cross_hand.trials import record, retarget
from smooth_operator_research.paper.docs_tables import replaced
from smooth_operator_research.paper.intervals import independent, mean_of
from smooth_operator_research.physics.results import wilson
from smooth_operator_research.run_report import (
    BenchmarkError,
    markdown,
    run_program,
)

FPS: Final = 25
"""Rate of observations and actions [Hz]."""

FIRST_TRAINING_WORLD: Final = 2000
"""World of the first recording; the human was tuned in the worlds from 1000."""

FIRST_TEST_WORLD: Final = 100
"""First world of an evaluation; the training was tuned in the worlds 0 to 9."""

POLICY: Final[dict[str, Any]] = {
    "dim_model": 128,
    "n_heads": 4,
    "dim_feedforward": 512,
    "n_encoder_layers": 2,
    "chunk_size": 25,
    "n_action_steps": 1,
    "temporal_ensemble_coeff": 0.01,
    "use_vae": False,
    "dropout": 0.0,
    "optimizer_lr": 5e-4,
}
"""Settings of ACT that differ from LeRobot's defaults, which are those of its paper (Zhao et al.,
"Learning Fine-Grained Bimanual Manipulation with Low-Cost Hardware", RSS 2023). For scripted
demonstrations the variational encoder made almost no difference there. On a processor it doubles
the time of a step, and dropout adds half."""

TOGETHER: Final = 10
"""Worlds that are evaluated side by side in one process."""

FEWEST: Final = 3
"""Fewest demonstrations with which a policy is trained."""

SIZE: Final = ("tracker", "recordings", "steps", "batch", "worlds", "seconds")
"""Settings that all results in a folder share."""


@dataclass(frozen=True, kw_only=True)
class Settings:
    """Settings of a run.

    Attributes:
        task: name of the task.
        conditions: HAND/METHOD or HAND/METHOD:PRESET; the others are compared with the first.
        tracker: tracker that records the human: glove, headset or camera.
        recordings: human recordings, one in each training world, the same for all conditions.
        steps: steps of each training.
        batch: frames of each step.
        seeds: trainings of each condition.
        worlds: worlds in which each policy is evaluated.
        seconds: longest episode [s].
        output: folder of data sets, policies and results.
        docs: page that receives the table instead of a run.
    """

    task: str = "relocate"
    conditions: tuple[str, ...] = (
        "mimic_p050/smooth",
        "mimic_p050/sbr:paper",
        "mimic_p050/dexpilot:published",
        "mimic_p050/ako:published",
        "wuji_hand/smooth",
    )
    tracker: str = "headset"
    recordings: int = 50
    steps: int = 3000
    batch: int = 16
    seeds: int = 3
    worlds: int = 100
    seconds: float = 10.0
    output: Path = Path("build") / "policies"
    docs: Path | None = None


class Condition(NamedTuple):
    """A robot hand and a retargeter."""

    hand: str
    method: str

    def folder(self, settings: Settings) -> Path:
        """Folder of the data set and the policies."""
        return settings.output / settings.task / f"{self.hand}-{self.method.replace(':', '-')}"


def condition_named(name: str) -> Condition:
    """Reads HAND/METHOD; BenchmarkError if it is something else."""
    hand, slash, method = name.partition("/")
    if not (hand and slash and method):
        raise BenchmarkError(f"a condition is HAND/METHOD, not {name!r}")
    return Condition(hand, method)


# --- demonstrations ------------------------------------------------------------------------------


class Episode(NamedTuple):
    """An episode in the environment.

    Attributes:
        success: True for a score of 1.
        observations: observation before each action, by name in the data set.
        actions: (t, a) actions.
    """

    success: bool
    observations: list[dict[str, np.ndarray]]
    actions: Float[np.ndarray, "t a"]


def derive_actions(
    task: str, condition: Condition, worlds: Sequence[int], tracker: str
) -> list[Float[np.ndarray, "t a"]]:
    """Retargets a human recording of each world to actions of the environment.

    Returns:
        for each world (t, a) actions at ``FPS``: positions of the actuated joints [rad]; with a
        moving wrist also its position [m] and rotation vector [rad] relative to its start.
    """
    hand = load_hand(condition.hand)
    demonstrations = [record(task, world, tracker) for world in worlds]
    retargeted = retarget(hand, condition.method, demonstrations, tracker)
    actions = []
    for demonstration, commands in zip(demonstrations, retargeted, strict=True):
        targets = commands.joint_positions[:, list(hand.actuated)]
        if isinstance(demonstration, HumanDemonstration):
            scene = demonstration.variation.scene(scene_of(task, hand))
            path = wrist_path(hand, demonstration, commands.joint_positions, scene)
            apart = poses.relative(scene.mount.wrist_pose, path)
            vectors = poses.rotation_vectors(apart[:, 3:])
            targets = np.concatenate([targets, apart[:, :3], vectors], axis=1)
        at = np.arange(int(commands.stamps[-1] * FPS) + 1) / FPS
        columns = [np.interp(at, commands.stamps, column) for column in targets.T]
        actions.append(np.stack(columns, axis=1))
    return actions


def play(environment: Any, actions: Float[np.ndarray, "t a"], world: int) -> Episode:
    """Plays actions open loop in a world of the environment, and holds the last one for
    ``STAYS_S``."""
    seen, _ = environment.reset(seed=world)
    observations, info = [], {"is_success": False}
    held = np.repeat(actions[-1:], round(STAYS_S * FPS), axis=0)
    played = np.concatenate([actions, held]).astype(np.float32)
    for action in played:
        observations.append(seen)
        seen, _, terminated, truncated, info = environment.step(action)
        if terminated or truncated:
            break
    return Episode(info["is_success"], observations, played[: len(observations)])


def make_demonstrations(settings: Settings, condition: Condition) -> dict[str, Any]:
    """Plays the recordings on a hand, and writes the successes as a LeRobot data set.

    Returns:
        ``successes`` of the recordings in order, ``frames`` of each demonstration, and ``start``,
        the actuated joints at the start of every episode [rad].
    """
    folder = condition.folder(settings)
    summary = folder / "demonstrations.json"
    if summary.exists():
        return dict(json.loads(summary.read_text()))
    from lerobot.datasets import LeRobotDataset
    from lerobot_env_smooth_hand import HandTask

    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    began = time.process_time()
    worlds = range(FIRST_TRAINING_WORLD, FIRST_TRAINING_WORLD + settings.recordings)
    actions = derive_actions(settings.task, condition, worlds, settings.tracker)
    start = actions[0][0, : len(load_hand(condition.hand).actuated)].tolist()
    config = _environment_config(settings, condition, start)
    environment = HandTask(settings.task, **config.gym_kwargs)
    dataset = LeRobotDataset.create(
        f"policies/{folder.name}",
        FPS,
        root=folder / "data",
        robot_type="smooth_hand",
        use_videos=False,
        features={
            config.features_map[name]: {"dtype": "float32", "shape": feature.shape, "names": None}
            for name, feature in config.features.items()
        },
    )
    episodes = [play(environment, *each) for each in zip(actions, worlds, strict=True)]
    environment.close()
    for episode in episodes:
        if not episode.success:
            continue
        for observation, action in zip(episode.observations, episode.actions, strict=True):
            named = {config.features_map[name]: value for name, value in observation.items()}
            instruction = environment.task_description
            dataset.add_frame({**named, "action": action, "task": instruction})
        dataset.save_episode()
    dataset.finalize()
    result = {
        "successes": [int(episode.success) for episode in episodes],
        "frames": [len(episode.actions) for episode in episodes if episode.success],
        "start": start,
        "seconds": time.process_time() - began,
    }
    _write(summary, result)
    return result


def _environment_config(settings: Settings, condition: Condition, start: list[float]) -> Any:
    """LeRobot's settings of the environment."""
    from lerobot_env_smooth_hand import SmoothHandEnv

    return SmoothHandEnv(
        task=settings.task, hand=condition.hand, fps=FPS, seconds=settings.seconds, start=start
    )


def _write(path: Path, content: Mapping[str, Any]) -> None:
    with atomic_write(path) as file:
        file.write(json.dumps(content).encode())


# --- policies ------------------------------------------------------------------------------------


def train(settings: Settings, folder: Path, seed: int) -> tuple[Any, Any, Any, float]:
    """Trains LeRobot's ACT on the data set of a folder.

    Returns:
        the policy, the processors before and after it, and the mean loss of the last tenth of the
        steps.
    """
    import torch
    from lerobot.configs import NormalizationMode
    from lerobot.datasets import LeRobotDataset
    from lerobot.policies.act.configuration_act import ACTConfig
    from lerobot.policies.factory import make_policy, make_pre_post_processors
    from lerobot.utils.random_utils import set_seed

    set_seed(seed)
    dataset = LeRobotDataset(f"policies/{folder.name}", root=folder / "data")
    scaled = dict.fromkeys(("STATE", "ENV", "ACTION"), NormalizationMode.MEAN_STD)
    config = ACTConfig(**POLICY, device="cpu", push_to_hub=False, normalization_mapping=scaled)
    policy = make_policy(config, ds_meta=dataset.meta)
    before, after = make_pre_post_processors(config, dataset_stats=dataset.meta.stats)
    rows = dataset.hf_dataset.with_format("torch")[:]
    scaled_rows = before({name: rows[name] for name in (*config.input_features, "action")})
    actions = scaled_rows.pop("action")
    observations = {name: scaled_rows[name] for name in config.input_features}
    episode = rows["episode_index"]
    last = torch.searchsorted(episode, episode, right=True) - 1
    optimizer = torch.optim.AdamW(  # LeRobot's choice; fused, it takes a third of the time
        policy.get_optim_params(),
        lr=config.optimizer_lr,
        weight_decay=config.optimizer_weight_decay,
        fused=True,
    )
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, settings.steps)
    policy.train()
    losses = []
    for _ in range(settings.steps):
        chosen = torch.randint(len(actions), (settings.batch,))
        ahead = chosen[:, None] + torch.arange(config.chunk_size)
        end = last[chosen][:, None]
        loss, _ = policy(
            {name: values[chosen] for name, values in observations.items()}
            | {"action": actions[torch.minimum(ahead, end)], "action_is_pad": ahead > end}
        )
        optimizer.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(policy.parameters(), 10.0)  # LeRobot's default
        optimizer.step()
        schedule.step()
        losses.append(float(loss.detach()))
    tail = losses[-max(1, settings.steps // 10) :]
    return policy, before, after, float(np.mean(tail))


def evaluate(
    settings: Settings, condition: Condition, start: list[float], trained: Sequence[Any]
) -> list[float]:
    """Evaluates a policy in the test worlds with LeRobot's own evaluation; returns the scores."""
    import torch
    from lerobot.envs.factory import make_env
    from lerobot.processor import PolicyProcessorPipeline
    from lerobot.scripts.lerobot_eval import eval_policy

    policy, before, after = trained
    config = _environment_config(settings, condition, start)
    count = min(TOGETHER, settings.worlds)
    ((worlds,),) = (suite.values() for suite in make_env(config, n_envs=count).values())
    unchanged: Any = PolicyProcessorPipeline(steps=[])
    parts = worlds, policy, unchanged, unchanged, before, after
    with torch.no_grad():
        result = eval_policy(*parts, settings.worlds, start_seed=FIRST_TEST_WORLD)
    worlds.close()
    return [float(episode["max_reward"]) for episode in result["per_episode"]]


def measure_policy(settings: Settings, condition: Condition, start: list[float], seed: int) -> None:
    """Trains and evaluates a policy, and writes it and its scores, unless they are there."""
    folder = condition.folder(settings)
    result = folder / f"seed-{seed}.json"
    if result.exists():
        return
    began = time.process_time()
    policy, before, after, loss = train(settings, folder, seed)
    for part in (policy, before, after):
        part.save_pretrained(folder / f"policy-{seed}")
    trained = time.process_time()
    scores = evaluate(settings, condition, start, (policy, before, after))
    seconds = {"train": trained - began, "evaluate": time.process_time() - trained}
    _write(result, {"scores": scores, "loss": loss, "seconds": seconds})


# --- table ---------------------------------------------------------------------------------------


class Share(NamedTuple):
    """A share of successes with its 95 % interval."""

    value: float
    low: float
    high: float

    def percent(self, sign: str = "") -> str:
        """The share and its interval in percent; sign ``+`` for a difference."""
        value, low, high = (f"{100 * share:{sign}.0f}".replace("-", "−") for share in self)
        return f"{value} ({low} to {high})"


def share_of_worlds(successes: Sequence[float]) -> Share:
    """Share of successful worlds with Wilson's interval."""
    return Share(float(np.mean(successes)), *wilson(sum(successes), len(successes)))


def share_of_seeds(successes: Float[np.ndarray, "s w"]) -> Share:
    """Mean share of the training seeds: Student's t interval over the seeds, and at least Wilson's
    for the worlds of one seed."""
    mean = float(np.mean(successes))
    worlds = successes.shape[1]
    low, high = wilson(mean * worlds, worlds)
    seeds = mean_of(independent(successes.mean(axis=1).tolist()))
    if seeds.low is not None and seeds.high is not None:
        low, high = min(low, max(0.0, seeds.low)), max(high, min(1.0, seeds.high))
    return Share(mean, low, high)


def difference(first: Share, second: Share) -> Share:
    """Second minus first, with Newcombe's interval from both intervals (Newcombe 1998, method
    10)."""
    value = second.value - first.value
    low = math.hypot(second.value - second.low, first.high - first.value)
    high = math.hypot(second.high - second.value, first.value - first.low)
    return Share(value, value - low, value + high)


HEADER: Final = (
    "hand",
    "retargeter",
    "demonstrations of recordings (tries for one)",
    "median [s]",
    *(
        heading
        for figure in ("score 1 [%]", "score 0.5 or 1 [%]")
        for heading in (figure, "by seed", "minus the first row")
    ),
)


def table(settings: Settings) -> str:
    """Makes the Markdown table of the finished results."""
    rows: list[list[object]] = []
    first: dict[float, Share] = {}
    for name in settings.conditions:
        condition = condition_named(name)
        folder = condition.folder(settings)
        row: list[object] = [f"`{condition.hand}`", f"`{condition.method}`"]
        rows.append(row)
        summary = folder / "demonstrations.json"
        results = [folder / f"seed-{seed}.json" for seed in range(settings.seeds)]
        scores = np.array([json.loads(r.read_text())["scores"] for r in results if r.exists()])
        row += [*_demonstrations(summary), *["–"] * 6]
        if not len(scores):
            continue
        for column, least in ((4, 1.0), (7, 0.5)):
            success = (scores >= least).astype(float)
            whole = share_of_seeds(success)
            row[column] = whole.percent()
            row[column + 1] = ", ".join(share_of_worlds(own).percent() for own in success)
            if name == settings.conditions[0]:
                first[least] = whole
            elif least in first:
                row[column + 2] = difference(first[least], whole).percent("+")
    return markdown(HEADER, rows)


def _demonstrations(summary: Path) -> tuple[str, str]:
    """Number of the demonstrations of a condition, and their median length."""
    if not summary.exists():
        return "–", "–"
    trials = json.loads(summary.read_text())
    good, tried = sum(trials["successes"]), len(trials["successes"])
    if not good:
        return f"0 of {tried}", "–"
    return f"{good} of {tried} ({tried / good:.1f})", f"{np.median(trials['frames']) / FPS:.1f}"


def claim_folder(settings: Settings) -> None:
    """Notes the size of a run in its folder; BenchmarkError if the folder has results of another
    size."""
    path = settings.output / settings.task / "settings.json"
    size = {name: getattr(settings, name) for name in SIZE}
    if path.exists():
        earlier = json.loads(path.read_text())
        if earlier != size:
            raise BenchmarkError(f"{path.parent} has results of {earlier}: choose another --output")
        return
    path.parent.mkdir(parents=True, exist_ok=True)
    _write(path, size)


def main(settings: Settings) -> None:
    """Runs what is not finished yet, and prints the table; with ``docs`` only writes it there."""
    if settings.docs is not None:
        page = settings.docs.read_text(encoding="utf-8")
        name = f"policies-{settings.task}"
        block = f"<!-- table: {name} -->\n{table(settings)}\n<!-- end -->"
        settings.docs.write_text(replaced(page, name, block), encoding="utf-8")
        return
    if min(settings.recordings, settings.steps, settings.seeds, settings.worlds) < 1:
        raise BenchmarkError("recordings, steps, seeds and worlds must be 1 or more")
    import torch

    start_jax()
    torch.set_num_threads(1)
    claim_folder(settings)
    conditions = [condition_named(name) for name in settings.conditions]
    starts: dict[Condition, list[float]] = {}
    for condition in conditions:
        demonstrations = make_demonstrations(settings, condition)
        good, tried = sum(demonstrations["successes"]), len(demonstrations["successes"])
        print(f"{'/'.join(condition)}: {good} demonstrations of {tried} recordings", flush=True)
        if good >= FEWEST:
            starts[condition] = demonstrations["start"]
    # one seed of every condition before the next one: a stopped run leaves a table of all
    for seed, condition in itertools.product(range(settings.seeds), starts):
        measure_policy(settings, condition, starts[condition], seed)
        print(f"{'/'.join(condition)}, seed {seed}: finished", flush=True)
    print(table(settings))


if __name__ == "__main__":
    run_program(main, Settings, __doc__)
