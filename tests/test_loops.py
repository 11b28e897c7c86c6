"""Hands whose fingers are closed loops of bars, against MuJoCo's own solution of the loops."""

import json
from pathlib import Path

import mujoco
import numpy as np
import pytest
from linkage_hands import crank_hand, four_bar_hand, polynomial_hand, rod_hand

import smooth_operator as so
from smooth_operator.errors import HandModelError
from smooth_operator.hand_discovery.loops import OpenModel, opened
from smooth_operator.hand_files.spec_writer import write_hand_spec
from smooth_operator.hands.hand import Hand
from smooth_operator.hands.spec_file import read_hand_spec
from smooth_operator.landmarks import FINGERS
from smooth_operator_devices.hands.actuator_map import BoundMap, find_table, read_table

pytestmark = pytest.mark.usefixtures("elsewhere", "own_hands")


class ClosedLoops:
    """The model of a file with its loops, solved by MuJoCo's dynamics-free projection.

    Independent of the library: the motors are held, all other joints move down the sum of squares
    of the equality rows, in small steps of the motors.
    """

    def __init__(self, path: Path) -> None:
        self.model = mujoco.MjModel.from_xml_path(str(path))
        off = mujoco.mjtDisableBit
        self.model.opt.disableflags |= int(off.mjDSBL_CONTACT | off.mjDSBL_LIMIT)
        self.model.opt.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
        self.data = mujoco.MjData(self.model)
        self.motors = [int(j) for j in self.model.actuator_trnid[:, 0]]
        held = self.model.jnt_dofadr[self.motors]
        self.free = np.setdiff1d(np.arange(self.model.nv), held)

    def moved_to(self, angles: np.ndarray, steps: int = 12) -> None:
        """Motors at (a,) angles [rad], on a straight way from the reference."""
        model, data = self.model, self.data
        mujoco.mj_resetData(model, data)
        at = model.jnt_qposadr[self.motors]
        begin = data.qpos[at].copy()
        for share in np.linspace(0, 1, steps + 1)[1:]:
            data.qpos[at] = begin + share * (angles - begin)
            for _ in range(40):
                mujoco.mj_fwdPosition(model, data)
                equal = data.efc_type == mujoco.mjtConstraint.mjCNSTR_EQUALITY
                rows = data.efc_J.reshape(-1, model.nv)[equal][:, self.free]
                step = np.zeros(model.nv)
                step[self.free] = -np.linalg.pinv(rows, rcond=1e-7) @ data.efc_pos[equal]
                mujoco.mj_integratePos(model, data.qpos, step, 1.0)
                if abs(step).max() < 1e-10:
                    break
        mujoco.mj_forward(model, data)
        assert (
            abs(data.efc_pos[data.efc_type == mujoco.mjtConstraint.mjCNSTR_EQUALITY]).max() < 1e-5
        )

    def in_palm(self, palm: str, body: str, offset: tuple[float, ...]) -> np.ndarray:
        """A point of a body in the frame of the palm [m]."""
        at, frame = self.data.body(palm), self.data.body(body)
        point = frame.xpos + frame.xmat.reshape(3, 3) @ offset
        return (point - at.xpos) @ at.xmat.reshape(3, 3)


def worst_tip_error(path: Path, hand: Hand, poses: int, share: float = 1.0) -> float:
    """Largest distance of fingertips from those of the closed loops, at random motor angles [m].

    The leaders are set to what the links' frames of the solved loops show.
    """
    loops, rng, worst = ClosedLoops(path), np.random.default_rng(4), 0.0
    low, high = loops.model.jnt_range[loops.motors].T
    middle, half = (low + high) / 2, share * (high - low) / 2
    for _ in range(poses):
        loops.moved_to(rng.uniform(middle - half, middle + half))
        q = leaders_of(loops, hand)
        tips = hand.tips(hand.full_configuration(q))
        for finger, tip in zip(hand.spec.fingers, tips, strict=True):
            true = loops.in_palm(hand.spec.palm, finger.tip.body, finger.tip.offset)
            worst = max(worst, float(np.linalg.norm(tip - true)))
    return worst


