"""Loss curves of a training: a table and a picture."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from smooth_operator.atomic_files import atomic_write
from smooth_operator.errors import require
from smooth_operator.formats.csv_table import csv_text
from smooth_operator.lab.training.loop import TrainingState
from smooth_operator.lab.training.losses import LOSSES

require("training", "lab", "matplotlib")

_UNITS = ("weighted", "1 - cosine", "m²", "relative", "m²")


def write_curves(path: Path, state: TrainingState) -> None:
    """Write the losses of all epochs done as CSV: epoch, then train_ and validation_ columns.

    Raises:
        OutputError: it can't be written.
    """
    names = ("loss", *LOSSES)
    columns = [f"{kind}_{n}" for kind in ("train", "validation") for n in names]
    done = int(state.epoch)
    rows = np.hstack([np.asarray(state.train), np.asarray(state.validation)])[:done]
    numbered = (
        {"epoch": epoch, **{c: f"{value:.9g}" for c, value in zip(columns, row, strict=True)}}
        for epoch, row in enumerate(rows, start=1)
    )
    with atomic_write(path) as file:
        file.write(csv_text(["epoch", *columns], numbered).encode())


def plot_curves(path: Path, state: TrainingState) -> None:
    """Draw the same as PNG, one panel for each loss.

    Raises:
        OutputError: it can't be written.
    """
    from matplotlib.figure import Figure  # not pyplot: no global state, no display

    done = int(state.epoch)
    epochs = np.arange(1, done + 1)
    curves = {
        "training": (np.asarray(state.train)[:done], "#0072B2"),
        "validation": (np.asarray(state.validation)[:done], "#D55E00"),
    }
    figure = Figure(figsize=(14, 3.2))
    figure.subplots_adjust(left=0.04, right=0.99, top=0.88, bottom=0.16, wspace=0.26)
    panels = figure.subplots(1, 1 + len(LOSSES))
    for i, (panel, name) in enumerate(zip(panels, ("loss", *LOSSES), strict=True)):
        for label, (values, colour) in curves.items():
            shown = values[:, i] > 0  # a logarithm has no place for nothing, nor for NaN
            panel.plot(epochs[shown], values[shown, i], color=colour, label=label)
            if shown.any():
                panel.set_yscale("log")
        panel.set_title(f"{name} [{_UNITS[i]}]", fontsize=10)
        panel.set_xlabel("epoch")
        panel.grid(alpha=0.25)
    panels[0].legend(frameon=False)
    with atomic_write(path) as file:
        figure.savefig(file, format="png", dpi=120)
