"""Experiment ``fk``: compares libraries of forward kinematics at several batch sizes.

Each library gets the same positions of all joints, converted beforehand to the form that suits it
best, so that only the kinematics is timed and not the conversion.
"""

from __future__ import annotations

import contextlib
import importlib
import io
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, partial
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, Final
from xml.sax.saxutils import quoteattr

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jaxtyping import Array, Float

from smooth_operator.hands.hand import Hand
from smooth_operator.hands.registry import load_hand
from smooth_operator.io.jsonable import to_json
from smooth_operator.result_cache import content_digest
from smooth_operator_benchmark.quality import Watch
from smooth_operator_research.paper.experiment import (
    Drawing,
    ExperimentContext,
    Outcome,
    Table,
    cell_job,
)
from smooth_operator_research.paper.figures import fk_figure
from smooth_operator_research.paper.intervals import (
    Estimate,
    Samples,
    contrast,
    independent,
    typical,
)
from smooth_operator_research.paper.verdicts import Direction, Verdict, judge

ROOT: Final = "palm"
"""Name of the link that is the frame of all positions."""

_LIMIT: Final = 100.0  # beyond any joint's; limits are not what is compared [rad or m]

_INERTIAL: Final = (
    '<inertial><mass value="0.01"/><inertia ixx="1e-5" ixy="0" ixz="0" iyy="1e-5" iyz="0" '
    'izz="1e-5"/></inertial>'
)
"""Mass of links; some readers refuse moving links without one."""


@dataclass(frozen=True, eq=False)
class Urdf:
    """A hand as a URDF file, for other libraries.

    Attributes:
        text: content of the file.
        joints: (n,) names of the hand's joints in the file, in the hand's order.
        zero: (n,) position of each joint of the hand at which the file's position is 0 [rad].
        tips: (F,) names of the links whose origins are the fingertips, thumb first.
    """

    text: str
    joints: tuple[str, ...]
    zero: Float[np.ndarray, " n"]
    tips: tuple[str, ...]


def write_urdf(hand: Hand) -> Urdf:
    """Writes the hand's joints below the palm; coupled joints are written like any other."""
    model, parts = hand.model, [f'<link name="{ROOT}"/>']
    palm = int(model.body(hand.spec.palm).id)
    at: dict[int, tuple[str, np.ndarray]] = {palm: (ROOT, np.eye(4))}
    names: dict[int, str] = {}
    for body in np.flatnonzero(hand.bodies):
        parent = int(model.body_parentid[body])
        if body == palm or parent not in at:
            continue
        link, inside = at[parent]
        inside = inside @ _pose(model.body_pos[body], model.body_quat[body])
        first = int(model.body_jntadr[body])
        for joint in range(first, first + int(model.body_jntnum[body])):
            name, moved = f"joint_{joint}", f"link_{joint}"
            anchor = _moved(model.jnt_pos[joint])
            slides = model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_SLIDE
            parts += [
                f'<link name="{moved}">{_INERTIAL}</link>',
                _joint(
                    name,
                    "prismatic" if slides else "revolute",
                    link,
                    moved,
                    inside @ anchor,
                    model.jnt_axis[joint],
                ),
            ]
            names[joint] = name
            link, inside = moved, np.linalg.inv(anchor)
        at[int(body)] = (link, inside)
    tips = []
    for finger in hand.spec.fingers:
        tip = finger.tip.mirrored if hand.spec.mirror else finger.tip
        link, inside = at[int(model.body(tip.body).id)]
        name = f"tip_{finger.name}"
        parts += [
            f"<link name={quoteattr(name)}/>",
            _joint(f"fixed_{finger.name}", "fixed", link, name, inside @ _moved(tip.offset)),
        ]
        tips.append(name)
    joints = [int(model.joint(name).id) for name in hand.joint_names]
    zero = np.array([model.qpos0[model.jnt_qposadr[joint]] for joint in joints], float)
    text = f'<robot name="hand">{"".join(parts)}</robot>'
    return Urdf(text, tuple(names[joint] for joint in joints), zero, tuple(tips))


