"""A function that is compiled once and kept: a second process neither traces nor compiles it.

What is kept is the executable (``jax.experimental.serialize_executable``) and the structure of what
it returns. The process that compiles it runs that same executable, so results are equal, bit for
bit, whether it was just compiled or read.
"""

from __future__ import annotations

import contextlib
import dataclasses
import enum
import functools
import hashlib
import json
import os
import threading
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from importlib import import_module
from importlib.metadata import version
from typing import Any, Final, NamedTuple

import jax
import numpy as np

from smooth_operator.compilation.frame_jit import compiled
from smooth_operator.compilation.program_cache import (
    LOGGER,
    ProgramCache,
    machine,
    program_cache,
)
from smooth_operator.formats.jsonable import to_json
from smooth_operator.hands.hand import Hand
from smooth_operator.methods.method import MethodConfig
from smooth_operator.methods.shared import fingerprint
from smooth_operator.result_cache.code import HOME, code_digest

_CODE: Final = (
    "compilation", "methods", "baselines", "objective", "solvers", "human", "hands",
    "hand_files/stand_ins.py", "geometry.py", "poses.py", "landmarks.py", "types.py",
)  # fmt: skip
"""What programs are traced from."""

_ELSEWHERE: Final = ("cache", "log", "dump", "async_dispatch")
"""Words in the names of JAX's settings that leave a program as it is."""


def program_key(
    hand: Hand, config: MethodConfig, *more: object, constants: Any = None
) -> str | None:
    """What a program of a hand and a configuration depends on, but for its arguments.

    Args:
        hand: the robot hand that the method was built for.
        config: the method's.
        more: anything else, as JSON.
        constants: of ``Method.constants``.

    Returns:
        a digest; None if it can't be known, as the configuration has code or a file of the user's.
    """
    known = config.shareable or constants is not None
    if not known or not _is_data(config, paths=constants is not None):
        return None
    parts = [fingerprint(hand), type(config).__qualname__, config, *more]
    digest = hashlib.sha256("\n".join(to_json(part) for part in parts).encode())
    for array in jax.tree.leaves(constants):
        digest.update(str(np.shape(array)).encode() + np.asarray(array).tobytes())
    digest.update(code_digest(*_CODE).encode())
    return digest.hexdigest()


class _Signature(NamedTuple):
    """What arguments a program was compiled for."""

    tree: Any
    shapes: tuple[Any, ...]
    device: jax.Device

    @classmethod
    def of(cls, arguments: tuple[Any, ...]) -> _Signature | None:
        """Of arguments; None if no single executable takes them."""
        leaves, tree = jax.tree.flatten(arguments)
        devices = set()
        for leaf in leaves:
            if isinstance(leaf, jax.core.Tracer):
                return None
            devices |= leaf.devices() if isinstance(leaf, jax.Array) else set()
        if len(devices) > 1:
            return None
        device = devices.pop() if devices else next(iter(jax.device_put(0).devices()))
        shapes = tuple((np.shape(leaf), str(jax.dtypes.result_type(leaf))) for leaf in leaves)
        return cls(tree, shapes, device)


