"""A model as a skeleton that can be posed: joints, limits, couplings, points of shapes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

import mujoco
import numpy as np
from jaxtyping import Float

from smooth_operator.errors import HandModelError
from smooth_operator.hands.loading import Coupling


@dataclass(frozen=True, eq=False)
class Placement:
    """Places of all parts in one pose, in the world frame [m].

    Attributes:
        bodies: (nbody, 3) origins.
        frames: (nbody, 3, 3) rotations, body to world.
        anchors: (njnt, 3) a point on each joint's axis.
        axes: (njnt, 3) unit axes.
        sites: (nsite, 3) positions.
    """

    bodies: Float[np.ndarray, "b 3"]
    frames: Float[np.ndarray, "b 3 3"]
    anchors: Float[np.ndarray, "j 3"]
    axes: Float[np.ndarray, "j 3"]
    sites: Float[np.ndarray, "s 3"]

    def world(self, body: int, points: np.ndarray) -> np.ndarray:
        """Points of a body's frame, (..., 3), in the world."""
        moved: np.ndarray = points @ self.frames[body].T + self.bodies[body]
        return moved

    def local(self, body: int, points: np.ndarray) -> np.ndarray:
        """Points of the world, (..., 3), in a body's frame."""
        moved: np.ndarray = (points - self.bodies[body]) @ self.frames[body]
        return moved


@dataclass(frozen=True, eq=False)
class Skeleton:
    """A compiled model, and what its shapes and couplings say.

    Attributes:
        model: the compiled model.
        couplings: joints that follow another.
        clouds: body -> its shapes, each (p, 3) points on it in the body's frame [m].
        pinned: joint -> its limits, where the file has the upper equal to the lower; MuJoCo takes
            it for a joint without limits.
    """

    model: mujoco.MjModel
    couplings: tuple[Coupling, ...]
    clouds: Mapping[int, tuple[np.ndarray, ...]]
    pinned: Mapping[str, float] = field(default_factory=dict)

    @cached_property
    def joint_names(self) -> tuple[str, ...]:
        """All joints, in the model's order."""
        return tuple(self.model.joint(j).name for j in range(self.model.njnt))

    @cached_property
    def limits(self) -> Float[np.ndarray, "n 2"]:
        """Limits [rad or m]; infinite where a joint has none."""
        limited = self.model.jnt_limited.astype(bool)[:, None]
        ranges = np.asarray(self.model.jnt_range, np.float64)
        return np.where(limited, ranges, np.array([-np.inf, np.inf]))

    @cached_property
    def turns(self) -> np.ndarray:
        """(n,) whether a joint is a hinge."""
        return np.asarray(self.model.jnt_type == int(mujoco.mjtJoint.mjJNT_HINGE))

    @cached_property
    def moves(self) -> np.ndarray:
        """(n,) whether a joint has one degree of freedom, a hinge or slide."""
        slides = np.asarray(self.model.jnt_type == int(mujoco.mjtJoint.mjJNT_SLIDE))
        moves: np.ndarray = self.turns | slides
        return moves

    @cached_property
    def bounded(self) -> np.ndarray:
        """(n,) whether a joint has finite limits."""
        bounded: np.ndarray = self.moves & np.isfinite(self.limits).all(axis=1)
        return bounded

    @cached_property
    def leaders(self) -> Mapping[int, tuple[int, float, float]]:
        """Follower -> (joint that it follows, multiplier, offset), chains of them resolved."""
        index = {name: j for j, name in enumerate(self.joint_names)}
        direct: dict[int, tuple[int, float, float]] = {}
        for c in self.couplings:
            if c.joint not in index or c.follows not in index:
                absent = c.joint if c.joint not in index else c.follows
                raise HandModelError(
                    f"joint {c.joint!r} is said to follow {c.follows!r}, but the model has no "
                    f"joint {absent!r}; mend the name in the file's mimic or equality element"
                )
            direct[index[c.joint]] = (index[c.follows], c.multiplier, c.offset)
        resolved = {}
        for joint in direct:
            leader, gain, offset = direct[joint]
            visited = {joint}
            while leader in direct:
                if leader in visited:
                    raise HandModelError(
                        f"joint {self.joint_names[joint]!r} follows itself through others; "
                        "remove one of the couplings from the file"
                    )
                visited.add(leader)
                leader, further, shift = direct[leader]
                offset += gain * shift
                gain *= further
            resolved[joint] = (leader, gain, offset)
        return resolved

    @cached_property
    def reference(self) -> Float[np.ndarray, " n"]:
        """All joints at zero, or where that is out of limits at the nearest one."""
        low, high = self.limits.T
        return self.coupled(np.clip(np.zeros(len(low)), low, high))

    def coupled(self, q: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """The pose with followers where their leaders put them, within their limits."""
        out = np.array(q, float)
        for joint, (leader, gain, offset) in self.leaders.items():
            out[joint] = np.clip(gain * q[leader] + offset, *self.limits[joint])
        return out

    def posed(self, named: Mapping[str, float]) -> Float[np.ndarray, " n"]:
        """The reference pose with some joints elsewhere, and those that follow them."""
        q = self.reference.copy()
        q[[self.joint_names.index(name) for name in named]] = list(named.values())
        return self.coupled(q)

    def free(self, joints: tuple[int, ...]) -> tuple[int, ...]:
        """The joints that decide about these: followers replaced by their leaders, each once."""
        leaders = [self.leaders[j][0] if j in self.leaders else j for j in joints]
        return tuple(dict.fromkeys(leaders))

    def place(self, q: Float[np.ndarray, " n"]) -> Placement:
        """Poses the model; joints that are no hinge or slide stay where they start."""
        data = self._data
        data.qpos[:] = self.model.qpos0
        single = np.flatnonzero(self.moves)
        data.qpos[self.model.jnt_qposadr[single]] = q[single]
        mujoco.mj_kinematics(self.model, data)
        return Placement(
            data.xpos.copy(),
            data.xmat.reshape(-1, 3, 3).copy(),
            data.xanchor.copy(),
            data.xaxis.copy(),
            data.site_xpos.copy(),
        )

    @cached_property
    def _data(self) -> mujoco.MjData:
        return mujoco.MjData(self.model)

    def body_name(self, body: int) -> str:
        """Name of a body."""
        return str(self.model.body(body).name)

    def path(self, body: int) -> tuple[int, ...]:
        """Bodies from the world (left out) down to this one."""
        out = []
        while body > 0:
            out.append(body)
            body = int(self.model.body_parentid[body])
        return tuple(reversed(out))

    def joints_of(self, body: int) -> tuple[int, ...]:
        """Joints between a body and its parent."""
        first = int(self.model.body_jntadr[body])
        return tuple(range(first, first + int(self.model.body_jntnum[body])))

    def rigid(self, body: int) -> tuple[int, ...]:
        """Bodies that move as one with this one, itself included."""
        weld = self.model.body_weldid
        return tuple(int(b) for b in np.flatnonzero(weld == weld[body]))
