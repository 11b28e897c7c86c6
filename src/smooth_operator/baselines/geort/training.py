"""GeoRT's losses and training. Each epoch is one compiled program, and the training state is
explicit.

It needs no pairs of human and robot poses (Yin et al., "Geometric Retargeting"). The arrays of the
losses have the batch last, as the unrolled kinematics does."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from smooth_operator.atomic_files import atomic_write
from smooth_operator.baselines.geort.method import (
    HIDDEN,
    GeortModel,
    Weights,
    finger_joints,
    forward,
)
from smooth_operator.baselines.geort.model_writer import recognition, write_geort_model
from smooth_operator.baselines.geort.training_data import (
    BEND,
    STEP_RANGE,
    GeortTraining,
    PointSet,
    TrainingData,
)
from smooth_operator.errors import (
    ConfigError,
    OutputError,
    RecordingError,
    SmoothOperatorError,
    require,
)
from smooth_operator.formats.arrays import open_arrays
from smooth_operator.formats.csv_table import csv_text
from smooth_operator.formats.environment import environment
from smooth_operator.hands.hand import Hand
from smooth_operator.io.documents import parse_json
from smooth_operator.io.jsonable import to_json

require("training GeoRT", "training", "optax")

_FLOOR: Final = 1e-6  # motion below which a robot tip has no direction, as at a limit [m]

LOSSES: Final = ("direction", "coverage", "curvature", "pinch")
"""Names of the losses, in the order in which they are recorded, without weights."""


class Batch(NamedTuple):
    """Batch of one training step.

    Attributes:
        points: (F, 3, B) human fingertips, drawn for each finger separately [m]; for coverage.
        around: (F, 3, B) positions at or near them [m]; for direction and curvature.
        steps: (F, 3, B) human steps from these positions [m].
        reach: (F, 3, R) reachable robot fingertips [m].
        pinches: (F, 3, P) human fingertips of P frames [m].
        pinched: (F - 1, P) True for fingers that pinch with the thumb.
    """

    points: Float[Array, "F 3 B"]
    around: Float[Array, "F 3 B"]
    steps: Float[Array, "F 3 B"]
    reach: Float[Array, "F 3 R"]
    pinches: Float[Array, "F 3 P"]
    pinched: Bool[Array, "f P"]


@dataclass(frozen=True, eq=False)
class GeortLoss:
    """GeoRT's training losses for one hand.

    Attributes:
        hand: the robot hand.
        settings: weights of the losses.
        centre: (F, 3) centres of the normalised fingertips [m].
        scale: (F,) scales of the normalised fingertips [m].
    """

    hand: Hand
    settings: GeortTraining
    centre: Float[np.ndarray, "F 3"]
    scale: Float[np.ndarray, " F"]

    @cached_property
    def _joints(self) -> tuple[tuple[int, ...], ...]:
        return finger_joints(self.hand)

    def tips(self, weights: Weights, points: Float[Array, "F 3 N"]) -> Float[Array, "F 3 N"]:
        """Robot fingertips [m] to which the networks map human fingertips."""
        hand = self.hand
        inputs = (points - self.centre[:, :, None]) / self.scale[:, None, None]
        unit = forward(weights, inputs.astype(jnp.float32))
        rows = [jnp.full_like(unit[0, 0], value) for value in hand.neutral]
        for finger, joints in enumerate(self._joints):
            for output, joint in enumerate(joints):
                low, high = (float(limit) for limit in hand.limits[joint])
                rows[joint] = (low + high) / 2 + (high - low) / 2 * unit[finger, output]
        placed = hand.tree.forward_kinematics(
            hand.full_configuration_rows(rows), hand.tip_names, within_limits=True
        )
        like = unit[0, 0]
        return jnp.stack(
            [jnp.stack([jnp.broadcast_to(c, like.shape) for c in point]) for point in placed]
        ).astype(like.dtype)

    def __call__(
        self, weights: Weights, batch: Batch, ramp: Array | float = 1.0
    ) -> tuple[Array, Float[Array, "4"]]:
        """The losses of a batch.

        Args:
            ramp: factor on the weight of coverage.

        Returns:
            the weighted sum, and the losses in the order of ``LOSSES``.
        """
        bend = batch.steps * (BEND / _length(batch.steps))
        # one pass through the networks for all points
        terms = [
            batch.points,
            batch.around,
            batch.around + batch.steps,
            batch.around + bend,
            batch.around - bend,
            batch.pinches,
        ]
        cuts = list(np.cumsum([part.shape[-1] for part in terms])[:-1])
        covering, at, moved, ahead, behind, pinching = jnp.split(
            self.tips(weights, jnp.concatenate(terms, axis=-1)), cuts, axis=-1
        )
        losses = (
            _direction(batch.steps, moved - at),
            _coverage(covering, batch.reach),
            jnp.mean(jnp.sum((ahead + behind - 2 * at) ** 2, axis=1)) / BEND**2,
            _pinch(pinching, batch.pinched),
        )
        settings = self.settings
        total = (
            settings.direction * losses[0]
            + settings.coverage * ramp * losses[1]
            + settings.curvature * losses[2]
            + settings.pinch * losses[3]
        )
        return total, jnp.stack(losses)


def _length(vectors: Float[Array, "F 3 N"]) -> Float[Array, "F 1 N"]:
    return jnp.sqrt(jnp.sum(vectors**2, axis=1, keepdims=True) + _FLOOR**2)


def _direction(human: Float[Array, "F 3 B"], robot: Float[Array, "F 3 B"]) -> Array:
    """Mean of one minus the cosine between human and robot step."""
    cosine = jnp.sum(human * robot, axis=1) / (_length(human) * _length(robot))[:, 0]
    return 1 - jnp.mean(cosine)


def _coverage(robot: Float[Array, "F 3 B"], reach: Float[Array, "F 3 R"]) -> Array:
    """Chamfer distance in both directions [m^2], summed over the fingers. The choice of the nearest
    point has no derivative."""
    total = jnp.zeros((), robot.dtype)
    for tips, goals in zip(robot, reach, strict=True):
        still = lax.stop_gradient(tips)
        product = still.T @ goals
        squares = jnp.sum(goals**2, axis=0)[None] - 2 * product
        nearest_goal = jnp.argmin(squares, axis=1)
        nearest_tip = jnp.argmin(jnp.sum(still**2, axis=0)[:, None] - 2 * product, axis=0)
        out = jnp.sum((tips - goals[:, nearest_goal]) ** 2, axis=0)
        back = jnp.sum((goals - tips[:, nearest_tip]) ** 2, axis=0)
        total = total + jnp.mean(out) + jnp.mean(back)
    return total


def _pinch(tips: Float[Array, "F 3 P"], pinched: Bool[Array, "f P"]) -> Array:
    """Mean squared distance between thumb tip and fingertip in the pinches [m^2]."""
    gaps = jnp.sum((tips[1:] - tips[:1]) ** 2, axis=1)
    return jnp.sum(jnp.where(pinched, gaps, 0)) / jnp.maximum(jnp.sum(pinched), 1)


_START = 0.8  # largest initial position of a joint, relative to half of its range
_BATCHES, _VALIDATION = 0xBA, 0x5E  # different random numbers for the two


class TrainingState(NamedTuple):
    """State of a training run, as a pytree of arrays. Random numbers are a function of the seed
    and ``epoch``.

    Attributes:
        weights: weights of the networks.
        optimiser: AdamW's moments and count.
        epoch: number of finished epochs.
        train: (epochs, 5) mean losses of each epoch: the weighted sum (with the coverage weight of
            that epoch), then ``LOSSES``; NaN for later epochs.
        validation: (epochs, 5) losses of the validation data after each epoch, with the full weight
            of coverage; NaN without such data.
    """

    weights: Weights
    optimiser: Any
    epoch: Int[Array, ""]
    train: Float[Array, "E 5"]
    validation: Float[Array, "E 5"]


@dataclass(frozen=True, eq=False)
class GeortTrainer:
    """Trains GeoRT for one hand on one set of data.

    Attributes:
        hand: the robot hand.
        data: result of ``training_data``.
        settings: settings of the training.
    """

    hand: Hand
    data: TrainingData
    settings: GeortTraining

    def init(self) -> TrainingState:
        """The state before the first epoch."""
        rng = np.random.default_rng([self.settings.seed, 0x3C])
        fingers = len(self.hand.fingers)
        outputs = max(len(joints) for joints in finger_joints(self.hand))

        def dense(inputs: int, width: int, gain: float = 1.0) -> tuple[Array, Array]:
            drawn = rng.normal(0.0, gain / np.sqrt(inputs), (fingers, inputs, width))
            return jnp.asarray(drawn, jnp.float32), jnp.zeros((fingers, width), jnp.float32)

        # The hand starts near its neutral pose, where every joint can move in both directions.
        layers = (*dense(3, HIDDEN, 1.5), *dense(HIDDEN, HIDDEN, 1.5), *dense(HIDDEN, outputs, 0.3))
        low, high = self.hand.limits.T
        unit = np.clip((2 * self.hand.neutral - low - high) / (high - low), -_START, _START)
        start = np.zeros((fingers, outputs))
        for row, joints in zip(start, finger_joints(self.hand), strict=True):
            row[: len(joints)] = np.arctanh(unit[list(joints)])
        weights = Weights(*layers)._replace(b3=jnp.asarray(start, jnp.float32))
        curves = jnp.full((self.settings.epochs, 1 + len(LOSSES)), jnp.nan, jnp.float32)
        return TrainingState(
            weights, self._optimiser.init(weights), jnp.zeros((), jnp.int32), curves, curves
        )

    @property
    def steps(self) -> int:
        """Number of optimiser steps in an epoch."""
        return -(-int(self.data.train.counts.max()) // self.settings.batch)

    def epochs(self, state: TrainingState) -> Iterator[TrainingState]:
        """Yields the state after each remaining epoch. Raises SmoothOperatorError if the losses are
        not finite."""
        for epoch in range(int(state.epoch), self.settings.epochs):
            data = self.data
            batches = draw_batches(
                data.train, data.reach, self.settings, self.steps, _BATCHES, epoch
            )
            weights, optimiser, train, validation = self._program(
                state.weights, state.optimiser, jnp.int32(epoch), batches, self._judging
            )
            train.block_until_ready()
            if not np.isfinite(np.asarray(train)).all():
                raise SmoothOperatorError(
                    f"training diverged in epoch {epoch + 1}: the losses are "
                    f"{train.tolist()}; try a learning rate below "
                    f"{self.settings.learning_rate:g}, or check the recording for outliers "
                    "among the landmarks"
                )
            state = TrainingState(
                weights,
                optimiser,
                jnp.int32(epoch + 1),
                state.train.at[epoch].set(train),
                state.validation.at[epoch].set(validation),
            )
            yield state

    def model(self, state: TrainingState, **about: Any) -> GeortModel:
        """Returns the networks of a state as a model.

        Args:
            state: the state after an epoch.
            about: further entries for the model's file.
        """
        hand, epoch = self.hand, int(state.epoch)
        own = finger_joints(hand)
        poses, tips = recognition(hand)
        curves = {}
        for name, curve in (("train", state.train), ("validation", state.validation)):
            last = np.asarray(curve)[epoch - 1] if epoch else np.full(1 + len(LOSSES), np.nan)
            curves[name] = dict(zip(("loss", *LOSSES), map(float, last), strict=True))
        training = {
            "settings": self.settings,
            "epochs_done": epoch,
            "steps": epoch * self.steps,
            "recordings": self.data.sources,
            "frames": self.data.frames,
            "points": self.data.train.counts,
            "pinch_frames": self.data.train.pinched.shape[-1],
            "data": self.data.digest,
            "losses": curves,
            **about,
        }
        return GeortModel(
            state.weights,
            self._loss.centre,
            self._loss.scale,
            hand.name,
            hand.spec.side,
            hand.fingers,
            tuple(tuple(hand.actuated_names[j] for j in joints) for joints in own),
            tuple(hand.limits[list(joints)] for joints in own),
            poses,
            tips,
            training,
        )

    @cached_property
    def _loss(self) -> GeortLoss:
        train = self.data.train
        own = [row[:, :count] for row, count in zip(train.points, train.counts, strict=True)]
        low = np.stack([points.min(axis=1) for points in own]).astype(float)
        high = np.stack([points.max(axis=1) for points in own]).astype(float)
        # one scale for all three axes, so that lengths compare in all directions
        return GeortLoss(
            self.hand, self.settings, (low + high) / 2, (high - low).max(axis=1).clip(1e-3) / 2
        )

    @cached_property
    def _optimiser(self) -> Any:
        import optax

        settings = self.settings
        total = self.steps * settings.epochs
        rate = optax.warmup_cosine_decay_schedule(
            0.0, settings.learning_rate, min(50, total // 4), max(total, 1)
        )
        return optax.adamw(rate, weight_decay=settings.weight_decay)

    @cached_property
    def _judging(self) -> Batch | None:
        """Validation batch. It is the same after every epoch, so that the losses compare."""
        data = self.data
        if data.validation is None:
            return None
        drawn = draw_batches(data.validation, data.reach, self.settings, 1, _VALIDATION, 0)
        return Batch(*(part[0] for part in drawn))

    @cached_property
    def _program(self) -> Any:
        return jax.jit(self._epoch)

    def _epoch(
        self, weights: Weights, optimiser: Any, epoch: Array, batches: Batch, judging: Batch | None
    ) -> tuple[Weights, Any, Array, Array]:
        rising = self.settings.ramp * self.settings.epochs
        ramp = jnp.clip(epoch / max(rising, 1), 0, 1) ** 2 if rising else 1.0

        def step(carry: tuple[Weights, Any], batch: Batch) -> tuple[tuple[Weights, Any], Array]:
            weights, optimiser = carry
            (total, losses), slope = jax.value_and_grad(self._loss, has_aux=True)(
                weights, batch, ramp
            )
            change, optimiser = self._optimiser.update(slope, optimiser, weights)
            weights = jax.tree.map(jnp.add, weights, change)
            return (weights, optimiser), jnp.concatenate([total[None], losses])

        (weights, optimiser), losses = lax.scan(step, (weights, optimiser), batches)
        if judging is None:
            judged = jnp.full_like(losses[0], jnp.nan)
        else:
            total, each = self._loss(weights, judging)
            judged = jnp.concatenate([total[None], each])
        return weights, optimiser, losses.mean(axis=0), judged


PINCHES: Final = 256
"""Frames with a pinch in a step."""


def draw_batches(
    points: PointSet,
    reach: Float[np.ndarray, "F 3 R"],
    settings: GeortTraining,
    steps: int,
    *words: int,
) -> Batch:
    """Draws batches, stacked along a new first axis. Points are drawn for each finger separately,
    with replacement; a pinch is drawn with all fingers.

    Args:
        points: points to draw from.
        reach: reachable fingertips of the robot.
        settings: number and spread of the points.
        steps: number of batches.
        words: numbers that determine the draw, together with the seed.
    """
    rng = np.random.default_rng([settings.seed, *words])
    fingers = len(points.counts)

    def drawn(pool: np.ndarray, at: np.ndarray) -> np.ndarray:
        """(S, F, 3, B) entries of (F, 3, N) at the indices (S, F, B)."""
        return np.take_along_axis(pool[None], at[:, :, None], axis=-1)

    at = rng.integers(0, points.counts[:, None], (steps, fingers, settings.batch))
    base = drawn(points.points, at)
    direction = rng.standard_normal(base.shape, np.float32)
    direction /= np.linalg.norm(direction, axis=2, keepdims=True) + 1e-6
    length = rng.uniform(*STEP_RANGE, (steps, fingers, 1, settings.batch))
    around = settings.surround * rng.standard_normal(base.shape, np.float32)
    # the same random poses for all fingers
    covered = rng.integers(0, reach.shape[-1], (steps, 1, settings.reach))
    pinches, pinched = points.pinches, points.pinched
    if not pinched.shape[-1]:  # a placeholder without a pinch
        pinches, pinched = points.points[:, :, :1], np.zeros((len(pinched), 1), bool)
    moments = rng.integers(0, pinched.shape[-1], (steps, PINCHES))
    arrays = (
        base,
        (base + around).astype(np.float32),
        (direction * length).astype(np.float32),
        drawn(reach, np.repeat(covered, fingers, axis=1)),
        np.moveaxis(pinches[:, :, moments], 2, 0),
        np.moveaxis(pinched[:, moments], 1, 0),
    )
    return Batch(*(jnp.asarray(array) for array in arrays))


CHECKPOINT: Final = "checkpoint.npz"
MODEL: Final = "model.npz"
ABOUT: Final = "model.json"
CURVES: Final = "losses.csv"


@dataclass(frozen=True, eq=False)
class TrainingSession:
    """Trains a model and writes it to a folder.

    The folder gets ``checkpoint.npz``, ``model.npz`` (the current networks, ready to use),
    ``model.json`` (settings and results of the training, which are also in the model), and
    ``losses.csv``. Files are written atomically. On one machine, a training that was interrupted
    and resumed gives the same bytes as an uninterrupted one.

    Attributes:
        trainer: trainer of the model.
        folder: an existing folder.
        every: number of epochs between checkpoints.
    """

    trainer: GeortTrainer
    folder: Path
    every: int = 10

    def run(
        self, *, resume: bool = False, watch: Callable[[TrainingState], None] | None = None
    ) -> GeortModel:
        """Trains to the last epoch, and returns the model that was written.

        Args:
            resume: True to continue from the folder's checkpoint.
            watch: called with the state before the first epoch and after each.

        Raises:
            ConfigError: there is no checkpoint to resume, or it belongs to another training.
            OutputError: the folder contains a training that is not resumed, or a file can't be
                written.
            KeyboardInterrupt: interrupted, after the last finished epoch was saved.
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
                f"{self.folder}: the folder already contains a training: continue it with "
                "--resume, or name another folder"
            )
        existing = [n for n in (MODEL, ABOUT, CURVES) if (self.folder / n).exists()]
        if existing:
            raise OutputError(
                f"{self.folder}: {', '.join(existing)} would be overwritten; name another folder"
            )
        return self.trainer.init()

    def _save(self, state: TrainingState) -> GeortModel:
        # no date, so that equal trainings give equal bytes
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
    """Writes the losses of all finished epochs as CSV: epoch, then train_ and validation_ columns;
    OutputError if the file can't be written."""
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
    """Writes the state of a training, from which it can be resumed; OutputError if the file can't
    be written."""
    leaves = {f"leaf_{i:03d}": np.asarray(leaf) for i, leaf in enumerate(jax.tree.leaves(state))}
    with atomic_write(path) as file:
        np.savez(file, allow_pickle=False, about=np.array(to_json(_identity(trainer))), **leaves)


def read_checkpoint(path: Path, trainer: GeortTrainer) -> TrainingState:
    """Reads a file that ``write_checkpoint`` wrote for the same training. Raises ConfigError if the
    file does not exist, is damaged, or belongs to another hand, other data or other settings; the
    message names the differences."""
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
            f"{path}: this checkpoint is of another training: {'; '.join(different)}. Resume "
            "it with the settings of its start, or train into another folder"
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
    """Describes each difference between two JSON values."""
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
