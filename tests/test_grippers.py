"""Grippers: one jaw that closes against a fixed one, or two jaws of one motor."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from discovery_hands import Part, claw, found_in, mjcf, sure, urdf, written
from scipy.stats import spearmanr

from smooth_operator.errors import HandModelError, UnknownNameError
from smooth_operator.formats.readers import read_recording
from smooth_operator.formats.toml_writer import toml_value
from smooth_operator.hand_discovery import check_hand
from smooth_operator.hand_discovery.discover import discover
from smooth_operator.hand_discovery.landmarks import UNSURE, Discovery, Overrules
from smooth_operator.hand_files.user_hands import save_hand
from smooth_operator.hands.hand import Hand, load_hand_spec
from smooth_operator.hands.registry import load_hand
from smooth_operator.hands.spec import Point
from smooth_operator.hands.spec_file import read_hand_spec
from smooth_operator.retargeting.retargeter import Retargeter
from smooth_operator.synthetic import SyntheticOperator
from smooth_operator.types import HandRecording

pytestmark = pytest.mark.usefixtures("elsewhere")

X, Y, Z = np.eye(3)
JAW = 0.09  # length of the jaws [m]


def one_jaw(*, slide: bool = False) -> tuple[Part, ...]:
    """A gripper at the end of an arm: a fixed jaw, and one that opens to the side of +x."""
    arm = [
        Part("lower", None, 0 * X, axis=Z, joint="turn", limits=(-2.0, 2.0), end=0.2 * Z),
        Part("upper", "lower", 0.2 * Z, axis=Y, joint="roll", limits=(-2.0, 2.0), end=0.1 * Z),
    ]
    grip = Part("grip", "upper", 0.12 * Z, axis=Z, joint="wrist", limits=(-2.0, 2.0))
    fixed = Part("fixed", "grip", -0.006 * X, end=JAW * Z)
    jaw = Part("jaw", "grip", 0.006 * X, axis=Y, joint="jaw_j", limits=(-0.1, 1.4), end=JAW * Z)
    if slide:
        jaw = replace(jaw, axis=X, limits=(0, 0.06), slide=True)
    return (*arm, grip, fixed, jaw)


def two_jaws() -> str:
    """Two sliding jaws that an equality and the tendon of a motor couple."""
    tendon = (
        '<tendon><fixed name="t"><joint joint="lf" coef="0.5"/><joint joint="rf" coef="0.5"/>'
        '</fixed></tendon><actuator><motor tendon="t"/></actuator></mujoco>'
    )
    parts = [p if p.joint != "lf" else replace(p, mimic=("rf", 1.0, 0.0)) for p in claw()]
    return mjcf(tuple(parts)).replace("</mujoco>", tendon)


def found_jaw(folder: Path, **options: object) -> Discovery:
    return found_in(folder, urdf(one_jaw(**options)), overrules=Overrules(gripper="jaw_j"))


def opening(hand: Hand, q: np.ndarray) -> np.ndarray:
    """Distance of the pads [m]."""
    tips = hand.tips(hand.full_configuration(q))
    return np.linalg.norm(tips[..., 0, :] - tips[..., 1, :], axis=-1)


@pytest.mark.parametrize("slide", [False, True])
def test_one_jaw_and_a_fixed_one_are_index_and_thumb(tmp_path, slide):
    found = found_jaw(tmp_path, slide=slide)
    spec = found.spec
    assert (spec.palm, spec.gripper) == ("grip", True)
    assert [(f.name, f.joints) for f in found.fingers] == [("thumb", ()), ("index", ("jaw_j",))]
    assert min(finding.confidence for finding in found.findings) > UNSURE
    hand = load_hand_spec(spec)
    assert hand.actuated_names == ("jaw_j",)  # the arm is no part of it
    openings = opening(hand, np.linspace(*hand.limits[0], 30)[:, None])
    closed = openings if slide else openings[2:]  # the limit lets the jaws overlap
    assert (np.diff(closed) > 0).all()
    assert openings.min() < 0.015
    assert openings.max() == pytest.approx(0.066 if slide else 1.2 * JAW, rel=0.25)
    low, high = hand.limits[0]
    assert low < hand.neutral[0] < high


def test_the_pads_that_the_user_names_are_used(tmp_path):
    path = written(tmp_path, urdf(one_jaw()))
    pads = (("thumb", Point("fixed", (0.0, 0.0, 0.07))), ("index", Point("jaw", (0.0, 0.0, 0.08))))
    wrist = Point("grip", (0.0, 0.0, -0.05))
    found = discover(path, overrules=Overrules(gripper="jaw_j", tips=pads, wrist=wrist))
    assert [f.tip for f in found.spec.fingers] == [point for _, point in pads]
    assert found.spec.wrist == wrist
    with pytest.raises(HandModelError, match=r"fixed to that jaw: 'grip', 'fixed'"):
        discover(
            path, overrules=Overrules(gripper="jaw_j", tips=(("thumb", Point("jaw", (0, 0, 0))),))
        )


@pytest.mark.parametrize(
    ("joint", "error", "message"),
    [
        ("jaw", UnknownNameError, r"unknown joint 'jaw'.*jaw_j"),
        ("wrist", HandModelError, r"changes the gap .* expected the joint of a jaw"),
    ],
)
def test_a_joint_that_is_no_jaw_is_refused(tmp_path, joint, error, message):
    with pytest.raises(error, match=message):
        found_in(tmp_path, urdf(one_jaw()), overrules=Overrules(gripper=joint))


def test_a_joint_above_two_jaws_is_refused(tmp_path):
    parts = (Part("arm", None, 0 * X, axis=Z, joint="turn", end=0.1 * Z), *claw())
    parts = tuple(p if p.name != "hand" else replace(p, parent="arm") for p in parts)
    with pytest.raises(HandModelError, match="moves 2 chains"):
        found_in(tmp_path, urdf(parts), overrules=Overrules(gripper="turn"))
    found = found_in(tmp_path, urdf(parts), overrules=Overrules(gripper="lf"))
    assert found.spec.palm == "hand"
    assert sorted(f.tip_body for f in found.fingers) == ["lf", "rf"]


def test_jaws_without_shapes_are_refused(tmp_path):
    parts = tuple(replace(p, end=None) for p in one_jaw())
    with pytest.raises(HandModelError, match=r"no shape that can be read; put the mesh files"):
        found_in(tmp_path, urdf(parts), overrules=Overrules(gripper="jaw_j"))


def test_an_equality_and_a_tendon_on_two_jaws_leave_one_motor(tmp_path):
    """As on Franka's hand; the joints had followed each other."""
    found = found_in(tmp_path, two_jaws(), "model.xml")
    assert (found.spec.gripper, sure(found, "side")) == (True, 1.0)
    hand = load_hand_spec(found.spec)
    assert [(c.joint, c.follows) for c in hand.couplings] == [("lf", "rf")]
    assert hand.actuated_names == ("rf",)


