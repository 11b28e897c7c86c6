"""Contacts of a scene's object, sorted by the part of the hand that presses on it."""

from __future__ import annotations

import mujoco
import numpy as np
from jaxtyping import Float, Int

from smooth_operator.hands.hand import Hand
from smooth_operator.simulation.physics_model import FURNISHED
from smooth_operator.simulation.scenes.scene import OBJECT

_PALM, _REST, _OBJECT = -1, -2, -3


class Touching:
    """Reads forces and points of contact from a scene's model.

    Args:
        hand: the hand in the scene.
        model: the compiled scene.
    """

    def __init__(self, hand: Hand, model: mujoco.MjModel) -> None:
        self._model = model
        self._fingers = len(hand.fingers)
        self._body = model.body(OBJECT).id
        self._owner = _owners(hand, model)
        self.own = [
            g for g in range(model.ngeom)
            if self._owner[g] >= _PALM and (model.geom_contype[g] or model.geom_conaffinity[g])
        ]  # fmt: skip
        self.things = [
            g for g in range(model.ngeom) if self._owner[g] == _OBJECT and model.geom_contype[g]
        ]

    def read(
        self, data: mujoco.MjData
    ) -> tuple[Float[np.ndarray, " f"], Float[np.ndarray, "f 3"], float, float]:
        """Forces on the object: fingers, their contact points, palm, everything else.

        Returns:
            (f,) normal force of each finger [N]; (f, 3) its point of contact in the object's frame
            [m], NaN without one; force of the palm [N]; force of all else [N].
        """
        force, palm, rest = np.zeros(self._fingers), 0.0, 0.0
        points = np.zeros((self._fingers, 3))
        wrench = np.zeros(6)
        for index in range(data.ncon):
            contact = data.contact[index]
            one, two = (int(self._owner[g]) for g in contact.geom)
            if _OBJECT not in (one, two) or contact.efc_address < 0:
                continue
            other = two if one == _OBJECT else one
            mujoco.mj_contactForce(self._model, data, index, wrench)
            normal = float(wrench[0])
            if other >= 0:
                force[other] += normal
                points[other] += normal * contact.pos
            elif other == _PALM:
                palm += normal
            else:
                rest += normal
        with np.errstate(invalid="ignore"):
            points = np.where(force[:, None] > 0, points / force[:, None], np.nan)
        turn = data.xmat[self._body].reshape(3, 3)
        return force, (points - data.xpos[self._body]) @ turn, palm, rest


def finger_geoms(hand: Hand, model: mujoco.MjModel) -> list[list[int]]:
    """Colliding shapes of each finger, thumb first."""
    owner = _owners(hand, model)
    solid = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
    return [np.flatnonzero((owner == n) & solid).tolist() for n in range(len(hand.fingers))]


def _owners(hand: Hand, model: mujoco.MjModel) -> Int[np.ndarray, " g"]:
    """(g,) number of the finger of each shape, or ``_PALM``, ``_REST`` or ``_OBJECT``."""
    palm = model.body(FURNISHED + hand.spec.palm).id
    finger_of: dict[int, int] = {}
    for number, finger in enumerate(hand.spec.fingers):
        body = model.body(FURNISHED + finger.tip.body).id
        while body not in (palm, 0):
            finger_of.setdefault(body, number)
            body = int(model.body_parentid[body])
    owners = np.full(model.ngeom, _REST)
    for geom in range(model.ngeom):
        body = int(model.geom_bodyid[geom])
        if model.body(body).name == OBJECT:
            owners[geom] = _OBJECT
        elif model.body(body).name.startswith(FURNISHED):
            while body and body not in finger_of:
                body = int(model.body_parentid[body])
            owners[geom] = finger_of.get(body, _PALM)
    return owners
