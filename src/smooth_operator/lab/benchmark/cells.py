"""Cells of a benchmark: one recording, one hand, one method with one preset; and their identity."""

from __future__ import annotations

import dataclasses
import hashlib
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

import smooth_operator
from smooth_operator.atomic_files import file_name
from smooth_operator.errors import SmoothOperatorError
from smooth_operator.formats.jsonable import to_json
from smooth_operator.hands.registry import load_hand
from smooth_operator.lab.benchmark.recordings import Source
from smooth_operator.lab.benchmark.settings import Choice, Settings, method_label
from smooth_operator.lab.offline.finished import digest
from smooth_operator.methods.method import MethodConfig
from smooth_operator.metrics.registry import plugin_metrics
from smooth_operator.result_cache import code_digest, key_digest
from smooth_operator.types import Side


@dataclass(frozen=True, eq=False)
class Cell:
    """One thing to measure.

    Attributes:
        source: the recording.
        hand: name of the robot hand.
        method: name of the method.
        preset: name of its preset.
        config: the method's configuration, the operator in it.
        fingers: robot finger -> human finger that drives it; None for all.
    """

    source: Source
    hand: str
    method: str
    preset: str
    config: MethodConfig
    fingers: Mapping[str, str] | None = None

    @property
    def side(self) -> Side:
        """Side of both hands."""
        return self.source.side

    @property
    def key(self) -> tuple[str, str, str, str, str]:
        """Recording, hand, side, method, preset: what names a row of the results."""
        return (self.source.name, self.hand, self.side, self.method, self.preset)

    @property
    def label(self) -> str:
        """For a person."""
        method = method_label(self.method, self.preset)
        return f"{self.source.name} on {self.hand} {self.side}, {method}"

    @property
    def slug(self) -> str:
        """Name of its files: readable, harmless anywhere, and unique."""
        path = self.source.request.path
        place = "" if path is None else str(path.absolute())
        return file_name("-".join(self.key), (place, *self.key))


def cells_of(
    sources: Iterable[Source], settings: Settings, methods: Sequence[Choice]
) -> list[Cell]:
    """Every recording with every hand and every method, in this order."""
    operator = settings.operator
    configs = [c.config if operator is None else c.config.with_operator(operator) for c in methods]
    return [
        Cell(source, hand, choice.method, choice.preset, config, settings.fingers)
        for source in sources
        for hand in settings.hands
        for choice, config in zip(methods, configs, strict=True)
    ]


def fingerprint(cell: Cell, settings: Settings) -> str:
    """Fingerprint of a cell's inputs, without code.

    Frames, hand, configuration, seed and definitions are in it. Of two cells with one fingerprint,
    one need not be done again.
    """
    outside = outside_code(cell.config, *(metric.compute for metric in plugin_metrics()))
    return key_digest(
        {
            "frames": cell.source.digest,
            "hand": hand_identity(cell.hand, cell.side, tuple((cell.fingers or {}).items())),
            "method": cell.method,
            "preset": cell.preset,
            "config": cell.config,
            "seed": settings.seed,
            "definition": settings.definition,
            "files": [digest(path) for path in files_of(cell.config)],
            **({"plugins": outside} if outside else {}),
            **({"metrics": sorted(settings.metrics)} if settings.metrics else {}),
        }
    )


def outside_code(*parts: Any) -> list[str]:
    """Digests of the other distributions that some parts come from, as those of plugins."""
    modules = {sys.modules[getattr(part, "__module__", __name__)] for part in parts}
    return sorted(code for module in modules if (code := _code_outside(module)))


@cache
def _code_outside(module: ModuleType) -> str:
    """Digest of the distribution's package that a module is in; empty for a module of this one."""
    package = sys.modules[module.__name__.partition(".")[0]]
    if package is smooth_operator or package.__file__ is None:
        return ""
    path = Path(package.__file__)
    files = sorted(path.parent.rglob("*.py")) if path.name == "__init__.py" else [path]
    return hashlib.sha256(b"\0".join(file.read_bytes() for file in files)).hexdigest()


def benchmark_code() -> str:
    """Digest of the code that a command or a metric depends on, the models in it included.

    Pages, plots and the command line are not in it. Whoever changes a method between two runs of a
    benchmark gets its cells measured again.
    """
    return code_digest(
        "geometry.py", "landmarks.py", "types.py", "human", "hands", "objective", "solvers",
        "methods", "baselines", "metrics", "lab/offline", "io", "formats",
    )  # fmt: skip


@cache
def hand_identity(name: str, side: Side, fingers: tuple[tuple[str, str], ...]) -> str:
    """The hand's description and the content of its model file, not the folder it is in."""
    try:
        spec = load_hand(name, side, fingers=dict(fingers) or None).spec
    except SmoothOperatorError as error:
        return f"{name} {side}: {error}"
    fields = {f.name: getattr(spec, f.name) for f in dataclasses.fields(spec) if f.name != "model"}
    text = to_json(fields).encode() + Path(spec.model).read_bytes()
    return hashlib.sha256(text).hexdigest()


def files_of(config: Any) -> Iterator[Path]:
    """The files that a configuration names, as trained models."""
    if isinstance(config, Path) and config.is_file():
        yield config
    elif dataclasses.is_dataclass(config):
        for field in dataclasses.fields(config):
            yield from files_of(getattr(config, field.name))
