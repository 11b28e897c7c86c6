"""Transmission of a hand: positions of all joints as a function of the actuated ones.

::

    q_all = p(A q + b)

An actuated joint has a row of the identity in A, and a joint that follows it through a gear has the
gear ratio. p is the identity except for a joint that follows its leader by a polynomial, such as
one in a four-bar linkage; the row of A then selects the leader.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise
from typing import TypeAlias

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from numpy.polynomial import Polynomial
from numpy.typing import ArrayLike

from smooth_operator.errors import HandModelError
from smooth_operator.geometry import AnyKind
from smooth_operator.hands.spec import Coupling

_FAR = 1e3  # stands for an infinite limit [rad]

Coefficients: TypeAlias = tuple[float, ...]
"""Coefficients of a polynomial, constant first."""


@dataclass(frozen=True, eq=False)
class Transmission:
    """Positions of all n joints as a function of the m actuated ones: q_all = p(A q + b).

    Attributes:
        matrix: (n, m) A. A nonzero entry means that the actuated joint moves the joint.
        offset: (n,) b [rad].
        curves: index of a joint that follows by a polynomial -> the polynomial; p is the identity
            for other joints.
    """

    matrix: Float[np.ndarray, "n m"]
    offset: Float[np.ndarray, " n"]
    curves: Mapping[int, Coefficients] = field(default_factory=dict)

    def positions(self, q: ArrayLike) -> Float[np.ndarray, "*batch n"]:
        """(..., n) positions of all joints [rad] at (..., m) positions of the actuated ones."""
        linear: np.ndarray = np.asarray(q, float) @ self.matrix.T + self.offset
        return self.curved(linear)

    def slopes(self, q: ArrayLike) -> Float[np.ndarray, "*batch n m"]:
        """(..., n, m) derivatives of all joint positions with respect to the actuated joints. For a
        hand without curves, returns the constant (n, m) matrix."""
        if not self.curves:
            return self.matrix
        linear = np.asarray(q, float) @ self.matrix.T + self.offset
        slopes: np.ndarray = self.curved(linear, 1)[..., None] * self.matrix
        return slopes

    def rows(self, q: Sequence[Array]) -> list[Array]:
        """``positions`` from m arrays of one shape (batch axis last), in a compiled program."""
        rows: list[Array] = []
        for i, (weights, constant) in enumerate(zip(self.matrix, self.offset, strict=True)):
            (used,) = np.nonzero(weights)
            row: Array | float = float(constant)
            for k in used:
                term = q[int(k)] if weights[k] == 1 else float(weights[k]) * q[int(k)]
                row = term if isinstance(row, float) and row == 0 else row + term
            if i in self.curves:
                row = _polynomial(self.curves[i], row)
            rows.append(jnp.full_like(q[0], row) if isinstance(row, float) else row)
        return rows

    def curved(
        self, linear: Float[AnyKind, "*batch n"], derivative: int = 0
    ) -> Float[AnyKind, "*batch n"]:
        """Evaluates the polynomial p, or its derivative p' or p'', of each joint at A q + b; NumPy
        or JAX. For a hand without curves, positions are returned as they are."""
        if not self.curves and derivative == 0:
            return linear
        table = self._tables[derivative].astype(linear.dtype)
        value: AnyKind = table[-1] + 0.0 * linear
        for row in table[-2::-1]:
            value = value * linear + row
        return value

    @cached_property
    def _tables(self) -> tuple[np.ndarray, ...]:
        """(d, n) coefficients of p, p' and p'', constants first."""
        identity = (0.0, 1.0)
        every = [Polynomial(self.curves.get(i, identity)) for i in range(len(self.offset))]
        degree = max(each.degree() for each in every)
        return tuple(
            np.stack([_padded(each.deriv(order).coef, degree + 1) for each in every], axis=1)
            for order in range(3)
        )


def build_transmission(
    names: Sequence[str],
    actuated: Sequence[int],
    couplings: Sequence[Coupling],
    held: Mapping[str, float],
) -> Transmission:
    """Builds the transmission from a hand's couplings.

    Args:
        names: names of all joints.
        actuated: indices of the actuated ones.
        couplings: joints that follow another one, in any order; a follower may follow a follower.
        held: positions of joints outside the hand [rad]; a joint that follows one is held too.

    Raises:
        HandModelError: joints follow each other in a ring, or a joint that nothing drives.
    """
    matrix, offset = np.zeros((len(names), len(actuated))), np.zeros(len(names))
    curves: dict[int, Coefficients] = {}
    done = set(actuated)
    matrix[list(actuated), range(len(actuated))] = 1
    pending = []
    for c in couplings:
        if c.follows in held:
            i = names.index(c.joint)
            offset[i] = c.at(held[c.follows])
            done.add(i)
        else:
            pending.append(c)
    while pending:
        ready = [c for c in pending if names.index(c.follows) in done]
        if not ready:
            raise HandModelError(
                f"joints {[c.joint for c in pending]} follow joints that nothing drives"
            )
        for c in ready:
            i, k = names.index(c.joint), names.index(c.follows)
            if (c.higher or k in curves) and matrix[k].any():
                # the leader's own polynomial of its actuated joint, inside this one
                (root,) = np.flatnonzero(matrix[k])
                inner = curves.get(k, (float(offset[k]), float(matrix[k, root])))
                whole = Polynomial(c.coefficients)(Polynomial(inner))
                matrix[i, root], curves[i] = 1.0, tuple(map(float, whole.coef))
            elif c.higher:  # of a joint that is held
                offset[i] = c.at(float(offset[k]))
            else:
                matrix[i] = c.multiplier * matrix[k]
                offset[i] = c.multiplier * offset[k] + c.offset
            done.add(i)
            pending.remove(c)
    return Transmission(matrix, offset, curves)


def leader_range(
    coefficients: Coefficients, leader: Float[np.ndarray, "2"], own: Float[np.ndarray, "2"]
) -> tuple[float, float]:
    """Ends of the widest part of a leader's limits in which its follower stays within its own
    limits [rad]. The lower end is above the upper end if there is no such part."""
    curve = Polynomial(coefficients)
    crossings = np.concatenate([(curve - end).roots() for end in own[np.isfinite(own)]] or [[]])
    real = crossings[np.isreal(crossings)].real
    low, high = leader
    ends = np.array([low, *np.sort(real[(real > low) & (real < high)]), high])
    parts: list[tuple[float, float]] = []
    for a, b in pairwise(ends.tolist()):
        middle = float(curve(np.clip([a, b], -_FAR, _FAR).mean()))
        if not own[0] <= middle <= own[1]:
            continue
        if parts and parts[-1][1] == a:
            parts[-1] = (parts[-1][0], b)
        else:
            parts.append((a, b))
    return max(parts, key=lambda part: part[1] - part[0], default=(np.inf, -np.inf))


def _polynomial(coefficients: Coefficients, x: Array | float) -> Array | float:
    value: Array | float = coefficients[-1]
    for c in coefficients[-2::-1]:
        value = value * x + c
    return value


def _padded(values: np.ndarray, length: int) -> np.ndarray:
    return np.concatenate([values, np.zeros(length - len(values))])
