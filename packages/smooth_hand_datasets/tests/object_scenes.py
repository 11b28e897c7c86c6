"""Clips of a human hand at an object whose geometry is known, made by code.

A hand of published anatomy (``smooth_operator.synthetic``) approaches an object, touches it with
some fingertips, moves it, and releases it. Fingertips are spheres; inverse kinematics puts them on
chosen points of the object's surface, and its residual is part of the clip: the contacts of record
are measured in the finished clip, from the shapes alone.

Kinds: *grasp* with all fingers and lift; *pinch* of thumb and index; *twist*, where the object
turns in a grip of three; *slide*, where the index moves along an object that others hold, leaves it
and comes back.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, Literal, TypeAlias, get_args

import numpy as np
from jaxtyping import Float

from smooth_hand_datasets.objects.contacts import Contacts, Scene, nearest_object, pad_centres
from smooth_hand_datasets.objects.placement import landmarks_in_world
from smooth_hand_datasets.objects.signed_distance import (
    Box,
    Capsule,
    Cylinder,
    Mesh,
    Solid,
    Sphere,
    signed_distance,
)
from smooth_operator import poses
from smooth_operator.errors import ConfigError
from smooth_operator.formats.clip import Clip, ObjectTrack
from smooth_operator.landmarks import TIPS
from smooth_operator.synthetic.hand_anatomy import (
    FREE,
    LOWER,
    UPPER,
    HandAnatomy,
    HandPoses,
    couple,
    draw_anatomy,
    mirror,
    pose_hand,
)
from smooth_operator.types import HandRecording, Side

FREE_M: Final = 0.012
"""Clearance that fingertips keep that do not touch [m]."""

_PRIOR: Final = np.radians(
    [12.0, 20.0, 12.0, 15.0, 2.0, 45.0, 40.0, 0.0, 48.0, 42.0, 0.0, 50.0, 42.0, -2.0, 48.0, 40.0]
)
_FREE_FINGER: Final = np.radians([0.0, 12.0, 12.0])  # one that touches nothing
_ROUNDS: Final = 25
_NUDGE: Final = 1e-5
_FIT_M: Final = 0.0005  # a fingertip's error counts in units of this
_POSTURE: Final = 1.2  # and an angle's distance from the prior in units of this [rad]


class GraspingHand:
    """A human hand at an object, for inverse kinematics; the hand's own frame."""

    def __init__(
        self, anatomy: HandAnatomy, pad: float, solid: Solid, used: tuple[int, ...]
    ) -> None:
        self.anatomy, self.pad, self.solid, self.used = anatomy, pad, solid, used
        self.low, self.high = LOWER[list(FREE)], UPPER[list(FREE)]
        self.prior = _PRIOR.copy()
        for finger in set(range(5)) - set(used):
            self.prior[4 + 3 * (finger - 1) : 7 + 3 * (finger - 1)] = _FREE_FINGER
        self.idle = [f for f in range(5) if f not in used]

    def landmarks(self, angles: Float[np.ndarray, "n 16"]) -> Float[np.ndarray, "n 21 3"]:
        """[m]."""
        return pose_hand(self.anatomy, couple(angles)).landmarks

    def contact_points(self, heights: Float[np.ndarray, "5"]) -> Float[np.ndarray, "5 3"]:
        """Where fingertips touch: fingers from +x, the thumb from -x, at heights along z [m]."""
        points = np.zeros((5, 3))
        for finger, height in enumerate(heights):
            way = np.array([-1.0 if finger == 0 else 1.0, 0.0, 0.0])
            start = np.array([0.0, 0.0, height])
            if isinstance(self.solid.shape, Sphere):  # towards the middle
                angle = height / float(self.solid.shape.radius)
                way = way * np.cos(angle) + np.array([0.0, 0.0, np.sin(angle)])
                start = np.zeros(3)
            at = start + 0.3 * way
            for _ in range(60):  # sphere tracing
                at = at - way * float(self.solid.distance(at[None])[0])
            points[finger] = at
        return points

    def grip(
        self, touch: Float[np.ndarray, "5 3"]
    ) -> tuple[Float[np.ndarray, "7"], Float[np.ndarray, "16"]]:
        """Pose of the object in the hand, and angles, so that fingertips touch."""
        first = self.landmarks(self.prior[None])[0][list(TIPS)]
        across = first[[f for f in self.used if f]].mean(axis=0) - first[0]
        x = across / np.linalg.norm(across)
        z = np.array([0.0, 1.0, 0.0]) - x[1] * x
        z /= np.linalg.norm(z)
        start = np.stack([x, np.cross(z, x), z], axis=-1)
        middle = 0.5 * (first[0] + first[[f for f in self.used if f]].mean(axis=0))
        pose = np.concatenate([middle, poses.quaternions(start)])

        def placed(rest: np.ndarray) -> np.ndarray:
            turn = poses.multiply(
                np.broadcast_to(pose[3:], (len(rest), 4)), poses.from_rotation_vectors(rest[:, 3:])
            )
            return np.concatenate([pose[:3] + rest[:, :3], turn], axis=-1)

        def residuals(x: np.ndarray) -> np.ndarray:
            angles, rest = x[:, :16], x[:, 16:]
            inside = placed(rest)
            many = np.broadcast_to(touch, (len(x), 5, 3))
            own = self._residuals(angles, inside, many, np.zeros((len(x), 5)))
            return np.concatenate([own, rest[:, 3:] / 0.5], axis=1)

        low = np.concatenate([self.low, np.full(3, -0.1), np.full(3, -0.8)])
        begin = np.concatenate([self.prior, np.zeros(6)])[None]
        solution = _least_squares(residuals, begin, low, np.concatenate([self.high, -low[16:]]), 60)
        return placed(solution[:, 16:])[0], solution[0, :16]

    def follow(
        self,
        inside: Float[np.ndarray, "T 7"],
        places: Float[np.ndarray, "T 5 3"],
        gaps: Float[np.ndarray, "T 5"],
        start: Float[np.ndarray, "16"],
    ) -> Float[np.ndarray, "T 16"]:
        """Angles of all frames, each for itself."""
        extra = [inside, places, gaps]

        def residuals(x: np.ndarray) -> np.ndarray:
            times = len(x) // len(inside)
            return self._residuals(x, *(np.concatenate([e] * times) for e in extra))

        begin = np.tile(start, (len(inside), 1))
        return _least_squares(residuals, begin, self.low, self.high, _ROUNDS)

    def _residuals(
        self,
        angles: Float[np.ndarray, "n 16"],
        inside: Float[np.ndarray, "n 7"],
        places: Float[np.ndarray, "n 5 3"],
        gaps: Float[np.ndarray, "n 5"],
    ) -> Float[np.ndarray, "n R"]:
        landmarks = self.landmarks(angles)
        centres = pad_centres(landmarks, self.pad)
        back = poses.invert(inside)

        def local(points: np.ndarray) -> np.ndarray:
            return np.asarray(poses.rotate(back[:, None, 3:], points) + back[:, None, :3])

        at = local(centres)
        used = list(self.used)
        normal = self._normals(places[:, used])
        goals = places[:, used] + (self.pad + gaps[:, used])[..., None] * normal
        reach = (at[:, used] - goals) / np.where(gaps[:, used] > 1e-6, 4.0, 1.0)[..., None] / _FIT_M
        posture = (angles - self.prior) / _POSTURE
        parts = [reach.reshape(len(at), -1), posture]
        if self.idle:
            free = signed_distance(self.solid.shape, at[:, self.idle]) - self.pad - FREE_M
            parts.append(np.minimum(free, 0.0) / 0.002)
        # The bones but the last, and the palm, stay out of the object
        bones = [f for first in (2, 6, 10, 14, 18) for f in (first, first + 1)]
        ends = landmarks[:, bones]
        middles = 0.5 * (landmarks[:, bones] + landmarks[:, [b - 1 for b in bones]])
        solid = local(np.concatenate([ends, middles], axis=1))
        depth = signed_distance(self.solid.shape, solid) - self.pad
        parts.append(np.minimum(depth, 0.0) / 0.002)
        return np.concatenate(parts, axis=1)

    def _normals(self, places: np.ndarray) -> np.ndarray:
        """Outward normals at points of the surface, from a little outside."""
        step = 1e-5
        slopes = [
            signed_distance(self.solid.shape, places + step * e)
            - signed_distance(self.solid.shape, places - step * e)
            for e in np.eye(3)
        ]
        normal = np.stack(slopes, axis=-1)
        unit: np.ndarray = normal / np.maximum(
            np.linalg.norm(normal, axis=-1, keepdims=True), 1e-12
        )
        return unit


