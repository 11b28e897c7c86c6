"""Robot hands: the built-in one against the published model, and any MJCF or URDF of one's own."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
from trees import limited_poses, mujoco_points, pincer, pincer_spec

from smooth_operator import LANDMARKS, FingerSpec, HandSpec, Point, load_hand
from smooth_operator.errors import HandModelError, UnknownNameError
from smooth_operator.hands.hand import Hand, load_hand_spec
from smooth_operator.hands.spec import Coupling

pytestmark = pytest.mark.usefixtures("elsewhere")


def mujoco_landmarks(hand: Hand, q: np.ndarray) -> np.ndarray:
    """(T, k, 3) landmarks of a hand by MuJoCo's own kinematics, for positions of all joints."""
    spec = hand.spec
    points = [spec.wrist, *(p for finger in spec.fingers for p in finger.points if p is not None)]
    placed = [
        (int(hand.model.body(p.body).id), np.array((p.mirrored if spec.mirror else p).offset))
        for p in points
    ]
    return mujoco_points(hand.model, int(hand.model.body(spec.palm).id), placed, q)


def equality(first: str, second: str, offset: float, gain: float, more: float = 0.0) -> str:
    """An MJCF equality: first = offset + gain second + more second^2."""
    return f'<joint joint1="{first}" joint2="{second}" polycoef="{offset} {gain} {more} 0 0"/>'


@pytest.fixture
def published(shared) -> Hand:
    """The same description on the published model."""
    spec = load_hand("mimic_p050").spec
    return load_hand_spec(replace(spec, model=shared / "hands/mimic_p050_hand/right_hand.xml"))


@pytest.mark.shared
def test_the_mimic_hand_is_the_published_one(published):
    ours = load_hand("mimic_p050", "right")
    assert ours.tree.names == LANDMARKS
    assert ours.joint_names == published.joint_names
    assert ours.actuated_names == published.actuated_names
    for name in ("joint_limits", "limits", "neutral"):
        np.testing.assert_allclose(getattr(ours, name), getattr(published, name), atol=1e-9)
    q = limited_poses(np.random.default_rng(0), ours.limits, 1000)
    theirs = mujoco_landmarks(published, published.full_configuration(q))
    assert np.linalg.norm(ours.landmark_positions(q) - theirs, axis=-1).max() < 1e-6


def test_mirroring_slides_and_anchors(tmp_path):
    spec = pincer(tmp_path, t1='type="slide" range="0 0.02"', i2='pos="0.01 0.01 0.01" range="0 1"')
    right = load_hand(spec)
    left = load_hand(replace(spec, mirror=True, side="left"))
    q = limited_poses(np.random.default_rng(2), right.limits, 20)
    np.testing.assert_allclose(
        left.landmark_positions(q), right.landmark_positions(q) * (-1, 1, 1), atol=1e-12
    )


LINE = equality("i3", "i2", 0.1, 0.5)
ACTUATED = ("t1", "t2", "i1", "i2")


@pytest.mark.parametrize(
    ("text", "actuated", "q", "expected"),
    [
        (LINE, ACTUATED, 1.0, [0.6]),
        (equality("i2", "i3", 0.1, 0.5), ACTUATED, 0.6, [1.0]),  # i2 = 0.1 + i3 / 2
        (equality("i2", "i3", 0.1, 0.5), ACTUATED, 0.1, [0.0]),
        (
            equality("i3", "i2", 0.1, 2) + equality("i2", "i1", -0.2, 0.5),
            ACTUATED[:3],
            1,
            [0.3, 0.7],
        ),
        (LINE.replace("/>", ' active="false"/>'), ACTUATED, 1.0, [0.0]),  # nothing drives it
    ],
    ids=["first", "second", "at zero", "followers of followers", "inactive"],
)
def test_an_equality_moves_its_follower(tmp_path, text, actuated, q, expected):
    hand = load_hand(pincer(tmp_path, equality=text, actuated=actuated, i3='range="-3 5"'))
    assert hand.actuated_names == actuated
    every = hand.full_configuration([*np.zeros(len(hand.actuated) - 1), q])
    np.testing.assert_allclose(every[-len(expected) :], expected, atol=1e-12)


