"""Reports the figures of a run as Markdown tables, and as JSON to compare runs.

A result is one JSON file with the machine, the versions, the arguments and a flat table of figures,
so that any two runs of the same program can be compared with ``--compare``.
"""

from __future__ import annotations

import contextlib
import datetime
import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np
import tyro

from smooth_operator.errors import SmoothOperatorError
from smooth_operator.formats.environment import environment
from smooth_operator.hands.hand import Hand
from smooth_operator.retargeting.batching import BatchRetargeter
from smooth_operator.synthetic import SyntheticOperator
from smooth_operator.types import HandRecording

RESULTS: Final = Path("build") / "benchmarks"
"""Default folder of results; relative to the current folder, ignored by git."""

_CHECKOUT: Final = Path(__file__).resolve().parents[3]
"""Root of the checkout; it is not a repository if this package was installed from a wheel."""

_Table = tuple[str, tuple[str, ...], list[list[object]]]


class BenchmarkError(SystemExit):
    """Error that stops a program with a message instead of a traceback."""


@dataclass(frozen=True, kw_only=True)
class ReportSettings:
    """Options for the files of a run.

    Attributes:
        output: JSON file of the figures; by default build/benchmarks/NAME.json.
        compare: an earlier JSON file with which this run is compared.
    """

    output: Path | None = None
    compare: Path | None = None


def run_program(main: Callable[[Any], None], settings: type, description: str | None) -> None:
    """Reads the settings of a program from the command line and runs it."""
    try:
        main(tyro.cli(settings, description=description))
    except SmoothOperatorError as error:
        raise BenchmarkError(str(error)) from error


def retargeter_of(hand: Hand | str, name: str) -> BatchRetargeter:
    """Makes the retargeter METHOD or METHOD:PRESET for a hand."""
    method, _, preset = name.partition(":")
    return BatchRetargeter(hand, method=method, preset=preset or None)


def operator_frames(frames: int, seed: int = 0) -> HandRecording:
    """Records a number of frames of the built-in operator at 100 Hz."""
    return SyntheticOperator(seed=seed).record((frames + 0.5) / 100)[:frames]


def percentiles(samples_ms: Sequence[float] | np.ndarray) -> dict[str, float]:
    """p50, p95, p99 and maximum of some times [ms]."""
    names = ("p50_ms", "p95_ms", "p99_ms", "max_ms")
    values = np.percentile(np.asarray(samples_ms, float), (50, 95, 99, 100))
    return {name: float(value) for name, value in zip(names, values, strict=True)}


def memory_mib(kind: str = "VmHWM", process: int | str = "self") -> float | None:
    """Peak resident memory of a process [MiB], or the current one (``VmRSS``); None without
    ``/proc``."""
    with contextlib.suppress(OSError, StopIteration):  # getrusage would hold that of the parent
        lines = Path(f"/proc/{process}/status").read_text(encoding="ascii").splitlines()
        return next(int(line.split()[1]) / 1024 for line in lines if line.startswith(kind))
    return None


