"""A function of one example as a function of many side by side, the lanes, along the first axis.

It is ``jax.vmap`` but for loops and branches. There, ``vmap`` works out both sides of a branch that
depends on the example, in every lane; here a side is worked out only if a lane needs it. And
``active`` says which lanes count at all: loops and branches that only other lanes need are left
out, and what those lanes hold afterwards means nothing.

No operation of one lane reads another. So the result of a lane depends on the number of lanes, for
which the program is compiled, and not on what the other lanes hold.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import jax
import jax.numpy as jnp
from jax import lax
from jax.extend.core import ClosedJaxpr, Jaxpr, JaxprEqn, Literal, jaxpr_as_fun
from jaxtyping import Array, Bool

_BRANCHING: Final = ("while", "cond")


@dataclass(frozen=True)
class _Value:
    """A value of the program, and whether it has lanes; without them it is the same in all."""

    of: Any
    lanes: bool


def over_lanes(function: Callable[..., Any], *examples: Any) -> Callable[..., Any]:
    """The same function over lanes.

    Args:
        function: of arrays or trees of them; traceable, without side effects.
        examples: its arguments for one lane; only shapes and types are read.

    Returns:
        a traceable function of (active, *arguments), where each leaf has one more axis, the first.
        (L,) ``active`` says which lanes count.
    """
    closed, shape = jax.make_jaxpr(function, return_shape=True)(*examples)
    structure = jax.tree.structure(shape)

    def many(active: Bool[Array, " L"], *arguments: Any) -> Any:
        run = _Lanes(active)
        found = run.closed(closed, [_Value(leaf, True) for leaf in jax.tree.leaves(arguments)])
        return jax.tree.unflatten(structure, run.spread(found))

    return many


@dataclass(frozen=True, eq=False)
class _Straight:
    """Operations without branches that follow each other; they are mapped together.

    Attributes:
        eqns: the operations.
    """

    eqns: list[JaxprEqn] = field(default_factory=list)

    def run(self, at: dict[Any, _Value], wanted: set[Any]) -> None:
        """Adds to the values what later operations want of these."""
        if not self.eqns:
            return
        made = {var for eqn in self.eqns for var in eqn.outvars}
        used = [a for eqn in self.eqns for a in eqn.invars if not isinstance(a, Literal)]
        given = list(dict.fromkeys(var for var in used if var not in made))
        results = [var for eqn in self.eqns for var in eqn.outvars if var in wanted]

        def straight(*values: Any) -> list[Any]:
            here = dict(zip(given, values, strict=True))
            for eqn in self.eqns:
                here.update(_applied(eqn, [_read(here, atom) for atom in eqn.invars]))
            return [here[var] for var in results]

        values = [at[var] for var in given]
        axes = tuple(0 if value.lanes else None for value in values)
        found = jax.vmap(straight, in_axes=axes)(*(value.of for value in values))
        at.update((var, _Value(of, True)) for var, of in zip(results, found, strict=True))
        self.eqns.clear()


class _Lanes:
    """Runs a traced function over lanes.

    Args:
        active: (L,) which lanes count.
    """

    def __init__(self, active: Bool[Array, " L"]) -> None:
        self.active = active

    def spread(self, values: Sequence[_Value]) -> list[Array]:
        """The values of each lane, also where all have the same."""
        count = len(self.active)
        return [
            jnp.asarray(v.of) if v.lanes else jnp.broadcast_to(v.of, (count, *jnp.shape(v.of)))
            for v in values
        ]

    def closed(self, closed: ClosedJaxpr, values: Sequence[_Value]) -> list[_Value]:
        """The results of a traced function."""
        jaxpr = closed.jaxpr
        at = {
            var: _Value(of, False) for var, of in zip(jaxpr.constvars, closed.consts, strict=True)
        }
        at.update(zip(jaxpr.invars, values, strict=True))
        wanted = _wanted(jaxpr)
        straight = _Straight()

        def read(atom: Any) -> _Value:
            return _Value(atom.val, False) if isinstance(atom, Literal) else at[atom]

        for eqn in jaxpr.eqns:
            known = [isinstance(a, Literal) or (a in at and not at[a].lanes) for a in eqn.invars]
            if all(known):
                made = _applied(eqn, [read(atom).of for atom in eqn.invars])
                at.update((var, _Value(of, False)) for var, of in made.items())
            elif not _branches(eqn):
                straight.eqns.append(eqn)
            else:
                straight.run(at, wanted)
                found = self._apply(eqn, list(map(read, eqn.invars)))
                at.update(zip(eqn.outvars, found, strict=True))
        straight.run(at, wanted)
        return [read(atom) for atom in jaxpr.outvars]

    def _apply(self, eqn: JaxprEqn, values: list[_Value]) -> list[_Value]:
        """The results of an operation with branches."""
        params = eqn.params
        if eqn.primitive.name == "while":
            return self._while(params, values)
        if eqn.primitive.name == "cond":
            return self._cond(params, values)
        if eqn.primitive.name == "scan":
            return self._scan(params, values)
        called = _called(eqn)
        assert called is not None  # what else would have branches
        return self.closed(called, values)

    def _scan(self, params: Any, values: list[_Value]) -> list[_Value]:
        closed: ClosedJaxpr = params["jaxpr"]
        fixed, carried = params["num_consts"], params["num_carry"]
        consts = values[:fixed]
        rows = [jnp.moveaxis(of, 0, 1) for of in self.spread(values[fixed + carried :])]

        def body(state: list[Any], row: list[Any]) -> tuple[list[Any], list[Any]]:
            given = [*consts, *(_Value(of, True) for of in (*state, *row))]
            made = self.spread(self.closed(closed, given))
            return made[:carried], made[carried:]

        state, stacked = lax.scan(
            body,
            self.spread(values[fixed : fixed + carried]),
            rows,
            length=params["length"],
            reverse=params["reverse"],
            unroll=params["unroll"],
        )
        return [_Value(of, True) for of in (*state, *(jnp.moveaxis(s, 0, 1) for s in stacked))]

    def _while(self, params: Any, values: list[_Value]) -> list[_Value]:
        condition, inner = params["cond_jaxpr"], params["body_jaxpr"]
        first, second = params["cond_nconsts"], params["body_nconsts"]
        asks, consts = values[:first], values[first : first + second]

        def goes_on(state: list[Any]) -> Any:
            given = [*asks, *(_Value(of, True) for of in state)]
            return self.spread(self.closed(condition, given))[0]

        def body(now: tuple[Any, list[Any]]) -> tuple[Any, list[Any]]:
            on, state = now
            made = self.spread(self.closed(inner, [*consts, *(_Value(of, True) for of in state)]))
            after = chosen(on, made, state)
            return on & goes_on(after), after

        start = self.spread(values[first + second :])
        _, state = lax.while_loop(
            lambda now: now[0].any(), body, (self.active & goes_on(start), start)
        )
        return [_Value(of, True) for of in state]

    def _cond(self, params: Any, values: list[_Value]) -> list[_Value]:
        (index,), operands = self.spread(values[:1]), values[1:]
        branches: Sequence[ClosedJaxpr] = params["branches"]
        # A branch without any work is a value; others are worked out only where a lane needs them.
        plain = next((i for i, b in enumerate(branches) if not b.jaxpr.eqns), 0)
        total = self.spread(self.closed(branches[plain], operands))
        for i, branch in enumerate(branches):
            if i != plain:
                wanted = (index.astype(jnp.int32) == i) & self.active

                def taken(
                    total: list[Any], wanted: Any = wanted, branch: ClosedJaxpr = branch
                ) -> list[Any]:
                    found = self.spread(self.closed(branch, operands))
                    return [chosen(wanted, *pair) for pair in zip(found, total, strict=True)]

                total = lax.cond(wanted.any(), taken, lambda total: total, total)
        return [_Value(of, True) for of in total]


def chosen(which: Bool[Array, " L"], new: Any, old: Any) -> Any:
    """New values in some lanes, old ones in the others; trees of arrays with the lanes first."""

    def one(a: Array, b: Array) -> Array:
        return jnp.where(which.reshape(-1, *[1] * (b.ndim - 1)), a, b)

    return jax.tree.map(one, new, old)


def _read(at: dict[Any, Any], atom: Any) -> Any:
    return atom.val if isinstance(atom, Literal) else at[atom]


def _applied(eqn: JaxprEqn, values: Sequence[Any]) -> dict[Any, Any]:
    """The results of an operation, by variable."""
    called = _called(eqn)
    if called is not None:  # written down elsewhere
        return dict(zip(eqn.outvars, jaxpr_as_fun(called)(*values), strict=True))
    found = eqn.primitive.bind(*values, **eqn.params)  # type: ignore[no-untyped-call]
    results = found if eqn.primitive.multiple_results else [found]
    return dict(zip(eqn.outvars, results, strict=True))


def _called(eqn: JaxprEqn) -> ClosedJaxpr | None:
    """The function that an operation is a call of; None for others."""
    if eqn.primitive.name in ("while", "cond", "scan"):
        return None
    called = eqn.params.get("jaxpr", eqn.params.get("call_jaxpr"))
    return called if isinstance(called, ClosedJaxpr) else None


def _branches(eqn: JaxprEqn) -> bool:
    """Whether an operation is a loop or branch by a condition, or holds one."""
    if eqn.primitive.name in _BRANCHING:
        return True
    inner = eqn.params.get("jaxpr", eqn.params.get("call_jaxpr"))
    return isinstance(inner, ClosedJaxpr) and any(map(_branches, inner.jaxpr.eqns))


def _wanted(jaxpr: Jaxpr) -> set[Any]:
    """Variables that an operation or the result reads."""
    atoms = [*(atom for eqn in jaxpr.eqns for atom in eqn.invars), *jaxpr.outvars]
    return {atom for atom in atoms if not isinstance(atom, Literal)}
