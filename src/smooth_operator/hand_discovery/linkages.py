"""Graph of a model's links: finds closed loops, and a tree of hinges that opens them."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator, Sequence
from typing import Final, Literal, NamedTuple, TypeAlias

import mujoco
import numpy as np
from jaxtyping import Float, Int

from smooth_operator.hands.loading import driven_joints

_STEPS: Final = 50  # of Gauss-Newton, at most
_STILL: Final = 1e-9  # step that ends the solution
_RANK: Final = 1e-8  # of equality rows, relative
_OPEN: Final = 2e-4  # a loop with a larger gap is not closed [m, rad]
_LINE: Final = 1e-3  # two connections closer than this are one [m]

HINGE: Final = int(mujoco.mjtJoint.mjJNT_HINGE)
SLIDE: Final = int(mujoco.mjtJoint.mjJNT_SLIDE)
"""Kinds of joints with one position, in ``jnt_type``."""
_FREE: Final = int(mujoco.mjtJoint.mjJNT_FREE)
_CONNECT: Final = int(mujoco.mjtEq.mjEQ_CONNECT)
_WELD: Final = int(mujoco.mjtEq.mjEQ_WELD)


Kind: TypeAlias = Literal["fixed", "hinge", "slide", "ball"]
"""How two bodies move relative to each other; a connection at one point is a ball joint."""


class Edge(NamedTuple):
    """A joint between two bodies, from the model's tree or from its connections.

    Attributes:
        ends: the two bodies.
        kind: kind of motion between them.
        name: name of the joint.
        joint: index of the joint; -1 for connections.
        axis: (3,) axis of a hinge or slide in the world, in the reference pose.
        anchor: (3,) a point on the axis [m].
    """

    ends: tuple[int, int]
    kind: Kind
    name: str = ""
    joint: int = -1
    axis: Float[np.ndarray, "3"] | None = None
    anchor: Float[np.ndarray, "3"] | None = None

    def other(self, body: int) -> int:
        """Returns the body at the other end of this joint."""
        return self.ends[1] if body == self.ends[0] else self.ends[0]


class Loop(NamedTuple):
    """Bodies of one loop, or of several loops that share bodies.

    Attributes:
        base: the body that carries them all, such as the palm.
        moving: bodies of the loops.
        parents: remaining body -> joint towards the base in the new tree, in order from the
            base.
        dropped: bodies that are left out.
    """

    base: int
    moving: set[int]
    parents: dict[int, Edge]
    dropped: set[int]

    @property
    def joints(self) -> dict[int, Edge]:
        """Maps each body to its hinge or slide in the opened tree."""
        return {b: edge for b, edge in self.parents.items() if edge.axis is not None}


class Pose(NamedTuple):
    """A pose in which the loops are closed: positions of the model's joints, and (nbody, 3, 3)
    frames in the world."""

    qpos: Float[np.ndarray, " nq"]
    frames: Float[np.ndarray, "nbody 3 3"]


class LinkGraph:
    """Bodies and connections of a model in its reference pose, in which the loops are closed."""

    def __init__(self, model: mujoco.MjModel) -> None:
        self.model, self.data = model, mujoco.MjData(model)
        off = mujoco.mjtDisableBit
        model.opt.disableflags |= int(
            off.mjDSBL_CONTACT | off.mjDSBL_LIMIT | off.mjDSBL_FRICTIONLOSS
        )
        model.opt.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
        self.driven = driven_joints(model)
        motors = [int(model.jnt_dofadr[j]) for j in self.driven]
        closed = self.closed(model.qpos0.copy(), np.setdiff1d(np.arange(model.nv), motors))
        self.reference = model.qpos0.copy() if closed is None else closed
        self.data.qpos[:] = self.reference
        mujoco.mj_kinematics(model, self.data)
        self.places = self.data.xpos.copy()
        self.frames = self.data.xmat.reshape(-1, 3, 3).copy()
        self._corners = self._shape_corners()
        self.edges = [*map(self._tree_edge, range(1, model.nbody)), *self._connections()]

    def _shape_corners(self) -> list[np.ndarray]:
        """Corners of the boxes around each body's shapes, and its origin [m]."""
        corners = np.array(list(itertools.product((-1, 1), repeat=3)))
        points = [[place] for place in self.places]
        for geom in range(self.model.ngeom):
            box = self.model.geom_aabb[geom]
            turn = self.data.geom_xmat[geom].reshape(3, 3)
            local = box[:3] + corners * box[3:]
            points[int(self.model.geom_bodyid[geom])] += list(
                self.data.geom_xpos[geom] + local @ turn.T
            )
        return [np.array(each) for each in points]

    def reach(self, bodies: Iterable[int], base: int) -> float:
        """Largest distance from the origin of the base to the shapes of some bodies [m]."""
        points = np.concatenate([self._corners[b] for b in bodies])
        return float(np.linalg.norm(points - self.places[base], axis=1).max())

    def parent(self, body: int) -> int:
        """Parent of a body in the file."""
        return int(self.model.body_parentid[body])

    def below(self, body: int) -> set[int]:
        """The body and all bodies below it in the file."""
        return {b for b in range(self.model.nbody) if body in self._path(b)}

    def _path(self, body: int) -> list[int]:
        out = [body]
        while body:
            body = self.parent(body)
            out.append(body)
        return out

    def _tree_edge(self, body: int) -> Edge:
        ends, joints = (self.parent(body), body), self.joints_of(body)
        if not joints:
            return Edge(ends, "fixed")
        if len(joints) > 1 or self.model.jnt_type[joints[0]] not in (HINGE, SLIDE):
            return Edge(ends, "ball", name=self.model.joint(joints[0]).name)
        (j,) = joints
        kind: Kind = "hinge" if self.model.jnt_type[j] == HINGE else "slide"
        axis, anchor = self.data.xaxis[j].copy(), self.data.xanchor[j].copy()
        return Edge(ends, kind, self.model.joint(j).name, j, axis, anchor)

    def joints_of(self, body: int) -> list[int]:
        """Joints between a body and its parent in the file."""
        first = int(self.model.body_jntadr[body])
        return list(range(first, first + int(self.model.body_jntnum[body])))

    def _connections(self) -> Iterator[Edge]:
        """Connections between two bodies: those on one line are a hinge."""
        model, of_sites = self.model, int(mujoco.mjtObj.mjOBJ_SITE)
        joined: dict[tuple[int, int], list[tuple[np.ndarray, str]]] = {}
        welded = []
        for e in np.flatnonzero(
            np.isin(model.eq_type, (_CONNECT, _WELD)) & (model.eq_active0 != 0)
        ):
            ends = [int(model.eq_obj1id[e]), int(model.eq_obj2id[e])]
            name = str(model.equality(e).name)
            if model.eq_objtype[e] == of_sites:
                anchor = self.data.site_xpos[ends[0]].copy()
                sites = [str(model.site(site).name) for site in ends]
                name = name or _stem(*sites) or sites[0]
                ends = [int(model.site_bodyid[site]) for site in ends]
            else:
                ends = [max(end, 0) for end in ends]
                anchor = self.places[ends[0]] + self.frames[ends[0]] @ model.eq_data[e, :3]
                name = name or f"{model.body(ends[0]).name}_{model.body(ends[1]).name}"
            pair = (min(ends), max(ends))
            if model.eq_type[e] == _WELD:
                welded.append(pair)
            else:
                joined.setdefault(pair, []).append((anchor, name))
        taken = {str(model.joint(j).name) for j in range(model.njnt)}
        for pair, anchors in joined.items():
            points = np.array([anchor for anchor, _ in anchors])
            spread = points - points.mean(axis=0)
            _, sizes, axes = np.linalg.svd(np.vstack([spread, np.zeros((3, 3))]))
            if sizes[1] > _LINE:
                welded.append(pair)
            elif sizes[0] > _LINE:
                name = anchors[0][1]
                while name in taken:
                    name += "_hinge"
                taken.add(name)
                yield Edge(pair, "hinge", name, -1, axes[0], points[0])
            else:
                yield Edge(pair, "ball")
        yield from (Edge(pair, "fixed") for pair in welded)

    def loops(self) -> list[Loop]:
        """Returns all loops; loops that share links are joined. Loops through a body that floats or
        is moved by hand, such as a base that a ``weld`` holds, are left out."""
        groups: list[set[int]] = []
        for edge in self.edges[self.model.nbody - 1 :]:
            one, other = map(self._path, edge.ends)
            moving = set(one) ^ set(other)
            floats = [self.model.jnt_type[j] == _FREE for b in moving for j in self.joints_of(b)]
            if any(floats) or any(self.model.body_mocapid[b] >= 0 for b in moving):
                continue
            for group in [g for g in groups if g & moving]:
                groups.remove(group)
                moving |= group
            while len(bases := {self.parent(b) for b in moving} - moving) > 1:
                moving.add(max(bases, key=lambda b: len(self._path(b))))
            groups.append(moving)
        return [self._loop(moving) for moving in groups]

    def _loop(self, moving: set[int]) -> Loop:
        """A new tree over hinges, the shortest from the base; of two ways to a link, that over the
        heavier one, which is a phalanx and no bar."""
        (base,) = {self.parent(b) for b in moving} - moving
        own = [e for e in self.edges if set(e.ends) <= moving | {base}]
        parents: dict[int, Edge] = {}
        level = [base]
        while level:
            level.sort(key=lambda b: -float(self.model.body_mass[b]))
            found = [
                (edge.other(body), edge)
                for body in level
                for edge in own
                if body in edge.ends and edge.kind != "ball"
            ]
            level = []
            for body, edge in found:
                if body not in parents and body != base:
                    parents[body] = edge
                    level.append(body)
        loop = Loop(base, moving, parents, moving - set(parents))
        self._drop_bars(loop, own)
        return loop

    def _drop_bars(self, loop: Loop, own: list[Edge]) -> None:
        """Drops the ends of the tree that are connected to a link that reaches further, or to the
        base and end before the link that carries them.

        A link above a dropped one, such as a crank, takes over its connections.
        """
        used = {id(e) for e in loop.parents.values()}
        cuts = {frozenset(e.ends) for e in own if id(e) not in used}
        for rod in loop.dropped:  # connects all that it touches
            touched = {end for cut in cuts if rod in cut for end in cut} - {rod}
            cuts = {cut for cut in cuts if rod not in cut}
            cuts |= {frozenset(pair) for pair in itertools.combinations(touched, 2)}
        outside = {b for b in range(1, self.model.nbody) if b not in loop.moving}

        def rival(body: int, other: int) -> set[int]:
            if other != loop.base:
                return self._beyond(loop, other)
            return {loop.parents[body].other(body)} - {loop.base} or {body}

        while True:
            inner = {e.other(b) for b, e in loop.parents.items()}
            inner |= {self.parent(b) for b in outside}
            bars = [
                (body, other)
                for cut in cuts
                for body, other in itertools.permutations(cut)
                if body in loop.parents and body not in inner
                if self.reach([body], loop.base) < self.reach(rival(body, other), loop.base)
            ]
            if not bars:
                return
            bar = min(body for body, _ in bars)
            above = loop.parents.pop(bar).other(bar)
            loop.dropped.add(bar)
            cuts = {frozenset(above if end == bar else end for end in cut) for cut in cuts}
            cuts = {cut for cut in cuts if len(cut) == 2 and cut != {loop.base}}

    def _beyond(self, loop: Loop, body: int) -> set[int]:
        """The body and all that hang from it in the new tree and, outside the loop, in the file."""
        out = {body}
        for b, edge in loop.parents.items():  # those nearest to the base first
            if edge.other(b) in out:
                out.add(b)
        more = {c for b in out for c in range(1, self.model.nbody) if self.parent(c) == b}
        return out.union(*(self.below(c) for c in more - loop.moving))

    def free(self, loop: Loop, motors: Sequence[int]) -> Int[np.ndarray, " f"]:
        """Degrees of freedom of a loop, and of joints that joint equalities tie to it, without
        those that motors drive."""
        own = self.tied({j for b in loop.moving for j in self.joints_of(b)}) - set(motors)
        return np.flatnonzero(np.isin(self.model.dof_jntid, list(own)))

    def tied(self, joints: set[int]) -> set[int]:
        """Returns these joints and all joints that joint equalities tie to them."""
        model, out = self.model, set(joints)
        ties = [
            {int(model.eq_obj1id[e]), int(model.eq_obj2id[e])} - {-1}
            for e in np.flatnonzero(model.eq_type == int(mujoco.mjtEq.mjEQ_JOINT))
        ]
        while more := [tie for tie in ties if tie & out and not tie <= out]:
            out |= set().union(*more)
        return out

    def rows(
        self, qpos: Float[np.ndarray, " nq"], free: Int[np.ndarray, " f"]
    ) -> tuple[Float[np.ndarray, " r"], Float[np.ndarray, "r f"]]:
        """Residuals of the equalities that some degrees of freedom change, and their
        derivatives."""
        self.data.qpos[:] = qpos
        mujoco.mj_fwdPosition(self.model, self.data)
        jacobian = self.data.efc_J.reshape(-1, self.model.nv)[:, free]
        touched = np.abs(jacobian).max(axis=1, initial=0.0) > 0
        return self.data.efc_pos[touched], jacobian[touched]

    def closed(
        self, qpos: Float[np.ndarray, " nq"], free: Int[np.ndarray, " f"]
    ) -> Float[np.ndarray, " nq"] | None:
        """Finds the nearest pose with closed loops by Gauss-Newton steps of some degrees of
        freedom; None if a gap remains."""
        for _ in range(_STEPS):
            gap, jacobian = self.rows(qpos, free)
            step = np.zeros(self.model.nv)
            step[free] = -np.linalg.lstsq(jacobian, gap, rcond=_RANK)[0]
            qpos = qpos.copy()
            mujoco.mj_integratePos(self.model, qpos, step, 1.0)
            if np.abs(step).max(initial=0.0) < _STILL:
                break
        gap, _ = self.rows(qpos, free)
        return qpos if np.abs(gap).max(initial=0.0) < _OPEN else None

    def pose(self, qpos: Float[np.ndarray, " nq"]) -> Pose:
        """Returns the pose with given positions of the model's joints."""
        self.data.qpos[:] = qpos
        mujoco.mj_kinematics(self.model, self.data)
        return Pose(qpos, self.data.xmat.reshape(-1, 3, 3).copy())


def _stem(one: str, other: str) -> str:
    """The beginning that two names have in common, without separators at its end."""
    same = itertools.takewhile(lambda pair: pair[0] == pair[1], zip(one, other, strict=False))
    return "".join(a for a, _ in same).rstrip("_-. ")
