"""The search for one pose: many starts descend, the best are finished.

All here is for one hand. Poses are of the actuated joints; couplings come in by
``hand.coupling_matrix``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal, TypeAlias

import jax
import jax.numpy as jnp
import nlopt
import numpy as np
from jaxtyping import Array, Float

from smooth_operator.baselines.slsqp import LINE_SEARCH_FAILED
from smooth_operator.hands.capsules import CapsulePairs, capsule_pairs, segments_apart
from smooth_operator.hands.collision import penetration_depths
from smooth_operator.hands.differential import PointKinematics
from smooth_operator.hands.hand import Hand
from smooth_operator.metrics.accuracy import PINCH_DISTANCE, cosines
from smooth_operator.metrics.safety import COLLISION_DEPTH
from smooth_operator.metrics.trace import keyvectors
from smooth_operator.objective.keyvectors import KeyvectorLayout

Aim: TypeAlias = Literal["thumb", "all"]
"""Which mean cosine is brought as high as it goes: of the thumb's keyvectors, or of all."""

SECOND = 0.01
"""Weight of the mean cosine that is not optimised: decides among equals."""
SIZE = 1e-3
"""Weight of thumb vectors' lengths, in squares of 50 mm: the same."""
ELASTIC = 10.0
"""Cost of each millimetre that a gap is too wide: far above what it could gain in cosine."""
BLOCK = 256
"""Poses that descend together."""
STEPS = 200
MARGIN = 2e-5
"""How far inside the limits the search aims, so that its end is within them [m]."""
EVALUATIONS = 60
FTOL = 1e-6


