"""Scene of the card pickup: a card on a table, to be slid over the edge and pinched."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Final

import mujoco
import numpy as np
from jaxtyping import Float

from smooth_operator.errors import HandModelError
from smooth_operator.hands.hand import Hand
from smooth_operator.simulation.scenes.mount import mount, reachable
from smooth_operator.simulation.scenes.scene import PLATFORM, Scene, add_shape

CARD: Final = (0.054, 0.0856, 0.002)
"""Size of the card [m]: area of a bank card, but thicker, since fingers press from both sides."""

MASS: Final = 0.009
"""Mass of the card, of polypropylene [kg]."""

_TABLE_TOP: Final = 0.18  # height of its top [m]
_TABLE: Final = (0.16, 0.24, 0.02)  # size of the table [m]
_INSET: Final = 0.004  # distance of the card from the edge at the start [m]
_TABLE_FRICTION: Final = (0.25, 0.001)  # plastic on a smooth table
_CARD_FRICTION: Final = (0.9, 0.002)  # rubber on plastic


@dataclass(frozen=True, eq=False)
class CardScene(Scene):
    """The table's edge runs across the hand, the fingers on the table and the thumb below it.

    Attributes:
        edge: x of the table's edge; the table lies beyond it [m].
        top: height of the table's top [m].
        reach: largest x at which a finger can press on the table [m].
    """

    view: ClassVar = (150.0, -12.0)

    edge: float
    top: float
    reach: float

    def add_platform(self, world: mujoco.MjSpec) -> None:
        """The table."""
        half = np.array(_TABLE) / 2
        add_shape(
            world.worldbody, PLATFORM, mujoco.mjtGeom.mjGEOM_BOX, half, mass=0.0,
            at=(self.edge + half[0], float(self.start[0][1]), self.top - half[2]),
            friction=_TABLE_FRICTION, color=(0.62, 0.5, 0.38, 1.0), priority=2,
        )  # fmt: skip

    def add_object(self, body: mujoco.MjsBody) -> None:
        """The card."""
        add_shape(
            body, "card", mujoco.mjtGeom.mjGEOM_BOX, np.array(CARD) / 2, mass=MASS,
            friction=_CARD_FRICTION, color=(0.85, 0.33, 0.25, 1.0),
        )  # fmt: skip


def card_scene(hand: Hand) -> CardScene:
    """Scene with table and card where a finger can press on the table and the thumb reach below it.

    Raises:
        HandModelError: the hand has no such place.
    """
    tips = reachable(hand)
    thumb, others = tips[:, 0], tips[:, 1:3].reshape(-1, 3)
    best: tuple[float, float, float] | None = None
    most = 0.0
    for depth in np.arange(0.0, 0.121, 0.005):
        press = others[np.abs(others[:, 2] - depth) < 0.005]
        below = thumb[(thumb[:, 2] > depth + 0.002) & (thumb[:, 2] < depth + 0.025)]
        for edge in np.arange(0.04, 0.2, 0.005):
            on = press[(press[:, 0] > edge + 0.008) & (press[:, 0] < edge + 0.04)]
            if len(on) < 50:
                continue
            across = float(np.median(on[:, 1]))
            under = (below[:, 0] > edge - 0.02) & (below[:, 0] < edge + 0.004)
            under &= np.abs(below[:, 1] - across) < 0.025
            score = min(len(on) / len(others), float(under.sum()) / len(thumb))
            if score > most:
                most, best = score, (float(depth), float(edge), across)
    if best is None or most < 5e-4:
        raise HandModelError(
            f"hand {hand.name!r} can't press on a table with a finger and reach below it with the "
            "thumb; choose another task or hand"
        )
    return _placed(hand, others, *best)


def _placed(
    hand: Hand, others: Float[np.ndarray, "k 3"], depth: float, edge: float, across: float
) -> CardScene:
    at = mount(hand, up=(0, 0, -1), forward=(1, 0, 0), wrist=(0.0, 0.0, _TABLE_TOP + depth))
    centre = at.world((edge + _INSET + CARD[0] / 2, across, depth - CARD[2] / 2))
    press = others[np.abs(others[:, 2] - depth) < 0.005]
    lower = np.array([edge - 0.10, centre[1] - 0.12, _TABLE_TOP - 0.05])
    upper = np.array([edge + _TABLE[0] + 0.02, centre[1] + 0.12, _TABLE_TOP + 0.15])
    return CardScene(
        mount=at, start=(centre, np.array([1.0, 0.0, 0.0, 0.0])), lower=lower, upper=upper,
        fixture=False, edge=edge, top=_TABLE_TOP, reach=float(np.quantile(press[:, 0], 0.98)),
    )  # fmt: skip
