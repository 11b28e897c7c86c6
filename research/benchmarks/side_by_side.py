"""Methods side by side: the tables of research/docs/benchmarks.md, and what SLSQP evaluates.

    smooth-operator bench RECORDING ... --methods all,sbr:paper,dexpilot:published --output FOLDER
    python research/benchmarks/side_by_side.py FOLDER
    python research/benchmarks/side_by_side.py FOLDER --columns "cos thumb" motion
    python research/benchmarks/side_by_side.py --evaluations GLOVE.npz --frames 0:500

The first prints a table for each recording from the results of ``smooth-operator bench``; with
columns, one table whose cells have all recordings, in the order of the results. The last counts the
evaluations that each frame takes with SLSQP alone.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from smooth_operator import Retargeter
from smooth_operator.baselines import slsqp_method
from smooth_operator.baselines.slsqp import SlsqpResult
from smooth_operator.formats.readers import read_recording
from smooth_operator.lab.benchmark import read_results
from smooth_operator.lab.benchmark.results import Row, row_method
from smooth_operator_research.run_report import markdown

COLUMNS: Final[dict[str, Callable[[dict[str, Any]], str]]] = {
    "cos thumb": lambda m: _places(m["cosine_similarity"], 4),
    "cos all": lambda m: _places(m["cosine_similarity_all"], 4),
    "scale": lambda m: _places(m["scale_ratio"], 3),
    "motion": lambda m: _places(m["motion_preservation"], 3),
    "flatness [m²]": lambda m: f"{m['flatness']:.2e}",
    "workspace": lambda m: f"{100 * m['workspace_utilisation']:.1f}%",
    "pinch [mm]": lambda m: _places(m["pinch_error_mm"], 1),
    "vel. corr.": lambda m: _places(m["velocity_correlation"], 3),
    "lag [ms]": lambda m: _places(m["lag_ms"], 0),
    "collision": lambda m: f"{100 * m['self_collision']['share']:.0f}%",
    "frozen": lambda m: f"{100 * m['frozen_share']:.0f}%",
}
"""Heading -> text from the metrics of a row."""

DESCENDING: Final = ("dexpilot", "ako", "keyvector", "hybrid")
ALONE: Final = ("slsqp", "published")
"""Presets in which SLSQP does everything."""


def _places(value: float | None, places: int) -> str:
    return "–" if value is None else f"{value:.{places}f}"


def print_tables(folder: Path) -> None:
    """A table for each recording, in the order of the results."""
    tables: dict[tuple[str, str], list[Row]] = {}
    for row in read_results(folder):
        frames = (row.get("source") or {}).get("frames")
        tables.setdefault((row["recording"], str(frames)), []).append(row)
    for (recording, frames), rows in tables.items():
        measured = [row for row in rows if row["metrics"] is not None]
        lines = [
            [f"`{row_method(row)}`", *(text(row["metrics"]) for text in COLUMNS.values())]
            for row in measured
        ]
        rate = measured[0]["metrics"]["rate_hz"] if measured else None
        print(f"\n**{recording}, frames {frames}** ({_places(rate, 0)} Hz)\n")
        print(markdown(["method", *COLUMNS], lines))
        for row in rows:
            if row["metrics"] is None:
                print(f"\n{row_method(row)}: {row['reason']}")


def print_columns(folder: Path, columns: Sequence[str]) -> None:
    """One table: a row for each method, the figures of the recordings with slashes between them."""
    metrics: dict[tuple[str, str], dict[str, Any] | None] = {}
    for row in read_results(folder):
        frames = (row.get("source") or {}).get("frames")
        metrics[row_method(row), f"{row['recording']}, frames {frames}"] = row["metrics"]
    methods, recordings = (list(dict.fromkeys(key[i] for key in metrics)) for i in (0, 1))
    print(f"\n{' / '.join(recordings)}\n")
    lines = [
        [f"`{method}`", *(_joined(metrics, method, recordings, name) for name in columns)]
        for method in methods
    ]
    print(markdown(["method", *columns], lines))


def _joined(
    metrics: Mapping[tuple[str, str], dict[str, Any] | None],
    method: str,
    recordings: Sequence[str],
    column: str,
) -> str:
    rows = [metrics.get((method, recording)) for recording in recordings]
    return " / ".join("–" if one is None else COLUMNS[column](one) for one in rows)


def print_evaluations(path: Path, frames: slice, rate: float | None) -> None:
    """Evaluations of the objective per frame with SLSQP alone, NLopt's and SciPy's."""
    recording = read_recording(path, rate=rate)[frames]
    lines = []
    for method in DESCENDING:
        counts = [_evaluations(method, preset, recording) for preset in ALONE]
        halves = [f"{np.percentile(c, 50):.0f} / {np.percentile(c, 90):.0f}" for c in counts]
        lines.append([f"`{method}`", *halves])
    print(f"\n{recording.name}, {len(recording)} frames: evaluations a frame, p50 / p90\n")
    print(markdown(["method", *(f"preset `{preset}`" for preset in ALONE)], lines))


def _evaluations(method: str, preset: str, recording: Any) -> list[int]:
    counts: list[int] = []

    def counted(minimise: Callable[..., SlsqpResult]) -> Callable[..., SlsqpResult]:
        def wrapped(*arguments: Any) -> SlsqpResult:
            result = minimise(*arguments)
            counts.append(result.evaluations)
            return result

        return wrapped

    plain = slsqp_method.slsqp_minimise, slsqp_method.scipy_slsqp_minimise
    try:
        slsqp_method.slsqp_minimise, slsqp_method.scipy_slsqp_minimise = map(counted, plain)
        Retargeter("mimic_p050", method=method, preset=preset).run(recording)
    finally:
        slsqp_method.slsqp_minimise, slsqp_method.scipy_slsqp_minimise = plain
    return counts


def main(arguments: Sequence[str] | None = None) -> None:
    """Reads the command line and prints."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("results", nargs="?", type=Path, help="folder of `smooth-operator bench`")
    parser.add_argument(
        "--columns",
        nargs="+",
        choices=COLUMNS,
        metavar="COLUMN",
        help=f"one table of these for all recordings: {', '.join(COLUMNS)}",
    )
    parser.add_argument("--evaluations", type=Path, metavar="RECORDING")
    parser.add_argument("--frames", default=":", help="of the recording, as A:B")
    parser.add_argument("--rate", type=float, help="of a recording without time stamps [Hz]")
    options = parser.parse_args(arguments)
    if options.results is None and options.evaluations is None:
        parser.error("give the folder of a benchmark, or --evaluations RECORDING")
    if options.results is not None and options.columns:
        print_columns(options.results, options.columns)
    elif options.results is not None:
        print_tables(options.results)
    if options.evaluations is not None:
        ends = [int(end) if end else None for end in options.frames.split(":")]
        print_evaluations(options.evaluations, slice(*ends), options.rate)


if __name__ == "__main__":
    main()
