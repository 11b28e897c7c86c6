"""GeoRT: trained networks from fingertips to joint positions (Yin et al., "Geometric Retargeting").

This module contains the method and the file format of its networks; ``training`` trains them.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar, Final, NamedTuple, NoReturn

import jax.numpy as jnp
import numpy as np
from jax import nn
from jaxtyping import Array, Float, UInt32

from smooth_operator.errors import ConfigError, HandModelError, brief, reason
from smooth_operator.hands.hand import Hand
from smooth_operator.landmarks import WRIST
from smooth_operator.retargeting.alignment import AlignmentConfig
from smooth_operator.retargeting.method import Method, MethodConfig, MethodOutput
from smooth_operator.retargeting.objective import FrameGoal
from smooth_operator.retargeting.sbr.published import ObjectiveConfig, PlainTargets
from smooth_operator.retargeting.sbr.sampled import SampledObjective
from smooth_operator.retargeting.targets import tips_of
from smooth_operator.types import as_side

_MODELS: Final = Path(__file__).parent / "models"


@dataclass(frozen=True)
class GeortConfig(MethodConfig):
    """Settings of GeoRT.

    Attributes:
        alignment: alignment of human landmarks to the palm frame, as in training.
        model: file from ``write_geort_model``; None for the built-in model of the hand.
    """

    shareable: ClassVar[bool] = False  # the file of a model may change, and has one side

    alignment: AlignmentConfig = field(default_factory=AlignmentConfig)
    model: Path | None = None

    def build(self, hand: Hand) -> Geort:
        """Builds the method for one hand. Raises ConfigError if there is no model for the hand."""
        path = built_in_model(hand.name) if self.model is None else Path(self.model)
        if path is None:
            names_built_in = ", ".join(
                sorted(file.stem.removeprefix("geort_") for file in _built_in())
            )
            raise ConfigError(
                f"there is no built-in GeoRT model for hand {hand.name!r} (there is one for: "
                f"{names_built_in or 'none'}); train one: {training_command(hand)}"
            )
        model = read_geort_model(path)
        return Geort(hand, self, model, model.mirrored_for(hand))

    def with_file(self, path: Path) -> GeortConfig:
        """Returns these settings with another model file."""
        return replace(self, model=path)


def built_in_model(hand: str) -> Path | None:
    """File of the built-in model for a hand, by its name; None if the hand has no model."""
    path = _MODELS / f"geort_{hand}.npz"
    return path if path in _built_in() else None


def _built_in() -> list[Path]:
    return sorted(_MODELS.glob("geort_*.npz"))


class GeortState(NamedTuple):
    """State of GeoRT, which is empty because GeoRT maps fingertips to joints without memory."""


@dataclass(frozen=True, eq=False)
class Geort(Method):
    """GeoRT for one hand.

    Attributes:
        hand: the robot hand.
        config: its settings.
        model: the networks.
        mirrored: True if the hand is the mirror image of the hand in training. The inputs are then
            reflected at x = 0 of the palm frame.
    """

    hand: Hand
    config: GeortConfig
    model: GeortModel
    mirrored: bool

    @cached_property
    def objective(self) -> SampledObjective:
        """Objective of the Smooth Operator paper, Eq. (1), without latches; used only to compute
        the tracking loss."""
        return SampledObjective(self.hand, ObjectiveConfig(targets=PlainTargets()))

    @property
    def needs(self) -> tuple[int, ...]:
        """Indices of the fingertips, and of the wrist for the tracking loss."""
        return (WRIST, *tips_of(self.hand.fingers))

    @property
    def constants(self) -> Any:
        """The networks, as loaded from the model file."""
        return self.model.weights, self.model.centre, self.model.scale, self.mirrored

    def init(self, seed: int) -> GeortState:
        """Empty state; the seed is not used."""
        del seed
        return GeortState()

    def step(
        self, state: GeortState, aligned: Float[Array, "21 3"], ticks: UInt32[Array, ""]
    ) -> tuple[GeortState, MethodOutput]:
        """Computes one frame; see ``Method.step``."""
        del ticks
        layout, model = self.objective.layout, self.model
        tips = aligned[np.array(tips_of(self.hand.fingers))]
        flip = np.array([-1.0 if self.mirrored else 1.0, 1.0, 1.0])
        centre, scale = model.centre * flip, model.scale[:, None]
        inputs = ((tips - centre) / scale * flip).astype(jnp.float32)
        unit = forward(model.weights, inputs)
        q = jnp.asarray(self.hand.neutral, jnp.float32)
        fingers, outputs, joints = self._wiring
        low, high = self.hand.limits[joints].T.astype(np.float32)
        q = q.at[joints].set((low + high) / 2 + (high - low) / 2 * unit[fingers, outputs])

        human = layout.human(aligned)
        weights = jnp.ones(len(layout.vectors), human.dtype)
        goal = FrameGoal(human, weights, q, 0.0)
        return state, MethodOutput(q, self.objective.tracking(list(q), goal))

    @cached_property
    def _wiring(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(finger, output of its network, actuated joint), one column each."""
        columns = [
            (finger, output, joint)
            for finger, joints in enumerate(finger_joints(self.hand))
            for output, joint in enumerate(joints)
        ]
        fingers, outputs, joints = np.array(columns).T
        return fingers, outputs, joints


