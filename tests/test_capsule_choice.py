"""Which pairs of shapes a hand is kept clear by, where a vendor's model has too many of them."""

import re
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from capsule_depths import depths, ends_of

from smooth_operator.hands.capsules import MOST, CapsulePairs, capsule_pairs, parts_apart
from smooth_operator.hands.hand import Hand, fingerprint, load_hand_spec
from smooth_operator.hands.penetration import penetration_depths
from smooth_operator.hands.registry import load_hand

_PIECES = 5


@pytest.fixture(scope="module")
def whole() -> Hand:
    return load_hand("allegro_hand")


@pytest.fixture(scope="module")
def in_pieces(whole, tmp_path_factory) -> Hand:
    """The same solid hand, each capsule of it made of five."""

    def cut(match: re.Match[str]) -> str:
        ends = np.array(match[2].split(), float).reshape(2, 3)
        cuts = ends[0] + np.linspace(0, 1, _PIECES + 1)[:, None] * (ends[1] - ends[0])
        text = [" ".join(map(str, [*a, *b])) for a, b in pairwise(cuts)]
        return "".join(f'<geom size="{match[1]}" fromto="{piece}"/>' for piece in text)

    model = whole.spec.model.read_text(encoding="utf-8")
    made, count = re.subn(r'<geom name="\w+" size="(\S+)" fromto="([^"]+)"/>', cut, model)
    assert count > 10
    path = tmp_path_factory.mktemp("model") / whole.spec.model.name
    path.write_text(made, encoding="utf-8")
    return load_hand_spec(replace(whole.spec, model=path))


def poses_of(hand: Hand, count: int) -> np.ndarray:
    """(count, m) random poses, other ones than the pairs are chosen by."""
    return np.random.default_rng(7).uniform(*hand.limits.T, (count, len(hand.limits)))


def deepest(pairs: CapsulePairs, hand: Hand, q: np.ndarray) -> np.ndarray:
    """(T,) depth of the deepest pair [m]."""
    return np.asarray(depths(pairs, ends_of(pairs, hand, q)).max(axis=-1))


def links(pairs: CapsulePairs, hand: Hand) -> set[frozenset[int]]:
    """Which two links each pair is of."""
    return {frozenset(hand.model.geom_bodyid[[int(a), int(b)]].tolist()) for a, b in pairs.shapes}


def test_of_too_many_pairs_those_are_kept_that_meet_most(whole, in_pieces):
    pairs = capsule_pairs(in_pieces)
    assert len(pairs.pairs) == MOST
    apart, all_of_them = links(pairs, in_pieces), links(capsule_pairs(whole), whole)
    assert apart <= all_of_them
    assert len(apart) > 0.9 * len(all_of_them)  # of so many, fewer poses are tried
    # in other poses, too, they know of nearly all that is deep
    q = poses_of(in_pieces, 400)
    true = penetration_depths(in_pieces, in_pieces.full_configuration(q))
    deep = true > 0.004
    assert (deepest(pairs, in_pieces, q)[deep] > 0).mean() > 0.9


def test_hands_that_move_alike_but_are_of_other_shapes_share_no_program(whole, in_pieces):
    """Or one would be kept clear by the shapes of the other."""
    assert whole.joint_names == in_pieces.joint_names
    assert fingerprint(in_pieces) != fingerprint(whole)
    assert fingerprint(load_hand_spec(whole.spec)) == fingerprint(whole)


def test_a_forearm_without_a_wrist_counts_though_it_does_not_hang_from_the_palm(whole, tmp_path):
    """A shape on the body that the palm is fixed to is as good as one on the palm itself, and those
    of an arm above it are nothing to the hand."""
    text = whole.spec.model.read_text(encoding="utf-8")
    palm = text.index(f'<body name="{whole.spec.palm}"')
    end = text.index(">", palm) + 1
    block = '<geom type="sphere" size="0.03" pos="0.1 0.02 0.05"/>'
    turned = 'pos="0.3 -0.2 0.1" quat="0.5 0.5 -0.5 0.5"'
    # the block's place in the frame above the palm: p_above = T p_palm
    place = text[palm:end]
    assert "pos=" not in place
    assert "quat=" not in place
    bodies = {
        "palm": text[:end] + block + text[end:],
        "forearm": text[:palm]
        + f'<body name="arm" {turned}><joint name="elbow" type="hinge" axis="1 0 0" range="-1 1"/>'
        + '<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>'
        + '<geom type="sphere" size="0.2"/><body name="forearm" pos="0 0 0.3">'
        + block
        + text[palm : text.rindex("</worldbody>")]
        + "</body></body>"
        + text[text.rindex("</worldbody>") :],
    }
    found = {}
    for name, model in bodies.items():
        path = tmp_path / f"{name}.xml"
        path.write_text(model, encoding="utf-8")
        hand = load_hand_spec(replace(whole.spec, model=path))
        pairs = capsule_pairs(hand)
        q = poses_of(hand, 200)
        found[name] = deepest(pairs, hand, q)
        assert len(pairs.pairs) > len(capsule_pairs(whole).pairs)
    np.testing.assert_allclose(found["forearm"], found["palm"], atol=1e-9)


def test_a_flat_mesh_is_as_large_as_the_box_that_it_is(whole, tmp_path):
    """A palm is a row of capsules in both forms."""
    text = whole.spec.model.read_text(encoding="utf-8")
    box = re.search(r'<geom name="palm" type="box" size="([^"]+)" (pos="[^"]+")/>', text)
    half = np.array(box[1].split(), float)
    corners = half * np.stack(np.meshgrid(*[(-1, 1)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    asset = (
        f'<asset><mesh name="p" vertex="{" ".join(f"{v:.6f}" for v in corners.ravel())}"/></asset>'
    )
    made = text.replace(box[0], f'<geom name="palm" type="mesh" mesh="p" {box[2]}/>')
    path = tmp_path / "mesh.xml"
    path.write_text(made.replace("<worldbody>", asset + "<worldbody>"), encoding="utf-8")
    hand = load_hand_spec(replace(whole.spec, model=path))
    q = poses_of(whole, 200)
    found, expected = (penetration_depths(h, h.full_configuration(q)) for h in (hand, whole))
    np.testing.assert_allclose(found, expected, atol=1e-6)
    assert len(parts_apart(hand).pairs) == len(parts_apart(whole).pairs)


def test_what_a_model_excludes_from_collision_stays_excluded(whole, tmp_path):
    """By a pair of bodies, or by the bits of its shapes."""
    text = whole.spec.model.read_text(encoding="utf-8")
    body = whole.model.body
    tips = [finger.tip.body for finger in whole.spec.fingers[:2]]
    pair = frozenset(int(body(name).id) for name in tips)
    assert pair in links(parts_apart(whole), whole)
    exclude = f'<contact><exclude body1="{tips[0]}" body2="{tips[1]}"/></contact>'
    bits = re.sub(
        rf'(<body name="{tips[0]}".*?<geom )',
        r'\1contype="2" conaffinity="2" ',
        text,
        count=1,
        flags=re.DOTALL,
    )
    for number, made in enumerate((text.replace("<actuator>", exclude + "<actuator>"), bits)):
        path = tmp_path / f"{number}.xml"
        path.write_text(made, encoding="utf-8")
        hand = load_hand_spec(replace(whole.spec, model=path))
        assert len(parts_apart(hand).pairs) < len(parts_apart(whole).pairs)
        assert pair not in links(parts_apart(hand), hand)
