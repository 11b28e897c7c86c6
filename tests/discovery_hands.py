"""Random robot hands whose names say nothing, with what is true of each, as URDF or MJCF text."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from smooth_operator.hand_discovery.discover import discover
from smooth_operator.hand_discovery.landmarks import Discovery
from smooth_operator.hands.loading import load_model

Vector = np.ndarray


@dataclass(frozen=True)
class Part:
    """One body: where it is in its parent, and the joint between them."""

    name: str
    parent: str | None
    position: Vector
    rotation: Vector = field(default_factory=lambda: np.eye(3))
    axis: Vector | None = None
    joint: str = ""
    limits: tuple[float, float] = (0.0, 1.0)
    slide: bool = False
    end: Vector | None = None  # a capsule from the origin to here
    radius: float = 0.006
    mimic: tuple[str, float, float] | None = None


@dataclass(frozen=True)
class Truth:
    """What is to be found.

    ``tips`` are last bodies and points in their frames, thumb first, then from the thumb's side.
    """

    side: str
    palm: str
    tips: tuple[tuple[str, Vector], ...]


@dataclass(frozen=True)
class Model:
    parts: tuple[Part, ...]
    truth: Truth


def make_hand(
    seed: int,
    *,
    fingers: int = 5,
    side: str = "right",
    joints: int = 3,
    shapes: bool = True,
    arm: int = 0,
    coupled: bool = False,
    turned: bool = True,
    prefix: str = "",
) -> Model:
    """A hand of random proportions.

    Drawn up as a right hand with fingers along z, palm to -y, thumb at +x, then mirrored if need
    be, and every frame turned at random. Half of the joints count the other way round, unless some
    are coupled.
    """
    rng = np.random.default_rng(seed)
    size = rng.uniform(0.7, 1.5)
    palm = f"{prefix}palm"
    parts = [Part(palm, None, np.zeros(3), end=np.array([0, 0, 0.07]) * size, radius=0.02 * size)]
    tips: list[tuple[str, Vector]] = []
    label = iter(range(1000))
    x, y, z = np.eye(3)

    def chain(base: Vector, steps: list[tuple[Vector, float, Vector, float]], last: Vector) -> None:
        """Steps: (way to the next joint, lower limit, axis, upper limit); the last link ends at
        ``last``."""
        parent, offset, leader = palm, base, ""
        for k, (following, low, axis, high) in enumerate(steps):
            name, joint = f"{prefix}b{next(label)}", f"{prefix}j{next(label)}"
            axis = axis + rng.normal(0, 0.04, 3)
            final = k == len(steps) - 1
            end = last if final else following
            part = Part(name, parent, offset, axis=axis / np.linalg.norm(axis), joint=joint)
            drawn = end if np.linalg.norm(end) > 0.004 else None
            mimic = (leader, 0.9, 0.05) if coupled and final and leader else None
            parts.append(replace(part, limits=(low, high), end=drawn, mimic=mimic))
            parent, offset, leader = name, following, joint
        tips.append((parent, last))

    # thumb: turns about the length of the hand, then bends in a plane of its own
    length = 0.045 * size
    out = np.array([0.8, 0.0, 0.6])
    bends = [(out * length * s, -0.1, -y, 1.3) for s in (1.0, 0.8)[: max(joints - 1, 1)]]
    base = np.array([0.028, -0.012, 0.02]) * size
    chain(base, [(out * 0.012 * size, -0.2, -z, 1.7), *bends], out * length * 0.7)
    width = 0.009 * (fingers - 2)
    for k in range(fingers - 1):
        across = 0.0 if fingers == 2 else 1 - 2 * k / (fingers - 2)
        base = np.array([across * width, 0.0, 0.085 - 0.008 * across**2]) * size
        scale = size * rng.uniform(0.85, 1.1)
        along = np.array([0.08 * across, 0.0, 1.0])
        segments = (0.042, 0.028, 0.022)[:joints]
        bends = [(along * s * scale, -0.1, x, 1.6) for s in segments]
        chain(base, [(np.zeros(3), -0.3, y, 0.3), *bends], along * segments[-1] * scale * 0.95)

    body = {p.name: p for p in parts}
    if side == "left":
        body = {name: mirrored(p) for name, p in body.items()}
        tips = [(name, tip * (-1, 1, 1)) for name, tip in tips]
    if not coupled:
        body = {
            name: flipped(p) if p.axis is not None and rng.random() < 0.5 else p
            for name, p in body.items()
        }
    if turned:
        body, tips = scrambled(body, tips, rng)
    if not shapes:
        body = {name: replace(p, end=None) for name, p in body.items()}
    top, arms = None, []
    for k in range(arm):
        link = Part(f"{prefix}a{k}", top, np.array([0.0, 0.02, 0.25]), axis=np.eye(3)[k % 3])
        joint, top = f"{prefix}aj{k}", link.name
        arms.append(replace(link, joint=joint, limits=(-2.5, 2.5), end=0.2 * z, radius=0.03))
    place = Rotation.from_rotvec(rng.normal(size=3)).as_matrix() if turned else np.eye(3)
    body[palm] = replace(body[palm], parent=top, rotation=place)
    return Model((*arms, *body.values()), Truth(side, palm, tuple(tips)))


def mirrored(part: Part) -> Part:
    flip = np.array([-1.0, 1.0, 1.0])
    return replace(
        part,
        position=part.position * flip,
        axis=None if part.axis is None else part.axis * (1, -1, -1),
        end=None if part.end is None else part.end * flip,
    )


def flipped(part: Part) -> Part:
    """The same joint, counted the other way round."""
    low, high = part.limits
    return replace(part, axis=-part.axis, limits=(-high, -low))


def scrambled(
    body: dict[str, Part], tips: list[tuple[str, Vector]], rng: np.random.Generator
) -> tuple[dict[str, Part], list[tuple[str, Vector]]]:
    """Every body's own frame turned at random: nothing can be read off an axis of a frame."""
    turn = {name: Rotation.random(random_state=rng).as_matrix() for name in body}
    out = {}
    for name, part in body.items():
        above = turn[part.parent] if part.parent else np.eye(3)
        own = turn[name]
        out[name] = replace(
            part,
            position=above.T @ part.position,
            rotation=above.T @ part.rotation @ own,
            axis=None if part.axis is None else own.T @ part.axis,
            end=None if part.end is None else own.T @ part.end,
        )
    return out, [(name, turn[name].T @ tip) for name, tip in tips]


