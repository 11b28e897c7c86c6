"""``hands add`` on what it can't use: one line that says what is wrong and what to do."""

import functools
import json
import os
import re
from collections.abc import Callable
from pathlib import Path

import odd_hands
import pytest
import trimesh
from discovery_hands import make_hand, mjcf, urdf
from processes import python

from smooth_operator.hand_discovery.checks import Samples
from smooth_operator.hand_discovery.joints import check_wrist
from smooth_operator.hands.registry import load_hand

HAND = make_hand(3)
TEXT, XML = urdf(HAND.parts), mjcf(HAND.parts)
JOINT = HAND.parts[2]  # of the thumb
LOW, HIGH = JOINT.limits
LAST = HAND.truth.tips[0][0]

WHEELS = "".join(
    f'<body name="w{k}" pos="{0.2 * k} 0 0"><joint name="w{k}" axis="0 1 0"/>'
    '<geom type="cylinder" size="0.05 0.01"/></body>'
    for k in range(4)
)
ROVER = (
    '<mujoco><worldbody><body name="base"><freejoint/><geom size="0.1"/>'
    f"{WHEELS}</body></worldbody></mujoco>"
)
ARM = "".join(
    f'<body name="a{k}" pos="0 0 0.2"><joint name="a{k}" range="-1 1"/><geom size="0.05"/>'
    for k in range(6)
)
ARM_ONLY = f"<mujoco><worldbody>{ARM}{6 * '</body>'}</worldbody></mujoco>"


def joint_of(name: str) -> str:
    """Pattern of a hinge in the MJCF text."""
    return rf'<joint name="{name}" type="hinge" axis="[^"]*" range="[^"]*"/>'


def scaled(attribute: str, factor: float) -> str:
    """The URDF with every number of an attribute multiplied."""

    def times(match: re.Match[str]) -> str:
        numbers = " ".join(str(factor * float(word)) for word in match[1].split())
        return f'{attribute}="{numbers}"'

    return re.sub(rf'{attribute}="([^"]*)"', times, TEXT)