def leaders_of(loops: ClosedLoops, hand: Hand) -> np.ndarray:
    """Positions of the actuated joints at which the links are turned as in the solved loops."""
    data, q = mujoco.MjData(hand.model), hand.neutral.copy()
    for k, name in enumerate(hand.actuated_names):
        joint = hand.model.joint(name)
        ends = [int(hand.model.body_parentid[joint.bodyid[0]]), int(joint.bodyid[0])]
        frames = [loops.data.body(hand.model.body(b).name).xmat.reshape(3, 3) for b in ends]
        data.qpos[:] = hand.qpos(hand.full_configuration(q))
        mujoco.mj_kinematics(hand.model, data)
        ours = [data.xmat[b].reshape(3, 3) for b in ends]
        off = (ours[0].T @ ours[1]).T @ (frames[0].T @ frames[1])
        sine = np.array([off[2, 1] - off[1, 2], off[0, 2] - off[2, 0], off[1, 0] - off[0, 1]])
        q[k] += np.arctan2(sine @ joint.axis, np.trace(off) - 1)
        # no other turn than about the joint's axis
        assert np.linalg.norm(sine) / 2 == pytest.approx(abs(sine @ joint.axis) / 2, abs=1e-5)
    return q


def added(run, path: Path) -> dict:
    """What ``hands add --json`` prints."""
    status, out, err = run("hands", "add", str(path), "--json")
    assert status == 0, err
    return json.loads(out)


HANDS = {
    "crank": crank_hand,
    "crank_leads": lambda: crank_hand("motor").replace('range="-0.2 1.5"', 'range="-0.2 0.5"'),
    "four_bar": four_bar_hand,
    "rod": rod_hand,
}


@pytest.mark.parametrize("name", HANDS)
def test_fingertips_are_where_the_closed_loops_have_them(run, tmp_path, name):
    path = tmp_path / f"{name}.xml"
    path.write_text(HANDS[name]())
    told = added(run, path)
    assert told["side"] == "right"
    assert [finger["name"] for finger in told["fingers"]] == list(FINGERS)
    hand = so.load_hand(name, "right")
    assert all(len(finger["joints"]) == 2 for finger in told["fingers"])
    assert worst_tip_error(path, hand, 12) < 0.5e-3


def test_bars_become_polynomials_in_the_spec_file(run, tmp_path):
    path = tmp_path / "four_bar.xml"
    path.write_text(four_bar_hand())
    told = added(run, path)
    assert told["model"] == str(path)
    assert "copy of the model has no closed loops: 4 links of the drive" in told["notes"][0]
    assert told["confidence"]["coupled"] == 0.9
    path.unlink()  # the copy is complete
    spec = read_hand_spec(told["file"])
    assert {(c.joint, c.follows) for c in spec.couplings} == {
        (f"{finger}_pip", f"{finger}_mcp") for finger in FINGERS[1:]
    }
    assert all(len(c.coefficients) == 5 for c in spec.couplings)
    write_hand_spec(spec, tmp_path / "again.toml")
    assert read_hand_spec(tmp_path / "again.toml") == spec
    hand = so.load_hand(told["name"], "right")
    leaders = (f"{finger}_mcp" for finger in FINGERS[1:])
    assert hand.actuated_names == (*leaders, "thumb_cmc", "thumb_mcp")
    np.testing.assert_allclose(hand.limits[0], [-0.2, 1.2], atol=1e-9)
    recording = so.SyntheticOperator(seed=5, rate_hz=50).record(duration=0.6)
    commands, _ = so.Retargeter(hand, method="smooth").run(recording)
    values = so.evaluate(so.assemble_trace(recording, commands, hand, reach_samples=0))
    assert values["cosine_similarity"] > 0.5


def test_the_motors_ranges_limit_the_leaders(run, tmp_path):
    """The MCP joints of the file have no range; the crank's is -0.2 to 1.5 rad."""
    path = tmp_path / "crank.xml"
    path.write_text(crank_hand())
    added(run, path)
    hand = so.load_hand("crank", "right")
    loops, reached = ClosedLoops(path), []
    for angle in np.linspace(*loops.model.jnt_range[loops.motors[0]], 15):
        loops.moved_to(np.array([angle, 0, 0, 0, 0, 0]))
        reached.append(float(loops.data.joint("index_mcp").qpos[0]))
    at = hand.actuated_names.index("index_mcp")
    np.testing.assert_allclose(hand.limits[at], [min(reached), max(reached)], atol=5e-3)
    assert "index_motor" not in hand.joint_names


def test_joints_that_follow_a_joint_of_a_loop_still_do(run, tmp_path):
    """A DIP joint outside the loop follows the PIP joint, which gets a polynomial."""
    path = tmp_path / "more.xml"
    text = four_bar_hand()
    tied = ""
    for finger in FINGERS[1:]:
        text = text.replace(
            f'<site name="{finger}_tip" pos="0 0 0.035"/>',
            f'<body name="{finger}_end" pos="0 0 0.03"><joint name="{finger}_dip" axis="1 0 0"/>'
            '<geom type="capsule" fromto="0 0 0 0 0 0.02" size="0.005" mass="0.01"/>'
            f'<site name="{finger}_tip" pos="0 0 0.025"/></body>',
        )
        tied += f'<joint joint1="{finger}_dip" joint2="{finger}_pip" polycoef="0 0.5 0 0 0"/>'
    path.write_text(text.replace("<equality>", f"<equality>{tied}"))
    added(run, path)
    hand = so.load_hand("more", "right")
    every = dict(zip(hand.joint_names, hand.full_configuration(hand.limits[:, 1]), strict=True))
    assert every["ring_dip"] == pytest.approx(0.5 * every["ring_pip"]) != 0
    assert worst_tip_error(path, hand, 4) < 0.5e-3


