"""Meshes that a model names, however it spells them; and models that would never end."""

import logging
import os
import re
import shutil
import sys
from pathlib import Path

import mujoco
import numpy as np
import pytest
import trimesh
from discovery_hands import make_hand, urdf

from smooth_operator import Retargeter, load_hand
from smooth_operator.cli import main
from smooth_operator.errors import HandModelError, RecordingError
from smooth_operator.hand_discovery.discover import discover
from smooth_operator.hand_discovery.model_limits import BODY, MOST_ELEMENTS
from smooth_operator.hand_files.user_hands import copy_model, model_files
from smooth_operator.hands import mujoco_messages
from smooth_operator.hands.hand import load_hand_spec
from smooth_operator.hands.loading import load_model, load_spec
from smooth_operator.hands.stand_ins import stand_in_note, stand_ins
from smooth_operator.planning import make_request
from smooth_operator.synthetic import SyntheticOperator
from smooth_operator.teleop.pages.hand_picture import save_hand_picture
from smooth_operator_benchmark.cells import only_side

JOINT = '<joint name="{0}" type="revolute"><parent link="{1}"/><child link="{2}"/>'


def write_box(path: Path, size: float = 0.01) -> None:
    """A cube as binary STL."""
    path.parent.mkdir(parents=True, exist_ok=True)
    trimesh.creation.box((size, size, size)).export(path)


def ros_package(folder: Path, mesh: str, *, side: str = "right", scale: str = "") -> Path:
    """A package as ROS has them, whose links all have one mesh; the URDF in it."""
    text = urdf(make_hand(9, side=side, shapes=False, turned=False).parts, mesh=mesh)
    if scale:
        text = text.replace("<mesh ", f'<mesh scale="{scale}" ')
    write_box(folder / "meshes" / "box.stl")
    (folder / "package.xml").write_text("<package><name>vendor_hand</name></package>")
    (folder / "urdf").mkdir()
    (folder / "urdf" / "hand.urdf").write_text(text)
    return folder / "urdf" / "hand.urdf"


@pytest.mark.parametrize(
    "name",
    [
        "../meshes/box.stl",
        "package://vendor_hand/meshes/box.stl",
        "package://called_otherwise/meshes/box.stl",
        "model://vendor_hand/meshes/box.stl",
        "file://HERE/meshes/box.stl",
        "HERE/meshes/box.stl",
        "/home/maker/ws/vendor_hand/meshes/box.stl",
        "file:///home/maker/ws/vendor_hand/meshes/box.stl",
        "C:\\maker\\vendor_hand\\meshes\\box.stl",
        "package://vendor_hand/Meshes/BOX.STL",
        "package://vendor_hand/meshes/b%6Fx.stl",
    ],
)
def test_a_mesh_is_loaded_however_it_is_named(name, tmp_path):
    package = tmp_path / "vendor_hand"
    path = ros_package(package, name.replace("HERE", package.as_posix()))
    loaded = load_model(path)
    bodies = loaded.model.nbody - 1
    assert (loaded.model.ngeom, loaded.unreadable, loaded.why) == (bodies, (), "")
    assert load_spec(path).compile().ngeom == bodies
    found = discover(path)
    assert found.notes == ()
    hand = load_hand_spec(found.spec)
    assert (hand.model.ngeom, stand_in_note(hand)) == (bodies, "")
    # a copy has them too, when the original is gone
    assert {file.name for file in model_files(path)} == {"hand.urdf", "box.stl"}
    copy = copy_model(path, tmp_path / "copies" / "hand")
    shutil.rmtree(package)
    assert load_model(copy).model.ngeom == bodies


def test_the_package_that_is_named_comes_before_a_nearer_one(tmp_path):
    path = ros_package(tmp_path / "mine", "package://other/meshes/box.stl")
    write_box(tmp_path / "other" / "meshes" / "box.stl", size=0.03)
    assert load_model(path).model.geom_aabb[:, 3:].max() == pytest.approx(0.015)