def _least_squares(
    residuals: Callable[[np.ndarray], np.ndarray],
    start: Float[np.ndarray, "n v"],
    low: Float[np.ndarray, " v"],
    high: Float[np.ndarray, " v"],
    rounds: int,
) -> Float[np.ndarray, "n v"]:
    """Levenberg and Marquardt's steps for many problems of one form, within bounds."""
    x = np.clip(start, low, high)
    count, size = x.shape
    damping = np.full(count, 1e-2)
    error = residuals(x)
    cost = (error**2).sum(axis=1)
    for _ in range(rounds):
        nudged = np.concatenate([x + _NUDGE * e for e in np.eye(size)])
        slopes = (residuals(nudged).reshape(size, count, -1) - error) / _NUDGE
        jacobian = np.moveaxis(slopes, 0, -1)  # (n, R, v)
        pull = -np.einsum("nrv,nr->nv", jacobian, error)
        stuck = ((x <= low) & (pull < 0)) | ((x >= high) & (pull > 0))
        jacobian = jacobian * ~stuck[:, None]
        hessian = np.swapaxes(jacobian, 1, 2) @ jacobian
        scale = damping[:, None] * (1.0 + np.einsum("nvv->nv", hessian))
        hessian += (scale + stuck)[:, :, None] * np.eye(size)
        step = np.linalg.solve(hessian, (pull * ~stuck)[..., None])[..., 0]
        new = np.clip(x + np.clip(step, -0.3, 0.3), low, high)
        trial = residuals(new)
        value = (trial**2).sum(axis=1)
        better = value < cost
        x, cost = np.where(better[:, None], new, x), np.where(better, value, cost)
        error = np.where(better[:, None], trial, error)
        damping = np.clip(np.where(better, damping / 5, damping * 5), 1e-9, 1e6)
    return np.asarray(x)