def test_a_loop_that_no_polynomial_fits_is_refused_with_its_error(run, tmp_path, own_hands):
    path = tmp_path / "steep.xml"
    path.write_text(four_bar_hand(0.004, -0.002, most=1.5))
    status, _, err = run("hands", "add", str(path))
    assert status == 2
    assert "joint 'index_pip' of a closed loop is not a polynomial of one other joint" in err
    assert "is up to 0.8 degrees off, more than 0.5" in err
    assert not own_hands.exists()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            ('axis="1 0 0" range="-0.2 1.5"', 'axis="1 0 0"'),
            "'index_motor' drives a closed loop but",
        ),
        (
            (
                '<joint name="index_mcp"',
                '<joint name="index_spread" axis="0 1 0"/><joint name="index_mcp"',
            ),
            "'index_proximal' of a closed loop has 2 joints",
        ),
        (('pos="0 0.024 0.031"', 'pos="0 0.024 0.231"'), "can't be solved: it closes in only 0 of"),
    ],
)
def test_loops_that_can_not_be_solved_are_refused(tmp_path, change, message):
    path = tmp_path / "crank.xml"
    path.write_text(crank_hand().replace(*change))
    with pytest.raises(HandModelError, match=message), opened(path):
        pass


def test_a_model_without_loops_is_itself(tmp_path):
    plain = tmp_path / "plain.xml"
    plain.write_text(polynomial_hand())
    with opened(plain) as model:
        assert model == OpenModel(plain)
    # the base of a hand on a mocap body, as in many scenes, is no loop of bars
    held = tmp_path / "held.xml"
    held.write_text(
        polynomial_hand()
        .replace(
            '<body name="palm">', '<body name="hold" mocap="true"/><body name="palm"><freejoint/>'
        )
        .replace("<equality>", '<equality><weld body1="hold" body2="palm"/>')
    )
    with opened(held) as model:
        assert model == OpenModel(held)


AMAZING = "hands_new/amazing_hand/mjcf/robot.xml"


@pytest.mark.shared
def test_the_amazing_hand_is_a_right_hand_of_four_fingers(run, shared):
    """Two ball-jointed rods move each finger: 8 motors, 12 ball joints, 20 connections."""
    told = added(run, shared / AMAZING)
    assert (told["name"], told["side"]) == ("my_amazing_hand", "right")
    assert [finger["name"] for finger in told["fingers"]] == ["thumb", "index", "middle", "ring"]
    assert min(finger["confidence"] for finger in told["fingers"]) > 0.8
    hand = so.load_hand("my_amazing_hand", "right")
    assert (len(hand.joint_names), len(hand.actuated)) == (12, 8)
    spans = np.degrees(np.ptp(hand.limits, axis=1))  # sideways and bending of each finger
    np.testing.assert_allclose(spans, [74.4, 108] * 4, atol=1.0)
    with opened(shared / AMAZING) as model:
        errors = np.degrees([c.error for c in model.couplings])
    assert len(errors) == 4
    assert errors.max() < 0.3  # degree 4 of the last joint's angle over its leader's
    assert worst_tip_error(shared / AMAZING, hand, 6) < 0.15e-3
    check_motors(ClosedLoops(shared / AMAZING), hand)


def check_motors(loops: ClosedLoops, hand: Hand) -> None:
    """The table of the real hand gives the motors of the leaders, and the leaders of the motors."""
    bound = BoundMap(read_table(find_table("amazing_hand", "feetech", "right")), hand)
    per_radian, rng = 1024 / np.radians(300), np.random.default_rng(0)
    for _ in range(2):
        bend, side = np.radians([rng.uniform(-40, 70, 4), rng.uniform(-20, 20, 4)])
        motors = np.stack([side + bend, side - bend], axis=1).ravel()
        loops.moved_to(motors)
        q = hand.full_configuration(leaders_of(loops, hand))
        commands = 511 + motors * per_radian
        np.testing.assert_allclose(bound.commands(bound.angles(q)), commands, atol=5.0)  # 1.5°
        np.testing.assert_allclose(bound.joints(commands), q, atol=np.radians(0.8))