GEORT_PRESETS: Final = {"default": GeortConfig()}


FORMAT: Final = "smooth-operator geort"
VERSION: Final = 1
HIDDEN: Final = 128
"""Width of both hidden layers, as published."""

_MOST_BYTES: Final = 64_000_000  # of an unpacked model; the built-in one has 0.4 MB
_SAME_PLACE: Final = 1e-5  # [m]; a tip that is further off belongs to another hand
_SAME_ANGLE: Final = 1e-5  # [rad]
_MIRROR: Final = np.array([-1.0, 1.0, 1.0])  # the mirrored side's palm frame


class Weights(NamedTuple):
    """Weights of F networks: 3 inputs, two hidden layers, J outputs. A finger with fewer than J
    joints does not use its last outputs."""

    w1: Float[Array, "F 3 H"]
    b1: Float[Array, "F H"]
    w2: Float[Array, "F H H"]
    b2: Float[Array, "F H"]
    w3: Float[Array, "F H J"]
    b3: Float[Array, "F J"]


def forward(weights: Weights, inputs: Float[Array, "F 3 *batch"]) -> Float[Array, "F J *batch"]:
    """Evaluates the networks for normalised fingertips. Returns joint positions, scaled so that the
    limits are -1 and 1. The hidden layers are smooth (SiLU), because the robot would follow a kink.
    """

    def layer(w: Array, b: Array, x: Array) -> Array:
        bias = b.reshape(*b.shape, *[1] * (x.ndim - 2))
        return jnp.einsum("fio,fi...->fo...", w, x) + bias

    hidden = nn.silu(layer(weights.w1, weights.b1, inputs))
    hidden = nn.silu(layer(weights.w2, weights.b2, hidden))
    return jnp.tanh(layer(weights.w3, weights.b3, hidden))


def finger_joints(hand: Hand) -> tuple[tuple[int, ...], ...]:
    """Indices of the actuated joints that move a single fingertip, per finger, thumb first. Joints
    that move several fingertips, such as a common spread joint, have no network and stay at
    neutral. Raises HandModelError if a finger has no joint of its own."""
    matrix = hand.transmission.matrix
    moves = np.zeros((len(hand.fingers), len(hand.actuated)), bool)
    for row, name in zip(moves, hand.tip_names, strict=True):
        at = hand.tree.keypoints[name].joint
        while at >= 0:
            row |= matrix[hand.tree.joints[at].source] != 0
            at = hand.tree.joints[at].parent
    own = moves & (moves.sum(axis=0) == 1)
    for finger, row in zip(hand.fingers, own, strict=True):
        if not row.any():
            raise HandModelError(
                f"GeoRT can't serve hand {hand.name!r}: no joint moves only its {finger} "
                "tip, but each finger needs its own network; use another method, such as sbr"
            )
    return tuple(tuple(int(i) for i in np.flatnonzero(row)) for row in own)


