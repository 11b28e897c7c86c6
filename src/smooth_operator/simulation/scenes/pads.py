"""Fingertip pads that give way as silicone does: contact parameters from a stiffness in N/mm.

MuJoCo scales a contact's stiffness by the mass that it moves. So the parameters of an object
follow from its mass, such that pads press into it equally far at equal force, whatever it weighs.
The force at a contact that is ``r`` deep is, at rest,

    F = d(r)^2 r / ((1 - d(r)) d_max^2 tau^2 A)

with the impedance ``d`` (``solimp``), the time constant ``tau`` (``solref``) and the inverse mass
``A`` of both bodies (https://mujoco.readthedocs.io/en/stable/modeling.html#solver-parameters).
"""

from __future__ import annotations

from typing import Final

import mujoco
import numpy as np

TOUCH_STIFFNESS: Final = 2000.0
"""Stiffness of one contact where a pad begins to touch [N/m]."""

PRESSED_STIFFNESS: Final = 8000.0
"""Force over depth of one contact where a pad is ``PRESSED_DEPTH`` deep [N/m].

With ``TOUCH_STIFFNESS`` it gives 0.35 mm at 1 N and 0.85 mm at 5 N. By Hertz a solid silicone
fingertip of 8 mm radius and Shore A 30 gives 0.31 and 0.90 mm (E = 1.16 MPa by Ruess' relation,
incompressible; F = 4/3 E* R^1/2 r^3/2). Soft robot fingertips were measured to follow such power
laws (Xydas and Kao 1999, doi:10.1177/02783649922066673). A human fingertip is softer and stiffens
exponentially (Pawluk and Howe 1999, doi:10.1115/1.2835100)."""

PRESSED_DEPTH: Final = 0.001
"""[m]"""

TIME_CONSTANT: Final = 0.01
"""Of the pads' damping, which is critical or above [s]; five steps of 2 ms."""

_SOFTEST: Final = 0.05  # impedance, for an object much heavier than a finger
_HARDEST: Final = 0.9995  # for one of less than a gram


def soften_pads(model: mujoco.MjModel, body: int, fingertips: list[int]) -> None:
    """Give an object's shapes the parameters with which a pad presses into them.

    Args:
        model: the scene; its shapes are changed.
        body: the object's.
        fingertips: bodies of the fingertips.
    """
    tips = float(np.median(model.body_invweight0[fingertips, 0]))
    low, high = pad_impedance(float(model.body_invweight0[body, 0]) + tips)
    first = int(model.body_geomadr[body])
    for geom in range(first, first + int(model.body_geomnum[body])):
        model.geom_solref[geom] = TIME_CONSTANT, 1.0
        model.geom_solimp[geom] = low, high, PRESSED_DEPTH, 0.5, 1.0


def pad_impedance(inverse_mass: float) -> tuple[float, float]:
    """Impedance where a pad begins to touch and where it is ``PRESSED_DEPTH`` deep.

    Args:
        inverse_mass: of the object and of the fingertip, added [1/kg].
    """
    scale = TIME_CONSTANT**2 * inverse_mass
    high = float(np.clip(1.0 - 1.0 / (PRESSED_STIFFNESS * scale), _SOFTEST, _HARDEST))
    # d^2 / (1 - d) = touch
    touch = TOUCH_STIFFNESS * scale * high**2
    low = (np.sqrt(touch * touch + 4.0 * touch) - touch) / 2.0
    return float(np.clip(low, _SOFTEST, high)), high


def pad_force(depth: float, inverse_mass: float) -> float:
    """With how much force a pad presses where it is so deep, at rest [N].

    Args:
        depth: of the contact [m].
        inverse_mass: of the object and of the fingertip, added [1/kg].
    """
    low, high = pad_impedance(inverse_mass)
    d = low + (high - low) * min(depth / PRESSED_DEPTH, 1.0)
    return d * d * depth / ((1.0 - d) * high**2 * TIME_CONSTANT**2 * inverse_mass)
