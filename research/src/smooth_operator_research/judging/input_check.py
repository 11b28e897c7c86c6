"""Measures how many mirrored hands, wrong orders and correct frames the input check refuses.

Windows of recordings and of built-in operators, original and mirrored, clean and with the noise of
a tracker, pass through the check of every recording and every live tracker
(``smooth_operator.io.check_hand``). The program prints how many correct windows are refused (which
should be none) and, for each fault, how many are detected and how many of these named correctly.

    python -m smooth_operator_research.judging.input_check glove.npz video.npz@30hz
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Sequence
from typing import Final, NamedTuple

import numpy as np

from smooth_operator.io.anatomy import FEWEST_FRAMES
from smooth_operator.io.landmark_order import doubt
from smooth_operator.landmarks import LAYOUTS
from smooth_operator.synthetic import SyntheticOperator
from smooth_operator.types import HandRecording, Side
from smooth_operator_benchmark.recordings import load_sources, parse_request
from smooth_operator_research.run_report import markdown

MIRROR: Final = np.array([-1.0, 1.0, 1.0])
OTHER: Final[dict[Side, Side]] = {"right": "left", "left": "right"}


class Window(NamedTuple):
    """Consecutive frames (T, 21, 3) [m] of a hand of one side in a recording."""

    recording: str
    landmarks: np.ndarray
    side: Side


def windows(
    recordings: Sequence[HandRecording], seconds: float, noise: float, rng: np.random.Generator
) -> Iterator[Window]:
    """All consecutive windows of a length, and as many at random positions with random lengths down
    to the fewest frames; each also as its mirror image."""
    for recording in recordings:
        whole = np.isfinite(recording.landmarks).all(axis=(1, 2))
        assert recording.valid is not None
        points = recording.landmarks[whole & recording.valid.all(axis=1)]
        count = min(len(points), max(FEWEST_FRAMES, round(seconds * recording.rate_hz)))
        cuts = [slice(i, i + count) for i in range(0, len(points) - count + 1, count)]
        for _ in range(len(cuts)):
            length = int(rng.integers(min(FEWEST_FRAMES, count), count + 1))
            first = int(rng.integers(0, len(points) - length + 1))
            cuts.append(slice(first, first + length))
        for cut in cuts:
            noisy = points[cut] + rng.normal(0.0, noise, points[cut].shape) * (noise > 0)
            yield Window(recording.name, noisy, recording.side)
            yield Window(recording.name, noisy * MIRROR, OTHER[recording.side])


def in_layout(landmarks: np.ndarray, name: str) -> np.ndarray:
    """Converts this project's landmarks to the order of another tracker."""
    points = np.empty_like(landmarks)
    points[:, LAYOUTS[name]] = landmarks
    return points


def table(
    recordings: Sequence[HandRecording], seconds: float, noises: Sequence[float], seed: int,
    share_of: int,
) -> str:  # fmt: skip
    """Makes a Markdown table of layouts over the windows of ``share_of``."""
    rows: list[list[object]] = []

    def add(
        noise: float, name: str, some: Sequence[Window], check: Callable[[Window], object],
        right: Callable[[object], bool] | None = None,
    ) -> None:  # fmt: skip
        doubts = [check(window) for window in some]
        noticed = [one for one in doubts if one is not None]
        share = f"{len(noticed)} ({100 * len(noticed) / max(len(some), 1):.1f} %)"
        named = "" if right is None else str(sum(map(right, noticed)))
        rows.append([f"{noise:g}", name, str(len(some)), share, named])
        if 0 < len(noticed) < len(some):
            for recording in sorted({window.recording for window in some}):
                own = [d for w, d in zip(some, doubts, strict=True) if w.recording == recording]
                count = sum(one is not None for one in own)
                rows.append(["", f"{name}, {recording}", str(len(own)), str(count), ""])

    for noise in noises:
        rng = np.random.default_rng(seed)
        every = list(windows(recordings, seconds, 1e-3 * noise, rng))
        some = every[::share_of]
        add(noise, "right side, right order", every, lambda w: doubt(w.landmarks, w.side))
        add(noise, "mirrored", every, lambda w: doubt(w.landmarks, OTHER[w.side]),
            lambda one: one.side is not None)  # type: ignore[attr-defined]  # fmt: skip
        for layout in (name for name in LAYOUTS if name not in ("mediapipe", "openpose")):
            add(noise, f"`{layout}`", some,
                lambda w, name=layout: doubt(in_layout(w.landmarks, name), w.side),  # type: ignore[misc]
                lambda one, name=layout: one.layout == name)  # type: ignore[misc]  # fmt: skip
            add(noise, f"`{layout}`, when it is said", some,
                lambda w, name=layout: doubt(in_layout(w.landmarks, name), w.side, layout=name))  # type: ignore[misc]  # fmt: skip
        add(noise, "random order", every,
            lambda w, rng=rng: doubt(w.landmarks[:, rng.permutation(21)], w.side))  # type: ignore[misc]  # fmt: skip
    return markdown(("noise [mm]", "input", "windows", "refused", "named rightly"), rows)


def main() -> None:
    """Reads the recordings, adds built-in operators, and prints the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("recordings", nargs="*", help="files, with settings after an @")
    parser.add_argument("--seconds", type=float, default=1.0, help="longest window")
    parser.add_argument("--noise", type=float, nargs="*", default=[0.0, 2.0, 4.0], help="[mm]")
    parser.add_argument("--operators", type=int, default=3, help="built-in operators, 10 s each")
    parser.add_argument(
        "--share", type=int, default=11, help="for layouts: use one window in this many"
    )
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    recordings = []
    if options.recordings:
        for source in load_sources([parse_request(text) for text in options.recordings]):
            if source.recording is None:
                raise SystemExit(source.error)
            recordings.append(source.recording)
    recordings += [SyntheticOperator(seed=seed).record(10.0) for seed in range(options.operators)]
    print(table(recordings, options.seconds, options.noise, options.seed, options.share))


if __name__ == "__main__":
    main()