def test_what_is_wrong_with_a_mesh_is_said_as_that(tmp_path):
    path = ros_package(tmp_path / "hand", "package://hand/meshes/none.stl")
    text = path.read_text()
    loaded = load_model(path)
    assert loaded.model.ngeom == 0
    assert re.search(r"1 mesh files are not at .*'package://hand/meshes/none.stl'", loaded.why)
    (tmp_path / "hand/meshes/none.dae").write_text("<COLLADA/>")
    path.write_text(text.replace("none.stl", "none.dae"))
    loaded = load_model(path)
    assert len(loaded.unreadable) == loaded.model.nbody - 1
    assert "MuJoCo can't read 1 meshes" in loaded.why
    note = stand_in_note(load_hand_spec(discover(path).spec))
    assert "export them as OBJ" in note
    path.write_text(text.replace("none.stl", "box.stl").replace("box.stl", "none.stl", 1))
    loaded = load_model(path)  # of one link only
    assert loaded.model.ngeom == loaded.model.nbody - 2


def test_a_pointer_of_git_lfs_is_a_mesh_to_download(tmp_path):
    path = ros_package(tmp_path / "hand", "../meshes/far.stl")
    mesh = tmp_path / "hand" / "meshes" / "far.stl"
    mesh.write_text("version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 9\n")
    loaded = load_model(path)
    assert loaded.model.ngeom == 0
    assert "git lfs pull" in loaded.why
    assert any("git lfs pull" in note for note in discover(path).notes)


def test_a_mesh_in_another_folder_is_used_if_it_is_the_only_one_of_its_name(tmp_path):
    path = ros_package(tmp_path / "hand", "parts/box.stl")
    (tmp_path / "hand" / "meshes").rename(path.parent / "assets")
    assert load_model(path).model.ngeom
    write_box(path.parent / "more" / "Box.stl")
    assert not load_model(path).model.ngeom


def test_a_texture_that_is_not_there_costs_the_texture_only(tmp_path):
    write_box(tmp_path / "box.stl")
    path = tmp_path / "hand.xml"
    path.write_text(
        '<mujoco><asset><texture name="t" type="2d" file="gone/skin.png"/><material name="m" '
        'texture="t"/><mesh name="box" file="box.stl"/></asset><worldbody><body><joint/><geom '
        'type="mesh" mesh="box" material="m"/></body></worldbody></mujoco>'
    )
    loaded = load_model(path)
    assert (loaded.model.ngeom, loaded.model.ntex, loaded.unreadable) == (1, 0, ())


@pytest.mark.parametrize(
    ("scale", "fits"), [("1000 1000 1000", "1"), ("50000 50000 50000", r"\S+")]
)
def test_meshes_of_another_unit_are_left_out(scale, fits, tmp_path):
    plain = discover(ros_package(tmp_path / "a", "../meshes/box.stl"))
    path = ros_package(tmp_path / "b", "../meshes/box.stl", scale=scale)
    write_box(tmp_path / "b" / "meshes" / "box.stl", size=0.03)
    found = discover(path)
    assert found.spec.side == plain.spec.side
    assert [f.joints for f in found.fingers] == [f.joints for f in plain.fingers]
    (note,) = found.notes
    assert re.search(rf"times as large as the links .* set scale {fits} where", note), note
    hand = load_hand_spec(found.spec)
    assert hand.model.ngeom == 0
    assert len(hand.unreadable) == hand.model.nbody - 1
    assert "set scale" in stand_in_note(hand)
    assert max(np.ptp(c.ends, axis=0).max() for c in stand_ins(hand).capsules) < 0.2


