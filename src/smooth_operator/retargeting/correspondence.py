"""Correspondence of human and robot fingers: computes the fingertip targets of the robot.

Each fingertip target is placed relative to the robot's own knuckle, at the same distance as the
human's fingertip from the human knuckle, in units of finger length, because a robot's fingers are
up to twice as long. When thumb and finger approach each other, their targets move together until
the vector between them equals the human's. The lengths of the human's fingers are measured in each
frame, because trackers stretch bones.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Final, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from smooth_operator.errors import ConfigError
from smooth_operator.geometry import lengths, smooth_step
from smooth_operator.hands.hand import Hand
from smooth_operator.landmarks import LANDMARKS, finger_landmarks
from smooth_operator.retargeting.gripper import Jaws
from smooth_operator.retargeting.program import FrameClock
from smooth_operator.settings import check_numbers, check_range

_FOLDS: Final = 0.2  # range of extensions in which a finger begins to count as unfolded
_GRASPS: Final = (0.55, 0.85)  # mean extensions of a hand that points and of one that may grasp
_POSES: Final = 256  # random ones, for the thumb's length
# distance of full pressing [m]; none at twice this distance
_PRESSED: Final = 0.012
_TINY: Final = 1e-9


@dataclass(frozen=True)
class CorrespondenceConfig:
    """Settings of the correspondence of human and robot fingers.

    Attributes:
        share: interpolation from the human's aligned fingertip (0) to the robot finger's target
            (1).
        near: distance between thumb and finger, on the robot's scale, below which the vector
            between their targets equals the human's [m].
        far: distance above which thumb and finger do not affect each other's targets [m].
        grasp: increase of ``near`` and ``far`` while all fingers are unfolded, because an object
            between thumb and fingers has the same size for both hands [m].
        press: reduction of the distance between the robot's thumb and finger in a pinch, for
            distances that are large compared to it [m].
        folded: extension of a finger (base-to-tip distance over length) at which a pinch has half
            effect, because a thumb next to a fist is not pinching. 0 disables this.
        thumb_share: weight of a nearby finger in the thumb's target; that of the thumb is 1.
        thumb_follows: weight of a finger at any distance, to keep the thumb on the human's side.
        catch_up: margin by which the speed of a fingertip target may exceed the human's step times
            the finger's gain [m/s].
    """

    share: float = 1.0
    near: float = 0.015
    far: float = 0.08
    grasp: float = 0.03
    press: float = 0.011
    folded: float = 0.35
    thumb_share: float = 0.6
    thumb_follows: float = 0.1
    catch_up: float = 0.2

    def __post_init__(self) -> None:
        check_numbers(self, "correspondence.", positive=("far", "catch_up"))
        if not self.near < self.far:
            raise ConfigError(
                f"correspondence.near {self.near} must be less than correspondence.far {self.far}"
            )
        check_range("correspondence.share", self.share, 0, 1)


class CorrespondenceState(NamedTuple):
    """Lengths of the operator's fingers, scaled to the robot, and the last fingertip targets.

    Attributes:
        bases: (F, 3) bases of the human's fingers in the palm frame [m].
        lengths: (F,) lengths of the fingers, sums of their bones [m].
        places: (F, 3) fingertip targets of the last frame [m].
    """

    bases: Float[Array, "F 3"]
    lengths: Float[Array, " F"]
    places: Float[Array, "F 3"]


@dataclass(frozen=True, eq=False)
class Correspondence:
    """Computes fingertip targets for one robot hand.

    Attributes:
        hand: the robot hand.
        config: settings.
    """

    hand: Hand
    config: CorrespondenceConfig

    @cached_property
    def robot(self) -> tuple[Float[np.ndarray, "F 3"], Float[np.ndarray, " F"]]:
        """Base positions (in the straight pose) and lengths of the robot's fingers [m].

        The length of a long finger is measured when it is straight. A thumb is hardly ever
        straight, so its length is the sum of its bones, averaged over random poses.
        """
        straight = self.hand.straight_pose
        names, points = self.hand.tree.names, self.hand.landmark_positions(straight.q)
        chains = finger_landmarks(self.hand.fingers)
        rows = [names.index(LANDMARKS[chain[0]]) for chain in chains]
        reach = straight.reach.astype(np.float32)
        thumb = self.hand.fingers.index("thumb")
        low, high = self.hand.limits.T
        poses = np.random.default_rng(0).uniform(low, high, (_POSES, len(low)))
        landmarks = [LANDMARKS[i] for i in chains[thumb] if LANDMARKS[i] in names]
        joints = self.hand.landmark_positions(poses)[:, [names.index(i) for i in landmarks]]
        reach[thumb] = np.linalg.norm(np.diff(joints, axis=1), axis=-1).sum(axis=-1).mean()
        return points[rows].astype(np.float32), reach

    def init(self) -> CorrespondenceState:
        """State before the first frame, with the robot's own finger lengths."""
        bases, reach = self.robot
        return CorrespondenceState(*jax.device_put((bases, reach, bases)))

    def step(
        self,
        before: CorrespondenceState,
        aligned: Float[Array, "21 3"],
        tips: Float[Array, "F 3"],
        steps: Float[Array, "F 3"],
        measured: Float[Array, "F 3"],
        clock: FrameClock,
    ) -> tuple[CorrespondenceState, Float[Array, "F 3"]]:
        """Returns the state after a frame, and the (F, 3) steps by which the fingertip targets move
        in that frame [m], in the direction of ``steps``. Traceable.

        Args:
            aligned: (21, 3) landmarks in the palm frame [m]; NaN if unknown.
            tips: (F, 3) the human's fingertips in the palm frame, thumb first [m].
            steps: (F, 3) steps of the filtered fingertips in this frame [m].
            measured: (F, 3) steps of the fingertips as measured [m].
            clock: time since the last frame.
        """
        # joints between base and tip may be hidden; then the last lengths are used
        chains = aligned[np.array(finger_landmarks(self.hand.fingers))]
        total = lengths(jnp.diff(chains, axis=1)).sum(-1)
        known = jnp.isfinite(total)
        operator = before._replace(
            bases=jnp.where(known[:, None], chains[:, 0], before.bases),
            lengths=jnp.where(known, total, before.lengths),
        )
        size = lengths(measured)
        if self.hand.spec.gripper:
            places, gain = Jaws(self.hand).places(operator.lengths[1], tips, self.config.press)
            size = jnp.full_like(size, size.sum())  # either fingertip opens both jaws
        else:
            places, gain, nearness = self._places(operator, tips)
        most = (jnp.maximum(gain, 1.0) * size + self.config.catch_up * clock.dt)[:, None]
        last = jnp.where(clock.restart, places, before.places)
        places = last + _shortened(places - last, most)
        if self.hand.spec.gripper:
            moves = places - last
        else:  # pinching fingers move together
            nearest = jnp.concatenate([nearness.max()[None], nearness])
            moves = (gain + nearest * (1 - gain))[:, None] * steps
        return operator._replace(places=places), _shortened(moves, most)

    def _places(
        self, operator: CorrespondenceState, tips: Float[Array, "F 3"]
    ) -> tuple[Float[Array, "F 3"], Float[Array, " F"], Float[Array, " F"]]:
        """Returns the fingertip targets, the gains of the fingers (robot length over human length)
        and their closeness to a pinch. The targets have a continuous derivative.

        Let h_i be the human's vector from thumb to finger i, T the targets of single fingers, g the
        gains, c_i the closeness and n_i the nearness to a pinch (c_i^3 for an unfolded finger),
        both from 0 to 1, and w_i = thumb_follows + thumb_share c_i the weights. The targets P are

            P_0 = (T_0 + sum w_i (T_i - h_i (g_i - c_i (g_i - 1)))) / (1 + sum w_i),
            P_i = T_i + n_i (P_0 + h_i (1 - s_i press / (|h_i| + press)) - T_i),

        where s_i falls from 1 to 0 between 12 and 24 mm.

        Without ``press``, the robot's fingertips would not touch, because trackers report touching
        fingertips some millimetres apart. Fingers around a handle are not pressed further.
        """
        config = self.config
        bases, reach = (jnp.asarray(part, tips.dtype) for part in self.robot)
        gain = reach / operator.lengths
        alone = bases + gain[:, None] * (tips - operator.bases)
        alone = tips + config.share * (alone - tips)
        gain = 1 + config.share * (gain - 1)
        human = tips[1:] - tips[0]
        apart = lengths(human, _TINY)
        extension = lengths(tips[1:] - operator.bases[1:], _TINY) / operator.lengths[1:]
        grasps = smooth_step((extension.mean() - _GRASPS[0]) / (_GRASPS[1] - _GRASPS[0]))
        beyond = config.far + config.grasp * grasps - apart
        close = smooth_step(beyond / (config.far - config.near))
        # a high power, so that a thumb at the side of a pointing finger does not bend the finger
        nearness = close**3 * smooth_step(0.5 + (extension - config.folded) / _FOLDS)
        weights = (config.thumb_follows + config.thumb_share * close)[:, None]
        scaled = human * (gain[1:] - close * (gain[1:] - 1))[:, None]
        thumb = (alone[0] + (weights * (alone[1:] - scaled)).sum(0)) / (1 + weights.sum(0))
        pinch = config.share * smooth_step(2 - apart / _PRESSED)
        pressed = human * (1 - pinch * config.press / (apart + config.press))[:, None]
        fingers = alone[1:] + nearness[:, None] * (thumb + pressed - alone[1:])
        return jnp.concatenate([thumb[None], fingers]), gain, nearness


def _shortened(vectors: Float[Array, "F 3"], most: Float[Array, "F 1"]) -> Float[Array, "F 3"]:
    """Shortens vectors that exceed a length limit."""
    return vectors * jnp.minimum(1.0, most / (lengths(vectors)[:, None] + _TINY))
