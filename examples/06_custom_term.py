"""A term of your own in the objective: two fingertips of the robot keep a distance."""

from __future__ import annotations

from dataclasses import dataclass, replace

import jax.numpy as jnp
import numpy as np
from jax import Array

from smooth_operator import Retargeter, SyntheticOperator, load_hand, method_config
from smooth_operator.retargeting import LeastSquaresTerm


@dataclass(frozen=True)
class TipDistance(LeastSquaresTerm):
    """Half of weight times the square of what two fingertips lack of a distance.

    Attributes:
        weight: of the squared distance [1/m^2].
        distance: that the tips keep [m].
    """

    weight: float = 20_000.0
    distance: float = 0.04

    def points(self) -> tuple[str, ...]:
        """The two fingertips."""
        return ("index_tip", "middle_tip")

    def residuals(self, points: Array, goal: object) -> Array:
        """(1,) how much they lack of the distance, times the root of the weight."""
        gap = jnp.linalg.norm(points[0] - points[1])
        return jnp.sqrt(self.weight) * jnp.maximum(self.distance - gap, 0.0)[None]


def main() -> None:
    """Retargets a synthetic recording without and with the term."""
    hand = load_hand("mimic_p050")
    index, middle = (hand.fingers.index(name) for name in ("index", "middle"))
    recording = SyntheticOperator(seed=1).record(2.0)
    plain = method_config("smooth")
    terms = (TipDistance(),)
    apart = replace(plain, objective=replace(plain.objective, terms=terms))
    least = {}
    for name, config in (("without", plain), ("with", apart)):
        commands, _ = Retargeter(hand, config=config).run(recording)
        tips = hand.tips(commands.joint_positions)
        gaps = np.linalg.norm(tips[:, index] - tips[:, middle], axis=-1)
        least[name] = 1e3 * gaps.min()
        print(f"{name} the term, the tips are at least {least[name]:.1f} mm apart")
    assert least["with"] > 35.0 > least["without"] + 5.0


if __name__ == "__main__":
    main()
