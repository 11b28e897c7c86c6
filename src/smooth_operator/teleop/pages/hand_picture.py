"""Draws a robot hand without a GPU: shape, landmarks, palm frame and joint ranges.

Matplotlib paints triangles sorted by depth, so this works without a display and without OpenGL.
"""

from __future__ import annotations

import io
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np
from jaxtyping import Float

from smooth_operator.atomic_files import atomic_write, output_error
from smooth_operator.hands.hand import Hand
from smooth_operator.teleop.joint_rows import joint_rows
from smooth_operator.teleop.pages.hand_view import PALM, HandView, finger_colors

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_LIGHT: Final = np.array([0.35, 0.55, 0.75]) / np.linalg.norm([0.35, 0.55, 0.75])
_FRAME_COLORS: Final = ("#d62728", "#2ca02c", "#1f77b4")  # x, y, z
_INK: Final = "#333333"
_DPI: Final = 110
_COLORS: Final = 96  # of the PNG's palette: a fifth of the bytes, and no eye sees it


def hand_figure(hand: Hand, *, simple: bool = False) -> Figure:
    """Draws a hand seen from the palm's side and from the thumb's side, with a list of its joints.

    Args:
        simple: draw simple shapes even if the model has meshes.
    """
    from matplotlib.figure import Figure

    pose = hand.neutral
    view = HandView(hand, simple=simple)
    palmar, rows = view.axes, joint_rows(hand)
    side = 1.0 if hand.spec.side == "right" else -1.0
    # Turned by a right angle about distal, and a little less, so that no finger hides the others.
    turn = np.deg2rad(65.0) * side
    radial = np.stack(
        [
            np.cos(turn) * palmar[0] - np.sin(turn) * palmar[2],
            palmar[1],
            np.sin(turn) * palmar[0] + np.cos(turn) * palmar[2],
        ]
    )
    figure = Figure(figsize=(10.5, max(4.6, 0.185 * len(rows) + 0.9)), layout="constrained")
    grid = figure.subplots(1, 3, width_ratios=(1.0, 1.0, 0.9))
    for axes, directions, title in zip(
        grid[:2], (palmar, radial), ("from the palm", "from the thumb"), strict=True
    ):
        _draw_hand(axes, view, pose, directions)
        axes.set_title(title, fontsize=9, color=_INK)
    _draw_joints(grid[2], hand, pose)
    mirrored = " (mirrored)" if hand.spec.mirror else ""
    figure.suptitle(f"{hand.name}, {hand.spec.side} hand{mirrored}", fontsize=11, color=_INK)
    return figure


def save_hand_picture(hand: Hand, path: str | Path, *, simple: bool = False) -> None:
    """Writes ``hand_figure`` as a PNG with a reduced palette.

    Args:
        path: the file.
        simple: draw simple shapes even if the model has meshes.

    Raises:
        OutputError: the file can't be written.
    """
    from PIL import Image

    drawn = io.BytesIO()
    hand_figure(hand, simple=simple).savefig(drawn, dpi=_DPI, format="png", facecolor="white")
    small = Image.open(drawn).convert("RGB").quantize(_COLORS, dither=Image.Dither.NONE)
    try:
        with atomic_write(path) as file:
            small.save(file, format="PNG", optimize=True)
    except OSError as error:
        raise output_error(path, error) from error


def _draw_hand(
    axes: Axes, view: HandView, q: Float[np.ndarray, " m"], directions: Float[np.ndarray, "3 3"]
) -> None:
    """Draws an orthographic view; ``directions`` are right, up and toward the viewer."""
    from matplotlib.collections import LineCollection, PolyCollection

    fingers = finger_colors(len(view.hand.fingers)) / 255.0
    flat, depths, colors = [], [], []
    for body, (rotation, position) in view.bodies(q).items():
        mesh, owner = view.meshes[body], view.finger_of_body[body]
        projected = (mesh.vertices @ rotation.T + position) @ directions.T
        corners = projected[mesh.faces]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-15)
        front = normals[:, 2] > 0
        color = np.array(PALM) / 255.0 if owner < 0 else 0.35 * fingers[owner] + 0.65
        light = 0.55 + 0.45 * np.clip(normals[front] @ _LIGHT, 0, 1)
        flat.append(corners[front][:, :, :2] * 1e3)
        depths.append(corners[front][:, :, 2].mean(axis=1))
        colors.append(light[:, None] * color)
    if flat:  # else a hand so small that not even capsules stand in for its shapes
        order = np.argsort(np.concatenate(depths))
        shades = np.concatenate(colors)[order]
        axes.add_collection(
            PolyCollection(
                list(np.concatenate(flat)[order]),
                facecolors=shades,
                edgecolors=shades,
                linewidths=0.3,
            )
        )
    points = view.hand.landmark_positions(q) @ directions.T * 1e3
    bones = view.bones()
    axes.add_collection(
        LineCollection(
            [points[[a, b], :2] for _, a, b in bones],
            colors=[fingers[finger] for finger, _, _ in bones],
            linewidths=1.1,
        )
    )
    marks = np.tile(np.array([0.2, 0.2, 0.2]), (len(points), 1))
    for finger, _, end in bones:
        marks[end] = fingers[finger]
    axes.scatter(
        points[:, 0], points[:, 1], s=16, c=marks, edgecolors="white", linewidths=0.6, zorder=3
    )
    arrows = directions.T[:, :2] * 30.0  # the palm frame's axes, 30 mm long
    for (x, y), color, name in zip(arrows, _FRAME_COLORS, "xyz", strict=True):
        axes.plot([0, x], [0, y], color=color, linewidth=2.0, zorder=4)
        if np.hypot(x, y) > 6:
            axes.annotate(
                name,
                (1.2 * x, 1.2 * y),
                color=color,
                fontsize=8,
                ha="center",
                va="center",
                zorder=4,
            )
    axes.set_aspect("equal")
    axes.autoscale_view()
    axes.margins(0.04)
    axes.tick_params(labelsize=7, colors=_INK)
    axes.set_xlabel("mm", fontsize=7, color=_INK)
    for spine in axes.spines.values():
        spine.set_color("#cccccc")


def _draw_joints(axes: Axes, hand: Hand, q: Float[np.ndarray, " m"]) -> None:
    """Draws the joint ranges as bars and the pose as marks."""
    rows, every = joint_rows(hand), hand.full_configuration(q)
    units = [1e3 if joint.slide else np.rad2deg(1.0) for joint in hand.tree.joints]
    for i, (row, value) in enumerate(zip(rows, every, strict=True)):
        low, high = units[i] * np.array([row.low, row.high])
        axes.barh(
            i, high - low, left=low, height=0.62, color="#9ecae1" if row.actuated else "#dddddd"
        )
        axes.plot(units[i] * value, i, marker="|", color=_INK, markersize=8, markeredgewidth=1.6)
    axes.set_yticks(range(len(rows)), [row.name for row in rows], fontsize=6.5, color=_INK)
    axes.set_ylim(len(rows) - 0.4, -0.6)
    axes.tick_params(axis="x", labelsize=7, colors=_INK)
    unit = "degrees (slides: mm)" if any(j.slide for j in hand.tree.joints) else "degrees"
    axes.set_xlabel(
        f"{unit}; grey bars: coupled joints; |: position in this pose", fontsize=7, color=_INK
    )
    axes.axvline(0, color="#bbbbbb", linewidth=0.6, zorder=0)
    for name in ("top", "right", "left"):
        axes.spines[name].set_visible(False)
