"""Preset ``paper`` on JAX's default device against the same algorithm written plainly.

    python research/benchmarks/gpu.py                    # on a GPU
    python research/benchmarks/gpu.py --samples 1024     # on a CPU, where the plain version is slow

The plain version is what one writes first: Algorithm 1 as a ``lax.scan``, normals from
``jax.random.normal``, ``mjx.kinematics`` under ``vmap``, a full ``argsort`` for the elite. It
shares alignment and targets with the package, so that both answer the same question.
Needs MJX: ``python -m pip install mujoco-mjx``.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import tyro
from timing import percentiles

from smooth_operator import Hand, HandFrame, Retargeter, SmoothOperatorError
from smooth_operator.errors import ConfigError
from smooth_operator.human.alignment import palm_alignment
from smooth_operator.methods.sbr import SbrConfig
from smooth_operator.objective.keyvectors import KeyvectorLayout
from smooth_operator.synthetic import SyntheticOperator
from smooth_operator_research.run_report import BenchmarkError, Report

try:
    from mujoco import mjx
except ImportError:
    mjx = None

BLOCK = 10


@dataclass(frozen=True)
class Settings:
    """What to run.

    Attributes:
        samples: N of Algorithm 1; the preset's 8192 unless given.
        cycles: L; the preset's 20 unless given.
        frames: how many frames.
        hand: built-in robot hand.
        output: JSON file; build/benchmarks/gpu.json unless given.
        compare: an earlier JSON file to compare this run with.
    """

    samples: int = 8192
    cycles: int = 20
    frames: int = 200
    hand: str = "mimic_p050"
    output: Path | None = None
    compare: Path | None = None


Step = Callable[[Any, HandFrame], tuple[Any, np.ndarray, float]]
"""state, frame -> next state, all joint positions [rad], tracking loss."""


def main(settings: Settings) -> None:
    report = Report("gpu", vars(settings))
    ours = Retargeter(settings.hand, method="sbr", preset="paper")
    if not isinstance(ours.config, SbrConfig):
        raise ConfigError(f"preset 'paper' must be an SbrConfig, not {type(ours.config).__name__}")
    sampling = replace(ours.config.sampling, samples=settings.samples, cycles=settings.cycles)
    config = replace(ours.config, sampling=sampling)
    ours = Retargeter(ours.hand, config=config)
    frames = list(SyntheticOperator().record(settings.frames / 100 + 0.1))[: settings.frames]

    steps: dict[str, tuple[Any, Step]] = {"ours": (ours.init(), wrap(ours))}
    if mjx is None:
        report.notes.append("plain version: not measured; it needs `pip install mujoco-mjx`")
    else:
        steps["plain"] = plain(ours.hand, config)
    runs = interleave(steps, frames)

    rows, medians = [], {}
    for name, (_, losses, latency) in runs.items():
        p = percentiles(latency)
        medians[name] = p["p50_ms"]
        loss = float(losses.mean())
        report.add(name, p | {"tracking_loss": loss})
        rows.append([name, *p.values(), loss])
    header = ("program", "p50 [ms]", "p95 [ms]", "p99 [ms]", "max [ms]", "tracking loss")
    report.table(
        f"Algorithm 1, N = {settings.samples}, L = {settings.cycles}, landmarks to command",
        header,
        rows,
    )
    if "plain" in medians:
        ratio = medians["plain"] / medians["ours"]
        apart = float(np.abs(runs["plain"][0] - runs["ours"][0]).mean())
        report.figures |= {"plain_over_ours": ratio, "mean_difference_rad": apart}
        report.notes.append(
            f"the plain version takes {ratio:.1f} times as long; its commands differ from ours by "
            f"{apart:.4f} rad on average (other random numbers)"
        )
    if jax.devices()[0].platform != "cpu":
        against_cpu(report, ours.hand, config, frames[:50], runs["ours"][0])
    report.finish(settings.output, settings.compare)


def interleave(
    steps: dict[str, tuple[Any, Step]], frames: list[HandFrame]
) -> dict[str, tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """name -> joint positions (T, n), tracking losses (T,), latencies (T,) [ms]."""
    states: dict[str, Any] = {}
    found: dict[str, tuple[list[Any], list[Any], list[Any]]] = {}
    for name, (state, step) in steps.items():
        states[name], found[name] = state, ([], [], [])
        for frame in frames[:5]:  # warm-up
            state, _, _ = step(state, frame)
    for turn, start in enumerate(range(0, len(frames), BLOCK)):
        for name in list(steps) if turn % 2 == 0 else list(reversed(steps)):
            step = steps[name][1]
            for frame in frames[start : start + BLOCK]:
                before = time.perf_counter()
                states[name], q, loss = step(states[name], frame)
                latency = (time.perf_counter() - before) * 1e3
                for values, value in zip(found[name], (q, loss, latency), strict=True):
                    values.append(value)
    return {name: tuple(np.array(v) for v in values) for name, values in found.items()}  # type: ignore[misc]


def wrap(retargeter: Retargeter) -> Step:
    def step(state: Any, frame: HandFrame) -> tuple[Any, np.ndarray, float]:
        state, result = retargeter.step(state, frame)
        return state, result.command.positions, result.tracking_loss

    return step


def plain(hand: Hand, config: SbrConfig) -> tuple[Any, Step]:
    """Algorithm 1 without any of our tricks: first state, and the step."""
    model = mjx.put_model(hand.model)
    data = mjx.make_data(model)
    points = [hand.spec.wrist, *(finger.tip for finger in hand.spec.fingers)]
    points = [p.mirrored for p in points] if hand.spec.mirror else points
    bodies = np.array([hand.model.body(p.body).id for p in points])
    offsets = np.array([p.offset for p in points], np.float32)
    palm = hand.model.body(hand.spec.palm).id

    layout = KeyvectorLayout(hand.fingers)
    start, end = (np.array(side) for side in zip(*layout.pairs, strict=True))
    matrix, offset = (
        jnp.asarray(part, jnp.float32) for part in (hand.coupling_matrix, hand.coupling_offset)
    )
    low, high = (jnp.asarray(hand.limits[:, i], jnp.float32) for i in (0, 1))
    neutral = jnp.asarray(hand.neutral, jnp.float32)
    sampling, objective = config.sampling, config.objective
    size, beta = len(hand.limits), objective.transition

    def keyvectors(q: jax.Array) -> jax.Array:
        moved = mjx.kinematics(model, data.replace(qpos=matrix @ q + offset))
        world = moved.xpos[bodies] + jnp.einsum("fij,fj->fi", moved.xmat[bodies], offsets)
        at_palm = (world - moved.xpos[palm]) @ moved.xmat[palm]
        vectors: jax.Array = at_palm[end] - at_palm[start]
        return vectors

    def tracking(q: jax.Array, vectors: jax.Array, weights: jax.Array) -> jax.Array:
        error = jnp.abs(keyvectors(q) - vectors)
        near = 0.5 * error**2 / beta
        return (weights[:, None] * jnp.where(error < beta, near, error - 0.5 * beta)).sum()

    @jax.jit
    def program(state: Any, landmarks: jax.Array) -> tuple[Any, jax.Array, jax.Array]:
        q, held, key = state
        aligned = palm_alignment(landmarks, hand, config.alignment).apply(landmarks)
        goal, held = objective.targets(held, layout, layout.human(aligned))

        def cost(u: jax.Array) -> jax.Array:
            pull = objective.pose_weight * ((u - neutral) ** 2).sum()
            drag = objective.velocity_weight * ((u - q) ** 2).sum()
            total: jax.Array = tracking(u, goal.vectors, goal.weights) + pull + drag
            return total

        def cycle(carry: Any, key: jax.Array) -> tuple[Any, None]:
            mean, cov = carry
            normals = jax.random.normal(key, (sampling.samples, size))
            u = jnp.clip(mean + normals @ jnp.linalg.cholesky(cov).T, low, high)
            costs = jax.vmap(cost)(u)
            best = jnp.argsort(costs)[: sampling.elites]
            elite, least = u[best], costs[best]
            weight = jax.nn.softmax(-(least - least.min()) / sampling.temperature)
            mean = weight @ elite
            spread = elite - mean
            cov = (weight[:, None] * spread).T @ spread + sampling.jitter * jnp.eye(size)
            return (mean, cov), None

        key, now = jax.random.split(key)
        first = q, (sampling.sigma**2 + sampling.jitter) * jnp.eye(size)
        # as ours, without the last draw, which changes nothing
        (mean, _), _ = jax.lax.scan(cycle, first, jax.random.split(now, sampling.cycles - 1))
        q = jnp.clip(mean, low, high)
        return (q, held, key), q, tracking(q, goal.vectors, goal.weights)

    def step(state: Any, frame: HandFrame) -> tuple[Any, np.ndarray, float]:
        state, q, loss = program(state, frame.landmarks.astype(np.float32))
        return state, hand.full_configuration(np.asarray(q, float)), float(loss)

    return (neutral, objective.targets.init(layout), jax.random.key(0)), step


def against_cpu(
    report: Report, hand: Hand, config: SbrConfig, frames: list[HandFrame], commands: np.ndarray
) -> None:
    """The same frames on this machine's CPU: the random numbers are the same on every device."""
    with jax.default_device(jax.devices("cpu")[0]):
        retargeter = Retargeter(hand, config=config)
        state, found = retargeter.init(), []
        for frame in frames:
            state, result = retargeter.step(state, frame)
            found.append(result.command.positions)
    apart = np.abs(np.array(found) - commands[: len(frames)])
    report.figures["from_cpu_mean_rad"] = float(apart.mean())
    report.figures["from_cpu_max_rad"] = float(apart.max())
    report.notes.append(
        f"commands differ from those of the CPU by {apart.mean():.1e} rad on average, "
        f"{apart.max():.1e} rad at most, over {len(frames)} frames"
    )


if __name__ == "__main__":
    try:
        main(tyro.cli(Settings, description=__doc__))
    except SmoothOperatorError as error:
        raise BenchmarkError(str(error)) from error
