"""The results as CSV tables, one row a number, for other programs."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Final

from smooth_operator.atomic_files import atomic_write
from smooth_operator.formats.csv_table import csv_text
from smooth_operator.study.analysis.analyze import Analysis
from smooth_operator.study.analysis.flow import flow_rows
from smooth_operator.study.analysis.operators import operator_means
from smooth_operator.study.analysis.readings import reading_rows
from smooth_operator.study.analysis.results import ScopeResult, plain

_FAMILIES: Final = {
    "coefficients": "name",
    "emm": "retargeter",
    "dunnett": "retargeter",
    "pairs": "pair",
}
"""Tables of a scope, and what names their rows."""


def write_tables(analysis: Analysis, folder: Path) -> list[str]:
    """Writes the tables.

    Args:
        analysis: of the study.
        folder: exists.

    Returns:
        Names of the files. A table without rows is not written, and an older one removed.

    Raises:
        OutputError: a file can't be written.
    """
    written = []
    for name, rows in _tables(analysis).items():
        path = folder / f"{name}.csv"
        if not rows:
            path.unlink(missing_ok=True)
            continue
        columns = list(dict.fromkeys(column for row in rows for column in row))
        with atomic_write(path) as file:
            file.write(csv_text(columns, rows).encode())
        written.append(path.name)
    return written


def _tables(analysis: Analysis) -> dict[str, list[dict[str, Any]]]:
    found: dict[str, list[dict[str, Any]]] = {}
    for family, label in _FAMILIES.items():
        found[family] = [
            {**where, label: name, **plain(entry)}
            for where, result in _scopes(analysis)
            for name, entry in getattr(result, family).items()
        ]
    found["separated"] = [
        {**where, "retargeter": name, "against": other, **_flat(plain(one)), **plain(test)}
        for where, result in _scopes(analysis)
        for name, one in result.separated.items()
        for other, test in one.against.items()
    ]
    found["warnings"] = [
        {**where, "warning": text}
        for where, result in _scopes(analysis)
        for text in result.warnings
    ]
    found["learning"] = [
        {"scope": scope, "index": index, "outcome": outcome, "retargeter": "all", **_flat(entry)}
        for scope, indices in analysis.learning.items()
        for index, outcomes in indices.items()
        for outcome, entry in outcomes.items()
    ]
    found["spearman"] = [
        {"metric": pair.split("~")[0], "outcome": pair.split("~")[1], **_flat(entry)}
        for pair, entry in analysis.spearman.items()
    ]
    found["readings"] = reading_rows(analysis.readings)
    found["flow"] = flow_rows(analysis.data.flow)
    found["operators"] = [plain(one) for one in operator_means(analysis.data)]
    return found


def _scopes(analysis: Analysis) -> Iterator[tuple[dict[str, str], ScopeResult]]:
    for mode, outcomes in analysis.results.items():
        for outcome, scopes in outcomes.items():
            for scope, result in scopes.items():
                yield {"mode": mode, "outcome": outcome, "scope": scope}, result


def _flat(entry: Mapping[str, Any]) -> dict[str, Any]:
    found = {}
    for key, value in plain(entry).items():
        if key in ("per_retargeter", "against"):
            continue
        if isinstance(value, Mapping):
            found.update({f"{key}_{inner}": number for inner, number in value.items()})
        else:
            found[key] = value
    return found