class KeptProgram:
    """A function of trees of arrays, compiled when it is first called, once for each shape.

    Args:
        function: traceable; returns a tree of tuples, lists, dictionaries and this package's named
            tuples.
        hand: the robot hand that the method was built for.
        config: the method's.
        more: what else the function depends on, as JSON.
        constants: of ``Method.constants``.
        kept: whether it is read from the user's cache, and kept there.
    """

    def __init__(
        self,
        function: Callable[..., Any],
        hand: Hand,
        config: MethodConfig,
        *more: object,
        constants: Any = None,
        kept: bool = True,
    ) -> None:
        self._function, self._kept, self._wide = function, kept, not config.one_thread
        self._key = functools.partial(program_key, hand, config, *more, constants=constants)
        self._run: Callable[..., Any] | None = None
        self._made: dict[_Signature, Callable[..., Any]] = {}
        self._lock = threading.Lock()

    def __call__(self, *arguments: Any) -> Any:
        """The function's value."""
        if self._run is not None:
            try:
                return self._run(*arguments)
            except (TypeError, ValueError):
                pass  # an executable takes no other shapes, nor another device
        signature = _Signature.of(arguments)
        if signature is None:
            return compiled(self._function, wide=self._wide)(*arguments)
        if self._lock.locked():  # another thread compiles it, or reads it
            _notice(False)
        with self._lock:
            made = self._made.get(signature)
            if made is None:
                made, value = self._prepared(signature, arguments)
                self._made[signature] = self._run = made
                return value
            self._run = made
        return made(*arguments)

    def _prepared(
        self, signature: _Signature, arguments: tuple[Any, ...]
    ) -> tuple[Callable[..., Any], Any]:
        """The program for arguments like these, and its value for them."""
        cache = program_cache() if self._kept else None
        key = self._key() if cache is not None else None
        settings: Any = jax.config  # its attributes are made at run time
        # tried on CPUs only: elsewhere an executable needs libraries that nothing here looks up
        apart = settings.jax_disable_jit or signature.device.platform != "cpu"
        if cache is None or key is None or apart:
            _notice(False)
            run = compiled(self._function, wide=self._wide)
            return run, run(*arguments)
        name = _file_name(key, signature)
        found = _read(cache, name, arguments, signature.device)
        if found is None and _notice(True):
            found = _read(cache, name, arguments, signature.device)
        if found is None:
            run = _compiled_and_kept(
                cache, name, compiled(self._function, wide=self._wide), arguments
            )
            return run, run(*arguments)
        return found


_noticed: Final = threading.local()


@contextlib.contextmanager
def before_compiling(notice: Callable[[bool], bool]) -> Iterator[None]:
    """While the block runs, a function is called before this thread compiles a program.

    Args:
        notice: called where a program was not kept, with whether it can be; and where another
            thread is at it. Returns whether it may be kept now, to be looked for again.
    """
    before = getattr(_noticed, "call", None)
    _noticed.call = notice
    try:
        yield
    finally:
        _noticed.call = before


def _notice(can_be_kept: bool) -> bool:
    call: Callable[[bool], bool] | None = getattr(_noticed, "call", None)
    return call is not None and call(can_be_kept)


def shaping_settings() -> dict[str, Any]:
    """JAX's settings that a program may depend on, as this thread has them."""
    config: Any = jax.config
    return {
        # an attribute holds the thread's own value; settings without one have the process's alone
        name: getattr(config, name, value)
        for name, value in sorted(config.values.items())
        if not any(word in name for word in _ELSEWHERE)
    }


def _file_name(key: str, signature: _Signature) -> str:
    settings = {name: repr(value) for name, value in shaping_settings().items()}
    device = signature.device
    said = [key, str(signature.tree), signature.shapes, machine(), version("jax"), settings,
            device.platform, device.device_kind, device.id,
            os.environ.get("XLA_FLAGS")]  # fmt: skip
    return f"{hashlib.sha256(repr(said).encode()).hexdigest()[:32]}.executable"


def _read(
    cache: ProgramCache, name: str, arguments: tuple[Any, ...], device: jax.Device
) -> tuple[Callable[..., Any], Any] | None:
    """The program as it was kept, and its value, if it can be run here."""
    data = cache.find(name)
    if data is None:
        return None
    from jax.experimental.serialize_executable import deserialize_and_load

    ready: Any = jax.block_until_ready  # has no types
    try:
        head, _, executable = data.partition(b"\n")
        out_tree = jax.tree.structure(_skeleton(json.loads(head)))
        in_tree, client = jax.tree.structure((arguments, {})), device.client
        job = executable, in_tree, out_tree, client, [device]
        found: Callable[..., Any]
        if b"lapack_" in executable and not find_lapack.cache_info().currsize:
            with ThreadPoolExecutor(1) as pool:  # XLA reads on one core while Python imports
                loading = pool.submit(deserialize_and_load, *job)
                find_lapack()
                found = loading.result()
        else:  # a new thread would not have the priority of those of a real-time loop
            found = deserialize_and_load(*job)
        value = ready(found(*arguments))
    except Exception as error:  # what JAX and XLA raise of what they can't load is not said
        cache.drop(name, f"{type(error).__name__}: {error}")
        return None
    return found, value


