"""Operations of a program by kind, and the rate of each kind on this machine.

Run as a program it prints what the machine does: ``python research/benchmarks/arithmetic.py CORES``
keeps to that many cores (where the system lets it) and reports operations per second.
"""

from __future__ import annotations

import itertools
import json
import math
import os
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

FLOAT, CHOICE, INTEGER = "multiply or add", "compare, choose, convert", "integer"
LOGARITHM, ROOT, OTHER = "logarithm", "root or division", "other function"
KINDS = (FLOAT, CHOICE, INTEGER, LOGARITHM, ROOT, OTHER)

_SIMPLE = {"add": 1, "sub": 1, "mul": 1, "neg": 1, "square": 1, "add_any": 1}
_CHOICES = {"max", "min", "abs", "sign", "select_n", "lt", "le", "gt", "ge", "eq", "ne", "floor"}
_CHOICES |= {"convert_element_type", "is_finite", "and", "or", "not", "round", "clamp", "argmin"}
_ROOTS = {"sqrt", "rsqrt", "div"}
_FUNCTIONS = {"sin", "cos", "tan", "exp", "exp2", "log1p", "expm1", "tanh", "logistic", "pow"}
_FUNCTIONS |= {"atan2", "erf", "erf_inv"}


def operations(jaxpr: Any) -> Counter[str]:
    """Operations on single numbers in a traced program, by kind, loops multiplied out.

    Moving data is free here; a matrix product of inner length k counts 2 k per result; a choice of
    the best counts one comparison per candidate; a loop without a known length counts once.

    Args:
        jaxpr: from ``jax.make_jaxpr(f)(...)``.
    """
    total: Counter[str] = Counter()
    for equation in jaxpr.eqns:
        name = equation.primitive.name
        inner = list(_inner(equation))
        if inner:
            times = equation.params["length"] if name == "scan" else 1
            for body in inner[-1:] if name == "while" else inner[:1] if name == "cond" else inner:
                for kind, count in operations(body).items():
                    total[kind] += times * count
            continue
        if not equation.outvars:
            continue
        out, first = equation.outvars[0].aval, equation.invars[:1]
        size, read = out.size, (first[0].aval.size if first else 0)
        if name == "dot_general":
            (contracted, _), _ = equation.params["dimension_numbers"]
            total[FLOAT] += 2 * size * math.prod(first[0].aval.shape[i] for i in contracted)
        elif name == "cholesky":
            total[FLOAT] += size * out.shape[-1] // 3
        elif name == "triangular_solve":
            total[FLOAT] += size * first[0].aval.shape[-1]
        elif name.startswith("reduce_") or name.startswith("cum"):
            total[FLOAT if name in ("reduce_sum", "reduce_prod", "cumsum") else CHOICE] += read
        elif name in ("top_k", "sort", "argmax", "argmin"):
            total[CHOICE] += read
        elif name == "integer_pow":
            total[FLOAT] += size * max(1, int(abs(equation.params["y"])).bit_length() - 1)
        elif name == "log":
            total[LOGARITHM] += size
        elif name in _ROOTS:
            total[ROOT] += size
        elif name in _FUNCTIONS:
            total[OTHER] += size
        elif name in _CHOICES:
            total[CHOICE] += size * (2 if name == "clamp" else 1)
        elif name in _SIMPLE or name.startswith("shift_") or name == "xor":
            total[FLOAT if out.dtype.kind == "f" else INTEGER] += size
    return total


def _inner(equation: Any) -> Iterator[Any]:
    for value in equation.params.values():
        for item in value if isinstance(value, tuple | list) else (value,):
            body = getattr(item, "jaxpr", item)
            if hasattr(body, "eqns"):
                yield body


