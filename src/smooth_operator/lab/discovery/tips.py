"""Fingertips: a site or tip link where there is one, else the far end of the last link's shape."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Float

from smooth_operator.hands.spec import Point
from smooth_operator.lab.discovery.branches import Chain
from smooth_operator.lab.discovery.skeleton import Placement, Skeleton, says_tip

_NAMED: Final = 0.3  # how far along the last link a frame called tip must be, of its length
_UNNAMED: Final = 0.65  # and a frame that is not called so
_WEIGHS: Final = 1e-5  # [kg]: less is what loading gives to links without inertia
_AGREE: Final = 0.012  # [m] between a frame and the end of the shape, for both to mean the tip


@dataclass(frozen=True)
class Tip:
    """A fingertip: where, how sure, why."""

    point: Point
    confidence: float
    evidence: tuple[str, ...]
    position: tuple[float, float, float]  # world, reference pose [m]


def find_tip(skeleton: Skeleton, chain: Chain, at: Placement) -> Tip:
    """The fingertip of a chain.

    Frames fixed to the last link (sites and links without joints) are taken if they lie well along
    it; a frame at its joint, as the last link's own origin is, never is one.
    """
    rigid = skeleton.rigid(chain.last)
    joint = chain.joints[-1]
    anchor, axis = at.anchors[joint], at.axes[joint]
    reach = np.linalg.norm(np.diff([at.anchors[j] for j in chain.own], axis=0), axis=1)
    clouds = [at.world(b, cloud) for b in rigid for cloud in skeleton.clouds.get(b, ())]
    end = far_end(clouds, anchor, axis, float(max(reach.sum(), 0.02)))

    frames: list[tuple[str, str, np.ndarray, int, np.ndarray]] = []
    for s in np.flatnonzero(np.isin(skeleton.model.site_bodyid, rigid)):
        body = int(skeleton.model.site_bodyid[s])
        local = np.asarray(skeleton.model.site_pos[s], float)
        frames.append(("site", str(skeleton.model.site(int(s)).name), local, body, at.sites[s]))
    leaves = set(rigid) - {int(skeleton.model.body_parentid[b]) for b in rigid} - {chain.last}
    frames += [
        ("link", skeleton.body_name(b), np.zeros(3), b, at.bodies[b]) for b in sorted(leaves)
    ]

    def along(point: np.ndarray) -> float:
        if end is None:
            return float(np.linalg.norm(point - anchor))
        far = end.far - anchor
        return float((point - anchor) @ far / np.linalg.norm(far))

    length = along(end.far) if end is not None else max((along(f[4]) for f in frames), default=0.0)
    fit = [
        (kind, name, local, body, world)
        for kind, name, local, body, world in frames
        if length > 1e-4 and along(world) > (_NAMED if says_tip(name) else _UNNAMED) * length
        if np.linalg.norm(world - anchor) < 1.2 * chain.length + 0.01
        if np.linalg.norm(world - anchor) > 1e-3
    ]
    if fit:
        # called a tip, then the farther one, then the site: it says more exactly what is meant
        kind, name, local, body, world = max(
            fit, key=lambda f: (says_tip(f[1]), round(along(f[4]), 4), f[0] == "site")
        )
        evidence = [f"{kind} {name!r} fixed to the last link"]
        confidence = 0.8
        if says_tip(name):
            confidence += 0.1
            evidence.append("its name says so")
        if end is not None:
            apart = float(np.linalg.norm(world - end.far))
            evidence.append(f"{apart * 1e3:.1f} mm from the far end of the shape")
            confidence += 0.08 if apart < _AGREE else -0.05
        else:
            evidence.append("the last link has no shape to compare with")
        return _tip(skeleton.point(body, local), confidence, evidence, world)
    if end is not None:
        body = _outermost(skeleton, rigid, at, end.far)
        evidence = ["far end of the last link's shape, on its middle line"]
        confidence = 0.75
        if end.nail:
            evidence.append(
                "a little behind it: the back juts out like a nail, and the pad is meant"
            )
            confidence = 0.6
        if frames:
            evidence.append(f"{frames[0][1]!r} is not there: it lies at the joint or half-way")
        point = skeleton.point(body, at.local(body, end.tip))
        return _tip(point, confidence, evidence, end.tip)
    guess, confidence, why = _extrapolated(skeleton, chain, at)
    evidence = ["no site, no tip link and no shape at the end of the finger", why]
    return _tip(
        skeleton.point(chain.last, at.local(chain.last, guess)), confidence, evidence, guess
    )


def _tip(point: Point, confidence: float, evidence: list[str], world: np.ndarray) -> Tip:
    u, v, w = (float(c) for c in world)
    return Tip(point, round(confidence, 2), tuple(evidence), (u, v, w))


def _outermost(skeleton: Skeleton, rigid: tuple[int, ...], at: Placement, far: np.ndarray) -> int:
    """Selects the body of the last link whose shape reaches the far end."""
    best, nearest = rigid[0], np.inf
    for body in rigid:
        for cloud in skeleton.clouds.get(body, ()):
            distance = float(np.linalg.norm(at.world(body, cloud) - far, axis=1).min())
            if distance < nearest - 1e-6:
                best, nearest = body, distance
    return best


def _extrapolated(skeleton: Skeleton, chain: Chain, at: Placement) -> tuple[np.ndarray, float, str]:
    """A guess where nothing shows the end: its place, how sure, and from what."""
    joint = chain.joints[-1]
    anchor, axis = at.anchors[joint], at.axes[joint]
    step = np.zeros(3)
    for earlier in reversed(chain.own[:-1]):
        step = anchor - at.anchors[earlier]
        step = step - (step @ axis) * axis
        if np.linalg.norm(step) > 5e-3:
            break
    before = float(np.linalg.norm(step))
    # The centre of mass of a rod is half-way. A link without its own inertia has none.
    mass = at.world(chain.last, np.asarray(skeleton.model.body_ipos[chain.last], float)) - anchor
    mass = mass - (mass @ axis) * axis
    reach = 2 * float(np.linalg.norm(mass))
    weighs = float(skeleton.model.body_mass[chain.last]) > _WEIGHS
    if weighs and reach > 5e-3 and 0.25 * before < reach < 2.5 * max(before, 0.02):
        return anchor + 2 * mass, 0.35, "guessed as twice as far as the last link's centre of mass"
    if before > 5e-3:
        return anchor + 0.8 * step, 0.2, "guessed as 0.8 of the link before, straight on"
    out = anchor - at.bodies[chain.palm]
    if np.linalg.norm(out) < 5e-3:
        return anchor, 0.1, "there is no link before to guess from: the last joint itself"
    return anchor + 0.5 * out, 0.1, "guessed as half the way from palm to joint, straight on"


_NAIL: Final = 0.06  # shift of the very end of a shape, of its thickness, that makes a nail
_PAD: Final = 0.8  # how far behind a nail's end the pad is, in half thicknesses
_ELSEWHERE: Final = 0.5  # of the finger's length: a shape farther from the joint is not the link's
_ROUNDS: Final = 4


@dataclass(frozen=True)
class End:
    """End of a link, in the world frame.

    Attributes:
        tip: (3,) where its pad ends [m]: the far end, or a little behind a nail.
        far: (3,) the far end on the middle line [m].
        nail: True if the back extends beyond the pad.
    """

    tip: Float[np.ndarray, "3"]
    far: Float[np.ndarray, "3"]
    nail: bool


def far_end(
    clouds: Sequence[Float[np.ndarray, "p 3"]],
    anchor: Float[np.ndarray, "3"],
    axis: Float[np.ndarray, "3"],
    scale: float,
) -> End | None:
    """The far end of a link on the middle line of its shapes.

    The middle line runs through the centres of two sections, one near the joint and one near the
    end, and is found together with the end by repetition.

    Args:
        clouds: points on each shape, world [m].
        anchor: a point of the joint's axis [m].
        scale: length of the rest of the finger [m], to tell what is small and what is far.

    Returns:
        the end; None if there are no shapes, or they lie about the joint and show no direction.
    """
    parts = [part for part in clouds if len(part)]
    if not parts:
        return None
    gaps = [float(np.linalg.norm(part - anchor, axis=1).min()) for part in parts]
    near = [part for part, gap in zip(parts, gaps, strict=True) if gap < _ELSEWHERE * scale]
    points = np.concatenate(near or parts) - anchor
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    middle = middle - (middle @ axis) * axis  # where along its hinge a link is drawn says nothing
    if np.linalg.norm(middle) < 1e-4:
        return None
    along = middle / np.linalg.norm(middle)
    tip = far = np.zeros(3)
    nail = False
    for _ in range(_ROUNDS):
        lateral = axis - (axis @ along) * along
        if np.linalg.norm(lateral) < 1e-6:
            return None  # a link along its own axis: it twists, and has no bending plane
        lateral = lateral / np.linalg.norm(lateral)
        across = np.cross(along, lateral)
        run = points @ along
        top = _top(run)
        if top < min(0.15 * scale, 0.008):
            return None
        share = run / top
        flat = points @ np.stack([across, lateral], axis=1)
        upper = (
            _section(flat, share, 0.6, 0.92)
            or _section(flat, share, 0.5, 1.0)
            or _section(flat, share, -np.inf, 1.0)
        )
        if upper is None:
            return None
        centre, half = upper
        far = top * along + centre[0] * across + centre[1] * lateral
        nail = _has_nail(flat[(share > 0.975) & (share <= 1.0)][:, 0], float(centre[0]), half)
        tip = far - (_PAD * half * along if nail else 0.0)
        lower = _section(flat, share, 0.1, 0.4)
        if lower is None:
            break
        start = 0.25 * top * along + lower[0][0] * across + lower[0][1] * lateral
        end = 0.76 * top * along + centre[0] * across + centre[1] * lateral
        along = (end - start) / np.linalg.norm(end - start)
    return End(anchor + tip, anchor + far, nail)


def _section(
    flat: np.ndarray, share: np.ndarray, low: float, high: float
) -> tuple[np.ndarray, float] | None:
    """Centre of a stretch of the link, (2,), and half its thickness; None with too few points."""
    inside = flat[(share >= low) & (share <= high)]
    if len(inside) < 6:
        return None
    least, most = inside.min(axis=0), inside.max(axis=0)
    return (least + most) / 2, float(most[0] - least[0]) / 2


def _has_nail(cap: np.ndarray, centre: float, half: float) -> bool:
    """True if a link is rounded and ends at one side; a straight cut has no nail."""
    if len(cap) < 5:
        return False
    shift = abs(float(cap.min() + cap.max()) / 2 - centre)
    return 2 * _NAIL * half < shift and float(np.ptp(cap)) < 1.7 * half


def _top(run: np.ndarray) -> float:
    """Finds the end of a shape: its last point, without few stray points beyond a gap."""
    order = np.sort(run)
    few = max(len(order) // 50, 1)
    if len(order) > 100:
        gaps = np.diff(order[-few - 1 :])
        jumps = np.flatnonzero(gaps > 0.08 * max(order[-few - 1], 1e-6))
        if len(jumps):
            return float(order[-few - 1 + jumps[0]])
    return float(order[-1])