def urdf(parts: tuple[Part, ...], *, mesh: str = "") -> str:
    """As URDF; ``mesh`` is the file name of a mesh that every link also has."""
    lines = ['<robot name="r">']
    roots = [p for p in parts if p.parent is None]
    root = "root" if len(roots) > 1 or roots[0].axis is not None else None
    if root:
        lines.append('<link name="root"/>')
    for p in parts:
        lines.append(f'<link name="{p.name}">')
        if p.end is not None:
            rpy = _along(p.end).as_euler("xyz")
            half, length = p.end / 2, np.linalg.norm(p.end)
            lines.append(
                f'<collision><origin xyz="{_text(half)}" rpy="{_text(rpy)}"/><geometry>'
                f'<cylinder radius="{p.radius}" length="{length}"/></geometry></collision>'
            )
        if mesh:
            lines.append(f'<collision><geometry><mesh filename="{mesh}"/></geometry></collision>')
        lines.append("</link>")
        parent = p.parent or root
        if parent is None:
            continue
        kind = "fixed" if p.axis is None else "prismatic" if p.slide else "revolute"
        rpy = Rotation.from_matrix(p.rotation).as_euler("xyz")
        lines.append(
            f'<joint name="{p.joint or p.name + "_fix"}" type="{kind}"><parent link="{parent}"/>'
            f'<child link="{p.name}"/><origin xyz="{_text(p.position)}" rpy="{_text(rpy)}"/>'
        )
        if p.axis is not None:
            lines.append(
                f'<axis xyz="{_text(p.axis)}"/><limit lower="{p.limits[0]}" upper="{p.limits[1]}" '
                'effort="1" velocity="1"/>'
            )
        if p.mimic:
            leader, gain, offset = p.mimic
            lines.append(f'<mimic joint="{leader}" multiplier="{gain}" offset="{offset}"/>')
        lines.append("</joint>")
    return "\n".join([*lines, "</robot>"])


