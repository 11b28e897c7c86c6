"""Opens the closed loops of a model: replaces bars and ball joints by joint couplings in the form
of polynomials.

The library computes the kinematics of a tree. In some hands, bars and links form closed loops (in
MJCF, by ``connect`` or ``weld``), and the motors move the fingers only through these loops. Such a
model is opened once, when it is added:

1. The links of a loop get a new tree over its hinges, from the palm outwards; two ``connect`` on
   one line are a hinge. Rods between ball joints, cranks and bars are left out.
2. The loops are solved over the ranges of the motors, by Gauss-Newton steps on MuJoCo's equality
   rows from each pose to the next.
3. The joints of the new tree that are nearest to the palm lead, at most as many as there are
   motors. Every other joint gets a polynomial of one leader. The limits of a leader are the range
   that the motors reach.

The driver of the real hand computes motor positions from those of the leaders.
"""

from __future__ import annotations

import itertools
import math
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from os.path import isfile
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final, NamedTuple

import mujoco
import numpy as np
from jaxtyping import Float
from numpy.polynomial import Polynomial

from smooth_operator.errors import HandModelError
from smooth_operator.hand_discovery.linkages import HINGE, SLIDE, Edge, LinkGraph, Loop, Pose
from smooth_operator.hand_discovery.loop_writer import OpenLoop, write_without_loops
from smooth_operator.hand_discovery.model_limits import check_model_limits
from smooth_operator.hands.loading import load_spec
from smooth_operator.hands.model_assets import model_path, read_model_files
from smooth_operator.hands.spec import MOST_DEGREE, Coupling

MOST_ERROR: Final = math.radians(0.5)
"""Largest error of a polynomial that replaces a loop [rad]."""
_CLOSE: Final = math.radians(0.01)  # error at which a polynomial needs no higher degree [rad]
_POSES: Final = 225  # of a loop, over the ranges of its motors
_MOST_PER_MOTOR: Final = 61
_DIGITS: Final = 8  # of a coefficient, after the point
_MARGIN: Final = 1e-3  # of a follower's range [rad]


class OpenModel(NamedTuple):
    """A model whose loops were opened.

    Attributes:
        path: its MJCF file, or the original if that has no loops.
        couplings: followers and their polynomials, which replace the loops.
        notes: notes to the user on the changes.
    """

    path: Path
    couplings: tuple[Coupling, ...] = ()
    notes: tuple[str, ...] = ()


@contextmanager
def opened(path: Path) -> Iterator[OpenModel]:
    """Yields a model with its loops opened, in a temporary folder with its meshes; a model without
    loops stays as it is. Raises HandModelError if the model can't be read, a loop can't be solved,
    or one of its joints is not a polynomial of another joint; the message names the joint and the
    error."""
    loops: list[Loop] = []
    if isfile(path) and _may_have_loops(path):  # others get their message from ``discover``
        check_model_limits(path)
        spec = load_spec(path)
        graph = LinkGraph(spec.compile())
        loops = graph.loops()
    if not loops:
        yield OpenModel(path)
        return
    solutions = [_solved(graph, loop) for loop in loops]
    with TemporaryDirectory(prefix="smooth-operator-") as folder:
        file = Path(folder) / f"{path.stem}.xml"
        file.write_text(write_without_loops(spec, graph, solutions, Path(folder)), encoding="utf-8")
        couplings = tuple(c for one in solutions for c in one.couplings)
        yield OpenModel(file, couplings, (_note(solutions, couplings),))


def _may_have_loops(path: Path) -> bool:
    """True if a file of the model has an element ``connect`` or ``weld``, in any encoding."""
    texts = (
        file.read_bytes().replace(b"\0", b"")
        for file in read_model_files(model_path(path)).documents
    )
    return any(tag in text for text in texts for tag in (b"<connect", b"<weld"))


def _note(solutions: Sequence[OpenLoop], couplings: Sequence[Coupling]) -> str:
    leaders = ", ".join(name for one in solutions for name in one.leaders)
    dropped = sum(len(one.loop.dropped) for one in solutions)
    text = (
        f"the copy of the model has no closed loops: {dropped} links of the drive are left out; "
        f"{leaders} are commanded, within limits that the motors reach"
    )
    if any(len(one.leaders) > 1 for one in solutions):
        text += ", which hold for each joint alone but not for every combination"
    if couplings:
        error = math.degrees(max(c.error for c in couplings))
        followers = ", ".join(c.joint for c in couplings)
        text += f"; {followers} follow them by polynomials, within {error:.2f} degrees"
    return text


