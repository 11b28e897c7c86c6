"""The nodes of a MANUS glove recording, put in the order of their ids."""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np
from jaxtyping import Float

from smooth_operator.errors import RecordingError, brief
from smooth_operator.formats.arrays import StoredArrays

_NUM_NODES = 25
_MOST_GLOVES: Final = 16
# Columns of the quaternion in wxyz order; px py pz come before it.
_QUATERNION_COLUMNS = {"wxyz": (3, 4, 5, 6), "xyzw": (6, 3, 4, 5)}


def manus_nodes(
    arrays: StoredArrays,
) -> tuple[Float[np.ndarray, "T 25 3"], Float[np.ndarray, "T 25 4"], dict[str, Any]]:
    """Read ``data`` of a MANUS ``.npz``: columns px py pz [m] and a quaternion for each node.

    The node with id i stands at index i of what comes back, whatever order the file has. Where
    ``keypoint_ids`` or ``quaternion_order`` is not in the file, the glove's own order (0 .. 24,
    wxyz) is taken and named in the third value under ``"assumed"``.

    Returns:
        Positions (T, 25, 3) [m], orientations (T, 25, 4) as unit quaternions wxyz (NaN where the
        file has a zero one), and what else the file says.

    Raises:
        RecordingError: no frames, missing or repeated ids, an unknown quaternion order, or what
            ``StoredArray.numbers`` raises.
    """
    where = str(arrays.path)
    item = arrays["data"]
    if item.shape[0] == 0:
        raise RecordingError(f"{where}: the recording holds no frames, its shape is {item.shape}")
    meta: dict[str, Any] = {"format": "manus"}
    assumed = []

    if "keypoint_ids" in arrays:
        order = _order(arrays["keypoint_ids"].numbers(), item.shape[1], where)
    elif item.shape[1] == _NUM_NODES:
        order = np.arange(_NUM_NODES)
        assumed.append("keypoint_ids")
    else:
        raise RecordingError(
            f"{where}: a MANUS recording has {_NUM_NODES} nodes, this one {item.shape[1]} and no "
            "'keypoint_ids' to say which they are; export it again with the ids"
        )

    if "quaternion_order" in arrays:
        labels = {text.strip().lower() for text in arrays["quaternion_order"].texts()}
    else:
        labels = {"wxyz"}
        assumed.append("quaternion_order")
    if len(labels) != 1 or not labels <= _QUATERNION_COLUMNS.keys():
        raise RecordingError(
            f"{where}: 'quaternion_order' must be 'wxyz' or 'xyzw', not {brief(sorted(labels))}"
        )

    data = item.numbers()[:, order]
    quaternions = data[..., _QUATERNION_COLUMNS[labels.pop()]]
    norms = np.linalg.norm(quaternions, axis=-1, keepdims=True)
    # The gloves' own are up to 1 % off unit length.
    quaternions = np.divide(
        quaternions, norms, out=np.full_like(quaternions, np.nan), where=norms > 0.0
    )
    if "glove_ids" in arrays:
        ids = arrays["glove_ids"]
        if ids.dtype.kind in "iuSU" and math.prod(ids.shape) <= _MOST_GLOVES:
            meta["glove_ids"] = (
                ids.texts() if ids.dtype.kind in "SU" else ids.load().ravel().tolist()
            )
    if assumed:
        meta["assumed"] = assumed
    return data[..., :3], quaternions, meta


def _order(ids: np.ndarray, count: int, where: str) -> np.ndarray:
    """Row of each id 0 .. 24 in the data."""
    if ids.shape != (count,):
        raise RecordingError(
            f"{where}: 'keypoint_ids' must name each of the {count} nodes, not shape {ids.shape}"
        )
    missing = sorted(set(range(_NUM_NODES)) - set(ids.tolist()))
    if missing:
        raise RecordingError(
            f"{where}: 'keypoint_ids' must hold 0 to {_NUM_NODES - 1}, but {missing} are missing; "
            "export the recording again with all nodes of the hand"
        )
    fingers = ids[ids < _NUM_NODES]
    if len(np.unique(fingers)) != len(fingers):
        raise RecordingError(
            f"{where}: 'keypoint_ids' holds an id more than once: {brief(ids.tolist())}"
        )
    return np.asarray([np.flatnonzero(ids == i)[0] for i in range(_NUM_NODES)])
