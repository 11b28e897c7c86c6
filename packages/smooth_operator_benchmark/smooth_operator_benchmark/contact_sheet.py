"""Contact sheet of poses: each row shows the human hand and the robot hand with each method."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np
from jaxtyping import Float, UInt8
from scipy.ndimage import median_filter

from smooth_operator.atomic_files import atomic_write
from smooth_operator.hands.hand import Hand
from smooth_operator.landmarks import BASES, FINGERS, TIPS, WRIST
from smooth_operator.metrics.posture import human_extensions
from smooth_operator.reporting.report_page import plot_name
from smooth_operator.reporting.run_plots import Panel
from smooth_operator.teleop.pages.hand_view import view_basis
from smooth_operator.types import Side
from smooth_operator_benchmark.figures import make_panels, shortened
from smooth_operator_benchmark.hand_surface import (
    PAPER,
    HandShape,
    SkeletonShape,
    Surface,
    landmark_surface,
    paint,
)
from smooth_operator_benchmark.suite import Finished

if TYPE_CHECKING:
    from PIL.Image import Image

CELL: Final = 150
"""Width and height of a view of a hand [px]."""
POSES: Final = (
    "flat",
    "fist",
    "point",
    "thumb up",
    "OK",
    "tripod",
    *(f"pinch {finger}" for finger in FINGERS[1:]),
)
"""Names of the poses, in the order of a sheet."""
_NAMES: Final = 130  # width of the column of poses [px]
_HEAD: Final = 24  # height of the row of methods [px]
_GAP: Final = 8  # between methods [px]
_PINCH: Final = 0.025  # largest distance of thumb and finger in a pinch, on the robot's scale [m]
_TRIPOD: Final = 0.03  # largest distance of thumb, index and middle finger in a tripod [m]
_AWAY: Final = 0.65  # least distance of a raised thumb from the index, over the palm's length
_SMOOTH: Final = 5  # frames of the median, which drops a tracker's single wrong frames
_UNFOLDED: Final = 0.45  # extension from which a finger may pinch
_HAND: Final = 0.19  # length of a human hand, as drawn [m]
_TURN: Final = np.deg2rad(70.0)  # between the two views: no finger hides the others entirely
_INK: Final = (40, 46, 52)
_SOFT: Final = (110, 118, 126)


@dataclass(frozen=True)
class Pose:
    """A frame of a recording in which the human hand shows a pose.

    Attributes:
        name: name of the pose, such as ``fist``.
        panel: the recording on the robot hand.
        frame: index of the frame.
    """

    name: str
    panel: Panel
    frame: int


def pose_scores(human: Float[np.ndarray, "T 21 3"]) -> dict[str, Float[np.ndarray, " T"]]:
    """Scores how well each frame shows each pose; the frame shows the pose if the score is above 0.

    Args:
        human: (T, 21, 3) landmarks, aligned to a robot [m]; NaN where a frame is not usable.

    Returns:
        name from ``POSES`` -> (T,) scores. In ``OK``, thumb and index finger pinch while the others
        are straight; in ``tripod``, the middle finger also pinches.
    """
    chains = human[:, np.array(BASES[1:])[:, None] + np.arange(4)]
    extension = human_extensions(chains)
    palm = np.linalg.norm(human[:, BASES[2]] - human[:, WRIST], axis=-1)
    away = np.linalg.norm(human[:, TIPS[0]] - human[:, BASES[1] + 1], axis=-1) / palm
    apart = np.linalg.norm(human[:, list(TIPS[1:])] - human[:, TIPS[0], None], axis=-1)
    apart = np.where(extension > _UNFOLDED, apart, 1.0)  # a thumb next to a fist pinches nothing
    straight = extension[:, 1:].min(axis=1) > 0.8
    nearest = apart <= apart.min(axis=1, keepdims=True)
    tripod = _TRIPOD - apart[:, :2].max(axis=1)
    closed = 0.65 - extension.max(axis=1)
    scores = {
        "flat": extension.min(axis=1) - 0.85,
        "fist": closed / (1 + away),
        "point": extension[:, 0] - extension[:, 1:].max(axis=1) - 0.2,
        "thumb up": np.where(closed > 0, away - _AWAY, -1.0),
        "OK": np.where(straight, _PINCH - apart[:, 0], -1.0),
        "tripod": tripod,
    }
    for i, finger in enumerate(FINGERS[1:]):
        alone = nearest[:, i] & (tripod < 0) & ~(straight & (i == 0))
        scores[f"pinch {finger}"] = np.where(alone, _PINCH - apart[:, i], -1.0)
    usable = np.isfinite(human).all(axis=(1, 2))
    return {
        name: median_filter(np.where(usable, score, -9.0), _SMOOTH, mode="nearest")
        for name, score in scores.items()
    }


def find_poses(panels: Iterable[Panel]) -> list[Pose]:
    """Finds the best frame of each pose over all recordings; skips poses that no recording
    shows."""
    best: dict[str, tuple[float, Pose]] = {}
    for panel in panels:
        human = panel.runs[0].human
        usable = np.isfinite(human).all(axis=(1, 2))
        for name, scores in pose_scores(human).items():
            frame = int(np.argmax(np.where(usable, scores, -np.inf)))
            if usable[frame] and scores[frame] > (best[name][0] if name in best else 0.0):
                best[name] = float(scores[frame]), Pose(name, panel, frame)
    return [best[name][1] for name in POSES if name in best]


def skeleton_shape(hand: Hand) -> SkeletonShape:
    """Surface of a robot hand, drawn as rods between its landmarks."""
    return SkeletonShape(hand, view_basis(hand))


def contact_sheet(
    panels: Sequence[Panel],
    shape: Callable[[Hand], HandShape] = skeleton_shape,
    names: Sequence[str] | None = None,
) -> Image | None:
    """Draws poses in rows: the human hand, then the robot hand with each method, seen from the palm
    and from the thumb's side.

    Each hand is drawn upright in the frame of its own wrist. All pictures of the robot have the
    same scale; all human hands are drawn with the same length.

    Args:
        panels: recordings on one hand of one side.
        shape: makes the surface of the robot hand.
        names: poses to draw, in this order. Default: all.

    Returns:
        The picture; None if no recording shows a pose.
    """
    poses = find_poses(panels)
    if names is not None:
        by_name = {pose.name: pose for pose in poses}
        poses = [by_name[name] for name in names if name in by_name]
    if not poses:
        return None
    methods = list(dict.fromkeys(run.method for panel in panels for run in panel.runs))
    robot = shape(panels[0].hand)
    side = panels[0].hand.spec.side
    humans = [HandPicture.of_human(pose.panel.runs[0].human[pose.frame], side) for pose in poses]
    robots = [
        {
            run.method: HandPicture.of_robot(robot, run.joints[pose.frame], side)
            for run in pose.panel.runs
        }
        for pose in poses
    ]
    human_frame = common_frame(humans)
    robot_frame = common_frame([picture for row in robots for picture in row.values()])
    width = _NAMES + (2 * CELL + _GAP) * (1 + len(methods))
    sheet = np.full((_HEAD + CELL * len(poses), width, 3), PAPER, np.uint8)
    for row, (human, own) in enumerate(zip(humans, robots, strict=True)):
        cells = [human.draw(human_frame)]
        blank = np.full_like(cells[0], PAPER)
        cells += [own[m].draw(robot_frame) if m in own else blank for m in methods]
        for column, cell in enumerate(cells):
            left, top = _NAMES + column * (2 * CELL + _GAP), _HEAD + row * CELL
            sheet[top : top + CELL, left : left + 2 * CELL] = cell
    return _lettered(sheet, poses, ["human", *methods], several=len(panels) > 1)


def write_sheets(
    finished: Iterable[Finished], folder: Path, shape: Callable[[Hand], HandShape] = skeleton_shape
) -> list[Path]:
    """Writes ``sheet-HAND-SIDE.png`` for each hand of a benchmark on which a pose was found;
    OutputError if a file can't be written."""
    paths = []
    for (hand, side), panels in panels_by_hand(make_panels(finished)).items():
        drawn = contact_sheet(panels, shape)
        if drawn is not None:
            path = folder / f"{plot_name(f'sheet-{hand}-{side}')}.png"
            with atomic_write(path) as file:
                drawn.save(file, format="PNG", optimize=True)
            paths.append(path)
    return paths