def test_limits_are_narrowed_by_followers(tmp_path):
    hand = load_hand(pincer(tmp_path, equality=LINE, i3='range="0 0.6"'))  # i3 = 0.1 + i2 / 2
    np.testing.assert_allclose(hand.limits[-1], [-0.2, 1.0])
    np.testing.assert_array_equal(hand.joint_limits[3], [-1, 2])
    q = hand.full_configuration(limited_poses(np.random.default_rng(6), hand.limits, 500))
    assert (q >= hand.joint_limits[:, 0] - 1e-12).all()
    assert (q <= hand.joint_limits[:, 1] + 1e-12).all()
    falling = equality("i3", "i2", 0.1, -0.5)
    hand = load_hand(pincer(tmp_path, equality=falling, i3='range="0 0.6"'))
    np.testing.assert_allclose(hand.limits[-1], [-1.0, 0.2])


def test_a_neutral_pose_is_brought_within_the_limits(tmp_path):
    spec = pincer(tmp_path, t1='range="0.5 1"')
    hand = load_hand(replace(spec, neutral={"i1": 0.7, "i2": 9.0}))
    np.testing.assert_allclose(hand.neutral, [0.5, 0.0, 0.7, 2.0])


RING = equality("i3", "i2", 0, 1) + equality("i2", "i3", 0, 1)


@pytest.mark.parametrize(
    ("text", "changes", "message"),
    [
        ('<joint joint1="i3" polycoef="0.4 0 0 0 0"/>', {}, "must be a polynomial"),
        (equality("i3", "i2", 0.4, 0), {}, "must be a polynomial"),
        (LINE, {"i3": 'range="5 6"'}, r"joint 'i2' has the limits .*coupled joints"),
        (RING, {"actuated": ("t1", "t2", "i1")}, "nothing drives"),
        (RING, {"actuated": ("i2", "i3")}, "no joint that can be commanded"),
    ],
)
def test_couplings_that_can_not_be_are_refused(tmp_path, text, changes, message):
    with pytest.raises(HandModelError, match=message):
        load_hand(pincer(tmp_path, equality=text, **changes))


URDF = """<robot name="pincer">
  <link name="palm">{visual}</link>
  <link name="t1">{mass}</link><link name="t2">{mass}</link>
  <link name="i1">{mass}</link><link name="i2">{mass}</link><link name="i3"/><link name="i_tip"/>
  <joint name="t1" type="revolute"><parent link="palm"/><child link="t1"/>
    <origin xyz="0.03 0 0.01"/><axis xyz="0 1 0"/><limit lower="-1" upper="2"/></joint>
  <joint name="t2" type="revolute"><parent link="t1"/><child link="t2"/>
    <origin xyz="0 0 0.03"/><axis xyz="1 0 0"/><limit lower="-1" upper="2"/></joint>
  <joint name="i1" type="revolute"><parent link="palm"/><child link="i1"/>
    <origin xyz="0 0.01 0.05" rpy="0.1 0.2 0.3"/><axis xyz="1 0 0"/>
    <limit lower="-1" upper="2"/></joint>
  <joint name="i2" type="revolute"><parent link="i1"/><child link="i2"/>
    <origin xyz="0 0 0.03"/><axis xyz="1 0 0"/><limit lower="-1" upper="2"/>{mimic2}</joint>
  <joint name="i3" type="revolute"><parent link="i2"/><child link="i3"/>
    <origin xyz="0 0 0.02"/><axis xyz="1 0 0"/><limit lower="-0.5" upper="1.2"/>{mimic}</joint>
  <joint name="i_tip" type="fixed"><parent link="i3"/><child link="i_tip"/>
    <origin xyz="0 0.01 0.02"/></joint>
</robot>"""
MASS = (  # an inertia that no body has
    '<inertial><mass value="0.1"/>'
    '<inertia ixx="1" iyy="1" izz="9" ixy="0" ixz="0" iyz="0"/></inertial>'
)
MISSING = (
    '<visual><geometry><mesh filename="package://robot/meshes/none.stl"/></geometry></visual>'
    + ('<collision><geometry><mesh filename="meshes/none.obj"/></geometry></collision>')
)