Kind: TypeAlias = Literal["grasp", "pinch", "twist", "slide"]
Form: TypeAlias = Literal["sphere", "box", "cylinder", "capsule", "mesh"]

PAD_SHARE: Final = 0.0395
"""Radius of a fingertip over the length of the hand: 7.5 mm at 0.19 m."""
TRUE_M: Final = 0.001
"""Clearance of a fingertip that touches, in the contacts of record [m]."""

_PARTS: Final = (0.8, 0.4, 1.2, 0.6)  # approach, hold, motion, release [s]
_GAP_M: Final = 0.035  # of the open hand
_AWAY_M: Final = np.array([0.01, 0.0, 0.07])  # palmar and distal of the grip, before and after it
_LIFT_M: Final = 0.08
_TWIST: Final = np.radians(12.0)
_SLIDE_M: Final = 0.012
_SPACING: Final = 0.105  # of fingertips over the length of the hand
_USED: Final = {
    "grasp": (0, 1, 2, 3, 4),
    "pinch": (0, 1),
    "twist": (0, 1, 2),
    "slide": (0, 1, 2, 3),
}


@dataclass(frozen=True)
class SceneSpec:
    """What is made.

    Attributes:
        kind: what the hand does.
        form: of the object.
        seed: of the person, the object's size and the motion.
        side: which hand.
        noise: standard deviation of each landmark's coordinate in each frame [m]; 0 for none.
        rate: frames a second [Hz].
    """

    kind: Kind = "pinch"
    form: Form = "box"
    seed: int = 0
    side: Side = "right"
    noise: float = 0.0
    rate: float = 60.0

    def __post_init__(self) -> None:
        if self.kind not in get_args(Kind) or self.form not in get_args(Form):
            raise ConfigError(
                f"a scene is one of {', '.join(get_args(Kind))} with one of "
                f"{', '.join(get_args(Form))}, not {self.kind!r} with {self.form!r}"
            )

    @property
    def name(self) -> str:
        """Such as ``twist-cylinder-3-right``."""
        return f"{self.kind}-{self.form}-{self.seed}-{self.side}"


@dataclass(frozen=True, eq=False)
class MadeClip:
    """A clip with what is known of it.

    Attributes:
        clip: hand and object; the object has no file of a mesh.
        solids: its shape by its name.
        scene: the same with the poses.
        truth: contacts of record: ``touching`` is a clearance of at most ``TRUE_M``.
        pad_radius: of the fingertips [m].
    """

    clip: Clip
    solids: dict[str, Solid]
    scene: Scene
    truth: Contacts
    pad_radius: float


