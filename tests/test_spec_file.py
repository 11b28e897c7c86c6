"""Spec files: round trips, mistakes, the user's own hands, and the commands that list and show."""

import json
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import tyro
from PIL import Image
from trees import pincer

from smooth_operator.cli.hands import Hands
from smooth_operator.errors import ConfigError, HandModelError, OutputError, UnknownNameError
from smooth_operator.hand_files.spec_writer import write_hand_spec
from smooth_operator.hand_files.user_hands import save_hand
from smooth_operator.hands.registry import (
    MODELS,
    find_hand,
    hand_names,
    known_hands,
    load_hand,
    user_hands_folder,
)
from smooth_operator.hands.spec import Coupling, HandSpec, JointMap, Point
from smooth_operator.hands.spec_file import read_hand_spec
from smooth_operator.teleop.joint_rows import joint_rows
from smooth_operator.teleop.pages.hand_page import HandPage
from smooth_operator.teleop.pages.hand_view import HandView

pytestmark = pytest.mark.usefixtures("own_hands")

TEXT = """
format = 1
name = "pincer"
side = "left"
model = "models/pincer.xml"
palm = "palm"
wrist = { body = "palm", offset = [0.01, -0.02, -0.03] }
align = ["wrist", "thumb", "index"]

[fingers.thumb]
cmc = { body = "t1" }
tip = { body = "t2", offset = [0, 0.0, 0.02] }

[fingers.index]
mcp = { body = "i1" }
pip = { body = "i2" }
dip = { body = "i3" }
tip = { body = "i3", offset = [0.0, 0.0, 0.02] }

[neutral]
i1 = 0.3
"""


def written(tmp_path: Path, text: str = TEXT) -> Path:
    path = tmp_path / "pincer.left.toml"
    path.write_text(text, encoding="utf-8")
    return path


def changed(old: str, new: str) -> Callable[[Path], Path]:
    assert TEXT.count(old) >= 1, old
    return lambda folder: written(folder, TEXT.replace(old, new, 1))


def test_content_of_a_file(tmp_path):
    spec = read_hand_spec(written(tmp_path))
    assert (spec.name, spec.side, spec.palm, spec.mirror) == ("pincer", "left", "palm", False)
    assert spec.model == tmp_path / "models/pincer.xml"
    assert spec.wrist == Point("palm", (0.01, -0.02, -0.03))
    thumb, index = spec.fingers
    assert thumb.points == (Point("t1"), None, None, Point("t2", (0.0, 0.0, 0.02)))
    assert [p.body for p in index.points if p] == ["i1", "i2", "i3", "i3"]
    assert spec.neutral == {"i1": 0.3}
    assert spec.align == ("wrist", "thumb", "index")


def test_written_files_are_read_back(tmp_path):
    spec = replace(
        pincer(tmp_path),
        side="left",
        mirror=True,
        neutral={"i1": 0.1 + 0.2, 'F0/"J 0"\n': -1e-17},
        joint_map=(
            JointMap("i1", 0.25, {"index_mcp": 1.5, "index_pip": -0.5}),
            JointMap("r-abd", 0.0),
        ),
        torque={"i1": 0.75, "r-abd": 2.0},
        couplings=(Coupling("i2", "i1", 0.89, -0.1), Coupling("r-abd", "i2", -1.0, 0.0)),
        source='our lab, "Müller"\\ \u2028\x07',
    )
    write_hand_spec(spec, tmp_path / "a.toml", comment="made by hand\n\nfor a test")
    assert read_hand_spec(tmp_path / "a.toml") == spec
    assert (tmp_path / "a.toml").read_text().startswith("# made by hand\n#\n# for a test\nformat")
    for torque in (0.7, None):
        write_hand_spec(replace(spec, torque=torque), tmp_path / "a.toml")
        assert read_hand_spec(tmp_path / "a.toml").torque == torque


@pytest.mark.parametrize("name", hand_names())
def test_built_in_hands_are_read_back(tmp_path, name):
    for side in ("right", "left"):
        spec = find_hand(name).spec(side)
        write_hand_spec(spec, tmp_path / "spec.toml")
        assert read_hand_spec(tmp_path / "spec.toml") == spec


def test_a_folder_with_its_model_can_be_moved(tmp_path):
    old = tmp_path / "old"
    (old / "models").mkdir(parents=True)
    write_hand_spec(pincer(old / "models"), old / "p.toml")
    assert 'model = "models/pincer.xml"' in (old / "p.toml").read_text()
    old.rename(tmp_path / "new")
    assert load_hand(tmp_path / "new" / "p.toml").name == "pincer"
    write_hand_spec(read_hand_spec(tmp_path / "new" / "p.toml"), tmp_path / "elsewhere.toml")
    assert load_hand(str(tmp_path / "elsewhere.toml")).name == "pincer"


