"""Costs of a robot hand near objects, with the wrist as six more variables of each frame.

With c_k(x) the clearance of sphere k of the hand (its centre's signed distance from the nearest
object, less its radius) and c_f(x) that of fingertip f (the least of its spheres), the cost of one
frame is::

    w_p/2 sum_k max(margin - c_k, 0)^2               nothing is inside an object
    + w_c sum_f a_f rho(c_f)                         a fingertip touches where the human's does
    + w_s sum_f a_f rho(|tangential offset|)         and about at the same place
    + w_n/2 sum_f (1 - a_f) max(clear_f - c_f, 0)^2  and touches nothing where the human's does not
    + w_t/2 |d|^2 + w_r/2 |r|^2                      small correction d, r of the wrist

a_f is 1 in a contact of the human's and 0 elsewhere, with a ramp of a few frames; rho is
pseudo-Huber, so that a fingertip that can't reach does not pull the others away. All weights are in
units of a keyvector's weight. Hessians are Gauss and Newton's.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from smooth_hand_datasets.objects.contacts import Contacts, Scene
from smooth_hand_datasets.objects.hand_surface import HandSurface
from smooth_hand_datasets.objects.signed_distance import FAR_M, Shape, signed_distance
from smooth_operator import poses
from smooth_operator.geometry import AnyArray
from smooth_operator.hands.hand import Hand
from smooth_operator.landmarks import FINGERS
from smooth_operator.settings import check_numbers

TRANSITION: Final = 0.02
"""Transition of the smooth-L1 cost [m], as for keyvectors, so that weights are comparable."""
CHUNK: Final = 64
"""Number of frames in a call of the compiled program."""
UNITS: Final = np.array([0.05] * 3 + [0.3] * 3)
"""Size of one unit of each wrist variable [m, rad], chosen so that motion costs as for a joint."""

_DEEPEST: Final = 48  # spheres of a frame whose derivatives are worked out


@dataclass(frozen=True)
class ObjectSettings:
    """Weights (relative to the weight of a keyvector) and bounds of the costs.

    Attributes:
        penetration: weight of the depth inside an object.
        margin: clearance below which a part counts as inside [m].
        contact: weight of a fingertip's clearance in a contact.
        place: weight of its offset along the surface in a contact.
        apart: weight of a fingertip that comes nearer than the human's while the human's does not
            touch.
        clear: clearance that is enough for such a fingertip [m].
        reach: clearance above which the cost of a missed contact grows linearly [m].
        slip: offset along the surface above which its cost grows linearly [m].
        wrist: weight of the wrist's correction: its translation, and its rotation times ``lever``.
        lever: arm on which a rotation of the wrist counts [m].
        ramp: time over which a contact's weight rises and falls [s].
        shift: largest correction of the wrist along each axis [m]; 0 for no correction.
        turn: largest correction about each axis [rad]; 0 for no correction.
    """

    penetration: float = 7000.0
    margin: float = 0.0005
    contact: float = 1000.0
    place: float = 30.0
    apart: float = 1000.0
    clear: float = 0.008
    reach: float = 0.01
    slip: float = 0.02
    wrist: float = 1.0
    lever: float = 0.1
    ramp: float = 0.03
    shift: float = 0.04
    turn: float = math.radians(15.0)

    def __post_init__(self) -> None:
        weights = ("penetration", "contact", "place", "apart", "clear", "wrist", "ramp")
        check_numbers(self, "objects.", not_negative=(*weights, "shift", "turn"))
        check_numbers(self, "objects.", positive=("reach", "slip", "lever"), not_negative=())


DEFAULT: Final = ObjectSettings()
"""Default weights; docs/explanation/objects.md describes how they were chosen."""


class ObjectFrame(NamedTuple):
    """Objects and contacts of one frame; a pytree. O objects, F fingers of the robot.

    Attributes:
        rotation: (O, 3, 3) rotations from palm to object.
        translation: (O, 3) positions of the palm in the objects' frames [m].
        known: (O,) whether these poses are known.
        contact: (F,) 1 in a contact, 0 elsewhere.
        clear: (F,) clearance that a fingertip without contact keeps [m]; -1 for no limit.
        which: (F,) index of the object that is touched.
        place: (F, 3) point that the human touches, in the object's frame [m].
        normal: (F, 3) outward normal at that point.
    """

    rotation: Float[AnyArray, "O 3 3"]
    translation: Float[AnyArray, "O 3"]
    known: Bool[AnyArray, " O"]
    contact: Float[AnyArray, " F"]
    clear: Float[AnyArray, " F"]
    which: Int[AnyArray, " F"]
    place: Float[AnyArray, "F 3"]
    normal: Float[AnyArray, "F 3"]


def object_frames(
    hand: Hand,
    T_world_palm: Float[np.ndarray, "T 7"],
    scene: Scene,
    contacts: Contacts,
    stamps: Float[np.ndarray, " T"],
    settings: ObjectSettings,
) -> ObjectFrame:
    """Objects and contacts of a clip's frames, stacked along the first axis; NumPy.

    Args:
        hand: the robot hand.
        T_world_palm: (T, 7) pose of its palm without correction.
        scene: the objects.
        contacts: the human's contacts.
        stamps: (T,) timestamps [s].
        settings: weights.
    """
    palm = poses.relative(scene.T_world_object, T_world_palm[None])  # (O, T, 7) T_object_palm
    valid = poses.is_valid(palm)
    safe = np.where(valid[..., None], palm, poses.IDENTITY)
    rows = [FINGERS.index(finger) for finger in hand.fingers]
    clearance = contacts.clearance[:, rows]
    touching = contacts.touching[:, rows]
    contact = _ramps(touching, stamps, settings.ramp)
    far = np.where(np.isfinite(clearance), np.clip(clearance, 0.0, settings.clear), -1.0)
    return ObjectFrame(
        np.moveaxis(poses.rotation_matrices(safe[..., 3:]), 0, 1),
        np.moveaxis(safe[..., :3], 0, 1),
        valid.T,
        contact,
        np.where(touching, -1.0, far),
        contacts.which[:, rows],
        contacts.place[:, rows],
        contacts.normal[:, rows],
    )


def _ramps(
    touching: Bool[np.ndarray, "T F"], stamps: Float[np.ndarray, " T"], ramp: float
) -> Float[np.ndarray, "T F"]:
    """Weights of contacts: 1 during a contact, with ramps before and after it."""
    out = touching.astype(float)
    if not ramp:
        return out
    for f in range(touching.shape[1]):
        at = stamps[touching[:, f]]
        if len(at):
            after = np.clip(np.searchsorted(at, stamps), 0, len(at) - 1)
            before = np.clip(after - 1, 0, None)
            gap = np.minimum(abs(stamps - at[after]), abs(stamps - at[before]))
            out[:, f] = np.clip(1.0 - gap / ramp, 0.0, 1.0)
    return out


class ObjectCosts:
    """Computes cost, gradient and Hessian of frames near objects, for one hand.

    Args:
        hand: the robot hand.
        settings: weights and bounds.
    """

    def __init__(self, hand: Hand, settings: ObjectSettings) -> None:
        self.hand, self.settings = hand, settings
        self.surface = HandSurface(hand)
        spheres = self.surface.spheres
        self.fingertips = self.surface.fingertips(spheres)
        self._centre = hand.align_points.mean(axis=0)

        def many(shapes: tuple[Shape, ...], x: Array, frame: ObjectFrame) -> Any:
            return jax.vmap(lambda one, at: self.frame_cost(shapes, one, at))(x, frame)

        self._costs: Callable[..., Any] = jax.jit(many)

    @property
    def limits(self) -> Float[np.ndarray, "6 2"]:
        """Bounds of the wrist's variables, in ``UNITS``."""
        settings = self.settings
        most = np.array([settings.shift] * 3 + [settings.turn] * 3) / UNITS
        return np.stack([-most, most], axis=1)

    def frame_cost(
        self, shapes: tuple[Shape, ...], x: Float[Array, " v"], frame: ObjectFrame
    ) -> tuple[Float[Array, ""], Float[Array, " v"], Float[Array, "v v"]]:
        """Cost, gradient and Gauss-Newton Hessian of one frame; traceable.

        Args:
            shapes: shapes of the O objects.
            x: (m + 6) joint positions [rad], then translation and rotation vector of the wrist's
                correction in ``UNITS``.
            frame: objects and contacts.
        """
        settings, joints = self.settings, self.hand.limits.shape[0]
        wrist = x[joints:] * jnp.asarray(UNITS, x.dtype)
        frames, slopes = self.surface.motion(x[:joints])
        spheres = self.surface.spheres
        share, radius = jnp.asarray(spheres.share, x.dtype), jnp.asarray(spheres.radius, x.dtype)
        body = jnp.asarray(spheres.body)
        points = jnp.einsum("ki,kic->kc", share, frames[body])
        clearance = self._distances(shapes, self._moved(points, wrist), frame) - radius
        deepest = jax.lax.top_k(-clearance, min(_DEEPEST, len(clearance)))[1]
        tips_of = [jnp.asarray(tip) for tip in self.fingertips]
        pads = jnp.stack([tip[jnp.argmin(clearance[tip])] for tip in tips_of])
        chosen = jnp.concatenate([deepest, pads])

        # Clearances of the chosen spheres and how the variables change them
        at = points[chosen]
        moved = self._moved(at, wrist)
        distance, normal = self._near(shapes, moved, frame)
        gap = distance - radius[chosen]
        motion = jnp.einsum("ki,kicm->kcm", share[chosen], slopes[body[chosen]])
        turned, turning = jax.jacfwd(lambda w: self._moved(at, w))(wrist), _rotation(wrist[3:])
        by_joint = jnp.einsum("cd,kdm->kcm", turning, motion)
        by_wrist = turned * jnp.asarray(UNITS, x.dtype)
        move = jnp.concatenate([by_joint, by_wrist], axis=-1)  # (C, 3, v) in the palm frame
        rows = jnp.einsum("kc,kcv->kv", normal, move)

        count = len(deepest)
        valid = frame.known.any()
        inside = jnp.maximum(settings.margin - gap[:count], 0.0)
        weight = jnp.where(valid, settings.penetration / TRANSITION, 0.0) * jnp.ones(count)
        total = _Sum.of(weight * (inside > 0), -inside, rows[:count])
        tip, tips = gap[count:], rows[count:]
        touch = jnp.where(valid, frame.contact, 0.0) * (settings.contact / TRANSITION)
        total += _Sum.huber(touch, tip, tips, settings.reach)
        keeps = valid & (frame.clear >= 0) & (frame.contact < 1)
        near = jnp.maximum(frame.clear - tip, 0.0)
        away = (1 - frame.contact) * (settings.apart / TRANSITION)
        total += _Sum.of(jnp.where(keeps & (near > 0), away, 0.0), -near, tips)

        # Offset along the surface, in the frame of the object that is touched
        turn = frame.rotation[frame.which]
        place = jnp.einsum("fij,fj->fi", turn, moved[count:]) + frame.translation[frame.which]
        off = place - frame.place - radius[pads][:, None] * frame.normal
        flat = jnp.eye(3) - frame.normal[:, :, None] * frame.normal[:, None, :]
        along = jnp.einsum("fij,fj->fi", flat, off)
        by = jnp.einsum("fij,fjk,fkv->fiv", flat, turn, move[count:])
        there = frame.known[frame.which]
        slip = jnp.where(there, frame.contact, 0.0) * (settings.place / TRANSITION)
        size = jnp.sqrt(1.0 + (along * along).sum(-1) / settings.slip**2)
        cost = (slip * settings.slip**2 * (size - 1.0)).sum()
        total += _Sum(
            cost,
            jnp.einsum("f,fi,fiv->v", slip / size, along, by),
            jnp.einsum("f,fiv,fiu->vu", slip / size, by, by),
        )
        lever = jnp.asarray(np.array([1.0] * 3 + [settings.lever] * 3), x.dtype)
        arms = jnp.asarray(UNITS, x.dtype) * lever
        pull = jnp.full(6, settings.wrist / TRANSITION, x.dtype)
        arm_rows = jnp.concatenate([jnp.zeros((6, joints)), jnp.diag(arms)], axis=1)
        total += _Sum.of(pull, wrist * lever, arm_rows)
        return total.cost, total.gradient, total.hessian

    def _moved(self, points: Array, wrist: Array) -> Array:
        """Moves points of the palm frame by the wrist's correction, about the palm's centre."""
        centre = jnp.asarray(self._centre, points.dtype)
        moved: Array = (points - centre) @ _rotation(wrist[3:]).T + centre + wrist[:3]
        return moved

    def _distances(self, shapes: tuple[Shape, ...], points: Array, frame: ObjectFrame) -> Array:
        """Signed distances from the nearest object [m]."""
        every = []
        for index, shape in enumerate(shapes):
            local = points @ frame.rotation[index].T + frame.translation[index]
            distance = signed_distance(shape, local)
            every.append(jnp.where(frame.known[index], distance, FAR_M))
        nearest: Array = jnp.stack(every).min(axis=0)
        return nearest

    def _near(
        self, shapes: tuple[Shape, ...], points: Array, frame: ObjectFrame
    ) -> tuple[Array, Array]:
        """Signed distances from the nearest object [m], and their gradients in the palm frame."""

        def one(point: Array) -> Array:
            return self._distances(shapes, point[None], frame)[0]

        both: tuple[Array, Array] = jax.vmap(jax.value_and_grad(one))(points)
        return both

    def all_costs(
        self, shapes: tuple[Shape, ...], x: Float[np.ndarray, "T v"], frames: ObjectFrame
    ) -> tuple[Float[np.ndarray, " T"], Float[np.ndarray, "T v"], Float[np.ndarray, "T v v"]]:
        """Costs, gradients and Hessians of many frames, on the host."""
        parts = []
        for start in range(0, len(x), CHUNK):
            rows = np.minimum(np.arange(start, start + CHUNK), len(x) - 1)
            chunk = jax.tree.map(lambda values, rows=rows: _narrow(values[rows]), frames)
            parts.append(self._costs(shapes, x[rows].astype(np.float32), chunk))
        cost, gradient, hessian = (
            np.concatenate([np.asarray(p, np.float64) for p in column])[: len(x)]
            for column in zip(*parts, strict=True)
        )
        return cost, gradient, hessian