@dataclass(frozen=True, eq=False)
class GeortModel:
    """Trained networks, and the hand that they were trained for.

    Attributes:
        weights: weights of the networks, float32.
        centre: (F, 3) centre of each fingertip [m]; the input of a network is (p - centre) / scale.
        scale: (F,) scale of each fingertip [m].
        hand: name of the hand.
        side: side of the hand.
        fingers: (F,) human finger names, thumb first.
        joints: per finger, names of the joints that its network commands.
        limits: per finger, (j, 2) limits of those joints [rad].
        poses: (k, m) positions of all actuated joints [rad], to recognise the hand.
        tips: (k, F, 3) fingertips in these poses [m].
        training: settings and results of the training, in JSON types.
    """

    weights: Weights
    centre: Float[np.ndarray, "F 3"]
    scale: Float[np.ndarray, " F"]
    hand: str
    side: str
    fingers: tuple[str, ...]
    joints: tuple[tuple[str, ...], ...]
    limits: tuple[Float[np.ndarray, "j 2"], ...]
    poses: Float[np.ndarray, "k m"]
    tips: Float[np.ndarray, "k F 3"]
    training: Mapping[str, Any]

    def mirrored_for(self, hand: Hand) -> bool:
        """Returns True if a hand is the mirror image of the hand that the model was trained for,
        and False if it is the same hand. Raises ConfigError if it is another hand."""
        own = finger_joints(hand)
        mirrored = self.side != hand.spec.side

        def refuse(difference: str) -> NoReturn:
            raise ConfigError(
                f"the GeoRT model was trained for the {self.side} hand {self.hand!r}{difference}; "
                f"train one for it: {training_command(hand)}"
            )

        def compare(what: str, trained: object, found: object) -> None:
            if trained != found:
                refuse(f" with {what} {trained}, but {hand.name!r} has {found}")

        compare("the fingers", self.fingers, hand.fingers)
        compare("a number of actuated joints of", self.poses.shape[1], len(hand.actuated))
        for finger, names, limits, joints in zip(
            self.fingers, self.joints, self.limits, own, strict=True
        ):
            driven, found = [hand.actuated_names[j] for j in joints], hand.limits[list(joints)]
            compare(f"the {finger} joints", list(names), driven)
            if np.abs(limits - found).max() > _SAME_ANGLE:
                compare(f"{finger} limits [rad] of", limits.tolist(), found.tolist())
        tips = self.tips * _MIRROR if mirrored else self.tips
        away = float(np.abs(hand.tips(hand.full_configuration(self.poses)) - tips).max())
        if away > _SAME_PLACE:
            refuse(
                f"; the {hand.spec.side} hand {hand.name!r} does not match "
                f"{'the mirror image of ' if mirrored else ''}it: at equal joint positions its "
                f"fingertips are up to {away * 1e3:.3g} mm off"
            )
        return mirrored


def training_command(hand: Hand) -> str:
    """The command that trains a model for a hand."""
    return (
        f"smooth-operator train geort RECORDING --hand {hand.name} --side {hand.spec.side} "
        "--output DIR"
    )


def read_geort_model(path: str | Path) -> GeortModel:
    """Reads a model file from ``write_geort_model``, without unpickling; ConfigError if the file
    does not exist, is damaged, or is not a model."""
    path = Path(path)
    expectation = "expected the model.npz that `smooth-operator train geort` writes"
    if not path.is_file():
        raise ConfigError(f"{path}: no such GeoRT model; {expectation}")
    try:
        with np.load(path, allow_pickle=False) as file:
            if sum(part.file_size for part in file.zip.infolist()) > _MOST_BYTES:
                raise ValueError(f"it has more than {_MOST_BYTES} bytes when unpacked")
            return _read(dict(file))
    except Exception as error:  # for damaged files, NumPy and zipfile raise errors of many classes
        what = f"it has no {error}" if isinstance(error, KeyError) else reason(error)
        raise ConfigError(f"{path}: not a GeoRT model ({what}); {expectation}") from error


def _read(arrays: Mapping[str, np.ndarray]) -> GeortModel:
    about = json.loads(arrays["about"].item())
    if (about["format"], about["version"]) != (FORMAT, VERSION):
        raise ValueError(
            f"format {brief(about['format'])} version {brief(about['version'])}, not {FORMAT!r} "
            f"{VERSION}"
        )
    named = tuple(map(str, about["fingers"]))
    joints = tuple(tuple(map(str, names)) for names in about["joints"])
    if len(named) != len(joints) or not joints:
        raise ValueError(f"it has {len(named)} fingers, but joints for {len(joints)}")
    fingers, outputs = len(named), max(map(len, joints))
    (count, actuated), hidden = arrays["poses"].shape, arrays["w2"].shape[-1]
    shapes = {
        "w1": (fingers, 3, hidden),
        "b1": (fingers, hidden),
        "w2": (fingers, hidden, hidden),
        "b2": (fingers, hidden),
        "w3": (fingers, hidden, outputs),
        "b3": (fingers, outputs),
        "centre": (fingers, 3),
        "scale": (fingers,),
        "poses": (count, actuated),
        "tips": (count, fingers, 3),
    }
    values = {name: arrays[name].astype(np.float64) for name in shapes}
    for name, shape in shapes.items():
        if (found := values[name]).shape != shape or not np.isfinite(found).all():
            raise ValueError(f"{name} must be finite and have shape {shape}, it is {found.shape}")
    limits = tuple(np.asarray(pairs, float).reshape(-1, 2) for pairs in about["limits"])
    if [len(names) for names in joints] != [len(pairs) for pairs in limits]:
        raise ValueError("the numbers of joints and limits differ")
    if not all(np.isfinite(pairs).all() for pairs in limits):
        raise ValueError("its limits must be finite numbers")
    return GeortModel(
        Weights(*(jnp.asarray(values[name], jnp.float32) for name in Weights._fields)),
        values["centre"],
        values["scale"],
        str(about["hand"]),
        as_side(about["side"]),
        named,
        joints,
        limits,
        values["poses"],
        values["tips"],
        dict(about["training"]),
    )