def test_a_long_mesh_on_what_stands_still_is_kept(tmp_path):
    path = ros_package(tmp_path / "a", "../meshes/box.stl")
    table = (
        '<link name="table"><collision><geometry><mesh filename="../meshes/box.stl" '
        'scale="300 300 300"/></geometry></collision></link><joint name="stand" type="fixed">'
        '<parent link="table"/><child link="palm"/></joint></robot>'
    )
    path.write_text(path.read_text().replace("</robot>", table))
    loaded = load_model(path)
    assert (loaded.oversize, loaded.unreadable) == (False, ())


def links(count: int) -> str:
    chain = "".join(
        JOINT.format(f"j{k}", f"l{k}", f"l{k + 1}") + '<axis xyz="1 0 0"/>'
        f'<limit lower="0" upper="1" effort="1" velocity="1"/></joint><link name="l{k + 1}"/>'
        for k in range(count)
    )
    return f'<robot name="r"><link name="l0"/>{chain}</robot>'


def world(text: str, more: str = "") -> str:
    return f"<mujoco>{more}<worldbody>{text}</worldbody></mujoco>"


GEOM = '<geom size="0.1"/>'
FLEX = '<flexcomp name="f" type="grid" count="500 500 500" dim="3" spacing="1 1 1"/>'
WEDGE = '<asset><mesh name="w" builtin="wedge" params="20000 20000 30 30 0"/></asset>'
ENDLESS: dict[str, tuple[str, str]] = {
    "replicate": (
        world(f'<replicate count="100000000" offset="1 0 0">{GEOM}</replicate>'),
        r"more than 500 bodies or 20000 elements",
    ),
    "replicate of bodies": (
        world(
            f'<replicate count="{MOST_ELEMENTS // BODY + 1}" offset="1 0 0"><body>{GEOM}</body>'
            "</replicate>"
        ),
        "bodies",
    ),
    "nested replicate": (
        world(3 * '<replicate count="1000" offset="1 0 0">' + GEOM + 3 * "</replicate>"),
        "elements",
    ),
    "included replicate": (world('<include file="inner.xml"/>'), "elements"),
    "flexcomp": (world(f"<body>{FLEX}</body>"), "bodies"),
    "points of a file": (
        world('<body><flexcomp name="f" type="mesh" file="a.obj" dim="2"/></body>'),
        "bodies",
    ),
    "composite": (
        world(f'<body><composite type="cable" count="1000 1 1">{GEOM}</composite></body>'),
        "bodies",
    ),
    "built-in mesh": (
        world('<body><joint/><geom type="mesh" mesh="w"/></body>', WEDGE),
        "params=.* is too large; expected at most 512",
    ),
    "large terrain": (
        world(
            '<geom type="hfield" hfield="t"/>',
            '<asset><hfield name="t" nrow="60000" ncol="60000" size="1 1 1 1"/></asset>',
        ),
        "terrain",
    ),
    "keyframes": (world(GEOM, '<size nkey="500000000"/>'), "nkey=.* is too large"),
    "links": (links(5000), "bodies"),
    "includes itself": (world('<include file="model.xml"/>'), "includes itself"),
    "models of models": (
        world(
            "".join(f'<attach model="m" body="b" prefix="p{k}_"/>' for k in range(30)),
            '<asset><model name="m" file="many.xml"/></asset>',
        ),
        "bodies",
    ),
}


@pytest.mark.parametrize("case", ENDLESS)
def test_a_model_that_would_not_end_is_refused_before_mujoco_sees_it(case, reader, tmp_path):
    text, said = ENDLESS[case]
    (tmp_path / "inner.xml").write_text(
        f'<mujocoinclude><replicate count="99999999">{GEOM}</replicate></mujocoinclude>'
    )
    (tmp_path / "many.xml").write_text(
        world(f'<body name="b">{20 * f"<body>{GEOM}</body>"}</body>')
    )
    path = tmp_path / ("model.urdf" if text.startswith("<robot") else "model.xml")
    path.write_text(text)
    verdict = reader.read("hostile_files:discovery", path)  # ends what hangs
    assert (verdict.sound, verdict.outcome) == (True, "refused"), verdict
    with pytest.raises(HandModelError, match=said):
        discover(path)


