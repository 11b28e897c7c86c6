"""Analyses a model file and describes the hand in it, with all findings."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Final

import mujoco
import numpy as np

from smooth_operator.errors import HandModelError, UnknownNameError, counted
from smooth_operator.hand_discovery.branches import Branches, Chain, HandTree, Tip, find_tip, holds
from smooth_operator.hand_discovery.gripper import find_jaws, gripper_palm
from smooth_operator.hand_discovery.landmarks import (
    Discovery,
    Finding,
    FoundCoupling,
    FoundFinger,
    Overrules,
    bases_finding,
    find_wrist,
    finger_points,
    fix_bases,
)
from smooth_operator.hand_discovery.motion import (
    Bending,
    Layout,
    Thumb,
    find_bending,
    find_layout,
    find_neutral,
    find_thumb,
    sample_reach,
)
from smooth_operator.hand_discovery.skeleton import (
    Placement,
    Skeleton,
    fingers_said,
    read_skeleton,
    says_wrist,
    side_said,
)
from smooth_operator.hands.loading import NO_ROOM, driven_joints, shared_range
from smooth_operator.hands.model_assets import model_path
from smooth_operator.hands.spec import Coupling, FingerSpec, HandSpec, Point
from smooth_operator.hands.spec_file import MOST_NAME
from smooth_operator.hands.wrist_joints import MOST_WRIST_JOINTS
from smooth_operator.landmarks import FINGERS
from smooth_operator.types import Side, as_side
from smooth_operator.wrist_following import MOST_ALONG

_EITHER_JAW: Final = 0.9  # confidence of a gripper's thumb: either jaw may have that name
_TURNS: Final = 4 * np.pi  # range that no joint of a finger has [rad]
_GENERIC: Final = {
    *("right", "left", "rh", "lh", "r", "l", "hand", "robot", "model", "scene", "description"),
    *("urdf", "mjcf", "xml", "assets", "models", "kinematics", "only"),
}


class _Analysis:
    """Findings about one palm and its chains."""

    def __init__(
        self, skeleton: Skeleton, tree: HandTree, side: Side | None, overrules: Overrules
    ) -> None:
        self.skeleton, self.tree = skeleton, tree
        at = skeleton.place(skeleton.reference)
        chains = tree.chains
        for chain in chains:
            _check_joints(skeleton, chain)
        names = fingers_said([_names(skeleton, chain) for chain in chains])
        self.chosen = _chosen(skeleton, chains, overrules)
        self.tips = tuple(find_tip(skeleton, chain, at) for chain in chains)
        self.bends: tuple[Bending, ...] = find_bending(skeleton, chains, self.tips)
        self.reach = reach = sample_reach(skeleton, chains, self.tips, self.bends)
        thumb = find_thumb(chains, self.bends, reach, names)
        thumb_index = next((i for i, name in self.chosen.items() if name == "thumb"), None)
        if thumb_index is not None:
            thumb = Thumb(thumb_index, 1.0, ("given",))
        self.thumb = thumb
        own = [n for chain in chains for n in _names(skeleton, chain)]
        palm = [skeleton.body_name(b) for b in skeleton.rigid(tree.palm)] if tree.palm else []
        self.layout: Layout = find_layout(
            chains, self.bends, reach, thumb.index, names, side_said([*own, *palm]), side
        )


def discover(
    path: str | Path,
    *,
    side: Side | None = None,
    name: str | None = None,
    overrules: Overrules | None = None,
) -> Discovery:
    """Reads a model and derives the description of its hand.

    No rule depends on a product: chains branch from the palm, the thumb closes against the other
    fingers, and the side follows from the directions in which the fingers point and close and from
    the place of the thumb. Names are weak evidence.

    Args:
        path: URDF or MJCF file, with or without its meshes.
        side: side of the hand; selects one of two hands in a file.
        name: name of the description. Default: the name of the file.
        overrules: properties that the user sets; they replace findings.

    Returns:
        The description, and every finding with confidence and evidence.

    Raises:
        HandModelError: the file can't be used, holds no hand, or holds two and ``side`` is None.
        UnknownNameError: the model lacks a name in ``overrules``.
    """
    path = Path(path)
    side = None if side is None else as_side(side)
    overrules = overrules or Overrules()
    skeleton, notes = read_skeleton(path, overrules.couplings)
    branches = Branches(skeleton, tuple(where for _, where in overrules.fingers))
    if overrules.gripper is not None:
        palm, jaw = gripper_palm(skeleton, branches, overrules.gripper)
        if jaw is not None:
            return _gripper(skeleton, jaw, path, name, side, overrules, notes)
        overrules = replace(overrules, palm=palm)
    if overrules.palm is not None:
        trees: tuple[HandTree, ...] = (branches.at(overrules.palm),)
    else:
        trees = branches.find()
    analysis = _choose(skeleton, trees, side, overrules, path)
    lost = [out for out in analysis.tree.left_out if out.doubtful]
    if lost and overrules.palm is None:
        palm = skeleton.body_name(analysis.tree.palm)
        raise HandModelError(
            f"{'; '.join(out.why for out in lost)}, but it branches from the palm {palm!r} "
            "like a finger: add limits to its joints in the file, or, if it is not a "
            f"finger, name the palm: --palm {palm}"
        )
    return _described(analysis, path, name, overrules, notes, len(trees))


def _gripper(
    skeleton: Skeleton,
    chain: Chain,
    path: Path,
    name: str | None,
    side: Side | None,
    overrules: Overrules,
    notes: tuple[str, ...],
) -> Discovery:
    """Description of a gripper with one moving jaw."""
    jaws = find_jaws(skeleton, chain, overrules)
    _check_joints(skeleton, chain)
    spec = HandSpec(
        name=name or hand_name(path),
        side=side or "right",
        model=model_path(path),
        palm=skeleton.body_name(chain.palm),
        wrist=jaws.wrist,
        fingers=jaws.fingers,
        align=_align(("thumb", "index")),
        source=f"derived from {path.name}",
        neutral=jaws.neutral,
        gripper=True,
        couplings=overrules.couplings,
    )
    coupled, coupled_finding = find_couplings(
        skeleton, frozenset(chain.joints), overrules.couplings
    )
    joints = tuple(skeleton.joint_names[j] for j in chain.joints)
    found = tuple(
        FoundFinger(
            name=finger.name,
            tip_body=finger.tip.body,
            tip_offset=finger.tip.offset,
            joints=joints if finger.name == "index" else (),
            confidence=jaws.confidence,
        )
        for finger in spec.fingers
    )
    findings = (
        _either_side(),
        Finding("palm", spec.palm, 1.0, ("it carries the jaw",), "--gripper JOINT"),
        Finding("thumb", "fixed jaw", 1.0, ("it has no joint",), "--gripper JOINT"),
        *(
            _tip_finding(finger.name, finger.tip, jaws.confidence, jaws.evidence)
            for finger in spec.fingers
        ),
        coupled_finding,
        _wrist_finding(spec.wrist, 0.8, ("behind the middle of the jaws",))
        if overrules.wrist is None
        else _wrist_finding(spec.wrist, 1.0, ("given",)),
    )
    return Discovery(spec, findings, found, coupled, (*notes, *coupling_notes(coupled)))


def _tip_finding(
    finger: str, point: Point, confidence: float, evidence: tuple[str, ...]
) -> Finding:
    option = f"--tip {finger}=BODY:x,y,z (metres)"
    return Finding(f"tip of {finger}", _place(point), confidence, evidence, option)


def _wrist_finding(wrist: Point, confidence: float, evidence: tuple[str, ...]) -> Finding:
    return Finding("wrist", _place(wrist), confidence, evidence, "--wrist BODY:x,y,z (metres)")


def _either_side() -> Finding:
    why = "a gripper has no side: either human hand can drive it"
    return Finding("side", "either", 1.0, (why,), "edit 'gripper' in the spec file")


def _choose(
    skeleton: Skeleton,
    trees: tuple[HandTree, ...],
    side: Side | None,
    overrules: Overrules,
    path: Path,
) -> _Analysis:
    if len(trees) == 1:
        return _Analysis(skeleton, trees[0], side, overrules)
    blank = Overrules()
    layouts = [(tree, _Analysis(skeleton, tree, None, blank).layout) for tree in trees]
    choices = "; ".join(
        f"palm {skeleton.body_name(tree.palm)!r}, {layout.side} ({layout.side_confidence:.2f})"
        for tree, layout in layouts
    )
    fits = [tree for tree, layout in layouts if layout.side == side]
    if len(fits) != 1:
        hint = "use --side right or --side left" if side is None else "name one with --palm"
        raise HandModelError(f"{path} contains {len(trees)} hands ({choices}); {hint}")
    return _Analysis(skeleton, fits[0], side, overrules)


def _described(
    analysis: _Analysis,
    path: Path,
    name: str | None,
    overrules: Overrules,
    notes: tuple[str, ...],
    hands: int,
) -> Discovery:
    skeleton, tree, layout = analysis.skeleton, analysis.tree, analysis.layout
    chains = tree.chains
    at = skeleton.place(skeleton.reference)
    order, names = _ordered(analysis)
    tips = dict(zip(order, (analysis.tips[i] for i in order), strict=True))
    for finger, point in overrules.tips:
        if finger not in names:
            raise HandModelError(
                f"--tip names the finger {finger!r}; this hand has {', '.join(names)}"
            )
        i = order[names.index(finger)]
        tips[i] = _given_tip(skeleton, chains[i], finger, point)
    _check_tips_differ([(n, tips[i]) for i, n in zip(order, names, strict=True)])
    fingers = tuple(
        FingerSpec(
            finger,
            finger_points(
                skeleton, chains[i], analysis.bends[i], tips[i].point, finger == "thumb", at
            ),
        )
        for i, finger in zip(order, names, strict=True)
    )
    neutral, neutral_said = find_neutral(skeleton, chains, analysis.bends, analysis.reach, order)
    fingers, moved_bases = fix_bases(
        skeleton, tree.palm, fingers, analysis.reach, skeleton.place(skeleton.posed(neutral))
    )
    wrist, wrist_sure, wrist_why = find_wrist(skeleton, tree.palm, chains, layout, at)
    if overrules.wrist is not None:
        skeleton.body(overrules.wrist.body)  # fails for an unknown body
        wrist, wrist_sure, wrist_why = overrules.wrist, 1.0, ("given",)
    wrist_joints, wrist_joints_finding = _wrist_joints(analysis, at)
    gripper = len(chains) == 2 and (overrules.gripper is not None or not layout.sided)
    spec = HandSpec(
        name=name or hand_name(path),
        side=layout.side,
        model=model_path(path),
        palm=skeleton.body_name(tree.palm),
        wrist=wrist,
        fingers=fingers,
        align=_align(names),
        source=f"derived from {path.name}",
        neutral=neutral,
        gripper=gripper,
        couplings=overrules.couplings,
        wrist_joints=wrist_joints,
    )
    moved = frozenset(j for chain in chains for j in chain.joints)
    coupled, coupled_finding = find_couplings(skeleton, moved, overrules.couplings)
    assign = min(layout.order_confidence, layout.names_confidence)
    descriptions = tuple(
        FoundFinger(
            name=finger,
            tip_body=tips[i].point.body,
            tip_offset=tips[i].point.offset,
            joints=tuple(skeleton.joint_names[j] for j in chains[i].joints),
            confidence=min(
                tips[i].confidence,
                _EITHER_JAW
                if gripper
                else analysis.thumb.confidence
                if finger == "thumb"
                else assign,
            ),
        )
        for i, finger in zip(order, names, strict=True)
    )
    thumb_joints = " → ".join(descriptions[0].joints)
    sure_order = 1.0 if set(names) <= set(analysis.chosen.values()) else layout.order_confidence
    other = "left" if layout.side == "right" else "right"
    overrule = "a body or joint of the correct finger"
    findings = (
        _either_side()
        if gripper
        else Finding(
            "side", layout.side, layout.side_confidence, layout.side_evidence, f"--side {other}"
        ),
        _palm_finding(analysis, dict(zip(order, names, strict=True)), overrules, hands),
        Finding(
            "thumb",
            thumb_joints,
            max(analysis.thumb.confidence, _EITHER_JAW * gripper),
            analysis.thumb.evidence,
            f"--thumb BODY ({overrule})",
        ),
        Finding(
            "order",
            ", ".join(names),
            max(sure_order, _EITHER_JAW * gripper),
            layout.order_evidence,
            f"--finger {names[-1]}=BODY ({overrule})",
        ),
        *(
            _tip_finding(name, tips[i].point, tips[i].confidence, tips[i].evidence)
            for i, name in zip(order, names, strict=True)
        ),
        coupled_finding,
        _wrist_finding(wrist, wrist_sure, wrist_why),
        *wrist_joints_finding,
        bases_finding(moved_bases),
        Finding(
            "neutral",
            f"{len(neutral)} joints",
            0.8,
            neutral_said,
            "edit [neutral] in the spec file",
        ),
    )
    notes = (*notes, *coupling_notes(coupled), *_chain_notes(skeleton, tree))
    return Discovery(spec, findings, descriptions, coupled, notes)


def _ordered(analysis: _Analysis) -> tuple[tuple[int, ...], tuple[str, ...]]:
    """Indices of the chains, thumb first, and their human fingers, as set by the user if so."""
    layout, chosen = analysis.layout, analysis.chosen
    order, names = list(layout.order), list(layout.names)
    free = [n for n in names if n not in chosen.values()]
    named = {i: chosen.get(i, "") for i in order}
    for i, name in zip(order, names, strict=True):
        if not named[i]:
            named[i] = name if name in free else free[0]
            free.remove(named[i])
    ranked = sorted(order, key=lambda i: FINGERS.index(named[i])) if chosen else order
    return tuple(ranked), tuple(named[i] for i in ranked)


def _chosen(skeleton: Skeleton, chains: tuple[Chain, ...], overrules: Overrules) -> dict[int, str]:
    """Index of a chain -> human finger that the user set."""
    pairs = list(overrules.fingers)
    if overrules.thumb is not None:
        pairs = [("thumb", overrules.thumb), *(p for p in pairs if p[0] != "thumb")]
    out: dict[int, str] = {}
    for finger, where in pairs:
        holding = [i for i, chain in enumerate(chains) if holds(skeleton, chain, where)]
        if not holding:
            parts = {n for chain in chains for n in _names(skeleton, chain)}
            raise UnknownNameError("body or joint of a finger", where, parts)
        i = holding[0]
        if i in out:
            raise HandModelError(
                f"{where!r} is assigned to {finger}, but it belongs to the same finger as {out[i]}"
            )
        out[i] = finger
    return out


def _names(skeleton: Skeleton, chain: Chain) -> list[str]:
    bodies = [*chain.bodies, *(b for b in skeleton.rigid(chain.last) if b not in chain.bodies)]
    joints = [skeleton.joint_names[j] for j in chain.own]
    return [*(skeleton.body_name(b) for b in bodies), *joints]


def _check_joints(skeleton: Skeleton, chain: Chain) -> None:
    for j in chain.joints:
        name = skeleton.joint_names[j]
        if not skeleton.moves[j]:
            raise HandModelError(
                f"joint {name!r} of a finger is a ball or free joint; a hand's joints must "
                "be hinges or slides: replace it by hinges in the file"
            )
        if not skeleton.bounded[j] and j not in skeleton.leaders:
            if name in skeleton.pinned:
                raise HandModelError(
                    f"joint {name!r} of a finger can't move: in the file, lower = upper = "
                    f"{skeleton.pinned[name]:g}; {len(skeleton.pinned)} joints have such a range; "
                    "set their ranges there, or make joints that never move fixed"
                )
            raise HandModelError(
                f"joint {name!r} of a finger has no limits; add them to the file (URDF: "
                '<limit lower="…" upper="…"/>, MJCF: range="… …")'
            )
        low, high = skeleton.limits[j]
        if skeleton.turns[j] and skeleton.bounded[j] and high - low > _TURNS:
            raise HandModelError(
                f"joint {name!r} of a finger has the limits {low:g} to {high:g} rad, more than two "
                "turns: are they degrees? Limits are in radians in a URDF, and in an MJCF with "
                '<compiler angle="radian"/>; correct them in the file'
            )


def _given_tip(skeleton: Skeleton, chain: Chain, finger: str, point: Point) -> Tip:
    body = skeleton.body(point.body)
    rigid = skeleton.rigid(chain.last)
    if body not in rigid:
        options = ", ".join(repr(skeleton.body_name(b)) for b in rigid)
        raise HandModelError(
            f"--tip puts the tip of {finger} on {point.body!r}; choose a body that is fixed to "
            f"that finger's last link: {options}"
        )
    at = skeleton.place(skeleton.reference)
    x, y, z = (float(c) for c in at.world(body, np.array(point.offset)))
    return Tip(point, 1.0, ("given",), (x, y, z))


def _check_tips_differ(tips: list[tuple[str, Tip]]) -> None:
    tip_names: dict[Point, str] = {}
    for finger, tip in tips:
        if tip.point in tip_names:
            raise HandModelError(
                f"{tip_names[tip.point]} and {finger} have the same tip, {tip.point.body!r}; give "
                f"each finger its own tip: --tip {finger}=BODY:x,y,z"
            )
        tip_names[tip.point] = finger


def _align(names: tuple[str, ...]) -> tuple[str, ...]:
    """Landmarks of the alignment: bases of thumb, first and last finger, as in the paper's code."""
    if len(names) == 2:
        return (*names, "wrist")
    return (names[0], names[1], names[-1])


