"""The MANO hand: computes 21 landmarks and the wrist's pose from its parameters, in NumPy.

J. Romero, D. Tzionas, M. J. Black: *Embodied Hands: Modeling and Capturing Hands and Bodies
Together*, SIGGRAPH Asia 2017; https://mano.is.tue.mpg.de. The user provides the model files,
whose licence forbids redistribution. Only the five vertices at the fingertips are skinned.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final, Literal, TypeAlias

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from smooth_hand_datasets.unpickle import array, load_restricted, table
from smooth_operator import poses
from smooth_operator.errors import RecordingError
from smooth_operator.landmarks import LAYOUTS
from smooth_operator.types import Side

PARENTS: Final = (-1, 0, 1, 2, 0, 4, 5, 0, 7, 8, 0, 10, 11, 0, 13, 14)
"""Parent of each of the 16 joints: wrist, index, middle, pinky, ring, thumb."""

Tips: TypeAlias = Literal["manopth", "smplx"]
"""Library whose choice of fingertip vertices is used."""

TIPS: Final[dict[tuple[Tips, Side], tuple[int, ...]]] = {
    ("manopth", "right"): (745, 317, 444, 556, 673),
    ("manopth", "left"): (745, 317, 445, 556, 673),
    ("smplx", "right"): (744, 320, 443, 554, 671),
    ("smplx", "left"): (744, 320, 443, 554, 671),
}
"""Vertices at the tips of thumb, index, middle, ring and pinky in the two libraries."""

WHERE_FROM: Final = (
    "register at https://mano.is.tue.mpg.de, download 'Models & Code' (mano_v1_2.zip) and name the "
    "folder that contains MANO_RIGHT.pkl and MANO_LEFT.pkl"
)

_VERTICES: Final = 778
_LEVELS: Final = tuple([3 * finger + level for finger in range(5)] for level in (1, 2, 3))
_ORDER: Final = list(LAYOUTS["mano"])
_SAME: Final = 1.0  # [m] sum of differences of the two hands' shapes, after smplx's issue 48
_KEYS: Final = (
    "v_template",
    "shapedirs",
    "posedirs",
    "J_regressor",
    "weights",
    "kintree_table",
    "hands_components",
    "hands_mean",
)


@dataclass(frozen=True, eq=False)
class PlacedHand:
    """A hand in a world, frame by frame.

    Attributes:
        landmarks: (T, 21, 3) [m], in the order of ``LANDMARKS``; NaN where a parameter is NaN.
        T_world_wrist: (T, 7) pose of the wrist, with the axes of this project.
    """

    landmarks: Float[np.ndarray, "T 21 3"]
    T_world_wrist: Float[np.ndarray, "T 7"]


@dataclass(frozen=True, eq=False)
class ManoModel:
    """MANO model of one side, reduced to its joints and fingertips.

    Attributes:
        side: side of the hand.
        template: (778, 3) vertices of the mean hand [m].
        shape_directions: (778, 3, 10) motion of the vertices with the shape.
        regressor: (16, 778) joints as means of vertices.
        pose_directions: (778, 3, 135) motion of the vertices with the pose.
        weights: (778, 16) share of each joint in a vertex.
        components: (45, 45) principal components of poses, as rows.
        mean: (45,) the mean pose [rad].
    """

    side: Side
    template: Float[np.ndarray, "778 3"]
    shape_directions: Float[np.ndarray, "778 3 10"]
    regressor: Float[np.ndarray, "16 778"]
    pose_directions: Float[np.ndarray, "778 3 135"]
    weights: Float[np.ndarray, "778 16"]
    components: Float[np.ndarray, "45 45"]
    mean: Float[np.ndarray, "45"]

    @np.errstate(all="ignore")  # impossible numbers become NaN or are refused later
    def rotations(
        self,
        root: Float[np.ndarray, "T 3"],
        pose: Float[np.ndarray, "T n"],
        *,
        pca: bool = False,
        flat_hand_mean: bool,
    ) -> Float[np.ndarray, "T 16 3 3"]:
        """Computes the rotations of the joints relative to their parents.

        Args:
            root: (T, 3) axis times angle of the whole hand [rad].
            pose: (T, 45) axis times angle of the fingers' joints, or (T, n) coefficients.
            pca: whether ``pose`` has coefficients of the first n principal components.
            flat_hand_mean: whether zeros mean the flat hand; if not, the mean pose is added.
        """
        full = pose @ self.components[: pose.shape[1]] if pca else pose
        full = full if flat_hand_mean else full + self.mean
        return from_axis_angle(np.concatenate([root, full], axis=1).reshape(-1, 16, 3))

    @np.errstate(all="ignore")
    def place(
        self,
        rotations: Float[np.ndarray, "T 16 3 3"],
        betas: ArrayLike,
        translation: Float[np.ndarray, "T 3"],
        *,
        moves: Literal["model", "wrist"] = "model",
        tips: Tips = "smplx",
        template: Float[np.ndarray, "778 3"] | None = None,
    ) -> PlacedHand:
        """Computes landmarks and wrists.

        Args:
            rotations: rotations of the joints relative to their parents; the root's in the world.
            betas: (10,) shape, or (T, 10) if it differs between frames.
            translation: (T, 3) translation [m].
            moves: what the translation moves: the model's origin, as in smplx and manopth, or the
                wrist joint, as with ``center_idx=0`` of manopth.
            tips: library of the fingertips.
            template: (778, 3) vertices of a measured hand, in place of the mean hand.
        """
        ids = list(TIPS[tips, self.side])
        shape = np.asarray(betas, np.float64).reshape(-1, 10)
        mean = self.template if template is None else template
        directions = np.einsum("jv,vkb->jkb", self.regressor, self.shape_directions)
        joints = self.regressor @ mean + np.einsum("jkb,tb->tjk", directions, shape)
        rest = mean[ids] + np.einsum("vkb,tb->tvk", self.shape_directions[ids], shape)
        bent = (rotations[:, 1:] - np.eye(3)).reshape(-1, 135)
        rest = rest + (bent @ self.pose_directions[ids].reshape(15, 135).T).reshape(-1, 5, 3)

        turned, moved = _chain(rotations, joints)
        points = np.zeros((len(rotations), 21, 3))
        points[:, :16] = moved
        for tip, joint in np.argwhere(self.weights[ids] > 0):
            carried = (turned[:, joint] @ (rest[:, tip] - joints[:, joint])[..., None])[..., 0]
            points[:, 16 + tip] += self.weights[ids[tip], joint] * (moved[:, joint] + carried)
        origin = moved[:, :1] if moves == "wrist" else 0.0
        landmarks = (points - origin + translation[:, None])[:, _ORDER]
        # The bases of the fingers do not move in the hand, so the axes turn with the root.
        still = np.zeros((len(joints), 21, 3))
        still[:, :16] = joints
        axes = poses.wrist_from_landmarks(still[:, _ORDER], self.side)
        wrist = turned[:, 0] @ poses.rotation_matrices(axes[:, 3:])
        pose = np.concatenate([landmarks[:, 0], _quaternions(wrist)], axis=1)
        pose[~np.isfinite(pose).all(axis=1)] = np.nan
        return PlacedHand(landmarks, pose)


def _chain(
    rotations: Float[np.ndarray, "T 16 3 3"], joints: Float[np.ndarray, "n 16 3"]
) -> tuple[Float[np.ndarray, "T 16 3 3"], Float[np.ndarray, "T 16 3"]]:
    """Rotations and positions of the joints in the world, level by level."""
    turned = np.array(rotations)
    moved = np.empty((len(rotations), 16, 3))
    moved[:, 0] = joints[:, 0]
    for level in _LEVELS:
        above = [PARENTS[joint] for joint in level]
        turned[:, level] = turned[:, above] @ rotations[:, level]
        bone = joints[:, level] - joints[:, above]
        moved[:, level] = moved[:, above] + (turned[:, above] @ bone[..., None])[..., 0]
    return turned, moved


@np.errstate(all="ignore")
def from_axis_angle(vectors: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 3 3"]:
    """Rotation matrices of axis times angle [rad], by Rodrigues' formula."""
    angle = np.linalg.norm(vectors, axis=-1)
    sine = np.sinc(angle / np.pi)  # sin(a) / a, and 1 at 0
    half = 0.5 * np.sinc(angle / (2.0 * np.pi)) ** 2  # (1 - cos(a)) / a^2
    x, y, z = np.moveaxis(vectors, -1, 0)
    cross = np.zeros((*angle.shape, 3, 3))
    cross[..., 0, 1], cross[..., 0, 2], cross[..., 1, 2] = -z, y, -x
    cross[..., 1, 0], cross[..., 2, 0], cross[..., 2, 1] = z, -y, x
    square = half[..., None, None] * (cross @ cross)
    turn: np.ndarray = np.eye(3) + sine[..., None, None] * cross + square
    return turn


