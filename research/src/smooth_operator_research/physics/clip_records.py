"""Clips as they are kept: thinned to what a player shows, packed as whole numbers."""

from __future__ import annotations

import base64
from typing import Any, Final

import numpy as np

from smooth_operator_research.physics.measure import Clip

RATE_HZ: Final = 30.0
_SCALES: Final = {"human": 1e-4, "joints": 1e-4, "objects": 1e-4}  # [m] or [rad]
_ABSENT: Final = -(2**31)


def clip_record(clip: Clip) -> dict[str, Any]:
    """A clip with a JSON form, at 30 frames a second."""
    stamps = clip.stamps
    count = min(len(stamps), max(2, int((stamps[-1] - stamps[0]) * RATE_HZ) + 1))
    wanted = np.linspace(stamps[0], stamps[-1], count)
    chosen = np.unique(np.searchsorted(stamps, wanted).clip(0, len(stamps) - 1))
    arrays = {name: getattr(clip, name) for name in _SCALES}
    return {
        "stamps": [round(float(t), 4) for t in stamps[chosen]],
        "edges": [list(edge) for edge in clip.edges],
        **{
            name: None if array is None else _packed(array[chosen], _SCALES[name])
            for name, array in arrays.items()
        },
    }


def clip_of_record(record: dict[str, Any]) -> Clip:
    """The clip of ``clip_record``, thinned."""
    arrays = {
        name: None if record[name] is None else _unpacked(record[name], scale)
        for name, scale in _SCALES.items()
    }
    human, joints = arrays["human"], arrays["joints"]
    assert human is not None
    assert joints is not None
    edges = [(int(a), int(b)) for a, b in record["edges"]]
    return Clip(np.asarray(record["stamps"], float), human, joints, arrays["objects"], edges)


def _packed(array: np.ndarray, scale: float) -> dict[str, Any]:
    finite = np.isfinite(array)
    whole = np.where(finite, np.rint(np.where(finite, array, 0.0) / scale), _ABSENT)
    text = base64.b64encode(whole.astype("<i4").tobytes()).decode()
    return {"shape": list(array.shape), "values": text}


def _unpacked(record: dict[str, Any], scale: float) -> np.ndarray:
    whole = np.frombuffer(base64.b64decode(record["values"]), "<i4").reshape(record["shape"])
    return np.where(whole == _ABSENT, np.nan, whole * scale)
