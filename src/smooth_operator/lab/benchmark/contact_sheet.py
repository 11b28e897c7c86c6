"""A contact sheet: poses of a recording, the human hand next to what each method made of it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Final

import numpy as np
from jaxtyping import Float

from smooth_operator.landmarks import BASES, FINGER_COLORS, FINGERS, TIPS, WRIST
from smooth_operator.metrics.posture import human_extensions
from smooth_operator.metrics.trace import Trace

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_PALM: Final = "#b9bec4"
_PINCH: Final = 0.025  # thumb to tip, on the robot's scale [m]
_EDGE: Final = 0.02  # of paper around a hand [m]


def find_poses(human: Float[np.ndarray, "T 21 3"]) -> dict[str, int]:
    """The frames in which a human hand shows its poses best.

    Args:
        human: (T, 21, 3) aligned landmarks [m]; NaN where a frame is not usable.

    Returns:
        ``open``, ``fist``, ``point`` and a ``pinch`` of each finger that comes to within 25 mm of
        the thumb, to the number of a frame; without those that the recording does not show.
    """
    chains = human[:, np.array(BASES[1:])[:, None] + np.arange(4)]
    extension = human_extensions(chains)
    finite = np.isfinite(human).all(axis=(1, 2))
    if not finite.any():
        return {}
    scores = {
        "open": extension.min(axis=1) - 0.85,
        "fist": 0.65 - extension.max(axis=1),
        "point": extension[:, 0] - extension[:, 1:].max(axis=1) - 0.2,
    }
    apart = np.linalg.norm(human[:, list(TIPS[1:])] - human[:, TIPS[0], None], axis=-1)
    for i, finger in enumerate(FINGERS[1:]):
        nearest = apart[:, i] <= np.nanmin(apart, axis=1, initial=np.inf)
        scores[f"pinch, {finger}"] = np.where(nearest, _PINCH - apart[:, i], -1.0)
    best = {name: int(np.argmax(np.where(finite, score, -9))) for name, score in scores.items()}
    return {name: frame for name, frame in best.items() if scores[name][frame] > 0}


def contact_sheet(traces: Mapping[str, Trace]) -> Figure:
    """Draws poses in rows: the human, then each method, from the front and from the side.

    All hands are seen from the human palm's own directions, which the alignment lays on the
    robot's, and each is drawn to its own size.

    Args:
        traces: name of a method -> its run, all of one recording on one hand.
    """
    from matplotlib.figure import Figure

    first = next(iter(traces.values()))
    poses = find_poses(first.human)
    columns = ["human", *traces]
    figure = Figure(figsize=(2.6 * len(columns), 1.7 * max(len(poses), 1)), layout="constrained")
    axes = figure.subplots(max(len(poses), 1), 2 * len(columns), squeeze=False)
    for axis in axes.flat:
        axis.set_axis_off()
        axis.set_aspect("equal")
    for column, name in enumerate(columns):
        axes[0, 2 * column].set_title(name, fontsize=8, loc="left")
    for row, (pose, frame) in enumerate(poses.items()):
        axes[row, 0].text(0, 1, f"{pose} ({frame})", fontsize=6, transform=axes[row, 0].transAxes)
        view = _view(first.human[frame])
        for column, name in enumerate(columns):
            points = first.human[frame] if name == "human" else _robot(traces[name], frame)
            _draw(axes[row, 2 * column], (points - points[WRIST]) @ view[:, [0, 1]])
            _draw(axes[row, 2 * column + 1], (points - points[WRIST]) @ view[:, [2, 1]])
    return figure


def _robot(trace: Trace, frame: int) -> Float[np.ndarray, "21 3"]:
    points = np.full((21, 3), np.nan) if trace.robot_landmarks is None else trace.robot_landmarks
    return np.asarray(points[frame] if points.ndim == 3 else points)


def _view(human: Float[np.ndarray, "21 3"]) -> Float[np.ndarray, "3 3"]:
    """Columns: across the palm, to the fingers, out of the palm."""
    up = human[BASES[2]] - human[WRIST]
    across = human[BASES[1]] - human[BASES[4]]
    up = up / np.linalg.norm(up)
    across = across - (across @ up) * up
    across = across / np.linalg.norm(across)
    return np.stack([across, up, np.cross(across, up)], axis=1)


def _draw(axis: Axes, points: Float[np.ndarray, "21 2"]) -> None:
    bases = [i for i in BASES if np.isfinite(points[i]).all()]
    outline = points[[WRIST, *bases, WRIST]]
    axis.fill(outline[:, 0], outline[:, 1], color=_PALM, linewidth=0)
    axis.plot(outline[:, 0], outline[:, 1], color=_PALM, linewidth=3)
    for base, color in zip(BASES, FINGER_COLORS, strict=True):
        chain = points[base : base + 4]
        chain = chain[np.isfinite(chain).all(axis=1)]
        axis.plot(chain[:, 0], chain[:, 1], color=color, linewidth=4, solid_capstyle="round")
    finite = points[np.isfinite(points).all(axis=1)]
    low, high = finite.min(axis=0) - _EDGE, finite.max(axis=0) + _EDGE
    middle, half = (low + high) / 2, (high - low).max() / 2
    axis.set_xlim(middle[0] - half, middle[0] + half)
    axis.set_ylim(middle[1] - half, middle[1] + half)