def _joint(
    name: str,
    kind: str,
    parent: str,
    child: str,
    pose: Float[np.ndarray, "4 4"],
    axis: Float[np.ndarray, "3"] | None = None,
) -> str:
    from scipy.spatial.transform import Rotation

    angles = Rotation.from_matrix(pose[:3, :3]).as_euler("xyz")  # about fixed axes, as URDF has it
    more = (
        ""
        if axis is None
        else (
            f'<axis xyz="{_numbers(axis)}"/>'
            f'<limit lower="{-_LIMIT}" upper="{_LIMIT}" effort="1" velocity="1"/>'
        )
    )
    return (
        f"<joint name={quoteattr(name)} type={quoteattr(kind)}>"
        f'<origin xyz="{_numbers(pose[:3, 3])}" rpy="{_numbers(angles)}"/>'
        f"<parent link={quoteattr(parent)}/><child link={quoteattr(child)}/>{more}</joint>"
    )


def _numbers(values: Float[np.ndarray, "3"]) -> str:
    return " ".join(repr(float(value)) for value in values)


def _pose(position: Float[np.ndarray, "3"], quat: Float[np.ndarray, "4"]) -> np.ndarray:
    matrix = np.zeros(9)
    mujoco.mju_quat2Mat(matrix, np.asarray(quat, float))
    pose = _moved(position)
    pose[:3, :3] = matrix.reshape(3, 3)
    return pose


def _moved(position: Float[np.ndarray, "3"] | tuple[float, ...]) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, 3] = position
    return pose


AGREEMENT: Final = 1e-5
"""Largest difference of fingertips that count as equal [m]; float32 is good to about 1e-7."""

OURS: Final = "smooth-operator"
BOUNDED: Final = "smooth-operator, within limits"
MJX: Final = "MJX"
PINOCCHIO: Final = "Pinocchio"
PYTORCH: Final = "PyTorch Kinematics"
MUJOCO: Final = "MuJoCo C"

_NEEDS: Final = {
    OURS: (("jax",), "jax"),
    BOUNDED: (("jax",), "jax"),
    MJX: (("mujoco.mjx",), "mujoco-mjx"),
    PINOCCHIO: (("pinocchio",), "pin"),
    PYTORCH: (("torch", "pytorch_kinematics"), "pytorch-kinematics"),
    MUJOCO: (("mujoco",), "mujoco"),
}
"""Library -> modules that it needs, and the distribution that contains them."""

LIBRARIES: Final = tuple(_NEEDS)

Run = Callable[[], Any]
"""Computes the fingertips of the prepared poses, and waits for the result."""


@dataclass(frozen=True, eq=False)
class Library:
    """Forward kinematics of one hand.

    Attributes:
        name: one of ``LIBRARIES``.
        prepare: (N, n) positions of all joints [rad] -> the function that is timed.
        read: result of that function -> (N, F, 3) fingertips in the palm frame [m].
    """

    name: str
    prepare: Callable[[Float[np.ndarray, "N n"]], Run]
    read: Callable[[Any], Float[np.ndarray, "N F 3"]]

    def tips(self, q: Float[np.ndarray, "N n"]) -> Float[np.ndarray, "N F 3"]:
        """Fingertips of some poses [m]."""
        return self.read(self.prepare(q)())


def missing(name: str) -> str | None:
    """Reason why a library can't be used here; None if it can."""
    modules, distribution = _NEEDS[name]
    for module in modules:
        try:
            with contextlib.redirect_stdout(io.StringIO()):  # MJX lists what it can do without
                importlib.import_module(module)
        except ImportError as error:
            absent = isinstance(error, ModuleNotFoundError) and (
                (error.name or "").partition(".")[0] == module.partition(".")[0]
                or error.name == module
            )
            return "not installed" if absent else f"{distribution} can't be imported: {error}"
    return None


def library_version(name: str) -> str:
    """Version of the distribution; ``unknown`` if it has none."""
    try:
        return version(_NEEDS[name][1])
    except PackageNotFoundError:
        return "unknown"