# what it is: content, what is said
REFUSED: dict[str, tuple[str, str]] = {
    "broken XML": ("<mujoco><worldbody>", r"not well-formed.*correct it"),
    "an empty file": ("", r"not well-formed.*export the model again"),
    "another format": ("<sdf><model/></sdf>", r"starts with <sdf>; expected <mujoco>"),
    "a template": (
        '<robot xmlns:xacro="http://x/xacro"><xacro:arg name="a"/></robot>',
        r"expand it first: xacro h\.urdf > hand\.urdf",
    ),
    "an include that is not there": (
        '<mujoco><include file="nope.xml"/></mujoco>',
        r"nope\.xml.*correct this in the file",
    ),
    "a parent that is not there": (
        TEXT.replace('<parent link="palm"/>', '<parent link="ghost"/>', 1),
        r"parent or child missing.*correct this",
    ),
    "limits reversed": (
        TEXT.replace(f'lower="{LOW}" upper="{HIGH}"', f'lower="{HIGH}" upper="{LOW}"', 1),
        r"are reversed.*swap them in the file",
    ),
    "limits reversed in MJCF": (
        XML.replace(f'range="{LOW} {HIGH}"', f'range="{HIGH} {LOW}"', 1),
        r"are reversed.*swap them in the file",
    ),
    "limits that are no numbers": (
        TEXT.replace(f'lower="{LOW}"', 'lower="none"', 1),
        r"are not two numbers",
    ),
    "limits in degrees": (
        re.sub(
            r'lower="([^"]*)" upper="([^"]*)"',
            lambda m: f'lower="{57.3 * float(m[1])}" upper="{57.3 * float(m[2])}"',
            TEXT,
        ),
        r"more than two turns: are they degrees\?.*correct them",
    ),
    "no limits": (
        re.sub(r"<limit [^>]*/>", "", TEXT),
        r"rotate without limits \(.*need limits in the file",
    ),
    "one joint without limits": (
        TEXT.replace(f'lower="{LOW}" upper="{HIGH}"', "").replace(
            f'name="{JOINT.joint}" type="revolute"', f'name="{JOINT.joint}" type="continuous"'
        ),
        r"no limits.*<limit",
    ),
    "equal limits": (
        re.sub(r'upper="1.6"', 'upper="-0.1"', TEXT),
        r"of a finger can't move: in the file, lower = upper = -?[\d.]+.*set their ranges there",
    ),
    "all limits equal": (
        re.sub(r'lower="[^"]*" upper="[^"]*"', 'lower="0.105" upper="0.105"', TEXT),
        r"5 whose joints can't move, because lower = upper in the file",
    ),
    "links at one point": (
        re.sub(
            r"<collision>.*?</collision>", "", re.sub(r'xyz="[^"]*" rpy', 'xyz="0 0 0" rpy', TEXT)
        ),
        r"all at one point \(.*\): the model is a placeholder.* no origins\. The palm",
    ),
    "millimetres": (scaled("xyz", 1000.0), r"a model that is not in metres"),
    "a tip link twice": (
        TEXT.replace("</robot>", f'<link name="{LAST}"/></robot>'),
        r"names the link .* twice; use a different name for each",
    ),
    "a tip given twice": (TEXT, r"--tip names 'index' twice; set one tip per finger"),
    "a tip on another finger": (TEXT, r"choose a body that is fixed to that finger's last link: "),
    "a ball joint": (
        re.sub(joint_of(JOINT.joint), f'<joint name="{JOINT.joint}" type="ball"/>', XML),
        r"is a ball or free joint.*replace it by hinges",
    ),
    "a mobile robot": (ROVER, r"4 that rotate without limits \(wheels\?"),
    "an arm": (ARM_ONLY, r"no fingers found: .*name the palm with --palm"),
    "no joints": ('<robot name="r"><link name="a"/></robot>', r"no joints"),
    "a coupling to nothing in URDF": (
        TEXT.replace("</joint>", '<mimic joint="ghost"/></joint>', 1),
        r"no joint 'ghost'",
    ),
    "a coupling to nothing": (
        XML.replace(
            "<equality>",
            f'<equality><joint joint1="{JOINT.joint}" joint2="ghost" polycoef="0 1 0 0 0"/>',
        ),
        r"ghost.*correct this",
    ),
}
ON_THE_THUMB = ("--tip", f"index={LAST}:0,0,0.01")
OPTIONS = {"a tip given twice": 2 * ON_THE_THUMB, "a tip on another finger": ON_THE_THUMB}

Run = Callable[..., tuple[int, str, str]]


@pytest.fixture
def run(run, elsewhere, own_hands, monkeypatch) -> Run:
    """Runs the command in a folder of its own."""
    monkeypatch.setenv("SMOOTH_OPERATOR_CACHE", "off")
    return functools.partial(run, "hands", "add")


@pytest.mark.parametrize("what", REFUSED)
def test_what_can_not_be_used_is_refused_in_a_line(run, tmp_path, own_hands, what):
    content, message = REFUSED[what]
    name = "h.xml" if content.startswith("<mujoco") else "h.urdf"
    (tmp_path / name).write_text(content, encoding="utf-8")
    status, out, err = run(name, *OPTIONS.get(what, ()))
    said = [line for line in err.splitlines() if line.startswith("smooth-operator: ")]
    assert (status, out, len(said)) == (2, "", 1), err
    assert re.search(message, said[0]), said[0]
    assert "Traceback" not in err
    assert not own_hands.exists()


def test_a_file_that_is_not_there_and_a_folder(run, tmp_path):
    status, _, err = run("none.urdf")
    assert (status, "no hand model at none.urdf" in err) == (2, True), err
    (tmp_path / "package").mkdir()
    (tmp_path / "package/hand.urdf").write_text(TEXT)
    (tmp_path / "package/README").touch()
    status, _, err = run("package")
    assert status == 2
    assert "is a folder; name the model file in it: hand.urdf" in err