def hand_name(path: Path) -> str:
    """Name for a hand, taken from the file's name or, if that is generic, from a folder above
    it."""
    for text in (path.stem, *(folder.name for folder in path.resolve().parents[:3])):
        parts = [w for w in re.split(r"[^A-Za-z0-9]+", text.lower()) if w]
        name_words = [w for w in parts if w not in _GENERIC]
        if name_words:
            words = [w for w in parts if w not in _GENERIC or w == "hand"]
            return "_".join(words)[:MOST_NAME]
    return "hand"


_DECLARED: Final = 0.95
_NONE_DECLARED: Final = 0.9
_IDLE: Final = 0.4  # joints that stand still may be coupled in the real hand
_FITTED: Final = 0.9
_TENDON: Final = 0.7  # the file does not tell how the joints of a tendon share its travel
_CONTRADICTED: Final = 0.3


def find_couplings(
    skeleton: Skeleton, joints: frozenset[int], given: tuple[Coupling, ...] = ()
) -> tuple[tuple[FoundCoupling, ...], Finding]:
    """Couplings among a hand's joints, and the finding about them.

    A coupling that leaves its follower no room to move has a low confidence, because a sign in the
    file is wrong. The loader has changed the sign if this gives the follower room. A joint without
    a motor or a leader does not move, although the real one may be coupled.
    """
    names = {skeleton.joint_names[j] for j in joints}
    tendons = _on_tendons(skeleton)
    couplings, notes = [], []
    for c in skeleton.couplings:
        if c.joint not in names:
            continue
        text = f"{c.joint} follows {c.follows}"
        confidence = _DECLARED
        if c.error:
            confidence = _FITTED
            text += (
                f" by a polynomial fitted to a closed loop, within {np.degrees(c.error):.2f} "
                "degrees"
            )
        elif c in given:
            confidence = 1.0
            text += ", as given"
        elif c.joint in tendons:
            confidence = _TENDON
            text += " on a tendon (its coefficients determine how the joints share its travel)"
        if c.turned:
            confidence = _CONTRADICTED
            text += f" with the factor {c.multiplier:g}: {_turned(c)}"
        elif _contradicted(skeleton, c.joint):
            confidence = _CONTRADICTED
            text += (
                f" as {c.formula}, as declared, but its own limits do not allow this: correct "
                "the coupling or the limits in the file"
            )
        couplings.append(FoundCoupling(c, confidence))
        notes.append(text)
    overrule = "--couple JOINT=LEADER*A+B, or edit the model file"
    least = min((f.confidence for f in couplings), default=_NONE_DECLARED)
    if any(c.coupling not in given for c in couplings):
        notes.append("as declared in the file")
    if not couplings:
        notes.append("the file declares no couplings")
    if idle := _idle_joints(skeleton, joints):
        least = _IDLE
        notes.append(
            f"joints without a motor or a leader do not move ({len(idle)}): {', '.join(idle)}"
        )
    value = f"{len(couplings)} joints" if couplings else "none"
    return tuple(couplings), Finding("coupled", value, least, tuple(notes), overrule)


