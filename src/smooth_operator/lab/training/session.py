"""A training in a folder: goes on where it stopped, keeps what it has when it is stopped."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final

from smooth_operator.atomic_files import atomic_write
from smooth_operator.baselines.geort import GeortModel, write_geort_model
from smooth_operator.errors import OutputError
from smooth_operator.formats.environment import environment
from smooth_operator.formats.jsonable import to_json
from smooth_operator.lab.training.checkpoint import read_checkpoint, write_checkpoint
from smooth_operator.lab.training.curves import plot_curves, write_curves
from smooth_operator.lab.training.loop import GeortTrainer, TrainingState

CHECKPOINT: Final = "checkpoint.npz"
MODEL: Final = "model.npz"
ABOUT: Final = "model.json"
CURVES: Final = "losses.csv"
PLOT: Final = "losses.png"


@dataclass(frozen=True, eq=False)
class TrainingSession:
    """Trains into a folder.

    The folder gets ``checkpoint.npz``, ``model.npz`` (the networks so far, ready to use),
    ``model.json`` (how they were trained, as the model also has it), ``losses.csv`` and, at
    the end, ``losses.png``. Each file is whole or not there. A training that was stopped and
    resumed ends in the same bytes as one that was not, on the same machine.

    Attributes:
        trainer: trainer of the model.
        folder: where to; must exist.
        every: epochs between checkpoints.
    """

    trainer: GeortTrainer
    folder: Path
    every: int = 10

    def run(
        self, *, resume: bool = False, watch: Callable[[TrainingState], None] | None = None
    ) -> GeortModel:
        """Train to the last epoch.

        Args:
            resume: go on from the folder's checkpoint.
            watch: called with the state before the first epoch and after each.

        Returns:
            the model, as written.

        Raises:
            ConfigError: there is nothing to resume, or it is another training.
            OutputError: there is a training in the folder and it is not to be resumed, or a file
                can't be written.
            KeyboardInterrupt: stopped; everything up to the last whole epoch is kept.
        """
        state = self._start(resume)
        saved = int(state.epoch) if resume else -1
        if watch is not None:
            watch(state)
        try:
            for later in self.trainer.epochs(state):
                state = later
                if watch is not None:
                    watch(state)
                if int(state.epoch) % self.every == 0:
                    self._save(state)
                    saved = int(state.epoch)
        except KeyboardInterrupt:
            if int(state.epoch) > max(saved, 0):
                self._save(state)
            if int(state.epoch) > 0:
                plot_curves(self.folder / PLOT, state)
            raise
        plot_curves(self.folder / PLOT, state)
        return self._save(state)

    def _start(self, resume: bool) -> TrainingState:
        checkpoint = self.folder / CHECKPOINT
        if resume:
            return read_checkpoint(checkpoint, self.trainer)
        if checkpoint.exists():
            raise OutputError(
                f"{self.folder}: there is a training already: go on with it (--resume), or name "
                "another folder"
            )
        existing = [n for n in (MODEL, ABOUT, CURVES, PLOT) if (self.folder / n).exists()]
        if existing:
            raise OutputError(
                f"{self.folder}: {', '.join(existing)} would be overwritten; name another folder"
            )
        return self.trainer.init()

    def _save(self, state: TrainingState) -> GeortModel:
        # No date: the same training is the same bytes.
        where: dict[str, Any] = {k: v for k, v in environment().items() if k != "created"}
        where["versions"] = where["versions"] | {"optax": version("optax")}
        model = self.trainer.model(state, environment=where)
        write_checkpoint(self.folder / CHECKPOINT, self.trainer, state)
        write_geort_model(self.folder / MODEL, model)
        with atomic_write(self.folder / ABOUT) as file:
            about = {"hand": model.hand, "side": model.side, "training": model.training}
            file.write(to_json(about, indent=2).encode() + b"\n")
        write_curves(self.folder / CURVES, state)
        return model
