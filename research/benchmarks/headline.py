"""The README's table of methods and pictures of poses, from one benchmark.

    python research/benchmarks/headline.py RECORDING... --output FOLDER [--docs docs]
        [--methods smooth,sbr:paper,dexpilot:published] [--pictures smooth,sbr,dexpilot]
        [--hands mimic_p050,shadow_hand,leap_hand]
        [--files research/docs/looks.md docs/reference/benchmarks.md]

Measures the first hand, with latency, for the table, and all hands for the pictures; writes
``DOCS/img/hands-in-poses-HAND.webp``, and puts the table into each of the files between the lines
``<!-- headline -->`` and ``<!-- /headline -->``.
"""

from __future__ import annotations

import argparse
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from smooth_operator_benchmark import (
    Finished,
    Row,
    Settings,
    make_rows,
    plan_cells,
    run_suite,
)
from smooth_operator_benchmark.command import comma_words
from smooth_operator_benchmark.contact_sheet import contact_sheet, panels_by_hand
from smooth_operator_benchmark.figures import make_panels
from smooth_operator_benchmark.model_shape import ModelShape
from smooth_operator_benchmark.page.report import summary_text

POSES: Final = ("flat", "fist", "point", "OK", "pinch middle")
"""Rows of the pictures."""
_BLOCK: Final = re.compile(r"(<!-- headline -->\n).*?(<!-- /headline -->)", re.DOTALL)


def main(arguments: Sequence[str] | None = None) -> None:
    """Measures, draws, prints the table and puts it into the files."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("recordings", nargs="+")
    parser.add_argument("--methods", default="smooth,sbr:paper,dexpilot:published")
    parser.add_argument("--pictures", help="methods of the pictures; default: --methods")
    parser.add_argument("--hands", default="mimic_p050,shadow_hand,leap_hand")
    parser.add_argument("--output", type=Path, required=True)
    parser.add_argument("--docs", type=Path)
    parser.add_argument("--files", type=Path, nargs="*", default=[])
    options = parser.parse_args(arguments)
    hands = comma_words(options.hands)
    text = summary_text(*_measured(options, hands[0], options.methods, latency_frames=500)[1:])
    print(text)
    for path in options.files:
        _put(path, text)
    for hand in hands if options.docs is not None else ():
        finished, _, _ = _measured(options, hand, options.pictures or options.methods)
        for (name, _), panels in panels_by_hand(make_panels(finished)).items():
            sheet = contact_sheet(panels, ModelShape, POSES)
            if sheet is not None:
                path = options.docs / "img" / f"hands-in-poses-{name}.webp"
                sheet.save(path, quality=82, method=6)
                print(f"wrote {path}")


def _measured(
    options: argparse.Namespace, hand: str, methods: str, latency_frames: int = 0
) -> tuple[list[Finished], list[Row], Settings]:
    settings = Settings(
        output=options.output / hand,
        recordings=tuple(options.recordings),
        hands=(hand,),
        methods=comma_words(methods),
        workers=0,
        latency_frames=latency_frames,
    )
    finished = run_suite(settings, plan_cells(settings))
    return finished, make_rows(finished, settings), settings


def _put(path: Path, text: str) -> None:
    """Replaces the block of a file."""
    old = path.read_text(encoding="utf-8")
    new, count = _BLOCK.subn(lambda block: f"{block[1]}{text}{block[2]}", old)
    if not count:
        raise SystemExit(f"{path}: no lines <!-- headline --> and <!-- /headline -->")
    path.write_text(new, encoding="utf-8")
    print(f"wrote {path}")


if __name__ == "__main__":
    main()