def make_library(name: str, hand: Hand) -> Library:
    """Prepares a library for a hand.

    Args:
        name: one of ``LIBRARIES``, for which ``missing`` found nothing.
    """
    if name in (OURS, BOUNDED):
        return _own_program(hand, name)
    return {MJX: _mjx, PINOCCHIO: _pinocchio, PYTORCH: _pytorch, MUJOCO: _mujoco}[name](hand)


def random_poses(hand: Hand, count: int, seed: int) -> Float[np.ndarray, "N n"]:
    """Random positions (N, n) of all joints [rad], within limits and couplings."""
    low, high = hand.limits.T
    rng = np.random.default_rng(seed)
    return hand.full_configuration(rng.uniform(low, high, (count, len(low))))


def disagreement(library: Library, hand: Hand, q: Float[np.ndarray, "N n"]) -> float:
    """Largest distance of a fingertip from MuJoCo's own [m]; NaN where one is not finite."""
    truth = _mujoco(hand).tips(q)
    return float(np.linalg.norm(library.tips(q) - truth, axis=-1).max())


def _own_program(hand: Hand, name: str) -> Library:
    bounded, tips = name == BOUNDED, len(hand.tip_names)

    def positions(q: Array) -> Array:
        points = hand.tree.forward_kinematics(list(q), hand.tip_names, within_limits=bounded)
        return jnp.stack([jnp.broadcast_to(c, q.shape[1:]) for p in points for c in p])

    compiled = jax.jit(positions)

    def prepare(q: np.ndarray) -> Run:
        there = jnp.asarray(np.ascontiguousarray(q.T), jnp.float32)  # batch last
        return lambda: compiled(there).block_until_ready()

    def read(points: Array) -> np.ndarray:
        return np.asarray(points, float).T.reshape(-1, tips, 3)

    return Library(name, prepare, read)


@dataclass(frozen=True, eq=False)
class _Tips:
    """Fingertips in the compiled model, and its palm in the world."""

    bodies: np.ndarray  # (F,)
    offsets: np.ndarray  # (F, 3) in the body's frame [m]
    rotation: np.ndarray  # (3, 3) of the palm
    origin: np.ndarray  # (3,) of the palm [m]

    @classmethod
    def of(cls, hand: Hand) -> _Tips:
        tips = [f.tip.mirrored if hand.spec.mirror else f.tip for f in hand.spec.fingers]
        data = mujoco.MjData(hand.model)
        mujoco.mj_kinematics(hand.model, data)  # what carries the palm stays where it is
        palm = int(hand.model.body(hand.spec.palm).id)
        return cls(
            np.array([hand.model.body(tip.body).id for tip in tips]),
            np.array([tip.offset for tip in tips]),
            data.xmat[palm].reshape(3, 3).copy(),
            data.xpos[palm].copy(),
        )

    def read(self, world: Any) -> np.ndarray:
        return np.asarray((np.asarray(world, float) - self.origin) @ self.rotation)


def _mjx(hand: Hand) -> Library:
    from mujoco import mjx

    tips, model = _Tips.of(hand), mjx.put_model(hand.model)
    data = mjx.make_data(model)

    def one(q: Array) -> Array:
        moved = mjx.kinematics(model, data.replace(qpos=q))
        turned = jnp.einsum("fij,fj->fi", moved.xmat[tips.bodies], tips.offsets)
        world: Array = moved.xpos[tips.bodies] + turned
        return world

    compiled = jax.jit(jax.vmap(one))

    def prepare(q: np.ndarray) -> Run:
        there = jnp.asarray(hand.qpos(q), jnp.float32)
        return lambda: compiled(there).block_until_ready()

    return Library(MJX, prepare, tips.read)


def _mujoco(hand: Hand) -> Library:
    tips, model = _Tips.of(hand), hand.model
    data = mujoco.MjData(model)
    qpos, xpos, xmat = data.qpos, data.xpos, data.xmat  # views: the loop pays for little but C

    def prepare(q: np.ndarray) -> Run:
        whole = hand.qpos(q)
        points, matrices = np.empty((len(q), *xpos.shape)), np.empty((len(q), *xmat.shape))

        def run() -> np.ndarray:
            for i, pose in enumerate(whole):
                qpos[:] = pose
                mujoco.mj_kinematics(model, data)
                points[i], matrices[i] = xpos, xmat
            turn = matrices[:, tips.bodies].reshape(len(q), -1, 3, 3)
            return np.asarray(
                points[:, tips.bodies] + np.einsum("nfij,fj->nfi", turn, tips.offsets)
            )

        return run

    return Library(MUJOCO, prepare, tips.read)


