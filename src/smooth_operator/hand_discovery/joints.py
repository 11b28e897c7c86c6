"""Checks joints, neutral pose and palm: limits, effect of each joint, sizes, overlaps."""

from __future__ import annotations

from functools import partial
from typing import Final

import mujoco
import numpy as np

from smooth_operator.errors import HandModelError
from smooth_operator.hand_discovery.checks import Check, Samples, Verdict, worst
from smooth_operator.hands.collision import PALM, owners, solid_shapes
from smooth_operator.hands.hand import Hand, finger_rays
from smooth_operator.hands.penetration import crowded_links, neutral_overlaps
from smooth_operator.hands.stand_ins import stand_in_links
from smooth_operator.landmarks import LANDMARKS
from smooth_operator.metrics.safety import COLLISION_DEPTH
from smooth_operator.retargeting.alignment import MIN_CONDITION, palm_alignment, reference_landmarks
from smooth_operator.retargeting.palm import human_palm_axes
from smooth_operator.wrist_following import WristSolver

_TURN: Final = 2 * np.pi  # largest range of a finger's hinge [rad]; above, these are degrees
_WIDE: Final = 3.6  # largest usual range [rad]; LEAP has 3.2
_NARROW: Final = 0.1  # smallest usual range [rad]; Shadow has 0.42
_LONG: Final = 0.3  # largest range of a slide [m]
_STILL: Final = 1e-4  # motion below which a joint does not move a landmark [m]
_SLIGHT: Final = 2e-3  # smallest usual motion of a landmark over a joint's range [m]
_POSES: Final = 12  # number of poses in which a joint is swept
_STEPS: Final = 9
_ROUNDING: Final = 1e-6  # rounding of spec files [rad]
_TOUCH: Final = 3e-3  # overlap in the neutral pose that shapes of too large a size explain [m]
_DEEP: Final = 0.01  # overlap that no shape explains [m]
_CROWDED_PALM: Final = 0.25
"""Largest share of random poses in which a finger's link and the palm may overlap. Joint limits
keep most fingers out of the palm: published models have up to 0.1, the built-in hands 0.17."""
_CROWDED_FINGERS: Final = 0.5
"""Largest share for links of two fingers. Neighbours that spread freely often cross (Tesollo's in
0.44 of the poses)."""


def check_ranges(hand: Hand) -> Check:
    """Checks the range of each commanded joint, which reveals limits in degrees."""
    ranges = hand.limits[:, 1] - hand.limits[:, 0]
    kinds = hand.model.jnt_type[[hand.model.joint(name).id for name in hand.actuated_names]]
    slides = kinds == int(mujoco.mjtJoint.mjJNT_SLIDE)
    named = dict(zip(hand.actuated_names, ranges, strict=True))
    figures = {name: round(float(width), 4) for name, width in named.items()}
    turns = ranges[~slides]
    text = f"{ranges.min():.2f} to {ranges.max():.2f} {_unit(slides)}"

    def those(mask: np.ndarray) -> str:
        return _list([name for name, hit in zip(named, mask, strict=True) if hit])

    beyond = np.where(slides, ranges > _LONG, ranges > _TURN)
    check = partial(Check, "joint ranges", figures=figures)
    if beyond.any():
        return check(
            "failed",
            f"{text}: {those(beyond)} have a larger range than any finger joint can have",
            "limits must be in radians (metres for a slide): are these in degrees (millimetres)?",
        )
    if len(turns) and turns.max() < _NARROW:
        return check(
            "failed",
            f"{text}: no joint rotates by more than {np.degrees(_NARROW):.0f} degrees",
            "limits in radians were read as degrees: an MJCF file in radians needs "
            '<compiler angle="radian"/>',
        )
    odd = ~slides & ((ranges < _NARROW) | (ranges > _WIDE))
    if odd.any():
        return check(
            "warning",
            f"{text}; unusual: {those(odd)}",
            "compare the limits of these joints, and of the joints that follow them, with "
            "the data sheet",
        )
    return check("ok", text)


