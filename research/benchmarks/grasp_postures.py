"""How bent the human's fingers are when thumb, index and middle finger meet, by recording.

    python research/benchmarks/grasp_postures.py RECORDING...

A recording is named as for ``smooth-operator bench``. A frame counts if the tip of the index finger
is within 20 mm of the thumb's, that of the middle finger within 45 mm, and the fingers are not
folded (mean extension over .55). The table gives medians over these frames. The scripted human of
``smooth-operator cross-hand`` draws the flexion of its PIP joints from the range of these medians.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from typing import Final

import numpy as np
from jaxtyping import Float

from smooth_operator.landmarks import FINGERS, TIPS, finger_landmarks
from smooth_operator_benchmark.recordings import load_sources, parse_request
from smooth_operator_research.run_report import markdown

NEAR: Final = (0.020, 0.045)
"""Largest distances of the index and of the middle fingertip from the thumb's [m]."""
FOLDED: Final = 0.55
"""Mean extension of the long fingers up to which they are folded."""


def lengths(vectors: np.ndarray) -> np.ndarray:
    """Lengths of vectors along the last axis."""
    return np.asarray(np.linalg.norm(vectors, axis=-1))


def angle(one: Float[np.ndarray, "t 3"], other: Float[np.ndarray, "t 3"]) -> np.ndarray:
    """Angles (t,) between vectors [degrees]."""
    cosine = (one * other).sum(-1) / (lengths(one) * lengths(other))
    return np.asarray(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))


def main(arguments: Sequence[str] | None = None) -> None:
    """Prints the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("recordings", nargs="+")
    options = parser.parse_args(arguments)
    rows: list[tuple[object, ...]] = []
    for source in load_sources([parse_request(text) for text in options.recordings]):
        assert source.recording is not None
        points = source.recording.landmarks
        bones = np.diff(points[:, np.array(finger_landmarks(FINGERS))], axis=2)[:, 1:]
        extension = (lengths(bones.sum(axis=2)) / lengths(bones).sum(axis=-1)).mean(axis=1)
        apart = lengths(points[:, list(TIPS[1:3])] - points[:, [TIPS[0]]])
        meet = (apart < NEAR).all(axis=1) & (extension > FOLDED)
        if not meet.any():
            rows.append((source.name, 0, "", "", "", ""))
            continue
        index = bones[meet, 0]
        palm = points[meet, finger_landmarks(FINGERS)[1][0]] - points[meet, 0]
        bends = [angle(palm, index[:, 0])] + [angle(index[:, k], index[:, k + 1]) for k in (0, 1)]
        medians = [f"{np.median(bend):.0f}" for bend in bends]
        rows.append((source.name, meet.sum(), f"{np.median(extension[meet]):.2f}", *medians))
    print(markdown(("recording", "frames", "extension", "MCP °", "PIP °", "DIP °"), rows))


if __name__ == "__main__":
    main()
