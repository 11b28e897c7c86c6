"""Self-collision that can't be measured is an empty cell with a footnote, never 0."""

import json
from dataclasses import replace

import pytest
from test_bench_uses import line
from test_stand_ins import with_lost_meshes

from smooth_operator.cli import main
from smooth_operator.hand_files.spec_writer import write_hand_spec
from smooth_operator.hands.penetration import collision_note, penetration_depths, shapeless_links
from smooth_operator.hands.registry import hand_names, load_hand
from smooth_operator.lab.benchmark import ranking

ONE_FINGER = r"index_\w+"


@pytest.mark.parametrize("name", hand_names())
def test_built_in_hands_are_measured(name):
    assert collision_note(load_hand(name)) == ""


@pytest.mark.parametrize("lost", [ONE_FINGER, r"(?!palm).*", r".*"])
def test_a_hand_that_lost_shapes_is_not_measured(lost, tmp_path):
    hand = with_lost_meshes(load_hand("mimic_p050"), lost, tmp_path)
    assert shapeless_links(hand)
    assert penetration_depths(hand, hand.full_configuration(hand.neutral)[None]) is None
    assert "no collision shapes that can be read" in collision_note(hand)


def test_a_verdict_has_no_part_for_collision_that_was_not_measured():
    lines = [
        line("wide", 0.98, 1.1, 0.95, 3e-6, 7.0, None, 0.10, 0.5),
        line("close", 0.97, 1.2, 0.92, 4e-6, 4.0, None, 0.09, 0.6),
    ]
    verdict = ranking.verdict(lines)
    assert "for pinching and grasping close (pinch gap over the human's 4 mm)" in verdict
    assert "self-collision" not in verdict


@pytest.mark.weekly
def test_bench_and_retarget_leave_the_cell_empty(tmp_path, capfd):
    hand = with_lost_meshes(load_hand("mimic_p050"), ONE_FINGER, tmp_path)
    bare = tmp_path / "bare.toml"
    write_hand_spec(replace(hand.spec, name="bare"), bare)
    assert main(["sample", str(tmp_path / "a.npz"), "--duration", "1"]) == 0
    arguments = [str(tmp_path / "a.npz"), "--output"]

    methods = ["--hands", str(bare), "--methods", "joint_angle,keyvector"]
    assert main(["bench", *arguments, str(tmp_path / "out"), *methods]) == 0
    rows = json.loads((tmp_path / "out/results.json").read_text())
    assert all(set(row["metrics"]["self_collision"].values()) == {None} for row in rows)
    printed = capfd.readouterr()
    assert "0.0 %" not in printed.out
    for text in (printed.out, (tmp_path / "out/report.html").read_text(encoding="utf-8")):
        assert "bare.toml right: not measured, since some of its links" in text
    assert "self-collision of bare right is not measured: " in printed.err

    method = ["--hand", str(bare), "--method", "joint_angle", "--json"]
    assert main(["retarget", *arguments, str(tmp_path / "b.npz"), *method]) == 0
    printed = capfd.readouterr()
    assert json.loads(printed.out)["self_collision"]["share"] is None
    assert "self-collision of bare right is not measured: " in printed.err
