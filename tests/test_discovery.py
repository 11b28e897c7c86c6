"""A hand is found in any model: by how it is built and moves, not by what it is called."""

import json
import re
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
import tyro
from discovery_hands import (
    Part,
    because,
    check,
    claw,
    found_in,
    make_hand,
    mjcf,
    ring_of_fingers,
    sure,
    tip_errors,
    urdf,
    written,
)
from real_hands import REAL, At, at
from scipy.spatial.transform import Rotation

from smooth_operator import Point, load_hand
from smooth_operator.cli.hands_add import Add
from smooth_operator.errors import ConfigError, HandModelError, UnknownNameError
from smooth_operator.hand_discovery.discover import discover
from smooth_operator.hand_discovery.landmarks import UNSURE, Overrules
from smooth_operator.hand_discovery.skeleton import fingers_said, side_said, words
from smooth_operator.hands.hand import load_hand_spec
from smooth_operator.hands.spec_file import read_hand_spec
from smooth_operator.types import Side

pytestmark = pytest.mark.usefixtures("elsewhere")

FINGERS = ("thumb", "index", "middle", "ring", "pinky")
SHADOW = ("th", "ff", "mf", "rf", "lf")
Known = tuple[str, Side, list[At]]
"""Name in the catalogue, side, and the fingertips, thumb first."""
LINKS: tuple[tuple[Side, tuple[int, ...]], ...] = (
    ("right", (15, 3, 7, 11)),
    ("left", (15, 11, 7, 3)),
)
"""Last links of the fingers in Allegro's URDF files."""


def published() -> dict[str, Known]:
    """Files of real hands, with the option where a file has two hands."""
    models: dict[str, Known] = {
        real.file: (name, side, [points[3] for points in real.fingers.values()])
        for (name, side), real in REAL.items()
    }
    mimic = [at(f"{finger}_fingertip") for finger in FINGERS]
    models["hands/mimic_p050_hand/right_hand.xml"] = ("mimic_p050", "right", mimic)
    for side, links in LINKS:
        tips = {
            f"allegro_hand/allegro_hand_{side}.urdf": [f"link_{k}.0_tip" for k in links],
            f"leap_hand/leap_hand_{side}.urdf": [f"{finger}_tip_head" for finger in FINGERS[:4]],
            f"shadow_hand/shadow_hand_{side}.urdf": [f"{f}tip" for f in SHADOW],
            f"shadow_hand/bimanual.urdf --side {side}": [f"{side[0]}h_{f}tip" for f in SHADOW],
        }
        for file, bodies in tips.items():
            name = file.partition("/")[0]
            models[f"hands_urdf/{file}"] = (name, side, [at(body) for body in bodies])
    return models


PUBLISHED = published()


@pytest.mark.shared
@pytest.mark.parametrize(
    ("model", "names"),
    [
        pytest.param(
            model,
            names,
            id=f"{model}-{'with' if names else 'without'} names",
            # left models without names: what names don't say is geometry, which is a mirror image's
            marks=[] if names or "left" not in model else pytest.mark.weekly,
        )
        for model in PUBLISHED
        for names in (True, False)
    ],
)
def test_a_real_hand_is_read_right(shared, model, names, monkeypatch):
    """Nothing hangs on a name: without any, thumb, order, side and tips are the same."""
    from smooth_operator.hand_discovery import branches, landmarks

    if not names:
        module = sys.modules["smooth_operator.hand_discovery.discover"]
        monkeypatch.setattr(module, "fingers_said", lambda chains: [None] * len(chains))
        monkeypatch.setattr(module, "side_said", lambda names: None)
        monkeypatch.setattr(branches, "says_tip", lambda name: False)
        monkeypatch.setattr(landmarks, "says_wrist", lambda name: False)
    hand, side, tips = PUBLISHED[model]
    name, _, option = model.partition(" --side ")
    found = discover(shared / name, side=side if option else None)
    assert found.spec.side == side
    errors = tip_errors(found, tips)
    assert errors.max() < 0.003, errors
    if not names:
        return
    assert [f.name for f in found.fingers] == list(FINGERS[: len(tips)])
    couplings = () if "hands_urdf/shadow" in model else load_hand(hand, side).couplings
    seen = {found.coupling.joint: found.coupling for found in found.coupled}
    assert set(seen) == {coupling.joint for coupling in couplings}
    for coupling in couplings:
        assert seen[coupling.joint].follows == coupling.follows
        numbers = seen[coupling.joint].coefficients
        assert numbers == pytest.approx(coupling.coefficients, abs=1e-8)
    assert sure(found, "thumb") > 0.9
    if "dexee" not in model:  # which has no side of its own
        assert sure(found, "side") > 0.9


