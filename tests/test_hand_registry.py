"""The hands of the registry: right, left, and as published."""

import math
import re
import runpy
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
from compact_hands import GRIPPERS
from real_hands import REAL
from trees import limited_poses, mujoco_points

from smooth_operator import HandFrame, Retargeter, Status
from smooth_operator.baselines.joint_angle import joint_map
from smooth_operator.errors import HandModelError, UnknownNameError
from smooth_operator.hand_files.vendor_model import on_model
from smooth_operator.hands.hand import load_hand_spec
from smooth_operator.hands.loading import load_model
from smooth_operator.hands.penetration import penetration_depths
from smooth_operator.hands.registry import MODELS, find_hand, hand_names, known_hands, load_hand
from smooth_operator.hands.spec import JointMap, select_fingers
from smooth_operator.landmarks import BASES, FINGERS, LANDMARKS
from smooth_operator.request import parse_fingers
from smooth_operator.retargeting.alignment import MIN_CONDITION, palm_alignment
from smooth_operator.retargeting.targets import KeyvectorLayout
from smooth_operator.synthetic.gestures import RELAXED
from smooth_operator.synthetic.hand_anatomy import couple, draw_anatomy, mirror, pose_hand

pytestmark = pytest.mark.usefixtures("own_hands")

NAMES = hand_names()
SHAPED = tuple(name for name in NAMES if name not in GRIPPERS)
"""Hands that are shaped as a human's."""
HANDS = [(name, side) for name in SHAPED for side in ("right", "left")]
MIRRORED = [name for name in SHAPED if known_hands()[name].mirrored]
ALIKE = {  # hands with a file for each side; how far their landmarks are from mirror images [mm]
    "aero_hand_open": 0.01,
    "brainco_revo2": 2.0,
    "dexhand021": 0.3,
    "inspire_ftp": 0.01,
    "linker_l20": 15.0,
    "linker_o6": 0.01,
    "orca_v1": 0.01,
    "sharpa_wave": 0.01,
    "tesollo_dg5f": 0.01,
    "unitree_dex3": 0.01,
    "unitree_dex5": 0.01,
}
LATER = tuple(name for name in NAMES if name in ALIKE or name == "linker_l10")
"""Hands whose published models are not beside the checkout, to be compared with."""


def human(side: str) -> np.ndarray:
    """(21, 3) an average operator's relaxed hand [m]."""
    poses = pose_hand(draw_anatomy(0.19, 0), couple(RELAXED)[None])
    return (poses if side == "right" else mirror(poses)).landmarks[0]


@pytest.mark.parametrize(("name", "side"), HANDS)
def test_every_hand(name, side):
    hand = load_hand(name, side)
    assert (hand.name, hand.spec.side) == (name, side)
    assert hand.spec.mirror == (name in MIRRORED and side == "left")
    assert hand.spec.source
    assert hand.fingers == FINGERS[: len(hand.fingers)]
    assert hand.actuated_names == tuple(hand.joint_names[i] for i in sorted(hand.actuated))

    low, high = hand.limits.T
    assert (high - low > 0.15).all()
    assert (np.abs(hand.limits) < math.pi).all()
    if name != "mimic_p050":  # the neutral pose of which is as released
        margin = np.minimum(hand.neutral - low, high - hand.neutral) / (high - low)
        assert margin.min() > 0.1, dict(zip(hand.actuated_names, margin.round(2), strict=True))
    every = hand.full_configuration(limited_poses(np.random.default_rng(0), hand.limits, 100))
    assert (every >= hand.joint_limits[:, 0] - 1e-9).all()
    assert (every <= hand.joint_limits[:, 1] + 1e-9).all()

    rows = joint_map(hand)
    assert tuple(row.joint for row in rows) == hand.actuated_names
    still = [row.joint for row in rows if not row.gains]
    assert not still, still
    assert penetration_depths(hand, hand.full_configuration(hand.neutral)[None]) == [0]
    assert np.isfinite(penetration_depths(hand, every[:20])).all()


@pytest.mark.parametrize("name", GRIPPERS)
def test_every_gripper(name):
    """A millimetre-wide gap at most when it is closed; open, it takes a cup."""
    hand = load_hand(name, "left")
    assert hand.spec.gripper
    assert not hand.spec.mirror
    assert hand.spec.source
    tips = hand.tips(hand.full_configuration(np.linspace(*hand.limits[0], 200)[:, None]))
    gaps = np.linalg.norm(tips[:, 0] - tips[:, 1], axis=-1)
    assert gaps.min() < 0.006
    assert gaps.max() > 0.075


