"""Where the robot's fingertips belong: the human's, finger by finger, from base to base.

Aligned palms do not make hands correspond: wrists and knuckles lie centimetres apart, and a robot's
fingers are up to twice as long as the human's, each by another factor. So each fingertip is placed
from the robot's own knuckle, as far out as the human's is from his, in units of the length of the
finger. A straight finger is then straight and a bent one as bent. Thumb and finger that come near
each other move together until the vector between them is the human's own.

What is needed of the human, the bases of the fingers and their lengths, is measured while the hand
is in use: constants of the operator that settle within a second.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Final, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from smooth_operator.errors import ConfigError
from smooth_operator.hands.hand import Hand
from smooth_operator.hands.straight_pose import straight_pose
from smooth_operator.landmarks import BASES, FINGERS, LANDMARKS
from smooth_operator.settings import check_numbers

_SUDDEN: Final = 0.2  # share of a length by which one frame may differ and count in full
_SETTLED: Final = 1.0  # after which small differences no longer count [s]
_SMALL: Final = 0.02  # share of a length that counts as a small difference
_TINY: Final = 1e-9


@dataclass(frozen=True)
class CorrespondenceConfig:
    """Settings of the correspondence of human and robot fingers.

    Attributes:
        share: of the way from the human's fingertip, as the palms are aligned, to its counterpart
            on the robot's finger; 0 leaves fingertips where they are.
        longest: greatest gain of a finger, robot length over human length.
        near: distance of thumb and finger, on the robot's scale, under which the vector between
            them is the human's own [m].
        far: distance over which they do not move each other [m].
        thumb_follows: weight with which the thumb keeps its vectors to all fingers, at any
            distance, against its own place; 0 leaves it there.
        span: averaging time of the operator's lengths [s].
    """

    share: float = 1.0
    longest: float = 2.5
    near: float = 0.012
    far: float = 0.05
    thumb_follows: float = 0.0
    span: float = 10.0

    def __post_init__(self) -> None:
        check_numbers(
            self,
            "correspondence.",
            positive=("longest", "far", "span"),
            not_negative=("share", "near", "thumb_follows"),
        )
        if not self.near < self.far:
            raise ConfigError(
                f"correspondence.near {self.near} must be less than correspondence.far {self.far}"
            )
        if self.share > 1:
            raise ConfigError(f"correspondence.share must be 0 to 1, not {self.share}")


class OperatorLengths(NamedTuple):
    """What is known of the operator, on the robot's scale.

    Attributes:
        bases: (F, 3) bases of the fingers in the palm frame [m].
        lengths: (F,) sums of their bones [m].
        time: (F,) for how long each finger has been measured [s].
    """

    bases: Float[Array, "F 3"]
    lengths: Float[Array, " F"]
    time: Float[Array, " F"]


@dataclass(frozen=True, eq=False)
class Correspondence:
    """The correspondence for one hand.

    Attributes:
        hand: the robot hand.
        config: settings.
    """

    hand: Hand
    config: CorrespondenceConfig

    @cached_property
    def landmarks(self) -> tuple[int, ...]:
        """Human landmarks that show the operator's lengths."""
        return tuple(int(i) for i in self._chains.ravel())

    @cached_property
    def _chains(self) -> np.ndarray:
        """(F, 4) landmarks of each finger, base to tip."""
        bases = [BASES[FINGERS.index(name)] for name in self.hand.fingers]
        return np.array(bases)[:, None] + np.arange(4)

    @cached_property
    def _robot(self) -> tuple[Float[np.ndarray, "F 3"], Float[np.ndarray, " F"]]:
        """Bases at the straight pose and lengths of the robot's straight fingers [m]."""
        straight = straight_pose(self.hand)
        names, points = self.hand.tree.names, self.hand.landmark_positions(straight.q)
        rows = [names.index(LANDMARKS[chain[0]]) for chain in self._chains]
        return points[rows].astype(np.float32), straight.reach.astype(np.float32)

    def init(self) -> OperatorLengths:
        """The lengths of an operator who is like the robot."""
        bases, lengths = self._robot
        made: OperatorLengths = jax.device_put(
            OperatorLengths(bases, lengths, np.zeros(len(lengths), np.float32))  # type: ignore[arg-type]
        )
        return made

    def measure(
        self,
        before: OperatorLengths,
        aligned: Float[Array, "21 3"],
        dt: Float[Array, ""],
        restart: Bool[Array, ""],
    ) -> OperatorLengths:
        """The operator after a frame; traceable.

        A mean over the time since the start that follows only differences of over 2 % once it has
        settled; a difference of over 20 % counts as one of 20 %.

        Args:
            before: after the last frame.
            aligned: (21, 3) landmarks in the palm frame [m]; NaN where one is not known.
            dt: time between the two [s].
            restart: nothing came before, or too long ago: it may be another operator.
        """
        chains = aligned[self._chains]
        bones = jnp.diff(chains, axis=1)
        lengths = jnp.sqrt((bones * bones).sum(-1)).sum(-1)
        known = jnp.isfinite(lengths)
        time = jnp.where(restart, 0.0, before.time)
        share = jnp.where(known, dt / (dt + jnp.minimum(time, self.config.span)), 0.0)
        # nothing is certain at first, so a difference counts in full; then it has to be larger
        early = time <= 0
        most = jnp.where(early, jnp.inf, _SUDDEN * before.lengths)
        least = jnp.where(time < _SETTLED, 0.0, _SMALL * before.lengths)

        def moved(mean: Array, now: Array) -> Array:
            """The mean after a frame, of (F, n) values of which the change is limited as one."""
            change = jnp.where(known[:, None], now - mean, 0.0)
            size = jnp.sqrt((change * change).sum(-1)) + _TINY
            counts = jnp.clip(size - least, 0.0, most) / size
            return mean + (share * counts)[:, None] * change

        return OperatorLengths(
            moved(before.bases, chains[:, 0]),
            moved(before.lengths[:, None], lengths[:, None])[:, 0],
            time + jnp.where(known, dt, 0.0),
        )

    def __call__(self, operator: OperatorLengths, tips: Float[Array, "F 3"]) -> Float[Array, "F 3"]:
        """Places of the robot's fingertips; traceable, with a continuous slope.

        With the human's vectors h_i from thumb to finger i, and places T of all fingertips by their
        own fingers alone, the result P is the least of |P_0 - T_0|^2 and, for each finger, of its
        misplacement and the error of its thumb vector, weighted by how near it is to the thumb.

        Args:
            operator: as measured.
            tips: (F, 3) the human's, thumb first, in the palm frame [m].
        """
        config = self.config
        bases, reach = (jnp.asarray(part, tips.dtype) for part in self._robot)
        gain = jnp.minimum(reach / operator.lengths, config.longest)
        alone = bases + gain[:, None] * (tips - operator.bases)
        alone = tips + config.share * (alone - tips)
        human = tips[1:] - tips[0]
        apart = jnp.sqrt((human * human).sum(-1) + _TINY)
        nearness = jnp.clip((config.far - apart) / (config.far - config.near), 0.0, 1.0)
        nearness = (nearness * nearness * (3 - 2 * nearness))[:, None]
        wanted = alone[1:] - human  # of the thumb, for each finger
        weights = nearness + config.thumb_follows
        thumb = (alone[0] + (weights * wanted).sum(0)) / (1 + weights.sum(0))
        fingers = alone[1:] + nearness * (thumb + human - alone[1:])
        return jnp.concatenate([thumb[None], fingers])
