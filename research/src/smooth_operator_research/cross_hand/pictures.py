"""Pictures of the cross-hand matrix: success of every hand, and strips of single trials."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from smooth_operator.errors import ConfigError
from smooth_operator.hands.registry import load_hand
from smooth_operator.reporting.drawing import colors_of
from smooth_operator.simulation.camera import SimulatedCamera, View
from smooth_operator.simulation.scenes import ScenePhysics
from smooth_operator.simulation.tasks import FIXED_WRIST
from smooth_operator_research.cross_hand.matrix import MatrixSettings, tracker_of
from smooth_operator_research.cross_hand.results import Trial
from smooth_operator_research.cross_hand.tables import Outcomes, label
from smooth_operator_research.cross_hand.trials import Block, judge, play_block
from smooth_operator_research.physics.results import wilson

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from PIL.Image import Image

_WIDTH, _HEIGHT = 240, 180  # size of a picture of a strip [px]
_LINE: Final = 14  # height of its text [px]
_FAR_M: Final = 0.75  # distance of the camera from a hand that moves [m]


def plot_success(outcomes: Outcomes) -> Figure:
    """Plot of the share of trials with score 1 and Wilson's interval: a panel for each task, a row
    for each hand, a colour for each method."""
    from matplotlib.figure import Figure

    hands, tasks, methods = outcomes.hands, outcomes.tasks, outcomes.methods
    plot = Figure(figsize=(2.2 * len(tasks) + 1.8, 0.34 * len(hands) + 1.2), layout="constrained")
    axes = plot.subplots(1, len(tasks), sharey=True, squeeze=False)[0]
    colors = colors_of(map(label, methods))
    for ax, task in zip(axes, tasks, strict=True):
        for number, method in enumerate(methods):
            shift = 0.6 * (number / max(1, len(methods) - 1) - 0.5)
            for row, hand in enumerate(hands):
                scores = [t.score == 1.0 for *_, t in outcomes.of(task, hand, method)]
                if not scores:
                    continue
                color, share = colors[label(method)], float(np.mean(scores))
                ends = wilson(sum(scores), len(scores))
                name = label(method) if row == 0 else None
                ax.plot(ends, [row + shift] * 2, color=color, linewidth=1.5, alpha=0.5)
                ax.plot(share, row + shift, "o", color=color, markersize=3.5, label=name)
        ax.set(title=task, xlim=(-0.03, 1.03), xlabel="share of trials with score 1")
    axes[0].set_yticks(range(len(hands)), hands)
    axes[0].set_ylim(len(hands) - 0.4, -0.6)
    handles, names = axes[0].get_legend_handles_labels()
    plot.legend(handles, names, loc="outside lower center", ncols=len(methods))
    return plot


def draw_strip(task: str, hands: Sequence[str], method: str, world: int, count: int) -> Image:
    """Draws a trial of each hand as a row of pictures, with the hand and the result below it.

    Args:
        task: name of the task.
        hands: names of right hands.
        method: ``METHOD`` or ``METHOD:PRESET``.
        world: number of the world, which determines the tracker.
        count: number of pictures in a row, at equal intervals.
    """
    from PIL import Image, ImageDraw

    if count < 2 or world < 0:
        raise ConfigError(f"a strip has 2 pictures or more of a world from 0, not {count}, {world}")
    # checks the names
    settings = MatrixSettings(tasks=(task,), hands=tuple(hands), methods=(method,))
    sheet = Image.new("RGB", (count * _WIDTH, len(hands) * (_HEIGHT + _LINE)), "white")
    for row, name in enumerate(settings.hands):
        block = Block(task, name, settings.methods[0], ((world, tracker_of(world)),))
        pictures, trial = _pictures(block, count)
        top = row * (_HEIGHT + _LINE)
        for column, picture in enumerate(pictures):
            sheet.paste(Image.fromarray(picture), (column * _WIDTH, top))
        text = f"{name}, {task}, {label(block.method)}: {trial.reason} ({trial.seconds:.1f} s)"
        ImageDraw.Draw(sheet).text((4, top + _HEIGHT + 1), text, fill="black")
    return sheet


def _pictures(block: Block, count: int) -> tuple[list[Any], Trial]:
    """Pictures of a block's only trial at equal intervals, and its result."""
    watched: list[ScenePhysics] = []
    positions = []
    (moments,) = play_block(load_hand(block.hand, "right"), block, watched.append)

    def recorded() -> Any:
        for moment in moments:
            positions.append(watched[0].data.qpos.copy())
            yield moment

    trial = judge(recorded())
    view = View(distance=None if block.task in FIXED_WRIST else _FAR_M)
    camera = SimulatedCamera(watched[0], _WIDTH, _HEIGHT, view)
    try:
        chosen = np.linspace(0, len(positions) - 1, count).astype(int)
        return [camera.draw(positions[k]) for k in chosen], trial
    finally:
        camera.close()