def mjcf(parts: tuple[Part, ...], *, tips: Sequence[tuple[str, Vector]] = ()) -> str:
    """As MJCF, with capsules for shapes, and with sites at ``tips``."""
    children: dict[str | None, list[Part]] = {}
    for p in parts:
        children.setdefault(p.parent, []).append(p)
    marks = dict(tips)

    def body(p: Part) -> str:
        quat = Rotation.from_matrix(p.rotation).as_quat(scalar_first=True)
        text = f'<body name="{p.name}" pos="{_text(p.position)}" quat="{_text(quat)}">'
        if p.axis is not None:
            kind = "slide" if p.slide else "hinge"
            text += (
                f'<joint name="{p.joint}" type="{kind}" axis="{_text(p.axis)}" '
                f'range="{p.limits[0]} {p.limits[1]}"/>'
            )
        if p.end is not None:
            text += f'<geom type="capsule" size="{p.radius}" fromto="0 0 0 {_text(p.end)}"/>'
        else:
            text += '<inertial pos="0 0 0" mass="0.01" diaginertia="1e-6 1e-6 1e-6"/>'
        if p.name in marks:
            text += f'<site name="s_{p.name}" pos="{_text(marks[p.name])}"/>'
        return text + "".join(body(c) for c in children.get(p.name, [])) + "</body>"

    equalities = "".join(
        f'<joint joint1="{p.joint}" joint2="{p.mimic[0]}" '
        f'polycoef="{p.mimic[2]} {p.mimic[1]} 0 0 0"/>'
        for p in parts
        if p.mimic
    )
    return (
        '<mujoco><compiler angle="radian" autolimits="true"/><worldbody>'
        + "".join(body(p) for p in children[None])
        + f"</worldbody><equality>{equalities}</equality></mujoco>"
    )


def _along(end: Vector) -> Rotation:
    """A rotation that takes z to a direction."""
    return Rotation.align_vectors([end / np.linalg.norm(end)], [[0.0, 0.0, 1.0]])[0]


def _text(values: Vector) -> str:
    return " ".join(repr(float(v)) for v in values)


def claw() -> tuple[Part, ...]:
    """A gripper of two fingers on slides."""
    end, parts = np.array([0.0, 0.0, 0.05]), [Part("hand", None, np.zeros(3))]
    parts[0] = replace(parts[0], end=end)
    for name, sign in (("lf", 1.0), ("rf", -1.0)):
        axis, at = np.array([0.0, sign, 0.0]), np.array([0, 0.01 * sign, 0.06])
        parts.append(
            Part(name, "hand", at, axis=axis, joint=name, limits=(0.0, 0.04), slide=True, end=end)
        )
    return tuple(parts)


def ring_of_fingers(radius: float, length: float = 0.05, closed: float = 0.9) -> tuple[Part, ...]:
    """Three equal fingers in a ring that close on its middle."""
    parts = [Part("base", None, np.zeros(3))]
    up = np.array([0.0, 0.0, length])
    for k in range(3):
        out = np.array([np.cos(2.1 * k), np.sin(2.1 * k), 0.0])
        axis = np.array([-out[1], out[0], 0.0])
        for name, parent, at in ((f"a{k}", "base", radius * out), (f"b{k}", f"a{k}", up)):
            parts.append(
                Part(name, parent, at, axis=axis, joint=f"j{name}", end=up, limits=(-1.3, closed))
            )
    return tuple(parts)


def written(folder: Path, text: str, name: str = "model.urdf") -> Path:
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


def found_in(folder: Path, text: str, name: str = "model.urdf", **options: Any) -> Discovery:
    """What is found in the text of a model."""
    return discover(written(folder, text, name), **options)


def sure(found: Discovery, subject: str) -> float:
    return next(f.confidence for f in found.findings if f.subject == subject)


def because(found: Discovery, subject: str) -> str:
    return " ".join(next(f.evidence for f in found.findings if f.subject == subject))


def check(found: Discovery, hand: Model) -> None:
    """Palm, side, thumb and the order of the fingers are true."""
    assert found.spec.palm == hand.truth.palm
    assert found.spec.side == hand.truth.side
    last = [body for body, _ in hand.truth.tips]
    assert [f.tip_body.removesuffix("_tip") for f in found.fingers] == last


def tip_errors(found: Discovery, truth: Sequence[tuple[str, Any]]) -> Vector:
    """Distances of the tips found from the true ones, thumb first [m]."""
    model = load_model(found.spec.model).model
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)

    def world(body: str, offset: Any) -> Vector:
        at = data.body(body)
        return at.xpos + at.xmat.reshape(3, 3) @ np.asarray(offset, float)

    return np.array(
        [
            np.linalg.norm(world(f.tip_body, f.tip_offset) - world(body, offset))
            for f, (body, offset) in zip(found.fingers, truth, strict=True)
        ]
    )