def panels_by_hand(panels: Iterable[Panel]) -> dict[tuple[str, str], list[Panel]]:
    """Groups panels by hand and side."""
    groups: dict[tuple[str, str], list[Panel]] = {}
    for panel in panels:
        groups.setdefault(panel.key[1:], []).append(panel)
    return groups


@dataclass(frozen=True, eq=False)
class HandPicture:
    """A hand in one pose, which can be drawn from two directions.

    Attributes:
        surface: its triangles, with the wrist at the origin [m].
        views: rows right, up and toward the viewer, for each view.
    """

    surface: Surface
    views: tuple[Float[np.ndarray, "3 3"], Float[np.ndarray, "3 3"]]

    @classmethod
    def of_human(cls, points: Float[np.ndarray, "21 3"], side: Side) -> HandPicture:
        """Makes a human hand from its landmarks [m], scaled to a common length."""
        middle = points[[WRIST, *range(BASES[2], BASES[2] + 4)]]
        points = points * (_HAND / np.linalg.norm(np.diff(middle, axis=0), axis=-1).sum())
        up = points[list(BASES[1:])].mean(axis=0) - points[WRIST]
        up = up / np.linalg.norm(up)
        right = points[BASES[1]] - points[BASES[4]]
        right = right - (right @ up) * up
        right = right / np.linalg.norm(right) * (1.0 if side == "right" else -1.0)
        palm = np.stack([right, up, np.cross(right, up)])
        return cls(landmark_surface(points - points[WRIST]), (palm, from_thumb(palm, side)))

    @classmethod
    def of_robot(cls, shape: HandShape, joints: Float[np.ndarray, " n"], side: Side) -> HandPicture:
        """Makes a robot hand at its joint positions [rad]."""
        surface = shape.surface(joints)
        placed = Surface(surface.triangles - shape.wrist, surface.colors)
        return cls(placed, (shape.view, from_thumb(shape.view, side)))

    def draw(self, frame: tuple[np.ndarray, float], size: int = CELL) -> UInt8[np.ndarray, "H W 3"]:
        """Draws the two views side by side, each ``size`` by ``size`` pixels.

        Args:
            frame: result of ``common_frame``.
            size: width and height of a view [px].
        """
        centres, half = frame
        views = zip(self.views, centres, strict=True)
        pictures = [paint(self.surface, view, centre, half, size) for view, centre in views]
        return np.concatenate(pictures, axis=1)

    def extent(self) -> Float[np.ndarray, "2 2 2"]:
        """Bounds of the hand in each view [m]; axes: view, low or high, right or up."""
        corners = self.surface.triangles.reshape(-1, 3)
        flat = [corners @ view.T[:, :2] for view in self.views]
        return np.array([[points.min(axis=0), points.max(axis=0)] for points in flat])


