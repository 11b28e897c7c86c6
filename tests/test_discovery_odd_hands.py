"""Hands of quite other designs are read right as well, or with honest doubt."""

from dataclasses import replace

import numpy as np
import odd_hands
import pytest
from discovery_hands import Model, Part, found_in, make_hand, mjcf, sure, tip_errors, urdf

from smooth_operator.errors import HandModelError
from smooth_operator.hand_discovery.checks import Samples
from smooth_operator.hand_discovery.discover import discover
from smooth_operator.hand_discovery.joints import check_wrist
from smooth_operator.hand_discovery.landmarks import SURE, UNSURE, Discovery, Overrules
from smooth_operator.hands.hand import load_hand_spec
from smooth_operator.hands.registry import hand_names, load_hand

pytestmark = pytest.mark.usefixtures("elsewhere")


def check(found: Discovery, model: Model) -> None:
    """Palm, side, thumb, order and tips are true, and the hand can be used."""
    assert found.spec.palm == model.truth.palm
    assert found.spec.side == model.truth.side
    assert [f.tip_body for f in found.fingers] == [body for body, _ in model.truth.tips]
    assert tip_errors(found, model.truth.tips).max() < 3e-3
    hand = load_hand_spec(found.spec)
    moved = {j for f in found.fingers for j in f.joints}
    assert moved <= set(hand.joint_names)
    assert moved == {
        p.joint for p in model.parts if p.joint and not p.joint.startswith(("arm", "bar"))
    }
    assert np.isfinite(hand.landmark_positions(hand.neutral)).all()


@pytest.mark.parametrize("side", ["right", "left"])
@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize(
    "draw",
    [
        odd_hands.curled_at_zero,
        odd_hands.six_joints_a_finger,
        odd_hands.prosthesis,
        odd_hands.pincer_with_a_wide_thumb,
    ],
)
def test_a_design_of_its_own(tmp_path, draw, seed, side):
    model = draw().model(side, seed)
    found = found_in(tmp_path, urdf(model.parts))
    check(found, model)
    assert sure(found, "thumb") > UNSURE
    assert sure(found, "side") > UNSURE


@pytest.mark.parametrize("seed", [0, 1])
def test_fingers_spread_around_a_palm_have_no_clear_side(tmp_path, seed):
    model = odd_hands.spread_around().model("right", seed)
    found = found_in(tmp_path, urdf(model.parts))
    assert found.fingers[0].tip_body == model.truth.tips[0][0]
    assert sure(found, "thumb") > UNSURE
    assert sure(found, "side") < UNSURE
    assert sure(found, "order") < SURE
    assert tip_errors(found, model.truth.tips)[0] < 3e-3
    spread = next(c.coupling for c in found.coupled if c.coupling.joint == "two0_j")
    assert (spread.follows, spread.multiplier) == ("one0_j", 1.0)
    assert len(load_hand_spec(found.spec).actuated) == 4  # spread, and a bend each
    check(found_in(tmp_path, urdf(model.parts), side="right"), model)


@pytest.mark.parametrize("side", ["right", "left"])
def test_a_hand_of_tendons_on_an_arm(tmp_path, side):
    model = odd_hands.curled_at_zero().model(side, 5)
    parts = []
    for part in model.parts:
        name = part.name
        if name[-1] == "3" and not name.startswith("Daumen"):  # the last joint of a finger
            part = replace(part, mimic=(f"{name[:-1]}2_j", 0.7, 0.0))
        parts.append(part)
    mount = Part("armmount", "arm1", np.array([0.0, 0.0, 0.1]))
    arm = [
        Part(
            "arm0",
            None,
            np.zeros(3),
            axis=odd_hands.Z,
            joint="arm0_j",
            limits=(-3.0, 3.0),
            end=np.array([0.0, 0.0, 0.4]),
            radius=0.05,
        ),
        Part(
            "arm1",
            "arm0",
            np.array([0.0, 0.0, 0.4]),
            axis=odd_hands.Y,
            joint="arm1_j",
            limits=(-2.0, 2.0),
            end=np.array([0.0, 0.0, 0.1]),
            radius=0.04,
        ),
        mount,
    ]
    parts[0] = replace(parts[0], parent="armmount")
    # as MJCF, a finger ends in half a ball, and its tip is on that
    tips = tuple((n, t * (1 + 0.006 / np.linalg.norm(t))) for n, t in model.truth.tips)
    model = Model((*arm, *parts), replace(model.truth, tips=tips))
    text = odd_hands.tendon_text(model, mjcf(model.parts))
    found = found_in(tmp_path, text, "model.xml")
    check(found, model)
    assert {(c.coupling.joint, c.coupling.follows) for c in found.coupled} == {
        (f"{f}3_j", f"{f}2_j") for f in ("Zeige", "Mitte", "Ringf", "Klein")
    }
    assert all(c.coupling.multiplier == pytest.approx(0.7) for c in found.coupled)
    assert all(c.confidence < SURE for c in found.coupled)  # how they share is not in the file
    hand = load_hand_spec(found.spec)
    assert len(hand.actuated) == 4 + 4 * 3