def urdf(folder: Path, *, mimic: str = "", mimic2: str = "", visual: str = "") -> HandSpec:
    path = folder / "pincer.urdf"
    path.write_text(URDF.format(mimic=mimic, mimic2=mimic2, visual=visual, mass=MASS))
    spec = pincer_spec(path)
    return replace(
        spec,
        fingers=(
            spec.fingers[0],
            FingerSpec("index", (Point("i1"), Point("i2"), Point("i3"), Point("i_tip"))),
        ),
    )


MIMIC = '<mimic joint="i2" multiplier="0.5" offset="-0.1"/>'


def test_a_urdf_with_a_mimic(tmp_path):
    hand = load_hand(urdf(tmp_path, mimic=MIMIC))
    assert hand.couplings == (Coupling("i3", "i2", 0.5, -0.1),)
    assert hand.joint_names == ("t1", "t2", "i1", "i2", "i3")
    assert hand.actuated_names == ("t1", "t2", "i1", "i2")
    np.testing.assert_allclose(hand.full_configuration([0, 0, 0, 1.0])[-1], 0.4)
    np.testing.assert_allclose(hand.limits[-1], [-0.8, 2.0])  # -0.5 = 0.5 q - 0.1
    q = limited_poses(np.random.default_rng(7), hand.limits, 20)
    np.testing.assert_allclose(
        hand.landmark_positions(q), mujoco_landmarks(hand, hand.full_configuration(q)), atol=1e-12
    )
    bare = load_hand(urdf(tmp_path, mimic=MIMIC, visual=MISSING))  # missing meshes do not matter
    np.testing.assert_array_equal(hand.landmark_positions(q), bare.landmark_positions(q))
    # the fingertip is a link on a fixed joint, which the compiler must not have folded away
    at_rest = hand.landmark_positions([0, 0, 0, 0.2])  # i3 = 0
    dip, tip = (hand.tree.names.index(f"index_{name}") for name in ("dip", "tip"))
    np.testing.assert_allclose(np.linalg.norm(at_rest[tip] - at_rest[dip]), np.hypot(0.01, 0.02))


def test_a_model_of_meshes_has_no_mirror_image(tmp_path):
    spec = pincer(tmp_path)
    text = spec.model.read_text()
    text = text.replace("<worldbody>", '<asset><mesh name="m" file="no.stl"/></asset><worldbody>')
    text = text.replace('<geom size="0.01"/>', '<geom type="mesh" mesh="m"/>')
    spec.model.write_text(text)
    with pytest.raises(HandModelError, match="meshes can't be mirrored"):
        load_hand(replace(spec, mirror=True, side="left"))


def test_mimic_defaults_and_chains(tmp_path):
    chain = '<mimic joint="i1" multiplier="-1" offset="0.3"/>'
    hand = load_hand(urdf(tmp_path, mimic='<mimic joint="i2"/>', mimic2=chain))
    np.testing.assert_allclose(hand.full_configuration([0, 0, 0.2]), [0, 0, 0.2, 0.1, 0.1])
    np.testing.assert_allclose(hand.limits[-1], [-0.9, 0.8])  # 0.3 - q within [-0.5, 1.2]


def test_a_mimic_of_an_unknown_joint_or_without_numbers(tmp_path):
    with pytest.raises(UnknownNameError, match=r"unknown joint 'i9'.*Available"):
        load_hand(urdf(tmp_path, mimic='<mimic joint="i9"/>'))
    with pytest.raises(HandModelError, match="multiplier"):
        load_hand(urdf(tmp_path, mimic='<mimic joint="i2" multiplier="half"/>'))


