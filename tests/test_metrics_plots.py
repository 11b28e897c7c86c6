"""Plots: names of points, and matplotlib that is not imported before a plot is drawn."""

import subprocess
import sys

import numpy as np

from smooth_operator.reporting.drawing import name_points


def test_importing_metrics_does_not_import_matplotlib():
    code = "import sys, smooth_operator.metrics; sys.exit('matplotlib' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_names_of_points_cover_nothing():
    from matplotlib.figure import Figure
    from matplotlib.text import Text

    drawing = Figure(figsize=(4, 3), dpi=100)
    ax = drawing.subplots()
    points = {f"method {i}": (0.9 + 0.01 * (i % 3), 0.5 + 0.002 * i) for i in range(8)}
    ax.set_xlim(0, 1)
    ax.set_ylim(0, 1)
    drawing.draw_without_rendering()
    name_points(ax, points, size=7.5)
    drawing.draw_without_rendering()
    boxes = [Text.get_window_extent(text) for text in ax.texts]  # without the lines to points
    assert len(boxes) == len(points)
    places = np.asarray(ax.transData.transform(list(points.values())))
    for i, box in enumerate(boxes):
        assert ax.bbox.x0 <= box.x0
        assert box.x1 <= ax.bbox.x1
        assert not any(box.overlaps(other) for other in boxes[:i])
        assert not any(box.contains(x, y) for x, y in places)
