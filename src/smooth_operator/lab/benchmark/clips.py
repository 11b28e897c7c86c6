"""Clips for the page: landmarks of a few seconds, thinned out and packed."""

from __future__ import annotations

import base64
from collections.abc import Mapping
from typing import Any, Final

import numpy as np
from jaxtyping import Float

from smooth_operator.lab.benchmark.panels import Panel, robot_bones, view_basis
from smooth_operator.landmarks import BONES

SECONDS: Final = 8.0
RATE_HZ: Final = 30.0
BUDGET: Final = 12_000_000
"""All clips of a page together [bytes]; where there are many, each gets fewer frames."""
MIN_FRAMES: Final = 40

_UNIT: Final = 1e-4
"""Of the packed numbers [m]."""
_ABSENT: Final = -32768
_POINTS: Final = 21 * 3 * 2 * 4 / 3  # bytes of one hand in one frame, in base64


def make_clip(panel: Panel, colors: Mapping[str, str], hands: int) -> dict[str, Any]:
    """Clip of one panel for the player, ready for JSON.

    Args:
        panel: one recording on one hand.
        colors: method -> colour.
        hands: number of hands in all clips of the page, which share the budget.

    Returns:
        ``times`` of the frames [s]; ``humans`` and ``robots``, each (frames, 21, 3) int16 in base64
        little-endian, in units of 0.1 mm about the middle of the clip, turned so that x is right, y
        up and z towards the viewer; -32768 stands for what is not there; each method's ``objects``,
        (frames, points, 3), where there are some; and how to draw them.
    """
    cut = panel.window(SECONDS)
    stamps = panel.stamps[cut]
    allowed = max(MIN_FRAMES, int(BUDGET / (max(hands, 1) * _POINTS)))
    duration = float(stamps[-1] - stamps[0])
    count = min(len(stamps), allowed, max(2, int(duration * RATE_HZ) + 1))
    times = np.linspace(stamps[0], stamps[-1], count)
    chosen = np.unique(np.searchsorted(stamps, times).clip(0, len(stamps) - 1)) + cut.start

    basis = view_basis(panel.hand)
    humans: list[np.ndarray] = []
    panes: list[dict[str, Any]] = []
    drawn = [run.robot[chosen] @ basis.T for run in panel.runs]
    points = np.concatenate([panel.runs[0].human[chosen] @ basis.T, *drawn]).reshape(-1, 3)
    points = points[np.isfinite(points).all(axis=-1)]
    middle = (points.min(axis=0) + points.max(axis=0)) / 2 if len(points) else np.zeros(3)
    reach = float(np.linalg.norm(points - middle, axis=-1).max()) if len(points) else 0.1
    for run, robot in zip(panel.runs, drawn, strict=True):
        human = run.human[chosen] @ basis.T
        # Methods that align alike share one human.
        same = (i for i, h in enumerate(humans) if np.array_equal(h, human, equal_nan=True))
        at = next(same, None)
        if at is None:
            at = len(humans)
            humans.append(human)
        panes.append(
            {
                "method": run.method,
                "color": colors[run.method],
                "human": at,
                "robot": _packed(robot - middle),
                "objects": None
                if run.objects is None
                else _packed(run.objects[chosen] @ basis.T - middle),
            }
        )
    objects = [run.objects.shape[1] for run in panel.runs if run.objects is not None]
    return {
        "times": [round(float(t), 3) for t in panel.stamps[chosen]],
        "reach": round(reach / _UNIT),
        "humans": [_packed(human - middle) for human in humans],
        "humanBones": [list(bone) for bone in BONES],
        "robotBones": [list(bone) for bone in robot_bones(panel.hand)],
        "objectPoints": max(objects, default=0),
        "objectEdges": [list(edge) for edge in panel.edges],
        "panes": panes,
    }


def _packed(points: Float[np.ndarray, "F k 3"]) -> str:
    finite = np.isfinite(points)
    units = np.rint(np.where(finite, points, 0.0) / _UNIT).clip(-32767, 32767)
    return base64.b64encode(np.where(finite, units, _ABSENT).astype("<i2").tobytes()).decode()
