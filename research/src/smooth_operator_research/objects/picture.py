"""A robot hand at an object, without and with regard to the object."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

import numpy as np
from jaxtyping import Float

from smooth_hand_datasets.objects.hand_surface import HandSurface
from smooth_hand_datasets.objects.interaction_metrics import hand_depths
from smooth_hand_datasets.objects.placement import apply
from smooth_hand_datasets.objects.terms import DEFAULT
from smooth_operator import poses
from smooth_operator.errors import require
from smooth_operator.hands.registry import load_hand
from smooth_operator_research.objects.comparison import AWARE, BLIND, answer_of
from smooth_operator_research.objects.scenes import MadeClip, SceneSpec, make_clip

_TIME_S: Final = 1.0  # the middle of the hold
_SHOWN_M: Final = 0.13  # of the hand, about the object
_CLOUD: Final = 300_000  # points from which the object's surface is drawn
_DOT: Final = 9.0  # area of a dot [pt^2]
_HAND, _OBJECT = np.array([0.55, 0.66, 0.78]), np.array([0.87, 0.80, 0.66])
_INSIDE, _TOUCHED = "#d55e00", "#009e73"


def draw_comparison(
    file: Path, hand: str = "mimic_p050", spec: SceneSpec | None = None
) -> dict[str, float]:
    """Draws one moment of a made clip without and with regard to the object, side by side.

    Args:
        file: PNG or SVG.
        hand: name of the robot hand.
        spec: of the clip; a grasp of a cylinder by default.

    Returns:
        method -> depth of the deepest point then [mm].

    Raises:
        MissingExtraError: Matplotlib is not installed.
    """
    require("the picture", "lab", "matplotlib")
    from matplotlib.figure import Figure

    clip = make_clip(spec or SceneSpec("grasp", "cylinder", 0))
    surface = HandSurface(load_hand(hand, next(iter(clip.clip.hands))))
    frame = int(np.searchsorted(clip.clip.stamps, _TIME_S))
    figure = Figure(figsize=(10, 5), dpi=120, layout="constrained")
    depths = {}
    for column, method in enumerate((BLIND, AWARE), start=1):
        answer, _ = answer_of(method, surface.hand, DEFAULT)
        commands, palm = answer(clip)
        q = commands.joint_positions
        world = apply(palm[frame][None], surface.surface.at(surface.frames(q[frame : frame + 1])))[
            0
        ]
        deepest = hand_depths(surface, q, palm, clip.scene).deepest
        depths[method] = 1e3 * float(deepest[frame])
        axes = figure.add_subplot(1, 2, column)
        _draw(axes, clip, frame, world)
        axes.set_title(f"{method}: deepest point {depths[method]:.1f} mm")
    figure.savefig(file)
    return depths


def _draw(axes: Any, clip: MadeClip, frame: int, world: Float[np.ndarray, "n 3"]) -> None:
    """Hand and object as dots, the near ones over the far ones, seen along the object."""
    solid, track = clip.scene.solids[0], clip.scene.T_world_object[0, frame]
    back = poses.invert(track)
    hand = poses.rotate(back[None, 3:], world) + back[:3]
    hand = hand[np.linalg.norm(hand, axis=-1) < _SHOWN_M]
    depth = solid.distance(hand)
    cloud = np.random.default_rng(0).uniform(-0.08, 0.08, (_CLOUD, 3))
    cloud = cloud[np.abs(solid.distance(cloud)) < 0.003]
    surface = solid.nearest(cloud)[1]
    palm = 1.0 if hand[:, 1].mean() > 0 else -1.0
    towards = np.array([0.25, -0.75 * palm, 0.6])  # from the object to the eye
    towards /= np.linalg.norm(towards)
    across = np.cross([0.0, 0.0, 1.0], towards)
    across /= np.linalg.norm(across)
    view = 1e3 * np.stack([across, np.cross(towards, across), towards], axis=-1)

    points = np.concatenate([surface @ view, hand @ view])
    colour = np.concatenate([np.tile(_OBJECT, (len(surface), 1)), np.tile(_HAND, (len(hand), 1))])
    far, near = points[:, 2].min(), points[:, 2].max()
    light = 0.55 + 0.45 * (points[:, 2:] - far) / max(float(near - far), 1.0)
    order = np.argsort(points[:, 2])
    axes.scatter(*points[order, :2].T, s=_DOT, c=(colour * light)[order], linewidths=0)
    inside = (hand @ view)[depth < -5e-4]
    axes.scatter(
        *inside[:, :2].T, s=_DOT, c=_INSIDE, linewidths=0, label="robot, inside the object"
    )
    touched = clip.truth.touching[frame]
    places = clip.truth.place[frame][touched] @ view
    axes.scatter(
        *places[:, :2].T, s=60, c=_TOUCHED, edgecolors="white", label="touched by the human"
    )
    axes.set_aspect("equal")
    axes.set_axis_off()
    axes.legend(loc="lower left", frameon=False, markerscale=1.5)
