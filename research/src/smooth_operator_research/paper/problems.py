"""A solver's input: the targets of every frame, computed once for all solvers.

The latches of DexPilot's targets hang on the human hand alone, so that targets and weights do not
depend on who solves them; only the start of a frame, the answer to the last one, does.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any, Final

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from smooth_operator.compilation.compiled_program import compiled
from smooth_operator.errors import RecordingError
from smooth_operator.hands.hand import Hand
from smooth_operator.hands.registry import load_hand
from smooth_operator.human.aligned_recording import align_recording
from smooth_operator.human.alignment import AlignmentConfig
from smooth_operator.lab.benchmark.recordings import Source
from smooth_operator.landmarks import LANDMARKS
from smooth_operator.objective.loss import Objective, ObjectiveConfig
from smooth_operator.objective.targets import Targets
from smooth_operator.objective.terms import FrameGoal
from smooth_operator.solvers.newton import newton_minimise
from smooth_operator.solvers.random_words import frame_key, seed_words
from smooth_operator.solvers.sampling import SamplingConfig, sample_minimise
from smooth_operator_research.paper.compared_solvers import NEWTON_CONFIG

FEWEST_FRAMES: Final = 10
"""A run of fewer usable frames has no jitter worth the name."""

_SETTLE_ROUNDS: Final = 6
_SETTLE = SamplingConfig(samples=512, elites=48, cycles=8, sigma=0.4, draws="quasi")


@dataclass(frozen=True, eq=False)
class Problem:
    """A recording as a sequence of minimisations.

    Attributes:
        name: of the recording.
        unit: the independent unit that it belongs to.
        objective: what is minimised; its hand and weights.
        vectors: (T, K, 3) targets [m].
        weights: (T, K) their weights.
        start: (m,) where every solver begins: the minimum of the first frame [rad].
        stamps: (T,) [s].
        frames: which frames of the recording these are.
    """

    name: str
    unit: str
    objective: Objective
    vectors: Float[np.ndarray, "T K 3"]
    weights: Float[np.ndarray, "T K"]
    start: Float[np.ndarray, " m"]
    stamps: Float[np.ndarray, " T"]
    frames: tuple[int, int]

    def __len__(self) -> int:
        return len(self.stamps)

    @property
    def hand(self) -> Hand:
        """The robot hand."""
        return self.objective.hand

    @property
    def rate_hz(self) -> float:
        """Median frame rate [Hz]."""
        return float(1 / np.median(np.diff(self.stamps)))

    @cached_property
    def digest(self) -> str:
        """What the answers depend on, as one word."""
        total = hashlib.sha256(repr((self.objective.config, self.hand.name)).encode())
        for array in (self.vectors, self.weights, self.start, self.stamps, self.hand.limits):
            total.update(np.ascontiguousarray(array, "<f8").tobytes())
        return total.hexdigest()

    def goal(self, t: int, previous: Float[np.ndarray, " m"], velocity_weight: float) -> FrameGoal:
        """The t-th frame after an answer."""
        return FrameGoal(
            jnp.asarray(self.vectors[t], jnp.float32),
            jnp.asarray(self.weights[t], jnp.float32),
            jnp.asarray(previous, jnp.float32),
            jnp.float32(velocity_weight),
        )

    def tracking_loss(self, q: Float[np.ndarray, "T m"]) -> Float[np.ndarray, " T"]:
        """First term of Eq. (1) at an answer to each frame."""
        layout, hand = self.objective.layout, self.hand
        moving = dict(
            zip(hand.tree.names, np.moveaxis(hand.landmark_positions(q), -2, 0), strict=True)
        )
        keypoints = self.hand.tree.keypoints
        points = [
            moving[name]
            if name in moving
            else np.broadcast_to(keypoints[name].position, (len(q), 3))
            for name in (LANDMARKS[i] for i in layout.landmarks)
        ]
        errors = layout.among(points) - self.vectors
        components = [jnp.asarray(errors[..., c]) for c in range(3)]
        price = self.objective.keyvectors.price
        prices = np.asarray(price(components, jnp.asarray(self.weights)), np.float64)
        return np.asarray(prices.sum(axis=-1))

    def cost(self, q: Float[np.ndarray, "T m"], velocity_weight: float) -> Float[np.ndarray, " T"]:
        """All of Eq. (1) at an answer to each frame, each with the answer before it."""
        before = np.concatenate([self.start[None], q[:-1]])
        goal = FrameGoal(self.vectors, self.weights, before, velocity_weight)
        rest = self.objective.regularisation(np.asarray(q), goal)
        return np.asarray(self.tracking_loss(q) + rest)


def make_problems(
    sources: Sequence[Source], hand: str, config: ObjectiveConfig, frames: int
) -> list[Problem]:
    """Problems of the recordings that can be read.

    Args:
        sources: recordings.
        hand: name of the robot hand.
        config: what is minimised.
        frames: the most of each recording.

    Raises:
        RecordingError: a recording has no run of ``FEWEST_FRAMES`` usable frames.
    """
    return [make_problem(s, hand, config, frames) for s in sources if s.recording is not None]


def make_problem(source: Source, hand: str, config: ObjectiveConfig, frames: int) -> Problem:
    """One of them.

    Raises:
        RecordingError: there is no run of ``FEWEST_FRAMES`` usable frames.
    """
    recording = source.recording
    assert recording is not None  # of a source that could be read
    objective = _objective(hand, recording.side, config)
    aligned = align_recording(recording, objective.hand, AlignmentConfig())
    usable = np.isfinite(aligned[:, list(objective.layout.landmarks)]).all(axis=(1, 2))
    cut = unbroken(usable, frames)
    if cut.stop - cut.start < FEWEST_FRAMES:
        raise RecordingError(
            f"{source.name}: the longest unbroken run of usable frames is "
            f"{cut.stop - cut.start}; an experiment needs {FEWEST_FRAMES}"
        )
    vectors, weights = _targets(objective, aligned[cut])
    first = source.frames[0] if source.frames else 0
    return Problem(
        source.name,
        source.request.unit,
        objective,
        vectors,
        weights,
        _settled(objective, vectors[0], weights[0]),
        np.asarray(recording.stamps[cut], np.float64),
        (first + cut.start, first + cut.stop),
    )


def unbroken(usable: Bool[np.ndarray, " T"], most: int) -> slice:
    """The first run of ``most`` usable frames; the longest there is where none is that long."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], usable, [False]]).astype(np.int8)))
    runs = [(int(a), int(b)) for a, b in edges.reshape(-1, 2)]
    whole = [run for run in runs if run[1] - run[0] >= most]
    start, stop = whole[0] if whole else max(runs, key=lambda r: r[1] - r[0], default=(0, 0))
    return slice(start, min(stop, start + most))


