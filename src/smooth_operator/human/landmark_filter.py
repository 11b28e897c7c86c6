"""Landmark filter and removal of a tracker's noise.

*The filter* is a low-pass that limits outliers and hardly delays ordinary motion: the larger a step
of a point, the smaller the share of it that is followed. The threshold of a jump grows with the
tracker's noise, measured by what points do between three frames beyond steady motion.

*The noise* is removed as far as the palm shows it. A rigid palm keeps its shape, so what its
landmarks move against each other is noise. A fit of the palm to its mean shape takes most of it
away without delay; the rest is filtered with the gains of a steady-state Kalman filter for constant
velocity. Nothing is removed where the palm goes on bending the same way, where the difference lasts
over a quarter of a second, or at 60 frames a second and fewer, where a hand's own motion changes
its sign from frame to frame, too.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from smooth_operator.geometry import umeyama
from smooth_operator.landmarks import BASES, WRIST
from smooth_operator.settings import check_numbers, is_off

NOISE_AT_FIRST: Final = 5e-4
"""Noise of a tracker that hasn't been seen yet [m]: between a glove's and a video's."""


@dataclass(frozen=True)
class LandmarkFilterConfig:
    """Settings of the landmark filter.

    Attributes:
        time_constant: delay of steady motion [s]; 0 for none.
        jump_threshold: step in one frame that is followed by half at most [m], for a tracker
            without noise.
        jump_speed: speed whose way between two frames is no jump where that is longer than the
            threshold [m/s]: at low rates, and after lost frames.
        noise: the threshold grows by this many times the tracker's noise. With a threshold of 0 as
            well, no step is limited.
        noise_time: averaging time of the noise [s].
    """

    time_constant: float = 0.0
    jump_threshold: float = 0.0
    jump_speed: float = 1.0
    noise: float = 0.0
    noise_time: float = 5.0

    def __post_init__(self) -> None:
        check_numbers(
            self,
            "landmarks.",
            positive=("noise_time",),
            not_negative=("time_constant", "jump_threshold", "jump_speed", "noise"),
        )


class FilterState(NamedTuple):
    """State of the filter between frames.

    Attributes:
        points: (n, 3) filtered [m].
        measured: (n, 3) as measured [m].
        step: (n, 3) change of the measurement in the last frame [m].
        root: running mean of the square root of the tracker's noise [m^0.5]: the mean of roots
            measures what a tracker usually does, and not its worst.
    """

    points: Float[Array, "n 3"]
    measured: Float[Array, "n 3"]
    step: Float[Array, "n 3"]
    root: Float[Array, ""]

    @classmethod
    def unseen(cls, count: int) -> FilterState:
        """State of points without any frame yet."""
        zero, root = jax.device_put(
            (np.zeros((count, 3), np.float32), np.sqrt(np.float32(NOISE_AT_FIRST)))
        )
        return cls(zero, zero, zero, root)

    @property
    def noise(self) -> Float[Array, ""]:
        """Estimated noise of the tracker, as a second difference of a point [m]."""
        return self.root**2


def filter_landmarks(
    before: FilterState,
    measured: Float[Array, "n 3"],
    dt: Float[Array, ""] | float,
    config: LandmarkFilterConfig,
    restart: Bool[Array, ""] | bool = False,
) -> tuple[FilterState, Float[Array, "n 3"]]:
    """The state after a frame of (n, 3) measured points [m], a time ``dt`` [s] after the last, and
    (n, 3) the step of the filtered points in it [m]. After a ``restart`` the last frame was too
    long ago to count; the noise estimate is kept."""
    last = jnp.where(restart, measured, before.measured)
    start = jnp.where(restart, measured, before.points)
    step = measured - last
    # the median over points: fingers that flick are not the tracker's noise
    noise_root = _median(((step - before.step) ** 2).sum(-1) + 1e-18) ** 0.25
    share = jnp.where(restart, 0.0, dt / (dt + config.noise_time))
    root = before.root + share * (noise_root - before.root)
    after = FilterState(measured, measured, step, root)
    limits_jumps = not (is_off(config.jump_threshold) and is_off(config.noise))
    if limits_jumps or not is_off(config.time_constant):
        way = measured - start
        delay = jnp.full((len(measured), 1), config.time_constant / dt, way.dtype)
        if limits_jumps:
            threshold = config.jump_threshold + config.noise * before.noise
            threshold = jnp.maximum(threshold, config.jump_speed * dt)
            delay = delay + jnp.sqrt((way * way).sum(-1, keepdims=True) + 1e-18) / threshold
        after = after._replace(points=start + way / (1 + delay))
    return after, after.points - start