def check_motion(samples: Samples) -> Check:
    """Checks that each commanded joint moves a landmark, and measures the largest motion."""
    hand = samples.hand
    moved: dict[str, float] = {}
    for k, name in enumerate(hand.actuated_names):
        poses = np.repeat(samples.poses[:_POSES, None], _STEPS, axis=1)
        poses[..., k] = np.linspace(hand.limits[k, 0], hand.limits[k, 1], _STEPS)
        at = hand.landmark_positions(poses)
        moved[name] = float(np.linalg.norm(at - at[:, :1], axis=-1).max())
    figures = {name: round(1e3 * distance, 2) for name, distance in moved.items()}
    least = min(moved, key=lambda name: moved[name])
    text = f"each joint moves its landmarks by {1e3 * moved[least]:.0f} mm or more over its range"
    idle = [name for name, distance in moved.items() if distance < _STILL]
    owner = owners(hand)
    dead = [name for name in idle if owner[hand.model.joint(name).bodyid[0]] != PALM]
    check = partial(Check, "joints used", figures=figures)
    if dead:
        return check(
            "failed",
            f"{_list(dead)}: no landmark moves with it",
            "the finger's tip lies on the joint's axis or before it: set a tip on the last "
            "link, beyond its last joint",
        )
    if idle:
        return check(
            "warning",
            f"{_list(idle)}: no landmark moves with it",
            "the joint does not belong to a finger of the description, so it stays in its "
            "neutral position; if it moves a finger, add that finger",
        )
    if slight := [name for name, distance in moved.items() if distance < _SLIGHT]:
        return check(
            "warning",
            f"{_list(slight)}: moves its landmarks by only {1e3 * moved[least]:.1f} mm",
            "compare the joint's limits and axis with the data sheet",
        )
    return check("ok", text)


def check_neutral(hand: Hand) -> Check:
    """Checks that the neutral pose is within the limits and free of self-collision.

    A hand clips values outside the limits when it is loaded, so overlaps are those of the clipped
    pose.
    """
    spec = hand.spec
    neutral = {k: spec.neutral[k] for k in hand.actuated_names if k in spec.neutral}
    outside = {
        name: value
        for name, low, high in zip(hand.actuated_names, *hand.limits.T, strict=True)
        if (value := neutral.get(name, low)) < low - _ROUNDING or value > high + _ROUNDING
    }
    overlaps = neutral_overlaps(hand)
    deepest = max(overlaps.values(), default=0.0)
    figures = {"outside_limits": outside, "overlap_mm": round(1e3 * deepest, 2)}
    texts, advice, verdicts = [], [], list[Verdict]()
    if outside:
        far = max(outside, key=lambda n: abs(outside[n]))
        texts.append(f"outside the limits: {_list(list(outside))} ({far} = {outside[far]:g})")
        advice.append("set [neutral] values within the limits, in radians")
        verdicts.append("failed")
    else:
        texts.append(f"{len(neutral)} joints given, within the limits")
    if deepest > _TOUCH:
        one, other = max(overlaps, key=lambda pair: overlaps[pair])
        texts.append(f"{one} and {other} overlap by {1e3 * deepest:.0f} mm")
        advice.append("choose a [neutral] in which nothing touches, or check these shapes")
        # a mesh collides as its convex hull, which is larger than the part
        exact = not hand.model.nmesh
        verdicts.append("failed" if deepest > _DEEP and exact else "warning")
    elif not hand.bodies[hand.model.geom_bodyid].any():
        texts.append("no shapes that could touch")
    else:
        texts.append("nothing touches" if deepest <= 0 else f"overlap {1e3 * deepest:.1f} mm")
    return Check("neutral pose", worst(*verdicts), "; ".join(texts), "; ".join(advice), figures)


