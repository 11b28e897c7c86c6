"""Measures real trackers from recordings: clock, losses, rigidity of the palm, shake of fingertips.

``python -m smooth_operator_research.tracker_fit RECORDING[@SETTINGS] ...`` prints the tables of
``research/docs/trackers.md``, which explains how the values of ``synthetic.tracker`` follow from
them.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Float
from scipy.optimize import nnls
from scipy.stats import spearmanr

from smooth_operator.landmarks import BASES, FINGERS, TIPS, WRIST
from smooth_operator.types import HandRecording
from smooth_operator_benchmark.recordings import load_sources, parse_request

PALM: Final = (WRIST, *BASES[1:])
"""Landmarks of the palm: wrist and MCPs."""

_WINDOW_S: Final = 0.5
_FEWEST: Final = 14  # frames of a window
_STILL: Final = 0.002  # by how much a fingertip's mean place may change within a window [m]
_TIMES: Final = np.concatenate([[1e-4], np.geomspace(0.005, 0.3, 60)])
"""Correlation times to try [s]; the first is white noise."""
_OUTLIER: Final = 5.0  # robust standard deviations
_LONGEST_GAP_S: Final = 0.25
"""Longest gap that counts as a loss of frames [s]; in longer gaps, the hand was out of view."""


@dataclass(frozen=True)
class ClockFit:
    """Timing of the frames.

    Attributes:
        rate_hz: one over the median time between frames [Hz].
        rate_jitter: robust standard deviation of a frame's time from an even grid, over the
            period.
        frame_loss: fraction of frames that never came or lack a complete hand, in gaps of up to
            0.25 s; in longer gaps, the hand was out of view.
        frame_loss_burst: mean length of such a gap [s]; 0 without gaps.
    """

    rate_hz: float
    rate_jitter: float
    frame_loss: float
    frame_loss_burst: float


def fit_clock(recording: HandRecording) -> ClockFit:
    """Rate, jitter and losses of a recording, from its stamps and from landmarks that are NaN."""
    seen = np.isfinite(recording.landmarks).all(axis=(1, 2))
    steps = np.diff(recording.stamps)
    period = float(np.median(steps))
    # Two neighbours' offsets make a step: its deviation is the square root of 2 times theirs.
    usual = steps[steps < 1.5 * period]
    spread = 1.4826 * float(np.median(np.abs(usual - period))) / np.sqrt(2.0)
    between = np.diff(recording.stamps[seen])
    missing = np.rint(between / period) - 1
    gaps = missing[(missing > 0) & (between < _LONGEST_GAP_S)]
    lost = float(gaps.sum())
    return ClockFit(
        1.0 / period,
        spread / period,
        lost / (lost + float(seen.sum())),
        float(gaps.mean()) * period if len(gaps) else 0.0,
    )


def in_palm(
    landmarks: Float[np.ndarray, "T 21 3"],
) -> tuple[Float[np.ndarray, "T 21 3"], Float[np.ndarray, "T 5 3"]]:
    """Landmarks in the palm frame, and their deviation from a rigid palm.

    The frame is the best rigid fit (Kabsch 1976) of wrist and MCPs to their mean shape.

    Returns:
        (T, 21, 3) landmarks [m]; (T, 5, 3) the palm's deviation from its mean shape [m]; NaN in
        frames without a complete hand.
    """
    seen = np.isfinite(landmarks).all(axis=(1, 2))
    points = landmarks[seen].astype(float)
    palm = points[:, PALM]
    centre = palm.mean(axis=1, keepdims=True)
    palm = palm - centre
    shape = palm[0]
    for _ in range(5):
        left, _, right = np.linalg.svd(np.einsum("tki,kj->tij", palm, shape))
        flip = np.ones((len(palm), 3))
        flip[:, 2] = np.sign(np.linalg.det(left @ right))
        turn = (left * flip[:, None]) @ right
        shape = (palm @ turn).mean(axis=0)
    out = np.full(landmarks.shape, np.nan)
    residual = np.full((len(landmarks), len(PALM), 3), np.nan)
    out[seen] = (points - centre) @ turn
    residual[seen] = palm @ turn - shape
    return out, residual


def still_windows(track: Float[np.ndarray, "T 3"], stamps: Float[np.ndarray, " T"]) -> list[slice]:
    """Windows of half a second (at least 14 frames) in which a point is at rest.

    Rest is judged by the means over quarters of a window, so that the choice does not prefer
    windows in which the tracker happens to shake little.
    """
    period = float(np.median(np.diff(stamps)))
    size = max(round(_WINDOW_S / period), _FEWEST)
    found, start = [], 0
    while start + size <= len(track):
        window = slice(start, start + size)
        start += max(size // 8, 1)
        if np.isfinite(track[window]).all() and np.diff(stamps[window]).max() < 3.5 * period:
            means = np.stack([part.mean(axis=0) for part in np.array_split(track[window], 4)])
            if np.linalg.norm(means[:, None] - means, axis=-1).max() < _STILL:
                found.append(window)
                start = window.start + size // 2
    return found


@dataclass(frozen=True)
class ShakeFit:
    """Shake of fingertips, without the person's own motion.

    Attributes:
        windows: number of windows at rest.
        frame: standard deviation, per coordinate, of white noise with the same second differences
            from frame to frame [m].
        shake: standard deviation of the autoregression, per coordinate [m].
        shake_time: its correlation time [s]; 0.0001 for white noise.
        outliers: fraction of second differences beyond five robust standard deviations.
    """

    windows: int
    frame: float
    shake: float
    shake_time: float
    outliers: float


def fit_shake(windows: Sequence[Float[np.ndarray, "w c"]], period: float) -> ShakeFit:
    """Shake of fingertips at rest, from their second differences over several lags.

    A second difference y(t + k) - 2 y(t) + y(t - k) contains neither position nor steady motion.
    Its variance for lags of k frames is

        2 s^2 (3 - 4 p^k + p^2k) + 2/3 q (k T)^3,    p = exp(-T / tau),

    for a tracker that is a first-order autoregression (s, tau) and a smoothly moving person whose
    velocity is a random walk (q). A person's tremor counts as the tracker's. For each lag, from a
    frame to a quarter of a window, the median over windows is used. s^2 and q minimise the squared
    relative error and are not negative; tau is the best of 61 values.

    Args:
        windows: parts in which a fingertip is at rest [m], of c coordinates each.
        period: time between frames [s].
    """
    shortest = min((len(window) for window in windows), default=0)
    if shortest < 12:
        raise ValueError(f"a fit of shake needs windows of 12 frames or more, not {shortest}")
    lags = np.unique(np.rint(np.geomspace(1, shortest // 4, 8)).astype(int))
    variances = np.array(
        [np.median([(_bend(window, k) ** 2).mean() for window in windows]) for k in lags]
    )
    variances = np.maximum(variances, 1e-18)
    times = lags * period
    best, shake, shake_time = np.inf, 0.0, 0.0
    for time in _TIMES:
        keep = np.exp(-times / time)
        model = np.stack([6.0 - 8.0 * keep + 2.0 * keep**2, 2.0 / 3.0 * times**3], axis=1)
        found, error = nnls(model / variances[:, None], np.ones(len(lags)))
        if error < best:
            best, shake, shake_time = error, float(np.sqrt(found[0])), float(time)
    bends = np.concatenate([_bend(window, 1) for window in windows])
    usual = 1.4826 * np.median(np.abs(bends), axis=0)
    outliers = float((np.abs(bends) > _OUTLIER * np.maximum(usual, 1e-12)).mean())
    frame = float(np.sqrt(variances[0] / 6.0))
    return ShakeFit(len(windows), frame, shake, shake_time, outliers)


def _bend(track: Float[np.ndarray, "w c"], lag: int) -> Float[np.ndarray, "v c"]:
    return np.asarray(track[2 * lag :] - 2.0 * track[lag:-lag] + track[: -2 * lag])


@dataclass(frozen=True)
class TrackerFit:
    """Properties of a tracker from a recording.

    Attributes:
        clock: rate, jitter and losses.
        palm: root mean square deviation of a palm landmark's coordinate from the rigid palm [m];
            it includes the person's own posture.
        palm_frame: root mean square of white noise with the same second differences [m].
        tips: shake of each fingertip in the palm's frame; None if it is never at rest.
        all_tips: shake of all fingertips together.
        joints: (2,) shake of PIP and DIP relative to the tip; NaN if none is at rest.
        together: mean correlation of two fingertips' second differences, coordinate by coordinate.
    """

    clock: ClockFit
    palm: float
    palm_frame: float
    tips: tuple[ShakeFit | None, ...]
    all_tips: ShakeFit | None
    joints: tuple[float, float]
    together: float


def fit_tracker(recording: HandRecording) -> TrackerFit:
    """Measures the tracker of a recording."""
    clock = fit_clock(recording)
    points, residual = in_palm(recording.landmarks)
    windows = [still_windows(points[:, tip], recording.stamps) for tip in TIPS]
    parts = [[points[w, tip] for w in found] for tip, found in zip(TIPS, windows, strict=True)]
    shares, pairs = [], []
    for tip, found in zip(TIPS, windows, strict=True):
        if not found:
            continue
        moves = np.concatenate([_bend(points[window], 1) for window in found])
        sizes = np.median(np.linalg.norm(moves[:, tip - 2 : tip + 1], axis=-1), axis=0)
        shares.append(sizes[:2] / sizes[2])
        pairs += [_correlation(moves[:, tip], moves[:, other]) for other in TIPS if other != tip]
    bends = _bend(residual.reshape(len(residual), -1), 1)
    first, second = np.median(shares, axis=0) if shares else (np.nan, np.nan)
    fits = [
        fit_shake(found, 1.0 / clock.rate_hz) if found else None
        for found in (*parts, [window for found in parts for window in found])
    ]
    return TrackerFit(
        clock,
        float(np.sqrt(np.nanmean(residual**2))),
        float(np.sqrt(np.nanmedian((bends**2).mean(axis=1)) / 6.0)),
        tuple(fits[:-1]),
        fits[-1],
        (float(first), float(second)),
        float(np.nanmean(pairs)) if pairs else np.nan,
    )


def _correlation(a: Float[np.ndarray, "n 3"], b: Float[np.ndarray, "n 3"]) -> float:
    """Spearman's correlation, which outliers and short motions do not dominate."""
    return float(np.mean([spearmanr(a[:, k], b[:, k]).statistic for k in range(3)]))