def rates(threads: int) -> dict[str, float]:
    """Attainable operations per second of each kind, with as many independent callers."""
    import jax
    import jax.numpy as jnp

    on_cpu = jax.devices()[0].platform == "cpu"
    size = 2048 if on_cpu else 2**20  # within the first-level cache; wide enough for an accelerator
    chains, rounds = 8, 20

    def kernel(
        step: Callable[[list[Any]], list[Any]], depth: int, dtype: Any
    ) -> Callable[[Any], Any]:
        def body(_: Any, x: Any) -> Any:
            rows = [x + jnp.asarray(i, dtype) for i in range(chains)]  # independent, to fill pipes
            for _ in range(depth):
                rows = step(rows)
            total = rows[0]
            for row in rows[1:]:
                total = total + row
            return total

        return jax.jit(lambda x: jax.lax.fori_loop(0, rounds, body, x))

    mix = jnp.uint32(0x7FEB352D)
    ramp = itertools.count(-1e6, 1.25)
    # step, operations per chain and step, depth, type
    kinds: dict[str, tuple[Callable[[list[Any]], list[Any]], int, int, Any]] = {
        FLOAT: (lambda rows: [r * 0.9990234 + 0.5 for r in rows], 2, 48, jnp.float32),
        # other thresholds in every step: a compiler must not see through it
        CHOICE: (
            lambda rows: [jnp.where(r < next(ramp), next(ramp), r) for r in rows],
            2,
            24,
            jnp.float32,
        ),
        INTEGER: (lambda rows: [(r ^ (r >> 15)) * mix for r in rows], 3, 16, jnp.uint32),
        LOGARITHM: (lambda rows: [jnp.log(r + 3.0) for r in rows], 1, 4, jnp.float32),
        ROOT: (lambda rows: [jnp.sqrt(r + 3.0) for r in rows], 1, 4, jnp.float32),
        OTHER: (lambda rows: [jnp.sin(r) for r in rows], 1, 2, jnp.float32),
    }
    figures = {}
    for name, (step, per_step, depth, dtype) in kinds.items():
        run = kernel(step, depth, dtype)
        x = jnp.ones(size, dtype)
        work = size * chains * depth * per_step * rounds
        figures[name] = work * _calls_per_second(partial(run, x), threads)
    figures["matrix product"] = _matrix_product(on_cpu)
    figures["bytes copied"] = _copying(on_cpu, threads)
    return figures


def _calls_per_second(call: Callable[[], Any], threads: int, seconds: float = 0.4) -> float:
    """Calls per second in the best of three rounds, which other load on the machine disturbs
    least."""
    call().block_until_ready()
    best = 0.0
    for _ in range(3):
        counts = [0] * threads
        stop = time.perf_counter() + seconds

        def work(i: int, counts: list[int] = counts, stop: float = stop) -> None:
            while time.perf_counter() < stop:
                call().block_until_ready()
                counts[i] += 1

        start = time.perf_counter()
        team = [threading.Thread(target=work, args=(i,)) for i in range(threads)]
        for member in team:
            member.start()
        for member in team:
            member.join()
        best = max(best, sum(counts) / (time.perf_counter() - start))
    return best


def _matrix_product(on_cpu: bool) -> float:
    """Operations per second of a large single-precision matrix product, the fastest of the
    library."""
    import jax.numpy as jnp
    import numpy as np

    size = 1024 if on_cpu else 8192
    a = np.ones((size, size), np.float32)
    on_device = None if on_cpu else jnp.asarray(a)

    def product() -> None:
        if on_device is None:
            a @ a
        else:
            jnp.dot(on_device, on_device, precision="highest").block_until_ready()

    return 2 * size**3 / _best(product)


def _copying(on_cpu: bool, threads: int) -> float:
    """Bytes per second, read and written, of copying arrays beyond every cache."""
    import jax
    import jax.numpy as jnp
    import numpy as np

    if not on_cpu:
        x = jnp.zeros(2**26, jnp.float32)
        add = jax.jit(lambda x: x + 1)
        return 2 * x.nbytes / _best(lambda: add(x).block_until_ready())
    pairs = [(np.ones(2**24, np.float32), np.ones(2**24, np.float32)) for _ in range(threads)]

    def copy_all() -> None:  # NumPy copies without holding the interpreter
        team = [threading.Thread(target=np.copyto, args=pair) for pair in pairs]
        for member in team:
            member.start()
        for member in team:
            member.join()

    return 2 * threads * pairs[0][0].nbytes / _best(copy_all)


def _best(call: Callable[[], object]) -> float:
    call()
    times = []
    for _ in range(7):
        start = time.perf_counter()
        call()
        times.append(time.perf_counter() - start)
    return min(times)


if __name__ == "__main__":
    wanted = int(sys.argv[1])
    if hasattr(os, "sched_setaffinity"):  # before JAX and BLAS count the cores
        os.sched_setaffinity(0, set(sorted(os.sched_getaffinity(0))[:wanted]))
    print(json.dumps(rates(wanted)))
