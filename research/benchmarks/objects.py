"""Contacts kept and penetration: the object-aware form against methods that do not know of objects.

    python research/benchmarks/objects.py       # hands and seeds that nothing was tuned on
    python research/benchmarks/objects.py --hands mimic_p050 --seeds 0 1      # those of the tuning

Clips are made by code (``smooth_operator_research.objects.scenes``), so contacts are known. Every
method has the same wrist: the robot's palm lies on the human's. Intervals are of a bootstrap over
clips.
"""

from __future__ import annotations

import math
import sys
from dataclasses import dataclass

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
from smooth_operator_research.objects.scenes import SceneSpec, make_clip
from smooth_operator_research.run_report import Report, ReportSettings, run_program


@dataclass(frozen=True)
class Settings(ReportSettings):
    """What to run.

    Attributes:
        hands: robot hands.
        seeds: each makes one clip of every kind and form.
        kinds: kinds of clips; all unless given.
        forms: forms of objects; all unless given.
        methods: compared methods.
        noise: standard deviation of the landmarks' noise [mm]; the contacts of record are without.
        side: which hand.
    """

    hands: tuple[str, ...] = REPORTED_HANDS
    seeds: tuple[int, ...] = REPORTED_SEEDS
    kinds: tuple[str, ...] = ("grasp", "pinch", "twist", "slide")
    forms: tuple[str, ...] = ("sphere", "box", "cylinder", "capsule", "mesh")
    methods: tuple[str, ...] = (AWARE, FIXED_WRIST, BLIND, FITTED, *PUBLISHED)
    noise: float = 0.0
    side: str = "right"


def main(settings: Settings) -> None:
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
        note = lambda line: print(line, file=sys.stderr, flush=True)  # noqa: E731
        rows += compare((hand,), clips, settings.methods, note=note)
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


if __name__ == "__main__":
    run_program(main, Settings, __doc__)
