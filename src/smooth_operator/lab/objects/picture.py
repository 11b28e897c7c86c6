"""A robot hand at an object, without and with regard to the object."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from smooth_operator import poses
from smooth_operator.errors import require
from smooth_operator.hands.registry import load_hand
from smooth_operator.lab.objects.comparison import AWARE, BLIND, answer_of
from smooth_operator.lab.objects.hand_surface import HandSurface
from smooth_operator.lab.objects.interaction_metrics import hand_depths
from smooth_operator.lab.objects.placement import apply
from smooth_operator.lab.objects.scenes import MadeClip, SceneSpec, make_clip
from smooth_operator.lab.objects.terms import DEFAULT

_TIME_S = 1.0  # the middle of the hold
_VIEW = (18.0, -60.0)
_FREE, _INSIDE, _TOUCHED = "#9aa7b5", "#d55e00", "#009e73"


def draw_comparison(
    file: Path, hand: str = "shadow_hand", spec: SceneSpec | None = None
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

    made = make_clip(spec or SceneSpec("grasp", "cylinder", 100))
    surface = HandSurface(load_hand(hand, next(iter(made.clip.hands))))
    frame = int(np.searchsorted(made.clip.stamps, _TIME_S))
    figure = Figure(figsize=(10, 5), dpi=120, layout="constrained")
    depths = {}
    for column, method in enumerate((BLIND, AWARE), start=1):
        answer, _ = answer_of(method, surface.hand, DEFAULT)
        commands, palm = answer(made)
        q = commands.joint_positions
        world = apply(palm[frame][None], surface.surface.at(surface.frames(q[frame : frame + 1])))[
            0
        ]
        deepest = hand_depths(surface, q, palm, made.scene).deepest
        depths[method] = 1e3 * float(deepest[frame])
        axes = figure.add_subplot(1, 2, column, projection="3d")
        _draw(axes, made, frame, world)
        axes.set_title(f"{method}: deepest point {depths[method]:.1f} mm")
    figure.savefig(file)
    return depths


def _draw(axes: Any, made: MadeClip, frame: int, world: Float[np.ndarray, "n 3"]) -> None:
    """The hand's surface in the object's frame, the object, and where the human touches it."""
    solid, track = made.scene.solids[0], made.scene.T_world_object[0, frame]
    back = poses.invert(track)
    local = poses.rotate(back[None, 3:], world) + back[:3]
    near = np.linalg.norm(local, axis=-1) < 0.13
    local = 1e3 * local[near]
    inside = solid.distance(local / 1e3) < 0
    axes.scatter(*local[~inside][::2].T, s=1.0, c=_FREE, alpha=0.35, linewidths=0)
    axes.scatter(*local[inside].T, s=4.0, c=_INSIDE, linewidths=0, label="robot, inside")
    rng = np.random.default_rng(0)
    cloud = rng.uniform(-0.08, 0.08, (60_000, 3))
    distance, shell, _ = solid.nearest(cloud[np.abs(solid.distance(cloud)) < 0.003])
    shell = 1e3 * shell[np.isfinite(distance)]
    axes.scatter(*shell[::2].T, s=0.8, c="#444444", alpha=0.15, linewidths=0)
    touched = made.truth.touching[frame]
    places = 1e3 * made.truth.place[frame][touched]
    axes.scatter(*places.T, s=45, c=_TOUCHED, label="touched by the human", depthshade=False)
    axes.view_init(*_VIEW)
    axes.set_aspect("equal")
    axes.set_axis_off()
    axes.legend(loc="lower left", frameon=False)