def _pinocchio(hand: Hand) -> Library:
    import pinocchio

    urdf = write_urdf(hand)
    model = pinocchio.buildModelFromXML(urdf.text)
    data = model.createData()
    at = [model.joints[model.getJointId(name)].idx_q for name in urdf.joints]
    places = [data.oMf[model.getFrameId(name)] for name in urdf.tips]

    def prepare(q: np.ndarray) -> Run:
        there = np.zeros((len(q), model.nq))
        there[:, at] = q - urdf.zero
        points = np.empty((len(q), len(places), 3))

        def run() -> np.ndarray:
            for i, pose in enumerate(there):
                pinocchio.framesForwardKinematics(model, data, pose)
                for k, place in enumerate(places):
                    points[i, k] = place.translation
            return points

        return run

    return Library(PINOCCHIO, prepare, lambda points: np.array(points))


def _pytorch(hand: Hand) -> Library:
    import pytorch_kinematics
    import torch

    urdf = write_urdf(hand)
    device = "cuda" if torch.cuda.is_available() else "cpu"
    chain = pytorch_kinematics.build_chain_from_urdf(urdf.text.encode())
    chain = chain.to(dtype=torch.float32, device=device)
    order = [urdf.joints.index(name) for name in chain.get_joint_parameter_names()]
    frames = chain.get_frame_indices(*urdf.tips)

    def prepare(q: np.ndarray) -> Run:
        there = torch.tensor((q - urdf.zero)[:, order], dtype=torch.float32, device=device)

        def run() -> Any:
            with torch.no_grad():
                poses = chain.forward_kinematics(there, frames)
                points = torch.stack([poses[tip].get_matrix()[:, :3, 3] for tip in urdf.tips], 1)
            if device == "cuda":
                torch.cuda.synchronize()
            return points

        return run

    return Library(PYTORCH, prepare, lambda points: points.cpu().numpy().astype(float))


INSTALL: Final = 'python -m pip install "./research[fk]"'
"""Command that installs the compared libraries, in a clone."""
SLICE_S: Final = 0.05
"""Time for which a round repeats a call [s]; a call that takes longer is made once."""

CHECKED: Final = 200
"""Number of poses on which a library must agree before it is timed."""


@dataclass(frozen=True, eq=False)
class Timing:
    """Measured times.

    Attributes:
        batches: batch sizes.
        per_pose: library -> batch size -> time in each round [ns].
        gaps: library -> reason why it was not timed.
        worst: library -> its largest disagreement with MuJoCo [m].
        others: largest fraction of the cores that other processes used; None if unknown.
    """

    batches: Sequence[int]
    per_pose: Mapping[str, Mapping[int, list[float]]]
    gaps: Mapping[str, str]
    worst: Mapping[str, float]
    others: float | None

    def rounds(self, library: str, batch: int) -> Samples:
        """Time per pose in each round [ns]. All rounds count, because a selection by speed would
        understate the variation of the machine."""
        return independent(self.per_pose[library][batch])

    def mean(self, library: str, batch: int) -> Estimate:
        """Geometric mean of the time per pose [ns], with an interval over rounds."""
        return typical(self.rounds(library, batch))

    def over(self, slow: str, fast: str, batch: int) -> Estimate:
        """Ratio of the times of two libraries, round by round."""
        return contrast(self.rounds(slow, batch), self.rounds(fast, batch), "ratio")


