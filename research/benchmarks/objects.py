"""Contacts kept and penetration: the object-aware form against methods that do not know of objects.

    python research/benchmarks/objects.py       # hands and seeds that nothing was tuned on
    python research/benchmarks/objects.py --hands mimic_p050 --seeds 0 1      # those of the tuning
    python research/benchmarks/objects.py --picture docs/img/objects.png

Clips are made by code (``smooth_operator_research.objects.scenes``), so contacts are known. Every
method has the same wrist: the robot's palm lies on the human's. Intervals are of a bootstrap over
clips. ``--picture`` draws one frame of one clip without and with the object.
"""

from __future__ import annotations

import math
import sys
from dataclasses import dataclass
from pathlib import Path

from smooth_operator_research.objects.comparison import (
    AWARE,
    BLIND,
    COLUMNS,
    COMBINATIONS,
    FITTED,
    FIXED_WRIST,
    PUBLISHED,
    REPORTED_HANDS,
    REPORTED_SEEDS,
    Judged,
    compare,
    table,
    targets,
)
from smooth_operator_research.objects.picture import draw_comparison
from smooth_operator_research.objects.scenes import SceneSpec, make_clip
from smooth_operator_research.run_report import Report, ReportSettings, run_program


@dataclass(frozen=True)
class Settings(ReportSettings):
    """What to run.

    Attributes:
        hands: robot hands.
        seeds: of the clips; each makes one clip of every kind and form.
        kinds: of clips; all unless given.
        forms: of objects; all unless given.
        methods: to compare.
        noise: of the landmarks [mm], a standard deviation; the contacts of record are without.
        side: of the hands.
        picture: draw one clip into this file instead.
    """

    hands: tuple[str, ...] = REPORTED_HANDS
    seeds: tuple[int, ...] = REPORTED_SEEDS
    kinds: tuple[str, ...] = ("grasp", "pinch", "twist", "slide")
    forms: tuple[str, ...] = ("sphere", "box", "cylinder", "capsule", "mesh")
    methods: tuple[str, ...] = (AWARE, FIXED_WRIST, BLIND, FITTED, *PUBLISHED)
    noise: float = 0.0
    side: str = "right"
    picture: Path | None = None


def main(settings: Settings) -> None:
    if settings.picture is not None:
        draw_comparison(settings.picture)
        print(f"{settings.picture}: written")
        return
    report = Report("objects", vars(settings))
    specs = [
        SceneSpec(kind, form, seed, settings.side, 1e-3 * settings.noise)
        for seed in settings.seeds
        for kind, form in COMBINATIONS
        if kind in settings.kinds and form in settings.forms
    ]
    clips = [make_clip(spec) for spec in specs]
    rows: list[Judged] = []
    for hand in settings.hands:
        rows += compare((hand,), clips, settings.methods, note=_note)
        print(f"\n{hand}, {len(clips)} clips\n\n{table(rows, hand)}", flush=True)
    if len(settings.hands) > 1:
        print(f"\nAll hands, {len(clips)} clips each\n\n{table(rows)}\n")
    if {AWARE, BLIND} <= set(settings.methods):
        for name, (mean, low, high) in targets(rows).items():
            print(f"{name}: {mean:.3f} [{low:.3f}, {high:.3f}]")
    for row in rows:
        figures = {c: row.figures[c] for c in COLUMNS if math.isfinite(row.figures[c])}
        report.add(f"{row.hand}/{row.clip}/{row.method}", figures)
    report.finish(settings.output, settings.compare)


def _note(line: str) -> None:
    print(line, file=sys.stderr, flush=True)


if __name__ == "__main__":
    run_program(main, Settings, __doc__)
