"""Joint angles by the paper's authors: the start of their hybrid baseline.

Each finger is a chain of frames from the wrist, with y axes along the bones and x axes as near as
possible to the parent's. A joint follows one Euler angle of one frame. The map is the authors' own,
published for the joints of the mimic P0.50 hand. A joint that drives another one takes half of the
angle, as in the authors' code, which divides each angle among the joints that share it. The method
``smooth_operator.baselines.joint_angle`` uses other angles.
"""

from __future__ import annotations

from typing import Final

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from smooth_operator.hands.hand import Hand
from smooth_operator.human.anatomical_axes import unit_vectors
from smooth_operator.landmarks import BASES, FINGERS, NUM_LANDMARKS, WRIST

_TURN: Final = np.pi / 8 - np.pi / 2
"""Turn of the palm's frame about its normal [rad]: from the index finger's ray to its y axis."""

_MAP: Final = {
    "thumb_base2cmc": ("thumb", 1, "z", -1.0),
    "thumb_cmc2mcp": ("thumb", 1, "x", -1.0),
    "thumb_mcp2pp": ("thumb", 2, "z", -1.0),
    "thumb_pp2dp_actuated": ("thumb", 3, "z", -1.0),
    "index_base2mcp": ("index", 1, "z", -1.0),
    "index_mcp2pp": ("index", 1, "x", -1.0),
    "index_pp2mp": ("index", 2, "x", -0.5),
    "middle_base2mcp": ("middle", 1, "z", -1.0),
    "middle_mcp2pp": ("middle", 1, "x", -1.0),
    "middle_pp2mp": ("middle", 2, "x", -0.5),
    "ring_base2mcp": ("ring", 1, "z", 1.0),
    "ring_mcp2pp": ("ring", 1, "x", -1.0),
    "ring_pp2mp": ("ring", 2, "x", -0.5),
    "pinky_base2mcp": ("pinky", 1, "z", 1.0),
    "pinky_mcp2pp": ("pinky", 1, "x", -1.0),
    "pinky_pp2mp": ("pinky", 2, "x", -0.5),
}
"""Actuated joint -> finger, bone (0 is from the wrist to the finger's base), Euler angle, gain."""


class PublishedAngles:
    """The published map from landmarks to joint positions, for a hand with its joints.

    Attributes:
        needs: human landmarks that the map uses: all 21.

    Args:
        hand: the robot hand, for which ``fits`` is True.
    """

    needs: tuple[int, ...] = tuple(range(NUM_LANDMARKS))

    def __init__(self, hand: Hand) -> None:
        self.hand = hand

    @staticmethod
    def fits(hand: Hand) -> bool:
        """True if the hand's actuated joints are those of the map."""
        return set(hand.actuated_names) == set(_MAP)

    def positions(self, aligned: Float[Array, "21 3"]) -> Float[Array, " m"]:
        """Joint positions for landmarks; traceable.

        Args:
            aligned: (21, 3) finite landmarks in any frame [m].

        Returns:
            (m,) positions of the actuated joints [rad], within their limits.
        """
        angles = _chain_angles(aligned)
        rows = [_MAP[name] for name in self.hand.actuated_names]
        picked = [
            gain * angles[axis][FINGERS.index(finger), bone] for finger, bone, axis, gain in rows
        ]
        low, high = (jnp.asarray(side, aligned.dtype) for side in self.hand.limits.T)
        return jnp.clip(jnp.stack(picked), low, high)


def _chain_angles(landmarks: Float[Array, "21 3"]) -> dict[str, Float[Array, "5 4"]]:
    """Euler angles (about fixed x, y, z, in this order) of each bone's frame in its parent's."""
    points = landmarks - landmarks[WRIST]
    ray = unit_vectors(points[BASES[1]], jnp)
    normal = unit_vectors(jnp.cross(ray, points[BASES[4]]), jnp)
    palm = jnp.stack([ray, jnp.cross(normal, ray), normal], axis=-1)
    cosine, sine = np.cos(_TURN), np.sin(_TURN)
    turn = np.array([[cosine, -sine, 0], [sine, cosine, 0], [0, 0, 1]]) @ np.diag([-1, 1, -1])
    points = points @ palm @ jnp.asarray(turn, landmarks.dtype)
    chain = jnp.asarray([[base + i for i in range(4)] for base in BASES])
    before = jnp.concatenate([jnp.zeros_like(chain[:, :1]), chain[:, :-1]], axis=1)
    bones = points[chain] - points[before]  # (5, 4, 3)
    frame = jnp.broadcast_to(jnp.eye(3, dtype=landmarks.dtype), (len(BASES), 3, 3))
    turns = []
    for i in range(4):
        y = unit_vectors(jnp.einsum("fij,fi->fj", frame, bones[:, i]), jnp)
        z = jnp.stack([jnp.zeros_like(y[:, 0]), -y[:, 2], y[:, 1]], axis=-1)  # x cross y
        z = unit_vectors(z, jnp)
        local = jnp.stack([jnp.cross(y, z), y, z], axis=-1)
        frame = frame @ local
        turns.append(local)
    local = jnp.stack(turns, axis=1)  # (5, 4, 3, 3)
    return {
        "x": jnp.arctan2(local[..., 2, 1], local[..., 2, 2]),
        "z": jnp.arctan2(local[..., 1, 0], local[..., 0, 0]),
    }