class FkLibraries:
    """Times our kinematics, MJX, Pinocchio, PyTorch Kinematics and MuJoCo's C on the same poses."""

    title = "Libraries of forward kinematics"
    claim = "MJX is fast enough even at large batch sizes, and was chosen for it"

    def run(self, context: ExperimentContext) -> Outcome:
        """See ``Experiment``."""
        hand = load_hand(context.hand, context.sources[0].side)
        timing = time_libraries(context, hand)
        device = str(context.store.environment["device"])
        return Outcome(
            f"Fingertips of {hand.name} ({len(hand.joint_names)} joints) in its palm frame, from "
            "the same random poses within the limits, converted beforehand to the form that suits "
            "each library best; Pinocchio and PyTorch Kinematics read a URDF file that is "
            "written from the compiled model. Before timing, each must agree with MuJoCo's own "
            f"kinematics on {CHECKED} poses to {1e6 * AGREEMENT:g} µm. Compiling is not timed. "
            f"Libraries take turns for {context.size.fk_rounds} rounds, and are compared round by "
            f"round; a round is the median of calls in {1e3 * SLICE_S:g} ms. Intervals are over "
            "the rounds of this run on this machine, and do not apply to others. Ours, MJX "
            "and PyTorch Kinematics compute in float32 on as many threads as they choose "
            f"({device}); Pinocchio and MuJoCo C compute in float64, one pose at a time in a "
            "Python loop, because they have no batches."
            + "".join(f" {name} is missing: {why}." for name, why in timing.gaps.items()),
            [_paper_verdict(timing), _own_verdict(timing)],
            [_table(timing)],
            [
                Drawing(
                    "fk",
                    "Time per pose over the batch size; lower is faster. Bars: 95 % intervals "
                    "over rounds, mostly smaller than the marks. The legend names missing "
                    "libraries.",
                    fk_figure(
                        timing.batches, timing.mean, list(timing.per_pose), timing.gaps, LIBRARIES
                    ),
                )
            ],
            {
                "batches": timing.batches,
                "ns_per_pose": timing.per_pose,
                "gaps": timing.gaps,
                "disagreement_m": timing.worst,
                "versions": {name: library_version(name) for name in timing.per_pose},
                "others": timing.others,
            },
        )


def time_libraries(context: ExperimentContext, hand: Hand) -> Timing:
    """Times the libraries that are installed and agree; gives a reason for each of the others."""
    gaps = {name: why for name in LIBRARIES if (why := missing(name)) is not None}
    library: Callable[[str], Library] = cache(lambda name: make_library(name, hand))
    here = [name for name in LIBRARIES if name not in gaps]

    def key(kind: str, names: Sequence[str], **more: Any) -> dict[str, Any]:
        versions = {name: library_version(name) for name in names}
        model = [write_urdf(hand).text, to_json(hand.limits), content_digest(Path(__file__))]
        return {
            "kind": kind,
            "libraries": versions,
            "model": model,
            "machine": context.store.machine,
            **more,
        }

    def checked(name: str, advance: object) -> dict[str, np.ndarray]:
        return {
            "worst": np.array(disagreement(library(name), hand, random_poses(hand, CHECKED, 0)))
        }

    jobs = [
        cell_job(f"{name}: agreement", key("fk-check", [name]), 3000.0, partial(checked, name))
        for name in here
    ]
    cells = context.finish("agreement of the libraries", jobs)
    worst = {name: float(cell["worst"]) for name, cell in zip(here, cells, strict=True)}
    for name, error in worst.items():
        if not error < AGREEMENT:  # NaN is none
            gaps[name] = f"its fingertips are up to {error:.1e} m from MuJoCo's, so it is not timed"
    here = [name for name in here if name not in gaps]

    size = context.size

    def timed(batch: int, advance: Callable[[float], None]) -> dict[str, np.ndarray]:
        poses = random_poses(hand, batch, 1)
        watch = Watch()
        runs = {name: library(name).prepare(poses) for name in here}
        times = rounds_of(runs, size.fk_rounds, lambda: advance(1 / size.fk_rounds))
        others = watch.others()
        return {
            "names": np.array(here),
            "ns": 1e9 * np.array([times[name] for name in here]) / batch,
            "others": np.array(np.nan if others is None else others),
        }

    jobs = [
        cell_job(
            f"batch {batch:,}",
            key("fk-time", here, batch=batch, rounds=size.fk_rounds),
            1000.0 + size.fk_rounds * len(here) * max(50.0, 0.03 * batch),
            lambda advance, b=batch: timed(b, advance),  # type: ignore[misc]
        )
        for batch in size.fk_batches
    ]
    cells = context.finish("forward kinematics", jobs)
    shares = [float(cell["others"]) for cell in cells if np.isfinite(cell["others"])]
    per_pose = {
        name: {
            batch: cell["ns"][list(cell["names"]).index(name)].tolist()
            for batch, cell in zip(size.fk_batches, cells, strict=True)
        }
        for name in here
    }
    return Timing(size.fk_batches, per_pose, gaps, worst, max(shares, default=None))


