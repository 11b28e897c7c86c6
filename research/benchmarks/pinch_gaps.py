"""Shares of pinches that close, and of fingers closed wrongly, with the gaps of trackers.

    python research/benchmarks/pinch_gaps.py video VIDEO [MODEL.task] index=310:334 middle=360:381
    python research/benchmarks/pinch_gaps.py built RECORDING...

``video``: MediaPipe's landmarks of a video, with frames of contact as a person saw them. ``built``:
recordings of a tracker that closes pinches, as they are and with gaps built in, where the truth is
the recording: contact is within 3 mm of a finger's own least distance, and a finger is closed
wrongly over 10 mm farther from the thumb than that. A finger is closed under 8 mm.
"""

import sys
from collections.abc import Mapping
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from smooth_operator.formats.readers import read_recording
from smooth_operator.hands.registry import load_hand
from smooth_operator.landmarks import BASES, FINGERS, TIPS
from smooth_operator.retargeting.alignment import palm_alignment
from smooth_operator.retargeting.known_gaps import MEDIAPIPE, NO_GAPS
from smooth_operator.retargeting.pinch_gaps import PinchGapEstimate, PinchGapState
from smooth_operator.retargeting.program import FrameClock
from smooth_operator.types import HandRecording

CLOSED, CONTACT, FAR, LEAST = 8.0, 3.0, 10.0, 15.0  # [mm]
BUILT = {"24, 30, 19, 8 mm": (24.0, 30.0, 19.0, 8.0), "15 mm": (15.0,) * 4, "as it is": (0.0,) * 4}
STARTS: Mapping[str, Mapping[str, float] | None] = {
    "off": None,
    "no known gap": NO_GAPS,
    "MediaPipe's": MEDIAPIPE,
}


def distances(points: np.ndarray) -> np.ndarray:
    """(T, 4) distances of the long fingers from the thumb."""
    return np.linalg.norm(points[:, TIPS[1:]] - points[:, TIPS[:1]], axis=-1)


def palm_mm(points: np.ndarray) -> float:
    """Median length of the palm [mm]."""
    return 1e3 * float(np.median(np.linalg.norm(points[:, BASES[2]] - points[:, 0], axis=-1)))


def corrected(
    points: np.ndarray, stamps: np.ndarray, known: Mapping[str, float] | None
) -> tuple[np.ndarray, np.ndarray]:
    """(T, 4) distances after the correction [palm lengths], and the last estimates."""
    estimate = PinchGapEstimate(load_hand())
    aligned = palm_alignment(points, estimate.hand).apply(points).astype(np.float32)
    dt = np.diff(stamps, prepend=stamps[0] - 1).astype(np.float32)

    def one(state: PinchGapState, frame: tuple) -> tuple[PinchGapState, jax.Array]:
        points, *clock = frame
        return estimate.step(state, points, FrameClock(*clock))

    start = PinchGapState.of(estimate.hand.fingers, known)
    state, out = jax.lax.scan(one, start, tuple(map(jnp.asarray, (aligned, dt, dt > 0.25))))
    return distances(np.asarray(out)) / estimate.palm, np.asarray(state.gap)


def shares(rows: np.ndarray, closed: np.ndarray) -> str:
    """Share of closed frames for each finger."""
    return "  ".join(
        f"{closed[rows[:, i], i].mean():.3f}" if rows[:, i].any() else "  –  " for i in range(4)
    )


def built(path: Path) -> None:
    """Prints the figures of recordings with added gaps."""
    recording = read_recording(path, rate=30.0 if path.suffix == ".npy" else None)
    whole = np.isfinite(recording.landmarks).all(axis=(1, 2))
    points, stamps = recording.landmarks[whole], recording.stamps[whole]
    truth, rng = 1e3 * distances(points), np.random.default_rng(0)
    least = np.percentile(truth, 0.2, axis=0)
    contact, far = (
        (truth < least + CONTACT) & (least < LEAST),
        truth > np.minimum(least, LEAST) + FAR,
    )
    print(f"{path.name}: {len(points)} frames; least {np.round(least, 1)} mm")
    for gaps, values in BUILT.items():
        seen = points.copy()
        wider = np.cbrt(truth**3 + np.array(values) ** 3) / truth
        away = seen[:, TIPS[1:]] - seen[:, TIPS[:1]]
        seen[:, TIPS[1:]] = seen[:, TIPS[:1]] + away * wider[..., None]
        seen += rng.normal(0, 0.00058 if any(values) else 0.0, seen.shape)  # 1 mm in all
        for start, known in STARTS.items():
            after, gap = corrected(seen, stamps, known)
            closed = after * palm_mm(points) < CLOSED
            print(
                f"  gaps {gaps:17} known {start:12}  closed at contact {shares(contact, closed)}  "
                f"closed wrongly {shares(far, closed)}  gaps at the end {np.round(gap, 2)}"
            )


def video(path: Path, labels: list[str]) -> None:
    """Prints the figures of a video with labelled contacts."""
    from smooth_operator.teleop.sources.webcam.picture_tracker import PictureConfig
    from smooth_operator.teleop.sources.webcam.webcam_source import track_video

    models = [Path(label) for label in labels if label.endswith(".task")]
    config = PictureConfig(model=models[0] if models else None)
    recording: HandRecording = track_video(path, config=config)
    points, palm = recording.landmarks, palm_mm(recording.landmarks)
    contact = np.zeros((len(points), 4), bool)
    for label in labels[len(models) :]:
        finger, _, frames = label.partition("=")
        first, last = map(int, frames.split(":"))
        contact[first:last, FINGERS.index(finger) - 1] = True
    near = np.stack([np.convolve(row, np.ones(9), "same") > 0 for row in contact.T], axis=1)
    for start, known in STARTS.items():
        after, _ = corrected(points, recording.stamps, known)
        closed = after * palm < CLOSED
        print(
            f"known {start:12}  closed at contact {shares(contact, closed)}  "
            f"closed elsewhere {shares(~near, closed)}"
        )


if __name__ == "__main__":
    if sys.argv[1] == "video":
        video(Path(sys.argv[2]), sys.argv[3:])
    else:
        for name in sys.argv[2:]:
            built(Path(name))