def _solved(graph: LinkGraph, loop: Loop) -> OpenLoop:
    """Solves a loop over the ranges of its motors and fits polynomials."""
    for body in loop.moving:
        if (count := len(graph.joints_of(body))) > 1:
            raise HandModelError(
                f"link {graph.model.body(body).name!r} of a closed loop has {count} joints; give "
                "each joint a link of its own in the file"
            )
    motors = _motors(graph, loop)
    poses = _poses(graph, loop, motors)
    positions = {
        edge.name: np.array([_position(graph, body, edge, pose) for pose in poses])
        for body, edge in loop.joints.items()
    }
    # joints outside the loops that followed a part of the drive, which the copy lacks
    dropped = {j for b in loop.dropped for j in graph.joints_of(b)}
    outside = {j for j in graph.tied(dropped) if int(graph.model.jnt_bodyid[j]) not in loop.moving}
    for j in sorted(outside):
        values = [pose.qpos[graph.model.jnt_qposadr[j]] for pose in poses]
        positions[str(graph.model.joint(j).name)] = np.array(values)
    reference = {name: float(values[0]) for name, values in positions.items()}
    names = sorted(positions, key=lambda name: _joint(graph, name) not in graph.driven)
    leaders, couplings = _fitted({name: positions[name] for name in names}, len(motors))
    ranges = {name: np.array([v.min(), v.max()]) for name, v in positions.items()}
    for c in couplings:  # a polynomial may leave the range of what it was fitted to
        low, high = ranges[c.follows]
        q = np.linspace(low, high, _MOST_PER_MOTOR)
        reached = Polynomial(c.coefficients)(q)
        ranges[c.joint] = np.array([reached.min() - _MARGIN, reached.max() + _MARGIN])
    return OpenLoop(loop, {n: ranges[n] for n in leaders}, couplings, ranges, reference)


def _joint(graph: LinkGraph, name: str) -> int:
    return int(mujoco.mj_name2id(graph.model, mujoco.mjtObj.mjOBJ_JOINT, name))


def _motors(graph: LinkGraph, loop: Loop) -> list[int]:
    """Joints that determine the pose of a loop: driven ones; those with limits if it has none."""
    model = graph.model
    joints = [
        j
        for b in sorted(loop.moving)
        for j in graph.joints_of(b)
        if model.jnt_type[j] in (HINGE, SLIDE)
    ]
    fit = [j for j in joints if j in graph.driven] or [j for j in joints if model.jnt_limited[j]]
    if not fit:
        raise HandModelError(
            f"the closed loop of {_words(graph, loop)} has no motor and no joint with limits: add "
            "an actuator, or a range, to the joint that drives it"
        )
    if unlimited := [model.joint(j).name for j in fit if not model.jnt_limited[j]]:
        raise HandModelError(
            f"joint {unlimited[0]!r} drives a closed loop but has no limits: add its "
            'range="... ..." to the file'
        )
    _, jacobian = graph.rows(graph.reference, graph.free(loop, []))
    _, sizes, basis = np.linalg.svd(jacobian)
    free = basis[int((sizes > 1e-6 * sizes.max(initial=1e-9)).sum()) :].T
    dofs = graph.free(loop, []).tolist()
    kept: list[int] = []
    for j in fit:  # those that move independently
        rows = free[[dofs.index(int(model.jnt_dofadr[k])) for k in (*kept, j)]]
        if np.linalg.matrix_rank(rows, tol=1e-6) > len(kept):
            kept.append(j)
    return kept


def _words(graph: LinkGraph, loop: Loop) -> str:
    names = [graph.model.body(b).name for b in sorted(loop.moving)]
    return ", ".join(map(repr, names[:3])) + (", ..." if len(names) > 3 else "")


