"""Landmarks and the pose at rest of a hand that was found: what the alignment goes by stays put."""

from dataclasses import replace

import numpy as np
import pytest
from discovery_hands import Part, because, claw, found_in, make_hand, ring_of_fingers, urdf
from real_hands import REAL

from smooth_operator.hand_discovery.checks import Samples
from smooth_operator.hand_discovery.discover import discover
from smooth_operator.hand_discovery.joints import check_palm
from smooth_operator.hands.hand import Hand, load_hand_spec
from smooth_operator.hands.penetration import neutral_overlaps
from smooth_operator.hands.registry import load_hand

pytestmark = pytest.mark.usefixtures("elsewhere")


def base_travel(hand: Hand) -> np.ndarray:
    """(fingers,) how far random poses move each finger's base in the palm [m]."""
    return np.ptp(Samples(hand).bases, axis=0).max(axis=-1)


def with_moving_knuckle(shift: float) -> tuple[Part, ...]:
    """A hand whose last finger's knuckle is beyond its spreading joint."""
    hand = make_hand(3, turned=False)
    tip = hand.truth.tips[-1][0]
    parent = {p.name: p.parent for p in hand.parts}
    chain = [tip]
    while (above := parent[chain[-1]]) != "palm":
        chain.append(above)
    knuckle = chain[-2]  # the last of the chain spreads
    step = np.array([0.0, 0.0, shift])
    return tuple(
        replace(p, position=p.position + step) if p.name == knuckle else p for p in hand.parts
    )


def test_a_knuckle_that_a_joint_moves_stays_where_it_rests(tmp_path):
    found = found_in(tmp_path, urdf(with_moving_knuckle(0.02)))
    assert found.spec.fingers[-1].base.body == "palm"
    assert all(finger.base.body != "palm" for finger in found.spec.fingers[:-1])
    # the arc of 0.6 rad about a joint that is 20 mm below and somewhat beside
    assert "joints move the finger base of pinky, by up to 13 mm" in because(found, "bases")
    hand = load_hand_spec(found.spec)
    assert base_travel(hand).max() < 1e-4


def test_a_knuckle_that_no_joint_moves_stays_on_its_link(tmp_path):
    found = found_in(tmp_path, urdf(make_hand(3, turned=False).parts))
    assert all(finger.base.body != "palm" for finger in found.spec.fingers)
    assert "no joint moves them" in because(found, "bases")
    assert base_travel(load_hand_spec(found.spec)).max() < 1e-4


def test_hinges_beside_a_finger_give_landmarks_in_its_middle(tmp_path):
    """CAD exports put a hinge's origin at a face of the finger. That of a short last link was kept,
    so its landmark was 12 mm aside of the finger."""
    hand = make_hand(3, turned=False)
    parts = {p.name: p for p in hand.parts}
    for name, _ in hand.truth.tips[1:]:
        part = parts[name]
        aside = 0.012 * part.axis
        parts[name] = replace(part, position=part.position + aside, end=None)
        parts[f"{name}_shape"] = Part(f"{name}_shape", name, -aside, end=part.end)
    hand = load_hand_spec(found_in(tmp_path, urdf(tuple(parts.values()))).spec)
    points = dict(zip(hand.tree.names, hand.landmark_positions(hand.straight_pose.q), strict=True))
    for finger in ("index", "middle", "ring", "pinky"):
        bones = np.diff([points[f"{finger}_{joint}"] for joint in ("pip", "dip", "tip")], axis=0)
        bones /= np.linalg.norm(bones, axis=1)[:, None]
        assert np.degrees(np.arccos(bones[0] @ bones[1])) < 10


def test_a_base_on_a_slide_stays_too(tmp_path):
    found = found_in(tmp_path, urdf(claw()))
    assert base_travel(load_hand_spec(found.spec)).max() < 1e-6
    assert "thumb, index, by up to 4" in because(found, "bases")


MOVING = {
    f"{name} {side}": (real.file, real.moving, name, side)
    for (name, side), real in REAL.items()
    if real.moving
}


@pytest.mark.shared
@pytest.mark.parametrize("model", MOVING)
def test_bases_of_real_hands_stay_as_in_the_catalogue(shared, model):
    file, moving, name, side = MOVING[model]
    found = discover(shared / file)
    hand, ours = load_hand_spec(found.spec), load_hand(name, side)
    assert base_travel(hand).max() < 2e-4
    check = check_palm(Samples(hand))
    assert check.verdict == "ok", check
    said = because(found, "bases")
    assert all(finger in said for finger in moving if finger != "thumb")
    # the distances between the bases are the catalogue's, whatever the palm's frame is
    gaps = []
    for h in (hand, ours):
        at = dict(zip(h.tree.names, h.landmark_positions(h.neutral), strict=True))
        bases = [at[f"{finger}_mcp"] for finger in h.fingers[1:]]
        gaps.append([np.linalg.norm(b - bases[0]) for b in bases])
    np.testing.assert_allclose(gaps[0], gaps[1], atol=4e-3)


def test_a_palm_frame_at_the_thumb_is_no_wrist(tmp_path):
    """What the palm is mounted on is, where nothing better is known."""
    hand = make_hand(2, shapes=False, turned=False)
    thumb = next(p for p in hand.parts if p.parent == "palm" and p.position[0] > 0)
    start = thumb.position
    parts = [Part("mount", None, np.zeros(3))]
    for p in hand.parts:
        if p.name == "palm":
            p = replace(p, parent="mount", position=start)
        elif p.parent == "palm":
            p = replace(p, position=p.position - start)
        parts.append(p)
    found = found_in(tmp_path, urdf(tuple(parts)))
    assert found.spec.palm == "palm"
    np.testing.assert_allclose(found.spec.wrist.offset, -start, atol=1e-6)
    assert "'mount', on which the palm is mounted" in because(found, "wrist")
    plain = found_in(tmp_path, urdf(hand.parts))
    assert plain.spec.wrist.offset == (0.0, 0.0, 0.0)
    assert "origin of the palm" in because(plain, "wrist")


@pytest.mark.shared
@pytest.mark.parametrize("side", ["right", "left"])
def test_the_wrist_of_a_palm_that_is_the_thumbs_base(shared, side):
    found = discover(shared / f"hands_urdf/ability_hand/ability_hand_{side}.urdf")
    hand, ours = load_hand_spec(found.spec), load_hand("ability_hand", side)
    reach = [np.linalg.norm(Samples(h).tips - h.wrist, axis=-1).max() for h in (hand, ours)]
    assert abs(reach[0] - reach[1]) < 1e-4
    assert next(f.confidence for f in found.findings if f.subject == "wrist") < 0.8


def test_fingers_that_would_rest_in_each_other_are_opened(tmp_path):
    wide = found_in(tmp_path, urdf(ring_of_fingers(0.06)))
    assert "overlap" not in because(wide, "neutral")
    found = found_in(tmp_path, urdf(ring_of_fingers(0.025)))
    assert "fingers would overlap" in because(found, "neutral")
    bent = replace(found.spec, neutral=wide.spec.neutral)
    before, after = (
        max(neutral_overlaps(load_hand_spec(spec)).values(), default=0.0)
        for spec in (bent, found.spec)
    )
    assert after < 3e-3 < before
    knuckles = [found.spec.neutral[f"ja{k}"] - wide.spec.neutral[f"ja{k}"] for k in range(3)]
    assert min(knuckles) > 0.1  # outwards
    assert found.spec.neutral["jb0"] == wide.spec.neutral["jb0"]
