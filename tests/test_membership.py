"""What of a model is the hand: neither the arm that carries it nor a second hand beside it."""

import mujoco
import numpy as np
import pytest
from discovery_hands import make_hand, mjcf, urdf
from trees import limited_poses, mujoco_points, pincer, pincer_spec

from smooth_operator import Retargeter
from smooth_operator.errors import HandModelError
from smooth_operator.hand_discovery.discover import discover
from smooth_operator.hand_files.vendor_model import on_model
from smooth_operator.hands.hand import Hand, load_hand_spec
from smooth_operator.hands.penetration import penetration_depths
from smooth_operator.hands.spec import Coupling, select_fingers
from smooth_operator.retargeting.registry import DEFAULT_METHOD
from smooth_operator.synthetic import SyntheticOperator
from smooth_operator.teleop.pages.hand_view import HandView

pytestmark = pytest.mark.usefixtures("elsewhere")


def world_tips(hand: Hand, q: np.ndarray) -> np.ndarray:
    """(T, f, 3) fingertips in the palm frame by MuJoCo, with the whole model posed."""
    tips = [finger.tip for finger in hand.spec.fingers]
    placed = [(int(hand.model.body(p.body).id), np.array(p.offset)) for p in tips]
    palm = int(hand.model.body(hand.spec.palm).id)
    return mujoco_points(hand.model, palm, placed, hand.qpos(hand.full_configuration(q)))


@pytest.mark.parametrize("form", ["urdf", "mjcf", "mjcf with motors"])
def test_joints_of_an_arm_are_none_of_the_hands(tmp_path, form):
    made = make_hand(3, arm=6, coupled=True)
    text = urdf(made.parts) if form == "urdf" else mjcf(made.parts)
    if "motors" in form:  # of the arm alone: the hand's are on another controller
        motors = "".join(f'<motor joint="aj{k}"/>' for k in range(6))
        text = text.replace("</mujoco>", f"<actuator>{motors}</actuator></mujoco>")
    path = tmp_path / ("m.urdf" if form == "urdf" else "m.xml")
    path.write_text(text)
    hand = load_hand_spec(discover(path).spec)
    arm = {part.joint for part in made.parts if part.joint.startswith("aj")}
    assert len(arm) == 6
    assert not arm & set(hand.joint_names)
    own = {part.joint for part in made.parts if part.joint} - arm
    assert set(hand.joint_names) == own
    order = [hand.model.joint(name).id for name in hand.joint_names]
    assert order == sorted(order)  # the model's own
    followers = {part.joint for part in made.parts if part.mimic}
    assert set(hand.actuated_names) == own - followers
    assert hand.full_configuration(hand.neutral).shape == (len(own),)
    assert hand.joint_limits.shape == (len(own), 2)
    if form == "urdf":
        bare = tmp_path / "bare.urdf"
        bare.write_text(urdf(make_hand(3, coupled=True).parts))
        there = on_model(load_hand_spec(discover(bare, name="gadget").spec), path)
        assert there.joint_names == hand.joint_names
        assert there.model.njnt == len(there.joint_names) + 6
    q = limited_poses(np.random.default_rng(0), hand.limits, 50)
    np.testing.assert_allclose(
        hand.tips(hand.full_configuration(q)), world_tips(hand, q), atol=1e-12
    )


def test_an_arm_is_not_drawn_and_does_not_collide(tmp_path):
    path = tmp_path / "m.urdf"
    path.write_text(urdf(make_hand(3, arm=6).parts))
    hand = load_hand_spec(discover(path).spec)
    drawn = {hand.model.body(body).name for body in HandView(hand).meshes}
    assert "palm" in drawn
    # but for the flange that the palm is bolted to
    assert {name for name in drawn if name.startswith("a")} == {"a5"}
    assert hand.bodies[[hand.model.body(name).id for name in drawn]].all()
    every = hand.full_configuration(hand.neutral)[None]
    assert penetration_depths(hand, every) == pytest.approx([0.0])


@pytest.mark.shared
@pytest.mark.parametrize("side", ["right", "left"])
def test_of_two_hands_in_a_file_one_is_commanded(shared, side):
    path = shared / "hands_urdf/shadow_hand/bimanual.urdf"
    hand = load_hand_spec(discover(path, side=side).spec)
    prefix = "rh_" if side == "right" else "lh_"
    assert hand.model.njnt == 48
    assert len(hand.joint_names) == len(hand.actuated) == 22
    assert all(name.startswith(prefix) for name in hand.joint_names)
    assert not [name for name in hand.joint_names if "WRJ" in name]
    seen = [hand.model.body(int(b)).name for b in np.flatnonzero(hand.bodies)]
    assert all(name.startswith(prefix) for name in seen)
    q = limited_poses(np.random.default_rng(0), hand.limits, 50)
    np.testing.assert_allclose(
        hand.tips(hand.full_configuration(q)), world_tips(hand, q), atol=1e-12
    )
    # nothing of the other hand moves
    data = mujoco.MjData(hand.model)
    other = [j for j in range(48) if hand.model.joint(j).name not in hand.joint_names]
    data.qpos[:] = hand.qpos(hand.full_configuration(q))[7]
    np.testing.assert_array_equal(data.qpos[other], hand.model.qpos0[other])


