"""The findings as a checklist, each with the option that overrules it."""

from __future__ import annotations

from collections.abc import Mapping

from smooth_operator.hands.spec import HandSpec, Point
from smooth_operator.lab.discovery.branches import HandTree
from smooth_operator.lab.discovery.findings import Finding
from smooth_operator.lab.discovery.layout import Layout
from smooth_operator.lab.discovery.skeleton import Skeleton
from smooth_operator.lab.discovery.thumb import Thumb
from smooth_operator.lab.discovery.tips import Tip


def checklist(
    *,
    skeleton: Skeleton,
    tree: HandTree,
    layout: Layout,
    thumb: Thumb,
    order: tuple[int, ...],
    names: tuple[str, ...],
    overruled: frozenset[str],
    tips: Mapping[int, Tip],
    coupled: Finding,
    wrist: tuple[Point, float, tuple[str, ...]],
    bases: Finding,
    neutral: tuple[str, ...],
    spec: HandSpec,
    palm_given: bool,
    hands: int,
) -> tuple[Finding, ...]:
    """Puts what was found into words.

    Args:
        skeleton: the model.
        tree: palm and chains.
        layout: side and order.
        thumb: index of the thumb.
        order: chains, thumb first.
        names: their human fingers.
        overruled: human fingers whose chains a person named.
        tips: chain -> tip.
        coupled: finding about joints that follow another.
        wrist: point, confidence, reasons.
        bases: finding about the fingers' bases.
        neutral: the neutral pose in words.
        spec: the description.
        palm_given: True if a person named the palm.
        hands: number of hands in the file.
    """
    chains = tree.chains
    palm_why = [f"{len(chains)} chains of joints branch from it"]
    palm_sure = 0.95
    nested = [n for i, n in zip(order, names, strict=True) if chains[i].shared]
    if nested:
        palm_why.append(f"{', '.join(nested)} share a joint inside the palm")
        palm_sure = 0.85
    above = [j for b in skeleton.path(tree.palm) for j in skeleton.joints_of(b)]
    if above:
        palm_why.append(f"{len(above)} joints lead to it: an arm or wrist, no part of the hand")
    if hands > 1:
        palm_why.append(f"one of {hands} hands in the file, chosen by side")
    if tree.left_out:
        palm_why.append("left out: " + "; ".join(tree.left_out))
        palm_sure -= 0.15
    if palm_given:
        palm_sure, palm_why = 1.0, ["given"]

    out = [
        Finding("side", layout.side, layout.side_confidence, layout.side_evidence, "--side left"
                if layout.side == "right" else "--side right"),
        Finding("palm", spec.palm, round(palm_sure, 2), tuple(palm_why), "--palm BODY"),
        Finding(
            "thumb",
            _chain_value(skeleton, chains[order[0]].joints),
            thumb.confidence,
            thumb.evidence,
            "--thumb BODY (any body or joint of the right one)",
        ),
        Finding(
            "order",
            ", ".join(names),
            1.0 if overruled >= set(names) else layout.order_confidence,
            layout.order_evidence,
            f"--finger {names[-1]}=BODY (any body or joint of the right one)",
        ),
    ]  # fmt: skip
    for i, name in zip(order, names, strict=True):
        tip = tips[i]
        x, y, z = _millimetres(tip.point)
        out.append(
            Finding(
                f"tip of {name}",
                f"{tip.point.body} ({x:.1f}, {y:.1f}, {z:.1f}) mm",
                tip.confidence,
                tip.evidence,
                f"--tip {name}=BODY:x,y,z (metres)",
            )
        )
    out.append(coupled)
    point, sure, why = wrist
    x, y, z = _millimetres(point)
    out.append(
        Finding(
            "wrist",
            f"{point.body} ({x:.1f}, {y:.1f}, {z:.1f}) mm",
            sure,
            why,
            "--wrist BODY:x,y,z (metres)",
        )
    )
    out.append(bases)
    out.append(
        Finding(
            "neutral",
            f"{len(spec.neutral)} joints",
            0.8,
            neutral,
            "edit [neutral] in the spec file",
        )
    )
    return tuple(out)


def _chain_value(skeleton: Skeleton, joints: tuple[int, ...]) -> str:
    return " → ".join(skeleton.joint_names[j] for j in joints)


def _millimetres(point: Point) -> list[float]:
    return [round(1e3 * c, 1) + 0.0 for c in point.offset]