def check_shapes(samples: Samples) -> Check:
    """Checks that links have collision shapes, or estimated ones, and that no two of them overlap
    in a large share of random poses."""
    hand = samples.hand
    links, solid = stand_in_links(hand), int(solid_shapes(hand).sum())
    owner = owners(hand)
    shares = crowded_links(hand, samples.poses, COLLISION_DEPTH)
    crowded = {}
    for (one, other), share in shares.items():
        palm = any(owner[hand.model.body(name).id] == PALM for name in (one, other))
        if share > (_CROWDED_PALM if palm else _CROWDED_FINGERS):
            crowded[f"{one} and {other}"] = round(share, 3)
    texts, advice, verdicts = [f"{solid} collision shapes"], [], list[Verdict]()
    if links:
        texts.append(
            f"those of {_list(list(links))} can't be read or are missing; estimated capsules "
            "along the bones replace them"
        )
        advice.append("put the mesh files at the paths in the model file, and add the hand again")
        verdicts.append("warning")
    if crowded:
        most = max(crowded.values())
        texts.append(f"{_list(list(crowded))} overlap in up to {most:.0%} of random poses")
        advice.append(
            "make these shapes the size of the real parts; if the parts can't touch, exclude the "
            'pair in the model file: <exclude body1="..." body2="..."/>'
        )
        verdicts.append("failed")
    elif shares:
        (one, other), share = next(iter(shares.items()))
        texts.append(
            f"{one} and {other} touch in {share:.0%} of random poses, and other pairs in fewer"
        )
    figures = {
        "shapes": solid,
        "estimated": list(links),
        "crowded": crowded,
        "largest_share": round(max(shares.values(), default=0.0), 3),
    }
    return Check("shapes", worst(*verdicts), "; ".join(texts), "; ".join(advice), figures)


def _unit(slides: np.ndarray) -> str:
    return "m" if slides.all() else "rad or m" if slides.any() else "rad"


def _list(names: list[str]) -> str:
    shown = ", ".join(names[:4])
    return shown if len(names) <= 4 else f"{shown} and {len(names) - 4} more"


_POOR: Final = 0.08  # condition of a palm that noise turns; built-in hands have 0.16 and more
_MOVES: Final = 2e-3  # motion of an aligned landmark that a round trip shows [m]
_USUAL: Final = (0.10, 0.40)  # wrist to farthest fingertip [m]; built-in hands: 0.166 to 0.251
_POSSIBLE: Final = (0.05, 0.80)  # wrist to farthest fingertip [m]


_TOGETHER: Final = 0.5  # least length of the mean of the fingers' directions that has a meaning
_BEHIND_DEG: Final = 72.0
"""Largest angle of a wrist behind the knuckles; the built-in hands have up to 25."""


def check_palm(samples: Samples) -> Check:
    """Checks that the landmarks of the palm define a frame and do not move."""
    hand = samples.hand
    condition = float(palm_alignment(reference_landmarks(hand), hand).condition)
    used = [hand.tree.names.index(LANDMARKS[i]) for i in hand.align_indices]
    travel = float(np.ptp(samples.landmarks[:, used], axis=0).max())
    figures = {"condition": round(condition, 3), "travel_mm": round(1e3 * travel, 2)}
    align = ", ".join(hand.spec.align)
    text = f"{align}: condition number {condition:.2f} (0 for a line, 0.5 for human palms)"
    check = partial(Check, "palm frame", figures=figures)
    if condition < MIN_CONDITION:
        return check(
            "failed",
            text,
            "these landmarks lie on a line, so they do not determine a rotation: name others "
            "in align, or correct the positions of the finger bases and the wrist",
        )
    if travel > _MOVES:
        return check(
            "warning",
            f"{text}; they move by {1e3 * travel:.0f} mm with the joints",
            "attach the aligned bases to a body fixed to the palm, at their positions in the "
            "neutral pose: a human's knuckles don't move relative to the palm",
        )
    if condition < _POOR:
        return check(
            "warning",
            text,
            "nearly on a line, so tracker noise will rotate the hand; in align, name landmarks "
            "that are further apart",
        )
    return check("ok", text)