@dataclass(frozen=True, eq=False)
class Search:
    """The search for one hand.

    Attributes:
        hand: the robot hand.
        depth: how deep parts may be in each other [m].
    """

    hand: Hand
    depth: float = COLLISION_DEPTH

    @cached_property
    def layout(self) -> KeyvectorLayout:
        """Which keyvectors there are."""
        return KeyvectorLayout(self.hand.fingers)

    @cached_property
    def pairs(self) -> CapsulePairs:
        """Parts of the hand that may touch each other."""
        return capsule_pairs(self.hand)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Fingertips, then ends of capsules."""
        return (*self.hand.tip_names, *self.pairs.names)

    @cached_property
    def low(self) -> np.ndarray:
        """Lower joint limits [rad]."""
        return np.asarray(self.hand.limits[:, 0], float)

    @cached_property
    def high(self) -> np.ndarray:
        """Upper joint limits [rad]."""
        return np.asarray(self.hand.limits[:, 1], float)

    @property
    def thumb(self) -> slice:
        """Keyvectors from the thumb to the other tips."""
        return self.layout.thumb

    def weights(self, aim: Aim) -> Float[np.ndarray, " K"]:
        """Of each keyvector's cosine in what is sought."""
        count = len(self.layout.vectors)
        if aim == "all":
            return np.full(count, 1 / count)
        weights = np.zeros(count)
        weights[self.thumb] = 1 / len(weights[self.thumb])
        return weights

    def priced(self, aim: Aim) -> Array:
        """(K,) weights with what decides among equals."""
        other: Aim = "thumb" if aim == "all" else "all"
        return jnp.asarray(self.weights(aim) + SECOND * self.weights(other), jnp.float32)

    def caps(self, human: Float[np.ndarray, "T K 3"], gap: float) -> Float[np.ndarray, "T P"]:
        """Longest that each thumb vector may be [m]; infinite where the human does not pinch."""
        length = np.linalg.norm(human[:, self.thumb], axis=-1)
        return np.where(length < PINCH_DISTANCE, length + gap, np.inf)

    # -- many starts --------------------------------------------------------------------------

    def explore(
        self,
        aim: Aim,
        human: Float[np.ndarray, "T K 3"],
        gap: float,
        poses: Float[np.ndarray, "T S m"],
        starts: int,
        keep: int,
        rng: np.random.Generator,
    ) -> list[list[np.ndarray]]:
        """For each frame the most promising ends of many descents."""
        count, joints = len(human), self.low.size
        share = np.clip((poses - self.low) / (self.high - self.low), 0.01, 0.99)
        # by start, so that the first of many are those of few
        u = np.moveaxis(rng.normal(0.0, 1.5, (starts, count, joints)), 0, 1)
        logits = np.log(share / (1 - share))
        took = min(logits.shape[1], starts)
        u[:, :took] = logits[:, :took]
        around = np.arange(took, starts, 4)  # a quarter of the others lie around them
        if took:
            u[:, around] = logits[:, around // 4 % took] + 0.7 * u[:, around]
        flat = np.repeat(np.arange(count), starts)
        caps = np.minimum(self.caps(human, gap), 1.0)
        ends, merits = np.empty((count * starts, joints)), np.empty((2, count * starts))
        for begin in range(0, count * starts, BLOCK):
            rows = np.arange(begin, min(begin + BLOCK, count * starts))
            padded = np.resize(rows, BLOCK)
            arrays = (u.reshape(-1, joints)[padded], human[flat[padded]], caps[flat[padded]])
            q, merit = self._descend(*(jnp.asarray(np.moveaxis(a, 0, -1), jnp.float32)
                                       for a in arrays), self.priced(aim))  # fmt: skip
            ends[rows] = np.asarray(q).T[: len(rows)]
            merits[:, rows] = np.asarray(merit)[:, : len(rows)]
        out = []
        for t in range(count):
            mine = ends[flat == t]
            orders = np.argsort(-merits[:, flat == t], axis=1)  # by turns: bold, and within limits
            chosen: list[np.ndarray] = []
            for k in orders.T.ravel():
                if all(abs(mine[k] - other).max() > 0.05 for other in chosen):
                    chosen.append(mine[k])
                if len(chosen) == keep:
                    break
            out.append(chosen)
        return out

    @cached_property
    def _descend(self) -> Callable[..., Any]:
        """Adam on logits of the limits: (m, B), (K, 3, B), (P, B), (K,) -> (m, B), (2, B)."""
        low, high = (jnp.asarray(a, jnp.float32)[:, None] for a in (self.low, self.high))

        def terms(u: Array, human: Array, caps: Array, weights: Array) -> tuple[Array, Array]:
            vectors, depths = self._look(low + (high - low) * jax.nn.sigmoid(u))
            loss, length = self._loss(vectors, human, weights[:, None], axis=1)
            over = jnp.concatenate([depths - self.depth, length[self.thumb] - caps]) + MARGIN
            return loss, jnp.maximum(over, 0.0) * 1e3

        def costs(u: Array, human: Array, caps: Array, weights: Array, price: Array) -> Array:
            loss, over = terms(u, human, caps, weights)
            return (loss + price * (over * over).sum(0)).sum()

        def descend(u: Array, human: Array, caps: Array, weights: Array) -> tuple[Array, Array]:
            def step(i: Array, state: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
                u, mean, square = state
                share = i / STEPS
                slope = jax.grad(costs)(u, human, caps, weights, 0.01 * 1000.0**share)
                mean, square = 0.9 * mean + 0.1 * slope, 0.98 * square + 0.02 * slope * slope
                rate = 0.15 * (1 - share) + 0.003
                scale = jnp.sqrt(square / (1 - 0.98 ** (i + 1.0))) + 1e-8
                return u - rate * mean / (1 - 0.9 ** (i + 1.0)) / scale, mean, square

            zero = jnp.zeros_like(u)
            u, _, _ = jax.lax.fori_loop(0, STEPS, step, (u, zero, zero))
            loss, over = terms(u, human, caps, weights)
            merits = jnp.stack([-loss - price * over.max(0) for price in (0.1, ELASTIC)])
            return low + (high - low) * jax.nn.sigmoid(u), merits

        return jax.jit(descend)

    def _look(self, q: Float[Array, "m B"]) -> tuple[Float[Array, "K 3 B"], Float[Array, "P B"]]:
        """Keyvectors, and how deep each pair is in each other, of many poses [m]."""
        rows = self.pairs.tree.forward_kinematics(
            self.hand.full_configuration_rows(list(q)), self.names, within_limits=True
        )
        points = jnp.stack([
            jnp.stack([jnp.broadcast_to(jnp.asarray(c, q.dtype), q[0].shape) for c in point])
            for point in rows
        ])  # fmt: skip
        tips, ends = points[: len(self.hand.fingers)], points[len(self.hand.fingers) :]
        wrist = jnp.broadcast_to(jnp.asarray(self.hand.wrist, q.dtype)[:, None], tips[0].shape)
        vectors = self.layout.among([p.T for p in (wrist, *tips)])  # (B, K, 3)
        depths = jax.vmap(self._depths, in_axes=-1, out_axes=-1)(ends)[0]
        return jnp.moveaxis(vectors, 0, -1), depths

    def _depths(
        self, ends: Float[Array, "E 3"]
    ) -> tuple[Float[Array, " P"], Float[Array, "P 3"], tuple[Array, Array]]:
        """How deep each pair is in each other [m], its direction, the shares that are nearest."""
        first, second = self.pairs.pairs.T
        one, other = ((ends[2 * c], ends[2 * c + 1]) for c in (first, second))
        apart, s, t = segments_apart(one, other)
        distance = jnp.sqrt((apart * apart).sum(-1) + 1e-12)
        reach = jnp.asarray(self.pairs.reach, ends.dtype)
        return reach - distance, -apart / distance[:, None], (s, t)

    def _loss(self, vectors: Array, human: Array, weights: Array, axis: int) -> tuple[Array, Array]:
        """What is brought down, and the lengths [m]."""
        length = jnp.sqrt((vectors * vectors).sum(axis) + 1e-12)
        human_length = jnp.sqrt((human * human).sum(axis) + 1e-12)
        cosine = (vectors * human).sum(axis) / (length * human_length)
        size = ((length - human_length)[self.thumb] / 0.05) ** 2
        return (weights * (1 - cosine)).sum(0) + SIZE * size.mean(0), length

    # -- finishing ----------------------------------------------------------------------------

    @cached_property
    def _kinematics(self) -> PointKinematics:
        return PointKinematics(self.pairs.tree, self.names)

    @cached_property
    def _local(self) -> Callable[[Array, Array, Array], Array]:
        """(m,), (K, 3), (K,) -> (1 + P + F - 1, 1 + m): loss, depths, lengths; derivatives."""
        fingers = len(self.hand.fingers)
        first, second = self.pairs.pairs.T

        def local(q: Array, human: Array, weights: Array) -> Array:
            matrix, offset = (
                jnp.asarray(a, q.dtype)
                for a in (self.hand.coupling_matrix, self.hand.coupling_offset)
            )
            motion = self._kinematics(matrix @ q + offset)
            spread = matrix[np.array(self._kinematics.order)]
            jacobian = jnp.einsum("fjc,jm->fcm", self._kinematics.jacobian(motion), spread)
            wrist = jnp.asarray(self.hand.wrist, q.dtype)
            vectors = self.layout.among([wrist, *motion.points[:fingers]])
            moved = self.layout.among(
                [jnp.zeros((3, len(q))).T, *jnp.swapaxes(jacobian[:fingers], 1, 2)]
            )
            (loss, length), back = jax.vjp(lambda v: self._loss(v, human, weights, -1), vectors)
            (slope,) = back((jnp.ones_like(loss), jnp.zeros_like(length)))
            gradient = jnp.einsum("kc,mkc->m", slope, moved)
            unit = vectors / length[:, None]
            longer = jnp.einsum("kc,mkc->km", unit, moved)[self.thumb]
            depths, direction, (s, t) = self._depths(motion.points[fingers:])
            ends = jacobian[fingers:]
            s, t = s[:, None, None], t[:, None, None]
            apart = (
                (1 - s) * ends[2 * first] + s * ends[2 * first + 1]
                - (1 - t) * ends[2 * second] - t * ends[2 * second + 1]
            )  # fmt: skip
            deeper = jnp.einsum("pc,pcm->pm", direction, apart)
            values = jnp.concatenate([loss[None], depths, length[self.thumb]])
            return jnp.concatenate(
                [values[:, None], jnp.concatenate([gradient[None], deeper, longer])], axis=1
            )

        return jax.jit(local)

    def finish(
        self,
        aim: Aim,
        human: Float[np.ndarray, "K 3"],
        caps: Float[np.ndarray, " P"],
        start: Float[np.ndarray, " m"],
        depth: float,
    ) -> Float[np.ndarray, " m"]:
        """The local optimum that SLSQP goes to from a start, limits kept by the capsules."""
        target, weights = jnp.asarray(human, jnp.float32), self.priced(aim)
        limit = np.concatenate([np.full(len(self.pairs.pairs), depth), caps]) - MARGIN
        start = np.clip(start, self.low, self.high)
        last: tuple[bytes, np.ndarray] = (b"", np.empty(0))
        best, lowest = start, np.inf  # for when it ends in a line search that fails

        def at(x: np.ndarray) -> np.ndarray:
            nonlocal last, best, lowest
            if x.tobytes() != last[0]:
                local = np.asarray(self._local(jnp.asarray(x, jnp.float32), target, weights), float)
                last = (x.tobytes(), local)
                merit = local[0, 0] + 1e3 * ELASTIC * (local[1:, 0] - limit).max(initial=0.0)
                if merit < lowest:
                    best, lowest = x.copy(), merit
            return last[1]

        over = at(start)[1:, 0] - limit
        near = np.flatnonzero(over > -0.015)  # others are too far to be met from here

        count = len(start)
        slack = near >= len(self.pairs.pairs)  # a gap may be too wide, at its cost

        def value(x: np.ndarray, gradient: np.ndarray) -> float:
            if gradient.size:
                gradient[:count], gradient[count] = at(x[:count])[0, 1:], ELASTIC
            return float(at(x[:count])[0, 0] + ELASTIC * x[count])

        def broken(out: np.ndarray, x: np.ndarray, gradient: np.ndarray) -> None:
            rows = at(x[:count])[1:][near]
            out[:] = 1e2 * (rows[:, 0] - limit[near]) - 0.1 * slack * x[count]
            if gradient.size:
                gradient[:, :count], gradient[:, count] = 1e2 * rows[:, 1:], -0.1 * slack

        solver = nlopt.opt(nlopt.LD_SLSQP, count + 1)
        solver.set_lower_bounds(np.append(self.low, 0.0))
        solver.set_upper_bounds(np.append(self.high, 1e3))
        solver.set_min_objective(value)
        if len(near):
            solver.add_inequality_mconstraint(broken, np.full(len(near), 1e-4))
        solver.set_ftol_abs(FTOL)
        solver.set_maxeval(EVALUATIONS)
        wide = 1e3 * over[len(self.pairs.pairs) :].max(initial=0.0)
        try:
            end = solver.optimize(np.append(start, wide))[:count]
        except LINE_SEARCH_FAILED:
            end = best
        return np.asarray(np.clip(end if np.isfinite(end).all() else best, self.low, self.high))

    def check(
        self,
        aim: Aim,
        poses: Float[np.ndarray, "N m"],
        human: Float[np.ndarray, "N K 3"],
        caps: Float[np.ndarray, "N P"],
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """What was sought, and by how much depth and gaps are above their limits [m]: exactly."""
        every = self.hand.full_configuration(np.clip(poses, self.low, self.high))
        robot = keyvectors(self.hand.tips(every), np.broadcast_to(self.hand.wrist, (len(poses), 3)))
        depth = penetration_depths(self.hand, every)
        deep = np.zeros(len(poses)) if depth is None else depth - self.depth
        wide = np.linalg.norm(robot[:, self.thumb], axis=-1) - caps
        return cosines(human, robot) @ self.weights(aim), deep, wide.max(axis=1)
