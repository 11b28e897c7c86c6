"""Hands of designs of their own, each with what is true of it; none is a product.

All are drawn up as right hands with fingers along z, palm to -y and thumb at +x.
"""

import re
from dataclasses import dataclass, field, replace

import numpy as np
from discovery_hands import Model, Part, Truth, Vector, mirrored, scrambled
from scipy.spatial.transform import Rotation

X, Y, Z = np.eye(3)
Step = tuple[Vector, Vector, tuple[float, float]]
"""Offset from the joint before, axis, limits."""


@dataclass
class Drawing:
    """A hand on paper: parts and tips are added finger by finger, thumb first."""

    palm: str
    parts: list[Part] = field(default_factory=list)
    tips: list[tuple[str, Vector]] = field(default_factory=list)

    def finger(
        self,
        name: str,
        base: Vector,
        steps: list[Step],
        last: Vector,
        *,
        parent: str = "",
        follow: dict[int, tuple[int, float]] | None = None,
    ) -> None:
        """A chain of joints; ``follow`` says which step follows which other with what factor."""
        above, offset = parent or self.palm, base
        for k, (to_here, axis, limits) in enumerate(steps):
            following = steps[k + 1][0] if k + 1 < len(steps) else last
            leader = (follow or {}).get(k)
            self.parts.append(
                Part(
                    f"{name}{k}",
                    above,
                    offset + to_here if k == 0 else to_here,
                    axis=axis / np.linalg.norm(axis),
                    joint=f"{name}{k}_j",
                    limits=limits,
                    end=following if np.linalg.norm(following) > 0.004 else None,
                    mimic=None if leader is None else (f"{name}{leader[0]}_j", leader[1], 0.0),
                )
            )
            above, offset = f"{name}{k}", np.zeros(3)
        self.tips.append((above, last))

    def model(self, side: str, seed: int) -> Model:
        """As the hand of a side, every body's frame turned at random."""
        parts, tips = {p.name: p for p in self.parts}, self.tips
        if side == "left":
            parts = {name: mirrored(p) for name, p in parts.items()}
            tips = [(name, tip * (-1, 1, 1)) for name, tip in tips]
        parts, tips = scrambled(parts, tips, np.random.default_rng(seed))
        return Model(tuple(parts.values()), Truth(side, self.palm, tuple(tips)))


def palm(name: str, size: float = 1.0, parent: str | None = None) -> Part:
    end = np.array([0, 0, 0.08]) * size
    return Part(name, parent, np.zeros(3), end=end, radius=0.018 * size)


def curled_at_zero() -> Drawing:
    """Joints count from the middle of their range, where all fingers are half closed; German names
    that no list of words holds; the thumb bends before it turns."""
    drawing = Drawing("Handflaeche", [palm("Handflaeche")])

    def bend(angle: float) -> Vector:
        return Rotation.from_rotvec(angle * X).apply(Z)

    inward = np.array([-0.35, -0.9, 0.1])
    out = np.array([0.75, -0.2, 0.6])
    drawing.finger(
        "Daumen",
        np.array([0.026, -0.008, 0.018]),
        [
            (0 * X, inward, (-0.6, 0.7)),
            (0.012 * out, -Z, (-0.8, 0.8)),
            (0.04 * out, inward, (-0.7, 0.7)),
            (0.032 * out, inward, (-0.6, 0.8)),
        ],
        0.026 * out,
    )
    for k, name in enumerate(("Zeige", "Mitte", "Ringf", "Klein")):
        long = (0.044, 0.046, 0.044, 0.036)[k]
        drawing.finger(
            name,
            np.array([0.03 - 0.02 * k, 0.0, 0.09 - 0.004 * abs(k - 1)]),
            [
                (0 * X, Y, (-0.25, 0.25)),
                (0 * X, X, (-0.7, 0.8)),
                (long * bend(0.7), X, (-0.7, 0.9)),
                (0.6 * long * bend(1.4), X, (-0.6, 0.6)),
            ],
            0.5 * long * bend(1.9),
        )
    return drawing