def make_clip(spec: SceneSpec) -> MadeClip:
    """Makes a clip; the same for the same settings."""
    rng = np.random.default_rng([spec.seed, *spec.kind.encode(), *spec.form.encode()])
    length = float(rng.uniform(0.17, 0.205))
    anatomy, pad = draw_anatomy(length, spec.seed), PAD_SHARE * length
    solid = _object(spec, rng)
    hand = GraspingHand(anatomy, pad, solid, _USED[spec.kind])
    touch = hand.contact_points(_spread(spec, length))
    grip, angles = hand.grip(touch)

    # The object in the frame of the hand, what is touched, and how far fingertips are from it
    stamps = np.arange(round(sum(_PARTS) * spec.rate)) / spec.rate
    opening, action, lift = _timeline(stamps)
    count = len(stamps)
    turn = _TWIST * np.sin(2 * np.pi * action) * (spec.kind == "twist")
    about = poses.from_rotation_vectors(turn[:, None] * np.array([0.0, 0.0, 1.0]))
    inside = poses.compose(
        np.tile(grip, (count, 1)), np.concatenate([np.zeros((count, 3)), about], 1)
    )
    inside[:, :3] += opening[:, None] * _AWAY_M * rng.uniform(0.8, 1.2)
    places = np.repeat(touch[None], count, axis=0)
    gaps = np.repeat(_GAP_M * opening[:, None], 5, axis=1)
    if spec.kind == "slide":
        along = _SLIDE_M * np.sin(2 * np.pi * np.clip(action / 0.6, 0, 1))
        moved = places[:, 1] + along[:, None] * np.array([0.0, 0.0, 1.0])
        places[:, 1] = solid.nearest(moved)[1]
        gaps[:, 1] += 0.025 * np.sin(np.pi * np.clip((action - 0.65) / 0.3, 0, 1)) ** 2
    angles = hand.follow(inside, places, gaps, angles)

    shape = pose_hand(anatomy, couple(angles))
    shape = shape if spec.side == "right" else mirror(shape)
    if spec.side == "left":  # the objects are their own mirror images in y
        inside = inside * np.array([1.0, -1.0, 1.0, 1.0, -1.0, 1.0, -1.0])
    own = poses.wrist_from_landmarks(shape.landmarks, spec.side)
    world = _object_in_world(lift, rng)
    wrist = poses.compose(poses.compose(world, poses.invert(inside)), own)
    landmarks = shape.landmarks + spec.noise * rng.normal(size=shape.landmarks.shape)
    recording = HandRecording(
        landmarks,
        stamps,
        spec.side,
        T_world_wrist=wrist,
        world="scene",
        name=spec.name,
    )
    track = ObjectTrack(spec.form, world)
    clip = Clip(spec.name, {spec.side: recording}, "scene", task=spec.kind, objects=(track,))
    scene = Scene((spec.form,), (solid,), world[None])
    return MadeClip(
        clip, {spec.form: solid}, scene, _truth(clip, spec.side, scene, shape, own, pad), pad
    )


def _truth(
    clip: Clip,
    side: Side,
    scene: Scene,
    shape: HandPoses,
    own: Float[np.ndarray, "T 7"],
    pad: float,
) -> Contacts:
    """Contacts of the hand without noise, from the shapes alone."""
    wrist = clip.hands[side].T_world_wrist
    assert wrist is not None
    moved = poses.compose(wrist, poses.invert(own))
    exact = HandRecording(
        poses.rotate(moved[:, None, 3:], shape.landmarks) + moved[:, None, :3],
        clip.stamps,
        side,
        T_world_wrist=wrist,
    )
    centres = pad_centres(landmarks_in_world(exact), pad)
    distance, which, place, normal = nearest_object(centres, scene)
    return Contacts(distance - pad, distance - pad <= TRUE_M, which, place, normal)


def _object(spec: SceneSpec, rng: np.random.Generator) -> Solid:
    """An object that fits the grip."""
    low, high = {"grasp": (22, 32), "pinch": (8, 16), "twist": (14, 24), "slide": (10, 18)}[
        spec.kind
    ]
    thick = 1e-3 * float(rng.uniform(low, high))
    long = 1e-3 * float(rng.uniform(45, 60)) if spec.kind != "pinch" else 2.2 * thick
    if spec.form == "sphere":
        return Solid(Sphere(1.25 * thick))
    if spec.form == "box":
        return Solid(Box(np.array([thick, 1.2 * thick, long])))
    if spec.form == "cylinder":
        return Solid(Cylinder(thick, long))
    if spec.form == "capsule":
        return Solid(Capsule(thick, long - thick))
    mesh = bumpy_mesh(thick, long)
    return Solid(mesh.grid(), mesh)


