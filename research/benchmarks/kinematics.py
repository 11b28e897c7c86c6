"""Forward kinematics of many hands: the unrolled program against MJX and MuJoCo.

    python research/benchmarks/kinematics.py --batches 1 64 1024 8192

All compute the fingertips from the positions of all joints; ``positions`` computes all landmarks.
Before anything is timed, all must agree with ``mujoco.mj_kinematics`` in float64.
MJX is optional: ``python -m pip install mujoco-mjx``.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import tyro
from timing import interleaved, percentiles

from smooth_operator import Hand, SmoothOperatorError, load_hand
from smooth_operator_research.paper.fk_libraries import (
    AGREEMENT,
    BOUNDED,
    MJX,
    MUJOCO,
    OURS,
    Library,
    Run,
    disagreement,
    make_library,
    missing,
    random_poses,
)
from smooth_operator_research.run_report import BenchmarkError, Report

LOOP_LIMIT = 8192  # a Python loop says nothing new beyond that

POSITIONS = "positions"


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
        compare: an earlier JSON file to compare this run with.
    """

    batches: tuple[int, ...] = (1, 16, 128, 1024, 2048, 8192)
    seconds: float = 5.0
    hand: str = "mimic_p050"
    side: str = "right"
    seed: int = 0
    output: Path | None = None
    compare: Path | None = None


def main(settings: Settings) -> None:
    report = Report("kinematics", vars(settings))
    hand = load_hand(settings.hand, settings.side)
    libraries = programs(hand)
    if (why := missing(MJX)) is not None:
        report.notes.append(f"MJX: {why}; it needs `python -m pip install mujoco-mjx`")
    worst = check(hand, libraries, settings.seed)
    report.add("disagreement_m", worst)

    rows, ratios = [], []
    for batch in settings.batches:
        q = random_poses(hand, batch, settings.seed)
        work = {
            name: library.prepare(q)
            for name, library in libraries.items()
            if name != MUJOCO or batch <= LOOP_LIMIT
        }
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
                speed = {ours: medians[name] / medians[ours] for ours in (OURS, BOUNDED, POSITIONS)}
                report.add(f"{batch}/{name} over", speed)
                ratios.append([batch, f"{name} / ours", *speed.values()])
    header = ("hands", "program", "p50 [ms]", "p95 [ms]", "p99 [ms]", "per hand [ns]")
    report.table("Forward kinematics, time per batch", header, rows)
    report.table(
        "How many times faster, by p50", ("hands", "ratio", OURS, BOUNDED, POSITIONS), ratios
    )
    report.notes.append(
        f"{OURS}: forward kinematics to the fingertips, batch last; {BOUNDED}: the same, promised "
        f"that joints keep their limits, as the solver calls it; {POSITIONS}: the public "
        f"`tree.positions`, all {len(hand.tree.names)} landmarks, batch first. "
        f"{MJX}: `mjx.kinematics` under vmap and jit, fingertips. All in float32 but {MUJOCO}."
    )
    report.notes.append(
        "largest disagreement with `mj_kinematics` over 1,000 poses: "
        + ", ".join(f"{name} {1e6 * error:.2f} µm" for name, error in worst.items())
    )
    report.finish(settings.output, settings.compare)


def programs(hand: Hand) -> dict[str, Library]:
    """name -> library: those of the experiment ``fk`` that are here, and the public interface."""
    libraries = {
        name: make_library(name, hand)
        for name in (OURS, BOUNDED, MJX, MUJOCO)
        if missing(name) is None
    }
    compiled = jax.jit(hand.tree.positions)
    at = [hand.tree.names.index(name) for name in hand.tip_names]

    def prepare(q: np.ndarray) -> Run:
        on_device = jnp.asarray(q, jnp.float32)  # batch first
        return lambda: compiled(on_device).block_until_ready()

    libraries[POSITIONS] = Library(
        POSITIONS, prepare, lambda points: np.asarray(points, float)[:, at]
    )
    return libraries


def check(hand: Hand, libraries: dict[str, Library], seed: int) -> dict[str, float]:
    """Largest distance of each program from MuJoCo's [m].

    Raises:
        BenchmarkError: if one is beyond AGREEMENT: what is wrong need not be timed.
    """
    q = random_poses(hand, 1000, seed)
    worst = {
        name: disagreement(library, hand, q)
        for name, library in libraries.items()
        if name != MUJOCO
    }
    for name, error in worst.items():
        if not error < AGREEMENT:
            raise BenchmarkError(
                f"{name} is {error:.1e} m from MuJoCo's kinematics; at most "
                f"{AGREEMENT:.0e} m were expected, so there is nothing to time"
            )
    return worst


if __name__ == "__main__":
    try:
        main(tyro.cli(Settings, description=__doc__))
    except SmoothOperatorError as error:
        raise BenchmarkError(str(error)) from error