@pytest.mark.shared
def test_a_hand_without_a_side_of_its_own_says_so(shared):
    path = shared / "hands/shadow_dexee_hand/shadow_dexee.xml"
    found = discover(path)
    assert sure(found, "side") < 0.5
    assert "a right or a left hand" in because(found, "side")
    left = discover(path, side="left")
    assert [f.joints[-1] for f in left.fingers] == ["F0/J3", "F1/J3", "F2/J3"]
    assert sure(left, "side") > 0.9


@pytest.mark.parametrize("fingers", [2, 3, 4, 5])
@pytest.mark.parametrize("side", ["right", "left"])
@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.weekly)])
def test_an_unseen_hand_in_any_frame_by_any_name(tmp_path, seed, side, fingers):
    hand = make_hand(10 * fingers + seed, fingers=fingers, side=side, joints=2 + seed)
    found = found_in(tmp_path, urdf(hand.parts))
    check(found, hand)
    assert tip_errors(found, list(hand.truth.tips)).max() < 1e-3
    if fingers > 2:
        assert sure(found, "thumb") > 0.8
    else:
        assert sure(found, "thumb") < 0.8  # which of two it is, is a matter of taste
    loaded = load_hand_spec(found.spec)
    assert (loaded.neutral >= loaded.limits[:, 0]).all()
    assert (loaded.neutral <= loaded.limits[:, 1]).all()
    bent = loaded.landmark_positions(loaded.neutral)
    straight = loaded.landmark_positions(np.clip(0, *loaded.limits.T))
    assert np.abs(bent - straight).max() > 5e-3


@pytest.mark.parametrize("seed", range(4))
def test_neither_arm_nor_format_nor_missing_shapes_matter(tmp_path, seed):
    hand = make_hand(
        seed, side="left" if seed % 2 else "right", arm=6, shapes=seed < 2, coupled=True
    )
    found = found_in(tmp_path, mjcf(hand.parts), "model.xml")
    check(found, hand)
    assert len(found.coupled) == 5
    wanted = {p.joint: p.mimic for p in hand.parts if p.mimic}
    for c in (f.coupling for f in found.coupled):
        leader, gain, offset = wanted[c.joint]
        assert (c.follows, c.multiplier, c.offset) == (
            leader,
            pytest.approx(gain),
            pytest.approx(offset),
        )
    assert "lead to the palm" in because(found, "palm")
    arm = {p.joint for p in hand.parts if p.joint.startswith("aj")}
    assert not arm & {j for f in found.fingers for j in f.joints}
    if seed >= 2:  # nothing marks the tips: guessed, and said to be
        assert all(sure(found, f"tip of {name}") < 0.5 for name in FINGERS)
        assert found.unsure[0].subject.startswith("tip of")


def test_tip_links_and_sites_are_taken_to_the_micrometre(tmp_path):
    linked = make_hand(5, shapes=False)
    links = [Part(f"{body}_tip", body, tip) for body, tip in linked.truth.tips]
    found = found_in(tmp_path, urdf((*linked.parts, *links)))
    check(found, linked)
    assert tip_errors(found, list(linked.truth.tips)).max() < 1e-6
    assert all(f.tip_body.endswith("_tip") for f in found.fingers)
    bare = make_hand(5)
    found = found_in(tmp_path, mjcf(bare.parts, tips=bare.truth.tips), "m.xml")
    assert tip_errors(found, list(bare.truth.tips)).max() < 1e-6


def test_a_frame_half_way_or_at_the_joint_is_no_tip(tmp_path):
    hand = make_hand(6)
    last, tip = hand.truth.tips[1]
    parts = (*hand.parts, Part("imu", last, tip * 0.4), Part("origin_tip", last, tip * 0.0))
    found = found_in(tmp_path, urdf(parts))
    assert tip_errors(found, list(hand.truth.tips)).max() < 1e-3
    assert found.fingers[1].tip_body == last