def _quaternions(rotation: Float[np.ndarray, "T 3 3"]) -> Float[np.ndarray, "T 4"]:
    finite = np.isfinite(rotation).all(axis=(1, 2))
    result = np.full((len(rotation), 4), np.nan)
    result[finite] = poses.quaternions(rotation[finite])
    return result


def model_path(folder: Path | None, side: Side) -> Path:
    """Path of the user's model file for a side.

    Raises:
        RecordingError: there is no such file; the message says where to get it.
    """
    name = f"MANO_{side.upper()}"
    if folder is None:
        raise RecordingError(
            f"hands given by MANO parameters need {name}.pkl, which may not be redistributed: "
            f"{WHERE_FROM}, with --mano FOLDER (in Python: ReadingOptions(mano=...))"
        )
    places = [folder / inner for inner in ("", "models", "mano", "mano/models")]
    for place in places:
        for suffix in (".pkl", ".npz"):
            if (place / f"{name}{suffix}").is_file():
                return place / f"{name}{suffix}"
    raise RecordingError(f"{folder}: it contains no {name}.pkl or {name}.npz; {WHERE_FROM}")


def load_model(folder: Path | None, side: Side, *, mirrored_shape: bool = False) -> ManoModel:
    """Loads the model of a side from the user's file.

    Args:
        folder: folder with ``MANO_RIGHT.pkl`` and ``MANO_LEFT.pkl``, or the same as ``.npz``.
        side: side of the hand.
        mirrored_shape: True if the left hand's shape directions are the mirror image of the right
            one's. In the published file, their x is that of the right hand
            (https://github.com/vchoutas/smplx/issues/48). Parameters that were fitted to that file
            need it unchanged; those of data sets that corrected it, as HOT3D, need it corrected.

    Raises:
        RecordingError: there is no file, or it is not a model of MANO.
    """
    path = model_path(folder, side)
    model = _loaded(path, side, path.stat().st_mtime_ns)
    if not mirrored_shape or side == "right":
        return model
    right = load_model(folder, "right")
    x = model.shape_directions[:, 0]
    if float(np.abs(x - right.shape_directions[:, 0]).sum()) >= _SAME:
        return model
    mirrored = model.shape_directions * np.array([-1.0, 1.0, 1.0])[:, None]
    return replace(model, shape_directions=mirrored)


