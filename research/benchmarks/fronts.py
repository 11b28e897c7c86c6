"""Trade-offs between posture, thumb directions, motion and stillness, by setting.

    python research/benchmarks/fronts.py [RECORDING...] [--still RECORDING...]
        [--hands leap_hand...] [--output FOLDER]

Each curve is one setting of the default method, the others as they are; each point is the mean over
the recordings, one recording one unit. ``--still``: recordings with rests, for the front of shake
at rest and motion, drawn as ``stillness.svg``. ``--hands``: the front between ``smooth:precise``
and ``smooth`` by ``correspondence.share``, on other hands. Prints tables, and draws ``fronts.svg``
if recordings are given for posture.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from looks import COLUMNS, figures

from smooth_operator.hands.registry import load_hand
from smooth_operator.metrics.assemble import assemble_trace
from smooth_operator.reporting.drawing import INK, styled, write_figure
from smooth_operator.retargeting.preset_files import method_config, with_settings
from smooth_operator.retargeting.retargeter import Retargeter
from smooth_operator.types import HandRecording
from smooth_operator_benchmark.recordings import load_sources, parse_request

PLACES: Final[Mapping[str, Sequence[float]]] = {
    "correspondence.share": (0.0, 0.4, 0.7, 0.85, 1.0),
    "correspondence.thumb_follows": (0.0, 0.1, 0.3, 1.0),
    "pinch_damping": (0.0, 30.0, 100.0, 300.0),
    "direction_length.direction": (1.0, 1.5, 1.9, 3.0, 6.0),
}
"""Setting -> values that trade posture for directions of the thumb."""
STILLNESS: Final[Mapping[str, Sequence[float]]] = {
    "fingertips.share": (0.1, 0.2, 0.3, 0.5, 1.0),
    "fingertips.reach": (1.5, 3.0, 5.0, 8.0),
    "motion_weight": (1500.0, 3000.0, 6000.0, 12000.0),
    "motion_speed": (0.02, 0.05, 0.1),
}
"""Setting -> values that trade motion for stillness."""


def row(
    hand: str, settings: Mapping[str, Any], recordings: Iterable[HandRecording], preset: str = ""
) -> list[float]:
    """Means of the columns of ``looks.py`` over the recordings, for a preset of ``smooth`` with
    some settings."""
    config = with_settings(method_config("smooth", preset or None), settings)
    retargeter = Retargeter(load_hand(hand), config=config)
    traces = (
        assemble_trace(one, retargeter.run(one)[0], retargeter.hand, reach_samples=0)
        for one in recordings
    )
    rows = [figures(trace) for trace in traces]
    return [float(x) for x in np.ma.masked_invalid(rows).mean(axis=0).filled(np.nan)]


def front(
    hand: str, sweep: Mapping[str, Sequence[float]], recordings: Sequence[HandRecording]
) -> dict[str, np.ndarray]:
    """Setting -> (V, M) metrics by value, printed as a table."""
    print(f"\n## {hand}, {len(recordings)} recordings\n")
    print("| setting | value | " + " | ".join(COLUMNS.values()) + " |")
    print("|---|---:|" + "---:|" * len(COLUMNS))
    curves = {}
    for name, values in sweep.items():
        curves[name] = np.array([row(hand, {name: value}, recordings) for value in values])
        for value, means in zip(values, curves[name], strict=True):
            print(f"| {name} | {value:g} | " + " | ".join(f"{x:.3g}" for x in means) + " |")
    return curves


def draw_front(
    ax: Any,
    curves: Mapping[str, np.ndarray],
    sweep: Mapping[str, Sequence[float]],
    x: str,
    y: str,
) -> None:
    """Draws one curve per setting over two metrics; each point is labelled with its value."""
    columns = [list(COLUMNS.values()).index(name) for name in (x, y)]
    for name, means in curves.items():
        points = means[:, columns]
        ax.plot(*points.T, marker="o", ms=4, label=name.rpartition(".")[2])
        for value, point in zip(sweep.get(name, ()), points, strict=False):
            ax.annotate(f"{value:g}", point, (3, 3), textcoords="offset points", size=6)
    ax.legend(fontsize=6)
    ax.margins(0.1)


def main(arguments: Sequence[str] | None = None) -> None:
    """Prints the tables and draws the picture."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("recordings", nargs="*", default=())
    parser.add_argument("--still", nargs="+", default=())
    parser.add_argument("--hand", default="mimic_p050")
    parser.add_argument("--hands", nargs="*", default=())
    parser.add_argument("--output", type=Path, default=Path("."))
    options = parser.parse_args(arguments)
    recordings, still = (
        [s.recording for s in load_sources([parse_request(t) for t in texts]) if s.recording]
        if texts
        else []
        for texts in (options.recordings, options.still)
    )
    from matplotlib.figure import Figure

    options.output.mkdir(parents=True, exist_ok=True)
    if still:
        curves = front(options.hand, STILLNESS, still)
        with styled():
            drawn = Figure(figsize=(4.5, 3.8), layout="constrained")
            draw_front(drawn.subplots(), curves, STILLNESS, "shake", "motion")
            (ax,) = drawn.axes
            ax.axvline(0.7, color=INK, lw=0.5, ls=":")
            ax.axhline(0.92, color=INK, lw=0.5, ls=":")
            ax.set(xlabel="shake at rest, robot / human", ylabel="motion preservation")
            write_figure(drawn, options.output / "stillness")
    if not recordings:
        return
    share = {"correspondence.share": PLACES["correspondence.share"]}
    places = front(options.hand, PLACES, recordings)
    hands, precise = {}, {}
    for hand in options.hands:
        hands[hand] = front(hand, share, recordings)["correspondence.share"]
        precise[hand] = np.array(row(hand, {}, recordings, "precise"))
        print("| `smooth:precise` | | " + " | ".join(f"{x:.3g}" for x in precise[hand]) + " |")
    with styled():
        drawn = Figure(figsize=(8.0, 3.8), layout="constrained")
        one, two = drawn.subplots(1, 2)
        draw_front(one, places, PLACES, "extension", "thumb cos")
        one.axvline(0.04, color=INK, lw=0.5, ls=":")
        one.axhline(0.97, color=INK, lw=0.5, ls=":")
        one.set(xlabel="extension error", ylabel="thumb cosine", title=options.hand)
        values = dict.fromkeys(hands, share["correspondence.share"])
        draw_front(two, hands, values, "extension", "thumb cos")
        columns = [list(COLUMNS.values()).index(name) for name in ("extension", "thumb cos")]
        for line, means in zip(two.get_lines(), precise.values(), strict=True):
            two.plot(*means[columns], "s", ms=6, color=line.get_color())
        two.set(xlabel="extension error", ylabel="thumb cosine", title="by share; square: precise")
        write_figure(drawn, options.output / "fronts")


if __name__ == "__main__":
    main()