@pytest.mark.parametrize(("arm", "fingers"), [(0, 3), (5, 2)])
def test_of_two_hands_the_side_chooses(tmp_path, arm, fingers):
    hands = {
        side: make_hand(k, side=side, arm=arm, fingers=fingers, prefix=side[0])
        for k, side in enumerate(("right", "left"))
    }
    apart = [
        replace(p, position=p.position + np.array([0.5, 0, 0])) if p.parent is None else p
        for p in hands["left"].parts
    ]
    path = written(tmp_path, urdf((*hands["right"].parts, *apart)))
    with pytest.raises(HandModelError, match=r"contains 2 hands .*--side"):
        discover(path)
    for side, hand in hands.items():
        check(discover(path, side="left" if side == "left" else "right"), hand)


def test_three_like_fingers_are_a_guess_and_a_gripper_has_no_side(tmp_path):
    found = found_in(tmp_path, urdf(ring_of_fingers(0.05, 0.06, 0.5)))
    assert sure(found, "side") <= 0.3
    assert sure(found, "thumb") < 0.8
    assert {f.subject for f in found.guesses} >= {"side"}
    found = found_in(tmp_path, urdf(claw()))  # either of its jaws may be the thumb
    assert found.spec.gripper
    assert not found.guesses
    assert [f.name for f in found.fingers] == ["thumb", "index"]  # rf is no ring finger here
    load_hand_spec(found.spec)


def test_fingers_round_a_middle_may_be_a_gripper_without_a_side(tmp_path):
    """Their first joints turn to one side only, so that reach alone would tell a side."""
    parts = [Part("base", None, np.zeros(3))]
    x, y, z = np.eye(3)
    for k in range(3):
        turn = Rotation.from_euler("z", 120 * k, degrees=True).as_matrix()
        parent, place = "base", turn @ (0.05, 0.0, 0.02)
        for axis, limits in ((x, (-0.9, 0.0)), (y, (-1.6, 1.6)), (y, (-1.6, 1.6))):
            name = f"link{len(parts)}"
            joint = f"{name}_j"
            parts.append(
                Part(name, parent, place, turn, axis, joint, limits, end=0.04 * z, radius=0.006)
            )
            parent, place, turn = name, 0.045 * z, np.eye(3)
    found = found_in(tmp_path, urdf(tuple(parts)))
    assert sure(found, "side") <= 0.3
    assert "may be a gripper without a side" in because(found, "side")


def test_overruled_findings_are_as_given(tmp_path):
    hand = make_hand(8, fingers=4)
    path = written(tmp_path, urdf(hand.parts))
    last = [body for body, _ in hand.truth.tips]
    tip = Point(last[1], (0.0, 0.001, 0.03))
    found = discover(
        path,
        side="left",
        name="mine",
        overrules=Overrules(
            thumb=last[3],
            fingers=(("pinky", last[2]),),
            tips=(("middle", Point(last[1], (0.0, 0.0, 0.01))),),
            wrist=Point("palm", (0.0, 0.0, -0.01)),
        ),
    )
    by_name = {f.name: f for f in found.fingers}
    assert {"thumb", "middle", "pinky"} < set(by_name)
    assert by_name["thumb"].tip_body == last[3]
    assert by_name["pinky"].tip_body == last[2]
    assert found.spec.side == "left"
    assert found.spec.name == "mine"
    assert sure(found, "thumb") == 1.0
    assert found.spec.wrist.offset == (0.0, 0.0, -0.01)
    given = discover(path, overrules=Overrules(palm="palm", tips=(("index", tip),)))
    assert given.spec.fingers[1].tip == tip
    assert sure(given, "tip of index") == 1.0


LAST = [body for body, _ in make_hand(8).truth.tips]


@pytest.mark.parametrize(
    ("given", "error", "message"),
    [
        ({"palm": "nowhere"}, UnknownNameError, "nowhere"),
        ({"thumb": "nothing"}, UnknownNameError, "nothing"),
        ({"thumb": LAST[0], "fingers": (("ring", LAST[0]),)}, HandModelError, "same finger"),
        ({"palm": LAST[0]}, HandModelError, r"branch from the palm .*--finger"),
        ({"fingers": (("toe", "a"),)}, HandModelError, "'toe'"),
    ],
)
def test_what_is_given_is_checked(tmp_path, given, error, message):
    with pytest.raises(error, match=message):
        found_in(tmp_path, urdf(make_hand(8).parts), overrules=Overrules(**given))
    with pytest.raises(ConfigError, match="side"):
        found_in(tmp_path, urdf(make_hand(8).parts), side="up")