def six_joints_a_finger() -> Drawing:
    """A twist, a spread and four bends in each finger; the palm arches under the last two."""
    drawing = Drawing("q0", [palm("q0", 1.3)])
    out = np.array([0.8, 0.0, 0.6])
    drawing.finger(
        "k",
        np.array([0.036, -0.014, 0.026]),
        [
            (0 * X, -Z, (-0.3, 1.6)),
            (0.014 * out, np.array([0.6, 0, -0.8]), (-0.4, 0.4)),
            *((0.03 * out, -Y, (-0.1, 1.0)) for _ in range(4)),
        ],
        0.024 * out,
    )
    arch, at = np.array([0.55, 0.0, 0.85]), np.array([-0.005, 0, 0.02])
    drawing.finger("m9", at, [(0 * X, arch, (0.0, 0.5))], np.array([-0.03, 0.0, 0.05]))
    drawing.tips.pop()  # a part of the palm
    for k, name in enumerate("pdwz"):
        place = np.array([0.039 - 0.026 * k, 0.0, 0.115])
        arched = k > 1
        drawing.finger(
            name,
            place - (at if arched else 0),
            [
                (0 * X, Z, (-0.2, 0.2)),
                (0.006 * Z, Y, (-0.3, 0.3)),
                *(((0.004 if i == 0 else 0.03) * Z, X, (-0.1, 1.1)) for i in range(4)),
            ],
            0.024 * Z,
            parent="m90" if arched else "",
        )
    return drawing


def spread_around() -> Drawing:
    """Two fingers that swing round the palm's rim, one led by the other, and a thumb that can't."""
    drawing = Drawing("core", [palm("core", 0.5)])
    drawing.finger(
        "fixed",
        np.array([0.0, -0.05, 0.03]),
        [(0 * X, -X, (0.0, 2.2)), (0.06 * Z, -X, (0.0, 0.9))],
        0.05 * Z,
        follow={1: (0, 0.33)},
    )
    for name, sign in (("one", 1.0), ("two", -1.0)):
        drawing.finger(
            name,
            np.array([0.03 * sign, 0.03, 0.03]),
            [(0 * X, -sign * Z, (0.0, 1.5)), (0.02 * Y, X, (0.0, 2.2)), (0.06 * Z, X, (0.0, 0.9))],
            0.05 * Z,
            follow={2: (1, 0.33)},
        )
    follower = next(p for p in drawing.parts if p.name == "two0")
    at = drawing.parts.index(follower)
    drawing.parts[at] = replace(follower, mimic=("one0_j", 1.0, 0.0))
    return drawing


def opposed_pairs() -> Drawing:
    """Two fingers against two that all lie flat when they are open; no shape marks the wrist."""
    drawing = Drawing("disc", [Part("disc", None, np.zeros(3))])
    for name, x, y in (("a", 1, 1), ("b", 1, -1), ("c", -1, 1), ("d", -1, -1)):
        out = np.array([float(x), 0.0, 0.0])
        drawing.finger(
            name,
            np.array([0.03 * x, 0.02 * y, 0.01]),
            [(0 * X, -x * Y, (0.0, 1.6)), (0.05 * out, -x * Y, (0.0, 1.2))],
            0.045 * out,
        )
    return drawing


def prosthesis() -> Drawing:
    """One joint a finger, bent as it was moulded, and two for the thumb; pinyin names."""
    drawing = Drawing("zhang", [palm("zhang")])
    out = np.array([0.7, -0.1, 0.7])
    drawing.finger(
        "muzhi",
        np.array([0.03, -0.012, 0.02]),
        [(0 * X, -Z, (0.0, 1.5)), (0.018 * out, np.array([-0.1, -1.0, 0.0]), (0.0, 0.9))],
        0.055 * out,
    )
    for k, name in enumerate(("shizhi", "zhongzhi", "wuming", "xiaozhi")):
        tip = np.array([0.0, -0.02, 0.065 - 0.004 * abs(k - 1)])
        drawing.finger(name, np.array([0.03 - 0.02 * k, 0, 0.09]), [(0 * X, X, (0.0, 1.5))], tip)
    return drawing


