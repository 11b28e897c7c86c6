"""Programs that are traced once and kept in a file: a second process does not trace them again.

Tracing ``smooth`` in lanes takes 2.5 s of a core, as long as everything else of a start together.
What is kept is ``jax.export``'s serialised StableHLO. It holds no code of Python, and is compiled
again or taken from JAX's compilation cache (``compile_cache``).

Where programs are kept, the exported form is what runs, whether it was just traced or read. A test
holds that results are those of the program as traced, to the last bit.
"""

from __future__ import annotations

import contextlib
import dataclasses
import enum
import functools
import hashlib
from collections.abc import Callable, Mapping
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Final

import jax
import numpy as np
from jax import export

from smooth_operator.atomic_files import atomic_write
from smooth_operator.compilation.compile_cache import kept_programs
from smooth_operator.errors import OutputError
from smooth_operator.formats.jsonable import to_json
from smooth_operator.hands.hand import Hand
from smooth_operator.methods.method import MethodConfig
from smooth_operator.methods.program import compiled
from smooth_operator.methods.shared import fingerprint
from smooth_operator.result_cache.code import HOME, code_digest

_CODE: Final = (
    "compilation", "methods", "baselines", "objective", "solvers", "human", "hands", "geometry.py",
    "poses.py", "landmarks.py", "types.py",
)  # fmt: skip
"""What programs are traced from."""

_WRITER: Final = "flatbuffers"
"""What ``jax.export`` writes and reads with, and JAX does not bring. Extras do; without it each
process traces its programs."""

_DIGEST: Final = 32
_MOST: Final = 64
"""Programs that are kept; those that were used last."""


def program_key(hand: Hand, config: MethodConfig, *more: object) -> str | None:
    """What a program of a hand and a configuration depends on, but for its arguments.

    Args:
        hand: the robot hand that the method was built for.
        config: the method's.
        more: anything else, as JSON.

    Returns:
        a digest; None if it can't be known, as the configuration has code or a file of the user's.
    """
    if not config.shareable or not _is_data(config):
        return None
    parts = [fingerprint(hand), type(config).__qualname__, config, *more]
    digest = hashlib.sha256("\n".join(to_json(part) for part in parts).encode())
    digest.update(code_digest(*_CODE).encode())
    return digest.hexdigest()


class ExportedProgram:
    """A function of trees of arrays, compiled when it is first called.

    Arrays among the arguments that come from a result should from the start be on a device by name
    (``jax.device_put``), as those of results are: otherwise the program is compiled for both.

    Args:
        function: traceable; returns (a tree like one of the arguments, a tuple of arrays).
        like: which argument.
        hand: the robot hand that the method was built for.
        config: the method's.
        more: what else the function depends on, as JSON.
    """

    def __init__(
        self,
        function: Callable[..., Any],
        like: int,
        hand: Hand,
        config: MethodConfig,
        *more: object,
    ) -> None:
        self._function, self._like = function, like
        self._key = functools.partial(program_key, hand, config, *more)
        self._run: Callable[..., Any] | None = None

    def __call__(self, *arguments: Any) -> Any:
        """The function's value."""
        if self._run is None:
            self._run = self._prepared(arguments)
        return self._run(*arguments)

    def _prepared(self, arguments: tuple[Any, ...]) -> Callable[..., Any]:
        leaves, tree = jax.tree.flatten(arguments)
        folder = kept_programs() if find_spec(_WRITER) is not None else None
        key = None if folder is None else self._key()
        found = None
        if folder is not None and key is not None:
            found = self._exported(leaves, tree, folder, key)
        if found is None:
            return compiled(self._function)
        returned: Any = jax.tree.structure(arguments[self._like])
        flat: Any = found.call

        def call(*given: Any) -> Any:
            out = flat(*jax.tree.leaves(given))
            size = returned.num_leaves
            return jax.tree.unflatten(returned, out[:size]), tuple(out[size:])

        return compiled(call)

    def _exported(
        self, leaves: list[Any], tree: Any, folder: Path, key: str
    ) -> export.Exported | None:
        """The program as it was kept, or traced and kept; None if it can't be exported."""

        def flat(*given: Any) -> list[Any]:
            return jax.tree.leaves(self._function(*jax.tree.unflatten(tree, given)))

        abstract: Any = jax.ShapeDtypeStruct
        shapes = [abstract(np.shape(x), jax.dtypes.result_type(x)) for x in leaves]
        settings: Any = jax.config  # its attributes are made at run time
        said = [key, str(shapes), str(tree), jax.default_backend(), version("jax"),
                version("jaxlib"), settings.jax_enable_x64]  # fmt: skip
        file = folder / f"{hashlib.sha256(repr(said).encode()).hexdigest()[:32]}.stablehlo"
        found = _read(file)
        if found is None:
            try:
                data = export.export(jax.jit(flat))(*shapes).serialize()
            except (NotImplementedError, ValueError):  # an operation that can't be exported
                return None
            _write(file, data)
            found = export.deserialize(data)
        return found


def _read(file: Path) -> export.Exported | None:
    """A program that was kept, if it is whole."""
    try:
        content = file.read_bytes()
        digest, data = content[:_DIGEST], content[_DIGEST:]
        if _digest(data) == digest:
            found = export.deserialize(bytearray(data))
            file.touch()  # used now
            return found
    except OSError:
        return None
    except Exception:  # of a format that JAX no longer reads; what it raises is not said
        pass
    with contextlib.suppress(OSError):
        file.unlink()
    return None


def _digest(data: bytes) -> bytes:
    """A flipped bit may leave a program that can be read, and computes something else."""
    return hashlib.sha256(data).digest()


def _write(file: Path, data: bytes | bytearray) -> None:
    with contextlib.suppress(OutputError, OSError):  # a full disk costs time only
        with atomic_write(file) as stream:
            stream.write(_digest(bytes(data)) + data)
        files = sorted(file.parent.glob("*.stablehlo"), key=lambda each: each.stat().st_mtime)
        for old in files[:-_MOST]:
            old.unlink(missing_ok=True)


def _is_data(value: object) -> bool:
    """Whether a value is numbers, texts and this package's own dataclasses, all the way down."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        ours = type(value).__module__.partition(".")[0] == HOME.name
        fields = dataclasses.fields(value)
        return ours and all(_is_data(getattr(value, field.name)) for field in fields)
    if isinstance(value, Mapping):
        return all(_is_data(each) for pair in value.items() for each in pair)
    if isinstance(value, (tuple, list, set, frozenset)):
        return all(_is_data(each) for each in value)
    if isinstance(value, str):
        return ":" not in value  # package.module:attribute
    return value is None or isinstance(value, (int, float, enum.Enum, np.ndarray, np.generic))