def test_either_side_loads_a_gripper(tmp_path, own_hands):
    """Its model has no mirror image, so one with meshes loads as well."""
    found = found_jaw(tmp_path)
    file = save_hand(found.spec)
    right, left = (load_hand(found.spec.name, side) for side in ("right", "left"))
    assert (right.spec.side, left.spec.side) == ("right", "left")
    assert not left.spec.mirror
    places = [hand.landmark_positions(hand.neutral) for hand in (right, left)]
    np.testing.assert_array_equal(*places)
    text = file.read_text()
    assert f"gripper = {toml_value(True)}\n" in text
    (tmp_path / "three.toml").write_text(text.replace("[fingers.index]", "[fingers.ring]"))
    with pytest.raises(HandModelError):  # align names the index finger
        read_hand_spec(tmp_path / "three.toml")


def test_check_accepts_a_gripper(tmp_path):
    validation = check_hand(found_jaw(tmp_path).spec.mirrored, methods=("sbr", "smooth"), poses=4)
    assert validation.ok, validation.failed
    assert validation["side"].measured.startswith("a gripper has no side")
    assert validation["round trip: smooth"].verdict == "unjudged"


def jaw_follows(hand: Hand, recording: HandRecording) -> None:
    """The opening grows with the distance of the human's thumb and index finger, over its range."""
    retargeter = Retargeter(hand)
    index = list(hand.actuated)
    q = np.array([retargeter(frame).command.joint_positions[index] for frame in recording])
    human = np.linalg.norm(recording.landmarks[:, 4] - recording.landmarks[:, 8], axis=-1)
    robot = opening(hand, q)
    assert spearmanr(human, robot).statistic > 0.97
    every = opening(hand, np.linspace(*hand.limits[0], 200)[:, None])
    closed, opened = every.min(), every.max()
    assert robot[human < 0.012].max(initial=closed) < closed + 0.1 * (opened - closed)
    assert robot[np.argmax(human)] > closed + 0.7 * (opened - closed)


@pytest.mark.parametrize(("jaws", "side"), [(1, "left"), (2, "right")])
def test_a_pinch_closes_the_jaws(tmp_path, jaws, side):
    found = found_jaw(tmp_path) if jaws == 1 else found_in(tmp_path, two_jaws(), "model.xml")
    spec = found.spec if side == "right" else found.spec.mirrored
    jaw_follows(load_hand_spec(spec), SyntheticOperator(side=side, rate_hz=30).record(12.0))


@pytest.mark.shared
def test_a_recorded_pinch_closes_the_jaw_of_a_real_gripper(shared):
    model = shared / "hands_new/so101/SO101/so101_new_calib.urdf"
    if not model.is_file():
        pytest.skip("the model of that gripper is not there")
    found = discover(model, overrules=Overrules(gripper="gripper"))
    # the maker's frame between the jaws is 98 mm along the fixed one
    assert np.linalg.norm(np.subtract(found.spec.fingers[0].tip.offset, (-0.008, 0, -0.098))) < 0.01
    recording = read_recording(shared / "recordings/manus_right_subject-000_run-010.npz")
    jaw_follows(load_hand_spec(found.spec), recording[2080:3100:4])