def _median(values: Float[Array, " n"]) -> Float[Array, ""]:
    """By rank and not by sorting, for which XLA calls a library."""
    count, index = len(values), np.arange(len(values))
    first = (values[None] < values[:, None]) | (
        (values[None] == values[:, None]) & (index[None] < index[:, None])
    )
    rank = first.sum(axis=1)
    middle = jnp.where((rank == (count - 1) // 2) | (rank == count // 2), values, 0.0)
    return middle.sum() / (2 - count % 2)


PALM: Final = (WRIST, *BASES)
"""Landmarks that keep their distances."""

_RIGID: Final = 5e-5  # noise at which half is corrected [m]: a palm with less is rigid
_SHORTEST: Final = 0.25  # 1 - correlation of noise between frames, at least: the rest is motion
_LASTS: Final = 0.25  # over which noise averages out [s]
_BENDS: Final = 0.3  # share of the palm's deformation left by that, at which half is corrected
_RATE: Final = 70.0  # at which half is corrected [Hz]
_SUDDEN: Final = 9.0  # how much more than its mean a frame may count
_OWN_SHARE: Final = 2.0  # a fingertip's variance by that of a coordinate: its own, and the palm's


@dataclass(frozen=True)
class NoiseConfig:
    """Settings of the removal of tracker noise.

    Attributes:
        acceleration: acceleration [m/s^2] of a resting fingertip that counts as motion: the larger,
            the less is filtered. 0 removes no noise.
        by_speed: growth of that with the fingertip's speed [1/s].
        outlier: standard deviations from where a fingertip is expected at which it is half
            followed as it was measured.
        level_time: averaging time of how much noise there is [s].
        shape_time: averaging time of the palm's shape, and of how much it bends [s].
    """

    acceleration: float = 0.0
    by_speed: float = 8.0
    outlier: float = 20.0
    level_time: float = 1.0
    shape_time: float = 10.0

    def __post_init__(self) -> None:
        check_numbers(
            self,
            "tracker_noise.",
            positive=("outlier", "level_time", "shape_time"),
            not_negative=("acceleration", "by_speed"),
        )


class NoiseState(NamedTuple):
    """State between frames.

    Attributes:
        shape: (P, 3) mean positions of ``PALM`` [m]; NaN where one was never seen.
        residual: (P, 3) what the fit of the palm to its shape left in the last frame [m].
        change: (P, 3) by how much that differed from the frame before [m].
        slow: (P, 3) mean residual of the last quarter of a second [m].
        rate: frames a second [Hz].
        lasting: mean square of ``slow``, per coordinate [m^2].
        spread: mean square of the residual, per coordinate [m^2].
        power: mean square of such a change, over 2 and per coordinate [m^2].
        product: mean product of two changes in a row, per coordinate [m^2].
        time: since the first frame, or the first after a gap [s].
        points: (n, 3) filtered [m].
        velocity: (n, 3) of those [m/s].
    """

    shape: Float[Array, "P 3"]
    residual: Float[Array, "P 3"]
    change: Float[Array, "P 3"]
    slow: Float[Array, "P 3"]
    rate: Float[Array, ""]
    lasting: Float[Array, ""]
    spread: Float[Array, ""]
    power: Float[Array, ""]
    product: Float[Array, ""]
    time: Float[Array, ""]
    points: Float[Array, "n 3"]
    velocity: Float[Array, "n 3"]

    @classmethod
    def unseen(cls, count: int) -> NoiseState:
        """State of ``count`` points before the first frame."""
        palm, points = (np.zeros((size, 3), np.float32) for size in (len(PALM), count))
        none = np.float32(0)
        placed: NoiseState = jax.device_put(
            cls(palm, palm, palm, palm, none, none, none, none, none, none, points, points)  # type: ignore[arg-type]
        )
        return placed

    @property
    def opened(self) -> Float[Array, ""]:
        """1 - correlation of the noise between two frames; 0 or less of motion."""
        return -self.product / jnp.maximum(self.power, 1e-16)

    @property
    def white(self) -> Float[Array, ""]:
        """Share of ``power`` that changes its sign from frame to frame [m^2]."""
        return self.power * jnp.clip(2 * self.opened / _SHORTEST, 0.0, 1.0)

    @property
    def loud(self) -> Float[Array, ""]:
        """0 for a palm that is rigid, 1 for one with noise."""
        return self.white**2 / (self.white**2 + _RIGID**4)

    @property
    def sure(self) -> Float[Array, ""]:
        """1 for noise; 0 for a palm that bends, and for few frames a second."""
        bends = self.lasting / jnp.maximum(self.spread, 1e-16)
        slow = _RATE / jnp.maximum(self.rate, 1.0)
        return 1 / (1 + (bends / _BENDS) ** 8) / (1 + slow**24)

    @property
    def share(self) -> Float[Array, ""]:
        """Share of the palm's fit that is applied, 0 to 1."""
        return self.loud * self.sure

    @property
    def deviation(self) -> Float[Array, ""]:
        """Standard deviation of a fingertip's coordinate [m]: of white noise that has as much in
        slow motion as this tracker's."""
        # of noise with the correlation r between frames, the power is s^2 (1 - r)
        opened = jnp.clip(self.opened, _SHORTEST, 1.0)
        power = _OWN_SHARE * self.loud * self.white
        return self.sure * jnp.sqrt(power * (2 - opened)) / opened


def remove_noise(
    before: NoiseState,
    aligned: Float[Array, "21 3"],
    needs: tuple[int, ...],
    dt: Float[Array, ""] | float,
    config: NoiseConfig,
    restart: Bool[Array, ""] | bool = False,
) -> tuple[NoiseState, Float[Array, "n 3"]]:
    """The state after a frame, and (n, 3) the wanted landmarks [m].

    Args:
        aligned: (21, 3) landmarks in the palm frame [m]; NaN where one is not known.
        needs: indices of the landmarks to clean, fingertips and wrist; known in every frame.
        dt: time between the two frames [s].
        restart: the last frame was too long ago to count.
    """
    if is_off(config.acceleration):
        return before, aligned[np.array(needs)]
    rows = np.array(PALM)
    palm = aligned[rows]
    shape = jnp.where(restart | ~jnp.isfinite(before.shape), palm, before.shape)
    finite = jnp.isfinite(palm).all(-1)
    source, target = (jnp.where(finite[:, None], points, 0.0) for points in (palm, shape))
    moved = umeyama(source, target, weights=finite.astype(palm.dtype)).apply(aligned)
    residual = jnp.where(finite[:, None], moved[rows] - shape, 0.0)
    change = jnp.where(restart, 0.0, residual - before.residual)
    free = jnp.maximum(3 * finite.sum() - 7, 1)
    time = jnp.where(restart, 0.0, before.time)

    def averaged(mean: Array, now: Array, span: float) -> Array:
        return mean + dt / (dt + jnp.minimum(time, span)) * (now - mean)

    slow = averaged(before.slow, residual, _LASTS)
    square, lasting, spread = ((x * x).sum() / free for x in (change, slow, residual))
    square = square / 2
    # a palm that is lost for a frame is no measure of the usual
    trust = jnp.minimum(1.0, (_SUDDEN * before.power + _RIGID**2) / jnp.maximum(square, 1e-16))
    product = (change * before.change).sum() / free
    mean = averaged(shape, palm, config.shape_time)
    after = before._replace(
        shape=jnp.where(finite[:, None], mean, shape),
        residual=residual,
        change=change,
        slow=slow,
        rate=averaged(before.rate, jnp.asarray(1 / dt), config.level_time),
        lasting=averaged(before.lasting, trust * lasting, config.shape_time),
        spread=averaged(before.spread, trust * spread, config.shape_time),
        power=averaged(before.power, trust * square, config.level_time),
        product=averaged(before.product, trust * product, config.level_time),
        time=time + dt,
    )
    place = [PALM.index(i) if i in PALM else len(PALM) + i for i in range(len(moved))]
    steady = jnp.concatenate([shape, moved])[np.array(place)]
    whole = aligned + jnp.where(jnp.isfinite(steady), after.share * (steady - aligned), 0.0)
    measured = whole[np.array(needs)]
    # alpha-beta filter (Kalata 1984): its gains follow from the ratio of motion to noise
    velocity = jnp.where(restart, 0.0, before.velocity)
    deviation = jnp.maximum(after.deviation, 1e-12)
    speed = jnp.sqrt((velocity * velocity).sum(-1, keepdims=True) + 1e-18)
    index = (config.acceleration + config.by_speed * speed) * dt * dt / deviation
    left = 4 / (4 + index + jnp.sqrt(index * index + 8 * index))
    expected = jnp.where(restart, measured, before.points) + velocity * dt
    off = measured - expected
    far = (off * off).sum(-1, keepdims=True) / (3 * (config.outlier * deviation) ** 2)
    near = 1 / (1 + far)
    beta = jnp.minimum(2 * (1 - left) ** 2, 1.0)
    points = measured - left**2 * near * off  # without noise as measured, to the bit
    velocity = velocity + (1 - (1 - beta) * near) * off / dt
    return after._replace(points=points, velocity=velocity), points