@pytest.mark.parametrize("way", ["..", "down/..", "link/..", "link", "link.urdf"])
def test_a_path_by_way_of_other_folders(run, tmp_path, monkeypatch, way):
    """The copy holds the model and its mesh, whichever way the path goes."""
    package, here = tmp_path / "vendor/package", tmp_path / "vendor/here/down"
    for folder in (package / "urdf", package / "meshes", here):
        folder.mkdir(parents=True)
    trimesh.creation.box((0.01, 0.01, 0.01)).export(package / "meshes/part.stl")
    (package / "urdf/hand.urdf").write_text(urdf(HAND.parts, mesh="../meshes/part.stl"))
    (here / "link").symlink_to(package / "urdf", target_is_directory=True)
    (package / "urdf/other.urdf").symlink_to(package / "urdf/hand.urdf")
    monkeypatch.chdir(here)
    path = {
        "..": "../../package/urdf/hand.urdf",
        "down/..": "../down/../../package/urdf/hand.urdf",
        "link/..": "link/../urdf/hand.urdf",  # beside the folder that the link names
        "link": "link/hand.urdf",
        "link.urdf": "link/other.urdf",
    }[way]
    status, out, err = run(path, "--name", "gadget")
    assert (status, "Traceback" in err) == (0, False), err
    assert "Copied the model" in out
    assert "could not be read" not in out
    (tmp_path / "vendor").rename(tmp_path / "gone")
    hand = load_hand("gadget")
    assert (hand.model.nmesh, hand.unreadable) == (1, ())


def test_a_path_that_is_not_utf8(run, tmp_path):
    """Only some file systems have such names."""
    folder = os.fsencode(tmp_path) + b"/m\xff"
    try:
        os.mkdir(folder)
    except OSError:
        pytest.skip("this file system has names in UTF-8 only")
    for name in (b"/h\xff.urdf", b"/h.urdf"):
        Path(os.fsdecode(folder + name)).write_text(TEXT)
        status, out, err = run(os.fsdecode(folder + name), "--name", "raw")
        assert (status, out, "Traceback" in err) == (2, "", False), err
        assert "is not UTF-8 text; rename the file or its folder" in err


def test_names_that_no_file_can_have(run, tmp_path):
    (tmp_path / "h.urdf").write_text(TEXT)
    for name in ("x" * 300, "x" * 101):
        status, out, err = run("h.urdf", "--name", name)
        assert (status, out, "Traceback" in err) == (2, "", False), err
        assert "expected at most 100" in err
    status, _, err = run("x" * 300 + ".urdf")
    assert (status, "no hand model at xxx" in err) == (2, True), err
    (tmp_path / f"{'y' * 240}.urdf").write_text(TEXT)
    assert run(f"{'y' * 240}.urdf")[0] == 0
    assert load_hand("y" * 100).fingers[0] == "thumb"


def test_a_hand_that_would_be_a_guess_is_refused(run, tmp_path, own_hands):
    """One line names every guess and its option; with these, the hand is added and is sound."""
    (tmp_path / "h.urdf").write_text(urdf(tuple(odd_hands.opposed_pairs().parts)))
    status, out, err = run("h.urdf", "--name", "pairs")
    assert (status, out, err.count("is only a guess")) == (2, "", 2), err
    assert re.search(r"the thumb is only a guess .* set it with --thumb BODY", err)
    assert re.search(r"the wrist is only a guess .* set it with --wrist BODY:x,y,z", err)
    assert not own_hands.exists()
    status, _, err = run("h.urdf", "--name", "pairs", "--thumb", "a1")
    assert (status, "thumb is only" in err, "wrist is only" in err) == (2, False, True)
    text = urdf(odd_hands.spread_around().model("right", 0).parts)
    (tmp_path / "around.urdf").write_text(text)
    assert "set it with --side right|left" in run("around.urdf")[2]
    assert run("around.urdf", "--side", "left", "--wrist", "core")[0] == 0
    given = ("--thumb", "a1", "--wrist", "disc:0,0,-0.08", "--json")
    status, out, err = run("h.urdf", "--name", "pairs", *given)
    assert status == 0, err
    assert check_wrist(Samples(load_hand("pairs"))).verdict == "ok"


def test_joints_without_couplings_are_a_note(run, tmp_path):
    """A URDF without mimic elements may be of a hand with fewer motors."""
    for model, noted in ((make_hand(3), True), (make_hand(5, coupled=True), False)):
        (tmp_path / "h.urdf").write_text(urdf(model.parts))
        status, out, _ = run("h.urdf", "--name", "motors", "--overwrite")
        assert (status, "check how many motors the maker specifies" in out) == (0, noted)