def common_frame(pictures: Sequence[HandPicture]) -> tuple[Float[np.ndarray, "2 2"], float]:
    """Returns the centre of each view, and half of the width that a view needs to show all of these
    hands [m]."""
    extents = np.array([picture.extent() for picture in pictures])
    low, high = extents[:, :, 0].min(axis=0), extents[:, :, 1].max(axis=0)
    return (low + high) / 2, 0.53 * float((high - low).max())


def from_thumb(palm: Float[np.ndarray, "3 3"], side: Side) -> Float[np.ndarray, "3 3"]:
    """Rotates the view of the palm so that the hand is seen from the thumb's side.

    Args:
        palm: rows right, up and toward a viewer who looks at the palm.
    """
    turn = _TURN if side == "right" else -_TURN
    right, up, toward = palm
    return np.stack(
        [
            np.cos(turn) * right - np.sin(turn) * toward,
            up,
            np.sin(turn) * right + np.cos(turn) * toward,
        ]
    )


def _lettered(
    sheet: UInt8[np.ndarray, "H W 3"], poses: Sequence[Pose], columns: Sequence[str], several: bool
) -> Image:
    from PIL import Image as pillow
    from PIL import ImageDraw, ImageFont

    image = pillow.fromarray(sheet)
    pen = ImageDraw.Draw(image)
    large, small = ImageFont.load_default(14), ImageFont.load_default(10)
    for column, name in enumerate(columns):
        middle = _NAMES + column * (2 * CELL + _GAP) + CELL
        pen.text((middle, 4), name, fill=_INK, font=large, anchor="ma")
    for row, pose in enumerate(poses):
        top = _HEAD + row * CELL + CELL // 2
        pen.text((6, top - 16), pose.name, fill=_INK, font=large)
        where = f"frame {pose.frame}"
        pen.text((6, top + 2), where, fill=_SOFT, font=small)
        if several:
            pen.text((6, top + 15), shortened(pose.panel.key[0]), fill=_SOFT, font=small)
        if row:
            line = _HEAD + row * CELL
            pen.line((0, line, image.width, line), fill=(228, 230, 233))
    return image