def _idle_joints(skeleton: Skeleton, joints: frozenset[int]) -> list[str]:
    """Joints of fingers that nothing moves, in a model whose other joints have motors."""
    driven = driven_joints(skeleton.model)
    if not driven & joints:
        return []
    followers = {c.joint for c in skeleton.couplings}
    names = [skeleton.joint_names[j] for j in sorted(joints - driven)]
    return [name for name in names if name not in followers]


def _chain_notes(skeleton: Skeleton, tree: HandTree) -> Iterator[str]:
    """Notes about chains that are not fingers, and about joints that can make a full turn."""
    if tree.left_out:
        yield (
            f"chains that are not used: {'; '.join(out.why for out in tree.left_out)}. If one of "
            "them is a finger, add --finger NAME=BODY with its body. Joints that do not move a "
            "finger stay at neutral"
        )
    names = [
        skeleton.joint_names[j]
        for j in dict.fromkeys(j for chain in tree.chains for j in chain.joints)
        if skeleton.bounded[j] and skeleton.turns_freely(j)
    ]
    if names:
        yield (
            "joints of fingers can make a full turn according to the file: "
            f"{', '.join(names)}; set the limits of the real hand there"
        )


def coupling_notes(couplings: tuple[FoundCoupling, ...]) -> tuple[str, ...]:
    """Warnings about couplings whose sign differs from that in the file."""
    return tuple(
        f"joint {c.joint!r} follows {c.follows!r} with the factor {c.multiplier:g}: "
        f"{_turned(c)}. Check it on the hand; if the limits are wrong, correct them in the "
        "file"
        for c in (f.coupling for f in couplings)
        if c.turned
    )