@pytest.mark.parametrize(("name", "side"), HANDS)
def test_every_hand_is_shaped_as_a_hand(name, side):
    hand = load_hand(name, side)
    fit = palm_alignment(human(side)[None], hand)
    assert fit.condition[0] > 5 * MIN_CONDITION
    assert 0.6 < fit.scale[0] < 1.6
    tips = hand.tips(hand.full_configuration(hand.neutral))

    def apart(landmarks: np.ndarray) -> np.ndarray:
        aligned = palm_alignment(landmarks[None], hand).apply(landmarks[None])[0]
        return np.linalg.norm(tips - aligned[[LANDMARKS.index(n) for n in hand.tip_names]], axis=1)

    assert apart(human(side)).max() < 0.1
    # a hand of the other side bends its fingers the other way when it is laid on this palm
    assert apart(human(side)).mean() < apart(human("left" if side == "right" else "right")).mean()
    points = dict(zip(hand.tree.names, hand.landmark_positions(hand.neutral), strict=True))
    # knuckles are fixed to the palm, as a human's are: what is aligned does not move
    q = limited_poses(np.random.default_rng(4), hand.limits, 20)
    bases = [hand.tree.names.index(LANDMARKS[i]) for i in hand.align_indices]
    assert np.ptp(hand.landmark_positions(q)[:, bases], axis=0).max() < 1e-6
    bends = [
        np.linalg.norm(points[a] - points[b])
        for finger in hand.fingers
        for base in (BASES[FINGERS.index(finger)],)
        for a, b in zip(LANDMARKS[base : base + 3], LANDMARKS[base + 1 : base + 4], strict=True)
    ]
    assert min(bends) > 0.008
    assert max(bends) < 0.105


@pytest.mark.parametrize("name", NAMES)
def test_tips_are_at_the_end_of_their_fingers(name):
    """Within 3 mm of the surface of the last link."""
    hand = load_hand(name)
    data = mujoco.MjData(hand.model)
    mujoco.mj_kinematics(hand.model, data)
    for finger in hand.spec.fingers:
        body = hand.model.body(finger.tip.body).id
        tip = data.xpos[body] + data.xmat[body].reshape(3, 3) @ np.array(finger.tip.offset)
        distances = []
        for geom in np.flatnonzero(hand.model.geom_bodyid == body):
            local = data.geom_xmat[geom].reshape(3, 3).T @ (tip - data.geom_xpos[geom])
            radius, half = hand.model.geom_size[geom, :2]
            local[2] -= np.clip(local[2], -half, half)
            distances.append(np.linalg.norm(local) - radius)
        assert abs(min(distances, key=abs)) < 0.003, (finger.name, distances)


@pytest.mark.parametrize("name", ALIKE)
def test_separately_published_sides_are_nearly_mirror_images(name):
    """The two sides were written down from two files, so a slip in one of them shows."""
    right, left = load_hand(name, "right"), load_hand(name, "left")
    planes = {"unitree_dex5": (1, 1, -1), "inspire_ftp": (-1, 1, 1), "orca_v1": (-1, 1, 1)}
    mirror = np.array(planes.get(name, (1, -1, 1)))
    low, high = right.limits.T
    sense = np.ones(len(low))  # some joints turn the other way on the left
    rest = right.landmark_positions(right.neutral) * mirror
    for joint, step in enumerate(np.diag(0.1 * (high - low))):
        moved = right.landmark_positions(right.neutral + step) * mirror - rest
        ways = [
            left.landmark_positions(left.neutral + s * step) - left.landmark_positions(left.neutral)
            for s in (1, -1)
        ]
        apart = [np.abs(way - moved).max() for way in ways]
        sense[joint] = 1 if apart[0] < apart[1] else -1
    q = limited_poses(np.random.default_rng(5), right.limits, 100)
    ours = right.landmark_positions(q) * mirror
    theirs = left.landmark_positions(left.neutral + sense * (q - right.neutral))
    assert np.linalg.norm(ours - theirs, axis=-1).max() * 1e3 < ALIKE[name]
    turned = np.where(sense[:, None] > 0, left.limits, -left.limits[:, ::-1])
    np.testing.assert_allclose(right.limits, turned, atol=1e-4)
    np.testing.assert_array_equal(right.neutral, sense * left.neutral)


