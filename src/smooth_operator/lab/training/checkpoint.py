"""Checkpoints of a training: plain arrays and a text, written whole or not at all."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Final

import jax
import jax.numpy as jnp
import numpy as np

from smooth_operator.atomic_files import atomic_write
from smooth_operator.errors import ConfigError, RecordingError
from smooth_operator.formats.arrays import open_arrays
from smooth_operator.formats.jsonable import to_json
from smooth_operator.io.documents import parse_json
from smooth_operator.lab.training.loop import GeortTrainer, TrainingState

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