@functools.lru_cache(maxsize=8)
def _loaded(path: Path, side: Side, changed: int) -> ManoModel:
    where = f"{path} (a model of MANO)"
    held: dict[Any, Any] = table(load_restricted(path), where, _KEYS)

    def part(name: str, *shape: int | None) -> np.ndarray:
        return array(held[name], f"{where}, {name!r}", shape, finite=True)

    shapes = part("shapedirs", _VERTICES, 3, None)
    tree = part("kintree_table", 2, 16)
    if shapes.shape[2] < 10:
        raise RecordingError(f"{where}: its shape has {shapes.shape[2]} directions, not 10")
    if tuple(int(n) for n in tree[0][1:]) != PARENTS[1:]:
        raise RecordingError(f"{where}: its joints are not connected as in MANO")
    model = ManoModel(
        side,
        part("v_template", _VERTICES, 3),
        shapes[..., :10],
        part("J_regressor", 16, _VERTICES),
        part("posedirs", _VERTICES, 3, 135),
        part("weights", _VERTICES, 16),
        part("hands_components", 45, 45),
        part("hands_mean", 45),
    )
    _check(model, where)
    return model


def _check(model: ManoModel, where: str) -> None:
    """Raises RecordingError if a hand's shape is not in metres or belongs to the other side."""
    joints = model.regressor @ model.template
    palm = float(np.linalg.norm(joints[4] - joints[0]))
    if not 0.05 < palm < 0.14:
        raise RecordingError(
            f"{where}: the distance from the wrist to the middle finger's base is {palm:.4g}, but "
            "a hand in metres has 0.05 to 0.14"
        )
    sums = np.abs(model.weights.sum(axis=1) - 1.0).max()
    if sums > 1e-3 or model.weights.min() < -1e-6:
        raise RecordingError(f"{where}: the weights of a vertex do not add up to one")
    # In the published files the right hand's fingers point to -x, the left one's to x.
    side: Side = "right" if joints[4, 0] < joints[0, 0] else "left"
    if side != model.side:
        raise RecordingError(
            f"{where}: judging by its shape, it is a {side} hand; were the two files exchanged?"
        )