@pytest.mark.shared
@pytest.mark.parametrize(("name", "side"), REAL)
def test_landmarks_and_limits_are_the_published_ones(shared, name, side):
    real, hand = REAL[name, side], load_hand(name, side)
    model = load_model(shared / real.file).model
    joints = [model.joint(joint).id for joint in hand.joint_names]
    assert joints == sorted(joints)  # the model's own order
    others = {model.joint(j).name for j in range(model.njnt)} - set(hand.joint_names)
    assert others <= {"lh_WRJ1", "lh_WRJ2"}  # the arm's, as the right one is published without
    np.testing.assert_allclose(hand.joint_limits, model.jnt_range[joints], atol=1e-8)

    q = limited_poses(np.random.default_rng(2), hand.joint_limits, 1000)
    ours = dict(
        zip(hand.tree.names, np.moveaxis(np.asarray(hand.tree.positions(q)), 1, 0), strict=True)
    )
    points = {"wrist": real.wrist} if real.wrist else {}
    for finger, four in real.fingers.items():
        base = BASES[FINGERS.index(finger)]
        points |= {LANDMARKS[base + i]: p for i, p in enumerate(four) if p is not None}
    placed = [(model.body(name).id, np.array(offset)) for name, offset in points.values()]

    def published(poses: np.ndarray) -> np.ndarray:
        every = np.tile(model.qpos0, (len(poses), 1))
        every[:, joints] = poses
        return mujoco_points(model, model.body(real.palm).id, placed, every)

    theirs = published(q)
    neutral = published(hand.full_configuration(hand.neutral)[None])
    for finger in real.moving:
        base = list(points).index(LANDMARKS[BASES[FINGERS.index(finger)]])
        assert np.ptp(theirs[:, base], axis=0).max() > 0.001
        theirs[:, base] = neutral[0, base]
    for name_, column in zip(points, np.moveaxis(theirs, 1, 0), strict=True):
        miss = np.linalg.norm(ours[name_] - column, axis=-1).max()
        assert miss < 1e-6, (name_, miss)
    assert set(hand.tree.names) - set(points) <= {"wrist"} | {
        LANDMARKS[BASES[FINGERS.index(f)] + 2] for f, four in real.fingers.items() if not four[2]
    }


@pytest.mark.shared
@pytest.mark.parametrize(
    ("name", "side"), [("shadow_hand", "right"), ("inspire_hand", "left"), ("leap_hand", "right")]
)
def test_a_description_is_carried_over_to_the_vendors_model(shared, name, side):
    hand = load_hand(name, side)
    there = on_model(hand, shared / REAL[name, side].file)
    assert there.spec.palm == REAL[name, side].palm
    assert there.fingers == hand.fingers
    assert there.actuated_names == hand.actuated_names
    np.testing.assert_allclose(
        there.landmark_positions(hand.neutral), hand.landmark_positions(hand.neutral), atol=1e-6
    )


@pytest.mark.shared
def test_models_of_other_hands_are_refused(shared):
    right = load_hand("shadow_hand")
    with pytest.raises(HandModelError, match=r"lacks the joints rh_FFJ4.*that hand and side"):
        on_model(right, shared / REAL["shadow_hand", "left"].file)
    with pytest.raises(HandModelError, match="mirror image"):
        on_model(load_hand("wuji_hand", "left"), shared / REAL["wuji_hand", "right"].file)


def test_a_model_whose_landmarks_lie_elsewhere_is_refused(tmp_path):
    text = (MODELS / "ability_hand_right.xml").read_text()
    longer = tmp_path / "longer.xml"
    longer.write_text(text.replace('name="index_2" pos="0.0384', 'name="index_2" pos="0.0484'))
    assert longer.read_text() != text
    with pytest.raises(HandModelError, match=r"up to 1\d\.\d mm apart"):
        on_model(load_hand("ability_hand"), longer)


TENDON = """
<mujoco>
  <compiler angle="radian" autolimits="true"/>
  <worldbody><body name="palm"><geom size="0.02"/>
    <body name="a" pos="0 0 0.1"><joint name="a" range="0 1"/><geom size="0.01"/>
      <body name="b" pos="0 0 0.1"><joint name="b" range="0 1"/><geom size="0.01"/>
        <body name="c" pos="0 0 0.1"><joint name="c" range="0 1"/><geom size="0.01"/></body>
      </body>
    </body>
  </body></worldbody>
  <tendon><fixed name="t"><joint joint="c" coef="0.5"/><joint joint="b" coef="2"/></fixed></tendon>
  <actuator><position joint="a"/>{actuators}</actuator>
</mujoco>
"""


@pytest.mark.parametrize(
    ("actuators", "expected"),
    [
        ('<position tendon="t"/>', [("c", "b", 0.25)]),  # the first joint of the tendon leads
        ('<position tendon="t"/><position tendon="t"/>', [("c", "b", 0.25)]),
        ('<position tendon="t"/><position joint="b"/>', []),  # b is led by its own actuator
        ("", []),
    ],
)
def test_joints_on_one_tendon(tmp_path, actuators, expected):
    path = tmp_path / "tendon.xml"
    path.write_text(TENDON.format(actuators=actuators))
    couplings = load_model(path).couplings
    assert [(c.joint, c.follows, c.multiplier) for c in couplings] == expected
    assert all(c.offset == 0 for c in couplings)


