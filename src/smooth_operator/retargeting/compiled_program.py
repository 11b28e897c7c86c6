"""A function that is traced and compiled once for each shape of its arguments."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any, Final, Protocol, TypeAlias

import jax
import numpy as np

from smooth_operator.geometry import on_gpu
from smooth_operator.hands.hand import Hand
from smooth_operator.retargeting.method import MethodConfig

_LOOPS_ON_GPU: Final = {
    "xla_gpu_enable_command_buffer": "FUSION,CUBLAS,CUBLASLT,CUDNN,CUSTOM_CALL,"
    "DYNAMIC_SLICE_FUSION,CONDITIONAL,WHILE",
}
"""Option of XLA, from JAX's documentation: loops run on the GPU, not kernel by kernel."""

Signature: TypeAlias = tuple[Any, tuple[tuple[tuple[int, ...], str], ...], str]
"""Structure, shapes and kinds of the arguments, and their device."""


class ProgramCache(Protocol):
    """Stores traced programs for other processes, as ``ProgramStore`` does; hashable."""

    def traced(
        self, program: CompiledProgram, signature: Signature, arguments: tuple[Any, ...]
    ) -> Callable[..., Any]:
        """Returns the program's function, or a traced one that gives the same results."""


class CompiledProgram:
    """A function of pytrees of arrays, compiled at its first call with arguments of each shape.

    Args:
        function: traceable; returns a tree of tuples, lists, dictionaries and named tuples.
        name: name of the function, and further values that it depends on.
        hand: the robot hand that the method was built for.
        config: the method's settings.
        constants: ``Method.constants``.
        cache: keeps the traced function; None traces it in each process.
        graphs: True to run loops on a GPU, for batches; a single frame takes 10 % longer.
    """

    def __init__(
        self,
        function: Callable[..., Any],
        *name: object,
        hand: Hand,
        config: MethodConfig,
        constants: Any = None,
        cache: ProgramCache | None = None,
        graphs: bool = False,
    ) -> None:
        self.function, self.name, self.hand, self.config = function, name, hand, config
        self.constants, self._cache, self._graphs = constants, cache, graphs
        self._run: Callable[..., Any] | None = None
        self._programs: dict[Signature, Callable[..., Any]] = {}
        self._lock = threading.Lock()

    def __call__(self, *arguments: Any) -> Any:
        """Calls the compiled function."""
        if self._run is not None:
            try:
                return self._run(*arguments)
            except (TypeError, ValueError, NotImplementedError):
                self._run = None  # a program accepts no other shapes, and no tracers
        signature = _signature(arguments)
        if signature is None:
            return jax.jit(self.function)(*arguments)
        with self._lock:
            run = self._programs.get(signature)
            if run is None:
                run = self._compiled(signature, arguments)
                value = run(*arguments)
                self._programs[signature] = run
                self._run = run if len(self._programs) == 1 else None
                return value
        return run(*arguments)

    def _compiled(self, signature: Signature, arguments: tuple[Any, ...]) -> Callable[..., Any]:
        """The program for arguments of this signature. It is compiled ahead of time, because
        ``jax.jit`` would compile again if NumPy's state becomes one of JAX."""
        function = self.function
        if self._cache is not None:
            function = self._cache.traced(self, signature, arguments)
        options = _LOOPS_ON_GPU if self._graphs and on_gpu() else None
        return jax.jit(function, compiler_options=options).lower(*arguments).compile()


def _signature(arguments: tuple[Any, ...]) -> Signature | None:
    """Signature of a compiled program; None for tracers and for arguments on several devices."""
    leaves, tree = jax.tree.flatten(arguments)
    devices = set()
    for leaf in leaves:
        if isinstance(leaf, jax.core.Tracer):
            return None
        devices |= leaf.devices() if isinstance(leaf, jax.Array) else set()
    if len(devices) > 1:
        return None
    shapes = tuple((np.shape(leaf), str(jax.dtypes.result_type(leaf))) for leaf in leaves)
    return tree, shapes, str(devices.pop() if devices else jax.devices()[0])