def pinch_gap(recording: HandRecording, finger: str, frames: slice) -> float:
    """Distance of thumb and fingertip landmarks while they touch, in palm lengths.

    It is the mean over the frames. The palm length is from the wrist to the middle finger's MCP.
    """
    landmarks = recording.landmarks[frames]
    apart = landmarks[:, TIPS[FINGERS.index(finger)]] - landmarks[:, TIPS[0]]
    palm = landmarks[:, BASES[2]] - landmarks[:, WRIST]
    return float(np.nanmean(np.linalg.norm(apart, axis=-1) / np.linalg.norm(palm, axis=-1)))


def tables(names: Sequence[str], fits: Sequence[TrackerFit]) -> str:
    """Markdown tables of several recordings; millimetres and milliseconds."""
    clock = [
        f"| {name} | {c.rate_hz:.0f} | {c.rate_jitter:.2f} | {100 * c.frame_loss:.1f} | "
        f"{1e3 * c.frame_loss_burst:.0f} | {1e3 * fit.palm:.2f} | {1e3 * fit.palm_frame:.3f} | "
        f"{fit.joints[0]:.2f}, {fit.joints[1]:.2f} | {fit.together:.2f} |"
        for name, fit in zip(names, fits, strict=True)
        for c in [fit.clock]
    ]
    shake = [
        " | ".join(["", name, *map(_cell, (*fit.tips, fit.all_tips)), ""]).strip()
        for name, fit in zip(names, fits, strict=True)
    ]
    return "\n".join([
        "| recording | rate [Hz] | jitter | lost [%] | gap [ms] | palm [mm] | palm, frame to frame "
        "[mm] | PIP, DIP | correlation |",
        "|---|--:|--:|--:|--:|--:|--:|--:|--:|", *clock, "",
        " | ".join(["| recording", *FINGERS, "all |"]), "|---|--:|--:|--:|--:|--:|--:|", *shake,
    ])  # fmt: skip