def _narrow(values: np.ndarray) -> np.ndarray:
    return values.astype(np.float32) if values.dtype == np.float64 else values


class _Sum(NamedTuple):
    """A cost with its gradient and Hessian."""

    cost: Array
    gradient: Array
    hessian: Array

    @classmethod
    def of(cls, weight: Array, error: Array, rows: Array) -> _Sum:
        """Half the weighted sum of squared errors; ``rows`` are the errors' derivatives."""
        return cls(
            0.5 * (weight * error * error).sum(),
            (weight * error) @ rows,
            (rows * weight[:, None]).T @ rows,
        )

    @classmethod
    def huber(cls, weight: Array, error: Array, rows: Array, scale: float) -> _Sum:
        """Weighted sum of errors that count quadratically up to a scale and linearly beyond it."""
        size = jnp.sqrt(1.0 + (error / scale) ** 2)
        part = cls.of(weight / size, error, rows)
        return part._replace(cost=(weight * scale**2 * (size - 1.0)).sum())

    def __add__(self, other: _Sum) -> _Sum:  # type: ignore[override]
        return _Sum(
            self.cost + other.cost, self.gradient + other.gradient, self.hessian + other.hessian
        )


def _rotation(vector: Float[Array, "3"]) -> Float[Array, "3 3"]:
    """Rotation about a vector by its length [rad] (Rodrigues); differentiable at zero."""
    angle = jnp.sqrt((vector * vector).sum() + 1e-12)
    x, y, z = vector
    cross = jnp.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    sine, half = jnp.sin(angle) / angle, jnp.sin(0.5 * angle) / angle
    return jnp.eye(3) + sine * cross + 2.0 * half**2 * (cross @ cross)
