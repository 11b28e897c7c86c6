"""Plots of a run: they are drawn for any hand, without a display or global state."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from metrics_cases import human_motion, make_trace

from smooth_operator.errors import ConfigError, OutputError
from smooth_operator.reporting import metric_plots as plots
from smooth_operator.reporting.drawing import name_points
from smooth_operator.reporting.metric_plots import save_plots

NAMES = ["thumb_cmc", "index_mcp", "middle_mcp", "ring_mcp"]


@pytest.mark.filterwarnings("error")
def test_all_figures_are_written(tmp_path: Path) -> None:
    human = human_motion(40)
    human[10:15] = np.nan
    paths = save_plots(make_trace(human), NAMES, tmp_path / "new" / "plots")
    assert [p.name for p in paths] == [
        "fingertips.png",
        "joints.png",
        "latency.png",
        "thumb_distances.png",
    ]
    for path in paths:
        assert path.read_bytes().startswith(b"\x89PNG")
        assert path.stat().st_size > 10_000


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("frames", [1, 3])
def test_a_tiny_run_of_a_two_finger_hand_without_latency(frames: int, tmp_path: Path) -> None:
    trace = make_trace(
        human_motion(frames),
        fingers=("thumb", "pinky"),
        latency_ms=np.full(frames, np.nan),
        joint_limits=np.full((4, 2), np.nan),
    )
    assert all(path.stat().st_size for path in save_plots(trace, NAMES, tmp_path))


def test_axes_are_labelled_with_units() -> None:
    trace = make_trace(human_motion(30))
    for figure in (
        plots.fingertip_figure(trace),
        plots.joint_figure(trace, NAMES),
        plots.latency_figure(trace),
        plots.thumb_distance_figure(trace),
    ):
        labels = {ax.get_xlabel() for ax in figure.axes} | {ax.get_ylabel() for ax in figure.axes}
        assert any(unit in label for label in labels for unit in ("[mm]", "[rad]", "commands"))
        assert "time [s]" in labels or "latency [ms]" in labels
        assert figure.get_suptitle()


def test_the_joint_lines_are_the_commands() -> None:
    trace = make_trace(human_motion(30))
    figure = plots.joint_figure(trace, NAMES)
    for j, ax in enumerate(figure.axes):
        assert ax.get_title() == NAMES[j]
        limits, line = ax.lines[:-1], ax.lines[-1]
        np.testing.assert_array_equal(line.get_ydata(), trace.joint_positions[:, j])
        assert [line.get_ydata()[0] for line in limits] == [-1, 1]


def test_a_slow_first_command_does_not_hide_the_others() -> None:
    latency = np.r_[9000.0, np.linspace(1, 2, 399)]
    left, right = plots.latency_figure(make_trace(human_motion(400), latency_ms=latency)).axes
    assert left.get_xlim()[1] < 4
    assert right.get_xlim()[1] < 4
    title = left.get_figure().get_suptitle()  # type: ignore[union-attr]
    assert "1 beyond the view" in title


def test_wrong_names_and_unwritable_folders_say_so(tmp_path: Path) -> None:
    trace = make_trace(human_motion(5))
    with pytest.raises(ConfigError, match="must name the 4 joints"):
        save_plots(trace, NAMES[:3], tmp_path)
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(OutputError, match="can't be written"):
        save_plots(trace, NAMES, tmp_path / "file")


def test_importing_metrics_does_not_import_matplotlib() -> None:
    code = "import sys, smooth_operator.metrics; sys.exit('matplotlib' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_names_of_points_cover_nothing() -> None:
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