def _cell(fit: ShakeFit | None) -> str:
    if fit is None:
        return "–"
    return (
        f"{1e3 * fit.shake:.2f} ({1e3 * fit.shake_time:.0f}; {1e3 * fit.frame:.2f}; {fit.windows})"
    )


def main(arguments: Sequence[str] | None = None) -> None:
    """Prints the tables for the recordings on the command line."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument(
        "recordings", nargs="+", help="files as `smooth-operator bench` takes them: file.npz@30hz"
    )
    parser.add_argument(
        "--contacts", nargs="*", default=[], metavar="FINGER=A:B",
        help="frames of the last recording in which thumb and finger touch: index=312:332",
    )  # fmt: skip
    options = parser.parse_args(arguments)
    sources = load_sources([parse_request(text) for text in options.recordings])
    fits = []
    for source in sources:
        if source.recording is None:
            raise SystemExit(f"{source.name}: {source.error}")
        fits.append(fit_tracker(source.recording))
    print(tables([source.name for source in sources], fits))
    for contact in options.contacts:
        finger, _, frames = contact.partition("=")
        first, _, end = frames.partition(":")
        recording = sources[-1].recording
        assert recording is not None
        gap = pinch_gap(recording, finger, slice(int(first), int(end)))
        print(f"{finger}: thumb and tip {gap:.3f} palm lengths apart where they touch")


if __name__ == "__main__":
    main()