def test_a_tip_is_at_the_end_of_its_mesh(tmp_path):
    hand = make_hand(9, shapes=False, turned=False)
    text = urdf(hand.parts, mesh="box.stl")
    assert sure(found_in(tmp_path, text), "tip of index") < 0.5
    box = trimesh.creation.box(extents=(0.008, 0.008, 0.02))
    box.apply_translation((0.0, 0.0, 0.01))
    box.export(tmp_path / "box.stl")
    found = found_in(tmp_path, text)
    np.testing.assert_allclose(found.fingers[1].tip_offset, (0.0, 0.0, 0.02), atol=1e-4)
    assert sure(found, "tip of index") > 0.5


# Words: weak evidence.


def test_words_are_told_apart():
    assert words("rightIndexTip_2") == ("right", "index", "tip")
    assert fingers_said([["ffproximal"], ["thbase"], ["rf_medial"], ["lfj3"]]) == [
        "index",
        "thumb",
        "ring",
        "pinky",
    ]
    # said of all, a word tells none from another; initials of two may be left and right
    assert fingers_said([["a_middle"], ["b_middle"]]) == [None, None]
    assert fingers_said([["rf"], ["lf"]]) == [None, None]
    assert side_said(["rh_palm", "rh_ff"]) == "right"
    assert side_said(["thumb_L1", "index_L2"]) is None
    assert side_said(["l_thumb"]) == "left"


def test_names_that_lie_lower_the_confidence_and_change_nothing(tmp_path):
    hand = make_hand(2, fingers=4, side="left")
    honest = found_in(tmp_path, urdf(hand.parts))
    first = {f.joints[0] for f in honest.fingers[1:2]}
    text = urdf(hand.parts)
    for joint in first:
        text = text.replace(f'"{joint}"', '"right_thumb_joint"')
    found = found_in(tmp_path, text)
    assert [f.tip_body for f in found.fingers] == [f.tip_body for f in honest.fingers]
    assert found.spec.side == "left"
    assert sure(found, "side") < sure(honest, "side")
    assert "although names" in because(found, "side")


def add(*arguments: str | Path) -> None:
    tyro.cli(Add, args=[str(a) for a in arguments], config=(tyro.conf.FlagCreatePairsOff,)).run()


def test_the_command_writes_a_spec_and_prints_a_checklist(tmp_path, own_hands, capsys):
    hand = make_hand(1, side="left")
    path = written(tmp_path, urdf(hand.parts), "gadget_left.urdf")
    add(path, "--all")
    text = capsys.readouterr().out
    assert text.splitlines()[-1] == "Next: smooth-operator hands check gadget --side left"
    for word in ("side", "palm", "thumb", "order", "tip of pinky", "wrist", "0.98", "--tip"):
        assert word in text
    file = own_hands / "gadget.left.toml"
    spec = read_hand_spec(file)
    assert replace(spec, model=path) == discover(path).spec
    assert spec.model == own_hands / "models" / "gadget.left" / path.name
    assert spec.model.read_bytes() == path.read_bytes()
    assert "0.98  side: left" in file.read_text(encoding="utf-8")
    load_hand_spec(spec)


def test_json_is_one_object_and_opens_no_page(tmp_path, own_hands, capsys):
    hand = make_hand(1, fingers=3, coupled=True)
    add(written(tmp_path, urdf(hand.parts)), "--json", "--name", "three")
    told = json.loads(capsys.readouterr().out)
    assert told["side"] == "right"
    assert told["palm"] == "palm"
    assert [f["name"] for f in told["fingers"]] == ["thumb", "index", "middle"]
    finger, coupled = told["fingers"][0], told["coupled"][0]
    assert set(finger) == {"name", "tip_body", "tip_offset", "joints", "confidence"}
    assert len(finger["tip_offset"]) == len(told["coupled"]) == 3
    assert set(coupled) == {"joint", "follows", "multiplier", "offset", "higher", "confidence"}
    assert {"side", "palm", "thumb", "order"} <= set(told["confidence"])
    assert told["file"] == str(own_hands / "three.right.toml")