@pytest.mark.skipif(sys.platform == "win32", reason="no named pipes")
@pytest.mark.parametrize("tag", ["mesh", "texture", "include"])
def test_a_name_of_a_pipe_is_refused(tag, reader, tmp_path):
    os.mkfifo(tmp_path / "pipe.stl")
    inner = {
        "mesh": '<asset><mesh name="m" file="pipe.stl"/></asset>',
        "texture": '<asset><texture name="m" type="2d" file="pipe.stl"/></asset>',
        "include": '<include file="pipe.stl"/>',
    }[tag]
    path = tmp_path / "model.xml"
    path.write_text(world("<body><joint/>" + GEOM + "</body>", inner))
    verdict = reader.read("hostile_files:discovery", path)
    assert (verdict.sound, verdict.outcome) == (True, "refused"), verdict
    with pytest.raises(HandModelError, match=r"names 'pipe.stl': it is a pipe, not a regular file"):
        load_model(path)


@pytest.mark.skipif(sys.platform == "win32", reason="no devices")
def test_a_name_of_a_device_is_refused(tmp_path):
    path = ros_package(tmp_path / "hand", "file:///dev/zero")
    with pytest.raises(HandModelError, match="it is a device"):
        load_model(path)


def test_mujocos_warnings_appear_once(tmp_path, caplog):
    path = ros_package(tmp_path / "hand", "../meshes/none.stl")  # compiled more than once
    path.write_text(path.read_text().replace('upper="1.6"', 'upper="-0.1"'))
    mujoco_messages._warn.cache_clear()
    previous = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(mujoco_messages._warn)
    try:
        with caplog.at_level(logging.WARNING, "smooth_operator.mujoco"):
            load_model(path)
            load_spec(path)
    finally:
        mujoco.set_mju_user_warning(previous)
    texts = [record.message for record in caplog.records]
    assert any("equal lower and upper limits" in text for text in texts)
    assert len(texts) == len(set(texts))


def test_a_hand_of_one_side_has_that_side_by_default(tmp_path, own_hands):
    path = ros_package(tmp_path / "lefty", "package://lefty/meshes/box.stl", side="left")
    assert main(["hands", "add", str(path), "--name", "lefty"]) == 0
    assert load_hand("lefty").spec.side == "left"
    assert Retargeter("lefty", method="joint_angle").hand.spec.side == "left"
    assert main(["hands", "show", "lefty", "--no-view"]) == 0
    assert (only_side(("lefty",)), only_side(("lefty", "mimic_p050"))) == ("left", None)
    with pytest.raises(HandModelError, match="--side left or right"):
        load_hand("lefty", "right")
    # landmarks that do not say their side
    recording, right = tmp_path / "hand.npy", tmp_path / "right.npy"
    landmarks = SyntheticOperator(seed=0, side="left").record(1.0).landmarks
    np.save(recording, landmarks)
    np.save(right, landmarks * (-1, 1, 1))
    request = make_request(hand="lefty", method="joint_angle")
    assert request.read_recording(recording, 100.0).side == "left"
    assert request.read_recording(right, 100.0).side == "right"  # as its shape says
    with pytest.raises(RecordingError):
        make_request(hand="mimic_p050", method="joint_angle").read_recording(recording, 100.0)


@pytest.mark.parametrize("simple", [True, False])
def test_a_hand_without_shapes_is_drawn_by_estimated_ones(simple, tmp_path):
    path = ros_package(tmp_path / "bare", "package://bare/meshes/none.stl")
    hand = load_hand_spec(discover(path).spec)
    assert hand.model.ngeom == 0
    save_hand_picture(hand, tmp_path / "bare.png", simple=simple)
    from PIL import Image

    colors = Image.open(tmp_path / "bare.png").convert("RGB").getcolors(1 << 24)
    assert len(colors) > 40  # shaded surfaces, not only lines
