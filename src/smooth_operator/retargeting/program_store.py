"""Stores traced programs in a folder, so that later processes start faster.

The traced program is stored with ``jax.export``. JAX's compilation cache stores machine code, if
the process has enabled it, as the command does. A process that traces a program also runs its
exported form, so results are equal bit for bit in both cases.

Any number of processes can use a folder. No other user may be able to write to it (``own_files``).
Figures: docs/reference/benchmarks.md, *Start*.
"""

from __future__ import annotations

import contextlib
import dataclasses
import enum
import functools
import hashlib
import json
import os
import tempfile
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from importlib import import_module
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final

import jax
import numpy as np

from smooth_operator.errors import DocumentError
from smooth_operator.hands.hand import fingerprint
from smooth_operator.own_files import LOGGER, MOST_BYTES, make_room, own_folder, read_own_file
from smooth_operator.retargeting.compiled_program import CompiledProgram, Signature
from smooth_operator.source_digest import HOME, code_digest
from smooth_operator.user_folders import is_off, user_cache

_DIGEST: Final = 32
MOST_BYTES_OF_ONE: Final = 256 << 20

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


@dataclass(frozen=True)
class ProgramStore:
    """Stores traced programs in a folder, for ``Retargeter(cache=...)``. An entry is complete or
    missing, never partial.

    Attributes:
        folder: an existing folder to which no other user can write.
        most_bytes: largest size of all files together [bytes]; a program has 0.2 to 2 MB.
    """

    folder: Path
    most_bytes: int = MOST_BYTES

    @classmethod
    def of_user(cls) -> ProgramStore | None:
        """The store in this user's cache folder, which the command uses. None if the cache is
        disabled (``SWITCH``) or its folder is not safe."""
        folder = None if is_off() else own_folder(user_cache() / "programs")
        return None if folder is None else cls(folder)

    def traced(
        self, program: CompiledProgram, signature: Signature, arguments: tuple[Any, ...]
    ) -> Callable[..., Any]:
        """Returns the stored program, or traces and stores it. If the function depends on the
        user's code or on a user's file, it can't be stored and is returned as it is."""
        config: Any = jax.config  # its attributes are made at run time
        key = None if config.jax_disable_jit else program_key(program)
        if key is not None:
            try:
                name = _file_name(key, signature)
                return self._exported(name, program.function, arguments).call  # type: ignore[no-any-return]
            except Exception as error:  # a program that can't be exported still runs
                LOGGER.info("a compiled program can't be stored: %s", error)
        return program.function

    def _exported(self, name: str, function: Callable[..., Any], arguments: tuple[Any, ...]) -> Any:
        data = self.read(name)
        if data is not None:
            try:
                head, _, body = data.partition(b"\n")
                for kind in json.loads(head):
                    _register(_own_class(kind))
                return jax.export.deserialize(bytearray(body))
            except Exception as error:  # JAX raises errors of many classes
                self.drop(name, f"{type(error).__name__}: {error}")
        # JAX does not promise that other versions read a kernel; here only the same version does
        kernels = [jax.export.DisabledSafetyCheck.custom_call("__gpu$xla.gpu.triton")]
        exported = jax.export.export(jax.jit(function), disabled_checks=kernels)(*arguments)
        kinds = {*_named_tuples(exported.in_tree), *_named_tuples(exported.out_tree)}
        for each in kinds:
            _register(each)
        head = json.dumps(sorted(map(_class_name, kinds))).encode()
        self.write(name, head + b"\n" + exported.serialize())
        return exported

    def read(self, name: str) -> bytes | None:
        """Returns the content of an entry; None if it is missing or damaged."""
        file = self.folder / name
        try:
            content = read_own_file(file, MOST_BYTES_OF_ONE)
        except FileNotFoundError:
            return None
        except (OSError, DocumentError) as error:
            self.drop(name, error)
            return None
        digest, data = content[:_DIGEST], content[_DIGEST:]
        if _digest(data) != digest:
            self.drop(name, "it is damaged")
            return None
        with contextlib.suppress(OSError):
            file.touch()  # the time of its last use
        return data

    def write(self, name: str, data: bytes) -> None:
        """Writes an entry, and removes the least recently used entries. Disk errors are ignored."""
        with contextlib.suppress(OSError):
            handle, unfinished = tempfile.mkstemp(dir=self.folder)
            try:
                with open(handle, "wb") as stream:
                    stream.write(_digest(data) + data)
                os.replace(unfinished, self.folder / name)
            finally:
                Path(unfinished).unlink(missing_ok=True)
            make_room(self.folder, self.most_bytes)

    def drop(self, name: str, reason: object) -> None:
        """Removes an unusable entry, and logs the reason."""
        LOGGER.warning("the program %s is compiled again: %s", self.folder / name, reason)
        with contextlib.suppress(OSError):
            (self.folder / name).unlink()


def program_key(program: CompiledProgram) -> str | None:
    """Digest of everything that a program depends on, except its arguments; None if the
    configuration refers to code or to a file of the user."""
    config, constants = program.config, program.constants
    shareable = config.shareable or constants is not None
    if not shareable or not _is_data(config, paths=constants is not None):
        return None
    parts = (fingerprint(program.hand), config, program.name)
    digest = hashlib.sha256(repr(parts).encode())
    for array in jax.tree.leaves(constants):
        digest.update(str(np.shape(array)).encode() + np.asarray(array).tobytes())
    digest.update(code_digest(*_CODE).encode())
    return digest.hexdigest()


def _file_name(key: str, signature: Signature) -> str:
    settings = [repr(getattr(jax.config, name, None)) for name in _SETTINGS]
    tree, *rest = signature
    parts = [key, str(tree), *rest, version("jax"), version("jaxlib"), settings]
    return f"{hashlib.sha256(repr(parts).encode()).hexdigest()[:32]}.program"


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


def _digest(data: bytes) -> bytes:
    """Checksum: a program with a flipped bit may be readable and compute wrong results."""
    return hashlib.sha256(data).digest()
