"""Model files and spec files that are damaged, hostile, or in another encoding."""

import re

import numpy as np
import pytest
from discovery_hands import make_hand, mjcf, urdf
from fuzzing import damaged_xml, each

from smooth_operator.errors import HandModelError
from smooth_operator.hand_discovery.discover import discover
from smooth_operator.hands.capsules import parts_apart
from smooth_operator.hands.collision import solid_shapes
from smooth_operator.hands.hand import load_hand_spec
from smooth_operator.hands.loading import load_model
from smooth_operator.hands.registry import MODELS
from smooth_operator.hands.spec_file import read_hand_spec

HAND = make_hand(3)
URDF, MJCF = urdf(HAND.parts), mjcf(HAND.parts)
SPEC = (MODELS / "shadow_hand.right.toml").read_text(encoding="utf-8")


def declared(text: str, encoding: str) -> str:
    return f'<?xml version="1.0" encoding="{encoding}"?>\n' + re.sub(
        r"^\s*<\?xml[^>]*\?>", "", text
    )


@pytest.mark.parametrize(
    ("encoding", "written"),
    [
        *((name, name) for name in ("gb2312", "GBK", "shift_jis", "utf-16")),
        pytest.param("gb2312", "utf-8", id="declared wrongly"),
    ],
)
def test_a_urdf_in_a_vendors_encoding_loads(encoding, written, tmp_path):
    plain, other = tmp_path / "plain.urdf", tmp_path / "other.urdf"
    plain.write_text(URDF, encoding="utf-8")
    text = declared(URDF.replace(f'"{HAND.parts[2].name}"', '"手"'), encoding)
    other.write_bytes(text.encode(written))
    model, wanted = load_model(other).model, load_model(plain).model
    np.testing.assert_array_equal(model.body_pos, wanted.body_pos)
    assert (written == "utf-8") or "手" in [model.body(b).name for b in range(model.nbody)]
    assert (
        load_hand_spec(discover(other).spec).joint_names
        == load_hand_spec(discover(plain).spec).joint_names
    )


MASS = '<inertial><mass value="0.01"/>{}</inertial>'
NEGATIVE = '<inertia ixx="1e-6" iyy="1e-6" izz="1e-6" ixy="5e-6" ixz="0" iyz="0"/>'


@pytest.mark.parametrize("inertia", ["", NEGATIVE, NEGATIVE.replace('"5e-6"', '"small"')])
def test_a_urdf_is_read_without_an_inertia_that_mujoco_refuses(inertia, tmp_path):
    plain, path = tmp_path / "plain.urdf", tmp_path / "hand.urdf"
    plain.write_text(URDF, encoding="utf-8")
    path.write_text(URDF.replace("</link>", MASS.format(inertia) + "</link>", 2), encoding="utf-8")
    found = discover(path)
    assert any(note.startswith("the inertia of 2 links") for note in found.notes)
    assert found.spec.fingers == discover(plain).spec.fingers


def test_a_urdf_is_read_without_a_colour_that_mujoco_refuses(tmp_path):
    path = tmp_path / "hand.urdf"
    grey = '<material name="grey"><color>1 1 1 1</color></material>'
    path.write_text(URDF.replace("</robot>", grey + "</robot>"), encoding="utf-8")
    loaded = load_model(path)
    assert loaded.model.njnt
    assert loaded.inertias == ()


def test_a_mesh_of_a_declared_pair_that_is_missing_is_a_lost_shape(tmp_path):
    """Its masks are 0, and MuJoCo refuses a pair whose shape is gone."""
    model = make_hand(3, turned=False)
    tip = model.truth.tips[0][0]
    text = mjcf(model.parts).replace('<geom type="capsule"', '<geom name="own" type="capsule"', 1)
    head, body, tail = text.partition(f'<body name="{tip}"')
    mesh = '<geom name="gone" type="mesh" mesh="m" contype="0" conaffinity="0"/>'
    text = head + body + tail.replace(">", f">{mesh}", 1)
    text = text.replace("<worldbody>", '<asset><mesh name="m" file="m.stl"/></asset><worldbody>')
    pair = '<contact><pair geom1="gone" geom2="own"/></contact></mujoco>'
    (tmp_path / "h.xml").write_text(text.replace("</mujoco>", pair))
    loaded = load_model(tmp_path / "h.xml")
    assert loaded.unreadable == (tip,)
    assert loaded.model.npair == 0


