"""A function that is traced and compiled once: a second process reads the program.

The traced program is kept with ``jax.export``. Machine code is kept by JAX's compilation cache, if
the process has switched it on, as the command does. A process that traces a program runs the
exported form too, so results are equal, bit for bit, whether it was traced or read.
"""

from __future__ import annotations

import dataclasses
import enum
import functools
import hashlib
import json
import os
import threading
from collections.abc import Callable, Iterator, Mapping
from importlib import import_module
from importlib.metadata import version
from typing import Any, Final, TypeAlias

import jax
import numpy as np

from smooth_operator.geometry import on_gpu
from smooth_operator.hands.hand import Hand, fingerprint
from smooth_operator.retargeting.method import MethodConfig
from smooth_operator.retargeting.program_cache import LOGGER, ProgramCache, program_cache
from smooth_operator.source_digest import HOME, code_digest

_CODE: Final = (
    "retargeting",
    "baselines",
    "hands",
    "geometry.py",
    "io/anatomy.py",
    "poses.py",
    "landmarks.py",
    "types.py",
)
"""Code that programs are traced from."""

_SETTINGS: Final = (
    "jax_enable_x64",
    "jax_default_matmul_precision",
    "jax_default_prng_impl",
    "jax_numpy_dtype_promotion",
    "jax_numpy_rank_promotion",
    "jax_threefry_partitionable",
)
"""Settings of JAX that a traced program depends on."""

_LOOPS_ON_GPU: Final = {
    "xla_gpu_enable_command_buffer": "FUSION,CUBLAS,CUBLASLT,CUDNN,CUSTOM_CALL,"
    "DYNAMIC_SLICE_FUSION,CONDITIONAL,WHILE",
}
"""Option of XLA, from the list of flags in JAX's documentation: loops run on a GPU, where the host
would start their kernels."""

_Signature: TypeAlias = tuple[Any, tuple[tuple[tuple[int, ...], str], ...], str]
"""Structure, shapes and kinds of the arguments, and the platform that they are on."""


def program_key(
    hand: Hand, config: MethodConfig, *more: object, constants: Any = None
) -> str | None:
    """A digest of all that a program of a hand and a configuration depends on, but its arguments;
    ``more`` is anything else whose ``repr`` tells it apart. None if it can't be known, as the
    configuration has code or a file of the user's."""
    shareable = config.shareable or constants is not None
    if not shareable or not _is_data(config, paths=constants is not None):
        return None
    digest = hashlib.sha256(repr((fingerprint(hand), config, more)).encode())
    for array in jax.tree.leaves(constants):
        digest.update(str(np.shape(array)).encode() + np.asarray(array).tobytes())
    digest.update(code_digest(*_CODE).encode())
    return digest.hexdigest()


class CompiledProgram:
    """A function of trees of arrays, compiled when it is first called, once for each shape.

    Args:
        function: traceable; returns a tree of tuples, lists, dictionaries and named tuples.
        name: name of the function, and what else it depends on (``program_key``).
        hand: the robot hand that the method was built for.
        config: the method's settings.
        constants: ``Method.constants``.
        cached: it is read from the user's cache, and written there.
        graphs: on a GPU its loops run there: more frames a second where a loop has long turns; a
            frame alone takes a tenth longer.
    """

    def __init__(
        self,
        function: Callable[..., Any],
        *name: object,
        hand: Hand,
        config: MethodConfig,
        constants: Any = None,
        cached: bool = True,
        graphs: bool = False,
    ) -> None:
        self._function, self._cached, self._graphs = function, cached, graphs
        self._key = functools.partial(program_key, hand, config, *name, constants=constants)
        self._run: Callable[..., Any] | None = None
        self._programs: dict[_Signature, Callable[..., Any]] = {}
        self._lock = threading.Lock()

    def __call__(self, *arguments: Any) -> Any:
        """The function's value."""
        if self._run is not None:
            try:
                return self._run(*arguments)
            except (TypeError, ValueError, NotImplementedError):
                self._run = None  # a program takes no other shapes, and no tracers
        signature = _signature(arguments)
        if signature is None:
            return jax.jit(self._function)(*arguments)
        with self._lock:
            run = self._programs.get(signature)
            if run is None:
                run, value = self._compiled(signature, arguments)
                self._programs[signature] = run
                self._run = run if len(self._programs) == 1 else None
                return value
        return run(*arguments)

    def _compiled(
        self, signature: _Signature, arguments: tuple[Any, ...]
    ) -> tuple[Callable[..., Any], Any]:
        """The program for arguments like these, and its value for them.

        It is compiled ahead of time: ``jax.jit`` compiles a second time when an argument of the
        first call, a NumPy array, is an array of JAX in the next one, such as the state.
        """
        config: Any = jax.config  # its attributes are made at run time
        cache = None if config.jax_disable_jit or not self._cached else program_cache()
        key = None if cache is None else self._key()
        function = self._function
        if cache is not None and key is not None:
            try:
                function = _exported(cache, _file_name(key, signature), function, arguments).call
            except Exception as error:  # a program that can't be exported is still a program
                LOGGER.info("a program can't be kept: %s", error)
        options = _LOOPS_ON_GPU if self._graphs and on_gpu() else None
        run = jax.jit(function, compiler_options=options).lower(*arguments).compile()
        return run, run(*arguments)


