"""Contact parameters of soft fingertip pads, from the stiffness of silicone.

MuJoCo scales a contact's stiffness by the mass that it moves. The parameters of an object follow
from its mass, so that a given force presses a pad equally far into an object of any mass. The
force at a contact of depth ``r`` is, at rest,

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
"""Depth at which ``PRESSED_STIFFNESS`` holds [m]."""

TIME_CONSTANT: Final = 0.01
"""Time constant of the pads' damping, which is critical or above [s]; five steps of 2 ms."""

_SOFTEST: Final = 0.05  # lowest impedance: an object much heavier than a finger
_HARDEST: Final = 0.9995  # highest impedance: an object below 1 g


def soften_pads(model: mujoco.MjModel, body: int, fingertips: list[int]) -> None:
    """Set the contact parameters of an object's shapes to those of soft pads.

    Args:
        model: the scene; it is changed.
    """
    tips = float(np.median(model.body_invweight0[fingertips, 0]))
    low, high = pad_impedance(float(model.body_invweight0[body, 0]) + tips)
    first = int(model.body_geomadr[body])
    for geom in range(first, first + int(model.body_geomnum[body])):
        model.geom_solref[geom] = TIME_CONSTANT, 1.0
        model.geom_solimp[geom] = low, high, PRESSED_DEPTH, 0.5, 1.0


def pad_impedance(inverse_mass: float) -> tuple[float, float]:
    """Impedance at first touch and at ``PRESSED_DEPTH``.

    Args:
        inverse_mass: sum of the inverse masses of object and fingertip [1/kg].
    """
    scale = TIME_CONSTANT**2 * inverse_mass
    high = float(np.clip(1.0 - 1.0 / (PRESSED_STIFFNESS * scale), _SOFTEST, _HARDEST))
    # d^2 / (1 - d) = touch
    touch = TOUCH_STIFFNESS * scale * high**2
    low = (np.sqrt(touch * touch + 4.0 * touch) - touch) / 2.0
    return float(np.clip(low, _SOFTEST, high)), high