def _turned(coupling: Coupling) -> str:
    return (
        f"the file says {-coupling.multiplier:g}, but its own limits leave no room for that, "
        "so the sign in the file is assumed to be wrong"
    )


def _contradicted(skeleton: Skeleton, name: str) -> bool:
    follower = skeleton.joint_names.index(name)
    leader, curve = skeleton.leaders[follower]
    ranges = skeleton.limits[[follower, leader]]
    if not np.isfinite(ranges).all():
        return False
    return shared_range(curve, *ranges) < NO_ROOM


def _on_tendons(skeleton: Skeleton) -> set[str]:
    """Joints that a tendon moves and no equality couples to another joint."""
    model = skeleton.model
    kind, held = mujoco.mjtWrap.mjWRAP_JOINT, mujoco.mjtEq.mjEQ_JOINT
    wrapped = {int(model.wrap_objid[w]) for w in np.flatnonzero(model.wrap_type == int(kind))}
    equal = {int(model.eq_obj1id[e]) for e in np.flatnonzero(model.eq_type == int(held))}
    return {skeleton.joint_names[j] for j in wrapped - equal}


def _palm_finding(
    analysis: _Analysis, names: Mapping[int, str], overrules: Overrules, hands: int
) -> Finding:
    """Finding about the palm; ``names`` maps the index of a chain to its human finger."""
    skeleton, tree = analysis.skeleton, analysis.tree
    chains = tree.chains
    palm_why = [f"{len(chains)} chains of joints branch from it"]
    palm_sure = 0.95
    nested = [name for i, name in names.items() if chains[i].shared]
    if nested:
        palm_why.append(f"{', '.join(nested)} share a joint inside the palm")
        palm_sure = 0.85
    if above := _above_palm(analysis):
        palm_why.append(f"{len(above)} joints of a wrist or an arm lead to the palm")
    if hands > 1:
        palm_why.append(f"one of {hands} hands in the file, chosen by side")
    if tree.left_out:
        palm_why.append("left out: " + "; ".join(out.why for out in tree.left_out))
        palm_sure -= 0.2
    if overrules.palm is not None:
        palm_sure, palm_why = 1.0, ["given"]
    value = skeleton.body_name(tree.palm)
    return Finding("palm", value, round(palm_sure, 2), tuple(palm_why), "--palm BODY")