def test_a_file_from_windows(tmp_path):
    path = tmp_path / "w.toml"
    path.write_bytes(b"\xef\xbb\xbf" + TEXT.replace("\n", "\r\n").encode())
    assert read_hand_spec(path).name == "pincer"


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("format = 1", "", "format: is missing"),
        (
            "format = 1",
            "format = 2",
            "format: expected 1, not 2; this file is from a newer version",
        ),
        ("format = 1", "format = true", "format: expected a whole number, not True"),
        ("format = 1", "format = = 1", r"not well-formed TOML: .*line 2"),
        ('side = "left"', 'side = "Left"', "side: expected 'right' or 'left', not 'Left'"),
        ('name = "pincer"', 'name = "../x"', "can't be named '../x'"),
        ('name = "pincer"', "name = 3", "name: expected a string, not 3"),
        ('palm = "palm"', 'plam = "palm"', r"plam: no such entry. Did you mean 'palm'\?"),
        ('palm = "palm"', 'palm = ""', "palm: expected a string that is not empty"),
        ('palm = "palm"', "", "palm: is missing; expected a string"),
        ('model = "models/pincer.xml"', "", "model: is missing"),
        ("offset = [0.01, -0.02, -0.03]", "offset = [0.01, -0.02]", r"wrist.offset: expected \[x"),
        ("offset = [0.01,", "offset = [nan,", "wrist.offset: expected a finite number, not nan"),
        ("offset = [0.01,", "offset = [inf,", "finite number, not inf"),
        ("offset = [0.01,", 'offset = ["1",', "finite number, not '1'"),
        ("offset = [0.01,", "offset = [10.0,", "more than a metre"),
        ("offset = [0.01,", f"offset = [1{'0' * 400},", "whole number has more than 20 digits"),
        ('wrist = { body = "palm",', 'wrist = { link = "palm",', "wrist.link: no such entry"),
        ("[fingers.thumb]", "[fingers.toe]", "fingers.toe: no such entry"),
        ('cmc = { body = "t1" }', 'mpc = { body = "t1" }', r"thumb.mpc: no such .* 'mcp'\?"),
        ('cmc = { body = "t1" }', "", "fingers.thumb.cmc: is missing"),
        ('cmc = { body = "t1" }', 'cmc = "t1"', "thumb.cmc: expected a table, not 't1'"),
        ('mcp = { body = "i1" }', "mcp = {}", "index.mcp.body: is missing"),
        ("i1 = 0.3", "i1 = true", "neutral.i1: expected a finite number, not True"),
        ("i1 = 0.3", "i1 = 0.3\ni1 = 0.4", "not well-formed TOML"),
        ('["wrist", "thumb", "index"]', '["thumb", "index"]', "align needs three"),
        ('["wrist", "thumb", "index"]', '["wrist", 1, "index"]', "align: expected names"),
        ('["wrist", "thumb", "index"]', '["wrist", "thumb", "pinky"]', "align names"),
        ("[neutral]", "[torque]\ni1 = 1000.0\n[neutral]", "torque of 'i1' must be above 0"),
        ('palm = "palm"\n', 'palm = "palm"\ntorque = "x"\n', "torque: expected a finite number"),
        ("[neutral]", "[joint_map.i1]\ngain = 1\n[neutral]", "joint_map.i1.gain: no such entry"),
        ("[neutral]", "[joint_map.i1]\ngains = {index_mcp = 'x'}\n[neutral]", "gains.index_mcp"),
    ],
)
def test_mistakes_are_named(tmp_path, old, new, message):
    path = changed(old, new)(tmp_path)
    with pytest.raises(HandModelError, match=message) as caught:
        read_hand_spec(path)
    assert str(caught.value).startswith(str(path)) or str(path) in str(caught.value)


