"""Writes GeoRT's trained networks to a file, which ``method`` reads."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import numpy as np
from jaxtyping import Float

from smooth_operator.atomic_files import atomic_write
from smooth_operator.baselines.geort.method import FORMAT, VERSION, GeortModel
from smooth_operator.hands.hand import Hand
from smooth_operator.io.jsonable import to_json

_POSES: Final = 8  # random poses by which a hand is recognised


def recognition(hand: Hand) -> tuple[Float[np.ndarray, "k m"], Float[np.ndarray, "k F 3"]]:
    """Random poses of a hand and their fingertips, from which a model recognises the hand that it
    was trained for."""
    low, high = hand.limits.T
    poses = np.random.default_rng(0).uniform(low, high, (_POSES, len(low)))
    return poses, hand.tips(hand.full_configuration(poses))


def write_geort_model(path: str | Path, model: GeortModel) -> None:
    """Writes a model atomically, as an ``.npz`` of plain arrays; OutputError if the file can't be
    written."""
    about = {
        "format": FORMAT,
        "version": VERSION,
        "hand": model.hand,
        "side": model.side,
        "fingers": model.fingers,
        "joints": model.joints,
        "limits": model.limits,
        "training": model.training,
    }
    arrays = {name: np.asarray(w, np.float32) for name, w in model.weights._asdict().items()}
    with atomic_write(path) as file:
        np.savez_compressed(
            file,
            allow_pickle=False,
            about=np.array(to_json(about)),
            centre=np.asarray(model.centre, np.float64),
            scale=np.asarray(model.scale, np.float64),
            poses=np.asarray(model.poses, np.float64),
            tips=np.asarray(model.tips, np.float64),
            **arrays,
        )