def rounds_of(
    runs: Mapping[str, Run], rounds: int, done: Callable[[], None]
) -> dict[str, list[float]]:
    """Times calls that take turns, so that disturbances of the machine affect all equally.

    Args:
        runs: name -> function that is timed.
        rounds: number of rounds; each round begins with another one.
        done: called after each round.

    Returns:
        name -> one time for each round [s].
    """
    for run in runs.values():  # compiles, fills caches, wakes the clock
        run()
        run()
    names = list(runs)
    times: dict[str, list[float]] = {name: [] for name in names}
    for turn in range(rounds):
        for name in names if turn % 2 == 0 else names[::-1]:
            times[name].append(_round(runs[name]))
        done()
    return times


def _round(run: Run) -> float:
    calls: list[float] = []
    started = time.perf_counter()
    while not calls or time.perf_counter() - started < SLICE_S:
        before = time.perf_counter()
        run()
        calls.append(time.perf_counter() - before)
    return float(np.median(calls))


def _paper_verdict(timing: Timing) -> Verdict:
    largest = timing.batches[-1]
    rivals = [name for name in (PINOCCHIO, PYTORCH) if name in timing.per_pose]
    absent = [name for name in (MJX, PINOCCHIO, PYTORCH) if name not in timing.per_pose]
    claim = f"MJX is the fastest of the three at large batches ({largest:,} here)"
    gaps = "; ".join(f"{name}: {timing.gaps[name]}" for name in absent)
    note = f"Missing here: {gaps}. `{INSTALL}` installs them." if absent else ""
    if MJX not in timing.per_pose or not rivals:
        return Verdict(claim, "fastest, no figure", "not measured", "not shown", note)
    ratios = {name: timing.over(name, MJX, largest) for name in rivals}
    shown = ", ".join(f"{name} × {one.shown(3)}" for name, one in ratios.items())
    held = judge(Direction(1.0, upwards=True), list(ratios.values()), missing=len(absent))
    return Verdict(claim, "fastest, no figure", f"time over MJX's: {shown}", held, note)


def _own_verdict(timing: Timing) -> Verdict:
    rivals = [name for name in (MJX, PINOCCHIO, PYTORCH, MUJOCO) if name in timing.per_pose]
    batches = [batch for batch in timing.batches if batch >= 64]
    claim = "ours: the unrolled program is faster than all of them from a batch of 64"
    if OURS not in timing.per_pose or not rivals or not batches:
        why = timing.gaps.get(OURS, "there is nothing to compare it with")
        return Verdict(claim, "no claim", "not measured", "not shown", why)
    ratios = {(batch, name): timing.over(name, OURS, batch) for batch in batches for name in rivals}
    largest = timing.batches[-1]
    each = ", ".join(f"{name} × {ratios[largest, name].shown(3)}" for name in rivals)
    held = judge(Direction(1.0, upwards=True), list(ratios.values()))
    return Verdict(claim, "no claim", f"at {largest:,}: {each}", held)


def _table(timing: Timing) -> Table:
    rows = [
        [f"{batch:,}", *(timing.mean(name, batch).shown(3) for name in timing.per_pose)]
        for batch in timing.batches
    ]
    apart = ", ".join(f"{name} {1e6 * error:.2g} µm" for name, error in timing.worst.items())
    busy = (
        ""
        if timing.others is None
        else f" Other processes took up to {100 * timing.others:.0f} % of the cores."
    )
    return Table(
        "Time a pose [ns]",
        ["batch", *timing.per_pose],
        rows,
        "Geometric means with 95 % intervals over rounds. Largest disagreement with MuJoCo's "
        f"fingertips: {apart}." + busy,
    )