def _signature(arguments: tuple[Any, ...]) -> _Signature | None:
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


def _file_name(key: str, signature: _Signature) -> str:
    settings = [repr(getattr(jax.config, name, None)) for name in _SETTINGS]
    tree, *rest = signature
    parts = [key, str(tree), *rest, version("jax"), version("jaxlib"), settings]
    return f"{hashlib.sha256(repr(parts).encode()).hexdigest()[:32]}.program"


def _exported(
    cache: ProgramCache, name: str, function: Callable[..., Any], arguments: tuple[Any, ...]
) -> Any:
    """The program as it was kept, or traced and kept now."""
    data = cache.read(name)
    if data is not None:
        try:
            head, _, body = data.partition(b"\n")
            for kind in json.loads(head):
                _register(_own_class(kind))
            return jax.export.deserialize(bytearray(body))
        except Exception as error:  # JAX's are of many kinds
            cache.drop(name, f"{type(error).__name__}: {error}")
    # JAX does not promise that another version reads a kernel; a file is read by its own version
    kernels = [jax.export.DisabledSafetyCheck.custom_call("__gpu$xla.gpu.triton")]
    exported = jax.export.export(jax.jit(function), disabled_checks=kernels)(*arguments)
    kinds = {*_named_tuples(exported.in_tree), *_named_tuples(exported.out_tree)}
    for each in kinds:
        _register(each)
    head = json.dumps(sorted(map(_class_name, kinds))).encode()
    cache.write(name, head + b"\n" + exported.serialize())
    return exported


def _named_tuples(tree: Any) -> Iterator[type]:
    """The classes of the named tuples in a tree's structure."""
    node = tree.node_data()
    if node is None:
        return
    if issubclass(node[0], tuple) and node[0] is not tuple:
        yield node[0]
    for child in tree.children():
        yield from _named_tuples(child)


@functools.cache
def _register(kind: type) -> None:
    """Registers a named tuple, so that ``jax.export`` writes and reads it."""
    register: Any = jax.export.register_namedtuple_serialization
    register(kind, serialized_name=_class_name(kind))


def _class_name(kind: type) -> str:
    return f"{kind.__module__}:{kind.__qualname__}"


def _own_class(name: str) -> type:
    """A class of this package by its name.

    Raises:
        ValueError: it is another package's.
    """
    module, _, path = name.partition(":")
    if module.partition(".")[0] != HOME.name:
        raise ValueError(f"{module} is not of this package")
    kind: Any = import_module(module)
    for part in path.split("."):
        kind = getattr(kind, part)
    return kind  # type: ignore[no-any-return]


def _is_data(value: object, paths: bool = False) -> bool:
    """Numbers, texts and this package's own dataclasses, all the way down: ``repr`` shows all."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        own = type(value).__module__.partition(".")[0] == HOME.name
        fields = dataclasses.fields(value)
        return own and all(_is_data(getattr(value, field.name), paths) for field in fields)
    if isinstance(value, Mapping):
        return all(_is_data(each, paths) for pair in value.items() for each in pair)
    if isinstance(value, (tuple, list)):
        return all(_is_data(each, paths) for each in value)
    if isinstance(value, str):
        return ":" not in value  # package.module:attribute
    if isinstance(value, os.PathLike):
        return paths
    return value is None or isinstance(value, (int, float, enum.Enum, np.generic))
