"""A training in a folder: goes on where it stopped, keeps what it has when it is stopped."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final

import jax
import jax.numpy as jnp
import numpy as np

from smooth_operator.atomic_files import atomic_write
from smooth_operator.baselines.geort import GeortModel, write_geort_model
from smooth_operator.errors import ConfigError, OutputError, RecordingError
from smooth_operator.formats.arrays import open_arrays
from smooth_operator.formats.csv_table import csv_text
from smooth_operator.formats.environment import environment
from smooth_operator.formats.jsonable import to_json
from smooth_operator.io.documents import parse_json
from smooth_operator.lab.training.loop import LOSSES, GeortTrainer, TrainingState

CHECKPOINT: Final = "checkpoint.npz"
MODEL: Final = "model.npz"
ABOUT: Final = "model.json"
CURVES: Final = "losses.csv"


@dataclass(frozen=True, eq=False)
class TrainingSession:
    """Trains into a folder.

    The folder gets ``checkpoint.npz``, ``model.npz`` (the networks so far, ready to use),
    ``model.json`` (how they were trained, as the model also has it), and ``losses.csv``.
    Each file is whole or not there. A training that was stopped and resumed ends in the same bytes
    as one that was not, on the same machine.

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
            raise
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
        existing = [n for n in (MODEL, ABOUT, CURVES) if (self.folder / n).exists()]
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


FORMAT: Final = "smooth-operator geort checkpoint"
VERSION: Final = 1


def write_checkpoint(path: Path, trainer: GeortTrainer, state: TrainingState) -> None:
    """Write all that is needed to go on as if nothing had happened.

    Raises:
        OutputError: it can't be written.
    """
    leaves = {f"leaf_{i:03d}": np.asarray(leaf) for i, leaf in enumerate(jax.tree.leaves(state))}
    with atomic_write(path) as file:
        np.savez(file, allow_pickle=False, about=np.array(to_json(_identity(trainer))), **leaves)


def read_checkpoint(path: Path, trainer: GeortTrainer) -> TrainingState:
    """Read what ``write_checkpoint`` wrote, for the same training.

    Raises:
        ConfigError: there is none, it is damaged, or it is of another hand, other data or other
            settings; the message says which.
    """
    path = Path(path)
    if not path.is_file():
        raise ConfigError(f"{path}: there is no checkpoint to resume from; start without --resume")
    identity = json.loads(to_json(_identity(trainer)))
    template = trainer.init()
    shapes = [np.asarray(leaf) for leaf in jax.tree.leaves(template)]
    try:
        arrays = open_arrays(path)
        stored = parse_json(arrays["about"].text())
        different = _differences(identity, stored)
        leaves = [] if different else [arrays[f"leaf_{i:03d}"].load() for i in range(len(shapes))]
    except (RecordingError, KeyError, TypeError, ValueError) as error:
        raise ConfigError(f"{path}: not a checkpoint of GeoRT's training ({error})") from error
    if different:
        raise ConfigError(
            f"{path}: this checkpoint is of another training: {'; '.join(different)}. Resume with "
            "what it was started with, or train into another folder"
        )
    for leaf, expected in zip(leaves, shapes, strict=True):
        if leaf.shape != expected.shape or leaf.dtype != expected.dtype:
            raise ConfigError(
                f"{path}: not a checkpoint of this training: an array has shape {leaf.shape} of "
                f"{leaf.dtype}, expected {expected.shape} of {expected.dtype}"
            )
    state: TrainingState = jax.tree.unflatten(
        jax.tree.structure(template), [jnp.asarray(leaf) for leaf in leaves]
    )
    return state


def _identity(trainer: GeortTrainer) -> dict[str, Any]:
    return {
        "format": FORMAT,
        "version": VERSION,
        "hand": trainer.hand.name,
        "side": trainer.hand.spec.side,
        "settings": trainer.settings,
        "recordings": trainer.data.sources,
        "data": trainer.data.digest,
    }


def _differences(expected: Any, stored: Any, where: str = "") -> list[str]:
    """Each place where two JSON values differ, as a phrase."""
    if isinstance(expected, dict) and isinstance(stored, dict):
        keys = [*expected, *(key for key in stored if key not in expected)]
        return [
            phrase
            for key in keys
            for phrase in _differences(
                expected.get(key), stored.get(key), f"{where}.{key}" if where else key
            )
        ]
    return [] if expected == stored else [f"its {where} is {stored!r}, not {expected!r}"]