def _above_palm(analysis: _Analysis) -> list[int]:
    """Joints that move the whole palm, from the base on."""
    skeleton = analysis.skeleton
    return [j for b in skeleton.path(analysis.tree.palm) for j in skeleton.joints_of(b)]


def _wrist_joints(
    analysis: _Analysis, at: Placement
) -> tuple[tuple[str, ...], tuple[Finding, ...]]:
    """Names of the wrist joints, and the finding if joints lead to the palm.

    More joints than those of a wrist and a turning forearm are an arm's.
    """
    skeleton, above = analysis.skeleton, _above_palm(analysis)
    forward = analysis.layout.forward
    names = tuple(
        skeleton.joint_names[j]
        for j in above
        if skeleton.turns[j] and skeleton.bounded[j] and j not in skeleton.leaders
        if abs(at.axes[j] @ forward) <= MOST_ALONG
    )
    if not above:
        return (), ()
    sure, why = 0.8, f"{counted(len(above), 'joint')} between base and palm"
    if len(above) > MOST_WRIST_JOINTS + 1 or len(names) > MOST_WRIST_JOINTS:
        names, why = (), f"{why}: more joints than a wrist has, so they belong to an arm"
    elif not names:
        why += ", but none of them flexes or deviates the wrist within limits"
    elif all(map(says_wrist, names)):
        sure, why = 0.95, f"{why}; the names say so"
    value, advice = ", ".join(names) or "none", "edit wrist_joints in the spec file"
    return names, (Finding("wrist joints", value, sure, (why,), advice),)


def _place(point: Point) -> str:
    x, y, z = (round(1e3 * c, 1) + 0.0 for c in point.offset)
    return f"{point.body} ({x:.1f}, {y:.1f}, {z:.1f}) mm"