def test_fewer_fingers():
    hand = load_hand("shadow_hand", fingers=("thumb", "index", "pinky"))
    assert hand.fingers == ("thumb", "index", "pinky")
    assert hand.spec.align == ("thumb", "index", "pinky")
    assert KeyvectorLayout(hand.fingers).vectors[3:] == ((4, 8), (4, 20), (8, 20))
    assert len(hand.joint_names) == 22  # the driver still gets them all
    two = load_hand("shadow_hand", fingers=("thumb", "middle"))
    assert two.spec.align == ("wrist", "thumb", "middle")
    assert load_hand("shadow_hand") is load_hand("shadow_hand")  # the whole one is kept


def test_another_finger_drives():
    spec = find_hand("allegro_hand").spec("right")
    row = JointMap("rfj1", 0.1, {"ring_mcp": 1.0})
    lost = JointMap("mfj1", 0.1, {"middle_mcp": 1.0})
    chosen = select_fingers(
        replace(spec, joint_map=(row, lost)), {"thumb": "thumb", "ring": "pinky", "index": "index"}
    )
    assert [finger.name for finger in chosen.fingers] == ["thumb", "index", "pinky"]
    assert chosen.fingers[2].points == spec.fingers[3].points
    assert chosen.align == ("thumb", "index", "pinky")
    assert chosen.joint_map == (JointMap("rfj1", 0.1, {"pinky_mcp": 1.0}),)
    hand, whole = load_hand_spec(chosen), load_hand("allegro_hand")
    at = hand.landmark_positions(hand.neutral)[hand.tree.names.index("pinky_tip")]
    there = whole.landmark_positions(whole.neutral)[whole.tree.names.index("ring_tip")]
    np.testing.assert_array_equal(at, there)


def test_choices_as_text():
    assert parse_fingers("thumb, index,pinky=ring") == {
        "thumb": "thumb",
        "index": "index",
        "pinky": "ring",
    }
    for text in ("", "thumb,,index", "thumb,index=", "=ring"):
        with pytest.raises(HandModelError, match="is not a list of fingers"):
            parse_fingers(text)
    with pytest.raises(HandModelError, match="'index' twice"):
        parse_fingers("thumb,index,index=ring")


@pytest.mark.parametrize(
    ("fingers", "error", "message"),
    [
        (("thumb", "toe"), UnknownNameError, "unknown finger 'toe'"),
        ({"thumb": "thumb", "index": "toe"}, UnknownNameError, "unknown human finger 'toe'"),
        (("index", "middle"), HandModelError, "the thumb must be among the fingers"),
        ({"thumb": "index", "index": "thumb"}, HandModelError, "driven by the human thumb"),
        (("thumb",), HandModelError, "has 1 fingers"),
        ({"thumb": "thumb", "index": "ring", "ring": "ring"}, HandModelError, "names a finger tw"),
    ],
)
def test_impossible_choices(fingers, error, message):
    with pytest.raises(error, match=message):
        load_hand("shadow_hand", fingers=fingers)


@pytest.mark.parametrize(
    ("name", "side"),
    [
        ("ability_hand", "left"),
        *(
            pytest.param(name, "left" if at % 2 else "right", marks=pytest.mark.weekly)
            for at, name in enumerate(LATER)
        ),
    ],
)
def test_a_frame_is_retargeted(name, side):
    """Two joints a finger, on the left; and the hands that the matrix leaves out."""
    hand = load_hand(name, side)
    result = Retargeter(hand, method="joint_angle")(HandFrame(human(side), side=side))
    assert result.status is Status.OK
    assert result.command.joint_names == hand.joint_names
    q = result.command.joint_positions[list(hand.actuated)]
    assert (q >= hand.limits[:, 0]).all()
    assert (q <= hand.limits[:, 1]).all()
    assert np.abs(q - hand.neutral).max() > 0.05
    every = hand.full_configuration(q)
    np.testing.assert_allclose(every, result.command.joint_positions, atol=1e-12)


def test_the_documented_table_is_the_catalogue():
    docs = Path(__file__).resolve().parents[1] / "docs"
    page = (docs / "reference" / "hands.md").read_text(encoding="utf-8")
    table = runpy.run_path(str(docs / "hands_table.py"))
    touches = dict(re.findall(r"^\| `(\w+)` .*\| ([^|]+) \| \w+ \|$", page, re.MULTILINE))
    assert tuple(touches) == NAMES  # the page has the numbers of fingers and joints of each
    assert "".join(table["row"](name, touches[name]) for name in NAMES) in page
    assert touches["inspire_hand"] == table["thumb_touches"]("inspire_hand")
    for name in NAMES:
        assert (docs / "img" / "hands" / f"{name}.png").stat().st_size < 60_000
