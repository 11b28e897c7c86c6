"""Forward kinematics of many hands: the unrolled walk against MJX and MuJoCo.

    python benchmarks/kinematics.py --batches 1 64 1024 8192

All compute the fingertips from the positions of all joints; ``positions`` computes all landmarks.
Before anything is timed, all must agree with ``mujoco.mj_kinematics`` in float64.
MJX is optional: ``python -m pip install mujoco-mjx``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import tyro
from report import BenchmarkError, Report, interleaved, percentiles

from smooth_operator import Hand, SmoothOperatorError, load_hand

try:
    from mujoco import mjx
except ImportError:
    mjx = None

AGREEMENT = 1e-5  # [m]
LOOP_LIMIT = 8192  # a Python loop says nothing new beyond that

WALK, BOUNDED, POSITIONS = "walk", "walk within limits", "positions"
MJX, MUJOCO = "MJX", "MuJoCo C, loop"


@dataclass(frozen=True)
class Settings:
    """What to run.

    Attributes:
        batches: how many hands at once.
        seconds: about how long to time each batch size [s].
        hand: built-in robot hand.
        side: right or left.
        seed: of the random poses.
        output: JSON file; build/benchmarks/kinematics.json unless given.
        compare: an earlier JSON file to lay beside this run.
    """

    batches: tuple[int, ...] = (1, 16, 128, 1024, 2048, 8192)
    seconds: float = 5.0
    hand: str = "mimic_p050"
    side: str = "right"
    seed: int = 0
    output: Path | None = None
    compare: Path | None = None


@dataclass(frozen=True)
class Tips:
    """Where the fingertips are in the compiled MuJoCo model, in its world frame."""

    bodies: np.ndarray  # (F,)
    offsets: np.ndarray  # (F, 3) in the body's frame [m]
    palm: int

    @classmethod
    def of(cls, hand: Hand) -> Tips:
        tips = [f.tip.mirrored if hand.spec.mirror else f.tip for f in hand.spec.fingers]
        return cls(
            np.array([hand.model.body(tip.body).id for tip in tips]),
            np.array([tip.offset for tip in tips]),
            int(hand.model.body(hand.spec.palm).id),
        )


def main(settings: Settings) -> None:
    report = Report("kinematics", vars(settings))
    hand = load_hand(settings.hand, settings.side)
    tips = Tips.of(hand)
    bodies = programs(hand, tips)
    if mjx is None:
        report.notes.append("MJX: not measured; it needs `python -m pip install mujoco-mjx`")
    worst = check(hand, tips, bodies, np.random.default_rng(settings.seed))
    report.add("disagreement_m", worst)

    rows, ratios = [], []
    for batch in settings.batches:
        q = poses(hand, batch, np.random.default_rng(settings.seed))
        work = {name: ready(program, q) for name, program in bodies.items()}
        if batch <= LOOP_LIMIT:
            work[MUJOCO] = loop(hand.model, tips, q)
        times = interleaved(work, settings.seconds)
        medians = {}
        for name, samples in times.items():
            p = percentiles(samples)
            medians[name] = p["p50_ms"]
            report.add(f"{batch}/{name}", p)
            per_pose = p["p50_ms"] / batch * 1e6
            rows.append([batch, name, p["p50_ms"], p["p95_ms"], p["p99_ms"], per_pose])
        for name in (MJX, MUJOCO):
            if name in medians:
                speed = {ours: medians[name] / medians[ours] for ours in (WALK, BOUNDED, POSITIONS)}
                report.add(f"{batch}/{name} over", speed)
                ratios.append([batch, f"{name} / ours", *speed.values()])
    header = ("hands", "program", "p50 [ms]", "p95 [ms]", "p99 [ms]", "per hand [ns]")
    report.table("Forward kinematics, time per batch", header, rows)
    report.table(
        "How many times faster, by p50", ("hands", "ratio", WALK, BOUNDED, POSITIONS), ratios
    )
    report.notes.append(
        f"{WALK}: `tree.walk` to the fingertips, batch last; {BOUNDED}: the same, promised that "
        f"joints keep their limits, as the solver calls it; {POSITIONS}: the public "
        f"`tree.positions`, all {len(hand.tree.names)} landmarks, batch first. "
        f"{MJX}: `mjx.kinematics` under vmap and jit, fingertips. All in float32 but {MUJOCO}."
    )
    report.notes.append(
        "largest disagreement with `mj_kinematics` over 1,000 poses: "
        + ", ".join(f"{name} {1e6 * error:.2f} µm" for name, error in worst.items())
    )
    report.finish(settings.output, settings.compare)


Program = tuple[Callable[[jax.Array], jax.Array], bool]
"""A compiled function of joint positions, and whether the batch is its last axis."""


def programs(hand: Hand, tips: Tips) -> dict[str, Program]:
    """name -> program; all but ``positions`` give fingertips."""

    def walk(q: jax.Array, within_limits: bool) -> jax.Array:
        points = hand.tree.walk(list(q), hand.tip_names, within_limits=within_limits)
        return jnp.stack([jnp.broadcast_to(c, q.shape[1:]) for p in points for c in p])

    found: dict[str, Program] = {
        WALK: (jax.jit(lambda q: walk(q, False)), True),
        BOUNDED: (jax.jit(lambda q: walk(q, True)), True),
        POSITIONS: (jax.jit(hand.tree.positions), False),
    }
    if mjx is not None:
        model = mjx.put_model(hand.model)
        data = mjx.make_data(model)

        def one(q: jax.Array) -> jax.Array:
            moved = mjx.kinematics(model, data.replace(qpos=q))
            turned = jnp.einsum("fij,fj->fi", moved.xmat[tips.bodies], tips.offsets)
            world: jax.Array = moved.xpos[tips.bodies] + turned
            return world

        found[MJX] = (jax.jit(jax.vmap(one)), False)
    return found


def poses(hand: Hand, count: int, rng: np.random.Generator) -> np.ndarray:
    """(count, n) random positions of all joints [rad], couplings respected."""
    return hand.expand(rng.uniform(hand.limits[:, 0], hand.limits[:, 1], (count, len(hand.limits))))


def ready(program: Program, q: np.ndarray) -> Callable[[], object]:
    compiled, batch_last = program
    on_device = jnp.asarray(q.T if batch_last else q, jnp.float32)
    return lambda: compiled(on_device).block_until_ready()


def loop(model: mujoco.MjModel, tips: Tips, q: np.ndarray) -> Callable[[], object]:
    data = mujoco.MjData(model)
    qpos, xpos, xmat = data.qpos, data.xpos, data.xmat  # views: the loop pays for little but C
    points, matrices = np.empty((len(q), *xpos.shape)), np.empty((len(q), *xmat.shape))

    def run() -> np.ndarray:
        for i, pose in enumerate(q):
            qpos[:] = pose
            mujoco.mj_kinematics(model, data)
            points[i], matrices[i] = xpos, xmat
        turn = matrices[:, tips.bodies].reshape(len(q), -1, 3, 3)
        turned = np.einsum("nfij,fj->nfi", turn, tips.offsets)
        world: np.ndarray = points[:, tips.bodies] + turned
        return world

    return run


def check(
    hand: Hand, tips: Tips, bodies: dict[str, Program], rng: np.random.Generator
) -> dict[str, float]:
    """Largest distance of each program from MuJoCo's [m].

    Raises:
        BenchmarkError: if one is beyond AGREEMENT: what is wrong need not be timed.
    """
    q = poses(hand, 1000, rng)
    world = loop(hand.model, tips, q)()
    palm = mujoco.MjData(hand.model)
    mujoco.mj_kinematics(hand.model, palm)  # fixed to the world, so any pose will do
    rotation, origin = palm.xmat[tips.palm].reshape(3, 3), palm.xpos[tips.palm]
    truth = (np.asarray(world) - origin) @ rotation
    at = [hand.tree.names.index(name) for name in hand.tip_names]
    worst = {}
    for name, program in bodies.items():
        found = np.asarray(ready(program, q)(), float)
        if name == POSITIONS:
            found = found[:, at]
        elif name == MJX:
            found = (found - origin) @ rotation
        else:
            found = found.T.reshape(len(q), -1, 3)
        worst[name] = float(np.linalg.norm(found - truth, axis=-1).max())
        if not worst[name] < AGREEMENT:
            raise BenchmarkError(
                f"{name} is {worst[name]:.1e} m from MuJoCo's kinematics; at most "
                f"{AGREEMENT:.0e} m were expected, so there is nothing to time"
            )
    return worst


if __name__ == "__main__":
    try:
        main(tyro.cli(Settings, description=__doc__))
    except SmoothOperatorError as error:
        raise BenchmarkError(str(error)) from error
