"""Self-collision of a hand that lost shapes is that of estimates, and commands say so."""

import json
from dataclasses import replace

import pytest
from test_bench_uses import line
from test_stand_ins import with_lost_meshes

from smooth_operator.cli import main
from smooth_operator.hand_files.spec_writer import write_hand_spec
from smooth_operator.hands.registry import load_hand
from smooth_operator_benchmark import ranking

ONE_FINGER = r"index_\w+"


def test_a_verdict_has_no_part_for_collision_that_was_not_measured():
    lines = [
        line("wide", 0.98, 1.1, 0.95, 3e-6, 0.7, None, 0.10, 0.5),
        line("close", 0.97, 1.2, 0.92, 4e-6, 0.8, None, 0.09, 0.6),
    ]
    verdict = ranking.verdict(lines)
    assert "for pinching and grasping close (fraction of pinches that touch 80.0 %)" in verdict
    assert "self-collision" not in verdict


@pytest.mark.weekly
def test_bench_and_retarget_say_that_shapes_are_estimated(tmp_path, capfd):
    hand = with_lost_meshes(load_hand("mimic_p050"), ONE_FINGER, tmp_path)
    bare = tmp_path / "bare.toml"
    write_hand_spec(replace(hand.spec, name="bare"), bare)
    assert main(["sample", str(tmp_path / "a.npz"), "--duration", "1"]) == 0
    arguments = [str(tmp_path / "a.npz"), "--output"]

    methods = ["--hands", str(bare), "--methods", "joint_angle,keyvector"]
    assert main(["bench", *arguments, str(tmp_path / "out"), *methods]) == 0
    rows = json.loads((tmp_path / "out/results.json").read_text())
    assert all(row["metrics"]["self_collision"]["share"] is not None for row in rows)
    assert "estimated capsules along their bones" in capfd.readouterr().err

    for method in ("joint_angle", "smooth"):
        asked = ["--hand", str(bare), "--method", method, "--json", "--overwrite"]
        assert main(["retarget", *arguments, str(tmp_path / "b.npz"), *asked]) == 0
        printed = capfd.readouterr()
        assert json.loads(printed.out)["self_collision"]["share"] is not None
        assert printed.err.count("estimated capsules along their bones") == 1