def _poses(graph: LinkGraph, loop: Loop, motors: list[int]) -> list[Pose]:
    """Poses over a grid of the motors' ranges, the reference pose first; each is solved from its
    neighbour's. Poses that can't be reached are left out."""
    model = graph.model
    addresses = [int(model.jnt_qposadr[j]) for j in motors]
    per_motor = min(_MOST_PER_MOTOR, max(3, round(_POSES ** (1 / len(motors)))))
    ends = [(float(low), float(high)) for low, high in model.jnt_range[motors]]
    grid = [np.linspace(low, high, per_motor) for low, high in ends]
    free = graph.free(loop, motors)
    here = graph.reference[addresses]
    start = tuple(int(np.argmin(abs(values - q))) for values, q in zip(grid, here, strict=True))
    waiting = deque([(start, graph.reference)])
    seen, poses = {start}, [graph.pose(graph.reference)]
    while waiting:
        node, near = waiting.popleft()
        begin = near.copy()
        begin[addresses] = [values[i] for values, i in zip(grid, node, strict=True)]
        found = graph.closed(begin, free)
        if found is None:
            continue
        poses.append(graph.pose(found))
        for k, step in itertools.product(range(len(motors)), (-1, 1)):
            beside = (*node[:k], node[k] + step, *node[k + 1 :])
            if beside not in seen and 0 <= beside[k] < per_motor:
                seen.add(beside)
                waiting.append((beside, found))
    if len(poses) < max(8, len(seen) // 10):
        names = ", ".join(repr(model.joint(j).name) for j in motors)
        raise HandModelError(
            f"the closed loop of {_words(graph, loop)} can't be solved: it closes in only "
            f"{len(poses) - 1} of {len(seen)} poses of {names}; check the ranges and the positions "
            "of the connections"
        )
    return poses


def _position(graph: LinkGraph, body: int, edge: Edge, pose: Pose) -> float:
    """Position of a joint of the new tree in a pose [rad]."""
    if edge.joint >= 0:
        return float(pose.qpos[graph.model.jnt_qposadr[edge.joint]])
    above = edge.other(body)
    assert edge.axis is not None
    axis = graph.frames[above].T @ edge.axis
    before = graph.frames[above].T @ graph.frames[body]
    turn = pose.frames[above].T @ pose.frames[body] @ before.T
    sine = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
    return math.atan2(float(sine @ axis), float(np.trace(turn) - 1))


def _fitted(
    positions: Mapping[str, Float[np.ndarray, " s"]], count: int
) -> tuple[tuple[str, ...], tuple[Coupling, ...]]:
    """The first set of leaders, and polynomials of them, that represent all positions.

    Args:
        positions: name -> positions of a joint in the sampled poses; those that should lead first.
        count: largest number of leaders, that of the motors.
    """
    fits = {
        (joint, leader): _polynomial(joint, leader, positions)
        for joint, leader in itertools.permutations(positions, 2)
    }
    tried: list[tuple[float, str]] = []
    for number in range(1, min(count, len(positions)) + 1):
        for leaders in itertools.combinations(positions, number):
            couplings = [
                min((fits[joint, leader] for leader in leaders), key=lambda c: c.error)
                for joint in positions
                if joint not in leaders
            ]
            worst = max(couplings, key=lambda c: c.error, default=None)
            if worst is None or worst.error <= MOST_ERROR:
                return leaders, tuple(couplings)
            tried.append((worst.error, worst.joint))
    if not tried:  # the loop is only a part of the drive
        return (), ()
    error, joint = min(tried)
    raise HandModelError(
        f"joint {joint!r} of a closed loop is not a polynomial of one other joint: the best one of "
        f"degree {MOST_DEGREE} is up to {math.degrees(error):.1f} degrees off, more than "
        f"{math.degrees(MOST_ERROR):g}; narrow the ranges of the motors in the file, or describe "
        "the finger without the loop"
    )


def _polynomial(
    joint: str, leader: str, positions: Mapping[str, Float[np.ndarray, " s"]]
) -> Coupling:
    """A joint as a polynomial of another one, of the lowest degree that is close."""
    x, y = positions[leader], positions[joint]
    if np.ptp(x) < _MARGIN:
        return Coupling(joint, leader, 0.0, float(y.mean()), error=float(np.ptp(y)))
    for degree in range(1, MOST_DEGREE + 1):
        fit = Polynomial.fit(x, y, degree).convert()
        error = float(np.abs(fit(x) - y).max())
        if error < _CLOSE:
            break
    return replace(Coupling.of(joint, leader, fit.coef.round(_DIGITS).tolist()), error=error)