def test_couple_makes_a_joint_follow_another(tmp_path, own_hands, capsys):
    hand = make_hand(1, fingers=3)
    path = written(tmp_path, urdf(hand.parts))
    add(path, "--json", "--name", "free")
    *_, leader, last = json.loads(capsys.readouterr().out)["fingers"][1]["joints"]
    add(path, "--json", "--name", "led", "--couple", f"{last}={leader}*0.5-0.1")
    (row,) = json.loads(capsys.readouterr().out)["coupled"]
    assert (row["joint"], row["follows"], row["multiplier"]) == (last, leader, 0.5)
    free, led = load_hand("free"), load_hand("led")
    assert set(free.actuated_names) - set(led.actuated_names) == {last}
    full = dict(zip(led.joint_names, led.full_configuration(led.neutral), strict=True))
    assert full[last] == pytest.approx(0.5 * full[leader] - 0.1)
    with pytest.raises(HandModelError, match=r"no joint 'nothing'; .* --couple"):
        add(path, "--couple", f"{last}=nothing*0.5")
    with pytest.raises(HandModelError, match="follows itself"):
        add(path, "--couple", f"{last}={last}")


def test_joints_that_nothing_moves_are_reported(tmp_path):
    hand = make_hand(1, fingers=3)
    last = discover(written(tmp_path, urdf(hand.parts))).fingers[1].joints[-1]
    joints = re.findall(r'<joint name="([^"]+)"', text := mjcf(hand.parts))
    motors = "".join(f'<position joint="{name}"/>' for name in joints if name != last)
    text = text.replace("</mujoco>", f"<actuator>{motors}</actuator></mujoco>")
    found = found_in(tmp_path, text, "model.xml")
    assert sure(found, "coupled") < UNSURE
    assert f"joints without a motor or a leader do not move (1): {last}" in (
        because(found, "coupled")
    )


def test_a_hand_of_that_name_is_not_replaced_unasked(tmp_path, own_hands, capsys):
    path = written(tmp_path, urdf(make_hand(1).parts), "gadget.urdf")
    add(path, "--json")
    add(path, "--json")  # the same again
    assert [f.name for f in own_hands.glob("*.toml")] == ["gadget.right.toml"]
    written(tmp_path, urdf(make_hand(2).parts), "gadget.urdf")
    add(path, "--json")
    assert (own_hands / "gadget_2.right.toml").is_file()
    with pytest.raises(ConfigError, match="--overwrite"):
        add(path, "--json", "--name", "gadget")
    add(path, "--json", "--name", "gadget", "--overwrite")
    assert read_hand_spec(own_hands / "gadget.right.toml").neutral == discover(path).spec.neutral
    built_in = written(tmp_path, urdf(make_hand(1).parts), "shadow_hand.urdf")
    add(built_in, "--json")
    assert (own_hands / "my_shadow_hand.right.toml").is_file()
    capsys.readouterr()


def test_options_that_make_no_sense_are_said_to(tmp_path, own_hands):
    hand = make_hand(1)
    path = written(tmp_path, urdf(hand.parts))
    last = hand.truth.tips[1][0]
    for option, message in (
        (("--tip", "index"), "FINGER=BODY:x,y,z"),
        (("--tip", f"index={last}:1,2"), "three numbers"),
        (("--tip", f"index={last}:0,0,20"), "metres"),
        (("--finger", "index"), "FINGER=BODY"),
    ):
        with pytest.raises(ConfigError, match=message):
            add(path, "--json", *option)
    with pytest.raises(HandModelError, match="can't be named"):
        add(path, "--json", "--name", "a/b")
    assert not own_hands.exists()


def test_the_page_is_opened_on_request(tmp_path, own_hands, monkeypatch, capsys):
    from smooth_operator.cli import hands_show

    shown: list[Any] = []
    monkeypatch.setattr(hands_show, "show_hand", shown.append)
    path = written(tmp_path, urdf(make_hand(1).parts), "gadget.urdf")
    add(path, "--view", "--port", "0", "--no-browser")
    add(path)
    assert [(s.hand, s.port, s.no_browser) for s in shown] == [
        (str(own_hands / "gadget.right.toml"), 0, True)
    ]
    capsys.readouterr()
