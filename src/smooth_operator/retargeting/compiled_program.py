"""A function that is traced and compiled once; other processes read the traced program.

The traced program is stored with ``jax.export``. JAX's compilation cache stores machine code, if
the process has enabled it, as the command does. A process that traces a program also runs its
exported form, so results are equal bit for bit in both cases.
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
"""Option of XLA, from JAX's documentation: loops run on the GPU, not kernel by kernel."""

_Signature: TypeAlias = tuple[Any, tuple[tuple[tuple[int, ...], str], ...], str]
"""Structure, shapes and kinds of the arguments, and their device."""


def program_key(
    hand: Hand, config: MethodConfig, *more: object, constants: Any = None
) -> str | None:
    """Digest of everything that a program depends on, except its arguments; None if the
    configuration refers to code or to a file of the user."""
    shareable = config.shareable or constants is not None
    if not shareable or not _is_data(config, paths=constants is not None):
        return None
    digest = hashlib.sha256(repr((fingerprint(hand), config, more)).encode())
    for array in jax.tree.leaves(constants):
        digest.update(str(np.shape(array)).encode() + np.asarray(array).tobytes())
    digest.update(code_digest(*_CODE).encode())
    return digest.hexdigest()


class CompiledProgram:
    """A function of pytrees of arrays that is compiled at its first call with each shape.

    Args:
        function: traceable; returns a tree of tuples, lists, dictionaries and named tuples.
        name: name of the function, and further dependencies (``program_key``).
        hand: the robot hand that the method was built for.
        config: the method's settings.
        constants: ``Method.constants``.
        cached: True to read the program from the user's cache and store it there.
        graphs: True to run loops on a GPU, for batches; a single frame takes 10 % longer.
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
        """Calls the compiled function."""
        if self._run is not None:
            try:
                return self._run(*arguments)
            except (TypeError, ValueError, NotImplementedError):
                self._run = None  # a program accepts no other shapes, and no tracers
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
        """The program for arguments of this signature, and its value. It is compiled ahead of time,
        because ``jax.jit`` would compile again if NumPy's state becomes one of JAX."""
        config: Any = jax.config  # its attributes are made at run time
        cache = None if config.jax_disable_jit or not self._cached else program_cache()
        key = None if cache is None else self._key()
        function = self._function
        if cache is not None and key is not None:
            try:
                function = _exported(cache, _file_name(key, signature), function, arguments).call
            except Exception as error:  # a program that can't be exported still runs
                LOGGER.info("a compiled program can't be stored: %s", error)
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
    """Reads a stored program, or traces and stores it."""
    data = cache.read(name)
    if data is not None:
        try:
            head, _, body = data.partition(b"\n")
            for kind in json.loads(head):
                _register(_own_class(kind))
            return jax.export.deserialize(bytearray(body))
        except Exception as error:  # JAX raises errors of many classes
            cache.drop(name, f"{type(error).__name__}: {error}")
    # JAX does not promise that other versions read a kernel; here only the same version reads it
    kernels = [jax.export.DisabledSafetyCheck.custom_call("__gpu$xla.gpu.triton")]
    exported = jax.export.export(jax.jit(function), disabled_checks=kernels)(*arguments)
    kinds = {*_named_tuples(exported.in_tree), *_named_tuples(exported.out_tree)}
    for each in kinds:
        _register(each)
    head = json.dumps(sorted(map(_class_name, kinds))).encode()
    cache.write(name, head + b"\n" + exported.serialize())
    return exported


def _named_tuples(tree: Any) -> Iterator[type]:
    """Yields the classes of the named tuples in a tree's structure."""
    node = tree.node_data()
    if node is None:
        return
    if issubclass(node[0], tuple) and node[0] is not tuple:
        yield node[0]
    for child in tree.children():
        yield from _named_tuples(child)


@functools.cache
def _register(kind: type) -> None:
    """Registers a named tuple with ``jax.export``."""
    register: Any = jax.export.register_namedtuple_serialization
    register(kind, serialized_name=_class_name(kind))


def _class_name(kind: type) -> str:
    return f"{kind.__module__}:{kind.__qualname__}"


def _own_class(name: str) -> type:
    """Imports a class of this package by its name; ValueError for other packages."""
    module, _, path = name.partition(":")
    if module.partition(".")[0] != HOME.name:
        raise ValueError(f"{module} is not of this package")
    kind: Any = import_module(module)
    for part in path.split("."):
        kind = getattr(kind, part)
    return kind  # type: ignore[no-any-return]


def _is_data(value: object, paths: bool = False) -> bool:
    """True if ``repr`` shows the whole value: numbers, texts and dataclasses of this package."""
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
