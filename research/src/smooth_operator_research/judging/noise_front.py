"""How much tracker noise ``smooth`` removes, and what that costs: a table and a picture.

    python -m smooth_operator_research.judging.noise_front --data RECORDINGS

Each row is a value of ``tracker_noise.acceleration``: without removal, the palm's fit alone, and
filters that get stronger. Columns are the fingertip error and the lag of reachable motion with
0.5 mm of noise, the motion of a built-in operator with as much noise, against the operator without
it and against the tracked landmarks, and the largest loss on real recordings. No seed is one of the
judge's or of ``bench --physics``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Final

import numpy as np
import tyro

from smooth_operator import Retargeter, SmoothOperatorError, load_hand
from smooth_operator.formats.setting_paths import numeric_settings, with_settings
from smooth_operator.human.alignment import align_recording
from smooth_operator.lab.benchmark.recordings import Source, load_sources, parse_request
from smooth_operator.lab.tuning.score import figure
from smooth_operator.lab.tuning.traced import TracedRun
from smooth_operator.methods.presets import method_config
from smooth_operator.metrics import evaluate
from smooth_operator.metrics.assemble import assemble_trace
from smooth_operator.reporting.drawing import INK, styled, write_figure
from smooth_operator.types import CommandTrajectory, HandRecording
from smooth_operator_research.judging.judge import FILES
from smooth_operator_research.judging.targets import TruthFigures, against_truth, without_noise
from smooth_operator_research.physics.reachable_motion import (
    AskedMotion,
    motion_figures,
    reachable_motion,
)
from smooth_operator_research.run_report import RESULTS, BenchmarkError, Report

SETTING: Final = "tracker_noise.acceleration"
FIT_ALONE: Final = 1e6
"""So much motion between two frames that nothing is filtered over time [m/s^2]."""
CHOSEN: Final = numeric_settings(method_config("smooth"))[SETTING]
NOISE: Final = 5e-4
COLUMNS: Final = (
    "tip error [mm]", "lag [ms]", "motion, noise-free", "vel. corr., noise-free", "jitter [mm]",
    "motion, tracked", "largest loss of motion", "of vel. corr.",
)  # fmt: skip


@dataclass(frozen=True)
class Settings:
    """What to measure.

    Attributes:
        accelerations: values of the setting [m/s^2]; 0 and the palm's fit alone come first.
        data: folder of the judge's recordings; without it the columns of real ones are empty.
        hands: robot hands of reachable motion; recordings are for the first.
        seed: of reachable motion.
        operator: seed of the built-in operator.
        output: JSON file; Markdown and the picture stand next to it.
    """

    accelerations: tuple[float, ...] = (0.3, 0.1, 0.03, 0.01, 0.003, 0.001)
    data: Path | None = None
    hands: tuple[str, ...] = ("mimic_p050", "wuji_hand")
    seed: int = 300
    operator: int = 31
    output: Path = RESULTS / "noise.json"


@dataclass(frozen=True)
class Row:
    """The figures of one value.

    Attributes:
        tip_error_mm, lag_ms: of reachable motion with noise, mean over hands.
        truth: the operator with noise, against the same one without.
        tracked: its motion preservation against the tracked landmarks.
        real: recording -> motion preservation, velocity correlation.
    """

    tip_error_mm: float
    lag_ms: float
    truth: TruthFigures
    tracked: float
    real: Mapping[str, tuple[float, float]]

    def loss(self, off: Row, figure: int) -> float | None:
        """Largest loss of a figure on a real recording."""
        lost = [off.real[name][figure] - values[figure] for name, values in self.real.items()]
        return max(lost) if lost else None


def main(settings: Settings) -> None:
    """Measures all values, prints the table and draws the picture."""
    files = () if settings.data is None else (*FILES[:2], *FILES[3:])
    texts = [f"{settings.data}/{name}" for name in files]
    texts += [f"synthetic:{settings.operator}@0.5mm,:1200"]
    sources = load_sources([parse_request(text) for text in texts])
    for source in sources:
        if source.error is not None:
            raise BenchmarkError(source.error)
    values = (0.0, FIT_ALONE, *settings.accelerations)
    rows = {value: measure(value, sources, settings) for value in values}
    report, off = Report("noise", vars(settings)), rows[0.0]
    cells = []
    for value, row in rows.items():
        figures = (row.tip_error_mm, row.lag_ms, row.truth.motion_preservation,
                 row.truth.velocity_correlation, row.truth.jitter_mm, row.tracked,
                 row.loss(off, 0), row.loss(off, 1))  # fmt: skip
        cells.append([name_of(value), *figures])
        report.add(name_of(value), dict(zip(COLUMNS, figures, strict=True)))
    report.table("Removal of tracker noise", ("filter", *COLUMNS), cells)
    settings.output.parent.mkdir(parents=True, exist_ok=True)
    report.finish(settings.output, None)
    settings.output.with_suffix(".md").write_text(report.tables() + "\n", encoding="utf-8")
    draw(rows, CHOSEN, settings.output.with_suffix(""))


def name_of(value: float) -> str:
    """What a value is called."""
    return {0.0: "off", FIT_ALONE: "fit alone"}.get(value, f"{value:g} m/s²")


@lru_cache
def run_of(hand_name: str, off: bool) -> TracedRun:
    """``smooth`` on one hand; one program for all values but 0, which leaves the filter out."""
    config = with_settings(method_config("smooth", "precise"), {SETTING: 0.0 if off else CHOSEN})
    return TracedRun(Retargeter(load_hand(hand_name), config=config), () if off else (SETTING,))


def measure(value: float, sources: Sequence[Source], settings: Settings) -> Row:
    """The figures of one value of the setting."""

    def commands(hand_name: str, recording: HandRecording) -> CommandTrajectory:
        return run_of(hand_name, value == 0).run(recording, {SETTING: value})

    errors = []
    for name in settings.hands:
        request = asked_motion(name, settings.seed)
        joints = commands(name, request.recording).joint_positions
        measured = motion_figures(load_hand(name), request, joints)
        errors.append([measured["tip_error_mm"], measured["lag_ms"]])
    hand, real = load_hand(settings.hands[0]), {}
    for source in sources:
        recording, clean = source.recording, without_noise(source)
        assert recording is not None  # checked by main
        answer = commands(settings.hands[0], recording)
        trace = assemble_trace(recording, answer, hand, reach_samples=0)
        figures = evaluate(trace)
        motion = figure(figures, "motion_preservation") or np.nan
        if clean is None:
            real[source.name] = (motion, figure(figures, "velocity_correlation") or np.nan)
        else:
            truth, tracked = against_truth(trace, align_recording(clean, hand)).robot, motion
    tip, lag = np.mean(np.array(errors, float), axis=0)
    return Row(float(tip), float(lag), truth, tracked, real)


@lru_cache
def asked_motion(hand_name: str, seed: int) -> AskedMotion:
    """Reachable motion with noise; all values are asked for the same."""
    return reachable_motion(load_hand(hand_name), seed, noise=NOISE)


def draw(rows: Mapping[float, Row], chosen: float, stem: Path) -> None:
    """Three panels over the fingertip error: motion kept, loss on real recordings, lag."""
    from matplotlib.figure import Figure

    errors, off = [row.tip_error_mm for row in rows.values()], rows[0.0]
    lost = [row.loss(off, 0) for row in rows.values()]
    panels: list[tuple[str, dict[str, list[float]]]] = [
        ("motion preservation, operator with 0.5 mm", {
            "against the operator without noise":
                [row.truth.motion_preservation or np.nan for row in rows.values()],
            "against the tracked landmarks": [row.tracked for row in rows.values()],
        }),
        ("largest loss of it on a real recording",
         {"": [np.nan if value is None else value for value in lost]}),
        ("lag of reachable motion [ms]", {"": [row.lag_ms for row in rows.values()]}),
    ]  # fmt: skip
    with styled():
        drawn = Figure(figsize=(10.0, 3.3), layout="constrained")
        axes = drawn.subplots(1, len(panels))
        for ax, (title, lines) in zip(axes, panels, strict=True):
            for (label, values), marker in zip(lines.items(), "os", strict=False):
                ax.plot(errors, values, marker=marker, ms=4, label=label or None)
                at = list(rows).index(chosen)
                ax.plot(errors[at], values[at], marker=marker, ms=10, mfc="none", color=INK)
            for value, x, y in zip(rows, errors, next(iter(lines.values())), strict=True):
                ax.annotate(name_of(value), (x, y), (3, 5), textcoords="offset points", size=7)
            ax.set(title=title, xlabel="fingertip error, 0.5 mm noise [mm]")
            ax.margins(0.16)
            if len(lines) > 1:
                ax.legend(fontsize=7)
        write_figure(drawn, stem)


if __name__ == "__main__":
    try:
        main(tyro.cli(Settings, description=__doc__))
    except SmoothOperatorError as error:
        raise BenchmarkError(str(error)) from error