def test_a_joint_that_follows_another_finger_is_a_note(run, tmp_path):
    """As in a published model of LEAP Hand v2, where the PIP of the middle finger follows index."""
    text = urdf(make_hand(5, coupled=True).parts)
    (tmp_path / "h.urdf").write_text(text.replace('mimic joint="j19"', 'mimic joint="j11"'))
    status, out, _ = run("h.urdf", "--name", "crossed")
    assert status == 0
    assert "j21 of the middle finger follows j11 of the index finger: check that" in out
    (tmp_path / "h.urdf").write_text(text)
    assert "follows j11 of" not in run("h.urdf", "--name", "crossed", "--overwrite")[1]


@pytest.mark.parametrize("form", ["urdf", "xml"])
def test_missing_meshes_are_a_note_and_no_obstacle(run, tmp_path, form):
    if form == "urdf":
        text = urdf(make_hand(3, shapes=False).parts, mesh="package://vendor/meshes/none.stl")
    else:
        asset = '<asset><mesh name="m" file="none.stl"/></asset>'
        text = XML.replace("<worldbody>", f'{asset}<worldbody><geom type="mesh" mesh="m"/>')
    (tmp_path / f"h.{form}").write_text(text)
    status, out, err = run(f"h.{form}", "--name", "gadget")
    assert status == 0, err
    note = next(line for line in out.splitlines() if line.startswith("Note: "))
    assert "could not be read" in note
    assert "--tip" in note
    assert load_hand("gadget").fingers[0] == "thumb"


def test_a_deprecated_attribute_of_masses_is_no_news(tmp_path, own_hands):
    text = XML.replace('<compiler angle="radian"', '<compiler settotalmass="1" angle="radian"')
    assert "settotalmass" in text
    (tmp_path / "assets").mkdir()
    (tmp_path / "assets/robot.xml").write_text(text)
    words = ("-m", "smooth_operator", "hands", "add", "assets/robot.xml")
    done = python(*words, cwd=tmp_path, check=True)
    assert done.stderr == ""
    (spec,) = own_hands.glob("*.toml")
    assert not spec.name.startswith(("assets", "robot"))  # a name that says something


def test_a_model_without_names_is_read_all_the_same(run, tmp_path):
    text = re.sub(r'<body name="b\d+"', "<body", XML)
    text = re.sub(r'<joint name="j\d+" type', "<joint type", text)
    (tmp_path / "h.xml").write_text(text)
    status, out, err = run("h.xml", "--name", "nameless")
    assert status == 0, err
    assert "have no name in the file" in out
    hand = load_hand("nameless")
    assert len(set(hand.joint_names)) == len(hand.joint_names) == 19
    (tmp_path / "named.xml").write_text(XML)
    assert run("named.xml", "--name", "named")[0] == 0
    named = load_hand("named")
    q = (0.3 * hand.limits[:, 0] + 0.7 * hand.limits[:, 1])[None]
    assert hand.landmark_positions(q) == pytest.approx(named.landmark_positions(q), abs=1e-9)


def test_a_sign_that_can_not_be_is_turned_with_a_warning(run, tmp_path):
    coupled = make_hand(5, coupled=True)
    part = next(p for p in coupled.parts if p.mimic)
    gain = part.mimic[1]
    # of the same joint, counted the other way round, but the coupling left as it was
    low, high = part.limits
    old = f'name="{part.joint}" type="revolute"'
    head, _, tail = urdf(coupled.parts).partition(old)
    tail = tail.replace(f'lower="{low}" upper="{high}"', f'lower="{-high}" upper="{-low}"', 1)
    (tmp_path / "h.urdf").write_text(head + old + tail)
    status, out, err = run("h.urdf", "--name", "turned", "--json")
    assert status == 0, err
    said = json.loads(out)
    row = next(c for c in said["coupled"] if c["joint"] == part.joint)
    assert row["multiplier"] == pytest.approx(-gain)
    assert row["confidence"] < 0.5
    assert all(c["confidence"] > 0.9 for c in said["coupled"] if c is not row)
    assert "coupled" in said["unsure"]
    assert any("is assumed to be wrong" in note for note in said["notes"])
    hand = load_hand("turned", said["side"])
    every = hand.full_configuration(hand.limits.T)
    at = hand.joint_names.index(part.joint)
    assert abs(every[1, at] - every[0, at]) > 0.5