def bumpy_mesh(radius: float, half: float, around: int = 64, rows: int = 48) -> Mesh:
    """A closed surface about z with a waist and three bulges, which is not convex.

    Args:
        radius: mean radius [m].
        half: half of its length along z [m].
        around: vertices of a ring.
        rows: rings.
    """
    z = np.linspace(-1.0, 1.0, rows)
    angle = np.linspace(0.0, 2 * np.pi, around, endpoint=False)
    profile = (1.0 - 0.14 * np.cos(np.pi * z)) * np.clip(1.0 - np.abs(z) ** 8, 0.3, None)
    size = radius * profile[:, None] * (1.0 + 0.07 * np.cos(3 * angle))
    ring = np.stack([size * np.cos(angle), size * np.sin(angle)], axis=-1)
    height = np.broadcast_to((half * z)[:, None, None], (rows, around, 1))
    vertices = np.concatenate([ring, height], axis=-1).reshape(-1, 3)
    i, j = np.meshgrid(np.arange(rows - 1), np.arange(around), indexing="ij")
    a, b = i * around + j, i * around + (j + 1) % around
    sides = np.concatenate(
        [np.stack([a, b, b + around], -1), np.stack([a, b + around, a + around], -1)]
    ).reshape(-1, 3)
    k = np.arange(around)
    bottom, top = len(vertices), len(vertices) + 1
    last = (rows - 1) * around
    caps = [
        np.stack([np.full(around, bottom), (k + 1) % around, k], axis=-1),
        np.stack([np.full(around, top), last + k, last + (k + 1) % around], axis=-1),
    ]
    poles = np.array([[0.0, 0.0, -half], [0.0, 0.0, half]])
    return Mesh(np.concatenate([vertices, poles]), np.concatenate([sides, *caps]))


def _spread(spec: SceneSpec, length: float) -> Float[np.ndarray, "5"]:
    """Heights of the contacts along the object [m], thumb first; the index is uppermost."""
    space = _SPACING * length
    if spec.kind == "pinch":
        return np.zeros(5)
    rows = {"grasp": (0.9, 1.5, 0.5, -0.5, -1.5), "twist": (0.0, 0.5, -0.5, -1.5, -2.5)}
    return space * np.array(rows.get(spec.kind, (0.0, 1.0, 0.0, -1.0, -2.0)))


def _timeline(
    stamps: Float[np.ndarray, " T"],
) -> tuple[Float[np.ndarray, " T"], Float[np.ndarray, " T"], Float[np.ndarray, " T"]]:
    """How far the hand is open (1 to 0), how far the motion is done, and the lift, 0 to 1."""
    ends = np.cumsum(_PARTS)
    closing = _minimum_jerk(stamps / ends[0])
    releasing = _minimum_jerk((stamps - ends[2]) / _PARTS[3])
    action = np.clip((stamps - ends[1]) / _PARTS[2], 0.0, 1.0)
    lift = _minimum_jerk((stamps - ends[0]) / (ends[2] - ends[0]))
    return 1.0 - closing + releasing, action, lift


def _minimum_jerk(share: Float[np.ndarray, " T"]) -> Float[np.ndarray, " T"]:
    s = np.clip(share, 0.0, 1.0)
    return np.asarray(10 * s**3 - 15 * s**4 + 6 * s**5)


def _object_in_world(
    lift: Float[np.ndarray, " T"], rng: np.random.Generator
) -> Float[np.ndarray, "T 7"]:
    """The object stands, is lifted and turned a little, and stands again."""
    axis = rng.normal(size=3)
    turn = 0.4 * lift[:, None] * axis / np.linalg.norm(axis)
    first = poses.from_rotation_vectors(rng.uniform(-0.5, 0.5, (1, 3)))
    rise = np.stack([0.3 + 0 * lift, 0.05 * lift, 0.9 + _LIFT_M * lift], axis=-1)
    rotation = poses.multiply(
        np.broadcast_to(first, (len(lift), 4)), poses.from_rotation_vectors(turn)
    )
    return np.concatenate([rise, rotation], axis=-1)