def _four_fingers(
    drawing: Drawing, *, apart: float = 0.02, limits: tuple[float, float] = (-0.1, 1.6)
) -> None:
    """A thumb and four fingers of two joints, the last of which follows the first."""
    out = np.array([0.8, 0.0, 0.6])
    drawing.finger(
        "t",
        np.array([0.03, -0.012, 0.02]),
        [(0 * X, -Z, (-0.2, 1.6)), (0.016 * out, -Y, limits), (0.035 * out, -Y, limits)],
        0.03 * out,
        follow={2: (1, 0.8)},
    )
    for k, name in enumerate("abcd"):
        drawing.finger(
            name,
            np.array([(1.5 - k) * apart, 0.0, 0.09]),
            [(0 * X, X, limits), (0.042 * Z, X, limits)],
            0.036 * Z,
            follow={1: (0, 0.9)},
        )


def _bar(drawing: Drawing, name: str, parent: str, place: Vector, steps: list[Step]) -> None:
    """A chain that is no finger."""
    drawing.finger(f"bar_{name}", place, steps, 0.014 * Z, parent=parent)
    drawing.tips.pop()
    drawing.parts[-len(steps) :] = [
        replace(part, joint=f"bar_{name}{k}_j")
        for k, part in enumerate(drawing.parts[-len(steps) :])
    ]


def fingers_of_sliders_and_rods() -> Drawing:
    """A cylinder and a rod move each finger, a rod its last link; pins have no real limits."""
    drawing = Drawing("handplate", [palm("handplate")])
    full = (-3.14159, 3.14159)
    _four_fingers(drawing, limits=full)
    for k, name in enumerate("abcd"):
        place = np.array([(1.5 - k) * 0.02, 0.008, 0.06])
        cylinder = [(0 * X, Z, (0.0, 0.019)), (0.012 * Z, X, full)]
        _bar(drawing, f"{name}s", drawing.palm, place, cylinder)
        above = place + np.array([0, -0.002, 0.03])
        _bar(drawing, f"{name}r", drawing.palm, above, [(0 * X, X, full)])
    drawing.parts = [
        replace(p, slide=True) if re.fullmatch("bar_.s0", p.name) else p for p in drawing.parts
    ]
    _bar(drawing, "tr", "t1", np.array([0.006, 0.0, 0.01]), [(0 * X, -Y, full)])
    return drawing


def behind_a_wrist_with_a_bar() -> Drawing:
    """Fingers close together behind a wrist of two joints, and a bar of the wrist's drive."""
    base = Part("forearm", None, np.zeros(3), end=0.05 * Z, radius=0.02)
    pitch = Part("wrist0", "forearm", 0.08 * Z, axis=X, joint="arm0_j", limits=(-0.6, 0.6))
    plate = palm("plate", parent="wrist0")
    plate = replace(plate, position=0.03 * Z, axis=Y, joint="arm1_j", limits=(-0.5, 0.5))
    drawing = Drawing("plate", [base, pitch, plate])
    _four_fingers(drawing, apart=0.015)
    _bar(drawing, "w", "forearm", 0.08 * Z, [(0 * X, Y, (-0.5, 0.7))])
    return drawing


def four_bar_gripper() -> Drawing:
    """Two fingers of one motor, each with an inner bar that follows it."""
    drawing = Drawing("gripper", [palm("gripper", 0.7)])
    for name, sign in (("t", 1.0), ("a", -1.0)):
        drawing.finger(
            name,
            np.array([0.03 * sign, 0.0, 0.06]),
            [(0 * X, -sign * Y, (-0.1, 0.8)), (0.04 * Z + 0.02 * sign * X, sign * Y, (-0.1, 0.8))],
            0.04 * Z,
            follow={1: (0, 1.0)},
        )
        _bar(
            drawing,
            name,
            "gripper",
            np.array([0.012 * sign, 0.0, 0.066]),
            [(0 * X, -sign * Y, (-0.1, 0.8))],
        )
    for k, part in enumerate(drawing.parts):
        if part.joint in ("a0_j", "a1_j", "bar_t0_j", "bar_a0_j"):
            part = replace(part, mimic=("t0_j", 1.0, 0.0))
        if part.name.startswith("bar"):
            part = replace(part, end=0.05 * Z + 0.02 * np.sign(part.position[0]) * X)
        drawing.parts[k] = part
    return drawing
