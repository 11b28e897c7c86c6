"""Hands of quite other designs are read right as well, or with honest doubt."""

import numpy as np
import odd_hands
import pytest
from discovery_hands import Model, check, found_in, make_hand, mjcf, sure, tip_errors, urdf

from smooth_operator.errors import HandModelError
from smooth_operator.hand_discovery.checks import Samples
from smooth_operator.hand_discovery.joints import check_wrist
from smooth_operator.hand_discovery.landmarks import SURE, UNSURE, Discovery, Overrules
from smooth_operator.hands.hand import load_hand_spec

pytestmark = pytest.mark.usefixtures("elsewhere")


def check_use(found: Discovery, model: Model) -> None:
    """What is found is true, tips included, and the hand can be used."""
    check(found, model)
    assert tip_errors(found, model.truth.tips).max() < 3e-3
    hand = load_hand_spec(found.spec)
    moved = {j for f in found.fingers for j in f.joints}
    assert moved <= set(hand.joint_names)
    assert moved == {
        p.joint for p in model.parts if p.joint and not p.joint.startswith(("arm", "bar"))
    }
    assert np.isfinite(hand.landmark_positions(hand.neutral)).all()


@pytest.mark.parametrize(("side", "seed"), [("right", 0), ("left", 1)])
@pytest.mark.parametrize(
    "draw", [odd_hands.curled_at_zero, odd_hands.six_joints_a_finger, odd_hands.prosthesis]
)
def test_a_design_of_its_own(tmp_path, draw, seed, side):
    model = draw().model(side, seed)
    found = found_in(tmp_path, urdf(model.parts))
    check_use(found, model)
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
    check_use(found_in(tmp_path, urdf(model.parts), side="right"), model)


def test_joints_on_one_tendon_are_coupled_with_doubt(tmp_path):
    """How they share the tendon's motion is not in the file."""
    model = make_hand(5, arm=6, coupled=True)
    pairs = {p.joint: p.mimic[0] for p in model.parts if p.mimic}
    tendons = "".join(
        f'<fixed name="t_{joint}"><joint joint="{leader}" coef="1"/>'
        f'<joint joint="{joint}" coef="0.7"/></fixed>'
        for joint, leader in pairs.items()
    )
    motors = "".join(f'<motor tendon="t_{joint}"/>' for joint in pairs)
    head = mjcf(model.parts).partition("<equality>")[0]
    more = f"<tendon>{tendons}</tendon><actuator>{motors}</actuator></mujoco>"
    found = found_in(tmp_path, head + more, "model.xml")
    assert {c.coupling.joint: c.coupling.follows for c in found.coupled} == pairs
    assert all(abs(c.coupling.multiplier) == pytest.approx(0.7) for c in found.coupled)
    assert all(c.confidence < SURE for c in found.coupled)


@pytest.mark.parametrize(("side", "seed"), [("right", 0), ("left", 1)])
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
        check_use(found, model)
    joints = {p.joint for p in model.parts if p.joint.startswith("bar")}
    assert not joints & {joint for finger in found.fingers for joint in finger.joints}
    ends = [p.name for p in model.parts if p.name.startswith("bar")]
    ends = [name for name in ends if not any(p.parent == name for p in model.parts)]
    (note,) = (n for n in found.notes if n.startswith("chains that are not used: "))
    assert all(repr(name) in note for name in ends)
    assert sure(found, "palm") < SURE


def test_a_chain_that_was_left_out_is_a_finger_if_it_is_named(tmp_path):
    model = odd_hands.four_bar_gripper().model("right", 0)
    named = found_in(
        tmp_path, urdf(model.parts), overrules=Overrules(thumb="t0", fingers=(("pinky", "bar_t0"),))
    )
    assert [f.tip_body for f in named.fingers if f.name == "pinky"] == ["bar_t0"]


def test_a_piece_of_a_finger_is_no_hand(tmp_path):
    """A palm with too many chains is refused with their names, whatever branches inside one."""
    drawing = odd_hands.curled_at_zero()
    bend = [(0 * odd_hands.X, odd_hands.X, (-0.5, 0.5))]
    for k in range(2):
        place = np.array([-0.05 - 0.02 * k, 0.0, 0.08])
        drawing.finger(f"more{k}", place, 2 * bend, 0.03 * odd_hands.Z)
        fork = np.array([0.01 - 0.02 * k, 0.0, 0.02])
        drawing.finger(f"fork{k}", fork, bend, 0.02 * odd_hands.Z, parent="Daumen2")
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
    found = found_in(tmp_path, text, overrules=Overrules(palm="palm"))
    assert len(found.fingers) == 4
    assert any("rotates without limits" in note for note in found.notes)


def test_check_fails_a_wrist_beside_the_palm(tmp_path):
    """The fingers of opposed pairs point in opposite directions, so the wrist is a guess."""
    found = found_in(tmp_path, urdf(odd_hands.opposed_pairs().model("right", 0).parts))
    assert "wrist" in {guess.subject for guess in found.guesses}
    check = check_wrist(Samples(load_hand_spec(found.spec)))
    assert check.verdict == "failed"
    assert "--wrist" in check.advice