@functools.cache
def find_lapack() -> None:
    """Has JAX look up LAPACK, which it does when it lowers a call, not when it loads one.

    The first time it imports SciPy's linear algebra, which holds the interpreter for 50 to 90 ms.
    """
    try:
        lapack: Any = import_module("jaxlib.lapack")
        lapack.prepare_lapack_call("potrf_ffi", np.dtype(np.float32))
    except (ImportError, AttributeError, TypeError):  # moved, in another version
        jax.jit(jax.lax.linalg.cholesky).lower(np.eye(2, dtype=np.float32))


def _compiled_and_kept(
    cache: ProgramCache, name: str, traced: Any, arguments: tuple[Any, ...]
) -> Callable[..., Any]:
    from jax.experimental.serialize_executable import serialize

    lowered = traced.lower(*arguments)
    seen = _cache_hits()
    seen.any = False
    found = lowered.compile()
    if not seen.any:  # XLA writes an executable that it has read without its code
        try:  # before it has run: XLA can't write a sort that has
            executable, _, out_tree = serialize(found)
            numbered = jax.tree.unflatten(out_tree, range(out_tree.num_leaves))
            head = json.dumps(_description(numbered))
            cache.keep(name, head.encode() + b"\n" + executable)
        except Exception as error:  # a program that can't be kept is still a program
            LOGGER.info("a program can't be kept: %s", error)
    run: Callable[..., Any] = found
    return run


@functools.cache
def _cache_hits() -> threading.local:
    """Where a thread finds whether JAX took a program from its own cache (``any``)."""
    seen = threading.local()

    def on_event(event: str, **_: object) -> None:
        if event == "/jax/compilation_cache/cache_hits":
            seen.any = True

    jax.monitoring.register_event_listener(on_event)
    return seen


def _description(value: Any) -> Any:
    """The structure of a tree as JSON; leaves are numbers."""
    if value is None or isinstance(value, int):
        return value
    if isinstance(value, dict):
        return {"keys": {key: _description(each) for key, each in value.items()}}
    kind = type(value)
    if kind not in (tuple, list) and not kind.__module__.startswith(f"{HOME.name}."):
        raise TypeError(f"{kind.__qualname__} has no description")
    name = kind.__name__ if kind in (tuple, list) else f"{kind.__module__}:{kind.__qualname__}"
    return {"of": name, "items": [_description(each) for each in value]}


def _skeleton(said: Any) -> Any:
    """A tree of the structure that ``_description`` says."""
    if not isinstance(said, dict):
        return said
    if "keys" in said:
        return {key: _skeleton(each) for key, each in said["keys"].items()}
    items = [_skeleton(each) for each in said["items"]]
    if said["of"] in ("tuple", "list"):
        return tuple(items) if said["of"] == "tuple" else items
    module, _, name = said["of"].partition(":")
    if module.partition(".")[0] != HOME.name:
        raise ValueError(f"{module} is not of this package")
    kind: Any = import_module(module)
    for part in name.split("."):
        kind = getattr(kind, part)
    return kind(*items)


def _is_data(value: object, paths: bool = False) -> bool:
    """Whether a value is numbers, texts and this package's own dataclasses, all the way down."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        ours = type(value).__module__.partition(".")[0] == HOME.name
        fields = dataclasses.fields(value)
        return ours and all(_is_data(getattr(value, field.name), paths) for field in fields)
    if isinstance(value, Mapping):
        return all(_is_data(each, paths) for pair in value.items() for each in pair)
    if isinstance(value, (tuple, list, set, frozenset)):
        return all(_is_data(each, paths) for each in value)
    if isinstance(value, str):
        return ":" not in value  # package.module:attribute
    if isinstance(value, os.PathLike):
        return paths
    return value is None or isinstance(value, (int, float, enum.Enum, np.ndarray, np.generic))
