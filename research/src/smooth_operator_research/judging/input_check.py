"""How often a hand of the wrong side, or landmarks in the wrong order, are refused; right ones too.

Windows of recordings and of built-in operators, as they are and mirrored, clean and with the noise
of a tracker, go through the check that every recording and every live tracker goes through
(``smooth_operator.io.check_hand``). Prints a table: how many of the right ones are refused,
which should be none; of each fault how many are noticed, and how many of these are named rightly.

    python -m smooth_operator_research.judging.input_check glove.npz video.npz@30hz
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np

from smooth_operator.io.anatomy import FEWEST_FRAMES, doubt
from smooth_operator.lab.benchmark.recordings import load_sources, parse_request
from smooth_operator.landmarks import LAYOUTS
from smooth_operator.synthetic import SyntheticOperator
from smooth_operator.types import HandRecording, Side

MIRROR: Final = np.array([-1.0, 1.0, 1.0])


@dataclass(frozen=True)
class Window:
    """Frames that follow each other, of a side.

    Attributes:
        of: name of the recording.
        landmarks: (T, 21, 3) [m].
        side: which hand it shows.
    """

    of: str
    landmarks: np.ndarray
    side: Side


def windows(
    recordings: list[HandRecording], seconds: float, noise: float, rng: np.random.Generator
) -> Iterator[Window]:
    """All windows of a length, one after the other, and as many at random places and of random
    length down to the fewest frames; each also as its mirror image."""
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
            other: Side = "left" if recording.side == "right" else "right"
            yield Window(recording.name, noisy, recording.side)
            yield Window(recording.name, noisy * MIRROR, other)


def in_layout(landmarks: np.ndarray, name: str) -> np.ndarray:
    """Landmarks of ours as another tracker has them."""
    points = np.empty_like(landmarks)
    points[:, LAYOUTS[name]] = landmarks
    return points


def table(
    recordings: list[HandRecording], seconds: float, noises: list[float], seed: int, share_of: int
) -> None:
    """Measures and prints; layouts over one window of ``share_of``."""
    faults = [name for name in LAYOUTS if name not in ("mediapipe", "openpose")]
    others: dict[Side, Side] = {"right": "left", "left": "right"}
    row("noise [mm]", "input", "windows", "refused", "named rightly")
    row("---", "---", "---:", "---:", "---:")
    for noise in noises:
        rng = np.random.default_rng(seed)
        every = list(windows(recordings, seconds, 1e-3 * noise, rng))
        refused = [w for w in every if doubt(w.landmarks, w.side) is not None]
        row(f"{noise:g}", "right side, right order", len(every), len(refused), "")
        for of in sorted({w.of for w in refused}):
            row("", f"of these, {of}", "", sum(w.of == of for w in refused), "")
        doubts = [doubt(w.landmarks, others[w.side]) for w in every]
        measured = [d for d in doubts if d is not None]
        named = sum(d.side is not None for d in measured)
        row(f"{noise:g}", "mirrored", len(every), share(len(measured), len(every)), named)
        missed = [w.of for w, d in zip(every, doubts, strict=True) if d is None]
        for of in sorted(set(missed)):
            total = sum(w.of == of for w in every)
            row("", f"mirrored, {of}", total, share(total - missed.count(of), total), "")
        some = every[::share_of]
        for name in faults:
            doubts = [doubt(in_layout(w.landmarks, name), w.side) for w in some]
            measured = [d for d in doubts if d is not None]
            named = sum(d.layout == name for d in measured)
            row(f"{noise:g}", f"`{name}`", len(some), share(len(measured), len(some)), named)
        shuffled = [doubt(w.landmarks[:, rng.permutation(21)], w.side) for w in every]
        noticed = sum(d is not None for d in shuffled)
        row(f"{noise:g}", "random order", len(every), share(noticed, len(every)), "")
        shares = [
            doubt(in_layout(w.landmarks, name), w.side, layout=name)
            for w in some
            for name in faults
        ]
        noticed = sum(d is not None for d in shares)
        row(f"{noise:g}", "each of these layouts, when it is said", len(shares), noticed, "")


def row(*cells: object) -> None:
    """A row of a Markdown table."""
    print("|", " | ".join(map(str, cells)), "|", flush=True)


def share(part: int, whole: int) -> str:
    """A count with its percentage."""
    return f"{part} ({100 * part / max(whole, 1):.1f} %)"


def main() -> None:
    """Reads the recordings, adds built-in operators."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("recordings", nargs="*", help="files, with settings after an @")
    parser.add_argument("--seconds", type=float, default=1.0, help="longest window")
    parser.add_argument("--noise", type=float, nargs="*", default=[0.0, 2.0, 4.0], help="[mm]")
    parser.add_argument("--operators", type=int, default=3, help="built-in operators, 10 s each")
    parser.add_argument("--share", type=int, default=11, help="layouts: one window of so many")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    recordings = []
    if options.recordings:
        for source in load_sources([parse_request(text) for text in options.recordings]):
            if source.recording is None:
                raise SystemExit(source.error)
            recordings.append(source.recording)
    recordings += [SyntheticOperator(seed=seed).record(10.0) for seed in range(options.operators)]
    table(recordings, options.seconds, options.noise, options.seed, options.share)


if __name__ == "__main__":
    main()