@lru_cache(maxsize=16)
def _objective(hand: str, side: str, config: ObjectiveConfig) -> Objective:
    """One for each hand and configuration: compiled programs are kept by it."""
    return Objective(load_hand(hand, side), config)


def _targets(
    objective: Objective, aligned: Float[np.ndarray, "T 21 3"]
) -> tuple[Float[np.ndarray, "T K 3"], Float[np.ndarray, "T K"]]:
    run = _target_program(objective)
    state = objective.config.targets.init(objective.layout)
    targets = []
    for frame in np.nan_to_num(aligned).astype(np.float32):  # NaN where nothing looks
        (vectors, weights), state = run(frame, state)
        targets.append((np.asarray(vectors), np.asarray(weights)))
    return np.stack([v for v, _ in targets]), np.stack([w for _, w in targets])


def _settled(
    objective: Objective, vectors: Float[np.ndarray, "K 3"], weights: Float[np.ndarray, " K"]
) -> Float[np.ndarray, " m"]:
    """The minimum of the first frame: sampled wide, then descended, some times over."""
    run = _settling_program(objective)
    q = jnp.asarray(objective.hand.neutral, jnp.float32)
    for i in range(_SETTLE_ROUNDS):
        goal = FrameGoal(jnp.asarray(vectors), jnp.asarray(weights), q, jnp.float32(0.0))
        q = run(q, frame_key(jnp.asarray(seed_words(0)), jnp.uint32(i)), goal)
    return np.asarray(q, np.float64)


@lru_cache(maxsize=16)
def _target_program(objective: Objective) -> Callable[..., tuple[Targets, Any]]:
    layout, policy = objective.layout, objective.config.targets

    def step(landmarks: Array, state: Any) -> tuple[Targets, Any]:
        return policy(state, layout, layout.human(landmarks))

    return compiled(step)


@lru_cache(maxsize=16)
def _settling_program(objective: Objective) -> Callable[..., Array]:
    limits = objective.hand.limits

    def settle(q: Array, key: Array, goal: FrameGoal) -> Array:
        q = sample_minimise(lambda c: objective(c, goal), q, limits, key, _SETTLE)
        return newton_minimise(
            lambda few: objective.few_value_grad_hess(few, goal), q, limits, NEWTON_CONFIG
        )[0]

    return compiled(settle)