@pytest.mark.parametrize("side", ["right", "left"])
@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize(
    "draw",
    [
        odd_hands.fingers_of_sliders_and_rods,
        odd_hands.behind_a_wrist_with_a_bar,
        odd_hands.four_bar_gripper,
    ],
)
def test_bars_of_a_linkage_are_no_fingers_and_cost_none(tmp_path, draw, seed, side):
    """Every finger is found, no bar is one, and a note names what was left out."""
    model = draw().model(side, seed)
    gripper = draw is odd_hands.four_bar_gripper
    found = found_in(tmp_path, urdf(model.parts), **{"side": side} if gripper else {})
    tips = [f.tip_body for f in found.fingers]
    if gripper:  # either of its two fingers may be the thumb
        assert sorted(tips) == sorted(body for body, _ in model.truth.tips)
    else:
        check(found, model)
    joints = {p.joint for p in model.parts if p.joint.startswith("bar")}
    assert not joints & {joint for finger in found.fingers for joint in finger.joints}
    ends = [p.name for p in model.parts if p.name.startswith("bar")]
    ends = [name for name in ends if not any(p.parent == name for p in model.parts)]
    (note,) = (n for n in found.notes if n.startswith("not used: "))
    assert all(repr(name) in note for name in ends)
    assert sure(found, "palm") < SURE


def test_a_chain_that_was_left_out_is_a_finger_if_it_is_named(tmp_path):
    model = odd_hands.four_bar_gripper().model("right", 0)
    path = tmp_path / "model.urdf"
    path.write_text(urdf(model.parts))
    named = discover(path, overrules=Overrules(thumb="t0", fingers=(("pinky", "bar_t0"),)))
    assert [f.tip_body for f in named.fingers if f.name == "pinky"] == ["bar_t0"]


def test_a_piece_of_a_finger_is_no_hand(tmp_path):
    """A palm with too many chains is refused with their names, whatever branches inside one."""
    drawing = odd_hands.curled_at_zero()
    for k in range(2):  # two more fingers
        finger = [p for p in drawing.parts if p.name.startswith("Klein")]
        drawing.parts += [
            replace(
                p,
                name=f"more{k}{p.name}",
                joint=f"more{k}{p.joint}",
                parent=p.parent if p.parent == drawing.palm else f"more{k}{p.parent}",
                position=p.position - 0.02 * (k + 1) * odd_hands.X * (p.parent == drawing.palm),
            )
            for p in finger
            if not p.name.startswith("more")
        ]
    fork = next(p for p in drawing.parts if p.name == "Daumen2")
    for k, x in enumerate((0.01, -0.01)):
        drawing.parts.append(
            Part(
                f"fork{k}",
                fork.name,
                np.array([x, 0.0, 0.02]),
                axis=odd_hands.X,
                joint=f"fork{k}_j",
                limits=(-0.5, 0.5),
                end=np.array([0.0, 0.0, 0.02]),
            )
        )
    with pytest.raises(HandModelError, match=r"Zeige3.*more than the fingers of a hand"):
        found_in(tmp_path, urdf(drawing.model("right", 0).parts))


def test_a_finger_whose_joints_lack_limits_is_not_lost(tmp_path):
    model = make_hand(3)
    lost = model.truth.tips[-1][0]
    names, parts = {lost}, {p.name: p for p in model.parts}
    while (above := parts[lost].parent) != model.truth.palm:
        names.add(lost := above)
    text = urdf(model.parts)
    for name in names:
        text = text.replace(
            f'name="{parts[name].joint}" type="revolute"',
            f'name="{parts[name].joint}" type="continuous"',
        )
    with pytest.raises(HandModelError, match=r"rotates without limits.*--palm palm"):
        found_in(tmp_path, text)
    (tmp_path / "model.urdf").write_text(text)
    found = discover(tmp_path / "model.urdf", overrules=Overrules(palm="palm"))
    assert len(found.fingers) == 4
    assert any("rotates without limits" in note for note in found.notes)


def test_check_fails_a_wrist_beside_the_palm(tmp_path):
    """The fingers of opposed pairs point in opposite directions, so the wrist is a guess."""
    found = found_in(tmp_path, urdf(odd_hands.opposed_pairs().model("right", 0).parts))
    assert "wrist" in {guess.subject for guess in found.guesses}
    check = check_wrist(Samples(load_hand_spec(found.spec)))
    assert check.verdict == "failed"
    assert "--wrist" in check.advice


@pytest.mark.parametrize("name", hand_names())
def test_check_accepts_the_wrist_of_a_built_in_hand(name):
    assert check_wrist(Samples(load_hand(name))).verdict == "ok"
