"""Estimated capsules for links whose collision shapes can't be read."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from capsule_depths import depths, ends_of
from compact_hands import long_test_hands

from smooth_operator import Retargeter, load_hand, method_config
from smooth_operator.cli import main
from smooth_operator.hand_discovery.checks import Samples
from smooth_operator.hand_discovery.discover import discover
from smooth_operator.hand_discovery.joints import check_shapes
from smooth_operator.hand_files.spec_writer import write_hand_spec
from smooth_operator.hands.capsules import capsule_pairs
from smooth_operator.hands.collision import solid_shapes
from smooth_operator.hands.hand import Hand, fingerprint, load_hand_spec
from smooth_operator.hands.penetration import penetration_depths
from smooth_operator.hands.stand_ins import stand_in_links, stand_in_note, stand_ins

_GEOM = re.compile(r"<geom name=\"(\w+)\"[^>]*/>")
_INERTIA = '<inertial pos="0 0 0" mass="0.01" diaginertia="1e-5 1e-5 1e-5"/>'


def with_lost_meshes(hand: Hand, lost: str, folder: Path) -> Hand:
    """The hand with shapes whose name matches as meshes of which the file is not there."""
    text = hand.spec.model.read_text(encoding="utf-8")
    names: list[str] = []

    def as_mesh(match: re.Match[str]) -> str:
        if not re.fullmatch(lost, match[1]):
            return match[0]
        names.append(match[1])
        return f'<geom name="{match[1]}" type="mesh" mesh="{match[1]}"/>'

    text = _GEOM.sub(as_mesh, text)
    assert names
    assets = "".join(f'<mesh name="{name}" file="gone/{name}.stl"/>' for name in names)
    text = re.sub(r"(<body name=\"[^\"]*\"[^>]*>)", rf"\1{_INERTIA}", text)
    text = text.replace("<worldbody>", f"<asset>{assets}</asset><worldbody>", 1)
    path = folder / hand.spec.model.name
    path.write_text(text, encoding="utf-8")
    return load_hand_spec(replace(hand.spec, model=path))


@pytest.mark.parametrize("name", long_test_hands())
def test_a_hand_without_shapes_is_kept_clear_nearly_as_with_them(name, tmp_path):
    """Judged by the shapes that were taken away: deep poses are seen, clear ones mostly let be."""
    real = load_hand(name)
    bare = with_lost_meshes(real, r".*", tmp_path)
    assert not solid_shapes(bare).any()
    pairs = capsule_pairs(bare)
    assert len(pairs.pairs) > 10
    assert (pairs.shapes == -1).all()
    q = np.random.default_rng(3).uniform(*real.limits.T, (600, len(real.limits)))
    truth = penetration_depths(real, real.full_configuration(q))
    ours = np.maximum(depths(pairs, ends_of(pairs, bare, q)).max(axis=-1), 0.0)
    deep, clear = truth > 0.008, truth == 0
    assert deep.sum() > 10
    assert (ours[deep] > 0).mean() > 0.75
    if clear.sum() > 15:
        assert (ours[clear] < 0.006).mean() > 0.75


def test_only_links_that_lost_shapes_get_one(tmp_path):
    whole = load_hand("shadow_hand")
    assert stand_in_links(whole) == ()
    assert stand_in_note(whole) == ""
    assert Retargeter(whole).notes == ()
    assert check_shapes(Samples(whole)).verdict == "ok"
    geoms = [whole.model.geom(g).name for g in range(whole.model.ngeom)]
    lost = next(g for g in geoms if g.startswith("index") or "ff" in g.lower())
    hand = with_lost_meshes(whole, lost, tmp_path)
    (link,) = stand_in_links(hand)
    assert link == whole.model.body(whole.model.geom_bodyid[whole.model.geom(lost).id]).name
    assert solid_shapes(hand).sum() == solid_shapes(whole).sum() - 1  # the others stay
    note = stand_in_note(hand)
    assert link in note
    assert Retargeter(hand).notes == (note,)
    assert Retargeter(hand, method="sbr").notes == ()  # has no such term
    assert Retargeter(hand, config=method_config("smooth")).notes == (note,)
    checked = check_shapes(Samples(hand))
    assert (checked.verdict, checked.figures["estimated"]) == ("warning", [link])
    assert fingerprint(hand) != fingerprint(whole)


def test_where_most_fingers_lost_shapes_all_get_the_same_kind(tmp_path):
    whole = load_hand("leap_hand")
    tips = "|".join(
        whole.model.geom(g).name
        for f in whole.spec.fingers
        for g in np.flatnonzero(whole.model.geom_bodyid == whole.model.body(f.tip.body).id)
    )
    hand = with_lost_meshes(whole, tips, tmp_path)
    made = stand_ins(hand)
    assert {c.body for c in made.capsules} > {
        hand.model.body(f.tip.body).id for f in hand.spec.fingers
    }
    pairs = capsule_pairs(hand)
    used = {int(g) for g in pairs.shapes.ravel() if g >= 0}
    parts = {int(hand.model.body_weldid[hand.model.geom_bodyid[g]]) for g in used}
    assert not parts & made.replaced
    # the palm keeps its own
    assert int(hand.model.body_weldid[hand.model.body(hand.spec.palm).id]) in parts


def test_radii_follow_the_size_of_the_hand(tmp_path):
    for name in ("shadow_hand", "allegro_hand", "shadow_dexee"):
        real = load_hand(name)
        (folder := tmp_path / name).mkdir()
        long = stand_ins(with_lost_meshes(real, r".*", folder)).capsules
        fingers = [c.radius for c in long if c.body != real.model.body(real.spec.palm).id]
        thick = real.model.geom_size[solid_shapes(real) & (real.model.geom_type == 3), 0]
        assert 0.5 < np.median(fingers) / np.median(thick) < 1.6


@pytest.mark.shared
def test_a_vendors_urdf_is_kept_clear_without_its_meshes(shared):
    """Judged by the built-in hand's shapes at the same joint positions."""
    file = shared / "hands_urdf" / "leap_hand" / "leap_hand_right.urdf"
    urdf, real = load_hand_spec(discover(file).spec), load_hand("leap_hand")
    assert urdf.joint_names == real.joint_names
    assert len(urdf.unreadable) == 4  # the fingertips
    pairs = capsule_pairs(urdf)
    q = np.random.default_rng(2).uniform(*urdf.limits.T, (300, len(urdf.limits)))
    truth = penetration_depths(real, urdf.full_configuration(q))
    ours = depths(pairs, ends_of(pairs, urdf, q)).max(axis=-1)
    assert (ours[truth > 0.005] > 0.0).mean() > 0.9


def test_it_is_said_where_a_folder_is_retargeted(tmp_path, capfd):
    hand = with_lost_meshes(load_hand("mimic_p050"), r".*", tmp_path)
    write_hand_spec(hand.spec, tmp_path / "bare.toml")
    folder = tmp_path / "recordings"
    folder.mkdir()
    (folder / "a.npz").write_bytes(b"")  # fails before anything is compiled
    asked = ["retarget", str(folder), "--output", str(tmp_path / "out"), "--workers", "0"]
    for name, said in ((str(tmp_path / "bare.toml"), True), ("mimic_p050", False)):
        assert main([*asked, "--hand", name]) == 1
        assert ("estimated capsules along their bones" in capfd.readouterr().err) == said


@pytest.mark.shared
def test_it_is_said_where_a_hand_is_added(shared, own_hands, capfd):
    file = shared / "hands_urdf" / "leap_hand" / "leap_hand_right.urdf"
    assert main(["hands", "add", str(file), "--name", "bare_leap"]) == 0
    said = capfd.readouterr().out
    assert "could not be read; estimated capsules along their bones replace them" in said
    added = load_hand("bare_leap", "right")  # with the map of the built-in hand's thumb
    assert added.spec.joint_map == load_hand("leap_hand").spec.joint_map