def child_json(
    command: Sequence[object], environ: Mapping[str, str | None], text: str | None = None
) -> Any:
    """Runs a process; returns the JSON on the last line of its output.

    Args:
        command: program and arguments.
        environ: variables of its environment, besides those of this process; None removes one.
    """
    env = {k: v for k, v in {**os.environ, **environ}.items() if v is not None}
    words = list(map(str, command))
    try:
        child = subprocess.run(
            words, input=text, capture_output=True, text=True, timeout=1200, env=env
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        raise BenchmarkError(str(error)) from error
    if child.returncode:
        raise BenchmarkError(f"a process failed: {child.stderr.strip()[-2000:] or 'no message'}")
    return json.loads(child.stdout.splitlines()[-1])


def _load() -> list[float] | None:
    return [round(x, 2) for x in os.getloadavg()] if hasattr(os, "getloadavg") else None


@dataclass
class Report:
    """Figures of one run, and the conditions of the run.

    Attributes:
        benchmark: name of the benchmark.
        arguments: arguments of the run.
        figures: flat mapping from names to numbers, which ``--compare`` reads.
        notes: sentences below the tables, about missing values and limitations.
    """

    benchmark: str
    arguments: Mapping[str, object]
    figures: dict[str, float] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    started: str = field(
        default_factory=lambda: datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")
    )
    load_average: list[float] | None = field(default_factory=_load)
    _tables: list[_Table] = field(default_factory=list)

    def table(self, title: str, header: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
        """Adds a table to print."""
        self._tables.append((title, tuple(header), [list(row) for row in rows]))

    def tables(self) -> str:
        """Returns all tables as Markdown."""
        return "\n\n".join(
            f"**{title}**\n\n{markdown(header, rows)}" for title, header, rows in self._tables
        )

    def add(self, prefix: str, values: Mapping[str, float | None]) -> None:
        """Adds figures with a common prefix, except those that could not be measured."""
        self.figures |= {f"{prefix}/{k}": float(v) for k, v in values.items() if v is not None}

    def finish(self, output: Path | None, compare: Path | None) -> None:
        """Prints Markdown to standard output and writes the JSON file.

        Args:
            output: the file; None for ``build/benchmarks/<benchmark>.json``.
            compare: an earlier result of the same benchmark to compare with this one.
        """
        other, failure = None, None
        try:  # before it may be overwritten; a wrong file must not cost the run
            other = None if compare is None else _read(compare, self.benchmark)
        except BenchmarkError as error:
            failure = error
        where = machine()
        result = {
            "benchmark": self.benchmark,
            "date": self.started,
            "load_average": self.load_average,
            "hardware": where,
            "versions": versions(),
            "arguments": {k: _plain(v) for k, v in self.arguments.items()},
            "figures": self.figures,
            "notes": self.notes,
            "tables": [
                {"title": title, "header": header, "rows": [[_plain(c) for c in r] for r in rows]}
                for title, header, rows in self._tables
            ],
        }
        print(f"\n{self.tables()}\n")
        for note in self.notes:
            print(f"- {note}")
        print(
            f"- {self.started}; load average at the start "
            f"{'unknown' if self.load_average is None else self.load_average[0]}; "
            f"{where['cpu']}, {where['cores']} cores; JAX on {where['jax_device']}; "
            + ", ".join(f"{k} {v}" for k, v in versions().items())
        )
        if other is not None and compare is not None:
            print(
                f"\n**Against {compare.name} of {other['date']}**\n\n{_comparison(result, other)}"
            )
        path = RESULTS / f"{self.benchmark}.json" if output is None else output
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(result, indent=2, allow_nan=False) + "\n", encoding="utf-8")
        print(f"wrote {path}", file=sys.stderr)
        if failure is not None:
            raise failure


def markdown(header: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """Makes a Markdown table; numbers have four significant digits, and all columns of figures
    except the first are right-aligned."""
    lines = [[cell(value) for value in row] for row in rows]
    figures = [
        i > 0 and all(not t or t == "–" or t.lstrip("*−-+÷×<~ ")[:1].isdigit() for t in column)
        for i, column in enumerate(zip(*lines, strict=True))
    ] or [False] * len(header)
    ruler = "|" + "|".join("---:" if right else "---" for right in figures) + "|"
    head, *body = (
        "|" + "|".join(f" {t} " if t else " " for t in line) + "|" for line in (header, *lines)
    )
    return "\n".join([head, ruler, *body])


def cell(value: object) -> str:
    """Formats a value of a table; a dash if it is missing."""
    if value is None:
        return "–"
    if not isinstance(value, float):
        return str(value)
    if value == 0 or 1e-3 <= abs(value) < 1e5:
        digits = 4 if abs(value) < 1 else max(0, 3 - int(np.floor(np.log10(abs(value)))))
        return f"{value:.{digits}f}"
    return f"{value:.2e}"


def machine() -> dict[str, Any]:
    """Facts of the machine: processor, cores that this process may use, accelerator, system."""
    here = environment()
    return {
        "cpu": here["cpu"],
        "cores": here["cpu_cores"],
        "jax_device": here["device"],
        "system": here["platform"],
    }


def versions() -> dict[str, str]:
    """Versions of the measured program and its libraries, and the commit of a checkout."""
    names: dict[str, str] = dict(environment()["versions"])
    if (_CHECKOUT / ".git").exists():
        with contextlib.suppress(OSError, subprocess.CalledProcessError):  # git is not installed
            names["revision"] = subprocess.run(
                ["git", "describe", "--always", "--dirty"],
                cwd=_CHECKOUT,
                capture_output=True,
                text=True,
                check=True,
            ).stdout.strip()
    return names


def _read(path: Path, benchmark: str) -> dict[str, Any]:
    try:
        other: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise BenchmarkError(f"can't compare with {path}: {error}") from error
    if other.get("benchmark") != benchmark or "figures" not in other:
        raise BenchmarkError(
            f"can't compare with {path}: expected a result of benchmark {benchmark!r}, "
            f"found {other.get('benchmark')!r}"
        )
    return other


def _comparison(this: Mapping[str, Any], other: Mapping[str, Any]) -> str:
    rows = [
        [name, value, other["figures"][name], _ratio(value, other["figures"][name])]
        for name, value in this["figures"].items()
        if name in other["figures"]
    ]
    lines = [markdown(("figure", "this run", "that run", "this / that"), rows), ""]
    for kind in ("hardware", "versions", "arguments"):
        for key in sorted({*this[kind], *other[kind]}):
            mine, theirs = this[kind].get(key), other[kind].get(key)
            if mine != theirs and key not in ("output", "compare"):
                lines.append(f"- {kind}, {key}: {mine} here, {theirs} there")
    alone = {*this["figures"]} ^ {*other["figures"]}
    if alone:
        lines.append(f"- {len(alone)} figures are in only one of the two files")
    return "\n".join(lines)


def _ratio(a: float, b: float) -> float | None:
    return a / b if b else None


def _plain(value: object) -> object:
    """Converts to JSON values."""
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, Path):
        return value.name  # where it lies on this machine is nobody's business
    if isinstance(value, list | tuple):
        return [_plain(v) for v in value]
    return value
