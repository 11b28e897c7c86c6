"""``hands add`` keeps a copy of the model; ``hands remove`` takes a hand away again."""

import functools
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import trimesh
from discovery_hands import make_hand, urdf

from smooth_operator.hand_files.user_hands import copy_model, model_files
from smooth_operator.hands.loading import load_model
from smooth_operator.hands.registry import hand_names, load_hand

TEXT = urdf(make_hand(3).parts)
Run = Callable[..., tuple[int, str, str]]


@pytest.fixture
def run(run, own_hands) -> Run:
    return functools.partial(run, "hands")


def package(tmp_path: Path) -> Path:
    """A vendor's package: the URDF in one folder, a mesh that collides in another."""
    (tmp_path / "vendor" / "urdf").mkdir(parents=True)
    (tmp_path / "vendor" / "meshes").mkdir()
    trimesh.creation.box((0.01, 0.01, 0.01)).export(tmp_path / "vendor" / "meshes" / "box.stl")
    mesh = '<mesh filename="../meshes/box.stl"/>'
    collision = f"<collision><geometry>{mesh}</geometry></collision></link>"
    file = tmp_path / "vendor" / "urdf" / "claw.urdf"
    file.write_text(TEXT.replace("</link>", collision, 1), encoding="utf-8")
    return file


def test_a_hand_survives_that_its_model_is_moved(run, own_hands, tmp_path):
    file = package(tmp_path)
    assert load_model(file).model.nmesh == 1
    status, out, _ = run("add", file, "--name", "claw")
    assert status == 0
    assert "Copied the model" in out
    before = load_hand("claw")
    shutil.move(tmp_path / "vendor", tmp_path / "elsewhere")
    after = load_hand("claw")
    assert after.model.nmesh == 1
    assert after.unreadable == ()
    np.testing.assert_array_equal(after.align_points, before.align_points)
    # the whole folder may be moved as well
    (file,) = own_hands.glob("claw.*.toml")
    assert 'model = "models/' in file.read_text(encoding="utf-8")
    # adding it again from its new place is no other hand
    moved = tmp_path / "elsewhere" / "urdf" / "claw.urdf"
    assert run("add", moved, "--name", "claw")[0] == 0


def test_in_place_copies_nothing_and_a_lost_model_is_said_with_its_cure(run, own_hands, tmp_path):
    file = package(tmp_path)
    assert run("add", file, "--name", "claw", "--in-place")[0] == 0
    assert not (own_hands / "models").exists()
    shutil.move(tmp_path / "vendor", tmp_path / "elsewhere")
    status, _, err = run("show", "claw", "--no-view")
    assert status == 2
    assert "hands add NEWPATH --name claw" in err
    assert "--overwrite" in err


def test_model_files_are_those_of_mjcf_with_includes(tmp_path):
    (tmp_path / "parts" / "meshes").mkdir(parents=True)
    trimesh.creation.box((0.01, 0.01, 0.01)).export(tmp_path / "parts" / "meshes" / "box.stl")
    (tmp_path / "parts" / "assets.xml").write_text(
        '<mujoco><asset><mesh name="box" file="box.stl"/></asset></mujoco>', encoding="utf-8"
    )
    (tmp_path / "hand.xml").write_text(
        '<mujoco><compiler meshdir="parts/meshes"/><include file="parts/assets.xml"/><worldbody>'
        '<body><joint name="j"/><geom type="mesh" mesh="box"/></body></worldbody></mujoco>',
        encoding="utf-8",
    )
    (tmp_path / "not_of_it.stl").write_bytes(b"")
    names = {file.name for file in model_files(tmp_path / "hand.xml")}
    assert names == {"hand.xml", "assets.xml", "box.stl"}
    copy = copy_model(tmp_path / "hand.xml", tmp_path / "to" / "there")
    assert load_model(copy).model.nmesh == 1
    assert sorted(p.name for p in (tmp_path / "to").iterdir()) == ["there"]  # no leftovers


def test_remove_takes_the_hand_and_leaves_the_users_model(run, own_hands, tmp_path):
    file = package(tmp_path)
    assert run("add", file, "--name", "claw")[0] == 0
    assert "claw" in hand_names()
    status, _, err = run("remove", "claw")  # nobody there to ask
    assert status == 2
    assert "--yes" in err
    assert "claw" in hand_names()
    status, out, _ = run("remove", "claw", "--yes")
    assert status == 0
    assert "claw" in out
    assert "claw" not in hand_names()
    assert not list(own_hands.rglob("claw*"))
    assert file.is_file()
    assert (file.parent.parent / "meshes" / "box.stl").is_file()


def test_remove_of_what_is_not_ones_own(run, tmp_path):
    assert run("add", package(tmp_path), "--name", "claw")[0] == 0
    status, _, err = run("remove", "clow", "--yes")
    assert (status, "Did you mean 'claw'" in err) == (2, True)
    status, _, err = run("remove", "leap_hand", "--yes")
    assert (status, "built-in hand and can't be removed" in err) == (2, True)
    side = load_hand("claw").spec.side
    other = {"right": "left", "left": "right"}[side]
    status, _, err = run("remove", "claw", "--side", other, "--yes")
    assert (status, "no description of its" in err) == (2, True)
    assert run("remove", "claw", "--side", side, "--yes")[0] == 0
    assert "claw" not in hand_names()


def test_a_broken_description_can_be_removed(run, own_hands):
    own_hands.mkdir()
    (own_hands / "torn.right.toml").write_text("format =", encoding="utf-8")
    assert run("remove", "torn", "--yes")[0] == 0
    assert not list(own_hands.iterdir())