def check_wrist(samples: Samples) -> Check:
    """Checks that the wrist is behind the knuckles, on the opposite side from the fingers.

    The fingers point from base to tip when they are straight; if they point in opposite directions,
    as in a gripper that opens flat, they point where their tips are on average.
    """
    hand = samples.hand
    bases, rays = samples.bases.mean(axis=0), hand.straight_pose.rays
    units = rays / np.maximum(np.linalg.norm(rays, axis=-1, keepdims=True), 1e-9)
    forward = units[1:].mean(axis=0)
    if np.linalg.norm(forward) < _TOGETHER:
        forward = samples.tips.mean(axis=(0, 1)) - bases.mean(axis=0)
    away = bases.mean(axis=0) - hand.wrist
    lengths = np.linalg.norm(forward) * np.linalg.norm(away)
    angle = float(np.degrees(np.arccos(np.clip(forward @ away / max(lengths, 1e-9), -1, 1))))
    text = (
        f"{1e3 * np.linalg.norm(away):.0f} mm from the finger bases, {angle:.0f}° from the "
        "direction opposite to the fingers"
    )
    check = partial(Check, "wrist", figures={"angle_deg": round(angle, 1)})
    if angle > _BEHIND_DEG:
        return check(
            "failed",
            text,
            "set the wrist to a point of the palm behind the finger bases: hands add with --wrist",
        )
    return check("ok", text)


def check_tilt(samples: Samples) -> Check:
    """Measures the angle between the fingers of a flat human hand and the straight fingers of the
    robot."""
    tilt = palm_tilt_deg(samples.hand)
    way = "towards the palm" if tilt > 0 else "towards the back of the hand"
    text = f"when the human hand is flat, the robot's fingers are bent by {abs(tilt):.0f}° {way}"
    return Check("palm tilt", "unjudged", text, "", {"tilt_deg": round(tilt, 1)})


def check_wrist_joints(hand: Hand) -> Check:
    """Checks that the joints between forearm and palm can follow a human wrist."""
    names = hand.spec.wrist_joints
    check = partial(Check, "wrist joints", figures={"joints": list(names)})
    try:
        limits = np.degrees(WristSolver(hand).limits)
    except HandModelError as error:
        return check("failed", str(error), "correct wrist_joints in the spec file")
    ends = zip(names, limits.tolist(), strict=True)
    return check("ok", ", ".join(f"{name} {low:.0f}° to {high:.0f}°" for name, (low, high) in ends))


def check_size(samples: Samples) -> Check:
    """Checks the size of the hand, which reveals a model in millimetres."""
    hand = samples.hand
    reach = float(np.linalg.norm(samples.tips - hand.wrist, axis=-1).max())
    figures = {"reach_mm": round(1e3 * reach, 1)}
    text = f"{1e3 * reach:.0f} mm from the wrist to the farthest fingertip"
    check = partial(Check, "size", figures=figures)
    if not _POSSIBLE[0] < reach < _POSSIBLE[1]:
        return check(
            "failed",
            text,
            "no hand has that size: model and offsets must be in metres (a wrong mesh scale "
            "or a wrist on the wrong body can also be the cause)",
        )
    if not _USUAL[0] < reach < _USUAL[1]:
        return check("warning", text, "unusual size: check the wrist and the units of the model")
    return check("ok", text)


def palm_tilt_deg(hand: Hand) -> float:
    """Angle at their bases between the long fingers of a flat human hand, once aligned, and those
    of the robot [deg].

    Three landmarks of the palm align the hands; the fingers of a flat human hand and of a flat
    robot hand then point in different directions. If the angle is positive, a flat human hand bends
    the robot's fingers towards the palm; if negative, towards the back.

    The joints of a flat robot hand are at zero, or as close to zero as their limits allow, because
    vendors define the open hand there. At the neutral pose, as at ``Hand.straight_pose``, knuckles
    are often bent.
    """
    axes = human_palm_axes(hand)
    rays = finger_rays(hand, np.clip(0.0, *hand.limits.T))[1:]
    fingers = (rays / np.linalg.norm(rays, axis=-1, keepdims=True)).mean(axis=0)
    return float(np.degrees(np.arctan2(-(fingers @ axes.palmar), fingers @ axes.distal)))