def test_files_that_are_not_spec_files(tmp_path):
    with pytest.raises(HandModelError, match=r"no spec file at .*no\.toml"):
        load_hand("no.toml")
    with pytest.raises(HandModelError, match="it is a folder, not a regular file"):
        read_hand_spec(tmp_path)
    (tmp_path / "binary.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(HandModelError, match="not text in UTF-8"):
        read_hand_spec(tmp_path / "binary.toml")
    (tmp_path / "large.toml").write_bytes(b"#" * 2_000_000)
    with pytest.raises(HandModelError, match="it has 2000000 bytes, more than 1000000"):
        read_hand_spec(tmp_path / "large.toml")


def test_specs_that_cannot_be_written(tmp_path):
    spec = pincer(tmp_path)
    with pytest.raises(HandModelError, match="can't hold the number nan"):
        write_hand_spec(replace(spec, neutral={"i1": np.nan}), tmp_path / "a.toml")
    with pytest.raises(HandModelError, match="can't be named 'a b'"):
        write_hand_spec(replace(spec, name="a b"), tmp_path / "a.toml")
    with pytest.raises(OutputError, match="does not exist"):
        write_hand_spec(spec, tmp_path / "none" / "a.toml")
    assert not (tmp_path / "a.toml").exists()


def test_a_users_hand_is_found_by_name(tmp_path, own_hands):
    assert "pincer" not in hand_names()
    file = save_hand(pincer(tmp_path))
    assert file == own_hands / "pincer.right.toml"
    assert hand_names()[-1] == "pincer"
    entry = known_hands()["pincer"]
    assert (entry.builtin, entry.mirrored, entry.files) == (False, ("left",), {"right": file})
    right, left = load_hand("pincer"), load_hand("pincer", "left")
    q = np.array([0.1, 0.2, 0.3, 0.4])
    np.testing.assert_allclose(
        left.landmark_positions(q), right.landmark_positions(q) * (-1, 1, 1), atol=1e-12
    )
    # an edit counts at once
    save_hand(replace(pincer(tmp_path), neutral={"i1": 0.7}))
    assert load_hand("pincer").neutral[2] == 0.7


def test_a_spec_file_has_a_side(tmp_path):
    left = replace(pincer(tmp_path), side="left")
    write_hand_spec(left, tmp_path / "a.toml")
    assert (load_hand(tmp_path / "a.toml").spec.side, load_hand(left).spec.side) == ("left", "left")
    right = load_hand(str(tmp_path / "a.toml"), "right")
    assert (right.spec.side, right.spec.mirror) == ("right", True)


def test_built_in_names_are_refused(tmp_path, own_hands):
    mine = replace(pincer(tmp_path), name="shadow_hand")
    with pytest.raises(HandModelError, match=r"'shadow_hand' is a built-in hand.*a different name"):
        save_hand(mine)
    own_hands.mkdir()
    write_hand_spec(mine, own_hands / "shadow_hand.right.toml")
    with pytest.raises(HandModelError, match=r"'shadow_hand' is a built-in hand, so .*right.toml"):
        load_hand("shadow_hand", "left")
    assert load_hand("mimic_p050").name == "mimic_p050"
    assert hand_names().count("shadow_hand") == 1


def test_a_file_that_describes_another_hand(tmp_path, own_hands):
    own_hands.mkdir()
    write_hand_spec(pincer(tmp_path), own_hands / "claw.right.toml")
    with pytest.raises(
        HandModelError, match=r"the right hand 'pincer', but its file name says .* 'claw'"
    ):
        load_hand("claw")
    with pytest.raises(UnknownNameError, match="unknown hand 'pincer'"):
        load_hand("pincer")


def test_the_folder_of_the_user(monkeypatch, tmp_path):
    assert user_hands_folder().name == "hands of ünser user"
    monkeypatch.setenv("SMOOTH_OPERATOR_HANDS", "~/x")
    assert user_hands_folder() == Path.home() / "x"
    monkeypatch.delenv("SMOOTH_OPERATOR_HANDS")
    for platform, variable in (("linux", "XDG_CONFIG_HOME"), ("win32", "APPDATA")):
        monkeypatch.setattr(sys, "platform", platform)
        monkeypatch.setenv(variable, str(tmp_path))
        assert user_hands_folder() == tmp_path / "smooth-operator" / "hands"
    monkeypatch.setattr(sys, "platform", "darwin")
    assert user_hands_folder().parts[-3:] == ("Application Support", "smooth-operator", "hands")


def run(*arguments: str) -> None:
    tyro.cli(Hands, args=arguments, config=(tyro.conf.FlagCreatePairsOff,)).run()


def test_the_list(tmp_path, own_hands, capsys):
    save_hand(replace(pincer(tmp_path), source="[our] lab"))
    (own_hands / "broken.left.toml").write_text("format = 1")
    run("list")
    text = capsys.readouterr().out
    for words in (
        "shadow_hand",
        "18/22",
        "left (mirrored)",
        "[our] lab",
        "broken",
        "can't be used",
    ):
        assert words in text, words
    run("list", "--json")
    listed = json.loads(capsys.readouterr().out)
    assert listed["folder"] == str(own_hands)
    hands = {hand["name"]: hand for hand in listed["hands"]}
    assert tuple(hands) == hand_names()
    assert hands["inspire_hand"]["actuated"] == 6
    assert hands["inspire_hand"]["coupled"] == 6
    assert hands["wuji_hand"]["mirrored"] == ["left"]
    assert "side: is missing" in hands["broken"]["error"]
    assert (hands["pincer"]["builtin"], hands["pincer"]["mirrored"]) == (False, ["left"])


def test_show(capsys):
    run("show", "ability_hand", "--side", "left", "--no-view")
    text = capsys.readouterr().out
    for words in (
        "ability_hand: left hand",
        "1.059 index_q1 + 0.7235",
        "pinky_tip",
        "[rad]",
        "[mm]",
    ):
        assert words in text, words
    run("show", "orca_v2", "--side", "left", "--json")
    said = json.loads(capsys.readouterr().out)
    hand = load_hand("orca_v2", "left")
    assert (said["side"], said["mirrored"]) == ("left", True)
    assert [j["name"] for j in said["joints"]] == [*hand.joint_names, *said["wrist_joints"]]
    assert said["wrist_joints"] == ["right_wrist"]
    assert said["actuated"] == list(hand.actuated_names)
    assert said["fingers"]["index"]["tip"]["body"] == "index_3"
    assert len(said["landmarks_m"]) == 21
    assert {joint["torque"] for joint in said["joints"]} == {1.0}
    run("show", "schunk_svh", "--json")
    joints = {j["name"]: j for j in json.loads(capsys.readouterr().out)["joints"]}
    assert joints["right_hand_j5"]["follows"] == "right_hand_Thumb_Opposition"
    assert not joints["right_hand_j5"]["actuated"]
    assert not any("torque" in joint for joint in joints.values())


def test_a_picture(tmp_path, capsys):
    run("render", "shadow_dexee", "--output", str(tmp_path / "d.png"))
    assert capsys.readouterr().out.strip() == str(tmp_path / "d.png")
    with Image.open(tmp_path / "d.png") as picture:
        assert picture.width > 800
        colors = picture.convert("RGB").getcolors(1 << 24)
    assert len(colors) > 40  # shaded, not blank
    assert (tmp_path / "d.png").stat().st_size < 60_000
    with pytest.raises(OutputError, match="does not exist"):
        run("render", "mimic_p050", "--output", str(tmp_path / "none" / "d.png"))


def test_render_with_another_model(tmp_path):
    run(
        "render",
        "ability_hand",
        "--model",
        str(MODELS / "ability_hand_right.xml"),
        "--output",
        str(tmp_path / "a.png"),
    )
    with pytest.raises(HandModelError, match="lacks the joints"):
        run("render", "ability_hand", "--model", str(MODELS / "leap_hand_right.xml"))


@pytest.mark.parametrize(("name", "side"), [("schunk_svh", "left"), ("shadow_dexee", "right")])
def test_the_view(name, side):
    hand = load_hand(name, side)
    view = HandView(hand)
    right, up, toward = view.axes
    np.testing.assert_allclose(np.cross(right, up), toward, atol=1e-9)
    # to who looks at the palm, a right hand's thumb is on the right
    points = dict(zip(hand.tree.names, hand.landmark_positions(hand.neutral), strict=True))
    across = (points["thumb_tip"] - points[hand.tip_names[-1]]) @ right
    assert across * (1 if side == "right" else -1) > 0
    assert set(view.finger_of_body[list(view.meshes)]) == {-1, *range(len(hand.fingers))}
    rows = {row.name: row for row in joint_rows(hand)}
    assert list(rows) == list(hand.joint_names)
    if side == "left":
        assert rows["left_hand_j5"].follows == "-1 left_hand_Thumb_Opposition"
    assert len(view.bones()) == 4 * len(hand.fingers)


def test_the_page_poses_the_hand(tmp_path):
    hand = load_hand("ability_hand")
    with HandPage(hand, "notes", port=0) as page:
        assert page.url.startswith("http://127.0.0.1:")
        page.set_joint(2, 9.0)  # beyond its limit
        assert page.joint_positions[2] == hand.limits[2, 1]
        page.reset()
        np.testing.assert_array_equal(page.joint_positions, hand.neutral)
    with pytest.raises(ConfigError, match="not being served"):
        _ = page.url


def test_specs_are_equal_by_value(tmp_path):
    spec = pincer(tmp_path)
    twice = spec.mirrored.mirrored
    assert isinstance(twice, HandSpec)
    assert twice == spec
    assert spec.mirrored.side == "left"
