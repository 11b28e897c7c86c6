"""Finds where a tracker is mounted on a glove, from two motions of the hand that wears it.

A tracker on the back of the hand has a constant pose relative to the wrist. With the forearm held,
the hand turns about the wrist's centre; the point of the tracker's frame that moves least is that
centre (pivot calibration, by least squares). A flat hand, palm down on a table, has the back of the
hand upwards; as it slides along its middle finger, the motion is the direction of the fingers.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from smooth_operator import poses
from smooth_operator.calibration.segments import Prompt
from smooth_operator.errors import RecordingError

PROMPTS: Final = (
    Prompt(
        "turn",
        "rest the elbow, hold the forearm still with the other hand, and move the hand in wide "
        "circles about the wrist",
        settle=5.0,
        hold=15.0,
    ),
    Prompt(
        "slide",
        "lay the hand flat on a table, palm down, and slide it 30 cm straight forward, in the "
        "direction of the middle finger",
        settle=5.0,
        hold=5.0,
    ),
)
"""Prompts of this calibration, in order."""

MIN_FRAMES: Final = 30
RESIDUAL: Final = 0.010
"""Largest distance from the wrist's centre to its mean that is accepted, root mean square [m]."""
TURN: Final = 0.2
"""Least sine of the turns of the hand, root mean square, about the axis with the smallest turns."""
REACH: Final = 0.3
"""Largest distance from the tracker to the wrist [m]."""
SLIDE: Final = 0.15
"""Shortest slide along the table [m]."""
CROOKED: Final = 0.15
"""Largest deviation of the slide from a horizontal line, as a share of its length."""
TILT: Final = np.deg2rad(8.0)
"""Largest deviation of the hand from its mean orientation in the slide, root mean square [rad]."""

_OUTLIER: Final = 3.0  # residuals beyond this multiple of their median are left out


@dataclass(frozen=True, eq=False)
class Mount:
    """Where a tracker is mounted on a hand.

    Attributes:
        T_tracker_wrist: (7,) pose of the wrist in the tracker's frame, with the axes of
            docs/reference/conventions.md.
        residual: distance of the wrist's centre from its mean while the hand turned, root mean
            square [m].
        turn: sine of the turns of the hand about the axis with the smallest turns, root mean
            square.
        slide: length of the slide [m].
        tilt: deviation of the hand from its mean orientation in the slide, root mean square [rad].
    """

    T_tracker_wrist: Float[np.ndarray, "7"]
    residual: float
    turn: float
    slide: float
    tilt: float


def find_mount(turning: Float[np.ndarray, "n 7"], sliding: Float[np.ndarray, "m 7"]) -> Mount:
    """Finds where a tracker is mounted on a hand.

    Args:
        turning: poses of the tracker in a z-up world while the hand turns about the wrist and the
            forearm is held; poses with NaN are left out.
        sliding: its poses while the flat hand slides along a table, palm down.

    Raises:
        RecordingError: there are too few poses, or the motion does not determine the mount; the
            error says which motion to repeat and how.
    """
    turning, sliding = (part[poses.is_valid(part)] for part in (turning, sliding))
    for part, name in ((turning, "turned"), (sliding, "slid")):
        if len(part) < MIN_FRAMES:
            raise RecordingError(
                f"{len(part)} poses arrived from the tracker while the hand {name}; at least "
                f"{MIN_FRAMES} are needed. Keep the tracker in view of the base stations or cameras"
            )
    offset, residual, turn = _pivot(turning)
    mean, tilt = _mean_rotation(poses.rotation_matrices(sliding[:, 3:]))
    if tilt > TILT:
        raise RecordingError(
            f"the hand turned by {np.degrees(tilt):.0f}° (root mean square) while it slid, but at "
            f"most {np.degrees(TILT):.0f}° are accepted; keep it flat on the table, and slide it "
            "straight"
        )
    forward, slide = _slide(sliding[:, :3] + poses.rotate(sliding[:, 3:], offset))
    up = np.array([0.0, 0.0, 1.0])
    wrist = np.stack([forward, np.cross(up, forward), up], axis=1)
    pose = np.concatenate([offset, poses.quaternions(mean.T @ wrist)])
    return Mount(pose, residual, turn, slide, tilt)


def _pivot(turning: Float[np.ndarray, "n 7"]) -> tuple[Float[np.ndarray, "3"], float, float]:
    """Point of the tracker's frame that moves least, its motion [m], and the smallest turns."""
    rotations, places = poses.rotation_matrices(turning[:, 3:]), turning[:, :3]
    used = np.ones(len(turning), bool)
    for _ in range(2):
        turned = rotations[used] - rotations[used].mean(axis=0)
        moved = places[used] - places[used].mean(axis=0)
        turn = float(np.linalg.svd(turned.reshape(-1, 3), compute_uv=False)[-1])
        turn /= np.sqrt(used.sum())
        if turn < TURN:
            raise RecordingError(
                f"the hand turned too little about one of its axes ({turn:.3f}; at least {TURN:g} "
                "is needed). Move it in wider circles: up and down, and to both sides"
            )
        offset = np.linalg.lstsq(turned.reshape(-1, 3), -moved.ravel(), rcond=None)[0]
        centres = places + rotations @ offset
        away = np.linalg.norm(centres - np.median(centres, axis=0), axis=1)
        used = away <= _OUTLIER * np.median(away)
    residual = float(np.sqrt(np.mean(away[used] ** 2)))
    if residual > RESIDUAL:
        raise RecordingError(
            f"the wrist moved by {1e3 * residual:.0f} mm (root mean square) while the hand turned, "
            f"but at most {1e3 * RESIDUAL:.0f} mm are accepted. Hold the forearm still with the "
            "other hand, and check that the tracker does not move on the glove"
        )
    if (distance := np.linalg.norm(offset)) > REACH:
        raise RecordingError(
            f"the wrist would be {100 * distance:.0f} cm from the tracker; at most "
            f"{100 * REACH:.0f} cm are expected. Turn the hand about the wrist, not the whole arm"
        )
    return offset, residual, turn


def _slide(points: Float[np.ndarray, "n 3"]) -> tuple[Float[np.ndarray, "3"], float]:
    """Horizontal direction of a motion, a unit vector, and its length [m]."""
    start, end = (
        points[: len(points) // 10 + 1].mean(axis=0),
        points[-len(points) // 10 :].mean(axis=0),
    )
    way = end - start
    length = float(np.linalg.norm(way[:2]))
    if length < SLIDE:
        raise RecordingError(
            f"the hand slid by {100 * length:.0f} cm; at least {100 * SLIDE:.0f} cm are needed. "
            "Slide it forward until the time is over, and do not bring it back"
        )
    forward = np.array([*way[:2], 0.0]) / length
    aside = points - start - np.outer((points - start) @ forward, forward)
    crooked = float(np.abs(aside).max()) / length
    if crooked > CROOKED:
        raise RecordingError(
            f"the path of the hand deviated from a straight, level line by {100 * crooked:.0f} % "
            f"of its length; at most {100 * CROOKED:.0f} % are accepted. Slide it along a "
            "straight edge of the table"
        )
    return forward, length


def _mean_rotation(rotations: Float[np.ndarray, "n 3 3"]) -> tuple[Float[np.ndarray, "3 3"], float]:
    """Mean of rotations, and the root mean square of the angles to it [rad]."""
    turns = Rotation.from_matrix(rotations)
    mean = turns.mean()
    angles = (mean.inv() * turns).magnitude()
    return mean.as_matrix(), float(np.sqrt(np.mean(angles**2)))
