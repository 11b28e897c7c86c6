"""The rows of ``results.json``: one for each cell, with all that was measured and where."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, Final, TypeAlias

from smooth_operator.errors import RecordingError, UnknownNameError
from smooth_operator.io.documents import read_json
from smooth_operator.lab.benchmark.cells import Settings, method_label
from smooth_operator.lab.benchmark.recordings import UNKNOWN_TRACKER
from smooth_operator.lab.benchmark.suite import CELLS, RESULTS, Finished
from smooth_operator.metrics import Metric

Row: TypeAlias = dict[str, Any]
"""One cell: ``recording``, ``hand``, ``side``, ``method``, ``preset``, ``status``, ``reason``,
``metrics`` (as ``evaluate`` gives them, the latency measured alone),
``fingers``, ``latency``, ``source``, ``seed``, ``definition``, ``fingers_driven`` (as chosen; null
for all), ``operator`` (the calibration; null for none), ``cell``, ``seconds``, ``versions``,
``hardware``, ``date``."""

KEY: Final = ("recording", "hand", "side", "method", "preset")
"""What names a row; no two rows share all of them."""

_HARDWARE: Final = ("platform", "cpu", "cpu_cores", "device")


_MOST_BYTES = 100_000_000  # a row for each cell, with a few kB


def make_rows(finished: Iterable[Finished], settings: Settings) -> list[Row]:
    """The rows, in the order of the cells."""
    return [_row(one, settings) for one in finished]


def _row(finished: Finished, settings: Settings) -> Row:
    cell, measured, latency = finished.cell, finished.measured, finished.latency
    row: Row = dict(zip(KEY, cell.key, strict=True))
    row |= {
        "status": "error" if measured is None else "ok",
        "reason": finished.reason,
        "metrics": None,
        "fingers": None,
        "latency": None,
        "source": cell.source.facts,
        "seed": settings.seed,
        "definition": settings.definition,
        "fingers_driven": settings.fingers,
        "operator": settings.operator,
        "cell": None,
        "seconds": None,
        "versions": None,
        "hardware": None,
        "date": None,
    }
    if measured is None:
        return row
    configuration = measured.configuration
    none = dict.fromkeys(("mean", "p50", "p95", "p99", "first"))
    alone = none if latency is None else latency.summary
    return row | {
        "metrics": measured.metrics | {"latency_ms": alone},
        "fingers": measured.fingers,
        "latency": None if latency is None else latency.facts,
        "cell": f"{CELLS}/{cell.slug}.npz",
        "seconds": measured.seconds,
        "versions": configuration.get("versions"),
        "hardware": {key: configuration.get(key) for key in _HARDWARE},
        "date": configuration.get("created"),
    }


def row_key(row: Mapping[str, Any]) -> tuple[str, ...]:
    """Key of a row."""
    return tuple(str(row[name]) for name in KEY)


def row_method(row: Mapping[str, Any]) -> str:
    """Name of the row's method in tables."""
    return method_label(str(row["method"]), str(row["preset"]))


def row_tracker(row: Mapping[str, Any]) -> str:
    """Kind of tracker of the row's recording."""
    return str(_source(row).get("tracker", UNKNOWN_TRACKER))


def row_unit(row: Mapping[str, Any]) -> str:
    """The recording that the row's frames are of, as a whole: parts of a file share it."""
    return str(_source(row).get("unit") or row["recording"])


def _source(row: Mapping[str, Any]) -> Mapping[str, Any]:
    source = row.get("source")
    return source if isinstance(source, Mapping) else {}


def value_of(row: Mapping[str, Any], metric: Metric) -> float | None:
    """A metric of a row as a number; None where it failed, was not measured or is no number."""
    metrics = row.get("metrics")
    if not isinstance(metrics, Mapping):
        return None
    try:
        value = metric.of(metrics)
    except UnknownNameError:  # an earlier version did not measure it
        return None
    number = isinstance(value, (int, float)) and not isinstance(value, bool)
    return float(value) if number else None  # type: ignore[arg-type]


def read_results(path: Path) -> list[Row]:
    """Reads ``results.json``, of this or an earlier benchmark.

    Args:
        path: the file, or the folder of the benchmark.

    Raises:
        RecordingError: there is no such file, it is damaged, or something other than results.
    """
    if path.is_dir():
        path = path / RESULTS
    expected = f"expected the {RESULTS} of `smooth-operator bench`"
    try:
        rows = read_json(path, most_bytes=_MOST_BYTES)
    except FileNotFoundError:
        raise RecordingError(f"{path}: no such file; {expected}") from None
    except OSError as error:
        raise RecordingError(f"{path}: can't be read: {error.strerror or error}") from error
    except ValueError as error:
        raise RecordingError(f"{path}: damaged, or no JSON ({error}); {expected}") from None
    if not isinstance(rows, list):
        raise RecordingError(f"{path}: it holds a {type(rows).__name__}, not a list; {expected}")
    for i, row in enumerate(rows):
        missing = [
            name for name in KEY if not (isinstance(row, dict) and isinstance(row.get(name), str))
        ]
        if missing:
            raise RecordingError(f"{path}: row {i} lacks {', '.join(missing)}; {expected}")
        if not isinstance(row.get("metrics"), (dict, type(None))):
            raise RecordingError(f"{path}: the metrics of row {i} are no object; {expected}")
    return rows