def test_shapes_of_declared_pairs_are_collision_shapes(tmp_path):
    shapes = MJCF.replace("<geom ", '<geom contype="0" conaffinity="0" ')
    names = iter(range(1000))
    named = re.sub("<geom ", lambda _: f'<geom name="g{next(names)}" ', shapes)
    pair = '<contact><pair geom1="g0" geom2="g3"/></contact></mujoco>'
    path = tmp_path / "hand.mjcf"
    for text, count in ((named.replace("</mujoco>", pair), 2), (shapes, 0)):
        path.write_text(text, encoding="utf-8")
        hand = load_hand_spec(discover(path).spec)
        assert solid_shapes(hand).sum() == count
    path.write_text(shapes.replace("<geom ", '<geom group="3" '), encoding="utf-8")
    hand = load_hand_spec(discover(path).spec)
    assert solid_shapes(hand).sum() == shapes.count("<geom ")
    path.write_text(MJCF, encoding="utf-8")
    usual = load_hand_spec(discover(path).spec)  # of shapes that collide by their masks
    assert len(parts_apart(usual).pairs)
    np.testing.assert_array_equal(parts_apart(hand).pairs, parts_apart(usual).pairs)


REFUSED: dict[str, tuple[str, str, str]] = {
    "unknown encoding": ("h.xml", declared(MJCF, "klingon"), r"encoding 'klingon'.*UTF-8"),
    "pointer": (
        "h.urdf",
        "version https://git-lfs.github.com/spec/v1\noid sha256:0\n",
        r"pointer of Git LFS.*git lfs pull",
    ),
    "binary encoding": ("h.xml", declared(MJCF, "hex"), r"encoding 'hex'.*UTF-8"),
    "mimic inf": (
        "h.urdf",
        URDF.replace("</joint>", '<mimic joint="x" multiplier="inf"/></joint>', 1),
        r"multiplier and offset must be finite",
    ),
    "place nan": (
        "h.xml",
        re.sub(r'pos="\S+ ', 'pos="nan ', MJCF, count=2),
        r"numbers that are not finite",
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_a_model_that_cannot_be_used_is_refused_in_a_sentence(case, tmp_path):
    name, text, said = REFUSED[case]
    path = tmp_path / name
    path.write_text(text, encoding="utf-8")
    for reader in (load_model, discover):
        with pytest.raises(HandModelError, match=said):
            reader(path)


def test_a_mesh_name_that_no_file_can_have_is_a_missing_mesh(tmp_path):
    mesh = f'<visual><geometry><mesh filename="{"y" * 400}.stl"/></geometry></visual></link>'
    path = tmp_path / "hand.urdf"
    path.write_text(re.sub("</link>", mesh, URDF, count=2), encoding="utf-8")
    found = discover(path)
    assert any("could not be read" in note for note in found.notes)
    load_hand_spec(found.spec)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (SPEC.replace("format = 1", "format = " + "9" * 5000), r"not well-formed TOML"),
        ("a" + ".a" * 200_000 + " = 1\n" + SPEC, r"more than 1000 dots"),
        (SPEC.replace("format = 1", "format = " + "[" * 5000 + "]" * 5000), r"TOML|format"),
        (SPEC + "\n" + "\n".join(f"x{'.x' * 900} = {k}" for k in range(2)), r"."),
        (SPEC.replace('name = "shadow_hand"', f'name = "{"y" * 90_000}!"'), r"can't be named"),
    ],
    ids=["digits", "dots", "brackets", "deep", "name"],
)
def test_a_hostile_spec_file_is_refused_in_a_sentence(text, said, tmp_path):
    path = tmp_path / "hand.toml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(HandModelError, match=said) as refused:
        read_hand_spec(path)
    assert len(str(refused.value)) < 600


SEEDS: dict[str, tuple[str, str, str, int]] = {
    "urdf": ("m.urdf", URDF, "smooth_operator.hands.loading:load_model", 30),
    "mjcf": ("m.xml", MJCF, "smooth_operator.hands.loading:load_model", 30),
    "discovery": ("m.urdf", URDF, "hostile_files:discovery", 12),
    "toml": ("m.toml", SPEC, "smooth_operator.hands.spec_file:read_hand_spec", 60),
}


@pytest.mark.parametrize("kind", SEEDS)
def test_mutants_are_read_or_refused(kind, reader, tmp_path):
    name, text, target, count = SEEDS[kind]
    path, outcomes = tmp_path / name, set()

    def read(mutant: bytes) -> None:
        path.write_bytes(mutant)
        verdict = reader.read(target, path)
        assert verdict.sound, verdict
        outcomes.add(verdict.outcome)

    each(damaged_xml(text.encode()), count, read)
    assert outcomes == {"read", "refused"}