def broken(text: str) -> Callable[[HandSpec], HandSpec]:
    def write(spec: HandSpec) -> HandSpec:
        spec.model.write_text(text)
        return spec

    return write


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda s: replace(s, model=s.model.with_name("no.xml")), "no hand model at .*no.xml"),
        (broken("<mujoco><worldbody><robot/></worldbody></mujoco>"), "MuJoCo can't read"),
        (
            broken("<mujoco><worldbody><body name='palm'><joint/></body></worldbody></mujoco>"),
            "body 't1'|MuJoCo can't compile|unknown body",
        ),
    ],
)
def test_files_that_are_no_hand(tmp_path, change, message):
    with pytest.raises((HandModelError, UnknownNameError), match=message):
        load_hand(change(pincer(tmp_path)))


def test_unknown_names(tmp_path):
    spec = pincer(tmp_path)
    with pytest.raises(UnknownNameError, match=r"unknown body 'plam'. Did you mean 'palm'\?"):
        load_hand(replace(spec, palm="plam"))
    with pytest.raises(UnknownNameError, match="unknown body 'i9'"):
        load_hand(replace(spec, wrist=Point("i9")))
    with pytest.raises(UnknownNameError, match="unknown joint 'i9'"):
        load_hand(replace(spec, neutral={"i9": 0.0}))
    with pytest.raises(UnknownNameError, match=r"unknown hand 'mimic'.*mimic_p050"):
        load_hand("mimic")
    for model in ("my/leap_hand.urdf", "../leap_hand.XML", "hand.mjcf"):
        with pytest.raises(
            HandModelError, match=f"{model} is a model that you have to add first: .* hands add"
        ):
            load_hand(model)


def test_a_wrist_that_moves_is_refused(tmp_path):
    hand = load_hand(replace(pincer(tmp_path), wrist=Point("i2")))
    with pytest.raises(HandModelError, match=r"'wrist'.* must be fixed to the palm"):
        _ = hand.wrist


@pytest.mark.parametrize(
    ("joints", "message"),
    [
        ({"i1": ""}, r"joint 'i1' has the limits \[-inf, inf\]"),
        ({"i1": 'range="1 -1"'}, "'i1'|range"),
        ({"i1": 'range="0.5 0.5"', "i2": ""}, "'i1'|range"),
        ({"i1": 'type="ball" range="0 1"'}, "'i1' is a ball or free joint"),
    ],
)
def test_joints_that_can_not_be_commanded(tmp_path, joints, message):
    with pytest.raises(HandModelError, match=message):
        load_hand(pincer(tmp_path, **joints))


def finger(name: str) -> FingerSpec:
    return FingerSpec(name, (Point("t1"), None, None, Point("t2")))


@pytest.mark.parametrize(
    ("names", "align", "message"),
    [
        (("thumb",), ("thumb", "wrist"), "has 1 fingers; expected two to five"),
        ((), (), "has 0 fingers"),
        (("thumb", "index", "middle", "ring", "pinky", "pinky"), ("thumb",), "has 6 fingers"),
        (("thumb", "index", "index"), ("thumb",), "names a finger twice"),
        (("index", "thumb"), ("thumb",), "first finger must be the thumb, not 'index'"),
        (("thumb", "index"), ("thumb", "index", "index"), "three different landmarks"),
    ],
)
def test_descriptions_are_checked(names, align, message):
    with pytest.raises(HandModelError, match=message):
        HandSpec(
            "h",
            "right",
            Path("h.xml"),
            "palm",
            Point("palm"),
            tuple(finger(name) for name in names),
            align,
        )


def test_fingers_are_checked():
    with pytest.raises(HandModelError, match="the name of a human finger"):
        finger("toe")
    with pytest.raises(HandModelError, match="needs a base point and a tip point"):
        FingerSpec("thumb", (None, None, None, Point("t2")))
    with pytest.raises(HandModelError, match="needs a base point and a tip point"):
        FingerSpec("thumb", (Point("t1"), None, None, None))


def test_mujoco_writes_no_file_into_the_working_folder(tmp_path, monkeypatch, caplog):
    monkeypatch.chdir(tmp_path)
    data = mujoco.MjData(model := load_hand("allegro_hand").model)
    data.qpos[0] = np.nan
    mujoco.mj_step(model, data)
    assert "unstable" in caplog.text  # told, by logging
    assert not list(tmp_path.iterdir())