def test_a_free_cube_and_a_wheel_do_not_matter(tmp_path):
    spec = pincer(tmp_path, actuated=())
    cube = '<body name="cube" pos="1 0 0"><freejoint name="free"/><geom size="0.02"/></body>'
    knob = '<body name="knob"><joint name="knob" axis="0 0 1"/><geom size="0.005"/></body>'
    text = spec.model.read_text().replace("<worldbody>", f"<worldbody>{cube}")
    path = tmp_path / "scene.xml"
    path.write_text(text.replace('<body name="t1"', f'{knob}<body name="t1"'))
    hand = load_hand_spec(pincer_spec(path))
    assert hand.joint_names == ("knob", "t1", "t2", "i1", "i2", "i3")
    assert hand.actuated_names == ("t1", "t2", "i1", "i2", "i3")  # nothing turns the knob
    q = limited_poses(np.random.default_rng(1), hand.limits, 10)
    np.testing.assert_allclose(
        hand.tips(hand.full_configuration(q)), world_tips(hand, q), atol=1e-12
    )
    assert hand.qpos(hand.full_configuration(q)).shape == (10, 7 + 6)


def test_what_follows_a_joint_of_the_arm_stays_where_that_is(tmp_path):
    spec = pincer(tmp_path, actuated=("t1", "t2", "i1", "i2"))
    text = spec.model.read_text().replace(
        '<body name="palm">',
        '<body name="palm"><joint name="wrist" axis="0 1 0" range="-1 1" ref="0.4"/>',
    )
    equality = '<equality><joint joint1="i3" joint2="wrist" polycoef="0.1 0.5 0 0 0"/></equality>'
    path = tmp_path / "wrist.xml"
    path.write_text(text.replace("</mujoco>", f"{equality}</mujoco>"))
    hand = load_hand_spec(pincer_spec(path))
    assert "wrist" not in hand.joint_names
    assert hand.couplings == ()
    # 0.1 at the wrist's reference, by which MuJoCo counts
    np.testing.assert_allclose(hand.full_configuration([0, 0, 0, 0])[-1], 0.1)


@pytest.mark.parametrize(
    ("method", "settled"),
    [("joint_angle", 0), pytest.param(DEFAULT_METHOD, 10, marks=pytest.mark.weekly)],
)
def test_a_finger_that_is_left_out_stays_at_neutral_and_in_the_command(tmp_path, method, settled):
    """At once, or after the frames in which what the first one left is worked off."""
    path = tmp_path / "m.urdf"
    path.write_text(urdf(make_hand(3, arm=4, coupled=True).parts))
    spec = discover(path).spec
    whole = load_hand_spec(spec)
    part = load_hand_spec(select_fingers(spec, ("thumb", "index", "middle")))
    assert part.joint_names == whole.joint_names
    assert part.actuated_names == whole.actuated_names
    np.testing.assert_array_equal(part.neutral, whole.neutral)
    moving = {part.joint_names[joint.source] for joint in part.tree.joints}
    left = [i for i, name in enumerate(part.actuated_names) if name not in moving]
    assert len(left) == 6  # two fingers of three actuated joints
    retargeter = Retargeter(part, method=method)
    commands = [
        retargeter(frame).command for frame in SyntheticOperator(seed=1).record(duration=0.3)
    ]
    at = [commands[0].joint_names.index(part.actuated_names[i]) for i in left]
    rest = np.stack([command.joint_positions for command in commands])[:, at]
    assert np.abs(rest - part.neutral[left])[settled:].max() < 0.1


def follower(range_: str, multiplier: float, offset: float) -> str:
    """A thumb of two joints, and a finger whose last joint follows the one before it."""

    def joint(parent: str, child: str, axis: str, limit: str, mimic: str = "") -> str:
        return (
            f'<link name="{child}"/><joint name="{child}" type="revolute"><parent link="{parent}"/>'
            f'<child link="{child}"/><axis xyz="{axis}"/><limit {limit}/>{mimic}</joint>'
        )

    wide, mimic = 'lower="-1" upper="2"', f'multiplier="{multiplier}" offset="{offset}"'
    joints = (
        joint("palm", "t1", "0 1 0", wide),
        joint("t1", "t2", "1 0 0", wide),
        joint("palm", "i1", "1 0 0", wide),
        joint("i1", "i2", "1 0 0", 'lower="0" upper="1"'),
        joint("i2", "i3", "1 0 0", range_, f'<mimic joint="i2" {mimic}/>'),
    )
    return f'<robot name="r"><link name="palm"/>{"".join(joints)}</robot>'


@pytest.mark.parametrize(
    ("limits", "declared", "read"),
    [
        ('lower="-0.8" upper="0"', (0.8, 0.0), (-0.8, 0.0, True)),
        ('lower="-1" upper="-0.2"', (0.8, 0.2), (-0.8, -0.2, True)),  # counted the other way round
        ('lower="-0.9" upper="0.1"', (0.8, 0.0), (-0.8, 0.0, True)),  # wrong but for a little
        ('lower="-0.6" upper="0.5"', (0.8, 0.2), (0.8, 0.2, False)),  # little room, but some
        ('lower="3" upper="4"', (0.8, 0.0), (0.8, 0.0, False)),  # no sign mends this
    ],
)
def test_a_sign_that_the_limits_make_impossible_is_turned(tmp_path, limits, declared, read):
    path = tmp_path / "m.urdf"
    path.write_text(follower(limits, *declared))
    spec = pincer_spec(path)
    if limits.startswith('lower="3"'):
        with pytest.raises(HandModelError, match=r"'i2' has the limits .*coupled joints"):
            load_hand_spec(spec)
        return
    hand = load_hand_spec(spec)
    assert hand.couplings == (Coupling("i3", "i2", *read),)
    low, high = hand.limits[-1]
    assert high - low > 0.1
    ends = hand.full_configuration([[0, 0, 0, low], [0, 0, 0, high]])[:, -1]
    assert (ends >= hand.joint_limits[-1, 0] - 1e-12).all()
    assert (ends <= hand.joint_limits[-1, 1] + 1e-12).all()
